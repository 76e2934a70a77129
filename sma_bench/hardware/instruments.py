"""What instruments make of a true value: noise, then quantisation."""

import numpy as np

_BLOCK = 4096


class Instrument:
    """One sensor chain; `read` is called for every sample, so the noise is drawn in blocks."""

    def __init__(self, noise: float, resolution: float, seed: np.random.SeedSequence) -> None:
        """Gaussian `noise` (standard deviation) and `resolution` (step; 0 for none), in the unit
        of what is read."""
        self._noise = noise
        self._resolution = resolution
        self._random = np.random.default_rng(seed)
        self._drawn: list[float] = []

    def read(self, value: float) -> float:
        """The reading of a true `value`."""
        if self._noise > 0.0:
            value += self._next()
        if self._resolution > 0.0:
            value = round(value / self._resolution) * self._resolution
        return value

    def _next(self) -> float:
        if not self._drawn:
            self._drawn = (self._noise * self._random.standard_normal(_BLOCK)).tolist()
        return self._drawn.pop()
