"""The web page's node: passes a bench's graph and messages to dashboard/, and stops the bench. It
searches topics, services and parameters below a namespace periodically."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sma_bench.border import NUMBER, NUMBER_OR_NULL, TEXT, read_fields, shown
from sma_bench.dashboard import live_state
from sma_bench.dashboard.live_state import CELSIUS_ZERO, LIMITS, MEASURED, MODEL, LiveState
from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_state
from sma_bench.records.contract import BATTERY_STATE, JOINT_SIGNALS, MULTI_ARRAY, STRING, place_of
from sma_bench.ros import node as ros
from sma_bench.ros.bench_client import NodeCalls

_LOOK_EVERY, _ASK_EVERY, _SPIN, _TIMEOUT = 0.5, 2.0, 0.05, 5.0  # s
_PARAMETERS = ["bench.channels", *LIMITS]  # only nodes with limits of the bench have these
_LEVELS = "ok", "warning", "error", "stale"  # of a DiagnosticStatus, from 0
_RECORDER, _WORK = "recorder", {"identify": "identification", "diagnose": "diagnosis"}
_SERVICES = {**dict.fromkeys(("stop", *_WORK), "std_srvs/srv/Trigger"),
             "get_parameters": "rcl_interfaces/srv/GetParameters",
             "set_parameters": "rcl_interfaces/srv/SetParameters"}
_READINGS = ("power", "temperature", "range", "joint_states")
_PROGRESS = {"protocol": TEXT, "step": TEXT, "elapsed": NUMBER, "duration": NUMBER_OR_NULL}
# Limits, as anybody may create any number of topics and services.
_MOST_TOPICS, _MOST_CLIENTS, _MOST_CHANNELS = 500, 200, 64


class DashboardNode(ros.OverridableNode):
    """Collects all of one bench in a LiveState; `send_stop` and `send_zero`: from any thread."""

    def __init__(self, namespace: str, state: LiveState) -> None:
        super().__init__("dashboard", namespace=namespace)
        self.state, self._inside = state, self.get_namespace().rstrip("/") + "/"
        self._listened: set[str] = set()
        self._callable: dict[tuple[str, str], Client] = {}  # by service and node
        self._calls = NodeCalls(self, lambda: time.sleep(_SPIN))
        self._reported: dict[str, dict[str, float]] = {}
        self._channels: tuple[str, ...] = ()
        self._commanded, self._signature = 0, ros.signature(self)
        self._command = self.create_publisher(Float64MultiArray, ros.COMMAND, ros.READINGS)
        self._listen("/diagnostics", DiagnosticArray, self.on_diagnostics, ros.READINGS)
        self.create_timer(_LOOK_EVERY, self._look)
        self.create_timer(_ASK_EVERY, self._ask)
        self._look()

    def _ready(self, service: str) -> dict[str, Client]:
        """Clients of the nodes that offer a service now, by node name."""
        return {node: client for (what, node), client in list(self._callable.items())
                if what == service and client.service_is_ready()}

    def send_stop(self) -> dict[str, rclpy.Future]:
        """Call every `stop` service of the bench; the futures of their answers by node."""
        ready = self._ready("stop")
        return {name: client.call_async(Trigger.Request()) for name, client in ready.items()}

    def send_zero(self) -> bool:
        """Command 0 V to all channels; False if their number is unknown."""
        count = self._commanded or len(self._channels) or len(self.state.voltages())
        if count:
            channels = self._channels if len(self._channels) == count else ()
            self._command.publish(ros.voltage_command(channels, [0.0] * count, self._signature))
        return bool(count)

    def start_work(self, kind: str, records: list[str]) -> None:
        """Set a node's records and trigger its work; the result arrives on its topic. Blocks.
        InputError: no such node, no records, or it refuses them."""
        if kind not in self._works():
            raise InputError(f"no node here does {kind}")
        if not records:
            raise InputError("no records given")
        self._calls.set_parameters(_WORK[kind], {"record": records}, _TIMEOUT)

        def worked(response: rclpy.Future) -> None:
            result = response.result()
            text = f"{kind}: {'done' if result.success else shown(result.message)}"
            self.state.show("work", {"text": text, "good": bool(result.success)})

        self.state.show("work", {"text": f"{kind}: {' '.join(records)}", "good": True})
        client = self._callable[kind, _WORK[kind]]
        client.call_async(Trigger.Request()).add_done_callback(worked)

    def _works(self) -> list[str]:
        """Kinds of work whose node can be configured and triggered now."""
        settable = self._ready("set_parameters")
        return sorted(kind for kind, node in _WORK.items()
                      if node in settable and node in self._ready(kind))

    def _look(self) -> None:
        elsewhere, foreign = set(), {}
        obeying = {info.node_name for info in self.get_subscriptions_info_by_topic(ros.COMMAND)}
        for topic, types in self.get_topic_names_and_types():
            if topic.startswith(self._inside):
                self._take(topic, topic.removeprefix(self._inside).split("/"), types)
                if (place := place_of(topic)) and place.type == BATTERY_STATE:
                    sources = {i.node_name for i in self.get_publishers_info_by_topic(topic)}
                    for name in sources - obeying - {ros.NOT_YET_KNOWN}:
                        foreign[topic.split("/")[-2]] = shown(name)
            elif (place := place_of(topic)) and place.meaning.endswith("/power"):
                elsewhere.add(place.namespace)
        for service, types in self.get_service_names_and_types():
            node, _, what = service.removeprefix(self._inside).rpartition("/")
            kind = _SERVICES.get(what, "")
            if not service.startswith(self._inside) or kind not in types:
                continue
            wanted = node in _WORK.values() or what in ("stop", "get_parameters")
            # The recorder's stop only ends the record.
            new = (what, node) not in self._callable and node not in (self.get_name(), _RECORDER)
            if wanted and new and len(self._callable) < _MOST_CLIENTS:
                client = self._calls.client(f"{node}/{what}", ros.message_class(kind))
                self._callable[what, node] = client
        # Nodes that still exist: the last state of others stays latched here.
        there = [t for t in self._listened if t.endswith("/state") and self.count_publishers(t)]
        nodes = {t.removeprefix(self._inside).rpartition("/")[0] for t in there}
        for panel, names in (("elsewhere", elsewhere), ("stops", self._ready("stop")),
                             ("there", nodes), ("works", self._works())):
            self.state.show(panel, sorted(names))
        self.state.show("foreign", foreign)

    def _take(self, topic: str, parts: list[str], types: list[str]) -> None:
        """Subscribe to a topic of the bench, once."""
        is_twins, node, what = parts[0] == "twin", parts[0], parts[-1]
        meaning = "/".join(parts[is_twins:])
        place = place_of(meaning)
        if place and place.meaning == meaning and place.type in types and what in _READINGS:
            heard = partial(self.on_reading, meaning, MODEL if is_twins else MEASURED)
            self._listen(topic, ros.message_class(place.type), heard, ros.READINGS)
        elif meaning == ros.COMMAND and not is_twins and MULTI_ARRAY in types:
            self._listen(topic, Float64MultiArray, self.on_command, ros.READINGS)
        elif len(parts) == 2 and not is_twins and STRING in types and (
                what in ("state", "progress") or (what == "result" and node in _WORK.values())):
            self._listen(topic, String, partial(getattr(self, f"on_{what}"), node), ros.LATCHED)

    def _listen(self, topic: str, kind: type, heard: Callable[..., None], qos: QoSProfile) -> None:
        if topic not in self._listened and len(self._listened) < _MOST_TOPICS:
            self._listened.add(topic)
            self.create_subscription(kind, topic, heard, qos)

    def _ask(self) -> None:
        ready = self._ready("get_parameters")
        for name, client in ready.items():
            answer = client.call_async(GetParameters.Request(names=_PARAMETERS))
            answer.add_done_callback(partial(self.on_answer, name))
        self._reported = {name: found for name, found in self._reported.items() if name in ready}
        known = self._reported.values()
        limits = {limit: min(found[limit] for found in known if limit in found)
                  for limit in LIMITS if any(limit in found for found in known)}
        by = sorted(n for n, found in self._reported.items() if found)
        self.state.show("limits", {"values": live_state.shown_limits(limits), "of": by})

    def on_answer(self, name: str, answer: rclpy.Future) -> None:
        if (response := answer.result()) is None:
            return
        channels, *limits = response.values or [ParameterValue()]
        if channels.string_array_value:
            self._channels = tuple(map(shown, channels.string_array_value[:_MOST_CHANNELS]))
            self.state.show("channels", self._channels)
        self._reported[name] = {
            key: float(value.double_value) for key, value in zip(LIMITS, limits, strict=False)
            if value.type == ParameterType.PARAMETER_DOUBLE and math.isfinite(value.double_value)}

    def on_reading(self, meaning: str, kind: str, message: Any) -> None:
        place, _, what = meaning.rpartition("/")
        reading = partial(self.state.reading, kind=kind, stamp=ros.seconds_of(message))
        if what == "temperature":
            reading("temperature", place, message.temperature + CELSIUS_ZERO)
        elif what == "range":
            reading("distance", place, message.range)
        elif what == "power":
            reading("voltage", place, message.voltage)
            reading("current", place, message.current)
        else:
            for joint, signals in JOINT_SIGNALS.items():
                for signal, field in signals.items():
                    values = dict(zip(message.name, getattr(message, field), strict=False))
                    if joint in values:
                        reading(signal, joint, values[joint])

    def on_command(self, message: Float64MultiArray) -> None:
        channels = self._channels
        if len(message.data) == len(channels):
            self._commanded = len(channels)
            for channel, volts in zip(channels, message.data, strict=True):
                self.state.reading("voltage", channel, volts, live_state.COMMANDED)

    def on_state(self, node: str, message: String) -> None:
        self.state.merge("states", {node: state_line(message.data)})
        if node == _RECORDER and (recorder := recorder_state(message.data)):
            self.state.show("recorded", shown(recorder["output"]))

    def on_progress(self, node: str, message: String) -> None:
        with suppress(InputError):  # the page shows the age of the last valid one
            progress = read_fields(message.data, _PROGRESS, f"{node}/progress")
            texts = {name: shown(progress[name]) for name in ("protocol", "step")}
            heard = self.state.clock()
            self.state.show("progress", {**progress, **texts, "node": node, "heard": heard})

    def on_result(self, node: str, message: String) -> None:
        self.state.show(node, live_state.result_summary(node, message.data))

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        heard, own = self.state.clock(), {}
        for status in message.status:
            if status.name.startswith(self._inside):
                level = dict(enumerate(_LEVELS)).get(status.level[0], "error")
                item = {"level": level, "message": shown(status.message), "heard": heard}
                own[shown(status.name.removeprefix(self._inside))] = item
        self.state.merge("diagnostics", own)


@contextmanager
def listening_node(namespace: str, state: LiveState, on_failure: Callable[[Exception], Any],
                   ros_arguments: Sequence[str] = ()) -> Iterator[DashboardNode]:
    """A node that listens in its own thread; `on_failure` is called there if it fails. Raises
    InputError: invalid namespace, or ROS refuses an argument."""
    ros.start_ros(ros_arguments)
    node, ended = DashboardNode(namespace, state), threading.Event()

    def spin() -> None:
        executor = ros.OneThreadExecutor()
        executor.add_node(node)
        try:
            while not ended.is_set():
                executor.spin_once(timeout_sec=_SPIN)
        except Exception as error:  # without this node the page would show old values
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
        with ros.end_of_ros():
            node.destroy_node()


def state_line(text: str) -> str:
    """A node's state as text; the recorder's is JSON."""
    if found := recorder_state(text):
        text = f"{found['state']}: {found['output']}, {sum(found['messages'].values())} messages"
    return shown(text)
