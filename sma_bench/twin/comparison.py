"""Measured against predicted in bins of time, and how far the residuals may be off."""

from collections import defaultdict, deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.special import chdtri

from sma_bench.arrays import Array
from sma_bench.estimation.noise_model import Noise, estimate_noise, resolution, white_noise_level
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.boundary import side_of_channels
from sma_bench.physics.simulate import TemperatureDriven
from sma_bench.twin.free_run import FreeRun

BIN = 0.2  # s, as the diagnosis has it
MEMORY = 350  # bins from which noise is learned, and which are judged by it
_SLOW = 30.0  # s that noise must be known for; a drift slower than that is not seen in less
_FAST = 3.0  # s; no faster one is granted unseen
_CHANCE = 0.01
_SAMPLES = 400  # samples from which the scatter of neighbours is taken
_FEWEST_SAMPLES = 20
# Of a sample: no bench is simulated, and no voltage known, to less.
_LEAST = {"current": 2e-3, "temperature": 0.02, "deflection": 5e-6, "force": 5e-3}
# Standard deviations; `./bench check twin_alarms` shows how often noise is as surprising.
SURPRISING = 5.5
STAYS = 0.75  # of the threshold: a gap is over below that
_MOST_WHITE = 2.0  # of the scatter of neighbours: a residual that scatters more is a gap


class Bin(NamedTuple):
    """Mean residual of a bin."""

    time: float
    residual: float
    samples: int
    off: float  # what moments and zeros that are not known may add to it, one standard deviation
    cause: float  # what the residual is compared with, the signal's own prediction
    side: int  # number of the side it belongs to


class BinStatistics(NamedTuple):
    """What the last bins of a signal say."""

    energy: float  # mean square of the whitened residual, 1 for noise
    surprise: float  # standard deviations of energy or level beyond the noise before the window
    gap: Array  # rms of the residual over a sample's noise, a side; NaN where no signal was there
    residual: Array  # (n,) of the bins, in the signal's unit
    cause: Array  # (n,)
    tolerance: Array  # (n,)
    share: float  # residual over cause of all bins, NaN where causes are below the tolerance


class SignalBins:
    """One signal: residuals come in as samples for their noise, and as `bins` to be judged."""

    def __init__(self, quantity: str) -> None:
        """`quantity` is current, temperature, deflection or force."""
        self.quantity = quantity
        self._values: deque[float] = deque(maxlen=_SAMPLES)
        self._residuals: deque[float] = deque(maxlen=_SAMPLES)
        self.bins: deque[Bin] = deque(maxlen=MEMORY)
        self._learned: Noise | None = None
        self._scatter: float | None = None  # None where samples came since

    def samples(self, value: Array, residual: Array) -> None:
        """Measured values (n,), and measured less predicted."""
        self._values.extend(value.tolist())
        self._residuals.extend(residual.tolist())
        self._scatter = None

    @property
    def play(self) -> float:
        """Within which a difference that is smoothed over the newest bins is noise."""
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
        """What the bins of the last `window` s say, None while there are less than `fewest`.
        `allowed`: slow drift that the sensor may have, in the signal's unit; a surprising gap
        beyond the `threshold` is not learned as noise."""
        scatter = self.scatter
        if len(self.bins) < fewest or np.isnan(scatter):
            return None
        time, residual, count, off, cause, side = np.array(self.bins).T
        last = slice(min(int(np.searchsorted(time, time[-1] - window)), len(time) - fewest), None)
        # The gap: against what a sample may be off by, of each side.
        steady = np.hypot(scatter, allowed)
        tolerance = np.hypot(steady, off)
        squares = (residual / tolerance)[last] ** 2
        there = side[last] == np.arange(sides)[:, np.newaxis]
        gap = np.sqrt((squares * there).sum(axis=1) / len(squares))
        gap[~there.any(axis=1)] = np.nan
        size = float(np.sqrt(np.mean(squares)))
        # How surprising it is as noise. Bins where a reading's moment matters count as they inform.
        level = residual * steady / tolerance
        noise = self._learned
        if noise is None or noise.usual != allowed:
            noise = _noise_before(level, time, count, last.start, scatter, allowed)
        energy, surprise = judge(noise, level[last])
        if self._learned is not None and size >= STAYS * threshold:
            surprise = max(surprise, SURPRISING)  # once it has come, it is there until it goes
        self._learned = noise if size >= threshold * STAYS and surprise >= SURPRISING else None
        power = float(cause @ cause)
        informative = power > 0.1 * float(tolerance @ tolerance)
        share = float(residual @ cause) / power if informative else np.nan
        return BinStatistics(energy, surprise, gap, residual[last], cause[last], tolerance[last],
                             share)


