"""Calls of the bench's nodes by scripts and other nodes; a protocol run that is recorded."""

import os
import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.border import shown
from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_state
from sma_bench.live.run import DONE, IDLE, RUNNING
from sma_bench.ros.node import LATCHED, READINGS, OverridableNode, end_of_ros, start_ros
from sma_bench.ros.processes import NodeProcesses

_SPIN, _TIMEOUT = 0.05, 60.0  # s
_MATCHING = 0.3  # s until a server has matched a new client; earlier answers are lost
_STOP_TIMEOUT = 5.0  # s for the experiment node to answer a stop
_BUSY = re.compile(r"busy: (\d+) %, (.*)")
_DISCOVERY = 30.0  # s in which the experiment node finds existing readings and a recorder


class NodeCalls:
    """A node's calls to the others of its namespace. `spin`, of about 0.05 s, is called while
    waiting and may raise to end the wait."""

    def __init__(self, node: Node, spin: Callable[[], None]) -> None:
        self._node, self._spin = node, spin
        self._namespace = node.get_namespace().rstrip("/")
        self._states, self._clients = dict[str, str](), dict[str, Client]()

    def follow(self, node: str) -> None:
        """Listen to the latched state of a node."""
        if node not in self._states:
            self._states[node] = ""
            self._node.create_subscription(String, f"{node}/state", lambda message: (
                self._states.update({node: message.data})), LATCHED)

    def state(self, node: str) -> str:
        """Last state of a followed node, "" before the first."""
        return self._states.get(node, "")

    def progress(self, node: str) -> tuple[float, str] | None:
        """Share (0 to 1) of a node's work that is done, and its current step; None: no work."""
        found = _BUSY.match(self.state(node))
        return (int(found[1]) / 100.0, found[2]) if found else None

    def client(self, service: str, kind: Any = Trigger) -> Client:
        """The client of a service, created at its first use."""
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        return self._clients[service]

    def wait(self, what: str, condition: Callable[[], Any], timeout: float) -> Any:
        """The first true value of `condition`. InputError (begins with `what`): not in time."""
        end = time.monotonic() + timeout
        while not (value := condition()):
            if time.monotonic() > end:
                raise InputError(f"{what}: nothing within {timeout:g} s")
            self._spin()
        return value

    def find(self, service: str, timeout: float = 10.0) -> None:
        """Wait for a Trigger service. InputError: not found within `timeout` s."""
        try:
            self.wait(service, self.client(service).service_is_ready, timeout)
        except InputError:
            domain = os.environ.get("ROS_DOMAIN_ID") or "0"
            raise InputError(
                f"{self._namespace}/{service}: no such service found within {timeout:g} s in ROS "
                f"domain {domain}: does the node run, in this namespace?") from None

    def trigger(self, service: str, timeout: float = 10.0) -> str:
        """Call a std_srvs/Trigger service; its message. InputError: none in time, or it failed."""
        answer = self._call(service, Trigger, Trigger.Request(), timeout)
        if not answer.success:
            raise InputError(f"{service}: {answer.message}")
        return str(answer.message)

    def set_parameters(self, node: str, values: Mapping[str, Any], timeout: float = 10.0) -> None:
        """Set parameters of a node. InputError: node not found in time, or a value refused."""
        set_to = [RosParameter(name, value=v).to_parameter_msg() for name, v in values.items()]
        request = SetParameters.Request(parameters=set_to)
        answer = self._call(f"{node}/set_parameters", SetParameters, request, timeout)
        for name, result in zip(values, answer.results, strict=True):
            if not result.successful:
                lists = f"no such parameter; sma-bench run {node} --help lists all"
                reason = lists if "undeclared" in result.reason else shown(result.reason)
                raise InputError(f"{node}: {name}: {reason}")

    def _call(self, service: str, kind: Any, request: Any, timeout: float) -> Any:
        client = self.client(service, kind)
        self.wait(service, client.service_is_ready, timeout)
        matched = time.monotonic() + _MATCHING
        self.wait(service, lambda: time.monotonic() > matched, timeout)
        future = client.call_async(request)
        self.wait(service, future.done, timeout)
        return future.result()

    def run_recorded(self, protocol: str | Path, name: str, seconds: float, bag: str | Path,
                     on_state: Callable[[str], None] = lambda state: None,
                     simulated_time: bool = False, needed: Collection[str] = ()) -> None:
        """Let the experiment node run a protocol while a recorder started here records it. If
        anything ends this early, the experiment stops at 0 V, and the unfinished bag stays next to
        `bag`. `protocol`: its file; `name`, `seconds`: its name and duration; `bag`: new folder;
        `on_state`: called with the experiment's state about 20 times a second, may raise to end it;
        `simulated_time`: whether the bench runs on /clock; `needed`: relative topics to be recorded
        before it starts. InputError: the experiment is not ready or aborts, or a node is gone."""
        bag = Path(bag)
        unfinished = bag.with_name(f"unfinished_{bag.name}")
        _rename_unfinished(unfinished)  # left by a process that was killed
        self.follow("experiment")
        self.follow("recorder")
        self.find("experiment/start")
        self.wait("experiment", lambda: self.state("experiment"), _TIMEOUT)
        if not (state := self.state("experiment")).startswith((IDLE, DONE)):
            raise InputError(f"experiment: {shown(state)}: expected idle or done; reset it first")

        def is_recorded() -> bool:
            look()
            found = recorder_state(self.state("recorder"))
            # The last state of another bag's recorder may still arrive.
            if not found or (found["state"], found["output"]) != ("recording", str(unfinished)):
                return False
            heard = {topic.removeprefix(f"{self._namespace}/") for topic in found["messages"]}
            return bool(heard) and heard.issuperset(needed)

        def is_done() -> bool:
            state = look()
            if state not in ("", f"{RUNNING}: {name}", f"{DONE}: {name}"):
                raise InputError(f"experiment {shown(state)}")
            if not self._node.count_publishers("experiment/state"):
                raise InputError("experiment: the node is gone")
            return state.startswith(DONE)

        try:
            with NodeProcesses(self._namespace, bag.parent) as nodes:
                def look() -> str:
                    nodes.check()
                    on_state(self.state("experiment"))
                    return self.state("experiment")

                nodes.start("recorder", {"output": str(unfinished), "use_sim_time": simulated_time})
                self.wait("recorder", is_recorded, _TIMEOUT)
                self.set_parameters("experiment", {"protocol": str(Path(protocol).resolve())})
                self._states["experiment"] = ""  # it may have run one of this name before
                try:
                    # On a busy machine the experiment may not have discovered our recorder yet,
                    # only the end of the previous one.
                    end = time.monotonic() + _DISCOVERY
                    while True:
                        try:
                            self.trigger("experiment/start", _TIMEOUT)
                            break
                        except InputError:
                            look()
                            if time.monotonic() > end:
                                raise
                    self.wait(name, is_done, seconds * 2.0 + _TIMEOUT)
                except BaseException:
                    self.trigger("experiment/stop", _STOP_TIMEOUT)
                    raise
        except BaseException:
            _rename_unfinished(unfinished)
            raise
        unfinished.rename(bag)


def _rename_unfinished(bag: Path) -> None:
    """Give an unfinished bag, if there is one, a unique name."""
    if bag.exists():
        bag.rename(bag.with_name(f"{bag.name}_{time.time_ns()}"))


class BenchClient(NodeCalls, AbstractContextManager["BenchClient"]):
    """NodeCalls of a script, with its own node and ROS context; use as a context manager.
    `meanwhile` is called about 20 times a second while waiting and may raise to end the wait."""

    def __init__(self, namespace: str, meanwhile: Callable[[], None] = lambda: None,
                 ros_arguments: Sequence[str] = ()) -> None:
        start_ros(ros_arguments)
        super().__init__(OverridableNode("bench_client", namespace=namespace), self._look)
        self._meanwhile, self.simulated_seconds = meanwhile, 0.0
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics,
                                       READINGS)

    def __exit__(self, *_: object) -> None:
        with end_of_ros():
            self._node.destroy_node()

    def _look(self) -> None:
        self._meanwhile()
        rclpy.spin_once(self._node, timeout_sec=_SPIN)

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        for item in (item for status in message.status for item in status.values):
            if item.key == "simulated_seconds":
                self.simulated_seconds = float(item.value)
