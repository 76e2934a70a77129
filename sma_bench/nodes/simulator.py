"""The simulated bench: same topics, types, rates and sensor noise as the hardware.

In real time it catches up with the wall clock every 10 ms. Faster than that (`speed` above 1) it
publishes /clock and advances one command period after the other, in lockstep with the commands."""

import time
from collections import Counter

from builtin_interfaces.msg import Time as TimeMessage
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.subscription import Subscription
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray

from sma_bench.border import claimed
from sma_bench.errors import InputError
from sma_bench.hardware.bench_sensors import SIDES
from sma_bench.hardware.safety import CommandGate, Limits
from sma_bench.live.virtual_bench import REAL_TIME, STANDS, GroupReading, Lockstep, VirtualBench
from sma_bench.nodes.base import BRIDGE, BenchNode, be_punctual
from sma_bench.parameters.parameters import load_kind
from sma_bench.ros import node as ros

_SHORTEST_TICK, _REAL_TIME_SLICE = 0.002, 0.01  # s; the latter: period of the fastest readings
_SLICES_AT_ONCE = 8  # per callback, so that commands and services get their turn
_MOST_CAUGHT_UP = 1000  # slices run before a command in real time, if the machine was late
_CLOCK_REPEAT, _CLOCK_WATCH = 0.05, 0.5  # s


class SimulatedClock:
    """/clock of a bench. Two on one topic would spoil the records of both benches unnoticed: a
    second one of this package does not start, any other ends the node."""

    def __init__(self, node: BenchNode, tick: int) -> None:
        """`tick` ns: each published time is a multiple of it after the first."""
        try:
            node.claims.append(claimed(node.resolve_topic_name(ros.CLOCK)))
        except InputError as error:
            reason = f"{error}; above real time each bench needs its own domain"
            raise InputError(reason) from None
        self._node, self._tick, self._sent, self._last = node, tick, 0.0, 0
        self._others: Subscription | None = None
        self._publisher = node.create_publisher(Clock, ros.CLOCK, ros.READINGS)
        node.every(_CLOCK_WATCH, self._watch)

    def publish(self, now: int) -> None:
        """Publish the time (ns), also the same again: subscribers read it best effort, and a lost
        one must not stop the lockstep."""
        wall = time.monotonic()
        if now != self._last or wall - self._sent > _CLOCK_REPEAT:
            self._publisher.publish(Clock(clock=Time(nanoseconds=now).to_msg()))
            self._last, self._sent = now, wall

    def _watch(self) -> None:
        # The graph still lists killed nodes: only a received clock counts.
        if self._others is None and self._node.count_publishers(ros.CLOCK) > 1:
            what = Clock, ros.CLOCK, self.on_clock, ros.READINGS
            self._others = self._node.create_subscription(*what)

    def on_clock(self, message: Clock) -> None:
        heard = message.clock.sec * ros.NANOSECONDS + message.clock.nanosec
        if (heard - self._last) % self._tick:
            several = ros.several_publishers(self._node, [ros.CLOCK])
            self._node.fail(InputError(several or f"{ros.CLOCK} had a second publisher"))


