"""Which pictures of a camera are to be trusted, where a wire runs in them, its temperature there,
frame after frame, and what the camera's node reports of all that. No ROS.

The picture is turned so that the wire crosses every row: arrays are (lines, pixels across). The
ridge is the best path by dynamic programming through groups of lines, then a smooth curve.

A wire thinner than a pixel fills it in part, and the lens smears it over several. Blur moves
radiance but adds none: across the wire, sum(L - L_background) = width (L_surface - L_background).
So the known width (diameter over pixel size) gives the radiance of the surface, in every line."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from sma_bench.arrays import Array, Mask
from sma_bench.errors import InputError
from sma_bench.hardware import thermal_image as image
from sma_bench.hardware.safety import CELSIUS_ZERO, Limits
from sma_bench.parameters import Parameters

GROUP = 6  # lines that are averaged before the search
_SHIFT = 4  # pixels from one group to the next: 37 degrees of tilt
CLEAR = 4.0  # by which a wire stands out; a ridge in pure noise had 3.2 at most (6000 pictures)
# A group of lines shows the wire from this height on, in noise and in the median group's height.
_GROUP_VISIBLE, _GROUP_TYPICAL, _FEWEST_GROUPS = 2.5, 0.3, 3
_GAP, _RING = 3, 4  # pixels beside the wire that its blur may reach, and of background beyond
# Of the curve through the groups: its degree, groups for each, fits, and pixels that they lie off.
_HIGHEST_DEGREE, _GROUPS_A_DEGREE, _FITS, _OFF_CURVE = 4, 4, 3, 2.0
_SCALE_OF_MAD = 1.4826
STATISTICS = ("mean", "median", "hottest")
_BLUR, _NEAR, _FAR = 4, 3, 3  # pixels: of its blur from half the wire on, and of background
_MEDIAN_OVER_MEAN = 1.2533  # standard deviations of the two, of Gaussian noise
_WIDEST_TILT, _HIGHEST_FILL = 1.3, 1.15
_MOST_RIPPLE = 0.25  # of the wire's peak, beside it
_HALF_STEP = 0.5 / image.RAW_PER_KELVIN  # K; at the end of the camera's range pixels are that end
# A wire this many times clearer than the least visible one does not fade within this time [s].
_TOO_CLEAR_TO_FADE, _NO_TIME_TO_FADE = 4.0, 0.1
_SPARSE = 4  # every so many pixels each way show whether a frame is one uniform surface
_BELIEVED = 0.3  # of the modelled rise in temperature: parameters may be off by a factor
OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus


class Region(NamedTuple):
    """Part of a picture that one wire stays in, in pixels from the upper left corner."""

    x: int
    y: int
    width: int
    height: int
    along_x: bool  # the wire runs along the rows of the picture, not along its columns

    @classmethod
    def parse(cls, text: str, frame_width: int, frame_height: int, where: str) -> "Region":
        """Region of `X Y WIDTH HEIGHT [x|y]`; "" is the whole frame. The letter is the wire's
        direction, else the longer side. InputError: another form, outside the frame, too small."""
        words = text.split() or ["0", "0", str(frame_width), str(frame_height)]
        direction = words.pop() if words[-1] in ("x", "y") else ""
        if len(words) != 4 or not all(word.isdecimal() for word in words):
            raise InputError(f"{where}: {text!r}, expected 'X Y WIDTH HEIGHT', perhaps x or y")
        x, y, width, height = (int(word) for word in words)
        if x + width > frame_width or y + height > frame_height:
            raise InputError(f"{where}: {text!r} goes beyond the frame of {frame_width} x "
                             f"{frame_height}")
        region = cls(x, y, width, height, direction == "x" if direction else width > height)
        least_lines, least_across = 3 * GROUP, 2 * (_GAP + _RING)
        if region.shape[0] < least_lines or region.shape[1] < least_across:
            raise InputError(f"{where}: {text!r}, expected {least_lines} pixels or more along the "
                             f"wire and {least_across} across")
        return region

    @property
    def shape(self) -> tuple[int, int]:
        """Lines along the wire, pixels across."""
        return (self.width, self.height) if self.along_x else (self.height, self.width)


class Optics(NamedTuple):
    """How a wire appears to the camera."""

    width: float  # of the wire, pixels
    width_std: float  # of that, relative
    lowest: float  # K, of the camera's measuring range
    highest: float
    accuracy: float  # K, standard deviation of the camera's calibration, common to all pixels
    correct_fill: bool = True  # sum across the wire; otherwise its middle pixel as it is
    statistic: str = "median"  # one of STATISTICS, over the lines of the region
    least_visible: float = 0.5  # share of the region's length in which the wire must be seen


class WireReading(NamedTuple):
    """What a frame says about a wire; temperature and deviation are NaN where there is a reason."""

    kelvin: float = math.nan
    std: float = math.nan  # K
    reason: str = ""
    seen: bool = False  # the wire stands out from its background
    background: float = math.nan  # K, apparent, beside the wire
    fill: float = math.nan  # highest share of a pixel that the wire fills
    clearness: float = 0.0  # height of the ridge in standard deviations of its surroundings
    centre: float = math.nan  # mean position across the region, pixels from its border
    visible: float = 0.0  # share of the region's length in which the wire is seen
    limit: float = math.nan  # K, excess over the background that could just be seen


class Ridge(NamedTuple):
    """A wire's way through its region, a value a line."""

    centre: Array  # pixel across from the region's border
    slope: Array  # its change per line
    seen: Mask  # where it is seen
    clearness: float  # its mean height in standard deviations of its surroundings


