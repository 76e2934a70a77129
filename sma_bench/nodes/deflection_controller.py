"""Moves a bench as wanted: the position in joint_states to voltage_command."""

from collections.abc import Sequence

from std_msgs.msg import Float64

from sma_bench.hardware.safety import Freshness
from sma_bench.live.closed_loop import DeflectionLoop
from sma_bench.nodes.base import run_node
from sma_bench.nodes.controller import Controller
from sma_bench.physics.boundary import moves_tip
from sma_bench.protocols.reading import TIP


class DeflectionControllerNode(Controller):
    """Without fresh deflections it does not drive, as without fresh readings of the wires."""

    _loop: DeflectionLoop

    def __init__(self) -> None:
        super().__init__("deflection_controller", Float64)

    def loop(self) -> DeflectionLoop:
        """The controller, for the parameters of the moment."""
        joint = TIP if moves_tip(self.parameters) else "wire"
        freshness = Freshness(f"joint_states {joint}", self._feedback_timeout)
        return DeflectionLoop(self.settings, self.parameters, self.follow, freshness=freshness)

    def levels_of(self, message: Float64) -> list[float]:
        """One deflection in m."""
        return [message.data]

    def message_of(self, levels: Sequence[float]) -> Float64:
        """One deflection in m."""
        return Float64(data=levels[0])

    def measured(self, deflection: float, stamp: float, now: float) -> None:
        """What is controlled."""
        super().measured(deflection, stamp, now)
        self._loop.measured(deflection, stamp, now)



def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("deflection_controller", DeflectionControllerNode, argv)


if __name__ == "__main__":
    raise SystemExit(main())
