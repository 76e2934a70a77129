"""Pictures of an infrared camera: bytes to pixel values, and which frames can be trusted. No ROS.

Times come in as seconds; a frame is an array (height, width) of pixel values as the Optris drivers
publish them, T[degC] = (value - 1000)/10.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO

Frame = NDArray[np.uint16]

ENCODING = "mono16"
_BYTES_A_PIXEL = 2
# Every so many pixels each way show whether a frame is one uniform surface.
_SPARSE = 4


@dataclass(frozen=True)
class FrameFormat:
    """What a picture must be: width and height in pixels."""

    width: int
    height: int

    def decode(
        self, encoding: str, width: int, height: int, step: int, big_endian: bool, data: object
    ) -> Frame:
        """Pixel values (height, width) of an image message's fields; no copy where none is needed.

        Args:
            step: bytes from one row to the next, at least two a pixel.
            data: bytes, or anything with the buffer of bytes.

        Raises:
            InputError: wrong encoding or size, or fewer bytes than promised.
        """
        if encoding != ENCODING:
            raise InputError(f"thermal_image has encoding {encoding!r}, expected {ENCODING!r}")
        if (width, height) != (self.width, self.height):
            raise InputError(
                f"thermal_image is {width} x {height}, expected {self.width} x {self.height}"
            )
        if step < width * _BYTES_A_PIXEL:
            raise InputError(
                f"thermal_image has step {step}, expected {width * _BYTES_A_PIXEL} or more"
            )
        flat = np.frombuffer(data, np.uint8)  # type: ignore[call-overload]
        if flat.size < height * step:
            raise InputError(
                f"thermal_image has {flat.size} bytes, expected {height * step} ({height} x {step})"
            )
        rows = flat[: height * step].reshape(height, step)[:, : width * _BYTES_A_PIXEL]
        pixels = np.ascontiguousarray(rows).view(">u2" if big_endian else "<u2")
        return pixels.astype(np.uint16, copy=False)


def spread(frame: Frame) -> float:
    """Warmest minus coldest pixel in K, of a sparse sample of the frame."""
    sample = frame[::_SPARSE, ::_SPARSE]
    return float(int(sample.max()) - int(sample.min())) / RAW_PER_KELVIN


class FrameJudge:
    """Says why a frame must be held back, or "" for a good one.

    The Optris SDK repeats the last picture while the flag before the detector is closed, and other
    cameras show the flag, a uniform surface. Two real pictures are never equal, for noise.
    """

    def __init__(self, stale_limit: float, shutter_spread: float, shutter_settle: float) -> None:
        """`stale_limit` s is the oldest age of a frame; a frame whose `spread` is below
        `shutter_spread` K is the shutter (0: never), and so is what comes within `shutter_settle`
        s after it."""
        self._stale_limit = stale_limit
        self._shutter_spread = shutter_spread
        self._settle = shutter_settle
        self._stamp = -math.inf
        self._last: Frame | None = None
        self._shut = -math.inf
        self._flag_closed = False

    def flag(self, closed: bool) -> None:
        """The camera itself says whether its flag covers the detector."""
        self._flag_closed = closed

    def objection(self, frame: Frame, stamp: float, now: float) -> str:
        """Reason to hold back a frame acquired at `stamp` s that arrived at `now` s (one clock)."""
        before, self._last = self._last, frame
        newest, self._stamp = self._stamp, max(self._stamp, stamp)
        age = now - stamp
        if abs(age) > self._stale_limit:
            # A clock that was set back starts afresh.
            self._stamp = min(self._stamp, now)
            where = "old" if age > 0.0 else "in the future"
            return f"stale: frame {abs(age):.3g} s {where}, limit {self._stale_limit:g} s"
        if stamp <= newest:
            return "stale: frame with a stamp that was there before"
        if before is not None and np.array_equal(before, frame):
            return "frozen: frame equal to the one before (shutter closed, or camera hangs)"
        if self._flag_closed or spread(frame) < self._shutter_spread:
            self._shut = stamp
        if 0.0 <= stamp - self._shut <= self._settle:
            return "shutter: the flag covers the detector, or has just opened"
        return ""


# --- Radiance in a long-wave infrared camera's band, and what a wire's is behind its
# emissivity.
#
# The band is 7.5 to 13 um (Optris PI and Xi data sheets) with a flat response, which stands for
# the lens and the detector whose curves the maker does not publish. What is used are ratios of
# radiances, in which that matters little: a response falling to half at 13 um changes a
# temperature corrected from 0.5 to 1 of emissivity at 100 degC by 0.4 K.

Array = NDArray[np.float64]

BAND = (7.5e-6, 13e-6)
"""m, shortest and longest wavelength."""

# A camera's pixel: T[degC] = (value - 1000)/10, as the Optris drivers publish it.
RAW_OFFSET = 1000
RAW_PER_KELVIN = 10
_RAW_VALUES = 2**16

_PLANCK_1 = 1.191042972e-16  # 2 h c^2, W m2/sr
_PLANCK_2 = 1.438776877e-2  # h c/k, m K
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_HALF_BAND = (BAND[1] - BAND[0]) / 2
_WAVELENGTHS = (BAND[0] + BAND[1]) / 2 + _HALF_BAND * _NODES
_PLANCK_FACTORS = _PLANCK_1 / _WAVELENGTHS**5 * _WEIGHTS * _HALF_BAND


def raw_from_kelvin(kelvin: ArrayLike) -> Array:
    """Pixel values, not yet rounded, of temperatures in K."""
    return (np.asarray(kelvin) - CELSIUS_ZERO) * RAW_PER_KELVIN + RAW_OFFSET


def kelvin_from_raw(raw: ArrayLike) -> Array:
    """Temperatures in K of pixel values."""
    return (np.asarray(raw, float) - RAW_OFFSET) / RAW_PER_KELVIN + CELSIUS_ZERO


def band_radiance(kelvin: ArrayLike) -> Array:
    """Black body radiance in the band, W/(m2 sr), of temperatures (any shape) in K above 0.

    Planck's law integrated with 24 Gauss points: exact to 1e-12 between 200 and 2000 K.
    """
    temperature = np.asarray(kelvin, float)[..., np.newaxis]
    return (_PLANCK_FACTORS / np.expm1(_PLANCK_2 / (_WAVELENGTHS * temperature))).sum(axis=-1)


# Radiance of every pixel value there is; strictly rising, so that it can be read backwards.
_TABLE_KELVIN = kelvin_from_raw(np.arange(_RAW_VALUES))
_TABLE = band_radiance(_TABLE_KELVIN)
_TABLE_SLOPE = np.gradient(_TABLE) * RAW_PER_KELVIN
_TABLE_SINGLE = _TABLE.astype(np.float32)


def radiance_of_raw(raw: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Radiance of pixel values (any shape), single precision (1e-7)."""
    return _TABLE_SINGLE[raw]


