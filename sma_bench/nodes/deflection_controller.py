"""Moves a bench as wanted: the position in joint_states to voltage_command."""

import math
import time
from collections.abc import Sequence

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from sma_bench.control import DeflectionController
from sma_bench.control.deflection import deflection_reference_fault
from sma_bench.hardware.safety import Freshness
from sma_bench.nodes.base import run_node
from sma_bench.nodes.controller import Controller
from sma_bench.nodes.experiment import NEWEST, seconds
from sma_bench.physics.boundary import moves_tip
from sma_bench.protocols.reading import DEFLECTION, TIP


class DeflectionControllerNode(Controller):
    """Without fresh deflections it does not drive, as without fresh readings of the wires."""

    quantity = DEFLECTION

    def __init__(self) -> None:
        super().__init__("deflection_controller", Float64)
        self._deflection = math.nan
        self._joint = TIP if moves_tip(self.parameters) else "wire"
        self._tip = Freshness(f"joint_states {self._joint}", self._feedback_timeout)
        self.create_subscription(JointState, "joint_states", self._on_joints, NEWEST)

    def design(self) -> DeflectionController:
        """The controller for the parameters of the moment."""
        return DeflectionController(self.parameters, self._period, **self.tuning)

    def fault(self) -> str:
        """Why the wires must not be driven now, or ""."""
        return super().fault() or self._tip.fault(time.monotonic())

    def reference_fault(self, level: Sequence[float]) -> str:
        """Why a deflection cannot be followed, or ""."""
        return deflection_reference_fault(level, self.parameters)

    def levels_of(self, message: Float64) -> list[float]:
        """One deflection in m."""
        return [message.data]

    def message_of(self, levels: Sequence[float]) -> Float64:
        """One deflection in m."""
        return Float64(data=levels[0])

    def answer(self, wanted: Sequence[float], upcoming: Sequence[float]) -> list[float]:
        """Volts for the wanted deflection."""
        return self._law.step(wanted[0], self._deflection, self._period, upcoming[0]).tolist()

    def _on_joints(self, message: JointState) -> None:
        if self._joint not in message.name:
            return
        index = message.name.index(self._joint)
        if index < len(message.position) and math.isfinite(message.position[index]):
            self._deflection = message.position[index]
            self._tip.seen(seconds(message), time.monotonic())


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("deflection_controller", DeflectionControllerNode, argv)


if __name__ == "__main__":
    raise SystemExit(main())
