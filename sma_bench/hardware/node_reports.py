"""What the bridge and the camera report of themselves once a second. No ROS."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.device import LinkStatus
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_wire import WireReading


@dataclass
class Tally:
    """Counts of one report's period."""

    readings: int = 0
    oldest: float = 0.0
    """s, greatest age of a reading when it was published"""
    temperatures: dict[str, float] = field(default_factory=dict)
    """K, newest of each channel"""

    def note(self, age: float) -> None:
        """A reading was published, `age` s after its acquisition."""
        self.readings += 1
        self.oldest = max(self.oldest, age)


def link_values(status: LinkStatus) -> dict[str, str]:
    """What the link counts, in the units of its names."""
    values = {
        "connections": str(status.connections),
        "frames": str(status.telemetry),
        "lost_frames": str(status.lost),
        "crc_errors": str(status.damaged),
        "not_understood": str(status.not_understood),
        "refused_by_device": str(status.refused),
        "last_refusal": status.last_refusal,
        "round_trip_ms": f"{1e3 * status.round_trip:.2f}",
        "command_latency_ms": f"{1e3 * status.command_latency:.1f}",
        "clock_drift_ppm": f"{1e6 * status.drift:.0f}",
        "clock_uncertainty_ms": f"{1e3 * status.clock_uncertainty:.3f}",
    }
    if status.device is not None:
        values["firmware"] = f"{status.device.name} {status.device.build}"
        values["last_reset"] = status.device.reset
    return values | {f"device_{name}": str(n) for name, n in status.counters.items()}


def driver_values(driver: BenchDriver, now: float) -> dict[str, str]:
    """What became of the commands."""
    gate = driver.gate
    return {
        "state": driver.state,
        "self_test": driver.tested,
        "supply_volts": f"{driver.supply:.2f}",
        "outputs": " ".join(f"{volt:g}" for volt in gate.outputs(now)),
        "applied": " ".join(f"{volt:.2f}" for volt in driver.applied),
        "commander": gate.commander,
        "accepted_commands": str(gate.accepted),
        "rejected_commands": str(gate.rejected),
        "command_timeouts": str(gate.timeouts),
        "last_rejection": gate.last_rejection,
    }


def tally_values(tally: Tally, elapsed: float) -> dict[str, str]:
    """Rates over the last `elapsed` s, and temperatures."""
    return {
        "power_rate": f"{tally.readings / elapsed:.1f}",
        "oldest_reading_ms": f"{1e3 * tally.oldest:.1f}",
        **{f"{c}_degC": f"{kelvin - CELSIUS_ZERO:.1f}" for c, kelvin in tally.temperatures.items()},
    }


# --- the camera

OK, WARN, ERROR = "ok", "warn", "error"


@dataclass(frozen=True)
class Report:
    """One line for people, and numbers."""

    name: str
    level: str
    message: str
    values: dict[str, str]


class CameraReport:
    """Counts frames and readings, and judges each period between two reports."""

    def __init__(self, channels: Sequence[str], silence_limit: float, now: float) -> None:
        """`silence_limit` s without a good frame is an error; `now` s is the time of the start."""
        self._channels = tuple(channels)
        self._limit = silence_limit
        self._start = now
        self._arrived: float | None = None
        self._good: float | None = None
        self._held: Counter[str] = Counter()
        self._readings = [WireReading(reason="no frame yet") for _ in channels]
        self._held_readings = [0 for _ in channels]
        self._last_hold = ""
        self._longest_gap = 0.0
        self._begin_period(now)

    def arrived(self, now: float) -> None:
        """A frame came, of whatever kind."""
        if self._arrived is not None:
            self._longest_gap = max(self._longest_gap, now - self._arrived)
        self._arrived = now
        self._frames += 1

    def held(self, reason: str) -> None:
        """The frame was rejected or held back."""
        self._held[reason.partition(":")[0]] += 1
        self._period_held += 1
        self._last_hold = reason

    def read(self, readings: Sequence[WireReading], latency: float, now: float) -> None:
        """A good frame gave these readings, one a channel, `latency` s after it was taken."""
        self._good = now
        self._readings = list(readings)
        self._latencies.append(latency)
        for k, reading in enumerate(readings):
            self._published[k] += not reading.reason
            self._held_readings[k] += bool(reading.reason)

    def reports(self, now: float) -> list[Report]:
        """The camera's report and one a channel, over the time since the last call."""
        elapsed = max(now - self._since, 1e-9)
        reports = [self._camera(now, elapsed)]
        silent = reports[0].level == ERROR
        for k, channel in enumerate(self._channels):
            reports.append(self._wire(k, channel, elapsed, silent))
        self._begin_period(now)
        return reports

    def _begin_period(self, now: float) -> None:
        self._since = now
        self._frames = 0
        self._period_held = 0
        self._longest_gap = 0.0
        self._latencies: list[float] = []
        self._published = [0 for _ in self._channels]

    def _camera(self, now: float, elapsed: float) -> Report:
        mean = sum(self._latencies) / len(self._latencies) if self._latencies else math.nan
        values = {
            "frame_rate": f"{self._frames / elapsed:.1f}",
            "good_frame_rate": f"{len(self._latencies) / elapsed:.1f}",
            "held_frames": str(sum(self._held.values())),
            **{f"held_{kind.replace(' ', '_')}": str(n) for kind, n in self._held.items()},
            "last_held": self._last_hold,
            "longest_gap_s": f"{self._longest_gap:.3f}",
            "latency_mean_s": f"{mean:.4f}",
            "latency_max_s": f"{max(self._latencies, default=math.nan):.4f}",
        }
        return Report("camera", *self._judgement(now), values)

    def _judgement(self, now: float) -> tuple[str, str]:
        silence = now - (self._start if self._arrived is None else self._arrived)
        if silence > self._limit:
            never = " since the start" if self._arrived is None else ""
            return ERROR, f"no frame for {silence:.1f} s{never}"
        if now - (self._start if self._good is None else self._good) > self._limit:
            return ERROR, self._last_hold or "no good frame"
        if self._period_held:
            return WARN, f"{self._period_held} of {self._frames} frames held: {self._last_hold}"
        return OK, "running"

    def _wire(self, k: int, channel: str, elapsed: float, silent: bool) -> Report:
        reading = self._readings[k]
        values = {
            "reading_rate": f"{self._published[k] / elapsed:.1f}",
            "held_readings": str(self._held_readings[k]),
            "temperature_degC": f"{reading.kelvin - CELSIUS_ZERO:.2f}",
            "standard_deviation_K": f"{reading.std:.2f}",
            "background_degC": f"{reading.background - CELSIUS_ZERO:.2f}",
            "fill_factor": f"{reading.fill:.3f}",
            "clearness": f"{reading.clearness:.1f}",
            "position_px": f"{reading.centre:.2f}",
            "visible": f"{reading.visible:.2f}",
            "smallest_visible_excess_K": f"{reading.limit:.2f}",
        }
        if reading.reason or silent:
            return Report(channel, ERROR, reading.reason or "no good frames", values)
        celsius = reading.kelvin - CELSIUS_ZERO
        how = "" if reading.seen else " (as its background: not seen)"
        return Report(channel, OK, f"{celsius:.1f} degC +- {reading.std:.1f}{how}", values)
