"""The model run on the measured voltages, and measured minus predicted signals in bins of time."""

import math
from collections import defaultdict, deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.special import chdtri

from sma_bench.arrays import Array, IntArray
from sma_bench.estimation.laws import FLOOR, reach_of
from sma_bench.estimation.noise_model import Noise, estimate_noise, resolution, white_noise_level
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench
from sma_bench.physics.boundary import side_of_channels
from sma_bench.physics.kernel import State
from sma_bench.physics.material import time_constant
from sma_bench.physics.simulate import TemperatureDriven, warmed_from_rest

_BACK = 0.5  # s: a stamp further back means that a clock was set back or a record started again
_QUEUE = 5000  # readings of a channel that wait for those of the others
_LONGEST_STEP, _OFF = 0.01, 0.1  # s; V below which a channel does not heat
_RECENT, _MEMORY = 4.0, 60.0  # s of trajectory that are kept; re-simulated with other parameters


class Voltages:
    """Readings of each channel, released up to the time that all channels have reached: only up to
    there are the model's inputs known. A voltage is held until the channel's next reading."""

    timeout: float  # s; after a longer gap between readings of a channel, the input is unknown

    def __init__(self, wires: int) -> None:
        self._wires = wires
        self.dropped = {"not a number": 0, "out of order": 0}  # readings left out, by reason
        self._forget()

    def _forget(self) -> None:
        self._waiting = [deque[tuple[float, float]](maxlen=_QUEUE) for _ in range(self._wires)]
        self._latest, self._held = [-math.inf] * self._wires, [math.nan] * self._wires

    def take(self, wire: int, time: float, volt: float) -> str:
        """Add a reading at `time` s. Returns why the twin must start again, or ""."""
        passed, reason = time - self._latest[wire], ""
        if not math.isfinite(volt):
            self.dropped["not a number"] += 1
            return ""
        if -_BACK <= passed <= 0.0:
            self.dropped["out of order"] += 1
            return ""
        if passed < 0.0:
            reason = f"time went back by {-passed:.3g} s"
        elif self.timeout < passed < math.inf:
            reason = f"no voltages for {passed:.3g} s"
        if reason:
            self._forget()
        self._latest[wire] = time
        self._waiting[wire].append((time, volt))
        return reason

    def missing(self) -> list[int]:
        """Channels without any reading yet."""
        return [k for k, latest in enumerate(self._latest) if latest == -math.inf]

    def changes(self) -> tuple[Array, Array]:
        """Times (n,) s of the readings, as far as all channels are known, and the voltages (n, w) V
        held from each on; NaN before the first reading of a wire."""
        until = min(self._latest)  # -inf until every channel has a reading
        times, volts = list[float](), list[list[float]]()
        while (time := min((w[0][0] for w in self._waiting if w), default=math.inf)) <= until:
            for k, waiting in enumerate(self._waiting):
                if waiting and waiting[0][0] == time:
                    self._held[k] = waiting.popleft()[1]
            times.append(time)
            volts.append(list(self._held))
        return np.array(times), np.array(volts).reshape(len(times), self._wires)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What the model did, one row per step."""

    time: Array  # (n,) s
    temperature: Array  # (n, w) K
    reading: Array  # (n, w) K, of the sensors
    conductance: Array  # (n, w) A/V of the electrical readings
    mechanics: Array  # (n,) deflection [m], or force [N] of a clamped wire
    driven: IntArray  # wire with the highest voltage; at rest, the one before the rest

    def rows(self, start: float, stop: float) -> slice:
        """Rows in (start, stop], and the one before them."""
        first = max(int(np.searchsorted(self.time, start, side="right")) - 1, 0)
        return slice(first, int(np.searchsorted(self.time, stop, side="right")))

    def followed_by(self, other: Self) -> "Trajectory":
        """The last seconds of this one, then the other one without its first row."""
        kept = int(np.searchsorted(self.time, self.time[-1] - _RECENT))
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Trajectory(*(np.concatenate([own[kept:], more[1:]]) for own, more in pairs))


class FreeRun:
    """The model, simulated from the moment at which the twin started."""

    def __init__(self, parameters: Parameters, time: float, temperature: Array,
                 voltage: Array) -> None:
        """Begin at `time` s with measured temperatures (w,) K or NaN; voltages (w,) V are held."""
        self._measured = temperature
        self.time = self._joined = time  # s, up to which it has run
        self.spacing = 0.0  # s, longest time between the newest voltage readings
        # s, from when every wire's phase is known: that of a warm wire depends on its past.
        self.known_since = np.inf
        self._known = np.zeros(len(temperature), dtype=bool)
        self._volts, self._driven = voltage, 0
        # Each advance: the state before it (None for the first one), times, voltages.
        self._log: deque[tuple[State | None, Array, Array]] = deque()
        self._begin(parameters, None)
        self.trajectory = self._followed(np.array([time]), voltage[np.newaxis])

    @property
    def state(self) -> State:
        return self._bench.state

    def advance(self, time: Array, voltage: Array) -> None:
        """Simulate on to times (n,) s; voltage (n, w) V is held from each of them on."""
        begins = np.concatenate([[self.time], time])
        held = np.vstack([self._volts, voltage])
        self.spacing = float(np.max(np.diff(begins)))
        self._log.append((self.state if self._log else None, begins, held))
        self.trajectory = self.trajectory.followed_by(self._followed(begins, held))
        self.time, self._volts, self._driven = float(time[-1]), held[-1], self.trajectory.driven[-1]
        while len(self._log) > 1 and self._log[1][1][0] <= self.time - _MEMORY:
            self._log.popleft()
        if not self._known.all():
            settled = np.isfinite(self._measured) | (self.time - self._joined > self._settling)
            self._known |= self._surely.any(axis=0) & settled
            if self._known.all():
                self.known_since = self.time

    def change(self, parameters: Parameters) -> None:
        """Re-simulate the last minute with other parameters, and go on with them."""
        state = self._log[0][0] if self._log else None
        self._begin(parameters, state)
        if self._log:
            _, times, volts = zip(*self._log, strict=True)
            begins = np.concatenate([times[0][:1], *(time[1:] for time in times)])
            held = np.vstack([volts[0][:1], *(volt[1:] for volt in volts)])
            self._log = deque([(state, begins, held)])
            self.trajectory = self._followed(begins, held)

    def of_another(self, parameters: Parameters) -> Self:
        """A copy of this run with other parameters, its last minute re-simulated."""
        other = copy(self)
        other._known, other._log = self._known.copy(), deque(self._log)
        other.change(parameters)
        return other

    def _begin(self, parameters: Parameters, state: State | None) -> None:
        self.parameters = parameters
        self._settling = 10.0 * float(time_constant(parameters))
        if state is None:
            ambient = parameters["environment.ambient_temperature"]
            state = warmed_from_rest(parameters, np.nan_to_num(self._measured, nan=ambient))
        self._bench = Bench(parameters, initial=state)

    def _followed(self, time: Array, voltage: Array) -> Trajectory:
        """Trajectory in short steps, voltages (n, w) V held from each time (n,) s."""
        counts = np.maximum(np.ceil(np.diff(time) / _LONGEST_STEP - 1e-6), 1.0).astype(int)
        if np.any(counts > 1):
            which = np.repeat(np.arange(len(counts)), counts)
            within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
            grid = time[which] + within * (np.diff(time) / counts)[which]
            time, voltage = np.append(grid, time[-1]), np.vstack([voltage[which], voltage[-1:]])
        run = self._bench.follow(time - time[0], voltage)
        xi, kelvin, p = run.martensite_fraction, run.temperature, self.parameters
        cold = kelvin < float(p["wire.martensite_finish_temperature"])
        self._surely = (xi < 1e-6) | ((xi > 1.0 - 1e-6) & cold)
        mechanics = run.deflection_reading if load_kind(p) != "clamped" else run.force[:, 0]
        # At rest, measured voltages are noise around 0: only one that heats counts.
        drives = run.voltage.max(axis=1) > _OFF
        newest = np.maximum.accumulate(np.where(drives, np.arange(len(time)), -1))
        driven = np.where(newest < 0, self._driven, np.argmax(run.voltage, axis=1)[newest])
        seen = run.temperature_reading, run.conductance
        return Trajectory(time, kelvin, *seen, mechanics, driven)


class Band:
    """How far a healthy bench may be from the prediction, without sensor noise: the spread of
    models with parameters drawn within their uncertainty (estimation/laws.py)."""

    def __init__(self, run: FreeRun, benches: Sequence[Parameters], probability: float) -> None:
        self._run, self._reach = run, reach_of(probability)
        self._others = [run.of_another(bench) for bench in benches]
        self._least, self._most = (self._columns(run, slice(-1, None))[0] for _ in range(2))
        self._least[: run.trajectory.conductance.shape[1]] = 0.0  # a current's range starts at 0

    def advance(self, time: Array, voltage: Array) -> None:
        for other in self._others:
            other.advance(time, voltage)
        new = self._columns(self._run, slice(-len(time), None))
        self._least = np.minimum(self._least, new.min(axis=0))
        self._most = np.maximum(self._most, new.max(axis=0))

    def off(self, row: int) -> Array:
        """(2 w + 1,) half-width of the band of conductances, temperatures and mechanics there, in
        their units; at least a share of the range of each so far."""
        rows = slice(row, row + 1)
        mean = self._columns(self._run, rows)[0]
        drawn = np.vstack([self._columns(other, rows) for other in self._others])
        floor = FLOOR * (self._most - self._least)
        return np.asarray(self._reach * np.sqrt(np.mean((drawn - mean) ** 2, axis=0) + floor**2))

    @staticmethod
    def _columns(run: FreeRun, rows: slice) -> Array:
        at = run.trajectory
        return np.column_stack([at.conductance[rows], at.reading[rows], at.mechanics[rows]])

# --- Noise of the residuals.

BIN = 0.2  # s, as in the diagnosis
MEMORY = 350  # bins: from the older ones the noise is learned, by which the newest are judged
_SLOW = 30.0  # s, least time constant of a drift that is assumed for judging a mean
_FAST = 3.0  # s, time constant of a drift while few bins show it
_CHANCE = 0.01  # probability that so few bins show too slow a drift
_FEWEST_SAMPLES, _SAMPLES = 20, 400  # samples from which the scatter of neighbours is taken
# Least noise of a sample: no simulation and no voltage reading is more accurate.
_LEAST = {"current": 2e-3, "temperature": 0.02, "deflection": 5e-6, "force": 5e-3}
# Standard deviations; `./bench check twin_alarms` shows how often noise is as surprising.
SURPRISING = 5.5
STAYS = 0.75  # of the threshold: below that a gap has ended
_MOST_WHITE = 2.0  # times the scatter of neighbours: more than that is a gap, not noise


class Bin(NamedTuple):
    """Mean residual of a bin."""

    time: float
    residual: float
    samples: int
    off: float  # its standard deviation from unknown timing and zeros
    cause: float  # the predicted signal, to which the residual may be proportional
    side: int  # number of the side it belongs to


class BinStatistics(NamedTuple):
    """Statistics of the last bins of a signal."""

    energy: float  # mean square of the whitened residual, 1 for noise
    surprise: float  # standard deviations of energy or level beyond the noise before the window
    gap: Array  # rms of the residual over a sample's noise, by side; NaN where there was no signal
    residual: Array  # (n,) of the bins, in the signal's unit
    cause: Array  # (n,)
    tolerance: Array  # (n,)
    share: float  # slope of residual over cause, all bins; NaN if causes are within the tolerance


class SignalBins:
    """Residuals of one signal: samples, which give their noise, and `bins`, which are judged."""

    def __init__(self, quantity: str) -> None:
        """`quantity` is current, temperature, deflection or force."""
        self.quantity, self.bins = quantity, deque[Bin](maxlen=MEMORY)
        self._values, self._residuals = (deque[float](maxlen=_SAMPLES) for _ in range(2))
        self._learned: Noise | None = None
        self._scatter: float | None = None  # None: samples have come since it was computed

    def samples(self, value: Array, residual: Array) -> None:
        """Measured values (n,), and measured less predicted."""
        self._values.extend(value.tolist())
        self._residuals.extend(residual.tolist())
        self._scatter = None

    @property
    def play(self) -> float:
        """Largest smoothed difference of the newest bins that is still noise."""
        known = len(self.bins) > 0 and not np.isnan(self.scatter)
        return float(_PLAY * self.scatter / np.sqrt(self.bins[-1].samples)) if known else 0.0

    @property
    def scatter(self) -> float:
        """Standard deviation of a sample, a converter's steps included; NaN of too few."""
        if len(self._values) < _FEWEST_SAMPLES:
            return np.nan
        if self._scatter is None:
            steps = resolution(np.array(self._values)) / np.sqrt(12.0)
            white = white_noise_level(np.array(self._residuals))
            self._scatter = float(max(white, steps, _LEAST[self.quantity]))
        return self._scatter

    def read(self, allowed: float, sides: int, fewest: int, window: float,
             threshold: float = np.inf) -> BinStatistics | None:
        """Statistics of the bins of the last `window` s, None below `fewest` bins. `allowed`: drift
        granted to the sensor; a surprising gap near the `threshold` is not learned as noise."""
        scatter = self.scatter
        if len(self.bins) < fewest or np.isnan(scatter):
            return None
        time, residual, count, off, cause, side = np.array(self.bins).T
        last = slice(min(int(np.searchsorted(time, time[-1] - window)), len(time) - fewest), None)
        # The gap of each side, over the error of a sample.
        steady = np.hypot(scatter, allowed)
        tolerance = np.hypot(steady, off)
        squares = (residual / tolerance)[last] ** 2
        there = side[last] == np.arange(sides)[:, np.newaxis]
        gap = np.sqrt((squares * there).sum(axis=1) / len(squares))
        gap[~there.any(axis=1)] = np.nan
        size = float(np.sqrt(np.mean(squares)))
        # How surprising it is as noise. Bins with uncertain timing are scaled down.
        level = residual * steady / tolerance
        noise = self._learned
        if noise is None or noise.usual != allowed:
            noise = _noise_before(level, time, count, last.start, scatter, allowed)
        energy, surprise = judge(noise, level[last])
        if self._learned is not None and size >= STAYS * threshold:
            surprise = max(surprise, SURPRISING)  # a gap stays until it falls below
        self._learned = noise if size >= threshold * STAYS and surprise >= SURPRISING else None
        power = float(cause @ cause)
        informative = power > 0.1 * float(tolerance @ tolerance)
        return BinStatistics(energy, surprise, gap, residual[last], cause[last], tolerance[last],
                             float(residual @ cause) / power if informative else np.nan)


