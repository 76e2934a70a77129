"""Runs the model alongside the bench on the measured voltages, and reports where they differ."""

import math
import time
from collections.abc import Set
from functools import cache

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.nodes.base import BenchNode
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.boundary import moves_tip
from sma_bench.ros.node import NAN, NANOSECONDS, READINGS, BenchTopics, stamp_of
from sma_bench.twin import twin
from sma_bench.twin.twin import Prediction, Residual, Twin

# Topics below `twin/` have the names, types and stamps of the bench's. A residual is measured minus
# predicted; fields without a residual are NaN.
PREDICTED, RESIDUAL, ENERGY = "twin/", "twin/residual/", "twin/energy/"
LIMITS = {"twin/low/": -1.0, "twin/high/": 1.0}  # times the tolerance of a bench without a gap
# Reliable if all present publishers are: a lost voltage makes a wrong prediction. A long queue, as
# players and fast simulations publish in bursts.
_OFFERED = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_AVAILABLE)
_STEP_EVERY, _SILENCE = 0.02, 2.0  # s


class TwinNode(BenchNode):
    """Only listens, never drives. Parameters, also of effects, may change while it runs."""

    with_uncertainty = True  # a diagnosis's file loads whole into the running node

    def __init__(self) -> None:
        super().__init__("twin")
        self._channels = self.parameters["bench.channels"]
        self._joint = "tip" if moves_tip(self.parameters) else "wire"
        self._moves = load_kind(self.parameters) != "clamped"  # then its position is compared
        # Publishers of a bench's topics below a prefix, created when first needed.
        self._below = cache(lambda below: BenchTopics(self, self._channels, self._channels,
                                                      joint=self._joint, below=below))
        self._below(PREDICTED)
        self._residual = self._below(RESIDUAL)
        self._energy = {stage: self.create_publisher(Float64, ENERGY + stage, READINGS)
                        for stage in twin.MEASURED_STAGES}
        twin.compile_model(self.parameters)
        self._twin = Twin(self.parameters, self.settings, self._predict, self._part)
        if self._twin.no_band:
            raise InputError(f"band: {self._twin.no_band}")
        self._loaded, self._judged, self._message = self.parameters, self._twin.verdict, ""
        self._heard, self._restarts = time.monotonic(), 0
        self.listen(BatteryState, "power", self.on_power, True, _OFFERED)
        self.listen(Temperature, "temperature", self.on_temperature, True, _OFFERED)
        self.create_subscription(JointState, "joint_states", self.on_joint, _OFFERED)
        self.serve(accept=self._accept)
        self.every(_STEP_EVERY, self._step)

    def held(self) -> Set[str]:
        return {"bench.channels", "bench.channel_sides"}

    def on_power(self, wire: int, message: BatteryState) -> None:
        self._heard = time.monotonic()
        self._twin.power(wire, stamp_of(message), message.voltage, message.current)

    def on_temperature(self, wire: int, message: Temperature) -> None:
        variance = message.variance if 0.0 < message.variance < math.inf else 0.0
        kelvin = message.temperature + CELSIUS_ZERO
        self._twin.temperature(wire, stamp_of(message), kelvin, math.sqrt(variance))

    def on_joint(self, message: JointState) -> None:
        if self._joint not in message.name:
            return
        k = list(message.name).index(self._joint)
        position = message.position[k] if k < len(message.position) else math.nan
        if self._moves:
            self._twin.mechanics(stamp_of(message), position)
        elif k < len(message.effort):
            elongation = 0.0 if math.isnan(position) else position
            self._twin.mechanics(stamp_of(message), message.effort[k], elongation)

    def _predict(self, found: Prediction) -> None:
        self._publish(PREDICTED, found)
        for below, share in LIMITS.items() if found.off else ():
            self._publish(below, found.moved(share))

    def _publish(self, below: str, found: Prediction) -> None:
        topics = self._below(below)
        for k, channel in enumerate(self._channels):
            topics.power(channel, found.voltage[k], found.current[k], found.stamp)
            topics.temperature(channel, found.temperature[k] - CELSIUS_ZERO, found.stamp)
        held = None if self._moves else found.mechanics
        topics.joint(found.stamp, found.mechanics if self._moves else 0.0, held)

    def _part(self, residual: Residual) -> None:
        value, stamp = residual.value, residual.stamp
        if residual.kind == twin.CURRENT:
            self._residual.power(self._channels[residual.wire], NAN, value, stamp)
        elif residual.kind == twin.TEMPERATURE:
            self._residual.temperature(self._channels[residual.wire], value, stamp)
        else:
            held = None if self._moves else value
            self._residual.joint(stamp, value if self._moves else NAN, held)

    def _step(self) -> None:
        if (before := self._loaded) is not self.parameters:
            self._loaded = self.parameters
            self._twin.tune(self.settings)
            if before != self.parameters:
                self._twin.change(self.parameters)
            if self._twin.no_band:
                self.get_logger().warning(f"no band: {self._twin.no_band}")
        self._twin.advance()
        if self._restarts != self._twin.restarts:
            self._restarts = self._twin.restarts
            self.get_logger().info(f"restarted: {self._twin.reason}")
        verdict = self._twin.verdict
        if verdict is not self._judged:
            self._judged = verdict
            for state in verdict.measured:
                if not math.isnan(state.energy):
                    self._energy[state.stage].publish(Float64(data=state.energy))
            if verdict.message != self._message and verdict.measured:
                self.diagnose()

    def _accept(self) -> str:
        self._twin.accept()
        return "the present gap is accepted; only an increase counts as grown"

    def health(self) -> list[DiagnosticStatus]:
        verdict, silence = self._twin.verdict, time.monotonic() - self._heard
        gap = verdict.state in (twin.GAP, twin.GREW)
        level, message = DiagnosticStatus.WARN if gap else DiagnosticStatus.OK, verdict.message
        if silence > _SILENCE:
            level, message = DiagnosticStatus.STALE, "no voltages"
        if message != self._message:
            # Two calls: rclpy allows one severity per line of code.
            if level == DiagnosticStatus.OK:
                self.get_logger().info(message)
            else:
                self.get_logger().warning(message)
            self._message = message
        lines = [self.status("gap", level, message, {
            "state": verdict.state, "stages": " ".join(verdict.stages),
            "sides": " ".join(verdict.sides), "model_time": f"{self._twin.stamp / NANOSECONDS:.3f}",
            "silence": f"{silence:.1f}", **self._twin.counts})]
        for state in verdict.measured:
            learned, named = not math.isnan(state.energy), state.stage in verdict.stages
            message = f"{state.gap:.1f} times the noise" if learned else "learning the noise"
            level = DiagnosticStatus.WARN if named else DiagnosticStatus.OK
            numbers = {"energy": f"{state.energy:.3g}", "gap_over_noise": f"{state.gap:.3g}"}
            lines.append(self.status(state.stage, level, message, numbers))
        return lines
