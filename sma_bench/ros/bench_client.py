"""A client of the bench's nodes for scripts: wait for states, call services, set parameters."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_state
from sma_bench.ros.node import LATCHED, OverridableNode, start_ros

_SPIN = 0.05
_MATCHING = 0.3


class BenchClient:
    """Talks to the nodes of one namespace; use as a context manager.

    `meanwhile` is called about 20 times a second while waiting and may raise to end the wait.
    """

    def __init__(
        self, namespace: str, meanwhile: Callable[[], None] = lambda: None,
        ros_arguments: Sequence[str] = (),
    ) -> None:
        start_ros(ros_arguments)
        self._node = OverridableNode("bench_client", namespace=namespace)
        self._namespace = self._node.get_namespace().rstrip("/")
        self._meanwhile = meanwhile
        self._states: dict[str, str] = {}
        self.simulated_seconds = 0.0
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        rclpy.try_shutdown()

    def follow(self, node: str) -> None:
        """Listen to the latched state of a node."""
        self._node.create_subscription(
            String, f"{node}/state", lambda message: self._states.update({node: message.data}),
            LATCHED,
        )

    def state(self, node: str) -> str:
        """Last state of a followed node, "" before the first."""
        return self._states.get(node, "")

    def wait(self, what: str, condition: Callable[[], Any], timeout: float) -> Any:
        """Spin until `condition()` is true and return it.

        Raises:
            InputError: nothing within `timeout` s of wall time; `what` leads the line.
        """
        end = time.monotonic() + timeout
        while not (value := condition()):
            if time.monotonic() > end:
                raise InputError(f"{what}: nothing within {timeout:g} s")
            self._meanwhile()
            rclpy.spin_once(self._node, timeout_sec=_SPIN)
        return value

    def find(self, service: str, timeout: float = 10.0) -> None:
        """Make sure that a std_srvs/Trigger service is there.

        Raises:
            InputError: it is not, within `timeout` s.
        """
        client = self._node.create_client(Trigger, service)
        try:
            self.wait(service, client.service_is_ready, timeout)
        except InputError:
            domain = os.environ.get("ROS_DOMAIN_ID") or "0"
            raise InputError(
                f"{self._namespace}/{service}: no such service found within {timeout:g} s in ROS "
                f"domain {domain}: does the node run, in this namespace?"
            ) from None
        finally:
            self._node.destroy_client(client)

    def trigger(self, service: str, timeout: float = 10.0) -> str:
        """Call a std_srvs/Trigger service and return its message.

        Raises:
            InputError: no such service in time, or it answered with a failure.
        """
        client = self._node.create_client(Trigger, service)
        self._wait_for_service(service, client, timeout)
        answer = self._await(service, client.call_async(Trigger.Request()), timeout)
        self._node.destroy_client(client)
        if not answer.success:
            raise InputError(f"{service}: {answer.message}")
        return str(answer.message)

    def set_parameters(self, node: str, values: Mapping[str, Any], timeout: float = 10.0) -> None:
        """Set parameters of a node.

        Raises:
            InputError: no such node in time, or it refused one; the line says why.
        """
        service = f"{node}/set_parameters"
        client = self._node.create_client(SetParameters, service)
        self._wait_for_service(service, client, timeout)
        request = SetParameters.Request()
        request.parameters = [
            RosParameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        answer = self._await(service, client.call_async(request), timeout)
        self._node.destroy_client(client)
        for name, result in zip(values, answer.results, strict=True):
            if not result.successful:
                raise InputError(f"{node}: {name}: {result.reason}")

    def recorded(self, output: str) -> dict[str, int]:
        """Messages that the followed recorder has written to `output`, by relative topic."""
        state = recorder_state(self.state("recorder"))
        # Another bag's last state may still be on its way when the next recorder starts.
        if state is None or state["output"] != output or state["state"] != "recording":
            return {}
        own = self._namespace + "/"
        return {topic.removeprefix(own): n for topic, n in state["messages"].items()}

    def _wait_for_service(self, service: str, client: Client, timeout: float) -> None:
        self.wait(service, client.service_is_ready, timeout)
        # The server matches the client a little later; until then its answers are lost.
        matched = time.monotonic() + _MATCHING
        self.wait(service, lambda: time.monotonic() > matched, timeout)

    def _await(self, what: str, future: rclpy.Future, timeout: float) -> Any:
        self.wait(what, future.done, timeout)
        return future.result()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for item in status.values:
                if item.key == "simulated_seconds":
                    self.simulated_seconds = float(item.value)
