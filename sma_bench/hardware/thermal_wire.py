"""The temperature of one wire in a thermal picture, with its uncertainty. No ROS.

A wire thinner than a pixel fills it in part, and the lens smears it over several. Blur moves
radiance but adds none: summed across the wire, the excess over the background is the excess of the
wire's surface times its width in pixels, whatever the blur,

    sum(L - L_background) = width (L_surface - L_background).

So the known width (diameter over pixel size) gives the radiance of the surface, in every line.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import Frame
from sma_bench.hardware.thermal_radiance import (
    RAW_PER_KELVIN,
    Surface,
    radiance_at,
    radiance_of_raw,
    slope_at,
    temperature_of,
)
from sma_bench.hardware.thermal_ridge import GROUP, Region, Ridge, RidgeSearch

Array = NDArray[np.float64]

STATISTICS = ("mean", "median", "hottest")

# Pixels beside half the wire that hold all of its blur, and of background on either side.
_BLUR = 4
_NEAR = 3
_FAR = 3
_WIDEST_TILT = 1.3
_SCALE_OF_MAD = 1.4826
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
    ridge = search.hottest() or (search.coldest() if cold else None)
    if ridge is None:
        return _unseen(radiance, search, optics)
    lines = _whole_lines(ridge, begin, reach, radiance.shape[1])
    visible = len(lines) / region.shape[0]
    if visible < optics.least_visible:
        return WireReading(
            reason=f"wire seen in {100 * visible:.0f} % of its region, expected "
            f"{100 * optics.least_visible:.0f} % or more",
            visible=visible, clearness=ridge.clearness,
        )
    profile = _profile(radiance, ridge, lines, begin, half)
    return _reading(profile, ridge, search, optics, surface, visible)


def _whole_lines(ridge: Ridge, begin: int, reach: int, columns: int) -> NDArray[np.intp]:
    """Lines in which the wire is seen with `reach` pixels on both sides."""
    middle = np.rint(ridge.centre).astype(int) + begin
    return np.flatnonzero(ridge.seen & (middle >= reach) & (middle + reach < columns))


def _profile(
    radiance: NDArray, ridge: Ridge, lines: NDArray[np.intp], begin: int, half: int
) -> _Profile:
    middle = np.rint(ridge.centre).astype(int) + begin
    reach = half + _NEAR + _FAR
    offsets = np.arange(-reach, reach + 1)
    window = radiance[lines[:, np.newaxis], middle[lines, np.newaxis] + offsets].astype(float)
    distance = np.abs(offsets)
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
        tilt=np.hypot(1.0, ridge.slope[lines]),
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
    for radiance, limit, beyond in (
        (coldest, optics.lowest, coldest <= radiance_at(optics.lowest)),
        (hottest, optics.highest, hottest >= radiance_at(optics.highest)),
    ):
        if beyond:
            seen = float(temperature_of(radiance)) - CELSIUS_ZERO
            return (
                f"pixel of {seen:.1f} degC at the end of the camera's range "
                f"({limit - CELSIUS_ZERO:g} degC)"
            )
    return ""


def _unseen(radiance: NDArray, search: RidgeSearch, optics: Optics) -> WireReading:
    beside = float(temperature_of(float(np.median(radiance))))
    celsius = beside - CELSIUS_ZERO
    colder = search.coldest() is not None
    return WireReading(
        reason=(
            f"wire colder than its background of {celsius:.1f} degC" if colder
            else f"no wire stands out from the background of {celsius:.1f} degC"
        ),
        background=beside,
        limit=search.limit / optics.width / slope_at(beside),
    )