def _ridge(height: Array, noise: float, lines: int) -> Ridge | None:
    """The brightest ridge along the region; None where none stands out. A hot spot does not attract
    it: no group of lines counts more than the median one."""
    typical = float(np.median(height.max(axis=1)))
    # Beside a valley the surroundings look like ridges, of half its depth.
    if noise == 0.0 or typical < float(np.median(-height.min(axis=1))) / 1.5:
        return None
    scores = np.minimum(height, typical) / noise
    # Pixel of every group on the path of the highest sum that shifts by `_SHIFT` at most.
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
    along = scores[np.arange(groups), path]
    visible = along > max(_GROUP_VISIBLE, _GROUP_TYPICAL * typical / noise)
    if visible.sum() < _FEWEST_GROUPS or along[visible].mean() < CLEAR:
        return None
    # A polynomial through the visible groups; none where they do not lie on one curve.
    at, line = (np.arange(groups) + 0.5) * GROUP - 0.5, np.arange(lines)
    good = visible.copy()
    for _ in range(_FITS):
        degree = min(_HIGHEST_DEGREE, int(good.sum()) // _GROUPS_A_DEGREE)
        curve = Polynomial.fit(at[good], path[good].astype(float), degree, domain=[0.0, lines])
        before, good = good, visible & (np.abs(path - curve(at)) < _OFF_CURVE)
        if good.sum() < visible.sum() / 2:
            return None
        if (good == before).all():
            break
    # Seen between its ends; the groups in which these lie show only part of it.
    centre, slope = curve(line), curve.deriv()(line)
    first, last = np.flatnonzero(good)[[0, -1]]
    first += first > 0
    last -= last < groups - 1
    seen = (line >= first * GROUP) & (line < (last + 1) * GROUP)
    seen &= (centre >= 0.0) & (centre <= across - 1.0)
    return Ridge(centre, slope, seen, float(along[visible].mean()))


def read_wire(frame: image.Frame, region: Region, optics: Optics, surface: image.Surface,
              cold: bool = False) -> WireReading:
    """Find the wire in its region and read it; the reason says why that cannot be. With `cold`, a
    dark line where there is no bright one is taken for the wire."""
    half = math.ceil(optics.width * _WIDEST_TILT / 2) + _BLUR
    reach = half + _NEAR + _FAR
    # Its region, turned, with up to so many more pixels on both sides as the frame has.
    turned = frame.T if region.along_x else frame
    first, line = (region.y, region.x) if region.along_x else (region.x, region.y)
    (length, across), begin = region.shape, min(first, reach)
    rows = turned[line : line + length, first - begin : first + across + reach]
    radiance = image.radiance_of_raw(rows)
    # How far each pixel of a group of lines rises above those beside it (groups, across), the noise
    # of that, and the excess, summed across the wire, of one that could just be seen.
    groups = len(radiance) // GROUP
    grouped = radiance[: groups * GROUP].reshape(groups, GROUP, -1).mean(axis=1, dtype=float)
    near = (round(optics.width) + _GAP) // 2
    far = near + _RING
    inner, outer = 2 * near + 1, 2 * far + 1
    # Beyond the border the trend there goes on.
    beyond = np.pad(grouped, ((0, 0), (far, far)), mode="reflect", reflect_type="odd")
    own, both = (uniform_filter1d(beyond, n, axis=1)[:, far:-far] for n in (inner, outer))
    height = ((own - both) * (outer / (outer - inner)))[:, begin : begin + across]
    height -= np.median(height)
    noise = _SCALE_OF_MAD * float(np.median(np.abs(height)))
    if noise == 0.0:  # no noise at all, or less than the step of the pixel values
        noise = float(np.abs(height).max()) * 1e-6
    least = CLEAR * noise * inner / optics.width
    bright = _ridge(height, noise, length)
    dark = None if bright else _ridge(-height, noise, length)
    ridge = bright or (dark if cold else None)
    if ridge is None:
        beside = float(image.temperature_of(float(np.median(radiance))))
        what = "wire colder than its" if dark else "no wire stands out from the"
        return WireReading(reason=f"{what} background of {beside - CELSIUS_ZERO:.1f} degC",
                           background=beside, limit=least / image.slope_at(beside))
    # Lines in which the wire is seen with all of its surroundings.
    middle = np.rint(ridge.centre).astype(int) + begin
    lines = np.flatnonzero(ridge.seen & (middle >= reach) & (middle + reach < radiance.shape[1]))
    visible = len(lines) / length
    if visible < optics.least_visible:
        return WireReading(reason=f"wire seen in {100 * visible:.0f} % of its region, expected "
                           f"{100 * optics.least_visible:.0f} % or more",
                           visible=visible, clearness=ridge.clearness)
    columns = middle[lines, np.newaxis] + np.arange(-reach, reach + 1)
    window = radiance[lines[:, np.newaxis], columns].astype(float)
    tilt = np.hypot(1.0, ridge.slope[lines])
    reading = _measured(window, half, tilt, bright is None, optics, surface)
    return reading._replace(clearness=ridge.clearness, centre=float(ridge.centre.mean()),
                            visible=visible, limit=least / image.slope_at(reading.background))


def _measured(window: Array, half: int, tilt: Array, dark: bool, optics: Optics,
              surface: image.Surface) -> WireReading:
    """The reading from radiances (lines, pixels) with the wire in their middle. The standard
    deviation holds the pixels' noise and quantisation (from the frame itself), the background's
    curvature, width, emissivity, reflected temperature and the camera's accuracy."""
    # Excess over the background, a line each.
    distance = np.abs(np.arange(window.shape[1]) - window.shape[1] // 2)
    near = window[:, (distance > half) & (distance <= half + _NEAR)].mean(axis=1)
    far = window[:, distance > half + _NEAR].mean(axis=1)
    beside = (near + far) / 2.0
    excess = window[:, distance <= half] - beside[:, np.newaxis]
    pixels, background = excess.shape[1], float(np.median(beside))
    beside_kelvin = float(image.temperature_of(background))
    # The wire's surface, and what the steps of the pixel values leave open of it.
    step = image.slope_at(beside_kelvin) / image.RAW_PER_KELVIN
    if optics.correct_fill:
        over_width = 1.0 / optics.width
        surfaces = beside + excess.sum(axis=1) / (optics.width * tilt)
        # Noise of s steps dithers the rounding: what is left of it has the amplitude
        # exp(-2 (pi s)^2)/pi steps (Widrow and Kollar, Quantization Noise, 2008).
        noise = _line_noise(beside) * math.sqrt(2 * (_NEAR + _FAR))
        dithered = math.exp(-2.0 * (math.pi * noise / step) ** 2)
        rounding = step / math.pi / math.sqrt(2.0) * dithered * math.sqrt(pixels) * over_width
    else:
        over_width = 0.0
        surfaces = beside + excess[:, pixels // 2]
        # The median of rounded values is a rounded value.
        rounding = step / math.sqrt(12.0)
    noise = _line_noise(surfaces)
    if optics.statistic == "hottest":
        groups = surfaces[: len(surfaces) // GROUP * GROUP].reshape(-1, GROUP).mean(axis=1)
        apparent, noise = float(groups.max()), noise / math.sqrt(GROUP)
    else:
        median = optics.statistic == "median"
        apparent = float(np.median(surfaces) if median else surfaces.mean())
        noise *= (_MEDIAN_OVER_MEAN if median else 1.0) / math.sqrt(len(surfaces))
    above = apparent - background
    # What curves the background between near and far may curve it below the wire too.
    curved = abs(float(np.mean(near - far))) * pixels * over_width
    width = above * optics.width_std * optics.width * over_width
    camera = image.slope_at(float(image.temperature_of(apparent))) * optics.accuracy
    kelvin, std = surface.temperature(apparent, math.hypot(noise, rounding, curved, width, camera))
    # Why it is not to be believed.
    middle = excess.mean(axis=0)
    peak = float(middle.max() if above > 0.0 else middle.min())
    fill = peak / above if above else math.inf
    mean = window.mean(axis=0) - beside.mean()
    ripple = float(np.abs(((mean + mean[::-1]) / 2.0)[distance > half]).max())
    coldest, hottest = (float(image.temperature_of(r)) for r in (window.min(), window.max()))
    too_cold = coldest < optics.lowest + _HALF_STEP
    reason = ""
    if too_cold or hottest > optics.highest - _HALF_STEP:
        extreme, end = (coldest, optics.lowest) if too_cold else (hottest, optics.highest)
        reason = (f"pixel of {extreme - CELSIUS_ZERO:.1f} degC at the end of the camera's range "
                  f"({end - CELSIUS_ZERO:g} degC)")
    # A line whose sum across has the other sign stands in another one's light or shadow.
    elif dark == (above > 0.0) or ripple > _MOST_RIPPLE * abs(peak):
        reason = f"another line within {pixels // 2 + _NEAR + _FAR} pixels of the wire"
    elif optics.correct_fill and fill > _HIGHEST_FILL:
        reason = (f"fill factor {fill:.2f}, expected at most 1: the wire is narrower in the "
                  f"picture than its {optics.width:.2g} pixels")
    elif math.isnan(kelvin):
        reason = "less radiance than the reflected one alone: emissivity or reflection is wrong"
    return WireReading(math.nan if reason else kelvin, math.nan if reason else std, reason, True,
                       beside_kelvin, fill)


def _line_noise(lines: Array) -> float:
    """Standard deviation of a line, by its neighbours: a wire may be warmer in its middle."""
    return _SCALE_OF_MAD * float(np.median(np.abs(np.diff(lines)))) / math.sqrt(2.0)


class WireGauge:
    """Reads one wire; where `cold` ones are to be read, too, which at rest are as warm as their
    background, an unseen one is read as that, give or take what could just be seen: not when it was
    clear to see in the frame before (it left its region), and not when its heating should show."""

    def __init__(self, region: Region, optics: Optics, surface: image.Surface,
                 cold: bool = False) -> None:
        self._region, self._optics, self._surface, self._cold = region, optics, surface, cold
        self.reset()

    def reset(self) -> None:
        self._seen, self._clearness, self._lost = -math.inf, 0.0, False

    def read(self, frame: image.Frame, time: float, expected: float = 0.0) -> WireReading:
        """The wire in a frame taken at `time` s, when it should have `expected` K or more."""
        reading = read_wire(frame, self._region, self._optics, self._surface, self._cold)
        if reading.seen:
            self._seen, self._clearness, self._lost = time, reading.clearness, False
        elif time - self._seen <= _NO_TIME_TO_FADE:
            self._lost |= self._clearness > _TOO_CLEAR_TO_FADE * CLEAR
        held_for_itself = bool(reading.seen and reading.reason) or math.isnan(reading.background)
        if not self._cold or held_for_itself or reading.kelvin > reading.background:
            return reading
        if expected > reading.background + reading.limit:
            return WireReading(reason="wire not seen where its voltage makes it "
                               f"{expected - CELSIUS_ZERO:.1f} degC or more")
        if reading.seen:
            return reading
        if self._lost:
            return WireReading(reason="wire lost while clear to see: it left its region")
        deviation = math.hypot(reading.limit / 2.0, self._optics.accuracy)
        kelvin, std = self._surface.temperature(float(image.band_radiance(reading.background)),
                                                deviation * image.slope_at(reading.background))
        none = "less radiance than the reflected one alone" if math.isnan(kelvin) else ""
        return WireReading(kelvin, std, none, background=reading.background, limit=reading.limit)


class FrameJudge:
    """Why a frame must be held back, "" for a good one. While the flag before the detector is shut
    the Optris SDK repeats the last picture (no two real ones are equal), others show the flag."""

    def __init__(self, stale_limit: float, shutter_spread: float, shutter_settle: float) -> None:
        """`stale_limit` s is a frame's oldest age; one whose pixels differ by less than
        `shutter_spread` K is the shutter (0: never), with what comes `shutter_settle` s after."""
        self._stale_limit, self._spread, self._settle = stale_limit, shutter_spread, shutter_settle
        self._stamp = self._shut = -math.inf
        self._last: image.Frame | None = None
        self._flag_closed = False

    def flag(self, closed: bool) -> None:
        """The camera itself says whether its flag covers the detector."""
        self._flag_closed = closed

    def objection(self, frame: image.Frame, stamp: float, now: float) -> str:
        """Reason to hold back a frame acquired at `stamp` s that arrived at `now` s (one clock)."""
        before, self._last = self._last, frame
        newest, self._stamp = self._stamp, max(self._stamp, stamp)
        age = now - stamp
        if abs(age) > self._stale_limit:
            self._stamp = min(self._stamp, now)  # a clock that was set back starts afresh
            where = "old" if age > 0.0 else "in the future"
            return f"stale: frame {abs(age):.3g} s {where}, limit {self._stale_limit:g} s"
        if stamp <= newest:
            return "stale: frame with a stamp that was there before"
        if before is not None and np.array_equal(before, frame):
            return "frozen: frame equal to the one before (shutter closed, or camera hangs)"
        spread = int(np.ptp(frame[::_SPARSE, ::_SPARSE])) / image.RAW_PER_KELVIN
        if self._flag_closed or spread < self._spread:
            self._shut = stamp
        covered = 0.0 <= stamp - self._shut <= self._settle
        return "shutter: the flag covers the detector, or has just opened" if covered else ""


class ExpectedWarmth:
    """Temperature that a wire should have from its voltage, by eq. (2)."""

    def __init__(self, parameters: Parameters) -> None:
        self._model = Limits.from_parameters(parameters)
        self._kelvin, self._volts, self._time = self._model.ambient, 0.0, math.nan

    def voltage(self, volts: float, time: float) -> None:
        """The wire has `volts` V from `time` s on; not a number is passed over."""
        if math.isfinite(volts):
            self.kelvin(time)
            self._volts = volts

    def kelvin(self, time: float) -> float:
        """Temperature in K at `time` s that can be relied upon: a share of the model's rise."""
        if (elapsed := time - self._time) > 0.0:
            self._kelvin = self._model.warmed(self._kelvin, self._volts, elapsed)
        self._time = time
        return self._model.ambient + _BELIEVED * (self._kelvin - self._model.ambient)


def wire_gauges(parameters: Parameters, settings: Mapping[str, Any]) -> list[WireGauge]:
    """One gauge a channel, from the parameters of `ir_camera`. Raises InputError: regions that do
    not fit channels or picture, an unknown statistic, an empty range of the camera."""
    lowest, highest = settings["camera_lowest"], settings["camera_highest"]
    if settings["statistic"] not in STATISTICS:
        raise InputError(f"statistic: {settings['statistic']!r}, expected {', '.join(STATISTICS)}")
    if lowest >= highest:
        raise InputError(f"camera_lowest {lowest:g} K must lie below camera_highest {highest:g} K")
    diameter, pixel = parameters["wire.diameter"], settings["pixel_size"]
    thickness = parameters.std("wire.diameter") / diameter
    optics = Optics(diameter / pixel, math.hypot(thickness, settings["pixel_size_std"] / pixel),
                    lowest, highest, settings["camera_accuracy"], settings["correct_fill"],
                    settings["statistic"], settings["least_visible"])
    surface = image.Surface.of(parameters, settings)
    size = settings["image_width"], settings["image_height"]
    channels, regions = parameters["bench.channels"], settings["regions"]
    if len(regions) != len(channels):
        raise InputError(f"regions has {len(regions)} entries, expected one for each of {channels}")
    return [WireGauge(Region.parse(text, *size, f"regions: {channel}"), optics, surface,
                      settings["read_cold_wires"])
            for channel, text in zip(channels, regions, strict=True)]


class Report(NamedTuple):
    name: str
    level: int
    message: str
    values: dict[str, str]


class CameraReport:
    """Counts frames and readings, and judges each period between two reports, a second or so."""

    def __init__(self, channels: Sequence[str], silence_limit: float, now: float) -> None:
        """`silence_limit` s without a good frame is an error; `now` s is the time of the start."""
        self._channels, self._limit = tuple(channels), silence_limit
        self._arrived, self._good, self._ever = now, now, False
        self._readings = [WireReading(reason="no frame yet") for _ in channels]
        # Counts since the start by kind of hold and by channel, and those of this period.
        self._held, self._held_readings, self._last_hold = Counter[str](), Counter[str](), ""
        self._begin_period(now)

    def _begin_period(self, now: float) -> None:
        self._since, self._frames, self._period_held = now, 0, 0
        self._latencies, self._published = list[float](), Counter[str]()

    def arrived(self, now: float) -> None:
        self._arrived, self._ever = now, True
        self._frames += 1

    def held(self, reason: str) -> None:
        self._held[reason.partition(":")[0]] += 1
        self._period_held += 1
        self._last_hold = reason

    def read(self, readings: Sequence[WireReading], latency: float, now: float) -> None:
        """A good frame gave these readings, one a channel, `latency` s after it was taken."""
        self._good, self._readings = now, list(readings)
        self._latencies.append(latency)
        for channel, reading in zip(self._channels, readings, strict=True):
            (self._held_readings if reading.reason else self._published)[channel] += 1

    def reports(self, now: float) -> list[Report]:
        """The camera's report and one a channel, over the time since the last call."""
        elapsed, latencies = max(now - self._since, 1e-9), self._latencies
        mean = sum(latencies) / len(latencies) if latencies else math.nan
        values = {"frame_rate": f"{self._frames / elapsed:.1f}",
                  "held_frames": str(sum(self._held.values())),
                  **{f"held_{kind.replace(' ', '_')}": str(n) for kind, n in self._held.items()},
                  "last_held": self._last_hold, "latency_mean_s": f"{mean:.4f}"}
        level, message, silence = OK, "running", now - self._arrived
        if silence > self._limit:
            message = f"no frame for {silence:.1f} s{'' if self._ever else ' since the start'}"
            level = ERROR
        elif now - self._good > self._limit:
            level, message = ERROR, self._last_hold or "no good frame"
        elif self._period_held:
            held = f"{self._period_held} of {self._frames} frames held"
            level, message = WARN, f"{held}: {self._last_hold}"
        reports = [Report("camera", level, message, values)]
        for channel, reading in zip(self._channels, self._readings, strict=True):
            celsius = reading.kelvin - CELSIUS_ZERO
            values = {"reading_rate": f"{self._published[channel] / elapsed:.1f}",
                      "held_readings": str(self._held_readings[channel]),
                      "temperature_degC": f"{celsius:.2f}",
                      "standard_deviation_K": f"{reading.std:.2f}",
                      "background_degC": f"{reading.background - CELSIUS_ZERO:.2f}",
                      "fill_factor": f"{reading.fill:.3f}", "clearness": f"{reading.clearness:.1f}",
                      "position_px": f"{reading.centre:.2f}", "visible": f"{reading.visible:.2f}",
                      "smallest_visible_excess_K": f"{reading.limit:.2f}"}
            how = "" if reading.seen else " (as its background: not seen)"
            bad = reading.reason or ("no good frames" if level == ERROR else "")
            said = bad or f"{celsius:.1f} degC +- {reading.std:.1f}{how}"
            reports.append(Report(channel, ERROR if bad else OK, said, values))
        self._begin_period(now)
        return reports
