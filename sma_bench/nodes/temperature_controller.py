"""Holds wires at temperatures (experiment E8): one PI a wire, references from a file or topic."""

import math
from collections.abc import Sequence

from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray

from sma_bench.control import TemperatureController
from sma_bench.control.temperature import temperature_reference_fault
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.nodes.base import run_node
from sma_bench.nodes.controller import Controller
from sma_bench.protocols.reading import TEMPERATURE


class TemperatureControllerNode(Controller):
    """Readings of <channel>/temperature to voltage_command."""

    quantity = TEMPERATURE

    def __init__(self) -> None:
        super().__init__("temperature_controller", Float64MultiArray)
        if "temperature" not in self.settings["feedback"]:
            raise InputError("feedback: temperature control cannot do without temperature")
        self._kelvin = dict.fromkeys(self.parameters["bench.channels"], math.nan)

    def design(self) -> TemperatureController:
        """The controller for the parameters of the moment."""
        return TemperatureController(self.parameters, self._period, **self.tuning)

    def reference_fault(self, level: Sequence[float]) -> str:
        """Why wire temperatures cannot be followed, or ""."""
        return temperature_reference_fault(level, self.parameters)

    def levels_of(self, message: Float64MultiArray) -> list[float]:
        """Degrees Celsius to kelvin."""
        return [celsius + CELSIUS_ZERO for celsius in message.data]

    def message_of(self, levels: Sequence[float]) -> Float64MultiArray:
        """Kelvin to degrees Celsius."""
        return Float64MultiArray(data=[kelvin - CELSIUS_ZERO for kelvin in levels])

    def answer(self, wanted: Sequence[float], _: Sequence[float]) -> list[float]:
        """Volts for the wanted temperatures."""
        return self._law.step(wanted, list(self._kelvin.values()), self._period).tolist()

    def _on_temperature(self, channel: str, message: Temperature) -> None:
        super()._on_temperature(channel, message)
        # A gap (the camera's shutter) is bridged by the last reading until that is stale.
        if not math.isnan(message.temperature):
            self._kelvin[channel] = message.temperature + CELSIUS_ZERO


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("temperature_controller", TemperatureControllerNode, argv)


if __name__ == "__main__":
    raise SystemExit(main())
