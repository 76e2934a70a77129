"""Listens to a bench for its web page, and stops it: graph and messages in, dashboard/ out.

Topics, services and parameters are looked for below one namespace, again and again: nodes may come
and go.
"""

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.exceptions import InvalidNamespaceException
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile
from rclpy.validate_namespace import validate_namespace
from sensor_msgs.msg import BatteryState, JointState, Range, Temperature
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sma_bench.border import NUMBER, NUMBER_OR_NULL, TEXT, read_fields, shown
from sma_bench.dashboard import live_state
from sma_bench.dashboard.live_state import CELSIUS_ZERO, LIMITS, MEASURED, MODEL, LiveState
from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_state
from sma_bench.records.contract import place_of
from sma_bench.ros.node import (
    COMMAND,
    COMMANDED,
    LATCHED,
    OneThreadExecutor,
    OverridableNode,
    signature,
    start_ros,
    voltage_command,
)

_LOOK_EVERY, _ASK_EVERY, _SPIN = 0.5, 2.0, 0.05
_TRIGGER = "std_srvs/srv/Trigger"
_CHANNELS = "bench.channels"
# Only nodes with limits of the bench know these parameters.
_ASKED = [_CHANNELS, *LIMITS]
_LEVELS = {
    DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error", DiagnosticStatus.STALE: "stale",
}  # fmt: skip
_RECORDER = "recorder"
_WORK = {"identify": "identification", "diagnose": "diagnosis"}
_PROGRESS = {"protocol": TEXT, "step": TEXT, "elapsed": NUMBER, "duration": NUMBER_OR_NULL}
# Anybody may make topics and services without end.
_MOST_TOPICS, _MOST_CLIENTS, _MOST_CHANNELS = 500, 200, 64


