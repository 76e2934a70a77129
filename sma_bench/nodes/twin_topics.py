"""What the twin says as messages, below `twin/`: predictions, residuals, energies by stage.

Topics are called as those of the bench that they stand beside, and have their types and stamps.
A residual is measured less predicted; what is not part of it is NaN.
"""

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64

from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.nodes.base import MEASURED
from sma_bench.nodes.bench_topics import NAN
from sma_bench.twin.twin import CURRENT, NANOSECONDS, TEMPERATURE, Prediction, Residual
from sma_bench.twin.verdict import MEASURED_STAGES, Verdict

PREDICTED, RESIDUAL, ENERGY = "twin", "twin/residual", "twin/energy"


class TwinTopics:
    """Publishers below `twin/`, relative names."""

    def __init__(self, node: Node, channels: Sequence[str], joint: str, moves: bool) -> None:
        """`joint`: of joint_states; `moves`: its position is compared, else its effort."""
        self._node, self._channels = node, channels
        self._name, self._moves = joint, moves
        self._predicted = self._of(PREDICTED)
        self._residual = self._of(RESIDUAL)
        self._energy = {
            stage: node.create_publisher(Float64, f"{ENERGY}/{stage}", MEASURED)
            for stage in MEASURED_STAGES
        }

    def _of(self, below: str) -> tuple[list[Publisher], list[Publisher], Publisher]:
        def publisher(kind: type, topic: str) -> Publisher:
            return self._node.create_publisher(kind, f"{below}/{topic}", MEASURED)

        powers = [publisher(BatteryState, f"{c}/power") for c in self._channels]
        temperatures = [publisher(Temperature, f"{c}/temperature") for c in self._channels]
        return powers, temperatures, publisher(JointState, "joint_states")

    def predict(self, prediction: Prediction) -> None:
        """Publish what all sensors should read at one moment."""
        powers, temperatures, joint = self._predicted
        for k, channel in enumerate(self._channels):
            volt, ampere = float(prediction.voltage[k]), float(prediction.current[k])
            _send(powers[k], _power(channel, volt, ampere), prediction.stamp)
            celsius = float(prediction.temperature[k]) - CELSIUS_ZERO
            _send(temperatures[k], _temperature(channel, celsius), prediction.stamp)
        _send(joint, self._joint(prediction.mechanics, elongation=0.0), prediction.stamp)

    def residual(self, residual: Residual) -> None:
        """Publish the difference of one reading."""
        powers, temperatures, joint = self._residual
        channel = self._channels[residual.wire]
        if residual.kind == CURRENT:
            message = _power(channel, NAN, residual.value)
            _send(powers[residual.wire], message, residual.stamp)
        elif residual.kind == TEMPERATURE:
            _send(temperatures[residual.wire], _temperature(channel, residual.value),
                  residual.stamp)  # fmt: skip
        else:
            _send(joint, self._joint(residual.value, elongation=NAN), residual.stamp)

    def energies(self, verdict: Verdict) -> None:
        """Publish the whitened residual energy of the stages that are judged."""
        for state in verdict.measured:
            if state.energy == state.energy:
                self._energy[state.stage].publish(Float64(data=state.energy))

    def _joint(self, value: float, elongation: float) -> JointState:
        if self._moves:
            return JointState(name=[self._name], position=[value])
        return JointState(name=[self._name], position=[elongation], effort=[value])


def _power(channel: str, volt: float, ampere: float) -> BatteryState:
    message = BatteryState(location=channel, present=True, voltage=volt, current=ampere)
    for field in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
        setattr(message, field, NAN)
    message.header.frame_id = channel
    return message


def _temperature(channel: str, value: float) -> Temperature:
    message = Temperature(temperature=value)
    message.header.frame_id = channel
    return message


def _send(publisher: Publisher, message: Any, stamp: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    publisher.publish(message)
