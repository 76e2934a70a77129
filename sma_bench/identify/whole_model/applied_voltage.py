"""The heating that measured voltages stand for: mean squares over cells of time, jumps placed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.identify.estimate import Array
from sma_bench.identify.noise import quantisation_variance, resolution
from sma_bench.identify.segments import Segments, find_segments

_SMALLEST_JUMP = 0.05  # of the largest voltage; less heats too little to be misplaced
_STRAIGHT = 1.3
_FEWEST_IN_LINE = 10
_OFF = 5e-3  # V, below it a channel is off
_NARROWEST = 1e-3
_ONE_LEVEL = 0.5  # of the converter's step: what is nearer is one level


@dataclass(frozen=True)
class Course:
    """Voltage of one channel as knots of a polygon.

    Attributes:
        time: (k,) s; voltage: (k,) V, straight stretches freed of their noise.
        jumps: (j,) knots after which the voltage jumps before the next one.
        noise: (k,) V, white error of each knot.
        lines: first and last knot of each straight stretch, and the noise [V] of its samples.
        hidden, step: V, amplitude of the converter's error that no averaging removes, and its step.
    """

    time: Array
    voltage: Array
    jumps: Array
    noise: Array
    lines: tuple[tuple[int, int, float], ...]
    hidden: float
    step: float

    def energy(self, moments: Array, grid: Array, error: "CourseError | None" = None) -> Array:
        """Integral of V^2 [V2 s] over each cell of `grid` (n,), as (n - 1,).

        Args:
            moments: (j,) s at which the jumps happen.
            error: added to what was measured.
        """
        at = self.jumps.astype(np.intp) + 1
        volts = self.voltage if error is None else self.voltage + error.knots
        order = np.repeat(at, 2)
        time = np.insert(self.time, order, np.repeat(moments, 2))
        level = np.insert(volts, order, np.column_stack([volts[at - 1], volts[at]]).ravel())
        before, after = min(grid[0], time[0]) - 1.0, max(grid[-1], time[-1]) + 1.0
        time = np.concatenate([[before], time, [after]])
        level = np.concatenate([level[:1], level, level[-1:]])
        square = (level[1:] ** 2 + level[1:] * level[:-1] + level[:-1] ** 2) / 3.0
        if error is not None:
            change = np.diff(level[1:-1] ** 2)
            square[1:-1] += change * np.insert(error.moments, order, 0.0)[1:]
        total = np.concatenate([[0.0], np.cumsum(square * np.diff(time))])
        return np.diff(np.interp(grid, time, total))

    def hidden_levels(self) -> list[tuple[int, int, float]]:
        """First and last knot, and volts, of each held level that is not known to the last bit."""
        levels = []
        for first, last, _ in self.lines:
            volts = self.voltage[first:last]
            if self.hidden > 0.0 and np.ptp(volts) < self.step and volts.min() > max(
                self.step, _OFF
            ):
                levels.append((first, last, float(volts.mean())))
        return levels

    def draw_error(self, random: np.random.Generator, phase: float) -> "CourseError":
        """One possible error; `phase` (0 to 1) says where the converter's steps lie."""
        knots = self.noise * random.standard_normal(len(self.time))
        for first, last, noise in self.lines:
            # Errors of a fitted line: of its mean, and of its slope about the middle.
            level, tilt = noise / np.sqrt(last - first) * random.standard_normal(2)
            knots[first:last] = level + np.sqrt(3.0) * tilt * np.linspace(-1.0, 1.0, last - first)
            if self.step > 0.0:
                turns = self.voltage[first:last] / self.step + phase
                knots[first:last] += self.hidden * np.sin(2.0 * np.pi * turns)
        knots[self.voltage <= max(self.step, _OFF)] = 0.0
        stepped = self.noise > 0.0
        late = random.standard_normal(len(knots)) / np.sqrt(12.0)
        return CourseError(knots, np.where(stepped, late, 0.0))


@dataclass(frozen=True)
class CourseError:
    """A possible error of a measured voltage.

    `knots` (k,) V; `moments` (k,) by which share of the interval before each knot a voltage that
    is commanded in small steps has changed earlier or later than the straight line says.
    """

    knots: Array
    moments: Array

    @classmethod
    def none(cls, knots: int) -> "CourseError":
        """No error of a course of so many knots."""
        return cls(np.zeros(knots), np.zeros(knots))


