"""Runs a protocol on the bench and stops it at 0 V on a fault (`live.run`). If this process dies,
the command timeout of bridge or simulator sets the outputs to 0 V."""

import json
import time
from collections.abc import Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64, Float64MultiArray, String

from sma_bench.border import is_inside
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits, checked_feedback
from sma_bench.live.recording import BRIDGE, RECORDER, RUN_STATES, Readiness, recorder_failure
from sma_bench.live.run import ABORTED, IDLE, ClosedLoop, OpenLoop, Run, Surroundings
from sma_bench.nodes.base import DRIVER, BenchNode, be_punctual
from sma_bench.physics.boundary import moves_tip
from sma_bench.protocols import DEFLECTION, TEMPERATURE, TIP, Protocol, Quantity, is_path
from sma_bench.ros import node as ros

_FILES = frozenset({"protocol", "reference"})
_WATCH_EVERY = 0.05  # s
_SIMULATION_PAUSE = 10.0  # wall s that a loaded machine may pause a simulation: harmless there
_STEADY = 2.0  # s; while several benches start, readings may be late by a second or more


class ExperimentNode(BenchNode):
    """Runs one protocol at a time. A controller has another `loop` and the same safety rules."""

    called = "experiment"

    def __init__(self) -> None:
        super().__init__(self.called)
        settings, channels = self.settings, self.parameters["bench.channels"]
        self._bench_clock, pause = self.get_clock(), _SIMULATION_PAUSE
        if not self.simulated:
            be_punctual(DRIVER)
            self._bench_clock, pause = Clock(clock_type=ClockType.STEADY_TIME), 0.0
        self._feedback_timeout = max(settings["feedback_timeout"], pause)
        self._labelled = partial(ros.voltage_command, channels, signed=ros.signature(self))
        self._guard = Guard(channels, checked_feedback(settings["feedback"]),
                            self._feedback_timeout, aged=not self.simulated)
        self._readiness = Readiness(lambda: self.settings["require_recorder"])
        self._loop = self.loop()
        self.check_settings(settings)
        self._run = Run(self, self._loop, self._guard, self._readiness, len(channels),
                        settings["autostart"], self._feedback_timeout,
                        0.0 if self.simulated else _STEADY,
                        self.parameters["bench.command_timeout"])
        self._command = self.create_publisher(Float64MultiArray, ros.COMMAND, ros.READINGS)
        self.mark = self.line("experiment/marker")
        self._publish_state, self._publish_progress = self.line("~/state"), self.line("~/progress")
        self.listen(BatteryState, "power", self.on_power, newest=True)
        self.listen(Temperature, "temperature", self.on_temperature, newest=True)
        self._joint = TIP if moves_tip(self.parameters) else "wire"
        self.create_subscription(JointState, "joint_states", self.on_joints, ros.READINGS,
                                 newest=True)
        self._states = {BRIDGE, RECORDER, *RUN_STATES} - {f"{self.called}/state"}
        for topic in self._states:
            self.create_subscription(String, topic, partial(self.on_state, topic), ros.LATCHED)
        self.serve(start=lambda: self._run.start(time.monotonic(), self._plan),
                   stop=self._run.stop, reset=self._run.reset)
        self._ticked, period = 0, 1.0 / settings["command_rate"]
        self._period = round(period * ros.NANOSECONDS)
        if self.simulated:
            forward = JumpThreshold(min_forward=Duration(nanoseconds=1), min_backward=None,
                                    on_clock_change=False)
            clock = self._bench_clock
            self._leaps = clock.create_jump_callback(forward, post_callback=self._on_clock)
        else:
            self.create_timer(period, self._tick, clock=self._bench_clock)
        self.every(_WATCH_EVERY, lambda: self._run.watch(time.monotonic(), self._plan))
        self._run.enter(IDLE)
        if not settings["autostart"]:
            name = self.get_fully_qualified_name()
            self.get_logger().info(f"starts with {name}/start, or by itself: -p autostart:=true")

    def loop(self) -> OpenLoop:
        return OpenLoop()

    def held(self) -> Set[str]:
        """Always the bench's limits; during a run all contract parameters."""
        run: Run | None = getattr(self, "_run", None)  # ROS asks during construction, too
        everything = {*self._contract, "require_recorder"}
        driving = run is not None and run.running
        return everything if driving else {n for n in everything if n.startswith("bench.")}

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Accept only a protocol that can be loaded."""
        # The command line may name any file; a parameter set later only one inside the root.
        for name in _FILES & settings.keys():
            path, root = settings[name], settings["protocol_root"]
            is_new = path != self.settings[name] and is_path(path)
            if is_new and not is_inside(Path(path), Path(root or ".")):
                where = root or "where the node was started"
                raise InputError(f"{name}: {path} lies outside protocol_root ({where})")
        self._loop.plan(settings, self.parameters)

    def close(self) -> None:
        if self._run.state != IDLE:
            self._run.close()
            self.wait_for_listeners()

    def health(self) -> list[DiagnosticStatus]:
        run = self._run
        level = DiagnosticStatus.ERROR if run.state == ABORTED else DiagnosticStatus.OK
        several = ros.several_publishers(self, self._guard.known)
        return [self.status("run", level, run.state_text, {
            "protocol": run.protocol.name if run.protocol else "", "step": run.step,
            "obstacle": "" if run.running else run.obstacle(time.monotonic())}),
            *self.warnings(clocks=self._guard.doubt(), publishers=several)]

    def on_time_went_back(self, reason: str) -> None:
        """Steps and voltages would no longer fit the time."""
        if self._run.running:
            self._run.abort(reason)

    def on_state(self, topic: str, message: String) -> None:
        now = time.monotonic()
        if topic == RECORDER:
            self._guard.recorder(recorder_failure(message.data))
        self._readiness.state(topic, message.data, now)
        self._run.check(now)

    def on_power(self, channel: str, message: BatteryState) -> None:
        now, limits = time.monotonic(), Limits.from_parameters(self.parameters)
        taken = self.taken(message)
        self._guard.power(channel, message.voltage, message.current, taken, now, limits)
        self._run.check(now)  # the next reading may hide this one's fault

    def on_temperature(self, channel: str, message: Temperature) -> None:
        kelvin, taken = message.temperature + CELSIUS_ZERO, self.taken(message)
        now, limits = time.monotonic(), Limits.from_parameters(self.parameters)
        self._guard.temperature(channel, kelvin, taken, now, limits)
        self._run.heard("temperature", channel, kelvin, taken, now)
        self._run.check(now)

    def on_joints(self, message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=False)).get(self._joint)
        if position is not None:
            taken, now = self.taken(message), time.monotonic()
            self._run.heard("deflection", "", position, taken, now)

    def _on_clock(self, _: TimeJump) -> None:
        """Send one command per period of the simulated clock, as the bench waits for it. A timer of
        that clock would not do: EventsExecutor multiplies its calls when the clock jumps."""
        moment = self._bench_clock.now().nanoseconds
        since = moment - self._ticked
        if not 0 <= since < self._period:
            self._ticked = moment - max(since, 0) % self._period
            self._tick()

    def _tick(self) -> None:
        self._run.tick(time.monotonic(), self._bench_clock.now().nanoseconds / ros.NANOSECONDS)

    def _plan(self) -> Protocol:
        protocol = self._loop.plan(self.settings, self.parameters)
        if protocol.pulls:
            self.get_logger().warning(f"{protocol.name}: the load frame must pull as stated")
        self._loop.begin(self.settings, self.parameters)
        return protocol

    def surroundings(self) -> Surroundings:
        readings = map(self.resolve_topic_name, self._guard.wanted)
        return Surroundings(self._command.get_subscription_count() > 0,
                            ros.clock_fault(self),
                            {topic for topic in self._states if self.count_publishers(topic)},
                            lambda: [*{*ros.recorded_topics(self), *readings}])

    def send(self, voltage: list[float]) -> None:
        self._command.publish(self._labelled(voltage))

    def enter(self, state: str) -> None:
        self._publish_state(state)
        if state.startswith(ABORTED):  # two calls: rclpy allows one severity per line of code
            self.get_logger().error(state)
        else:
            self.get_logger().info(state)

    def show(self, progress: dict[str, Any]) -> None:
        self._publish_progress(json.dumps(progress))


class Controller(ExperimentNode):
    """Follows a reference of temperature or deflection under the same safety rules: from a file to
    its end, or from the topic `~/reference` until stopped (one number per channel, or a single one,
    in SI units less `zero`). `~/setpoint` is what it follows."""

    quantity: Quantity
    kind: type[Float64 | Float64MultiArray]
    zero = 0.0
    _loop: ClosedLoop

    def __init__(self) -> None:
        super().__init__()
        self._setpoint = self.create_publisher(self.kind, "~/setpoint", ros.READINGS)
        # Unlike readings a reference is sent once: reliable, none may be lost.
        self.create_subscription(self.kind, "~/reference", self.on_reference, QoSProfile(depth=10))

    def loop(self) -> ClosedLoop:
        return ClosedLoop(self.quantity, self.settings, self.parameters, self.follow)

    def follow(self, levels: Sequence[float]) -> None:
        """Publish the setpoint (SI)."""
        numbers = [level - self.zero for level in levels]
        self._setpoint.publish(self.kind(data=numbers[0] if self.kind is Float64 else numbers))

    def on_reference(self, message: Any) -> None:
        numbers = [message.data] if self.kind is Float64 else message.data
        levels = [number + self.zero for number in numbers]
        followed = self._run.protocol if self._run.running else None
        if fault := self._loop.ask(levels, followed, self.parameters):
            self.get_logger().warning(f"rejected: {fault}", throttle_duration_sec=1.0)


class TemperatureControllerNode(Controller):
    """Controls the wires' temperatures (E8): one PI per wire; degrees Celsius on the topics."""

    called, quantity = "temperature_controller", TEMPERATURE
    kind, zero = Float64MultiArray, CELSIUS_ZERO


class DeflectionControllerNode(Controller):
    """Controls the deflection: joint_states in, voltage_command out. It drives only with fresh
    deflections and fresh readings of the wires."""

    called, quantity, kind = "deflection_controller", DEFLECTION, Float64