def _noise_before(level: Array, time: Array, count: Array, stop: int, scatter: float,
                  allowed: float) -> Noise:
    """Noise that the bins before `stop` show, or, with few bins, could have at most."""
    white = scatter / float(np.sqrt(np.median(count)))
    period = max(round(float(np.median(np.diff(time))), 2), 0.01)
    if stop < 2:
        return Noise(white, allowed, _FAST, period, allowed)
    found = estimate_noise([level[:stop]], white, period, allowed)
    # A drift at the speed that was seen, but up to `allowed`: a minute does not show its full size.
    seen = max((allowed / max(found.drift, 1e-3 * allowed)) ** 2 * found.time, period)
    # Few bins may show too slow a drift by chance: take a lower bound of its time constant.
    surely = seen * float(chdtri(stop, 1.0 - _CHANCE)) / stop
    white = min(found.white, _MOST_WHITE * white)
    return Noise(white, allowed, min(seen, max(surely, _FAST)), period, allowed)


def judge(noise: Noise, level: Array) -> tuple[float, float]:
    """Energy of the whitened level (n,), and how surprising it is as noise."""
    white, ones = _whitened(noise, level)
    energy = float(np.mean(white**2))
    # Wilson and Hilferty's cube root: the tail of chi squared is not that of a Gaussian.
    spread = 2.0 / (9.0 * len(level))
    from_energy = (float(np.cbrt(energy)) - 1.0 + spread) / float(np.sqrt(spread))
    # Half a minute does not show that a drift returns to zero: judge the mean with a slower one.
    if noise.time < _SLOW:
        white, ones = _whitened(replace(noise, time=_SLOW), level)
    return energy, max(from_energy, abs(float(ones @ white)) / float(np.sqrt(ones @ ones)))


