"""What a record offers to each experiment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import (
    Array,
    autocorrelation,
    inflation,
    quantisation_variance,
    resolution,
)
from sma_bench.estimation.voltage import Segments, VoltageSegment, find_segments, protocol_spans
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.records import Record
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import has_samples, samples

SHORTEST_PLATEAU = 2.0
_COLDEST, _HOTTEST = 5.0, 95.0  # %
# What scales the wire's excess over the room.
CAMERA = ("sensor.temperature.gain", "sensor.temperature.emissivity",
          "sensor.temperature.spot_share")  # fmt: skip
_CALIBRATED = ("current", "voltage", "temperature", "deflection")


@dataclass(frozen=True)
class Staircase:
    """Plateaus at several voltages on one channel; `tolerance` in V tells levels apart."""

    channel: str
    plateaus: tuple[VoltageSegment, ...]
    tolerance: float
    protocol: str = ""

    def windows(self, settle: float, average: float) -> tuple[Array, tuple[Finding, ...]]:
        """Averaging windows (p, 2) in s and remarks on them."""
        return windows(self.plateaus, settle, average)

    def source(self, record: Record) -> str:
        """Where the points come from, for the result file."""
        span = f"{self.plateaus[0].start:.1f} to {self.plateaus[-1].stop:.1f} s"
        return f"{record.path}: {self.channel}, {span}" + (
            f", protocol {self.protocol}" if self.protocol else ""
        )


@dataclass(frozen=True)
class ChannelDrive:
    """What the voltage of one channel does over a record."""

    channel: str
    segments: Segments
    staircases: tuple[Staircase, ...]

    def describe(self) -> str:
        """A few words for messages."""
        s = self.segments
        counts = (len(s.plateaus), s.levels(), len(s.ramps))
        plateaus, voltages, ramps = (
            f"{n} {word}{'' if n == 1 else 's'}"
            for n, word in zip(counts, ("plateau", "voltage", "ramp"), strict=True)
        )
        return f"{self.channel}: {plateaus} at {voltages}, {ramps}"


def find_drives(record: Record) -> tuple[ChannelDrive, ...]:
    """Segments of every channel's voltage, split by protocol where markers name them.

    Raises:
        InputError: a voltage too short to be cut into segments.
    """
    drives = []
    for channel in record.channels:
        if not has_samples(record, f"{channel}.voltage"):
            continue
        try:
            segments = find_segments(*samples(record, f"{channel}.voltage"))
        except InputError as error:
            raise InputError(f"{record.path}: {channel}.{error}") from None
        found = []
        for protocol, start, stop in protocol_spans(record.markers, record.duration):
            part = segments.between(start, stop)
            plateaus = tuple(p for p in part.plateaus if p.duration >= SHORTEST_PLATEAU)
            if Segments(plateaus, (), part.tolerance).levels() >= FEWEST_LEVELS:
                found.append(Staircase(channel, plateaus, part.tolerance, protocol))
        drives.append(ChannelDrive(channel, segments, tuple(found)))
    return tuple(drives)


def as_calibrated(record: Record, parameters: Parameters) -> Record:
    """The record with its readings put right by the sensors' gains, offsets and spot."""
    corrected = {}
    for name, signal in record.signals.items():
        quantity = name.rpartition(".")[2]
        if quantity not in _CALIBRATED or name.startswith("ambient."):
            continue
        gain, offset = (parameters[f"sensor.{quantity}.{k}"] for k in ("gain", "offset"))
        hot = quantity == "temperature"
        share = parameters["sensor.temperature.spot_share"] if hot else 1.0
        if (gain, offset, share) == (1.0, 0.0, 1.0):
            continue
        zero = CELSIUS_ZERO if hot else 0.0
        values = gain * (signal.values - zero) + offset + zero
        room = parameters["environment.ambient_temperature"] if hot else 0.0
        corrected[name] = replace(signal, values=room + (values - room) / share)
    return replace(record, signals={**record.signals, **corrected}) if corrected else record