def temperature_of(radiance: ArrayLike) -> Array:
    """Black body temperature in K of band radiances; NaN outside 173 K to 6700 K."""
    return np.interp(np.asarray(radiance, float), _TABLE, _TABLE_KELVIN, left=np.nan, right=np.nan)


def slope_at(kelvin: float) -> float:
    """dL/dT in W/(m2 sr K)."""
    return float(np.interp(kelvin, _TABLE_KELVIN, _TABLE_SLOPE))


@functools.lru_cache(maxsize=64)
def radiance_at(kelvin: float) -> float:
    """As `band_radiance`, of one temperature that is asked for again and again."""
    return float(band_radiance(kelvin))


@dataclass(frozen=True)
class Surface:
    """What a wire does to radiation, each number with one standard deviation.

    Attributes:
        emissivity: in the camera's band, above 0, at most 1.
        reflected_temperature: K, of the surroundings that the wire mirrors (a black body's).
    """

    emissivity: float
    reflected_temperature: float
    emissivity_std: float = 0.0
    reflected_std: float = 0.0

    def emitted(self, apparent: float) -> float:
        """Black body radiance at the wire's temperature, from what comes from its surface.

        apparent = e L(T) + (1 - e) L(T_reflected), solved for L(T); may be negative.
        """
        reflected = radiance_at(self.reflected_temperature)
        return (apparent - (1.0 - self.emissivity) * reflected) / self.emissivity

    def apparent(self, kelvin: ArrayLike) -> Array:
        """Radiance that comes from the surface of a wire at these temperatures in K."""
        reflected = radiance_at(self.reflected_temperature)
        return self.emissivity * band_radiance(kelvin) + (1.0 - self.emissivity) * reflected

    def temperature(self, apparent: float, apparent_std: float) -> tuple[float, float]:
        """Temperature in K and its standard deviation from the radiance of the surface.

        First order in the deviations of the radiance, emissivity and reflected temperature, which
        are independent. NaN where no temperature of 173 K or more emits that little.
        """
        emitted = self.emitted(apparent)
        kelvin = float(temperature_of(emitted))
        if np.isnan(kelvin):
            return np.nan, np.nan
        reflected = radiance_at(self.reflected_temperature)
        mirrored = (1.0 - self.emissivity) * slope_at(self.reflected_temperature)
        variance = (
            apparent_std**2
            + ((emitted - reflected) * self.emissivity_std) ** 2
            + (mirrored * self.reflected_std) ** 2
        ) / self.emissivity**2
        return kelvin, float(np.sqrt(variance)) / slope_at(kelvin)
