"""Where a wire runs in a picture: the hottest ridge through a region. No ROS.

The picture is turned so that the wire crosses every row: arrays are (lines, pixels across). The
ridge is the best path by dynamic programming through groups of lines, then a smooth curve.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import (
    RAW_PER_KELVIN,
    Frame,
    Surface,
    radiance_at,
    radiance_of_raw,
    slope_at,
    temperature_of,
)

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
        seen: (lines,) where the wire stands out of its surroundings and lies in the region.
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

    def ridge(self, dark: bool = False) -> Ridge | None:
        """The brightest ridge along the region, or the darkest valley; None where none stands out.

        A hot spot does not attract it: no group of lines counts more than the median one.
        """
        height = -self._height if dark else self._height
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
    # Beyond the border the trend there goes on.
    beyond = np.pad(grouped, ((0, 0), (reach, reach)), mode="reflect", reflect_type="odd")
    np.cumsum(beyond, axis=1, out=sums[:, 1:])
    outer = sums[:, 2 * reach + 1 :] - sums[:, :across]
    inner = sums[:, reach + half + 1 :][:, :across] - sums[:, reach - half :][:, :across]
    return inner / (2 * half + 1) - (outer - inner) / (2 * (reach - half))


def _best_path(scores: Array) -> NDArray[np.intp]:
    """Pixel of every group on the path of the highest sum that shifts by `_SHIFT` at most."""
    groups, across = scores.shape
    totals = np.full((groups, across + 2 * _SHIFT), -np.inf)
    inside = slice(_SHIFT, _SHIFT + across)
    totals[0, inside] = scores[0]
    for k in range(1, groups):
        totals[k, inside] = maximum_filter1d(totals[k - 1], 2 * _SHIFT + 1)[inside] + scores[k]
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


# --- The temperature of one wire in a thermal picture, with its uncertainty. No ROS.
#
# A wire thinner than a pixel fills it in part, and the lens smears it over several. Blur moves
# radiance but adds none: summed across the wire, the excess over the background is the excess
# of the wire's surface times its width in pixels, whatever the blur,
#
#     sum(L - L_background) = width (L_surface - L_background).
#
# So the known width (diameter over pixel size) gives the radiance of the surface, in every
# line.

STATISTICS = ("mean", "median", "hottest")

# Pixels beside half the wire that hold all of its blur, and of background on either side.
_BLUR = 4
_NEAR = 3
_FAR = 3
_WIDEST_TILT = 1.3
_MEDIAN_OVER_MEAN = 1.2533
_HIGHEST_FILL = 1.15
_MOST_RIPPLE = 0.25


@dataclass(frozen=True)
class Optics:
    """How a wire appears to the camera.

    Attributes:
        width: of the wire, in pixels.
        width_std: relative standard deviation of that.
        lowest, highest: K, the camera's measuring range.
        accuracy: K, standard deviation of the camera's own calibration, common to all pixels.
        correct_fill: sum across the wire; otherwise its middle pixel is taken as it is.
        statistic: one of STATISTICS, over the lines of the region.
        least_visible: share of the region's length in which the wire must be seen.
    """

    width: float
    width_std: float
    lowest: float
    highest: float
    accuracy: float
    correct_fill: bool = True
    statistic: str = "median"
    least_visible: float = 0.5


@dataclass(frozen=True)
class WireReading:
    """What one frame says about one wire.

    Attributes:
        kelvin, std: temperature and its standard deviation, NaN where `reason` holds it back.
        reason: why there is no reading, "" when there is one.
        seen: the wire stands out from its background.
        background: K, apparent temperature beside the wire.
        fill: highest share of a pixel that the wire fills.
        clearness: height of the ridge in standard deviations of its surroundings.
        centre: mean position across the region, in pixels from its border.
        visible: share of the region's length in which the wire is seen.
        limit: K, excess over the background that could just be seen.
    """

    kelvin: float = math.nan
    std: float = math.nan
    reason: str = ""
    seen: bool = False
    background: float = math.nan
    fill: float = math.nan
    clearness: float = 0.0
    centre: float = math.nan
    visible: float = 0.0
    limit: float = math.nan


@dataclass(frozen=True)
class _Profile:
    """Across the wire, for every line in which it is seen; radiances."""

    excess: Array  # (lines, pixels) over the background of the line
    background: Array  # (lines,)
    curvature: Array  # (lines,) background near the wire less background far from it
    tilt: Array  # (lines,) width along a line over width across the wire
    ripple: float  # largest excess in the background, mean over lines and both sides
    extremes: tuple[float, float]


def read_wire(
    frame: Frame, region: Region, optics: Optics, surface: Surface, cold: bool = False
) -> WireReading:
    """Find the wire in its region and read it; the reason says why that cannot be.

    With `cold`, a dark line where there is no bright one is taken for the wire.

    The standard deviation holds the pixels' noise and quantisation (from the frame itself), the
    background's curvature, the width, the emissivity, the reflected temperature and the camera's
    accuracy.
    """
    half = math.ceil(optics.width * _WIDEST_TILT / 2) + _BLUR
    reach = half + _NEAR + _FAR
    raw, begin = region.band(frame, reach)
    radiance = radiance_of_raw(raw)
    search = RidgeSearch(radiance, begin, region.shape[1], optics.width)
    ridge = search.ridge() or (search.ridge(dark=True) if cold else None)
    if ridge is None:
        beside = float(temperature_of(float(np.median(radiance))))
        colder = search.ridge(dark=True) is not None
        what = "wire colder than its" if colder else "no wire stands out from the"
        return WireReading(
            reason=f"{what} background of {beside - CELSIUS_ZERO:.1f} degC",
            background=beside,
            limit=search.limit / optics.width / slope_at(beside),
        )
    middle = np.rint(ridge.centre).astype(int) + begin
    # Lines in which the wire is seen with all of its surroundings.
    whole = ridge.seen & (middle >= reach) & (middle + reach < radiance.shape[1])
    lines = np.flatnonzero(whole)
    visible = len(lines) / region.shape[0]
    if visible < optics.least_visible:
        return WireReading(
            reason=f"wire seen in {100 * visible:.0f} % of its region, expected "
            f"{100 * optics.least_visible:.0f} % or more",
            visible=visible, clearness=ridge.clearness,
        )
    across = middle[lines, np.newaxis] + np.arange(-reach, reach + 1)
    window = radiance[lines[:, np.newaxis], across].astype(float)
    profile = _profile(window, ridge.slope[lines], half)
    return _reading(profile, ridge, search, optics, surface, visible)


def _profile(window: Array, slope: Array, half: int) -> _Profile:
    """Of pixels (lines, across) with the wire in their middle."""
    reach = window.shape[1] // 2
    distance = np.abs(np.arange(-reach, reach + 1))
    near = window[:, (distance > half) & (distance <= half + _NEAR)].mean(axis=1)
    far = window[:, distance > half + _NEAR].mean(axis=1)
    background = (near + far) / 2.0
    inner = window[:, distance <= half]
    mean = window.mean(axis=0) - background.mean()
    beside = ((mean + mean[::-1]) / 2.0)[distance > half]
    return _Profile(
        excess=inner - background[:, np.newaxis],
        background=background,
        curvature=near - far,
        tilt=np.hypot(1.0, slope),
        ripple=float(np.abs(beside).max()),
        extremes=(float(window.min()), float(window.max())),
    )


def _reading(
    profile: _Profile, ridge: Ridge, search: RidgeSearch, optics: Optics, surface: Surface,
    visible: float,
) -> WireReading:
    background = float(np.median(profile.background))
    pixels = profile.excess.shape[1]
    if optics.correct_fill:
        lines = profile.background + profile.excess.sum(axis=1) / (optics.width * profile.tilt)
        rounding = _dithered_rounding(profile, background) * math.sqrt(pixels)
    else:
        lines = profile.background + profile.excess[:, pixels // 2]
        # The median of rounded values is a rounded value.
        rounding = _step(background) / math.sqrt(12.0)
    apparent, noise = _statistic(lines, optics.statistic)
    excess = apparent - background
    over_width = 1.0 / optics.width if optics.correct_fill else 0.0
    parts = (
        noise,
        rounding * (over_width or 1.0),
        # What curves the background between near and far may curve it below the wire too.
        abs(float(np.mean(profile.curvature))) * pixels * over_width,
        excess * optics.width_std * optics.width * over_width,
        slope_at(float(temperature_of(apparent))) * optics.accuracy,
    )
    kelvin, std = surface.temperature(apparent, math.hypot(*parts))
    middle = profile.excess.mean(axis=0)
    peak = float(middle.max() if excess > 0.0 else middle.min())
    fill = peak / excess if excess else math.inf
    beside = float(temperature_of(background))
    reason = _range_fault(profile, optics)
    # A line whose sum across has the other sign stands in another one's light or shadow.
    if not reason and (ridge.dark == (excess > 0.0) or profile.ripple > _MOST_RIPPLE * abs(peak)):
        reason = f"another line within {len(middle) // 2 + _NEAR + _FAR} pixels of the wire"
    if not reason and optics.correct_fill and fill > _HIGHEST_FILL:
        reason = (
            f"fill factor {fill:.2f}, expected at most 1: the wire is narrower in the picture "
            f"than its {optics.width:.2g} pixels"
        )
    if not reason and math.isnan(kelvin):
        reason = "less radiance than the reflected one alone: emissivity or reflection is wrong"
    return WireReading(
        kelvin=math.nan if reason else kelvin,
        std=math.nan if reason else std,
        reason=reason,
        seen=True,
        background=beside,
        fill=fill,
        clearness=ridge.clearness,
        centre=float(ridge.centre.mean()),
        visible=visible,
        limit=search.limit / optics.width / slope_at(beside),
    )


def _statistic(lines: Array, statistic: str) -> tuple[float, float]:
    """The statistic over the lines' radiances, and its standard deviation from their noise.

    Noise is what neighbouring lines differ by: a wire may be warmer in its middle.
    """
    steps = np.diff(lines)
    noise = _SCALE_OF_MAD * float(np.median(np.abs(steps))) / math.sqrt(2.0)
    if statistic == "mean":
        return float(lines.mean()), noise / math.sqrt(len(lines))
    if statistic == "median":
        return float(np.median(lines)), _MEDIAN_OVER_MEAN * noise / math.sqrt(len(lines))
    groups = lines[: len(lines) // GROUP * GROUP].reshape(-1, GROUP).mean(axis=1)
    return float(groups.max()), noise / math.sqrt(GROUP)


def _step(background: float) -> float:
    """Radiance of one step of the pixel values."""
    return slope_at(float(temperature_of(background))) / RAW_PER_KELVIN


def _dithered_rounding(profile: _Profile, background: float) -> float:
    """Radiance by which a pixel's rounding is off, in the mean of all lines.

    Noise of s steps dithers the rounding: what is left of it has the amplitude
    exp(-2 (pi s)^2)/pi steps (Widrow and Kollar, Quantization Noise, 2008).
    """
    step = _step(background)
    changes = np.abs(np.diff(profile.background))
    averaged = math.sqrt(2 * (_NEAR + _FAR))
    noise = _SCALE_OF_MAD * float(np.median(changes)) / math.sqrt(2.0) * averaged
    dithered = math.exp(-2.0 * (math.pi * noise / step) ** 2)
    return step / math.pi / math.sqrt(2.0) * dithered


def _range_fault(profile: _Profile, optics: Optics) -> str:
    coldest, hottest = profile.extremes
    if coldest <= radiance_at(optics.lowest):
        radiance, limit = coldest, optics.lowest
    elif hottest >= radiance_at(optics.highest):
        radiance, limit = hottest, optics.highest
    else:
        return ""
    seen = float(temperature_of(radiance)) - CELSIUS_ZERO
    return (
        f"pixel of {seen:.1f} degC at the end of the camera's range "
        f"({limit - CELSIUS_ZERO:g} degC)"
    )
