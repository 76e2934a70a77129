"""Nodes that follow references of temperature or deflection, all else as in `experiment`.

The same states, services, markers and safety rules; `~/setpoint` says what is followed.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64, Float64MultiArray

from sma_bench.hardware.safety import CELSIUS_ZERO, Freshness
from sma_bench.live.closed_loop import ClosedLoop, DeflectionLoop, TemperatureLoop
from sma_bench.nodes.experiment import ExperimentNode
from sma_bench.physics.boundary import moves_tip
from sma_bench.protocols.reading import TIP
from sma_bench.ros.node import MEASURED


class Controller(ExperimentNode, ABC):
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
        self._setpoint.publish(self.message_of(levels))

    def _on_reference(self, message: Any) -> None:
        followed = self._run.protocol if self._run.running else None
        if fault := self._loop.ask(self.levels_of(message), followed, self.parameters):
            self.get_logger().warning(f"rejected: {fault}", throttle_duration_sec=1.0)


class TemperatureControllerNode(Controller):
    """Holds wires at temperatures (E8): one PI a wire, references from a file or topic."""

    _loop: TemperatureLoop

    def __init__(self) -> None:
        super().__init__("temperature_controller", Float64MultiArray)

    def loop(self) -> TemperatureLoop:
        return TemperatureLoop(self.settings, self.parameters, self.follow)

    def levels_of(self, message: Float64MultiArray) -> list[float]:
        """Degrees Celsius to kelvin."""
        return [celsius + CELSIUS_ZERO for celsius in message.data]

    def message_of(self, levels: Sequence[float]) -> Float64MultiArray:
        """Kelvin to degrees Celsius."""
        return Float64MultiArray(data=[kelvin - CELSIUS_ZERO for kelvin in levels])

    def _on_temperature(self, channel: str, message: Temperature) -> None:
        super()._on_temperature(channel, message)
        self._loop.measured(channel, message.temperature + CELSIUS_ZERO)


class DeflectionControllerNode(Controller):
    """Moves a bench as wanted: the position in joint_states to voltage_command. Without fresh
    deflections it does not drive, as without fresh readings of the wires."""

    _loop: DeflectionLoop

    def __init__(self) -> None:
        super().__init__("deflection_controller", Float64)

    def loop(self) -> DeflectionLoop:
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
        super().measured(deflection, stamp, now)
        self._loop.measured(deflection, stamp, now)

