"""Readings of a simulated bench: the simulator node's sensors, with jitter and lost samples."""

from dataclasses import dataclass
from itertools import count

import numpy as np

from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.records import Signal

_SETTINGS = {parameter.name: parameter.default for parameter in SIMULATOR}
# The traverse of a load frame; the simulator node has none that moves.
_SETTINGS |= {"sensor.elongation_noise": 2e-6, "sensor.elongation_resolution": 1e-6}
_JITTER = 0.2
_LOST = 0.02
_UNITS = {
    "voltage": "V", "current": "A", "temperature": "K", "force": "N", "elongation": "m",
    "range": "m",
}
_CELSIUS_ZERO = 273.15


@dataclass(frozen=True)
class Course:
    """A true quantity over time: (n,) s and (n,) in SI; `held` between the times, or a line."""

    time: np.ndarray
    values: np.ndarray
    held: bool = False

    def at(self, time: np.ndarray) -> np.ndarray:
        """(m,) true values at `time` (m,) s."""
        if self.held:
            index = np.searchsorted(self.time, time, side="right") - 1
            return self.values[np.clip(index, 0, None)]
        return np.interp(time, self.time, self.values)


class Instruments:
    """All sensors of one experiment."""

    def __init__(self, seed: int, duration: float) -> None:
        """Sensors for an experiment of `duration` s."""
        self._random = np.random.default_rng(seed)
        self._seeds = np.random.SeedSequence(seed)
        self._numbers = count()
        self._duration = duration

    def clock(self, rate: float) -> np.ndarray:
        """(m,) s: instants of sampling at `rate` Hz, with jitter and losses."""
        ticks = np.arange(int(self._duration * rate) - 1) + 0.5
        ticks = ticks + self._random.uniform(-_JITTER, _JITTER, len(ticks))
        kept = self._random.uniform(size=len(ticks)) > _LOST
        return ticks[kept] / rate

    def read(self, name: str, quantity: str, course: Course, time: np.ndarray) -> Signal:
        """The signal `name` that a sensor of `quantity` makes of a true course."""
        seed = np.random.SeedSequence([self._seeds.entropy, next(self._numbers)])
        sensor = Instrument.of(_SETTINGS, quantity, seed)
        zero = _CELSIUS_ZERO if quantity == "temperature" else 0.0
        values = sensor.read_all(course.at(time) - zero)
        return Signal(name, _UNITS[quantity], time, np.array(values) + zero)