class Simulator(BenchNode):
    """See the module; `_now` is simulated time."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("simulator")
        limits, speed = Limits.from_parameters(self.parameters), self.settings["speed"]
        self._fast = speed > REAL_TIME
        slice_length = 1.0 / self.settings["command_rate"] if self._fast else _REAL_TIME_SLICE
        self._slice = round(slice_length * ros.NANOSECONDS)
        self._own_clock = SimulatedClock(self, self._slice) if self._fast else None
        self._now, self._epoch, self._begun = 0, time.time_ns(), 0  # ns: simulated; wall, monotonic
        self._bench = VirtualBench(self.parameters, self.settings)
        if not self._fast:  # the real device is never late
            be_punctual(BRIDGE)
        channels, composite = self._bench.channels, self._bench.composite
        self._topics = ros.BenchTopics(self, channels, (*channels, "ambient"),
                                   SIDES if composite else (), "tip" if composite else "wire")
        self.claims.append(ros.claim_readings(self, channels[0]))
        self._counts = Counter({"power": 0, "temperature": 0, "mechanics": 0, "ambient": 0})
        self._reported = 0, self._counts.copy()
        self._gate = CommandGate(len(channels), limits)
        self._lockstep = Lockstep(slice_length, speed, limits.command_timeout,
                                  self.settings["lockstep_patience"])
        self._commanders = ros.Commanders(self)
        self.create_subscription(Float64MultiArray, ros.COMMAND, self.on_command, ros.READINGS)
        self.every(max(slice_length / speed, _SHORTEST_TICK), self._tick)
        self.get_logger().info(f"simulating {', '.join(channels)}, {speed:g} s a second")
        if load_kind(self.parameters) == "displacement":
            self.get_logger().warning(f"load.kind displacement: {STANDS}")

    def on_command(self, message: Float64MultiArray) -> None:
        sender, fault = self._commanders.judge(message, self._bench.channels)
        if not self._fast:  # catch up first: effects of a command must be stamped after it
            self._tick(_MOST_CAUGHT_UP)
        now, gate = self._now / ros.NANOSECONDS, self._gate
        if reason := gate.refuse(fault) if fault else gate.command(message.data, now, sender):
            self.get_logger().warning(f"rejected: {reason}", throttle_duration_sec=1.0)
            return
        self._lockstep.commanded(now, time.monotonic())
        if self._fast:
            self._tick()

    def _tick(self, slices: int = _SLICES_AT_ONCE) -> None:
        if not self._begun:  # time begins with the first tick, not with the construction
            self._epoch, self._begun = time.time_ns(), time.monotonic_ns()
        wall = time.monotonic_ns() - self._begun
        for _ in range(slices):
            until = min(self._now + self._slice, wall)
            if self._fast:
                advances = self._lockstep.may_advance(self._now / ros.NANOSECONDS, time.monotonic())
                until = self._now + advances * self._slice
            if until <= self._now:
                break
            outputs = self._gate.outputs(self._now / ros.NANOSECONDS)
            for reading in self._bench.advance(outputs, until):
                self._publish(reading)
            self._now = until
            self._publish_clock()
        self._publish_clock()

    def _publish(self, reading: GroupReading) -> None:
        kind, values, stamp = reading.kind, reading.values, self._epoch + reading.time
        self._counts[kind] += 1
        if kind == "power":
            for channel, (volt, ampere) in zip(self._bench.channels, values, strict=True):
                self._topics.power(channel, volt, ampere, stamp)
        elif kind != "mechanics":
            places = self._bench.channels if kind == "temperature" else ("ambient",)
            for place, celsius in zip(places, values, strict=True):
                self._topics.temperature(place, celsius, stamp)
        elif self._bench.composite:
            for side, distance in zip(SIDES, values, strict=True):
                self._topics.range(side, distance, stamp)
            self._topics.joint(stamp, (values[1] - values[0]) / 2.0)
        else:
            self._topics.joint(stamp, *values)

    def _publish_clock(self) -> None:
        if self._own_clock:
            self._own_clock.publish(self._epoch + self._now)

    def stamp(self) -> TimeMessage:
        """Simulated time: this node publishes the clock and does not subscribe to it."""
        return Time(nanoseconds=self._epoch + self._now).to_msg()

    def health(self) -> list[DiagnosticStatus]:
        gate, now, (before, counts) = self._gate, self._now / ros.NANOSECONDS, self._reported
        elapsed = max(self._now - before, 1) / ros.NANOSECONDS
        self._reported = self._now, self._counts.copy()
        values = {**gate.diagnostics(now), "simulated_seconds": f"{now:.3f}",
                  **{f"{kind}_rate": f"{(count - counts[kind]) / elapsed:.1f}"
                     for kind, count in self._counts.items()}}
        level = DiagnosticStatus.WARN if gate.rejected else DiagnosticStatus.OK
        message = gate.last_rejection or "running"
        return [self.status("bench", level, message, values, "simulated bench")]
