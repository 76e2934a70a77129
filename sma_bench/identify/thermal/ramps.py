"""Windows around voltage ramps in which the wire stays below A_s."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.voltage import VoltageSegment
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array
from sma_bench.identify.signals import ChannelDrive
from sma_bench.records import Record
from sma_bench.records.record import samples

BEFORE = 3.0
AFTER = 12.0
FEWEST_SAMPLES = 30
_CLEARLY = 3.0  # of the noise, below A_s: where a cut falls must not hang on the noise


@dataclass(frozen=True)
class Window:
    """One stretch of a record: a drive with what comes before and after it; s, V, K."""

    voltage_time: Array
    voltage: Array
    temperature_time: Array
    temperature: Array


@dataclass(frozen=True)
class Cut:
    """A window, the number of samples cut off its end as too hot, and its highest temperature."""

    window: Window
    excluded: int
    highest: float


def cut_windows(record: Record, drive: ChannelDrive, limit: float) -> list[Cut]:
    """Windows around the ramps of one channel, each up to where it becomes too hot."""
    voltage_time, voltage = samples(record, f"{drive.channel}.voltage")
    time, temperature = samples(record, f"{drive.channel}.temperature")
    clear = limit - _CLEARLY * noise_floor(temperature)
    found = []
    for start, stop in _spans(drive.segments.ramps):
        inside = (time >= start) & (time <= stop)
        t, y = time[inside], temperature[inside]
        if len(t) < FEWEST_SAMPLES:
            continue
        smooth = median_filter(y, 5, mode="nearest")
        hot = np.flatnonzero(smooth > limit)
        # Once above A_s the latent heat of both ways is in the curve until the wire is cold.
        kept = int(np.argmax(smooth > clear)) if len(hot) else len(t)
        stop = float(t[kept - 1]) if kept else start
        first = max(int(np.searchsorted(voltage_time, start)) - 1, 0)
        last = int(np.searchsorted(voltage_time, stop)) + 2
        window = Window(voltage_time[first:last], voltage[first:last], t[:kept], y[:kept])
        found.append(Cut(window, len(t) - kept, float(smooth.max())))
    return found


def choose_windows(
    cuts: Sequence[Sequence[Cut]], limit: float, subject: str
) -> tuple[list[list[Window]], list[Finding]]:
    """Ramps of each drive that stay cold; the cold beginnings of hot ones where there are no
    others."""
    every = [cut for of_drive in cuts for cut in of_drive]
    hot = [cut for cut in every if cut.excluded]
    cold = [cut for cut in every if not cut.excluded]
    usable = [
        [
            cut.window for cut in of_drive
            if not (cold and cut.excluded) and len(cut.window.temperature) >= FEWEST_SAMPLES
        ]
        for of_drive in cuts
    ]
    if not hot:
        return usable, []
    highest = max(cut.highest for cut in hot)
    excluded = sum(cut.excluded for cut in hot)
    text = (
        f"the temperature reaches {highest:.1f} K, above A_s = {limit:.1f} K, where eq. (5) does "
        "not hold: "
    )
    if cold:
        text += f"{len(hot)} of {len(every)} ramps are left out"
    else:
        text += f"{excluded} samples from there to the end of each ramp are left out"
    numbers = {"ramps": float(len(hot)), "excluded": float(excluded), "highest": highest}
    return usable, [Finding("info" if cold else "warning", subject, text, numbers)]


def _spans(ramps: Sequence[VoltageSegment]) -> list[tuple[float, float]]:
    """Start and stop in s of the stretch around each ramp; stretches do not overlap."""
    spans = []
    for k, ramp in enumerate(ramps):
        earliest = ramps[k - 1].stop if k else -math.inf
        latest = ramps[k + 1].start if k + 1 < len(ramps) else math.inf
        latest = max(latest - BEFORE, ramp.stop)
        spans.append((max(ramp.start - BEFORE, earliest), min(ramp.stop + AFTER, latest)))
    return spans