def sensors_of(records: Sequence[Record], parameters: Parameters) -> Parameters:
    """What the camera's own messages state of its scale, where nobody has stated it otherwise:
    their error at the wire's coldest is its zero's, what comes on top is that of its scale."""
    found = []
    for record in records:
        for name, signal in record.signals.items():
            wire = name.endswith(".temperature") and not name.startswith("ambient.")
            if wire and signal.std is not None and len(signal) > 0:
                low, high = (np.percentile(signal.values, p) for p in (_COLDEST, _HOTTEST))
                (cold, at_cold), (hot, at_hot) = (
                    (float(np.median(signal.values[these])), float(np.median(signal.std[these])))
                    for these in (signal.values <= low, signal.values >= high)
                )
                on_top = float(np.sqrt(max(at_hot**2 - at_cold**2, 0.0)))
                found.append((at_cold, on_top / max(hot - cold, 1e-9)))
    if not found:
        return parameters
    zero, scale = np.max(found, axis=0).tolist()
    stated = dict.fromkeys(CAMERA, 0.0) | {CAMERA[-1]: scale, "sensor.temperature.offset": zero}
    known = parameters.given_uncertainty
    return parameters.replace(
        uncertainty={name: std for name, std in stated.items() if name not in known}
    )


def missing_findings(record: Record, channel: str) -> tuple[Finding, ...]:
    """A warning for each signal of a channel of which some samples were not measured."""
    findings = []
    for quantity in ("voltage", "current", "temperature"):
        signal = record.get(f"{channel}.{quantity}")
        if signal is None:
            continue
        bad = int(np.sum(~np.isfinite(signal.values)))
        if 0 < bad < len(signal.values):
            text = f"{record.path}: {bad} of {len(signal.values)} samples are NaN and left out"
            findings.append(Finding("warning", signal.name, text, {"count": float(bad)}))
    return tuple(findings)


# --- Settle, then average: one point a plateau, with what its mean is worth.

SETTLE = 15.0
AVERAGE = 15.0
FEWEST_LEVELS = 4
_FEWEST_SAMPLES = 8
# Detection finds a plateau's ends to a sample or two: only a real shortage is worth a remark.
_SHORTAGE = 0.95
_PRIOR_WEIGHT = 10.0


@dataclass(frozen=True)
class Means:
    """Means of one signal over p plateaus, in its unit.

    `value` (p,); `noise` (p,) standard error of each from the scatter of its samples, coloured
    noise counted; `hidden` standard deviation of the converter error that averaging does not
    remove, `step` the converter's step (0 if none is seen); `drift` (p,) change over the window by
    a straight line, `drift_std` its error; `n` (p,) samples.
    """

    value: Array
    noise: Array
    hidden: float
    step: float
    drift: Array
    drift_std: Array
    n: Array


def windows(
    plateaus: Sequence[VoltageSegment], settle: float = SETTLE, average: float = AVERAGE
) -> tuple[Array, tuple[Finding, ...]]:
    """Averaging window (start, stop) in s of every plateau, (p, 2), as in section II.B.

    A plateau too short for both times keeps their proportion.
    """
    if settle < 0.0 or average <= 0.0:
        raise InputError(f"settle {settle:g} s and average {average:g} s, expected >= 0 and > 0")
    wanted = settle + average
    scale = np.array([min(1.0, p.duration / wanted) for p in plateaus])
    start = np.array([p.start for p in plateaus])
    bounds = np.column_stack([start + scale * settle, start + scale * wanted])
    short = int(np.sum(scale < _SHORTAGE))
    if not short:
        return bounds, ()
    text = (
        f"{short} of {len(plateaus)} plateaus are shorter than {settle:g} s + {average:g} s; "
        f"their windows shrink in proportion, the shortest to {scale.min() * settle:.2g} s + "
        f"{scale.min() * average:.2g} s"
    )
    return bounds, (
        Finding("info", "plateaus", text, {"shortest_scale": float(scale.min())}),
    )


