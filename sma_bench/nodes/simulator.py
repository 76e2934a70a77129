"""Stands in for the bench: same topics, types, rates and sensor noise as the hardware."""

import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CommandGate, Limits
from sma_bench.live.virtual_bench import NANOSECONDS, REAL_TIME, Lockstep, VirtualBench
from sma_bench.nodes.base import BenchNode
from sma_bench.nodes.bench_topics import BenchTopics
from sma_bench.ros.node import COMMAND, COMMANDED, Commanders, layout_fault

# A bench in real time answers a command within 10 ms, the period of its power readings.
_REAL_TIME_SLICE = 0.01
_SHORTEST_TICK = 0.002
# Slices in one callback, so that commands and services get their turn.
_SLICES_AT_ONCE = 8
_CLOCK_REPEAT = 0.05
_CLOCK_WATCH = 0.5
_CLOCK = "/clock"


class Simulator(BenchNode):
    """Simulated time runs in slices; commands are applied between two of them."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("simulator")
        limits = Limits.from_parameters(self.parameters)
        speed = self.settings["speed"]
        self._fast = speed > REAL_TIME
        if self._fast:
            # Two times on one topic would spoil the records of both benches without a word.
            try:
                self.claim(self.resolve_topic_name(_CLOCK))
            except InputError as error:
                reason = f"{error}; above real time each bench needs its own domain"
                raise InputError(reason) from None
            self._others: Subscription | None = None
            self.every(_CLOCK_WATCH, self._watch_clock)
        slice_length = 1.0 / self.settings["command_rate"] if self._fast else _REAL_TIME_SLICE
        self._slice = round(slice_length * NANOSECONDS)
        self._now = 0
        self._bench = VirtualBench(self.parameters, self.settings)
        self._epoch = time.time_ns()
        self._gate = CommandGate(len(self._bench.channels), limits)
        self._lockstep = Lockstep(
            slice_length, speed, limits.command_timeout, self.settings["lockstep_patience"]
        )
        self._topics = BenchTopics(self, self._bench.channels, self._bench.composite)
        self._clock_sent = 0.0
        self._clock_publisher = self.create_publisher(Clock, _CLOCK, 10) if self._fast else None
        self.create_subscription(Float64MultiArray, COMMAND, self._command, COMMANDED)
        self._commanders = Commanders(self)
        self.every(max(slice_length / speed, _SHORTEST_TICK), self._tick)
        self._reported = (0, self._topics.counts())
        channels = ", ".join(self._bench.channels)
        self.get_logger().info(f"simulating {channels}, {speed:g} s a second")

    def _watch_clock(self) -> None:
        # The graph still lists who was killed: only what is heard counts.
        if self._others is None and self.count_publishers(_CLOCK) > 1:
            self._others = self.create_subscription(Clock, _CLOCK, self._hear_clock, 10)

    def _hear_clock(self, message: Clock) -> None:
        time_ns = message.clock.sec * NANOSECONDS + message.clock.nanosec
        if (time_ns - self._epoch) % self._slice:  # no tick of this clock
            infos = self.get_publishers_info_by_topic(_CLOCK)
            names = {f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in infos}
            others = ", ".join(sorted(names - {self.get_fully_qualified_name()})) or "another node"
            self.fail(InputError(f"{_CLOCK} has a second publisher: {others}"))

    def _command(self, message: Float64MultiArray) -> None:
        now = self._now / NANOSECONDS
        sender, obstacle = self._commanders.of(message)
        fault = layout_fault(message, self._bench.channels)
        fault = fault or (obstacle if any(message.data) else "")
        reason = self._gate.refuse(fault) if fault else self._gate.command(
            message.data, now, sender)  # fmt: skip
        if reason:
            self.get_logger().warning(f"rejected: {reason}", throttle_duration_sec=1.0)
            return
        self._lockstep.commanded(now, time.monotonic())
        if self._fast:
            self._tick()

    def _tick(self) -> None:
        for _ in range(_SLICES_AT_ONCE):
            if not self._lockstep.may_advance(self._now / NANOSECONDS, time.monotonic()):
                break
            voltage = self._gate.outputs(self._now / NANOSECONDS)
            until = self._now + self._slice
            for reading in self._bench.advance(voltage, until):
                self._topics.publish(reading, self._epoch)
            self._now = until
            self._publish_clock()
        # /clock is best effort at its readers: a lost one must not stop the lockstep.
        if time.monotonic() - self._clock_sent > _CLOCK_REPEAT:
            self._publish_clock()

    def _publish_clock(self) -> None:
        if self._clock_publisher:
            self._clock_publisher.publish(Clock(clock=self.stamp()))
            self._clock_sent = time.monotonic()

    def health(self) -> list[DiagnosticStatus]:
        before, counts_before = self._reported
        counts = self._topics.counts()
        self._reported = (self._now, counts)
        elapsed = max(self._now - before, 1) / NANOSECONDS
        values = {
            "commander": self._gate.commander,
            "accepted_commands": self._gate.accepted,
            "rejected_commands": self._gate.rejected,
            "command_timeouts": self._gate.timeouts,
            "last_rejection": self._gate.last_rejection,
            "simulated_seconds": f"{self._now / NANOSECONDS:.3f}",
            "outputs": " ".join(f"{v:g}" for v in self._gate.outputs(self._now / NANOSECONDS)),
        }
        for kind, count in counts.items():
            values[f"{kind}_rate"] = f"{(count - counts_before[kind]) / elapsed:.1f}"
        level = DiagnosticStatus.WARN if self._gate.rejected else DiagnosticStatus.OK
        message = self._gate.last_rejection or "running"
        return [self.status("bench", level, message, values, "simulated bench")]

    def stamp(self) -> Time:
        """Simulated time: the node gives the clock and does not hear it."""
        seconds, rest = divmod(self._epoch + self._now, NANOSECONDS)
        return Time(sec=seconds, nanosec=rest)
