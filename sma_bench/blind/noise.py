"""What a sensor adds of its own: white, coloured and drifting noise."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

Array = npt.NDArray[np.float64]

# Colour -> (share of the variance that is correlated, its correlation time in s): lowest, highest.
# "coloured" is a filtered or mains-ridden amplifier, "drift" one that warms up and wanders.
COLOURS: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "white": ((0.0, 0.0), (1.0, 1.0)),
    "coloured": ((0.4, 0.95), (0.1, 1.5)),
    "drift": ((0.08, 0.3), (8.0, 40.0)),
}


@dataclass(frozen=True)
class Noise:
    """Stationary noise: a white part, and an AR(1) part of exponential correlation.

    Attributes:
        std: of both parts together, in the unit of the signal.
        share: of the variance that is correlated, 0 to 1.
        correlation_time: s, in which the correlation falls to 1/e.
    """

    std: float
    share: float = 0.0
    correlation_time: float = 1.0

    @classmethod
    def of_colour(cls, colour: str, std: float, rng: np.random.Generator) -> "Noise":
        """Noise of a colour of COLOURS, its share and time drawn from the ranges given there."""
        (least, most), (fastest, slowest) = COLOURS[colour]
        time = float(np.exp(rng.uniform(np.log(fastest), np.log(slowest))))
        return cls(std, float(rng.uniform(least, most)), time)

    def draw(self, n: int, period: float, rng: np.random.Generator) -> Array:
        """(n,) noise at samples `period` s apart, stationary from the first one on."""
        white, driving = rng.standard_normal((2, n))
        rho = np.exp(-period / self.correlation_time)
        driving[1:] *= np.sqrt(1.0 - rho**2)
        correlated = lfilter([1.0], [1.0, -rho], driving)
        mixed = np.sqrt(1.0 - self.share) * white + np.sqrt(self.share) * correlated
        return np.asarray(self.std * mixed)

    def whiten_means(self, means: Array, width: float, samples: float) -> Array:
        """Means over windows side by side, filtered so that their noise is white with std 1.

        Means of white noise plus an AR(1) process are an ARMA(1,1) process: its innovations are
        what this returns, for a process that was quiet before the first window.

        Args:
            means: (n,) of the windows.
            width: of a window in s.
            samples: in a window.
        """
        ratio = width / self.correlation_time
        rho = float(np.exp(-ratio))
        # Variance of the means, and covariance of neighbours: the correlation integrated twice.
        variance = 2.0 * (ratio - 1.0 + rho) / ratio**2
        neighbours = (1.0 - rho) ** 2 / ratio**2
        variance = self.share * variance + (1.0 - self.share) / samples
        neighbours = self.share * neighbours
        # x_t - rho x_(t-1) is e_t + moving e_(t-1).
        own = (1.0 + rho**2) * variance - 2.0 * rho * neighbours
        next_one = neighbours - rho * variance
        moving = 2.0 * next_one / (own + np.sqrt(max(own**2 - 4.0 * next_one**2, 0.0)))
        innovation = np.sqrt(own / (1.0 + moving**2))
        filtered = lfilter([1.0, -rho], [1.0, moving], means)
        return np.asarray(filtered / (self.std * innovation))
