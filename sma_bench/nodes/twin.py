"""Runs the model beside the bench on the measured voltages, and says where the two part."""

import math
import time
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64

from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.nodes.base import BenchNode
from sma_bench.nodes.bench_topics import NAN, power_message, send, temperature_message
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.boundary import moves_tip
from sma_bench.ros.node import MEASURED
from sma_bench.twin import Twin, compile_model
from sma_bench.twin.twin import (
    CURRENT,
    GAP,
    GREW,
    MEASURED_STAGES,
    NANOSECONDS,
    TEMPERATURE,
    Prediction,
    Residual,
    Verdict,
)

# --- What the twin says as messages, below `twin/`: predictions, residuals, energies by stage.
#
# Topics are called as those of the bench that they stand beside, and have their types and stamps.
# A residual is measured less predicted; what is not part of it is NaN.

PREDICTED, RESIDUAL, ENERGY = "twin", "twin/residual", "twin/energy"


class TwinTopics:
    """Publishers below `twin/`, relative names."""

    def __init__(self, node: Node, channels: Sequence[str], joint: str, moves: bool) -> None:
        """`joint`: of joint_states; `moves`: its position is compared, else its effort."""
        self._channels, self._name, self._moves = channels, joint, moves

        def publisher(kind: type, topic: str) -> Publisher:
            return node.create_publisher(kind, topic, MEASURED)

        self._of = {
            below: (
                [publisher(BatteryState, f"{below}/{c}/power") for c in channels],
                [publisher(Temperature, f"{below}/{c}/temperature") for c in channels],
                publisher(JointState, f"{below}/joint_states"),
            )
            for below in (PREDICTED, RESIDUAL)
        }
        self._energy = {s: publisher(Float64, f"{ENERGY}/{s}") for s in MEASURED_STAGES}

    def predict(self, prediction: Prediction) -> None:
        """Publish what all sensors should read at one moment."""
        powers, temperatures, joint = self._of[PREDICTED]
        for k, channel in enumerate(self._channels):
            volt, ampere = float(prediction.voltage[k]), float(prediction.current[k])
            send(powers[k], power_message(channel, volt, ampere), prediction.stamp)
            celsius = float(prediction.temperature[k]) - CELSIUS_ZERO
            send(temperatures[k], temperature_message(channel, celsius), prediction.stamp)
        send(joint, self._joint(prediction.mechanics, elongation=0.0), prediction.stamp)

    def residual(self, residual: Residual) -> None:
        """Publish the difference of one reading."""
        powers, temperatures, joint = self._of[RESIDUAL]
        wire, value, stamp = residual.wire, residual.value, residual.stamp
        if residual.kind == CURRENT:
            send(powers[wire], power_message(self._channels[wire], NAN, value), stamp)
        elif residual.kind == TEMPERATURE:
            send(temperatures[wire], temperature_message(self._channels[wire], value), stamp)
        else:
            send(joint, self._joint(value, elongation=NAN), stamp)

    def energies(self, verdict: Verdict) -> None:
        """Publish the whitened residual energy of the stages that are judged."""
        for state in verdict.measured:
            if not math.isnan(state.energy):
                self._energy[state.stage].publish(Float64(data=state.energy))

    def _joint(self, value: float, elongation: float) -> JointState:
        if self._moves:
            return JointState(name=[self._name], position=[value])
        return JointState(name=[self._name], position=[elongation], effort=[value])


# Reliable unless a publisher that is there already is not: a lost voltage is a wrong prediction.
# Deep, as a player or a simulation faster than life comes in bursts.
_OFFERED = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_AVAILABLE)
_STEP_EVERY = 0.02
_DIAGNOSE_EVERY = 1.0
_SILENCE = 2.0