def _whitened(noise: Noise, level: Array) -> Array:
    """The level (n,) and ones, whitened by the noise's covariance: exact from the first bin on."""
    lags = np.arange(len(level)) * (noise.period / noise.time)
    covariance = toeplitz(noise.drift**2 * np.exp(-lags))
    covariance[np.diag_indices_from(covariance)] += noise.white**2
    both = np.column_stack([level, np.ones(len(level))])
    return np.asarray(solve_triangular(cholesky(covariance, lower=True), both, lower=True).T)


# --- Measured against predicted, bin by bin, also with measured temperatures as the input.
#
#     V -> I, V -> T         the free run's readings
#     T -> deflection        the model with the measured temperatures as its input
#     V -> deflection        the free run's reading
#
# That input is the model's temperature plus the smoothed difference to the measured one, which is
# updated only beyond its noise. Smoothing needs later bins, so mechanical bins come a second late.

_LATE = 0.2  # s that a reading may arrive after the voltages of its time
_AHEAD = 5  # bins on either side that smooth a bin's temperatures
_SMOOTHING = 2.0  # bins, standard deviation
_WEIGHTS = np.exp(-0.5 * (np.arange(-_AHEAD, _AHEAD + 1) / _SMOOTHING) ** 2)
_PLAY = 3.0 / np.sqrt(2.0 * np.sqrt(np.pi) * _SMOOTHING)  # of a bin's noise: 3 x what is left
_CLOCK_STD = 0.02  # s, between the stamps of an instrument and of the voltages
_SURELY = 1.0  # s after every wire has been in one phase in the model: the bench may be later
_ZERO_STD = 0.2  # K, of a camera's zero


