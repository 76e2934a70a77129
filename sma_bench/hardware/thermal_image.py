"""Pictures of an infrared camera: bytes to pixel values, and which frames can be trusted. No ROS.

Times come in as seconds; a frame is an array (height, width) of pixel values as the Optris drivers
publish them, T[degC] = (value - 1000)/10.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.hardware.thermal_radiance import RAW_PER_KELVIN

Frame = NDArray[np.uint16]

ENCODING = "mono16"
_BYTES_A_PIXEL = 2
# Every so many pixels each way tell whether a frame is one uniform surface.
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