class TwinNode(BenchNode):
    """Listens, and drives nothing. Parameters, effects among them, may change while it runs."""

    fixed = frozenset({"bench.channels", "bench.channel_sides"})
    with_uncertainty = True  # a diagnosis's file loads whole into the running node

    def __init__(self) -> None:
        super().__init__("twin")
        channels = self.parameters["bench.channels"]
        self._joint = "tip" if moves_tip(self.parameters) else "wire"
        self._moves = load_kind(self.parameters) != "clamped"
        self._topics = TwinTopics(self, channels, self._joint, self._moves)
        compile_model(self.parameters)
        self._twin = Twin(
            self.parameters, self.settings, self._topics.predict, self._topics.residual
        )
        self._loaded = self.parameters, self.settings
        self._judged = self._twin.verdict
        self._said = ""
        self._heard, self._readings, self._hertz = time.monotonic(), 0, 0.0
        self._reported = 0, self._heard
        self._restarts = 0
        self.listen(BatteryState, "power", self._on_power, _OFFERED, numbered=True)
        self.listen(Temperature, "temperature", self._on_temperature, _OFFERED, numbered=True)
        self.create_subscription(JointState, "joint_states", self._on_joint, _OFFERED)
        self.serve(accept=self._accept)
        self.every(_STEP_EVERY, self._step)

    # Readings

    def _on_power(self, wire: int, message: BatteryState) -> None:
        self._heard = time.monotonic()
        self._readings += 1
        self._twin.power(wire, _stamp(message), message.voltage, message.current)

    def _on_temperature(self, wire: int, message: Temperature) -> None:
        variance = message.variance if math.isfinite(message.variance) else 0.0
        self._twin.temperature(
            wire, _stamp(message), message.temperature + CELSIUS_ZERO,
            math.sqrt(max(variance, 0.0)),
        )  # fmt: skip

    def _on_joint(self, message: JointState) -> None:
        if self._joint not in message.name:
            return
        k = list(message.name).index(self._joint)
        position = message.position[k] if k < len(message.position) else math.nan
        if self._moves:
            self._twin.mechanics(_stamp(message), position)
        elif k < len(message.effort):
            elongation = 0.0 if math.isnan(position) else position
            self._twin.mechanics(_stamp(message), message.effort[k], elongation)

    # What follows from them

    def _step(self) -> None:
        parameters, settings = self._loaded
        if parameters is not self.parameters:
            self._loaded = self.parameters, self.settings
            if settings != self.settings:
                self._twin.tune(self.settings)
            if parameters != self.parameters:
                self._twin.change(self.parameters)
        self._twin.advance()
        if self._restarts != self._twin.restarts:
            self._restarts = self._twin.restarts
            self.get_logger().info(f"began anew: {self._twin.reason}")
        verdict = self._twin.verdict
        if verdict is not self._judged:
            self._judged = verdict
            self._topics.energies(verdict)
            if verdict.message != self._said and verdict.measured:
                self.diagnose()

    def _accept(self) -> str:
        self._twin.accept()
        return "the present gap is known; only more of it counts as grown"

    # Diagnostics

    def health(self) -> list[DiagnosticStatus]:
        verdict = self._twin.verdict
        silence = time.monotonic() - self._heard
        level, message = DiagnosticStatus.OK, verdict.message
        if verdict.state in (GAP, GREW):
            level = DiagnosticStatus.WARN
        if silence > _SILENCE:
            level, message = DiagnosticStatus.STALE, "no voltages"
        if message != self._said:
            # Two lines of code: rclpy pins the severity of each.
            if level == DiagnosticStatus.OK:
                self.get_logger().info(message)
            else:
                self.get_logger().warning(message)
            self._said = message
        # Readings of voltages a second, of all channels, over the last half second or more.
        now, (count, then) = time.monotonic(), self._reported
        if now - then > 0.5 * _DIAGNOSE_EVERY:
            self._hertz = (self._readings - count) / (now - then)
            self._reported = self._readings, now
        lines = [self.status("gap", level, message, {
            "state": verdict.state, "stages": " ".join(verdict.stages),
            "sides": " ".join(verdict.sides), "model_time": f"{self._twin.stamp / NANOSECONDS:.3f}",
            "voltage_readings_rate": f"{self._hertz:.1f}",
            "silence": f"{silence:.1f}", **self._twin.counts,
        })]  # fmt: skip
        for state in verdict.measured:
            learned = not math.isnan(state.energy)
            message = f"{state.gap:.1f} times the noise" if learned else "learning the noise"
            named = state.stage in verdict.stages
            level = DiagnosticStatus.WARN if named else DiagnosticStatus.OK
            numbers = {"energy": f"{state.energy:.3g}", "gap_over_noise": f"{state.gap:.3g}"}
            lines.append(self.status(state.stage, level, message, numbers))
        return lines


def _stamp(message: Any) -> int:
    return message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
