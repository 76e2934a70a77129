"""A measured voltage in straight pieces: plateaus, ramps, jumps; and its energy.

Heat depends on the mean square over a cell of time, which is computed exactly. A jump lies
somewhere between two samples, and a level between two steps of the converter is not known exactly:
a fit may move both (nuisances.py)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import coherence, quantisation_variance, resolution
from sma_bench.estimation.pieces import (
    CLEAR,
    FEWEST_IN_LINE,
    ROUNDING,
    TOGGLES,
    independent,
    smoothed,
    straight_and_curved,
)
from sma_bench.records.record import Record

SHORTEST_SEGMENT, FEWEST_SAMPLES = 0.5, 20  # s; of a voltage
_AT_CORNER, _BENT = 2, 3.0  # samples that may lie on neither line; times the noise
# Tolerance of a straight line: times the noise, in steps of the converter, in V.
_TOLERANCE_STD, _TOLERANCE_STEPS, _SMALLEST_TOLERANCE = 8.0, 2.5, 1e-3
_MOST_PIECES = 20_000
# Smallest jump whose moment matters (of the largest voltage); less beyond this sample period [s].
_SMALLEST_JUMP, _OFTEN_READ = 0.05, 0.1
_RAMPS = 0.7  # of all changes: so many equal ones are a commanded ramp
_STRAIGHT, _EXACT = 1.3, 1e-5  # times the noise, about a line; of the range, without noise
_OFF = 5e-3  # V, below it a channel is off
_NARROWEST = 1e-3  # s that jumps of one event have in common
_CLEAR_STEPS = 1.5  # of the converter: a smaller change of level may be its error
_ONE_LEVEL = 0.5  # of the converter's step: nearer levels are the same
_WORTH = 0.5  # of the error of a line's mean: smaller ones are ignored
_SAME_DRIVE = 0.02  # of the largest voltage, between wires with the same voltage
_ALIKE = 4.0  # steps of the converter between the ends of equal ramps


@dataclass(frozen=True)
class VoltageSegment:
    """A stretch of the voltage that one straight line describes."""

    kind: Literal["plateau", "ramp"]
    start: float  # s
    stop: float
    voltage_start: float  # V, of the line
    voltage_stop: float
    # Of a plateau: of the step before it (of the first one: of the step after it).
    direction: Literal["up", "down"]

    @property
    def duration(self) -> float:
        return self.stop - self.start

    @property
    def level(self) -> float:
        return 0.5 * (self.voltage_start + self.voltage_stop)


@dataclass(frozen=True)
class Segments:
    """All plateaus and ramps of a voltage in order, and the edges (s before, s after) of jumps;
    `tolerance` (V) is how far a sample may lie from its line."""

    items: tuple[VoltageSegment, ...]
    edges: tuple[tuple[float, float], ...]
    tolerance: float

    @property
    def plateaus(self) -> tuple[VoltageSegment, ...]:
        return tuple(s for s in self.items if s.kind == "plateau")

    @property
    def ramps(self) -> tuple[VoltageSegment, ...]:
        return tuple(s for s in self.items if s.kind == "ramp")

    def levels(self) -> int:
        levels = np.sort([p.level for p in self.plateaus])
        return min(len(levels), 1) + int(np.sum(np.diff(levels) > self.tolerance))


def find_segments(time: Array, voltage: Array) -> Segments:
    """Cut a voltage (n,) V, noisy or quantised, at increasing times (n,) s, with gaps and jitter or
    not, into straight pieces (Douglas and Peucker, 1973) and sort them. Raises InputError:
    fewer than 20 samples, or values that are not finite."""
    if len(time) < FEWEST_SAMPLES:
        raise InputError(
            f"voltage has {len(time)} samples, expected {FEWEST_SAMPLES} or more to find segments")
    if not (np.all(np.isfinite(voltage)) and np.all(np.isfinite(time))):
        raise InputError("voltage holds values that are not finite, expected V")
    # The median of three drops single wild samples and keeps edges and ramps.
    a, b, c = voltage[:-2], voltage[1:-1], voltage[2:]
    smooth = voltage.astype(np.float64)
    smooth[1:-1] = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    # A channel that is switched off may read exactly 0, which says nothing about its noise.
    second = np.diff(voltage, 2)
    driven = second[voltage[1:-1] != 0.0]
    second = driven if len(driven) else second
    noise = 1.4826 * float(np.median(np.abs(second - np.median(second)))) / np.sqrt(6.0)
    tolerance = max(_TOLERANCE_STD * noise, _TOLERANCE_STEPS * _step_of(voltage),
                    _SMALLEST_TOLERANCE)
    span = float(np.ptp(smooth))
    while True:
        # Join neighbours that one line describes as well: the chords end on noisy samples.
        pieces: list[tuple[int, int]] = []
        for piece in _split(time, smooth, tolerance):
            while pieces:
                first, last = pieces[-1][0], piece[1]
                is_edge = any(b - a == 1 for a, b in (pieces[-1], piece))
                if _line(time, smooth, first, last)[2] > tolerance / (2.0 if is_edge else 1.0):
                    break
                pieces.pop()
                piece = (first, last)
            pieces.append(piece)
        # A ramp commanded in small steps falls into crumbs, tiny plateaus: raise the tolerance.
        crumbs = longest = 0.0
        for first, last in pieces:
            length = float(time[last] - time[first])
            crumbs = crumbs + length if length < SHORTEST_SEGMENT else 0.0
            longest = max(longest, crumbs)
        if tolerance > span / 8.0 or longest <= 2.0 * SHORTEST_SEGMENT:
            break
        tolerance *= 2.0

    # Plateaus, ramps and edges; the direction of a plateau is that of the step before it.
    edges = tuple((float(time[first]), float(time[last])) for first, last in pieces
                  if last - first == 1 and abs(smooth[last] - smooth[first]) > tolerance)
    lines = [(float(time[first]), float(time[last]), *_line(time, smooth, first, last)[:2])
             for first, last in pieces if time[last] - time[first] >= SHORTEST_SEGMENT]
    flat = [abs(end - begin) <= tolerance for _, _, begin, end in lines]
    levels = [0.5 * (b + e) for (_, _, b, e), is_flat in zip(lines, flat, strict=True) if is_flat]
    steps = np.diff(levels).tolist()
    rises = iter([*steps[:1], *steps] or [0.0])  # of plateaus
    items = []
    for (start, stop, begin, end), is_flat in zip(lines, flat, strict=True):
        direction: Literal["up", "down"] = (
            "up" if (next(rises) if is_flat else end - begin) >= 0.0 else "down")
        kind: Literal["plateau", "ramp"] = "plateau" if is_flat else "ramp"
        items.append(VoltageSegment(kind, start, stop, begin, end, direction))
    return Segments(tuple(items), edges, tolerance)


def _step_of(voltage: Array) -> float:
    """Step of the converter [V]; 0 for a commanded ramp, whose steps are all equal."""
    moves = np.diff(voltage)
    again = np.abs(np.diff(moves)) < _EXACT * float(np.ptp(voltage))
    going = moves[:-1] != 0.0
    return 0.0 if going.any() and np.mean(again[going]) > _RAMPS else resolution(voltage)


def _split(time: Array, voltage: Array, tolerance: float) -> list[tuple[int, int]]:
    """Index pairs (first, last) of chords that stay within the tolerance of all samples."""
    pieces: list[tuple[int, int]] = []
    stack = [(0, len(time) - 1)]
    while stack and len(pieces) < _MOST_PIECES:
        first, last = stack.pop()
        inner = slice(first + 1, last)
        share = (time[inner] - time[first]) / max(time[last] - time[first], 1e-12)
        chord = voltage[first] + share * (voltage[last] - voltage[first])
        away = np.abs(voltage[inner] - chord)
        if len(away) and away.max() > tolerance:
            middle = first + 1 + int(np.argmax(away))
            stack.extend([(middle, last), (first, middle)])
        else:
            pieces.append((first, last))
    return pieces


def _line(time: Array, voltage: Array, first: int, last: int) -> tuple[float, float, float]:
    """Ends of the least-squares line through samples first..last, and the largest distance."""
    t, v = time[first : last + 1], voltage[first : last + 1]
    centred = t - t.mean()
    slope = float(centred @ v) / max(float(centred @ centred), 1e-12)
    fitted = v.mean() + slope * centred
    return float(fitted[0]), float(fitted[-1]), float(np.max(np.abs(v - fitted)))


def _energy(begin: Array, end: Array, duration: Array) -> Array:
    """Integral of V^2 [V2 s] over straight stretches."""
    return np.asarray((begin**2 + begin * end + end**2) / 3.0 * duration, dtype=np.float64)


@dataclass(frozen=True)
class Polygon:
    """Voltage of one channel: knots, and straight lines between them."""

    time: Array  # (k,) s
    voltage: Array  # (k,) V, straight stretches freed of their noise
    jumps: IntArray  # (j,) knots after which the voltage jumps before the next one
    lines: tuple[tuple[int, int, float], ...]  # first and last knot, and noise [V] of the samples
    hidden: float  # V, amplitude of the converter's error that no averaging removes
    step: float  # V, of the converter
    commanded: Array | None = None  # (k,) V at the knots, if recorded

    def energy(self, moments: Array, grid: Array, error: Array | None = None) -> Array:
        """Integral of V^2 [V2 s] over each cell of `grid` (n,), as (n - 1,), with jumps at these
        `moments` (j,) s; `error`: (k,) V, added to the knots."""
        at = self.jumps + 1
        volts = self.voltage if error is None else self.voltage + error
        order = np.repeat(at, 2)
        time = np.insert(self.time, order, np.repeat(moments, 2))
        # A ramp continues up to the jump that ends it.
        rising, falling = self._slopes_at_jumps
        ends = np.column_stack([volts[at - 1] + rising * (moments - self.time[at - 1]),
                                volts[at] + falling * (moments - self.time[at])])
        level = np.insert(volts, order, ends.ravel())
        before, after = min(grid[0], time[0]) - 1.0, max(grid[-1], time[-1]) + 1.0
        time = np.concatenate([[before], time, [after]])
        level = np.concatenate([level[:1], level, level[-1:]])
        total = np.append(0.0, np.cumsum(_energy(level[:-1], level[1:], np.diff(time))))
        # Up to each grid time: all stretches before it, and a part of its own.
        k = np.searchsorted(time, grid, side="right") - 1
        here = level[k] + (level[k + 1] - level[k]) * (grid - time[k]) / (time[k + 1] - time[k])
        return np.diff(total[k] + _energy(level[k], here, grid - time[k]))

    @cached_property
    def _slopes_at_jumps(self) -> tuple[Array, Array]:
        """(j,) V/s before and after each jump, 0 where the voltage is not straight there."""
        slope = np.zeros(len(self.time))
        for first, last, _ in self.lines:
            rise, run = (x[last - 1] - x[first] for x in (self.voltage, self.time))
            slope[first:last] = rise / run
        return slope[self.jumps], slope[self.jumps + 1]


@dataclass(frozen=True)
class AppliedVoltage:
    """Voltages of all channels of a record, and the moments of their common jumps: `early`, `late`
    (e,) s: the last sample before each event and the first one after it, the narrowest over the
    channels; `events` gives each channel's jumps their event."""

    channels: tuple[Polygon, ...]
    events: tuple[IntArray, ...]
    early: Array
    late: Array

    def at(self, channel: int, time: Array) -> Array:
        """(m,) V of a channel at `time` (m,) s, without noise."""
        polygon = self.channels[channel]
        return np.interp(time, polygon.time, polygon.voltage)

    def level_errors(self, own: bool = False) -> list[tuple[Array, ...]]:
        """(k,) V a channel: one standard error of each held level in turn that averaging does not
        remove, common to all stretches at it; the mean one of all levels, or by `own` samples."""
        held = []
        for channel, polygon in enumerate(self.channels):
            for first, last, noise in polygon.lines:
                volts = polygon.voltage[first:last]
                least = max(polygon.step, _OFF)
                if polygon.hidden > 0.0 and np.ptp(volts) < polygon.step and volts.min() > least:
                    held.append((float(volts.mean()), channel, first, last, noise))
        errors: list[tuple[Array, ...]] = []
        reached = -np.inf
        for level, channel, first, last, noise in sorted(held):
            polygon = self.channels[channel]
            step, std = polygon.step, polygon.hidden / np.sqrt(2.0)
            if level - reached > _ONE_LEVEL * step:
                errors.append(self._no_error())
                reached = level
            if own and noise > TOGGLES * step:
                std = float(np.sqrt(quantisation_variance(noise, step)))
            elif own:
                # Of readings that toggle between two codes the level may lie anywhere from their
                # mean, if noise makes them toggle, to the middle between the codes, without any.
                std = step * abs(0.5 - level / step % 1.0) / np.sqrt(3.0)
            errors[-1][channel][first:last] = std
        return errors

    def line_errors(self) -> list[tuple[Array, ...]]:
        """(k,) V a channel: one standard error of the mean and of the slope of each straight
        stretch in turn, from the noise of its samples; and errors by the converter."""
        errors: list[tuple[Array, ...]] = []
        # Equal ramps share their errors: their ends in steps of the converter, and the errors.
        alike: list[tuple[Array, dict[int, tuple[Array, ...]]]] = []
        for channel, polygon in enumerate(self.channels):
            step = polygon.step
            for first, last, noise in polygon.lines:
                n, volts = last - first, polygon.voltage[first:last]
                if noise != 0.0 and volts.max() > max(step, _OFF):
                    std = noise / np.sqrt(independent(n, noise, step, float(np.ptp(volts))))
                    for shape in _straight(n):
                        knots = self._no_error()
                        knots[channel][first:last] = std * shape
                        errors.append(knots)
                # A ramp is commanded in small jumps. Where these are whole steps of the converter,
                # or nearly, every sample has the same error and no scatter shows it; else the
                # errors cancel.
                ends = volts[[0, -1]] / (step or 1.0)
                near = (own for other, own in alike if np.max(np.abs(ends - other)) < _ALIKE)
                own = next(near, None)
                if own is None:
                    own = {}
                    alike.append((ends, own))
                if step == 0.0 or polygon.commanded is None or np.ptp(volts) < step:
                    continue
                for number, shape in enumerate(_straight(n)):
                    left = coherence(polygon.commanded[first:last], step, shape)
                    std = float(np.sqrt(quantisation_variance(0.0, step, left)))
                    if std > _WORTH * noise / np.sqrt(n):
                        own.setdefault(number, self._no_error())[channel][first:last] = std * shape
        ramps = [error for _, own in alike for error in own.values()]
        return [*errors, *ramps, *self.level_errors(own=True)]

    def _no_error(self) -> tuple[Array, ...]:
        return tuple(np.zeros(len(c.time)) for c in self.channels)

    def is_jumping(self, time: Array) -> NDArray[np.bool_]:
        """(m,) whether `time` (m,) s lies strictly within the bounds of an event."""
        event = np.searchsorted(self.early, time, side="left") - 1
        inside = event >= 0
        inside[inside] = time[inside] < self.late[event[inside]]
        return np.asarray(inside)

    def on_grid(self, grid: Array, place: Array, errors: Sequence[Array] | None = None) -> Array:
        """Voltages (n, w) V which, held from each grid time to the next, heat as the true ones.
        `place`: (e,) of the jumps, from -0.5 (just after `early`) to 0.5 (just before `late`);
        `errors`: (k,) V, added to the knots of each channel."""
        moments = 0.5 * (self.early + self.late) + place * (self.late - self.early)
        columns = []
        for channel, (polygon, own) in enumerate(zip(self.channels, self.events, strict=True)):
            error = None if errors is None else errors[channel]
            energy = polygon.energy(moments[own], grid, error)
            columns.append(np.sqrt(np.maximum(energy, 0.0) / np.diff(grid)))
        volts = np.column_stack(columns)
        return np.vstack([volts, volts[-1:]])