def _noise_before(level: Array, time: Array, count: Array, stop: int, scatter: float,
                  allowed: float) -> Noise:
    """Noise that the bins up to `stop` show, or may have while they are too few; no more."""
    white = scatter / float(np.sqrt(np.median(count)))
    period = max(round(float(np.median(np.diff(time))), 2), 0.01)
    if stop < 2:
        return Noise(white, allowed, _FAST, period, allowed)
    found = estimate_noise([level[:stop]], white, period, allowed)
    # As fast as it was seen to go, and as far as it may: nobody has seen that within a minute.
    seen = max((allowed / max(found.drift, 1e-3 * allowed)) ** 2 * found.time, period)
    # So few bins may have shown a slower one by chance.
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
    # That a drift goes to and fro about zero, half a minute does not show.
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


# --- Measured against predicted, bin by bin, with the chain broken at the measured temperatures.
#
#     V -> I, V -> T         the free run's readings
#     T -> deflection        the model led through the measured temperatures
#     V -> deflection        the free run's reading
#
# The measured temperature is the model's plus the smoothed difference, which moves only when it
# has changed by more than its noise: so the mechanical bins come a second after the others.

_LATE = 0.2  # s that a reading may come after the voltages of its moment
_AHEAD = 5  # bins on either side that smooth a bin's temperatures
_SMOOTHING = 2.0  # bins, standard deviation
_WEIGHTS = np.exp(-0.5 * (np.arange(-_AHEAD, _AHEAD + 1) / _SMOOTHING) ** 2)
_PLAY = 3.0 / np.sqrt(2.0 * np.sqrt(np.pi) * _SMOOTHING)  # of a bin's noise, thrice what is left
_CLOCK_STD = 0.02  # s, of one instrument's stamps behind the voltages'
_SURELY = 1.0  # s after a wire has been found martensite or austenite; the bench may be later
_ZERO_STD = 0.2  # K, of a camera's zero


class Comparison:
    """Bins of all signals since a moment of the free run."""

    def __init__(self, run: FreeRun, drift: float) -> None:
        """Begin where the run is now; `drift` K that a thermometer may have."""
        parameters, wires = run.parameters, len(run.parameters["bench.channels"])
        self._moves = load_kind(parameters) != "clamped"
        mechanics = "deflection" if self._moves else "force"
        # One a wire; the mechanics against the model led by temperatures, and against the free run.
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
        # The same a little warmer here and cooler there: what a camera's zero and drift do.
        self._warmer = TemperatureDriven(parameters, run.state)
        self._last_led = run.trajectory.mechanics[-1]
        self._doubt = float(np.hypot(_ZERO_STD, drift))
        self._sign = np.where(self._side == 0, 1.0, -1.0)
        self._correction = np.zeros(wires)
        # Of the last bins: measured less predicted temperatures (w,), and their own errors.
        self._differences: deque[Array] = deque(maxlen=2 * _AHEAD + 1)
        self._doubts: deque[Array] = deque(maxlen=2 * _AHEAD + 1)

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
        """(4, n) of the rows of `_open` before `stop`, which are taken out."""
        rows = self._open[kind, wire]
        before = rows[0] < stop
        self._open[kind, wire] = rows[:, ~before]
        return rows[:, before]

    def close(self, run: FreeRun) -> int:
        """Close the bins that are complete; how many."""
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
        differences, doubts = np.full(len(moments), np.nan), np.zeros(len(moments))
        for k, side in enumerate(self._side.tolist()):
            for signal in (self.currents[k], self.temperatures[k]):
                rows = self._samples(signal.quantity, k, stop)
                if not rows.size:
                    continue
                _, value, predicted, own = rows.mean(axis=1).tolist()
                off, cause = 0.0, predicted
                if signal.quantity == "temperature":
                    differences[k], doubts[k] = value - predicted, own
                    cause -= self._ambient
                    # Of pixels, emissivity and background: much the same in every picture.
                    off = float(np.hypot(moments[k], own))
                signal.bins.append(Bin(stop, value - predicted, rows.shape[1], off, cause, side))
        self._differences.append(differences)
        self._doubts.append(doubts)

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
        # The model led through these, and a little warmer.
        share = np.clip((time[1:] - start) / BIN, 0.0, 1.0)[:, np.newaxis]
        kelvin = trajectory.temperature[rows][1:] + before + share * (after - before)
        rough = np.nan_to_num(np.abs(self._differences[-1 - _AHEAD] - after))
        doubt = np.sqrt(self._doubt**2 + rough**2 + self._doubts[-1 - _AHEAD] ** 2)
        runs = self._led.run(time, kelvin), self._warmer.run(time, kelvin + self._sign * doubt)
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
    """How well the moment of a reading, and of a jump between two voltages, is known [s]."""
    return float(np.hypot(_CLOCK_STD, run.spacing / np.sqrt(3.0)))
