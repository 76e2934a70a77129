"""Sensors of a synthetic record: the simulator node's noise, resolution and rates."""

import numpy as np
import numpy.typing as npt

from sma_bench.hardware.instruments import Instrument
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.records.contract import CELSIUS_ZERO

Array = npt.NDArray[np.float64]

_SETTINGS = {
    parameter.name: float(parameter.default)
    for parameter in SIMULATOR
    if isinstance(parameter.default, float)
}
_NANOSECONDS = 1e9
STANDOFF = _SETTINGS["sensor.range_standoff"]


def clock(kind: str, duration: float) -> Array:
    """(n,) s: when the instruments of a kind (power, temperature, mechanics) read."""
    rate = _SETTINGS[f"rate.{kind}"]
    return whole_nanoseconds(np.arange(int(duration * rate)) / rate)


def whole_nanoseconds(time: npt.ArrayLike) -> Array:
    """Stamps as ROS has them, so that clocks of several rates meet exactly where they meet."""
    return np.asarray(np.round(np.multiply(time, _NANOSECONDS)) / _NANOSECONDS)


class Sensors:
    """All sensors of one record; every reading has noise of its own."""

    def __init__(self, seed: int) -> None:
        """The same seed gives the same noise."""
        self._seeds = np.random.SeedSequence(seed)

    def read(self, quantity: str, values: Array) -> Array:
        """What a sensor of `quantity` makes of true values (n,) in SI units."""
        sensor = Instrument(
            _SETTINGS[f"sensor.{quantity}_noise"],
            _SETTINGS.get(f"sensor.{quantity}_resolution", 0.0),
            self._seeds.spawn(1)[0],
        )
        # The camera's steps are those of the Celsius scale.
        zero = CELSIUS_ZERO if quantity == "temperature" else 0.0
        return np.array([sensor.read(value) for value in (values - zero).tolist()]) + zero
