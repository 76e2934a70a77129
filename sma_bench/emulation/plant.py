"""Wires behind the emulated pins: the heat of what the outputs did, the voltages of the sensors."""

import math

import numpy as np

from sma_bench.emulation.emulated_uno import CHANNELS, EmulatedUno
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench

# A triangulation sensor for 40 to 300 mm (GP2Y0A41SK0F's curve): V = SLOPE / (d + SHIFT) + OFFSET.
SLOPE = 0.124
SHIFT = 4.2e-3
OFFSET = 0.03
STANDOFF = 0.1


class Plant:
    """The physics of a rig, driven by the outputs' real pulses and seen through the real pins."""

    def __init__(self, uno: EmulatedUno, parameters: Parameters) -> None:
        """The rig's channels hang on the first outputs; the others have nothing connected."""
        self._uno = uno
        self._wires = len(parameters["bench.channels"])
        # What the outputs did comes as volts that heat, whatever the drive.
        self.bench = Bench(parameters.replace({"bench.drive": "voltage"}))
        self._squares = np.array(uno.electrics.square_time)
        self._time = uno.time
        resistance = parameters["wire.resistance"]
        uno.electrics.resistance[:] = [
            resistance if channel < self._wires else math.inf for channel in range(CHANNELS)
        ]
        self._show_deflection()

    def advance(self) -> None:
        """Let the time pass that the Uno has just run."""
        dt = self._uno.time - self._time
        if dt <= 0.0:
            return
        self._time = self._uno.time
        squares = np.array(self._uno.electrics.square_time)
        heating = np.sqrt((squares - self._squares) / dt)
        self._squares = squares
        self.bench.advance(heating[: self._wires], dt)
        self._show_deflection()

    def run(self, seconds: float, step: float = 1e-3) -> None:
        """Uno and wires together."""
        for _ in range(round(seconds / step)):
            self._uno.run(step)
            self.advance()

    def _show_deflection(self) -> None:
        deflection = self.bench.deflection
        self._uno.electrics.range_voltage[:] = [
            SLOPE / (distance + SHIFT) + OFFSET
            for distance in (STANDOFF - deflection, STANDOFF + deflection)
        ]
