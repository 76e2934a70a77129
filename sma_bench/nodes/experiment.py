"""Runs a protocol on the bench, and stops it at 0 V when something is wrong (`live.run`).

Should it die without a word, the command timeout of the bridge or the simulator puts the outputs
to 0 V.
"""

import json
import time
from collections.abc import Set
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64MultiArray, String

from sma_bench.border import is_inside
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.live.recording import BRIDGE, RECORDER, Beside
from sma_bench.live.run import ABORTED, IDLE, OpenLoop, Run, Surroundings
from sma_bench.nodes.base import DRIVER, BenchNode, be_punctual
from sma_bench.nodes.bench_topics import follow_recorder
from sma_bench.physics.boundary import moves_tip
from sma_bench.protocols import Protocol
from sma_bench.protocols.reading import TIP, is_path
from sma_bench.records.contract import place_of
from sma_bench.ros.node import COMMAND, LATCHED, MEASURED, NEWEST, signature, voltage_command

_FILES = frozenset({"protocol", "reference"})
_FEEDBACK = ("power", "temperature")
_WATCH_EVERY = 0.05
# Wall seconds for which readings of a simulation may stay away: a loaded machine may pause it, and
# nothing is heated meanwhile.
_SIMULATION_PAUSE = 10.0
_LAST_WORD = 0.5