def commands_of(record: Record, channels: tuple[str, ...],
                known: tuple[str, ...]) -> tuple[Array, Array] | None:
    """(c,) s and (c, w) V commanded, where the record has all the `known` channels, in order."""
    signal = record.get("voltage_command")
    known = known if set(channels) <= set(known) else channels
    if signal is None or signal.values.ndim != 2 or signal.values.shape[1] != len(known):
        return None
    return signal.time, signal.values[:, [known.index(channel) for channel in channels]]


def applied_voltage(channels: Sequence[tuple[Array, Array]],
                    commands: tuple[Array, Array] | None = None) -> AppliedVoltage:
    """Prepare measured voltages: of each channel (time (n,) s, voltage (n,) V); `commands`: (c,) s
    and (c, w) V that were commanded, held until the next, if known. Raises InputError: too few
    samples, or values that are not finite."""
    polygons = []
    for k, (time, voltage) in enumerate(channels):
        commanded = None
        if commands is not None:  # the last one before each time, 0 before the first
            commanded = np.append(0.0, commands[1][:, k])
            commanded = commanded[np.searchsorted(commands[0], time, side="right")]
        polygons.append(_polygon(time, voltage, commanded))
    # Jumps of several channels that can have been one command are one event.
    found = sorted((*polygon.time[knot : knot + 2], channel, order)
                   for channel, polygon in enumerate(polygons)
                   for order, knot in enumerate(polygon.jumps))
    bounds: list[list[float]] = []
    events = [np.zeros(len(polygon.jumps), dtype=np.int64) for polygon in polygons]
    for before, after, channel, order in found:
        if bounds and before < bounds[-1][1] - _NARROWEST:
            bounds[-1] = [max(before, bounds[-1][0]), min(after, bounds[-1][1])]
        else:
            bounds.append([before, after])
        events[channel][order] = len(bounds) - 1
    edges = np.array(bounds, dtype=np.float64).reshape(-1, 2)
    return AppliedVoltage(tuple(polygons), tuple(events), edges[:, 0], edges[:, 1])


