"""Where a wire runs in a picture: the hottest ridge through a region. No ROS.

The picture is turned so that the wire crosses every row: arrays are (lines, pixels across). The
ridge is the best path by dynamic programming through groups of lines, then a smooth curve.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError

Array = NDArray[np.float64]

# Lines that are averaged before the search.
GROUP = 6
# Pixels that the path may shift from one group to the next: 37 degrees of tilt.
_SHIFT = 4
# A ridge in pure noise scored 3.2 at most (6000 pictures); a wire must stand out by this much.
CLEAR = 4.0
# A group of lines shows the wire from this height on, in noise and in the median group's height.
_GROUP_VISIBLE = 2.5
_GROUP_TYPICAL = 0.3
_FEWEST_GROUPS = 3
_GAP = 3
_RING = 4
_HIGHEST_DEGREE = 4
_GROUPS_A_DEGREE = 4
_FITS = 3
_OFF_CURVE = 2.0
_SCALE_OF_MAD = 1.4826


@dataclass(frozen=True)
class Region:
    """Part of a picture that one wire stays in, in pixels.

    Attributes:
        x, y: column and row of the upper left corner, from 0.
        width, height: size.
        along_x: the wire runs along the rows of the picture, not along its columns.
    """

    x: int
    y: int
    width: int
    height: int
    along_x: bool

    @classmethod
    def parse(cls, text: str, frame_width: int, frame_height: int, where: str) -> "Region":
        """Region of `X Y WIDTH HEIGHT [x|y]`; "" is the whole frame.

        The letter is the direction of the wire; without it the longer side.

        Raises:
            InputError: not of that form, outside the frame, or too small to find a wire in.
        """
        words = text.split() or ["0", "0", str(frame_width), str(frame_height)]
        direction = words.pop() if words[-1] in ("x", "y") else ""
        if len(words) != 4 or not all(word.isdecimal() for word in words):
            raise InputError(f"{where}: {text!r}, expected 'X Y WIDTH HEIGHT', perhaps x or y")
        x, y, width, height = (int(word) for word in words)
        if x + width > frame_width or y + height > frame_height:
            raise InputError(
                f"{where}: {text!r} goes beyond the frame of {frame_width} x {frame_height}"
            )
        region = cls(x, y, width, height, direction == "x" if direction else width > height)
        lines, across = region.shape
        if lines < 3 * GROUP or across < 2 * (_GAP + _RING):
            raise InputError(
                f"{where}: {text!r}, expected {3 * GROUP} pixels or more along the wire and "
                f"{2 * (_GAP + _RING)} across"
            )
        return region

    @property
    def shape(self) -> tuple[int, int]:
        """Lines along the wire, pixels across."""
        return (self.width, self.height) if self.along_x else (self.height, self.width)

    def band(self, frame: NDArray, margin: int) -> tuple[NDArray, int]:
        """The region (lines, across) with up to `margin` more pixels on both sides.

        Also the number of pixels by which it really begins earlier: a region at the border of the
        frame gets no margin there.
        """
        turned = frame.T if self.along_x else frame
        first, line = (self.y, self.x) if self.along_x else (self.x, self.y)
        lines, across = self.shape
        begin = max(0, first - margin)
        return turned[line : line + lines, begin : first + across + margin], first - begin


@dataclass(frozen=True)
class Ridge:
    """A wire's way through its region.

    Attributes:
        centre: (lines,) pixel across, from the region's border, where the wire crosses each line.
        slope: (lines,) pixels across per line.
        seen: (lines,) where the wire can be told from its surroundings and lies in the region.
        clearness: mean height of the ridge in standard deviations of its surroundings.
        dark: it is a valley.
    """

    centre: Array
    slope: Array
    seen: NDArray[np.bool_]
    clearness: float
    dark: bool


class RidgeSearch:
    """Looks for one wire among the lines of a region."""

    def __init__(self, radiance: NDArray, begin: int, across: int, width: float) -> None:
        """`radiance` (lines, pixels) of a band whose columns `begin` to `begin + across` are the
        region; `width` of the wire in pixels."""
        groups = len(radiance) // GROUP
        grouped = radiance[: groups * GROUP].reshape(groups, GROUP, -1).mean(axis=1, dtype=float)
        half = (round(width) + _GAP) // 2
        height = _height(grouped, half)[:, begin : begin + across]
        self._shape = (len(radiance), across)
        self._height = height - np.median(height)
        self._noise = _SCALE_OF_MAD * float(np.median(np.abs(self._height)))
        if self._noise == 0.0:  # no noise at all, or less than the step of the pixel values
            self._noise = float(np.abs(self._height).max()) * 1e-6
        self.limit = CLEAR * self._noise * (2 * half + 1)
        """Excess radiance, summed across the wire, of a wire that could just be seen."""

    def hottest(self) -> Ridge | None:
        """The brightest ridge along the region, None when nothing stands out.

        A hot spot does not attract it: no group of lines counts more than the median one.
        """
        return self._best(self._height, dark=False)

    def coldest(self) -> Ridge | None:
        """The darkest valley along the region, None when nothing stands out."""
        return self._best(-self._height, dark=True)

    def _best(self, height: Array, dark: bool) -> Ridge | None:
        typical = float(np.median(height.max(axis=1)))
        # Beside a valley the surroundings look like ridges, of half its depth, and vice versa.
        if self._noise == 0.0 or typical < float(np.median(-height.min(axis=1))) / 1.5:
            return None
        scores = np.minimum(height, typical) / self._noise
        path = _best_path(scores)
        along = scores[np.arange(len(path)), path]
        visible = along > max(_GROUP_VISIBLE, _GROUP_TYPICAL * typical / self._noise)
        if visible.sum() < _FEWEST_GROUPS or along[visible].mean() < CLEAR:
            return None
        way = _smooth(path, visible, self._shape)
        return Ridge(*way, float(along[visible].mean()), dark) if way else None


def _height(grouped: Array, half: int) -> Array:
    """Mean of 2 half + 1 pixels less the mean of the pixels beside them, for every pixel."""
    reach = half + _RING
    across = grouped.shape[1]
    sums = np.zeros((len(grouped), across + 2 * reach + 1))
    np.cumsum(_beyond(grouped, reach), axis=1, out=sums[:, 1:])
    outer = sums[:, 2 * reach + 1 :] - sums[:, :across]
    inner = sums[:, reach + half + 1 :][:, :across] - sums[:, reach - half :][:, :across]
    return inner / (2 * half + 1) - (outer - inner) / (2 * (reach - half))


def _beyond(values: Array, reach: int) -> Array:
    """Values with `reach` more pixels on both sides, in which the trend at the border goes on."""
    left = 2.0 * values[:, :1] - values[:, reach:0:-1]
    right = 2.0 * values[:, -1:] - values[:, -2 : -2 - reach : -1]
    return np.concatenate([left, values, right], axis=1)


def _best_path(scores: Array) -> NDArray[np.intp]:
    """Pixel of every group on the path of the highest sum that shifts by `_SHIFT` at most."""
    groups, across = scores.shape
    totals = np.full((groups, across + 2 * _SHIFT), -np.inf)
    inside = slice(_SHIFT, _SHIFT + across)
    totals[0, inside] = scores[0]
    for k in range(1, groups):
        before = totals[k - 1]
        # The highest of nine neighbours, by twos, fours, eights.
        twos = np.maximum(before[:-1], before[1:])
        fours = np.maximum(twos[:-2], twos[2:])
        eights = np.maximum(fours[:-4], fours[4:])
        np.add(np.maximum(eights[:-1], before[8:]), scores[k], out=totals[k, inside])
    path = np.empty(groups, np.intp)
    path[-1] = totals[-1, inside].argmax()
    for k in range(groups - 1, 0, -1):
        # Column x lies at x + _SHIFT in the totals, so that its neighbours begin at x.
        neighbours = totals[k - 1, path[k] : path[k] + 2 * _SHIFT + 1]
        path[k - 1] = path[k] + neighbours.argmax() - _SHIFT
    return path


def _smooth(
    path: NDArray[np.intp], visible: NDArray[np.bool_], shape: tuple[int, int]
) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Centre, slope and where it is seen, of a polynomial through the visible groups.

    None where they do not lie on one curve.
    """
    lines, across = shape
    scale = 2.0 / lines
    at = ((np.arange(len(path)) + 0.5) * GROUP - 0.5) * scale - 1.0
    good = visible.copy()
    for _ in range(_FITS):
        degree = min(_HIGHEST_DEGREE, int(good.sum()) // _GROUPS_A_DEGREE)
        powers = np.vander(at, degree + 1, increasing=True)
        curve = np.linalg.lstsq(powers[good], path[good].astype(float), rcond=None)[0]
        before, good = good, visible & (np.abs(path - powers @ curve) < _OFF_CURVE)
        if good.sum() < visible.sum() / 2:
            return None
        if (good == before).all():
            break
    powers = np.vander(np.arange(lines) * scale - 1.0, degree + 1, increasing=True)
    centre = powers @ curve
    slope = powers[:, :-1] @ (curve[1:] * np.arange(1, degree + 1)) * scale
    first, last = np.flatnonzero(good)[[0, -1]]
    # The groups in which the wire ends show only part of it.
    first += first > 0
    last -= last < len(path) - 1
    line = np.arange(lines)
    seen = (line >= first * GROUP) & (line < (last + 1) * GROUP)
    seen &= (centre >= 0.0) & (centre <= across - 1.0)
    return centre, slope, seen
