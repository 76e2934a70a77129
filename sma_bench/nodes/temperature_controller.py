"""Holds wires at temperatures (experiment E8): one PI a wire, references from a file or topic."""

from collections.abc import Sequence

from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray

from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.live.closed_loop import TemperatureLoop
from sma_bench.nodes.base import run_node
from sma_bench.nodes.controller import Controller


class TemperatureControllerNode(Controller):
    """Readings of <channel>/temperature to voltage_command."""

    _loop: TemperatureLoop

    def __init__(self) -> None:
        super().__init__("temperature_controller", Float64MultiArray)

    def loop(self) -> TemperatureLoop:
        """The controller, for the parameters of the moment."""
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


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("temperature_controller", TemperatureControllerNode, argv)


if __name__ == "__main__":
    raise SystemExit(main())
