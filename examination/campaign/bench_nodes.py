"""Nodes in processes of their own for the campaign, and a node that talks to them."""

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.node import Node
from rclpy.qos import QoSProfile

from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.node import LATCHED
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/campaign"
# The machine may be busy with much else: what is judged is never how soon a node is up.
PATIENCE = 120.0
RELIABLE = QoSProfile(depth=2000)


class GaveUp(Exception):
    """What was waited for did not come."""


class Talker:
    """The campaign's own node, another of another program, and the processes beside them.

    DDS lets no program have two types on a topic: that is for the `stranger`.
    """

    def __init__(self, node: Node, stranger: Node, nodes: NodeProcesses) -> None:
        self.node, self.stranger, self.nodes = node, stranger, nodes

    def until(self, what: str, condition: Callable[[], Any], patience: float = PATIENCE) -> Any:
        """Spin until the condition holds and return it; GaveUp with `what` after `patience` s."""
        end = time.monotonic() + patience
        while not (value := condition()):
            if time.monotonic() > end:
                raise GaveUp(f"{what}: not within {patience:g} s")
            self.nodes.check()
            rclpy.spin_once(self.node, timeout_sec=0.01)
        return value

    def listen(self, seconds: float, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Spin for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.005)

    def heard(self, topic: str, kind: type, latched: bool = False) -> list[Any]:
        """Messages of a topic, growing while this spins."""
        messages: list[Any] = []
        qos = LATCHED if latched else RELIABLE
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def kill(self, name: str) -> None:
        """End a node without a warning."""
        with contextlib.suppress(ProcessLookupError):  # it has ended by itself
            os.kill(self.nodes.pid(name), signal.SIGKILL)
        self.nodes.end(name)

    def parameters_of(self, node: str) -> list[str]:
        """Names of a node's parameters: an answer means that it is served.

        One that was killed is in the graph for another 20 s, and a request then goes to nobody
        where its successor is not there yet: asked again until there is an answer.
        """
        end = time.monotonic() + PATIENCE
        while True:
            try:
                answer = self.call(ListParameters, f"{node}/list_parameters", patience=2.0)
                return list(answer.result.names)
            except GaveUp:
                if time.monotonic() > end:
                    raise

    def call(self, kind: type, service: str, patience: float = PATIENCE) -> Any:
        """The answer of a service without arguments."""
        client = self.node.create_client(kind, service)
        try:
            self.until(service, client.service_is_ready, patience)
            self.listen(0.3)  # the server knows its client a little later
            future = client.call_async(kind.Request())
            self.until(service, future.done, patience)
            return future.result()
        finally:
            self.node.destroy_client(client)


@contextlib.contextmanager
def bench_nodes(logs: Path) -> Iterator[Talker]:
    """A ROS context away from every other bench, for the time of a `with`."""
    private_ros_environment()
    # Physics compile once, here: a node that finds it done is up in a second or two, else a minute.
    settings = {parameter.name: parameter.default for parameter in NODE_TABLES["simulator"]}
    list(VirtualBench(Parameters.defaults(), settings).advance((1.0,), 10**8))
    logs.mkdir(parents=True, exist_ok=True)
    rclpy.init(args=[])
    elsewhere = rclpy.Context()
    rclpy.init(args=[], context=elsewhere)
    node = rclpy.create_node("campaign", namespace=NAMESPACE)
    stranger = rclpy.create_node("stranger", namespace=NAMESPACE, context=elsewhere)
    try:
        with NodeProcesses(NAMESPACE, logs) as nodes:
            yield Talker(node, stranger, nodes)
    finally:
        node.destroy_node()
        stranger.destroy_node()
        elsewhere.try_shutdown()
        rclpy.try_shutdown()
