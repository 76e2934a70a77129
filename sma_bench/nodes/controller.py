"""What the controllers share: a reference instead of a protocol, all else as in `experiment`.

The same states, services, markers and safety rules; `~/setpoint` says what is followed.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from std_msgs.msg import Float64, Float64MultiArray

from sma_bench.live.closed_loop import ClosedLoop
from sma_bench.nodes.experiment import Experiment
from sma_bench.ros.node import MEASURED


class Controller(Experiment, ABC):
    """A run ends with its reference; one from the topic goes on until stopped."""

    _loop: ClosedLoop

    def __init__(self, name: str, message: type[Float64 | Float64MultiArray]) -> None:
        super().__init__(name)
        self._setpoint = self.create_publisher(message, "~/setpoint", MEASURED)
        self.create_subscription(message, "~/reference", self._on_reference, 10)

    @abstractmethod
    def loop(self) -> ClosedLoop:
        """The controller, for the parameters of the moment."""

    @abstractmethod
    def levels_of(self, message: Any) -> list[float]:
        """Levels, SI, of a message of `~/reference`."""

    @abstractmethod
    def message_of(self, levels: Sequence[float]) -> Any:
        """The message of `~/setpoint`."""

    def follow(self, levels: Sequence[float]) -> None:
        """Say what is followed."""
        self._setpoint.publish(self.message_of(levels))

    def _on_reference(self, message: Any) -> None:
        followed = self._run.protocol if self._run.running else None
        if fault := self._loop.ask(self.levels_of(message), followed, self.parameters):
            self.get_logger().warning(f"rejected: {fault}", throttle_duration_sec=1.0)