class Comparison:
    """Bins of all signals from some time of the free run on."""

    def __init__(self, run: FreeRun, drift: float) -> None:
        """Begin at the run's present time; `drift`: K, granted to a thermometer."""
        parameters, wires = run.parameters, len(run.parameters["bench.channels"])
        self._moves = load_kind(parameters) != "clamped"
        mechanics = "deflection" if self._moves else "force"
        # One per wire; mechanics with measured temperatures as input, and of the free run.
        self.currents = [SignalBins("current") for _ in range(wires)]
        self.temperatures = [SignalBins("temperature") for _ in range(wires)]
        self.driven, self.free = SignalBins(mechanics), SignalBins(mechanics)
        self.late = 0  # readings that came after their bin had been closed
        self._side = side_of_channels(parameters)
        self._ambient = float(parameters["environment.ambient_temperature"])
        self._start, self._closed = run.time, 0
        # By kind and wire, of bins that are open: time, value, prediction, own error.
        self._open: dict[tuple[str, int], Array] = defaultdict(lambda: np.empty((4, 0)))
        self._led = TemperatureDriven(parameters, run.state)
        # The same with one side warmer and the other cooler, as a camera's zero and drift could do.
        self._warmer = TemperatureDriven(parameters, run.state)
        self._last_led = run.trajectory.mechanics[-1]
        self._camera_std = float(np.hypot(_ZERO_STD, drift))
        self._sign = np.where(self._side == 0, 1.0, -1.0)
        self._correction = np.zeros(wires)
        # Of the last bins: measured less predicted temperatures (w,), and their own errors.
        self._differences, self._stds = (deque[Array](maxlen=2 * _AHEAD + 1) for _ in range(2))

    def take(self, kind: str, wire: int, time: Array, value: Array, predicted: Array,
             std: Array) -> None:
        """Samples (n,): current [A], temperature [K] and its std, deflection [m] or force [N]."""
        number = self._closed - (_AHEAD if kind == "mechanics" else 0)
        fresh = time >= self._start + number * BIN
        self.late += int(np.count_nonzero(~fresh))
        rows = np.array([time, value, predicted, std])[:, fresh]
        self._open[kind, wire] = np.hstack([self._open[kind, wire], rows])
        signals = {"current": self.currents[wire:], "temperature": self.temperatures[wire:]}
        for signal in signals[kind][:1] if kind in signals else (self.driven, self.free):
            signal.samples(value, value - predicted)

    def _samples(self, kind: str, wire: int, stop: float) -> Array:
        """Take the rows (4, n) before `stop` out of `_open`."""
        rows = self._open[kind, wire]
        before = rows[0] < stop
        self._open[kind, wire] = rows[:, ~before]
        return rows[:, before]

    def close(self, run: FreeRun) -> int:
        """Close the bins that are complete. Returns how many."""
        before = self._closed
        while run.time >= self._start + (self._closed + 1) * BIN + _LATE:
            self._close_temperatures(run, self._closed)
            if self._closed >= _AHEAD:
                self._close_mechanics(run, self._closed - _AHEAD)
            self._closed += 1
        return self._closed - before

    def _close_temperatures(self, run: FreeRun, number: int) -> None:
        start, stop = self._start + number * BIN, self._start + (number + 1) * BIN
        reading = run.trajectory.reading[run.trajectory.rows(start, stop)]
        moments = np.abs(reading[-1] - reading[0]) / BIN * _moment(run)
        differences, stds = np.full(len(moments), np.nan), np.zeros(len(moments))
        for k, side in enumerate(self._side.tolist()):
            for signal in (self.currents[k], self.temperatures[k]):
                rows = self._samples(signal.quantity, k, stop)
                if not rows.size:
                    continue
                _, value, predicted, own = rows.mean(axis=1).tolist()
                off, cause = 0.0, predicted
                if signal.quantity == "temperature":
                    differences[k], stds[k] = value - predicted, own
                    cause -= self._ambient
                    # own: of pixels, emissivity and background, much the same in every image.
                    off = float(np.hypot(moments[k], own))
                signal.bins.append(Bin(stop, value - predicted, rows.shape[1], off, cause, side))
        self._differences.append(differences)
        self._stds.append(stds)

    def _close_mechanics(self, run: FreeRun, number: int) -> None:
        start, stop = self._start + number * BIN, self._start + (number + 1) * BIN
        trajectory, rows = run.trajectory, run.trajectory.rows(start, stop)
        time = trajectory.time[rows]
        if len(time) < 2:
            return
        # Measured less predicted temperatures (w,) of the middle bin, smoothed, with play.
        differences = np.array(self._differences)
        weights = _WEIGHTS[-len(differences):, np.newaxis] * np.isfinite(differences)
        total = weights.sum(axis=0)
        smooth = (weights * np.nan_to_num(differences)).sum(axis=0)
        smooth /= np.where(total > 0.0, total, 1.0)
        play = np.array([signal.play for signal in self.temperatures])
        before, after = self._correction, np.clip(self._correction, smooth - play, smooth + play)
        self._correction = after
        # The model with these as input, and with one side warmer.
        share = np.clip((time[1:] - start) / BIN, 0.0, 1.0)[:, np.newaxis]
        kelvin = trajectory.temperature[rows][1:] + before + share * (after - before)
        rough = np.nan_to_num(np.abs(self._differences[-1 - _AHEAD] - after))
        std = np.sqrt(self._camera_std**2 + rough**2 + self._stds[-1 - _AHEAD] ** 2)
        runs = self._led.run(time, kelvin), self._warmer.run(time, kelvin + self._sign * std)
        led, warmer = (deflection if self._moves else force[:, 0] for deflection, force in runs)
        spread = float(np.mean(np.abs(warmer - led)))
        led, self._last_led = np.insert(led, 0, self._last_led), float(led[-1])
        # Its bins, once the wires' phases are known.
        at, values, _, _ = self._samples("mechanics", 0, stop)
        if not len(at) or start < run.known_since + _SURELY:
            return
        side = int(self._side[trajectory.driven[rows][-1]])
        for signal, predicted in ((self.driven, led), (self.free, trajectory.mechanics[rows])):
            moving = abs(float(predicted[-1] - predicted[0])) / BIN * _moment(run)
            residual = float(np.mean(values - np.interp(at, time, predicted)))
            off = float(np.hypot(moving, spread))
            signal.bins.append(Bin(stop, residual, len(at), off, float(np.mean(predicted)), side))


def _moment(run: FreeRun) -> float:
    """Uncertainty [s] of the time of a reading and of a jump between two voltages."""
    return float(np.hypot(_CLOCK_STD, run.spacing / np.sqrt(3.0)))