def _straight(n: int) -> tuple[Array, Array]:
    """(n,) each: a mean and a slope, of unit rms."""
    return np.ones(n), np.sqrt(3.0) * np.linspace(-1.0, 1.0, n)


def _polygon(time: Array, voltage: Array, commanded: Array | None) -> Polygon:
    segments = find_segments(time, voltage)
    step = _step_of(voltage)
    # A level between two steps of the converter toggles by half a step about its mean.
    second = np.diff(voltage, 2)[voltage[1:-1] > _OFF]
    robust = 1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0) if len(second) else 0.0
    limit = _STRAIGHT * float(np.hypot(max(robust, step / np.sqrt(12.0)), 0.5 * step))
    limit = max(limit, _EXACT * float(np.ptp(voltage)))
    # Straight lines where the voltage is straight: first and last knot, and scatter, of each.
    smooth = voltage.copy()
    lines = []
    spans = {}
    for s in segments.items:
        begin, end = np.searchsorted(time, [s.start, s.stop + 1e-9]).tolist()
        spans[begin, end] = s
    pieces = [(*span, s.kind == "ramp") for span, s in spans.items()]
    straight, curved = straight_and_curved(time, voltage, pieces, step)
    for begin, end in curved:
        coarse = step if robust < TOGGLES * step else 0.0
        smooth[begin:end] = smoothed(time[begin:end], voltage[begin:end], coarse)
    for begin, end in straight:
        if end - begin < FEWEST_IN_LINE:
            continue
        ends = _line(time, voltage, begin, end - 1)[:2]
        if known := spans.get((begin, end)):
            ends = known.voltage_start, known.voltage_stop
        line = np.interp(time[begin:end], time[[begin, end - 1]], ends)
        line = line + _bend(voltage[begin:end] - line, step)
        parts, line = _levels(voltage[begin:end], line, step)
        for first, last in parts:
            scatter = float(np.std(voltage[begin + first : begin + last] - line[first:last]))
            if scatter < limit:
                smooth[begin + first : begin + last] = line[first:last]
                lines.append((int(begin + first), int(begin + last), scatter))
    left = [n for first, last, n in lines if smooth[first:last].max() > max(step, _OFF)]
    within = float(np.sqrt(np.mean(np.square(left)))) if left else 0.0
    hidden = float(np.sqrt(2.0 * quantisation_variance(within, step)))
    knots = np.searchsorted(time, [before for before, _ in segments.edges])
    size = np.abs(smooth[np.minimum(knots + 1, len(smooth) - 1)] - smooth[knots])
    least = _SMALLEST_JUMP * min(1.0, _OFTEN_READ / float(np.median(np.diff(time))))
    knots = knots[size > least * float(np.max(np.abs(smooth), initial=0.0))]
    whole = Polygon(time, smooth, np.unique(knots), tuple(lines), hidden, step, commanded)
    return _with_corners(whole, voltage)


