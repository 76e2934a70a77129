"""Records every contract topic of its namespace to a bag that stays readable if it is killed."""

import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from sma_bench.errors import InputError
from sma_bench.live.recording import FAILED, RECORDING, Recording
from sma_bench.nodes.base import BenchNode
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.contract import IMAGE
from sma_bench.ros.node import clock_fault, message_class, recorded_topics, several_publishers

_LOOK_EVERY, _FLUSH_EVERY = 0.2, 1.0  # s
_DEPTH, _IMAGE_DEPTH = 5000, 100  # messages that may wait for the disk: some seconds of readings
_EMPTY_SPINS = 10  # more than there are timers and clocks to be served between readings
_LONGEST_DRAIN = 3.0  # s
_IN_TRANSIT = 0.5  # s, more than twice the time to a retransmission (config/dds/this_machine.xml)
_NAP, _NEARLY_FULL = 0.001, 1 << 30  # s; free bytes


class Recorder(BenchNode):
    """Subscribes to the topics in the graph and writes the serialized messages; records from its
    start, or `~/start`, to `~/stop` or its end, each time into a new bag."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._recording = Recording(
            os.path.expanduser(self.settings["output"]),  # no shell does it after `output:=`
            lambda: (self.settings["skip_idle"], self.settings["idle_margin"]),
            self.fail, BagWriter)
        self._state, self._publish = "idle", self.line("~/state")
        self.every(_LOOK_EVERY, self._look)
        self.every(_FLUSH_EVERY, self._flush)
        self.serve(start=self._start, stop=self._stop, split=self._split)
        self._begin(self._recording.next_output())

    def health(self) -> list[DiagnosticStatus]:
        recording = self._recording
        values: dict[str, Any] = {"output": recording.output, "messages": recording.total}
        level, message = DiagnosticStatus.OK, self._state
        with suppress(OSError):
            values["free_bytes"] = shutil.disk_usage(Path(recording.output or ".").parent).free
            if values["free_bytes"] < _NEARLY_FULL:
                level, message = DiagnosticStatus.WARN, f"{message}; the disk is nearly full"
        readings = [t for t in recording.topics if t.endswith(("/power", "/temperature", "/range"))]
        if self.failure:
            level, message = DiagnosticStatus.ERROR, str(self.failure)
        return [self.status("bag", level, message, values), *self.warnings(
            clock=clock_fault(self), publishers=several_publishers(self, readings))]

    def drain(self, spin: Callable[[], None]) -> None:
        # Spins without a message end it: a bench that still publishes pauses between readings, too.
        begin, elapsed, empty = time.monotonic(), 0.0, 0
        while elapsed < _IN_TRANSIT or (elapsed < _LONGEST_DRAIN and empty < _EMPTY_SPINS):
            written = self._recording.total
            spin()
            empty = empty + 1 if self._recording.total == written else 0
            if empty and elapsed < _IN_TRANSIT:
                time.sleep(_NAP)
            elapsed = time.monotonic() - begin

    def close(self) -> None:
        self._finish()
        self._publish_state(FAILED if self.failure else "closed")
        self.diagnose()
        self.wait_for_listeners()

    def on_time_went_back(self, reason: str) -> None:
        """Later messages would get stamps before those of messages already written."""
        self._recording.fail(InputError(f"{self._recording.output or 'recorder'}: {reason}"))

    def _begin(self, output: str) -> None:
        self._recording.begin(output)
        self.get_logger().info(f"writing {self._recording.output}")
        self._look()
        self._publish_state(RECORDING)

    def _finish(self) -> None:
        recording = self._recording
        if recording.finish():
            self.get_logger().info(f"closed {recording.output}: {recording.total} messages")

    def _start(self) -> str:
        if self._recording.open:
            raise InputError("is recording already")
        self._begin(self._recording.next_output())
        return f"recording {self._recording.output}"

    def _stop(self) -> str:
        if not self._recording.open:
            raise InputError("is not recording")
        self._finish()
        self._publish_state(FAILED if self.failure else "idle")
        return f"closed {self._recording.output}"

    def _split(self) -> str:
        if not self._recording.open:
            raise InputError("is not recording")
        closed, output = self._recording.output, self._recording.next_output()
        self._finish()
        try:
            self._begin(output)
        except InputError:
            self._publish_state(FAILED if self.failure else "idle")
            raise
        return f"closed {closed}, recording {output}"

    def _look(self) -> None:
        for topic, kind in recorded_topics(self).items():
            if topic in self._recording.topics or not self._recording.add(topic, kind):
                continue
            # The best QoS that all present publishers of the topic offer.
            qos = QoSProfile(depth=_IMAGE_DEPTH if kind == IMAGE else _DEPTH,
                             reliability=ReliabilityPolicy.BEST_AVAILABLE,
                             durability=DurabilityPolicy.BEST_AVAILABLE)
            heard = partial(self._write, topic)
            self.create_subscription(message_class(kind), topic, heard, qos, raw=True)
            self.get_logger().info(f"recording {topic}")
            self._publish_state()

    def _write(self, topic: str, data: bytes) -> None:
        stamp = self.get_clock().now().nanoseconds
        if stamp == 0:  # simulated time has not begun: the message would have no time
            line = "use_sim_time is set, but there is no /clock yet: nothing is written"
            self.get_logger().warning(line, throttle_duration_sec=1.0)
            return
        self._recording.write(topic, stamp, data,
                              lambda data: str(deserialize_message(data, String).data))

    def _flush(self) -> None:
        self._recording.flush()
        self._publish_state()

    def _publish_state(self, state: str = "") -> None:
        """Publish a new state, or the last one again."""
        self._state = state or (FAILED if self.failure else self._state)
        self._publish(self._recording.state(self._state))
