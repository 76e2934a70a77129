"""Wire temperatures from infrared images: rejects bad frames, finds the wire, reads its
temperature, and makes the diagnostics of the camera's node. No ROS.

The image is turned so that the wire crosses every row: arrays are (lines, pixels across). The
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
CLEAR = 4.0  # least height of a wire's ridge over noise; pure noise had 3.2 at most (6000 images)
# A group shows the wire from this height on, over the noise and the median group; how many must.
_GROUP_VISIBLE, _GROUP_TYPICAL, _FEWEST_GROUPS = 2.5, 0.3, 3
_GAP, _RING = 3, 4  # pixels beside the wire that its blur may reach, and of background beyond
_HIGHEST_DEGREE, _GROUPS_PER_DEGREE = 4, 4  # of the polynomial through the groups
_FITS, _OFF_CURVE = 3, 2.0  # of that polynomial; pixels off it, from which a group is left out
_SCALE_OF_MAD = 1.4826
STATISTICS = ("mean", "median", "hottest")
_BLUR, _NEAR, _FAR = 4, 3, 3  # pixels from the wire's edge: its blur, then two rings of background
_MEDIAN_OVER_MEAN = 1.2533  # standard deviation of the median over that of the mean, Gaussian noise
_WIDEST_TILT, _HIGHEST_FILL = 1.3, 1.15
_MOST_RIPPLE = 0.25  # highest unevenness next to the wire, of the wire's peak
_HALF_STEP = 0.5 / image.RAW_PER_KELVIN  # K; pixels so near the end of the range are saturated
# A wire this many times clearer than the least visible one cannot cool unseen in this time (s).
_TOO_CLEAR_TO_FADE, _NO_TIME_TO_FADE = 4.0, 0.1
_SPARSE = 4  # only every so many pixels each way are compared to find a uniform frame
_EXPECTED_SHARE = 0.3  # of the modelled temperature rise: parameters may be off by a factor
OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus


class Region(NamedTuple):
    """Part of an image that one wire stays in, in pixels from the upper left corner."""

    x: int
    y: int
    width: int
    height: int
    along_x: bool  # the wire runs along the rows of the image, not along its columns

    @classmethod
    def parse(cls, text: str, frame_width: int, frame_height: int, where: str) -> "Region":
        """Region from `X Y WIDTH HEIGHT [x|y]`; "" is the whole frame. The letter is the wire's
        direction (default: the longer side). InputError: bad text, beyond the frame, too small."""
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
    """How a wire appears to the camera, and how it is read."""

    width: float  # of the wire, pixels
    width_std: float  # relative to the width
    lowest: float  # K, of the camera's measuring range
    highest: float
    accuracy: float  # K, standard deviation of the camera's calibration, common to all pixels
    correct_fill: bool = True  # sum across the wire; otherwise its middle pixel as it is
    statistic: str = "median"  # one of STATISTICS, over the lines of the region
    least_visible: float = 0.5  # share of the region's length in which the wire must be seen


class WireReading(NamedTuple):
    """A wire's reading from one frame; `reason`: why temperature and deviation are NaN."""

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
    """A wire's path through its region, one value per line."""

    centre: Array  # pixel across from the region's border
    slope: Array  # its change per line
    seen: Mask  # where it is seen
    clearness: float  # its mean height in standard deviations of its surroundings