def _with_corners(polygon: Polygon, voltage: Array) -> Polygon:
    """With a knot, maybe between two samples, where one straight stretch turns into the next
    without a jump: where the lines meet that are fitted without the samples next to it."""
    time, smooth = polygon.time, polygon.voltage.copy()
    lines, corners = list(polygon.lines), dict[int, tuple[float, float]]()
    least = polygon.step + _EXACT * float(np.ptp(voltage))
    for k, ((a, a_end, left), (b, b_end, right)) in enumerate(pairwise(polygon.lines)):
        parts = (a + _AT_CORNER, a_end - _AT_CORNER), (b + _AT_CORNER, b_end - _AT_CORNER)
        if b > a_end + _AT_CORNER or min(end - begin for begin, end in parts) < FEWEST_IN_LINE:
            continue
        rise, fall = (np.polyfit(time[i:j], voltage[i:j], 1) for i, j in parts)
        if any(np.max(np.abs(np.polyval(line, time[i:j]) - smooth[i:j])) > _BENT * noise + least
               for line, (i, j), noise in zip((rise, fall), parts, (left, right), strict=True)):
            continue
        at = float((fall[1] - rise[1]) / (rise[0] - fall[0])) if rise[0] != fall[0] else np.inf
        before = int(np.searchsorted(time, at)) - 1
        # Noise displaces a corner as far as it hides the difference of the two lines.
        far = (_BENT * max(left, right) + least) / max(abs(rise[0] - fall[0]), _EXACT)
        is_near = lines[k][0] < before < b_end - 2 and abs(at - time[b]) < far
        if not (is_near or a_end - _AT_CORNER <= before + 1 <= b + _AT_CORNER):
            continue
        for line, begin, end in ((rise, parts[0][1], before + 1), (fall, before + 1, parts[1][0])):
            smooth[begin:end] = np.polyval(line, time[begin:end])
        corners[before + 1] = at, float(np.polyval(rise, at))
        lines[k] = (lines[k][0], before + 1, lines[k][2])
        lines[k + 1] = (before + 1, *lines[k + 1][1:])
    places = np.array(sorted(corners), dtype=np.intp)
    moments, levels = np.array([corners[p] for p in places.tolist()]).reshape(-1, 2).T
    held = polygon.commanded
    within = np.zeros(len(polygon.jumps), dtype=bool)  # True: within a line
    for first, last, _ in lines:
        within |= (polygon.jumps >= first) & (polygon.jumps + 1 < last)

    def moved(index: IntArray | int) -> IntArray:
        return np.asarray(index + np.searchsorted(places, index, side="right"))

    return replace(
        polygon, time=np.insert(time, places, moments), voltage=np.insert(smooth, places, levels),
        jumps=moved(polygon.jumps[~np.isin(polygon.jumps + 1, places) & ~within]),
        lines=tuple((int(moved(i)), int(moved(j - 1)) + 1, noise) for i, j, noise in lines),
        commanded=None if held is None else np.insert(held, places, held[places - 1]))