class DashboardNode(OverridableNode):
    """Everything of one bench into a LiveState; `send_stop` and `send_zero` from any thread."""

    def __init__(self, namespace: str, state: LiveState) -> None:
        super().__init__("dashboard", namespace=namespace)
        self.state = state
        self._inside = self.get_namespace().rstrip("/") + "/"
        self._listened: set[str] = set()
        self._callable: dict[str, dict[str, Client]] = {
            "stop": {}, "get_parameters": {}, "set_parameters": {}, **{work: {} for work in _WORK},
        }  # fmt: skip
        self._reported: dict[str, dict[str, float]] = {}
        self._channels: tuple[str, ...] = ()
        self._commanded = 0
        self._command = self.create_publisher(Float64MultiArray, COMMAND, 10)
        self._signature = signature(self)
        self._listen("/diagnostics", DiagnosticArray, self._on_diagnostics, QoSProfile(depth=50))
        self.create_timer(_LOOK_EVERY, self._look)
        self.create_timer(_ASK_EVERY, self._ask)
        self._look()

    # --- the stop, and work on records --------------------------------------------------------

    def send_stop(self) -> dict[str, Future[tuple[bool, str]]]:
        """Call every `stop` service of the bench; the answers by node."""
        answers = {}
        for name, client in list(self._callable["stop"].items()):
            answer = answers[name] = Future[tuple[bool, str]]()
            if client.service_is_ready():
                client.call_async(Trigger.Request()).add_done_callback(
                    lambda done, answer=answer: answer.set_result(
                        (bool(done.result().success), str(done.result().message))
                    )
                )
            else:
                answer.set_result((False, "not there any more"))
        return answers

    def send_zero(self) -> bool:
        """Command 0 V to all channels; False where their number is not known."""
        wires = len(self.state.newest("voltage"))
        count = self._commanded or len(self._channels) or wires
        if count:
            channels = self._channels if len(self._channels) == count else ()
            self._command.publish(voltage_command(channels, [0.0] * count, self._signature))
        return bool(count)

    def start_work(self, kind: str, records: list[str]) -> Future[tuple[bool, str]]:
        """Set a node's records and call it; its result comes over its topic."""
        answer: Future[tuple[bool, str]] = Future()
        if kind not in self._works():
            answer.set_result((False, f"no node here does {kind}"))
            return answer
        if not records:
            answer.set_result((False, "no records given"))
            return answer
        node = _WORK[kind]

        def worked(response: rclpy.Future) -> None:
            result = response.result()
            text = f"{kind}: {'done' if result.success else shown(result.message)}"
            self.state.show("work", {"text": text, "good": bool(result.success)})

        def was_set(response: rclpy.Future) -> None:
            result = response.result().results[0]
            if result.successful:
                call = self._callable[kind][node].call_async(Trigger.Request())
                call.add_done_callback(worked)
                self.state.show("work", {"text": f"{kind}: {' '.join(records)}", "good": True})
            reason = "begun" if result.successful else shown(result.reason)
            answer.set_result((bool(result.successful), reason))

        chosen = RosParameter("record", value=records).to_parameter_msg()
        request = SetParameters.Request(parameters=[chosen])
        setting = self._callable["set_parameters"][node].call_async(request)
        setting.add_done_callback(was_set)
        return answer

    def _works(self) -> list[str]:
        return sorted(
            kind for kind, node in _WORK.items()
            if (call := self._callable[kind].get(node)) and call.service_is_ready()
            and (setting := self._callable["set_parameters"].get(node))
            and setting.service_is_ready()
        )  # fmt: skip

    # --- what is there ------------------------------------------------------------------------

    def _look(self) -> None:
        elsewhere = set()
        for topic, types in self.get_topic_names_and_types():
            if topic.startswith(self._inside):
                self._take(topic, topic.removeprefix(self._inside).split("/"), types)
            elif (place := place_of(topic)) and place.meaning.endswith("/power"):
                elsewhere.add(place.namespace)
        for service, types in self.get_service_names_and_types():
            name, _, what = service.removeprefix(self._inside).rpartition("/")
            known = self._callable.get(what, {})
            kind = {"get_parameters": GetParameters, "set_parameters": SetParameters}.get(
                what, Trigger if _TRIGGER in types else None
            )
            # The recorder's stop ends the record, and drives nothing.
            if (
                service.startswith(self._inside) and what in self._callable and kind is not None
                and name not in (*known, self.get_name(), _RECORDER) and len(known) < _MOST_CLIENTS
                and (what in ("stop", "get_parameters") or name in _WORK.values())
            ):
                known[name] = self.create_client(kind, service)
        stops = self._callable["stop"].items()
        # Of which nodes nothing more will come: their last words stay latched here.
        states = [topic for topic in self._listened if topic.endswith("/state")]
        there = [topic for topic in states if self.count_publishers(topic)]
        self.state.show("elsewhere", sorted(elsewhere))
        self.state.show("works", self._works())
        self.state.show("stops", sorted(n for n, client in stops if client.service_is_ready()))
        self.state.show(
            "there", sorted({t.removeprefix(self._inside).rpartition("/")[0] for t in there})
        )

    def _take(self, topic: str, parts: list[str], types: list[str]) -> None:
        """Subscribe to a topic of the bench, once."""
        kind = MEASURED
        if parts[0] == "twin" and len(parts) > 1:
            kind, parts = MODEL, parts[1:]
        reading = self.state.reading
        handler: tuple[type, Callable[[Any], None], QoSProfile] | None = None
        match parts:
            case [channel, "power"]:
                handler = BatteryState, partial(self._on_power, channel, kind), COMMANDED
            case [place, "temperature"]:
                handler = Temperature, lambda m: reading(
                    "temperature", place, m.temperature + CELSIUS_ZERO, kind
                ), COMMANDED
            case ["front" | "back" as side, "range"]:
                handler = Range, lambda m: reading("distance", side, m.range, kind), COMMANDED
            case ["joint_states"]:
                handler = JointState, partial(self._on_joints, kind), COMMANDED
            case ["voltage_command"] if kind == MEASURED:
                handler = Float64MultiArray, self._on_command, COMMANDED
            case ["identification" | "diagnosis" as node, "result"] if kind == MEASURED:
                handler = String, partial(self._on_result, node), LATCHED
            case [node, "state"] if kind == MEASURED:
                handler = String, partial(self._on_state, node), LATCHED
            case [node, "progress"] if kind == MEASURED:
                handler = String, partial(self._on_progress, node), LATCHED
        if handler is not None:
            package, name = handler[0].__module__.partition(".")[0], handler[0].__name__
            if f"{package}/msg/{name}" in types:
                self._listen(topic, *handler)

    def _listen(
        self, topic: str, kind: type, on_message: Callable[[Any], None], qos: QoSProfile
    ) -> None:
        if topic not in self._listened and len(self._listened) < _MOST_TOPICS:
            self._listened.add(topic)
            self.create_subscription(kind, topic, on_message, qos)

    # --- limits, as the nodes hold them -------------------------------------------------------

    def _ask(self) -> None:
        for name, client in self._callable["get_parameters"].items():
            if not client.service_is_ready():
                self._reported.pop(name, None)
                continue
            answer = client.call_async(GetParameters.Request(names=_ASKED))
            answer.add_done_callback(partial(self._on_answer, name))
        limits: dict[str, float] = {}
        for values in self._reported.values():
            for limit, value in values.items():
                limits[limit] = min(value, limits.get(limit, math.inf))
        by = sorted(n for n, found in self._reported.items() if found)
        self.state.show("limits", {"values": live_state.shown_limits(limits), "of": by})

    def _on_answer(self, name: str, answer: rclpy.Future) -> None:
        if (response := answer.result()) is None:
            return
        found: dict[str, float] = {}
        for key, value in zip(_ASKED, response.values, strict=False):
            is_number = value.type == ParameterType.PARAMETER_DOUBLE
            names = tuple(map(shown, value.string_array_value[:_MOST_CHANNELS]))
            if key == _CHANNELS and names:
                self._channels = names
                self.state.show("channels", names)
            elif key in LIMITS and is_number and math.isfinite(value.double_value):
                found[key] = float(value.double_value)
        self._reported[name] = found

    # --- messages -----------------------------------------------------------------------------

    def _on_power(self, channel: str, kind: str, message: BatteryState) -> None:
        self.state.reading("voltage", channel, message.voltage, kind)
        self.state.reading("current", channel, message.current, kind)

    def _on_joints(self, kind: str, message: JointState) -> None:
        quantities = {"tip": "deflection", "wire": "elongation"}
        for name, position in zip(message.name, message.position, strict=False):
            if name in quantities:
                self.state.reading(quantities[name], name, position, kind)
        for name, effort in zip(message.name, message.effort, strict=False):
            if name == "wire":
                self.state.reading("force", name, effort, kind)

    def _on_command(self, message: Float64MultiArray) -> None:
        channels = self._channels
        if len(message.data) == len(channels):
            self._commanded = len(channels)
            for channel, volts in zip(channels, message.data, strict=True):
                self.state.reading("voltage", channel, volts, live_state.COMMANDED)

    def _on_state(self, node: str, message: String) -> None:
        self.state.merge("states", {node: state_line(message.data)})
        if node == _RECORDER and (recorder := recorder_state(message.data)):
            self.state.show("recorded", shown(recorder["output"]))

    def _on_progress(self, node: str, message: String) -> None:
        try:
            progress = read_fields(message.data, _PROGRESS, f"{node}/progress")
        except InputError:
            return  # the page says that the last one is old
        texts = {name: shown(progress[name]) for name in ("protocol", "step")}
        heard = self.state.clock()
        self.state.show("progress", {**progress, **texts, "node": node, "heard": heard})

    def _on_result(self, node: str, message: String) -> None:
        self.state.show(node, getattr(live_state, f"{node}_summary")(message.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        heard = self.state.clock()
        self.state.merge("diagnostics", {
            shown(status.name.removeprefix(self._inside)): {
                "level": _LEVELS.get(status.level, "error"), "message": shown(status.message),
                "heard": heard,
            }
            for status in message.status
            if status.name.startswith(self._inside)
        })  # fmt: skip


@contextmanager
def listening_node(
    namespace: str, state: LiveState, on_failure: Callable[[Exception], Any],
    ros_arguments: Sequence[str] = (),
) -> Iterator[DashboardNode]:
    """A node that listens in a thread of its own; `on_failure` is called there if it dies.

    Raises:
        InputError: no such namespace can be, or ROS refuses its arguments.
    """
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException as error:
        reason = str(error).splitlines()[0].removesuffix(":")
        raise InputError(f"dashboard: namespace {namespace!r}: {reason}") from None
    start_ros(ros_arguments)
    node, ended = DashboardNode(namespace, state), threading.Event()

    def spin() -> None:
        executor = OneThreadExecutor()
        executor.add_node(node)
        try:
            while not ended.is_set():
                executor.spin_once(timeout_sec=_SPIN)
        except Exception as error:  # a page that goes on without it would show what was
            on_failure(error)
        finally:
            executor.shutdown(timeout_sec=1.0)

    thread = threading.Thread(target=spin, name="dashboard")
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        thread.join()
        node.destroy_node()
        rclpy.try_shutdown()


def state_line(text: str) -> str:
    """A node's state for people: that of the recorder is JSON."""
    if found := recorder_state(text):
        count = sum(found["messages"].values())
        text = f"{found['state']}: {found['output']}, {count} messages"
    return shown(text)