def means(time: Array, values: Array, bounds: Array, what: str) -> Means:
    """Mean of a signal in each window.

    Args:
        time: (n,) s, increasing; values: (n,); bounds: (p, 2) s.
        what: name of the signal, for messages.

    Raises:
        InputError: a window without enough samples.
    """
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    first = np.searchsorted(time, bounds[:, 0], side="left")
    beyond = np.searchsorted(time, bounds[:, 1], side="right")
    windows_of_samples = []
    for (start, stop), i, j in zip(bounds, first, beyond, strict=True):
        if j - i < _FEWEST_SAMPLES:
            raise InputError(
                f"{what}: {j - i} samples between {start:.1f} s and {stop:.1f} s, "
                f"expected {_FEWEST_SAMPLES} or more to average"
            )
        windows_of_samples.append((time[i:j], values[i:j]))
    n = np.array([len(v) for _, v in windows_of_samples], dtype=np.float64)
    drift, residuals = [], []
    for t, v in windows_of_samples:
        centred = t - t.mean()
        slope = float(centred @ v) / float(centred @ centred)
        residuals.append(v - v.mean() - slope * centred)
        drift.append(slope * float(t[-1] - t[0]))
    correlated = inflation(autocorrelation(residuals))
    variance = np.array([np.sum(r**2) / (len(r) - 2) for r in residuals])
    pooled = float(np.sum(variance * n) / np.sum(n))
    # Short windows know their own scatter badly and lean on the others'.
    steady = (n * variance + _PRIOR_WEIGHT * pooled) / (n + _PRIOR_WEIGHT)
    noise = np.sqrt(steady * correlated / n)
    step = resolution(values)
    hidden = quantisation_variance(float(np.sqrt(pooled)), step)
    return Means(
        value=np.array([v.mean() for _, v in windows_of_samples]),
        noise=noise,
        hidden=float(np.sqrt(hidden)),
        step=step,
        drift=np.array(drift),
        # A straight line's rise over its window has variance 12 times that of the mean.
        drift_std=np.sqrt(12.0) * noise,
        n=n,
    )


def same_level(voltage: Array, tolerance: float) -> Array:
    """(p, p) ones where two plateaus share a voltage and so the converter's error, else zeros."""
    return (np.abs(voltage[:, None] - voltage[None, :]) < tolerance).astype(np.float64)


# --- Straight pieces of a curve, with as many pieces as the curve is worth.

_MOST = 9
_SHORTEST = 4


@dataclass(frozen=True)
class Piece:
    """Points first..last (included), y = value + slope (x - at)."""

    first: int
    last: int
    at: float
    value: float
    slope: float

    def crossing(self, other: "Piece") -> float:
        """x where two lines meet."""
        at_zero = self.value - self.slope * self.at - other.value + other.slope * other.at
        return at_zero / (other.slope - self.slope)


def straight_pieces(x: Array, y: Array, tolerance: float) -> list[Piece]:
    """Best straight pieces by dynamic programming (Bellman, 1961).

    Args:
        x: (n,) increasing; y: (n,).
        tolerance: rms distance in the unit of y below which more pieces are not worth having.

    Returns:
        The smallest number of pieces whose rms distance is below the tolerance, at most nine.
    """
    n = len(x)
    cost = _costs(x, y)
    best = np.full((_MOST + 1, n + 1), np.inf)
    best[0, 0] = 0.0
    origin = np.zeros((_MOST + 1, n + 1), dtype=int)
    for count in range(1, _MOST + 1):
        for end in range(_SHORTEST, n + 1):
            totals = best[count - 1, : end - _SHORTEST + 1] + cost[: end - _SHORTEST + 1, end]
            origin[count, end] = int(np.argmin(totals))
            best[count, end] = totals[origin[count, end]]
        if best[count, n] <= n * tolerance**2:
            break
    ends = [n]
    for k in range(count, 0, -1):
        ends.append(int(origin[k, ends[-1]]))
    bounds = ends[::-1]
    return [fit_piece(x, y, a, b - 1) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def fit_piece(x: Array, y: Array, first: int, last: int) -> Piece:
    """Least-squares line through points first..last."""
    part = slice(first, last + 1)
    centred = x[part] - x[part].mean()
    slope = float(centred @ y[part]) / float(centred @ centred)
    return Piece(first, last, float(x[part].mean()), float(y[part].mean()), slope)


def _costs(x: Array, y: Array) -> Array:
    """(n + 1, n + 1) sum of squared distances from the line through points first..end - 1."""
    def running(values: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(values)])

    x, y = x - x.mean(), y - y.mean()
    sums: Sequence[Array] = [running(v) for v in (np.ones_like(x), x, y, x * x, x * y, y * y)]
    m, sx, sy, sxx, sxy, syy = (s[None, :] - s[:, None] for s in sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        vxx, vxy, vyy = sxx - sx * sx / m, sxy - sx * sy / m, syy - sy * sy / m
        cost = np.maximum(vyy - np.where(vxx > 0.0, vxy * vxy / vxx, 0.0), 0.0)
    cost[m < _SHORTEST] = np.inf
    return np.asarray(cost)