def _levels(volts: Array, line: Array, step: float) -> tuple[list[tuple[int, int]], Array]:
    """Levels in a stretch: first sample and the one after the last, and volts (n,) of all. The
    whole stretch and its line, unless two levels clearly fit better."""
    n = len(volts)
    count = np.arange(FEWEST_IN_LINE, n - FEWEST_IN_LINE + 1)
    if len(count) == 0:
        return [(0, n)], line
    away = volts - volts.mean()
    height = np.abs(np.cumsum(away)[count - 1]) * n / (count * (n - count))
    gain = height**2 * count * (n - count) / n
    k = int(np.argmax(gain))
    levels = float(away @ away) - float(gain[k])
    nearer = float(np.sum((volts - line) ** 2)) - levels
    least = max(_CLEAR_STEPS * step, ROUNDING * float(np.max(np.abs(volts))))
    if nearer <= CLEAR**2 * levels / n or height[k] < least:
        return [(0, n)], line
    spans, levelled = [], []
    for first, last in ((0, int(count[k])), (int(count[k]), n)):
        level = np.full(last - first, volts[first:last].mean())
        parts, own = _levels(volts[first:last], level, step)
        spans += [(first + a, first + b) for a, b in parts]
        levelled.append(own)
    return spans, np.concatenate(levelled)


def _bend(left: Array, step: float) -> Array:
    """(n,) V, parabola in the residual of a line; 0 if it may be noise or the converter's."""
    bow = np.square(np.linspace(-1.0, 1.0, len(left)))
    bow -= bow.mean()
    power = float(bow @ bow)
    depth = float(bow @ left) / power
    bent = abs(depth) > max(0.5 * step, CLEAR * float(np.std(left - depth * bow)) / np.sqrt(power))
    return depth * bow if bent else np.zeros(len(left))


def alike_by_side(volts: Array, sides: Sequence[str]) -> Array:
    """Voltages (n, w), averaged over each side on which they differ only by a voltmeter's error:
    one wire then stands for all of its side."""
    found = volts.copy()
    for side in set(sides):
        own = [k for k, one in enumerate(sides) if one == side]
        if np.max(np.ptp(volts[:, own], axis=1)) < _SAME_DRIVE * np.max(volts):
            found[:, own] = np.sqrt(np.mean(volts[:, own] ** 2, axis=1))[:, np.newaxis]
    return found
