"""Writes every contract topic under its namespace to a bag that can be read whenever it dies."""

import importlib
import json
import time
from collections.abc import Callable, Sequence
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from sma_bench.errors import InputError
from sma_bench.nodes.base import LATCHED, BenchNode, run_node
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.contract import IMAGE, place_of

_LOOK_EVERY = 0.2
_FLUSH_EVERY = 1.0
# What may wait while the disk is busy: seconds of readings, but not of images.
_DEPTH = 5000
_IMAGE_DEPTH = 100
_DRAIN_AT_ONCE = 100
_LONGEST_DRAIN = 3.0
_LAST_WORD = 1.0


class Recorder(BenchNode):
    """Subscribes to what it finds in the graph and writes the bytes as they came."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("recorder")
        output = self.settings["output"] or time.strftime("record_%Y%m%d_%H%M%S")
        self._bag = BagWriter(output)
        self._messages: dict[str, int] = {}
        self._latest: dict[str, int] = {}
        self._state = self.create_publisher(String, "~/state", LATCHED)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_EVERY, self._look, clock=steady)
        self.create_timer(_FLUSH_EVERY, self._flush, clock=steady)
        self.get_logger().info(f"writing {self._bag.path}")
        self._look()
        self._publish_state("recording")

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
        self._guarded(self._bag.close)
        self._publish_state("failed" if self.failure else "closed")
        if not self.failure:
            count = sum(self._messages.values())
            self.get_logger().info(f"closed {self._bag.path}: {count} messages")
        # Listeners would otherwise miss how it ended.
        self._state.wait_for_all_acked(Duration(seconds=_LAST_WORD))

    def on_time_went_back(self, reason: str) -> None:
        """What would be written from now on could not be told from what is written already."""
        self.fail(InputError(f"{self._bag.path}: {reason}"))

    def _look(self) -> None:
        inside = self.get_namespace().rstrip("/") + "/"
        for topic, types in self.get_topic_names_and_types():
            place = place_of(topic)
            wanted = place is not None and topic.startswith(inside) and place.type in types
            if wanted and topic not in self._messages and self.count_publishers(topic):
                self._subscribe(topic, place.type)

    def _subscribe(self, topic: str, type_name: str) -> None:
        if not self._guarded(self._bag.add_topic, topic, type_name):
            return
        self._messages[topic] = 0
        self.create_subscription(
            _message_class(type_name), topic, partial(self._write, topic),
            self._matching_qos(topic, type_name), raw=True,
        )
        self.get_logger().info(f"recording {topic}")
        self._publish_state("recording")

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
        if self._guarded(self._bag.write, topic, stamp, data):
            self._messages[topic] += 1

    def _guarded(self, action: Callable[..., None], *arguments: object) -> bool:
        """Whether the disk took it; if not, the node ends with the disk's line."""
        try:
            action(*arguments)
        except InputError as error:
            self.fail(error)
        return self.failure is None

    def _flush(self) -> None:
        self._guarded(self._bag.flush)
        self._publish_state("failed" if self.failure else "recording")

    def _publish_state(self, state: str) -> None:
        self._state.publish(String(data=json.dumps({
            "state": state,
            "output": str(self._bag.path),
            "failure": str(self.failure or ""),
            "messages": self._messages,
        })))


def _message_class(type_name: str) -> type:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("recorder", Recorder, argv)


if __name__ == "__main__":
    raise SystemExit(main())
