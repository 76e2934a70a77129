"""Output-error fit of the heat equation (2) to temperatures under a measured voltage."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sma_bench.estimation.noise_model import autocorrelation
from sma_bench.identify.estimate import Array, Indices

# --- response to a sampled voltage, exact for straight lines between the samples

# exp() of the elapsed time over tau must stay finite within a block.
_LONGEST_BLOCK = 200.0
# Samples on either side of a jump that tell how the voltage runs up to it.
_TREND = 8


@dataclass(frozen=True)
class VoltageCourse:
    """A voltage in straight pieces: piece k runs from start[k] to start[k] + length[k] in s.

    It begins at `voltage[k]` V and changes by `slope[k]` V/s; (p,) arrays, pieces adjoin.
    """

    start: Array
    length: Array
    voltage: Array
    slope: Array


def course_from_samples(
    time: Array, voltage: Array, edges: Indices, edge_times: Array
) -> VoltageCourse:
    """Straight lines between the samples; at an edge either side runs on to the jump.

    Args:
        time: (n,) s, increasing; voltage: (n,) V.
        edges: (e,) indices k of samples after which the voltage jumps before sample k + 1.
        edge_times: (e,) s of the jumps, each between its two samples.
    """
    lines = np.ones(len(time) - 1, dtype=bool)
    lines[edges] = False
    start = np.concatenate([time[:-1][lines], time[edges], edge_times])
    stop = np.concatenate([time[1:][lines], edge_times, time[edges + 1]])
    # A trend ends at the neighbouring jumps.
    behind = np.concatenate([[-1], edges, [len(time) - 1]]) + 1
    first = np.maximum(edges - _TREND, behind[:-2])
    last = np.minimum(edges + 2 + _TREND, behind[2:])
    before = np.array([_trend(time, voltage, f, k + 1) for f, k in zip(first, edges, strict=True)])
    after = np.array([_trend(time, voltage, k + 1, n) for n, k in zip(last, edges, strict=True)])
    landing = voltage[edges + 1] - after * (time[edges + 1] - edge_times)
    value = np.concatenate([voltage[:-1][lines], voltage[edges], landing])
    slope = np.concatenate([np.diff(voltage)[lines] / np.diff(time)[lines], before, after])
    order = np.argsort(start, kind="stable")
    return VoltageCourse(start[order], (stop - start)[order], value[order], slope[order])


def _trend(time: Array, voltage: Array, first: int, last: int) -> float:
    """Slope in V/s through samples first .. last - 1, 0 for a single one."""
    t, v = time[first:last], voltage[first:last]
    if len(t) < 2:
        return 0.0
    centred = t - t.mean()
    return float(centred @ v) / float(centred @ centred)


def temperature_rise(
    course: VoltageCourse, gain: float, tau: float, initial: float, at: Array
) -> Array:
    """Temperature above ambient in K: tau dx/dt = -x + gain V(t)^2, x = initial at the start.

    Within a piece V = a + b s and x = gain [V^2 - 2 b tau V + 2 b^2 tau^2] + c exp(-s/tau).

    Args:
        course: the voltage.
        gain: 1/(R h A_c) in K/V^2.
        tau: m c_p/(h A_c) in s.
        initial: K above ambient when the course begins.
        at: (m,) s, any order; earlier than the course gives `initial`.
    """
    end_voltage = course.voltage + course.slope * course.length
    begin = _particular(course.voltage, course.slope, gain, tau)
    end = _particular(end_voltage, course.slope, gain, tau)
    decay = course.length / tau
    state = _propagate(decay, end - begin * np.exp(-decay), initial)
    piece = np.clip(np.searchsorted(course.start, at, side="right") - 1, 0, None)
    since = np.maximum(at - course.start[piece], 0.0)
    local = _particular(
        course.voltage[piece] + course.slope[piece] * since, course.slope[piece], gain, tau
    )
    return np.asarray(local + (state[piece] - begin[piece]) * np.exp(-since / tau))


def _particular(voltage: Array, slope: Array, gain: float, tau: float) -> Array:
    lag = slope * tau
    return np.asarray(gain * (voltage**2 - 2.0 * lag * voltage + 2.0 * lag**2))


def _propagate(decay: Array, forcing: Array, initial: float) -> Array:
    """x[k+1] = exp(-decay[k]) x[k] + forcing[k], x[0] = initial; returns x at each piece's start.

    Blocks of a running sum replace the loop.
    """
    elapsed = np.concatenate([[0.0], np.cumsum(decay)])
    state = np.empty(len(decay) + 1)
    state[0] = initial
    first = 0
    while first < len(decay):
        stop = int(np.searchsorted(elapsed, elapsed[first] + _LONGEST_BLOCK, side="right"))
        last = max(min(stop, len(decay)), first + 1)
        since = elapsed[first + 1 : last + 1] - elapsed[first]
        if last == first + 1:
            state[last] = np.exp(-since[0]) * state[first] + forcing[first]
        else:
            grown = np.cumsum(forcing[first:last] * np.exp(since))
            state[first + 1 : last + 1] = np.exp(-since) * (state[first] + grown)
        first = last
    return state[:-1]


# --- the fit

# Order of the unknowns that all windows share; each window adds its own after them.
SPECIFIC_HEAT, HEAT_TRANSFER, RESISTANCE, DELAY = range(4)
SHARED = 4
_AMBIENT, _INITIAL, _FIRST_EDGE = range(3)
_INITIAL_STD = 5.0
_EDGE_STD = 1.0 / math.sqrt(12.0)
_LAST_EDGE = 0.49
_STEP = 1e-5
_PASSES = 3
_ENOUGH = 1e-7


@dataclass(frozen=True)
class Window:
    """One stretch of a record: a drive with what comes before and after it.

    Times in s, voltage in V, temperature in K; `edges` (e,) are indices into the voltage after
    which it jumps.
    """

    voltage_time: Array
    voltage: Array
    temperature_time: Array
    temperature: Array
    edges: Indices

    @property
    def unknowns(self) -> int:
        """Ambient, initial temperature, and the true moment of every jump."""
        return _FIRST_EDGE + len(self.edges)


@dataclass(frozen=True)
class Knowledge:
    """What is known before the fit.

    `rows` (r, 3) and `values` (r,): weighted linear statements on the logarithms of
    (c_p, h, R), each with unit standard deviation. `delay_std` s, `ambient` and `ambient_std` K,
    `mass` kg, `area` m2.
    """

    rows: Array
    values: Array
    delay_std: float
    ambient: float
    ambient_std: float
    mass: float
    area: float


@dataclass(frozen=True)
class HeatFit:
    """Result: logarithms of (c_p, h, R) and the delay in s, with their covariance (4, 4).

    `ambient` in K and `model` and `residuals` (m,) in K belong to one window each; `scatter` in K
    is the residuals' standard deviation.
    """

    shared: Array
    covariance: Array
    ambient: tuple[float, ...]
    model: tuple[Array, ...]
    residuals: tuple[Array, ...]
    scatter: float

    def value(self, index: int) -> float:
        """c_p, h or R."""
        return math.exp(float(self.shared[index]))

    def relative_std(self, index: int) -> float:
        """Relative standard error of c_p, h or R."""
        return math.sqrt(float(self.covariance[index, index]))

    @property
    def delay(self) -> float:
        """By how much temperature stamps lie behind voltage stamps, s."""
        return float(self.shared[DELAY])

    @property
    def delay_std(self) -> float:
        """Its standard error in s."""
        return math.sqrt(float(self.covariance[DELAY, DELAY]))

    @property
    def log_gain(self) -> tuple[float, float]:
        """Logarithm of 1/(R h) and its standard error."""
        weights = np.array([0.0, -1.0, -1.0, 0.0])
        return float(weights @ self.shared), math.sqrt(
            float(weights @ self.covariance @ weights)
        )


def fit_heat(windows: Sequence[Window], knowledge: Knowledge, start: Array) -> HeatFit:
    """Most likely c_p, h, R and delay, with ambient and initial temperature free per window.

    Residuals count as stationary coloured noise: their own autocorrelation goes into the
    covariance (sandwich form), so that neighbouring samples are not taken for independent ones.
    The noise of the voltage adds less than a thousandth and is left out.

    Args:
        windows: what was measured.
        knowledge: what is known beforehand.
        start: (3,) logarithms of (c_p, h, R) to begin with.
    """
    from scipy.optimize import least_squares  # half a second to load

    problem = _Problem(windows, knowledge)
    guess = problem.first_guess(start)
    for _ in range(_PASSES):
        guess = least_squares(
            problem.residuals, guess, problem.jacobian, problem.bounds(), x_scale="jac",
            ftol=_ENOUGH,
        ).x
        scatter = problem.scatter_of(guess)
        done = abs(scatter - problem.noise) < 1e-3 * scatter
        problem.noise = scatter
        if done:
            break
    covariance = problem.covariance(guess)
    models = problem.models(guess)
    return HeatFit(
        shared=guess[:SHARED],
        covariance=covariance[:SHARED, :SHARED],
        ambient=problem.ambients(guess),
        model=models,
        residuals=tuple(w.temperature - m for w, m in zip(windows, models, strict=True)),
        scatter=problem.noise,
    )


def rough_time_constant(windows: Sequence[Window]) -> tuple[float, float]:
    """(gain in K/V^2, tau in s) that fit best on a coarse grid, ambient free per window."""
    best = (math.inf, 1.0, 1.0)
    for tau in np.geomspace(0.02, 50.0, 30):
        shapes, targets = [], []
        for w in windows:
            course = _course(w, np.zeros(len(w.edges)))
            shape = temperature_rise(course, 1.0, float(tau), 0.0, w.temperature_time)
            shapes.append(shape - shape.mean())
            targets.append(w.temperature - w.temperature.mean())
        x, y = np.concatenate(shapes), np.concatenate(targets)
        gain = float(x @ y) / max(float(x @ x), 1e-30)
        left = float(np.sum((y - gain * x) ** 2))
        if gain > 0.0 and left < best[0]:
            best = (left, gain, float(tau))
    return best[1], best[2]


def _course(window: Window, shifts: Array) -> VoltageCourse:
    before = window.voltage_time[window.edges]
    after = window.voltage_time[window.edges + 1]
    return course_from_samples(
        window.voltage_time, window.voltage, window.edges,
        before + (0.5 + shifts) * (after - before),
    )


class _Problem:
    """Residuals, Jacobian and covariance; unknowns are the shared ones, then each window's."""

    def __init__(self, windows: Sequence[Window], knowledge: Knowledge) -> None:
        self._windows = windows
        self._known = knowledge
        self.noise = 0.1
        ends = SHARED + np.cumsum([w.unknowns for w in windows])
        self._own = [slice(e - w.unknowns, e) for e, w in zip(ends, windows, strict=True)]
        self._size = int(ends[-1])

    def first_guess(self, start: Array) -> Array:
        guess = np.zeros(self._size)
        guess[:DELAY] = start
        for window, own in zip(self._windows, self._own, strict=True):
            guess[own.start + _AMBIENT] = np.percentile(window.temperature, 5)
        return guess

    def bounds(self) -> tuple[Array, Array]:
        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        for own in self._own:
            low[own.start + _FIRST_EDGE : own.stop] = -_LAST_EDGE
            high[own.start + _FIRST_EDGE : own.stop] = _LAST_EDGE
        return low, high

    def _gain_tau(self, x: Array) -> tuple[float, float]:
        loss = math.exp(x[HEAT_TRANSFER]) * self._known.area
        return (
            1.0 / (math.exp(x[RESISTANCE]) * loss),
            self._known.mass * math.exp(x[SPECIFIC_HEAT]) / loss,
        )

    def _rise(self, window: Window, gain: float, tau: float, delay: float, own: Array) -> Array:
        course = _course(window, own[_FIRST_EDGE:])
        return temperature_rise(
            course, gain, tau, float(own[_INITIAL]), window.temperature_time - delay
        )

    def models(self, x: Array) -> tuple[Array, ...]:
        gain, tau = self._gain_tau(x)
        return tuple(
            x[own.start + _AMBIENT] + self._rise(w, gain, tau, float(x[DELAY]), x[own])
            for w, own in zip(self._windows, self._own, strict=True)
        )

    def ambients(self, x: Array) -> tuple[float, ...]:
        return tuple(float(x[own.start + _AMBIENT]) for own in self._own)

    def scatter_of(self, x: Array) -> float:
        left = np.concatenate(
            [w.temperature - m for w, m in zip(self._windows, self.models(x), strict=True)]
        )
        return float(np.sqrt(np.sum(left**2) / max(len(left) - self._size, 1)))

    def _prior(self) -> tuple[Array, Array]:
        """Rows (r, unknowns) and values (r,) of everything known, in standard deviations."""
        known = self._known
        rows = [np.concatenate([row, np.zeros(self._size - 3)]) for row in known.rows]
        values = list(known.values)

        def state(index: int, value: float, std: float) -> None:
            row = np.zeros(self._size)
            row[index] = 1.0 / std
            rows.append(row)
            values.append(value / std)

        state(DELAY, 0.0, known.delay_std)
        for own in self._own:
            state(own.start + _AMBIENT, known.ambient, known.ambient_std)
            state(own.start + _INITIAL, 0.0, _INITIAL_STD)
            for edge in range(own.start + _FIRST_EDGE, own.stop):
                state(edge, 0.0, _EDGE_STD)
        return np.array(rows), np.array(values)

    def residuals(self, x: Array) -> Array:
        rows, values = self._prior()
        measured = [
            (m - w.temperature) / self.noise
            for w, m in zip(self._windows, self.models(x), strict=True)
        ]
        return np.concatenate([*measured, rows @ x - values])

    def jacobian(self, x: Array) -> Array:
        return np.vstack([*(b / self.noise for b in self._blocks(x)), self._prior()[0]])

    def _blocks(self, x: Array) -> list[Array]:
        """(m, unknowns) derivative of each window's model in K."""
        gain, tau = self._gain_tau(x)
        delay = float(x[DELAY])
        blocks = []
        for window, own in zip(self._windows, self._own, strict=True):
            rise = partial(self._rise, window)
            mine, undriven = x[own], x[own].copy()
            undriven[_INITIAL] = 0.0
            by_gain = rise(gain, tau, delay, undriven)
            undriven[_INITIAL] = 1.0
            up, down = tau * (1.0 + _STEP), tau * (1.0 - _STEP)
            by_tau = (rise(gain, up, delay, mine) - rise(gain, down, delay, mine)) / (2.0 * _STEP)
            shift = _STEP * tau
            later, sooner = (rise(gain, tau, delay + s, mine) for s in (shift, -shift))
            block = np.zeros((len(window.temperature), self._size))
            block[:, SPECIFIC_HEAT] = by_tau
            block[:, HEAT_TRANSFER] = -by_tau - by_gain
            block[:, RESISTANCE] = -by_gain
            block[:, DELAY] = (later - sooner) / (2.0 * shift)
            block[:, own.start + _AMBIENT] = 1.0
            block[:, own.start + _INITIAL] = rise(0.0, tau, delay, undriven)
            for edge in range(_FIRST_EDGE, window.unknowns):
                nudge = _STEP * np.eye(window.unknowns)[edge]
                later, sooner = (rise(gain, tau, delay, mine + s * nudge) for s in (1.0, -1.0))
                block[:, own.start + edge] = (later - sooner) / (2.0 * _STEP)
            blocks.append(block)
        return blocks

    def covariance(self, x: Array) -> Array:
        """Sandwich H^-1 (J' Gamma J + prior) H^-1 with the residuals' own autocorrelation."""
        blocks = self._blocks(x)
        rows, _ = self._prior()
        left = [
            w.temperature - m for w, m in zip(self._windows, self.models(x), strict=True)
        ]
        colour = autocorrelation(left)
        prior = rows.T @ rows
        information = prior + sum(b.T @ b for b in blocks) / self.noise**2
        spread = prior + sum(_coloured(b, colour) for b in blocks) / self.noise**2
        inverse = np.linalg.pinv(information, hermitian=True)
        coloured = inverse @ spread @ inverse
        # Colour never makes a number surer than white noise of the same size.
        ratio = np.diag(inverse) / np.maximum(np.diag(coloured), 1e-300)
        widen = np.sqrt(np.maximum(ratio, 1.0))
        return np.asarray(coloured * np.outer(widen, widen))


def _coloured(block: Array, colour: Array) -> Array:
    """J' Gamma J for unit variance, Gamma Toeplitz with the correlations of lags 0 .. m-1."""
    total = block.T @ block
    for lag in range(1, len(colour)):
        cross = block[:-lag].T @ block[lag:] * colour[lag]
        total = total + cross + cross.T
    return np.asarray(total)