@dataclass(frozen=True)
class AppliedVoltage:
    """Voltages of all channels of a record, and the moments of their common jumps.

    `early`, `late` (e,) s: the last sample before each event and the first one after it, the
    narrowest over the channels; `events` gives each channel's jumps their event.
    """

    courses: tuple[Course, ...]
    events: tuple[Array, ...]
    early: Array
    late: Array

    def moments(self, place: Array) -> Array:
        """(e,) s; `place` (e,) from -0.5 (just after `early`) to 0.5 (just before `late`)."""
        return 0.5 * (self.early + self.late) + place * (self.late - self.early)

    def at(
        self, channel: int, time: Array, errors: Sequence[CourseError] | None = None
    ) -> Array:
        """(m,) V of a channel at `time` (m,) s, freed of noise."""
        course = self.courses[channel]
        volts = course.voltage if errors is None else course.voltage + errors[channel].knots
        return np.interp(time, course.time, volts)

    def draw_errors(self, random: np.random.Generator) -> tuple[CourseError, ...]:
        """One possible error of each channel.

        Channels at one voltage share what the steps of the converter hide of it.
        """
        phase = random.uniform()
        return tuple(course.draw_error(random, phase) for course in self.courses)

    def level_errors(self) -> list[tuple[CourseError, ...]]:
        """One standard error of each held level in turn, of all channels held at it."""
        held = sorted(
            (level, channel, first, last)
            for channel, course in enumerate(self.courses)
            for first, last, level in course.hidden_levels()
        )
        errors: list[tuple[CourseError, ...]] = []
        reached = -np.inf
        for level, channel, first, last in held:
            course = self.courses[channel]
            if level - reached > _ONE_LEVEL * course.step:
                errors.append(tuple(CourseError.none(len(c.time)) for c in self.courses))
                reached = level
            errors[-1][channel].knots[first:last] = course.hidden / np.sqrt(2.0)
        return errors

    def is_jumping(self, time: Array) -> NDArray[np.bool_]:
        """(m,) whether `time` (m,) s lies strictly within the bounds of an event."""
        event = np.searchsorted(self.early, time, side="left") - 1
        inside = event >= 0
        inside[inside] = time[inside] < self.late[event[inside]]
        return np.asarray(inside)

    def on_grid(
        self, grid: Array, place: Array, errors: Sequence[CourseError] | None = None
    ) -> Array:
        """Voltages (n, w) V which, held from each grid time to the next, heat as the true ones."""
        moments = self.moments(place)
        columns = []
        for channel, (course, own) in enumerate(zip(self.courses, self.events, strict=True)):
            error = None if errors is None else errors[channel]
            energy = course.energy(moments[own.astype(np.intp)], grid, error)
            columns.append(np.sqrt(np.maximum(energy, 0.0) / np.diff(grid)))
        volts = np.column_stack(columns)
        return np.vstack([volts, volts[-1:]])


def applied_voltage(channels: Sequence[tuple[Array, Array]]) -> AppliedVoltage:
    """Prepare measured voltages.

    Args:
        channels: (time (n,) s, voltage (n,) V) of each channel.

    Raises:
        InputError: too few samples, or values that are not finite.
    """
    courses = tuple(_course(*channel) for channel in channels)
    return AppliedVoltage(courses, *_events(courses))


def _course(time: Array, voltage: Array) -> Course:
    segments = find_segments(time, voltage)
    step = resolution(voltage)
    scatter = _scatter(voltage, step)
    # A level between two steps of the converter toggles by half a step about its mean.
    limit = _STRAIGHT * float(np.hypot(scatter, 0.5 * step))
    smooth, noise, lines = _free_of_noise(time, voltage, segments, scatter, limit)
    left = [n for first, last, n in lines if smooth[first:last].max() > max(step, _OFF)]
    within = float(np.sqrt(np.mean(np.square(left)))) if left else 0.0
    hidden = float(np.sqrt(2.0 * quantisation_variance(within, step)))
    return Course(time, smooth, _jumps(time, smooth, segments), noise, lines, hidden, step)


def _scatter(voltage: Array, step: float) -> float:
    """Noise [V] of the driven samples, its converter's included."""
    second = np.diff(voltage, 2)[voltage[1:-1] > _OFF]
    robust = 1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0) if len(second) else 0.0
    return max(robust, step / np.sqrt(12.0))


def _free_of_noise(
    time: Array, voltage: Array, segments: Segments, scatter: float, limit: float
) -> tuple[Array, Array, tuple[tuple[int, int, float], ...]]:
    """Straight lines where the voltage is straight.

    Noise on a plateau would make temperatures turn back and forth, and hysteresis with them.
    """
    smooth, noise = voltage.copy(), np.full(len(voltage), scatter)
    lines = []
    for segment in segments.items:
        first, last = np.searchsorted(time, [segment.start, segment.stop + 1e-9])
        line = np.interp(
            time[first:last], [segment.start, segment.stop],
            [segment.voltage_start, segment.voltage_stop],
        )
        left = float(np.std(voltage[first:last] - line))
        if last - first >= _FEWEST_IN_LINE and left < limit:
            smooth[first:last], noise[first:last] = line, 0.0
            lines.append((int(first), int(last), left))
    return smooth, noise, tuple(lines)


def _jumps(time: Array, voltage: Array, segments: Segments) -> Array:
    knots = np.searchsorted(time, [before for before, _ in segments.edges])
    size = np.abs(voltage[np.minimum(knots + 1, len(voltage) - 1)] - voltage[knots])
    knots = knots[size > _SMALLEST_JUMP * float(np.max(np.abs(voltage), initial=0.0))]
    return np.unique(knots).astype(np.float64)


def _events(courses: tuple[Course, ...]) -> tuple[tuple[Array, ...], Array, Array]:
    """Jumps of several channels that can have been one command are one event."""
    found = sorted(
        (course.time[knot], course.time[knot + 1], channel, order)
        for channel, course in enumerate(courses)
        for order, knot in enumerate(course.jumps.astype(np.intp))
    )
    bounds: list[list[float]] = []
    events = [np.zeros(len(course.jumps)) for course in courses]
    for before, after, channel, order in found:
        if bounds and before < bounds[-1][1] - _NARROWEST:
            bounds[-1] = [max(before, bounds[-1][0]), min(after, bounds[-1][1])]
        else:
            bounds.append([before, after])
        events[channel][order] = len(bounds) - 1
    edges = np.array(bounds, dtype=np.float64).reshape(-1, 2)
    return tuple(events), edges[:, 0], edges[:, 1]
