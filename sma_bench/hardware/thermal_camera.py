"""What the camera's node does with its pictures, without ROS: which frames it trusts, the wires
that it reads by its parameters, and what it reports of both."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Limits
from sma_bench.hardware.thermal_image import RAW_PER_KELVIN, Frame, Surface
from sma_bench.hardware.thermal_wire import STATISTICS, Optics, Region, WireGauge, WireReading
from sma_bench.parameters import Parameters

_SPARSE = 4  # every so many pixels each way show whether a frame is one uniform surface
_BELIEVED = 0.3  # of the modelled rise in temperature: parameters may be off by a factor
OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus


class FrameJudge:
    """Says why a frame must be held back, or "" for a good one. The Optris SDK repeats the last
    picture while the flag before the detector is closed, and other cameras show the flag, a uniform
    surface. Two real pictures are never equal, for noise."""

    def __init__(self, stale_limit: float, shutter_spread: float, shutter_settle: float) -> None:
        """`stale_limit` s is a frame's oldest age; one whose pixels differ by less than
        `shutter_spread` K is the shutter (0: never), with what comes `shutter_settle` s after."""
        self._stale_limit, self._spread, self._settle = stale_limit, shutter_spread, shutter_settle
        self._stamp = self._shut = -math.inf
        self._last: Frame | None = None
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
        spread = int(np.ptp(frame[::_SPARSE, ::_SPARSE])) / RAW_PER_KELVIN
        if self._flag_closed or spread < self._spread:
            self._shut = stamp
        covered = 0.0 <= stamp - self._shut <= self._settle
        return "shutter: the flag covers the detector, or has just opened" if covered else ""


class ExpectedWarmth:
    """Temperature that a wire should have from its voltage, by eq. (2)."""

    def __init__(self, parameters: Parameters) -> None:
        self._model = Limits.from_parameters(parameters)
        self._kelvin = self._model.ambient
        self._volts, self._time = 0.0, math.nan

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
    surface = Surface.of(parameters, settings)
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
        self._held, self._held_readings = Counter[str](), Counter[str]()
        self._last_hold = ""
        self._begin_period(now)

    def _begin_period(self, now: float) -> None:
        self._since = now
        self._frames = self._period_held = 0
        self._latencies: list[float] = []
        self._published: Counter[str] = Counter()

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
