"""Writes every contract topic under its namespace to a bag that can be read whenever it dies."""

import importlib
import json
import shutil
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, count
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import LATCHED, run_node
from sma_bench.nodes.managed_node import ACTIVE, ManagedNode
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.contract import IMAGE, STRING, place_of

_LOOK_EVERY = 0.2
_FLUSH_EVERY = 1.0
# What may wait while the disk is busy: seconds of readings, but not of images.
_DEPTH = 5000
_IMAGE_DEPTH = 100
_DRAIN_AT_ONCE = 100
_LONGEST_DRAIN = 3.0
_LAST_WORD = 1.0
_LITTLE = 1 << 30  # bytes
_STATE, _RUNNING = "/state", "running"
_RUN_STATES = {
    name + _STATE for name in ("experiment", "temperature_controller", "deflection_controller")
}


class Recorder(ManagedNode):
    """Subscribes to what it finds in the graph and writes the bytes as they came.

    `active` records: `~/start` and `~/stop` are the same as a lifecycle manager's way there and
    back. Every recording is a bag of its own.
    """

    frozen = True

    def __init__(self) -> None:
        super().__init__("recorder")
        self._bag: BagWriter | None = None
        self._output, self._said, self._closed_at = "", "idle", 0.0
        self._topics: dict[str, str] = {}
        self._runs: dict[str, bool] = {}
        self._kept: deque[tuple[str, int, bytes]] = deque()
        self._messages: dict[str, int] = {}
        self._latest: dict[str, int] = {}
        self._state = self.create_publisher(String, "~/state", LATCHED)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_EVERY, self._look, clock=steady)
        self.create_timer(_FLUSH_EVERY, self._flush, clock=steady)
        for name, act in {
            "start": self._start, "stop": self._stop, "split": self._split,
        }.items():
            self.create_service(Trigger, f"~/{name}", partial(self._answer, act))
        self._publish_state("idle")
        self.start_by_itself()

    def activate(self) -> None:
        """Begin a bag."""
        self._begin(self._next_output())

    def deactivate(self) -> None:
        """Finish the bag with its index."""
        self._finish()
        self._publish_state("failed" if self.failure else "idle")

    def health(self) -> list[DiagnosticStatus]:
        """What is written, and how much room the disk has."""
        values = {"output": self._output, "messages": sum(self._messages.values())}
        level, message = DiagnosticStatus.OK, self._said
        with suppress(OSError):
            values["free_bytes"] = shutil.disk_usage(Path(self._output or ".").parent).free
            if values["free_bytes"] < _LITTLE:
                level, message = DiagnosticStatus.WARN, f"{message}; the disk is nearly full"
        if self.failure:
            level, message = DiagnosticStatus.ERROR, str(self.failure)
        return [self.status("bag", level, message, values)]

    def drain(self, spin: Callable[[], None]) -> None:
        """Write what was sent before the end was asked for and still waits in the queues."""
        end = time.monotonic() + _LONGEST_DRAIN
        written = -1
        while written != sum(self._messages.values()) and time.monotonic() < end:
            written = sum(self._messages.values())
            for _ in range(_DRAIN_AT_ONCE):
                spin()

    def close(self) -> None:
        """Finish the bag with its index."""
        self._finish()
        self._publish_state("failed" if self.failure else "closed")
        self.diagnose()
        # Listeners would otherwise miss how it ended.
        for publisher in (self._state, self._diagnostics):
            publisher.wait_for_all_acked(Duration(seconds=_LAST_WORD))

    def on_time_went_back(self, reason: str) -> None:
        """What would be written from now on could not be told from what is written already."""
        self.fail(InputError(f"{self._output or 'recorder'}: {reason}"))

    # --- bags ---------------------------------------------------------------------------------

    def _next_output(self) -> str:
        """The parameter's, then the same with a number; it must not exist."""
        first = self.settings["output"] or time.strftime("record_%Y%m%d_%H%M%S")
        if not self._output and self.settings["output"]:
            return str(first)
        names = chain([first], (f"{first}_{k}" for k in count(2)))
        return str(next(name for name in names if not Path(name).exists()))

    def _begin(self, output: str) -> None:
        self._bag = BagWriter(output)
        self._output = str(self._bag.path)
        self._messages, self._latest = {}, {}
        for topic, type_name in self._topics.items():
            self._add(topic, type_name)
        self.get_logger().info(f"writing {self._output}")
        self._look()
        self._publish_state("recording")

    def _finish(self) -> None:
        if self._bag is None:
            return
        self._guarded(self._bag.close)
        self._bag = None
        if not self.failure:
            total = sum(self._messages.values())
            self.get_logger().info(f"closed {self._output}: {total} messages")

    def _start(self) -> str:
        self.require(self.trigger_activate)
        return f"recording {self._output}"

    def _stop(self) -> str:
        self.require(self.trigger_deactivate)
        return f"closed {self._output}"

    def _split(self) -> str:
        if self.stage != ACTIVE:
            raise InputError("is not recording")
        closed, output = self._output, self._next_output()
        self._finish()
        try:
            self._begin(output)
        except InputError:
            self.trigger_deactivate()
            raise
        return f"closed {closed}, recording {output}"

    def _answer(
        self, act: Callable[[], str], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message, response.success = act(), True
        except InputError as error:
            response.message, response.success = str(error), False
        return response

    # --- topics -------------------------------------------------------------------------------

    def _look(self) -> None:
        inside = self.get_namespace().rstrip("/") + "/"
        for topic, types in self.get_topic_names_and_types():
            kind = _recorded_type(topic, inside)
            if kind in types and topic not in self._topics and self.count_publishers(topic):
                self._subscribe(topic, kind)

    def _add(self, topic: str, type_name: str) -> bool:
        if self._bag is None:
            return True
        self._messages[topic] = 0
        return self._guarded(self._bag.add_topic, topic, type_name)

    def _subscribe(self, topic: str, type_name: str) -> None:
        self._topics[topic] = type_name
        if not self._add(topic, type_name):
            return
        self.create_subscription(
            _message_class(type_name), topic, partial(self._write, topic),
            self._matching_qos(topic, type_name), raw=True,
        )
        self.get_logger().info(f"recording {topic}")
        self._publish_state(self._said)

    def _matching_qos(self, topic: str, type_name: str) -> QoSProfile:
        """The most that every present publisher of the topic offers."""
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
        latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
        return QoSProfile(
            depth=_IMAGE_DEPTH if type_name == IMAGE else _DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            ),
        )

    def _write(self, topic: str, data: bytes) -> None:
        stamp = self.get_clock().now().nanoseconds
        if stamp == 0:  # simulated time has not begun: there is no time to write it under
            line = "use_sim_time is set, but there is no /clock yet: nothing is written"
            self.get_logger().warning(line, throttle_duration_sec=1.0)
            return
        # A simulated clock ticks coarsely: two messages of one tick keep their order.
        stamp = self._latest[topic] = max(stamp, self._latest.get(topic, 0) + 1)
        if topic.endswith(_STATE):
            self._runs[topic] = deserialize_message(data, String).data.startswith(_RUNNING)
        if self._bag is None:
            return
        self._kept.append((topic, stamp, data))
        margin = round(self.settings["idle_margin"] * 1e9)
        if any(self._runs.values()) or not self.settings["skip_idle"]:
            self._closed_at = stamp + margin
        if stamp > self._closed_at:  # nothing runs: the last seconds wait for a run that begins
            while self._kept[0][1] < stamp - margin:
                self._kept.popleft()
            return
        while self._kept:
            kept = self._kept.popleft()
            if self._guarded(self._bag.write, *kept):
                self._messages[kept[0]] += 1

    def _guarded(self, action: Callable[..., None], *arguments: object) -> bool:
        """Whether the disk took it; if not, the node ends with the disk's line."""
        try:
            action(*arguments)
        except InputError as error:
            self.fail(error)
        return self.failure is None

    def _flush(self) -> None:
        if self._bag is not None:
            self._guarded(self._bag.flush)
        self._publish_state("failed" if self.failure else self._said)

    def _publish_state(self, state: str) -> None:
        self._said = state
        self._state.publish(String(data=json.dumps({
            "state": state,
            "output": self._output,
            "failure": str(self.failure or ""),
            "messages": self._messages,
        })))


def _recorded_type(topic: str, inside: str) -> str:
    """Type of a topic that belongs into a bag of the bench below `inside`, "" for another one."""
    if topic == "/diagnostics":
        return "diagnostic_msgs/msg/DiagnosticArray"
    if not topic.startswith(inside):
        return ""
    if topic.removeprefix(inside) in _RUN_STATES:
        return STRING
    place = place_of(topic)
    return place.type if place else ""


def _message_class(type_name: str) -> type:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("recorder", Recorder, argv)


if __name__ == "__main__":
    raise SystemExit(main())