class ExperimentNode(BenchNode):
    """One protocol at a time; a controller, driving under the same rules, has another `loop`."""

    def __init__(self, name: str = "experiment") -> None:
        super().__init__(name)
        for kind in self.settings["feedback"]:
            if kind not in _FEEDBACK:
                raise InputError(f"feedback: {kind!r}, expected {' or '.join(_FEEDBACK)}")
        simulated = self.get_parameter("use_sim_time").value
        if not simulated:
            be_punctual(DRIVER)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._bench_clock = self.get_clock() if simulated else steady
        channels = self.parameters["bench.channels"]
        self._labelled = partial(voltage_command, channels, signed=signature(self))
        patience = _SIMULATION_PAUSE if simulated else 0.0
        self._feedback_timeout = max(self.settings["feedback_timeout"], patience)
        self._guard = Guard(channels, self.settings["feedback"], self._feedback_timeout)
        self._beside = Beside(self.settings["require_recorder"])
        self._loop = self.loop()
        self.check_settings(self.settings)
        self._run = Run(
            self, self._loop, self._guard, self._beside, len(channels),
            self.settings["autostart"], self._feedback_timeout,
        )
        self._command = self.create_publisher(Float64MultiArray, COMMAND, MEASURED)
        self._marker = self.create_publisher(String, "experiment/marker", LATCHED)
        self._state_publisher = self.create_publisher(String, "~/state", LATCHED)
        self._progress = self.create_publisher(String, "~/progress", LATCHED)
        self.listen(BatteryState, "power", self._on_power, NEWEST)
        self.listen(Temperature, "temperature", self._on_temperature, NEWEST)
        self._joint = TIP if moves_tip(self.parameters) else "wire"
        self.create_subscription(JointState, "joint_states", self._on_joints, NEWEST)
        follow_recorder(self, self._guard.recorder)
        self.create_subscription(String, BRIDGE, self._on_bridge, LATCHED)
        self.create_subscription(
            String, RECORDER, lambda m: self._beside.recorder(m.data, time.monotonic()), LATCHED
        )
        self.serve(
            start=lambda: self._run.start(time.monotonic(), self._plan),
            stop=self._run.stop, reset=self._run.reset,
        )  # fmt: skip
        self._ticked = -1
        self._ticks = self.create_timer(
            1.0 / self.settings["command_rate"], self._tick, clock=self._bench_clock
        )
        self.every(_WATCH_EVERY, lambda: self._run.watch(time.monotonic(), self._plan))
        self._run.enter(IDLE)
        if not self.settings["autostart"]:
            name = self.get_fully_qualified_name()
            self.get_logger().info(f"starts with {name}/start, or by itself: -p autostart:=true")

    def loop(self) -> OpenLoop:
        return OpenLoop()

    def held(self) -> Set[str]:
        """The limits always, everything that is said of the bench while it is driven."""
        run: Run | None = getattr(self, "_run", None)  # ROS asks while the node is made, too
        driving = run is not None and run.running
        return {name for name in self._contract if driving or name.startswith("bench.")}

    def check_settings(self, settings: dict[str, Any]) -> None:
        """A protocol must be readable before it becomes the parameter's value."""
        # Whoever started the node may have named any file, whoever sets parameters may not.
        for name in _FILES & settings.keys():
            path, root = settings[name], settings["protocol_root"]
            if path == self.settings[name] or not is_path(path):
                continue
            if not is_inside(Path(path), Path(root or ".")):
                where = root or "where the node was started"
                raise InputError(f"{name}: {path} lies outside protocol_root ({where})")
        self._loop.plan(settings, self.parameters)

    def close(self) -> None:
        if self._run.state == IDLE:
            return
        self._run.close()
        end = time.monotonic() + _LAST_WORD
        for publisher in (self._command, self._marker, self._state_publisher):
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))

    def health(self) -> list[DiagnosticStatus]:
        run = self._run
        level = DiagnosticStatus.ERROR if run.state == ABORTED else DiagnosticStatus.OK
        return [self.status("run", level, run.said, {
            "protocol": run.protocol.name if run.protocol else "", "step": run.step,
            "obstacle": "" if run.running else run.obstacle(time.monotonic()),
        })]  # fmt: skip

    def on_time_went_back(self, reason: str) -> None:
        """No step and no volt would be that of its time."""
        if self._run.running:
            self._run.abort(reason)

    # --- messages in --------------------------------------------------------------------------

    def _on_bridge(self, message: String) -> None:
        self._beside.bridge(message.data)
        self._run.check(time.monotonic())

    def _on_power(self, channel: str, message: BatteryState) -> None:
        self._guard.power(
            channel, message.voltage, message.current, seconds(message), time.monotonic(),
            Limits.from_parameters(self.parameters),
        )

    def _on_temperature(self, channel: str, message: Temperature) -> None:
        kelvin, stamp, now = message.temperature + CELSIUS_ZERO, seconds(message), time.monotonic()
        limits = Limits.from_parameters(self.parameters)
        self._guard.temperature(channel, kelvin, stamp, now, limits)
        self._run.heard("temperature", channel, kelvin, stamp, now)

    def _on_joints(self, message: JointState) -> None:
        if self._joint not in message.name:
            return
        index = message.name.index(self._joint)
        if index < len(message.position):
            self.measured(message.position[index], seconds(message), time.monotonic())

    def measured(self, deflection: float, stamp: float, now: float) -> None:
        """A deflection or elongation in m, acquired at `stamp` s."""
        self._run.heard("deflection", "", deflection, stamp, now)

    def _tick(self) -> None:
        """One command for each moment of the bench. A simulated clock that leaps twice before the
        executor comes calls its timer twice, of which the second is the call of the next moment: a
        bench that waits for that moment's command would never get it."""
        moment = self._bench_clock.now().nanoseconds
        if moment == self._ticked:
            self._ticks.reset()
            return
        self._ticked = moment
        self._run.tick(time.monotonic(), moment / 1e9)

    def _plan(self) -> Protocol:
        """What is followed, from the parameters of the moment."""
        protocol = self._loop.plan(self.settings, self.parameters)
        if protocol.pulls:
            self.get_logger().warning(f"{protocol.name}: the frame has to pull as its steps say")
        self._loop.begin(self.settings, self.parameters)
        return protocol

    # --- messages out (live.run.Outputs) ------------------------------------------------------

    def surroundings(self) -> Surroundings:
        return Surroundings(
            self._command.get_subscription_count() > 0, self._bench_clock.now().nanoseconds > 0,
            {name for name in (BRIDGE, RECORDER) if self.count_publishers(name)}, self._published,
        )

    def send(self, voltage: list[float]) -> None:
        self._command.publish(self._labelled(voltage))

    def mark(self, step: str) -> None:
        self._marker.publish(String(data=step))

    def enter(self, state: str) -> None:
        self._state_publisher.publish(String(data=state))
        if state.startswith(ABORTED):
            self.get_logger().error(state)
        else:
            self.get_logger().info(state)

    def show(self, progress: dict[str, Any]) -> None:
        self._progress.publish(String(data=json.dumps(progress)))

    def _published(self) -> list[str]:
        inside = self.get_namespace().rstrip("/") + "/"
        return [
            topic for topic, types in self.get_topic_names_and_types()
            if (place := place_of(topic)) and topic.startswith(inside) and place.type in types
            and self.count_publishers(topic)
        ]  # fmt: skip


def seconds(message: BatteryState | Temperature | JointState) -> float:
    """Acquisition stamp in s."""
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9