def _ridge(height: Array, noise: float, lines: int) -> Ridge | None:
    """The brightest ridge along the region; None if none stands out. No group of lines counts more
    than the median one, so that a hot spot does not attract it."""
    typical = float(np.median(height.max(axis=1)))
    # On both sides of a valley the surroundings look like ridges of half its depth.
    if noise == 0.0 or typical < float(np.median(-height.min(axis=1))) / 1.5:
        return None
    scores = np.minimum(height, typical) / noise
    # Pixel of each group on the path with the highest sum; from group to group at most `_SHIFT`.
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
    # A polynomial through the visible groups; no ridge if they do not lie on one curve.
    at, line = (np.arange(groups) + 0.5) * GROUP - 0.5, np.arange(lines)
    good = visible.copy()
    for _ in range(_FITS):
        degree = min(_HIGHEST_DEGREE, int(good.sum()) // _GROUPS_PER_DEGREE)
        curve = Polynomial.fit(at[good], path[good].astype(float), degree, domain=[0.0, lines])
        before, good = good, visible & (np.abs(path - curve(at)) < _OFF_CURVE)
        if good.sum() < visible.sum() / 2:
            return None
        if (good == before).all():
            break
    # Seen between the wire's ends, without the groups that hold an end.
    centre, slope = curve(line), curve.deriv()(line)
    first, last = np.flatnonzero(good)[[0, -1]]
    first += first > 0
    last -= last < groups - 1
    seen = (line >= first * GROUP) & (line < (last + 1) * GROUP)
    seen &= (centre >= 0.0) & (centre <= across - 1.0)
    return Ridge(centre, slope, seen, float(along[visible].mean()))


def read_wire(frame: image.Frame, region: Region, optics: Optics, surface: image.Surface,
              cold: bool = False) -> WireReading:
    """Find the wire in its region and read it. With `cold`, a dark line counts as the wire if there
    is no bright one."""
    half = math.ceil(optics.width * _WIDEST_TILT / 2) + _BLUR
    reach = half + _NEAR + _FAR
    # The region, turned, with `reach` more pixels on both sides, as far as the frame has them.
    turned = frame.T if region.along_x else frame
    first, line = (region.y, region.x) if region.along_x else (region.x, region.y)
    (length, across), begin = region.shape, min(first, reach)
    rows = turned[line : line + length, first - begin : first + across + reach]
    radiance = image.radiance_of_raw(rows)
    # Height of each pixel of a group of lines above its surroundings (groups, across), its noise,
    # and the least radiance of a wire, over the background, that could be seen.
    groups = len(radiance) // GROUP
    grouped = radiance[: groups * GROUP].reshape(groups, GROUP, -1).mean(axis=1, dtype=float)
    near = (round(optics.width) + _GAP) // 2
    far = near + _RING
    inner, outer = 2 * near + 1, 2 * far + 1
    # Extrapolate the trend beyond the border.
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
    # Lines in which the wire and all of its surroundings are in the frame.
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
    """The reading from radiances (lines, pixels) with the wire in the middle. Its standard
    deviation includes the pixels' noise and quantisation (from the frame itself), the background's
    curvature, width, emissivity, reflected temperature and the camera's accuracy."""
    # Excess over the background in each line.
    distance = np.abs(np.arange(window.shape[1]) - window.shape[1] // 2)
    near = window[:, (distance > half) & (distance <= half + _NEAR)].mean(axis=1)
    far = window[:, distance > half + _NEAR].mean(axis=1)
    beside = (near + far) / 2.0
    excess = window[:, distance <= half] - beside[:, np.newaxis]
    pixels, background = excess.shape[1], float(np.median(beside))
    beside_kelvin = float(image.temperature_of(background))
    # Radiance of the wire's surface, and its uncertainty by the rounding of the pixel values.
    step = image.slope_at(beside_kelvin) / image.RAW_PER_KELVIN
    if optics.correct_fill:
        over_width = 1.0 / optics.width
        surfaces = beside + excess.sum(axis=1) / (optics.width * tilt)
        # Noise of s steps dithers the rounding: its remaining error has the amplitude
        # exp(-2 (pi s)^2)/pi steps (Widrow and Kollar, Quantization Noise, 2008).
        noise = _line_noise(beside) * math.sqrt(2 * (_NEAR + _FAR))
        dithered = math.exp(-2.0 * (math.pi * noise / step) ** 2)
        rounding = step / math.pi / math.sqrt(2.0) * dithered * math.sqrt(pixels) * over_width
    else:
        over_width = 0.0
        surfaces = beside + excess[:, pixels // 2]
        # The median of rounded values is rounded, too.
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
    # If the background differs between near and far, it may be as curved under the wire.
    curved = abs(float(np.mean(near - far))) * pixels * over_width
    width = above * optics.width_std * optics.width * over_width
    camera = image.slope_at(float(image.temperature_of(apparent))) * optics.accuracy
    kelvin, std = surface.temperature(apparent, math.hypot(noise, rounding, curved, width, camera))
    # Reasons to reject the reading.
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
    # If the sum across has the wrong sign, or the background ripples, there is another line.
    elif dark == (above > 0.0) or ripple > _MOST_RIPPLE * abs(peak):
        reason = f"another line within {pixels // 2 + _NEAR + _FAR} pixels of the wire"
    elif optics.correct_fill and fill > _HIGHEST_FILL:
        reason = (f"fill factor {fill:.2f}, expected at most 1: the wire is narrower in the "
                  f"image than its {optics.width:.2g} pixels")
    elif math.isnan(kelvin):
        reason = "less radiance than the reflected one alone: emissivity or reflection is wrong"
    return WireReading(math.nan if reason else kelvin, math.nan if reason else std, reason, True,
                       beside_kelvin, fill)


def _line_noise(lines: Array) -> float:
    """Standard deviation of a line, from differences of neighbours: the wire may be uneven."""
    return _SCALE_OF_MAD * float(np.median(np.abs(np.diff(lines)))) / math.sqrt(2.0)


class WireGauge:
    """Reads one wire, frame after frame. With `cold`, a wire that is not seen gets its background's
    temperature, within the least visible excess; but not if it was clear a moment before (then it
    left its region) or if its voltage should make it visible."""

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
        rejected = bool(reading.seen and reading.reason) or math.isnan(reading.background)
        if not self._cold or rejected or reading.kelvin > reading.background:
            return reading
        if expected > reading.background + reading.limit:
            return WireReading(reason="wire not seen, though its voltage makes it "
                               f"{expected - CELSIUS_ZERO:.1f} degC or more")
        if reading.seen:
            return reading
        if self._lost:
            return WireReading(reason="wire lost while clearly visible: it left its region")
        deviation = math.hypot(reading.limit / 2.0, self._optics.accuracy)
        kelvin, std = self._surface.temperature(float(image.band_radiance(reading.background)),
                                                deviation * image.slope_at(reading.background))
        none = "less radiance than the reflected one alone" if math.isnan(kelvin) else ""
        return WireReading(kelvin, std, none, background=reading.background, limit=reading.limit)


class FrameJudge:
    """Decides which frames are held back. While the shutter flag covers the detector the Optris SDK
    repeats the last frame (no two real ones are equal); other cameras show the flag."""

    def __init__(self, stale_limit: float, shutter_spread: float, shutter_settle: float) -> None:
        """`stale_limit` s: highest age of a frame. One whose pixels differ by less than
        `shutter_spread` K shows the shutter (0: never), as do those `shutter_settle` s after it."""
        self._stale_limit, self._spread, self._settle = stale_limit, shutter_spread, shutter_settle
        self._stamp = self._shut = -math.inf
        self._last: image.Frame | None = None
        self._flag_closed = False

    def flag(self, closed: bool) -> None:
        """Note whether the flag covers the detector, as the camera reports it."""
        self._flag_closed = closed

    def objection(self, frame: image.Frame, stamp: float, now: float) -> str:
        """Why to hold back a frame acquired at `stamp`, received at `now` (s, one clock), or ""."""
        before, self._last = self._last, frame
        newest, self._stamp = self._stamp, max(self._stamp, stamp)
        age = now - stamp
        if abs(age) > self._stale_limit:
            self._stamp = min(self._stamp, now)  # so that after a clock set back frames are new
            where = "old" if age > 0.0 else "in the future"
            return f"stale: frame {abs(age):.3g} s {where}, limit {self._stale_limit:g} s"
        if stamp <= newest:
            return "stale: frame with a stamp not after the one before"
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
        """The wire has `volts` V from `time` s on; ignored if not finite."""
        if math.isfinite(volts):
            self.kelvin(time)
            self._volts = volts

    def kelvin(self, time: float) -> float:
        """Temperature (K) that the wire has at least at `time` s: a share of the modelled rise."""
        if (elapsed := time - self._time) > 0.0:
            self._kelvin = self._model.warmed(self._kelvin, self._volts, elapsed)
        self._time = time
        return self._model.ambient + _EXPECTED_SHARE * (self._kelvin - self._model.ambient)


def wire_gauges(parameters: Parameters, settings: Mapping[str, Any]) -> list[WireGauge]:
    """One gauge per channel, from the parameters of `ir_camera`. Raises InputError: regions that do
    not fit channels or image, an unknown statistic, an empty range of the camera."""
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
    """Counts frames and readings, and reports each period, of about a second."""

    def __init__(self, channels: Sequence[str], silence_limit: float, now: float) -> None:
        """`silence_limit` s without a good frame is an error; `now` s: time of the start."""
        self._channels, self._limit = tuple(channels), silence_limit
        self._arrived, self._good, self._ever = now, now, False
        self._readings = [WireReading(reason="no frame yet") for _ in channels]
        # Counts since the start, by reason to hold a frame and by channel.
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
            message = bad or f"{celsius:.1f} degC +- {reading.std:.1f}{how}"
            reports.append(Report(channel, ERROR if bad else OK, message, values))
        self._begin_period(now)
        return reports
