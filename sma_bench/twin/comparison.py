"""Measured against predicted in bins of time, and how far the residuals may be off."""

from collections import defaultdict, deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.stats import chi2

from sma_bench.estimation.noise_model import Noise, estimate_noise, resolution, white_noise_level
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.boundary import side_of_channels
from sma_bench.physics.simulate import TemperatureDriven
from sma_bench.twin.free_run import FreeRun

Array = NDArray[np.float64]


# --- Residuals of one signal in bins.

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


@dataclass(frozen=True)
class Bin:
    """Mean residual of a bin.

    `off`: what moments and zeros that are not known may add to it, one standard deviation, in the
    signal's unit; `cause`: what the residual is compared with, the signal's own prediction; `side`:
    number of the side it belongs to.
    """

    time: float
    residual: float
    count: int
    off: float
    cause: float
    side: int


@dataclass(frozen=True)
class BinStatistics:
    """What the last bins of a signal say.

    Attributes:
        energy: mean square of the whitened residual, 1 for noise.
        surprise: standard deviations by which the energy or the level is beyond that of the noise
            before the window.
        gap: root mean square of the residual over the noise of a sample; per side, NaN where the
            signal was not on that side.
        noise: of the sensor, as learned; scatter: of a sample.
        residual, cause: (n,) of the bins; tolerance: (n,) in the signal's unit.
        share: residual over cause, least squares over all bins at hand, not just the last; NaN
            where the causes are no larger than the tolerance.
    """

    energy: float
    surprise: float
    gap: Array
    noise: Noise
    scatter: float
    residual: Array
    cause: Array
    tolerance: Array
    share: float


class SignalBins:
    """One signal: residuals come in as samples for their noise, and as bins to be judged."""

    def __init__(self, quantity: str, wire: int) -> None:
        """`quantity` is current, temperature, deflection or force; `wire` its number."""
        self.quantity, self.wire = quantity, wire
        self._values: deque[float] = deque(maxlen=_SAMPLES)
        self._residuals: deque[float] = deque(maxlen=_SAMPLES)
        self._bins: deque[Bin] = deque(maxlen=MEMORY)
        self._learned: Noise | None = None
        self._scatter: float | None = None  # None where samples came since

    def samples(self, value: Array, residual: Array) -> None:
        """Measured values (n,), and measured less predicted."""
        self._values.extend(value.tolist())
        self._residuals.extend(residual.tolist())
        self._scatter = None

    def add(self, one: Bin) -> None:
        """The next bin."""
        self._bins.append(one)

    def clear(self) -> None:
        """Forget the bins; the samples' noise stays."""
        self._bins.clear()
        self._learned = None

    @property
    def bins(self) -> int:
        """Bins at hand."""
        return len(self._bins)

    @property
    def play(self) -> float:
        """Within which a difference that is smoothed over the newest bins is noise."""
        if np.isnan(self.scatter) or not self._bins:
            return 0.0
        return float(_PLAY * self.scatter / np.sqrt(self._bins[-1].count))

    @property
    def scatter(self) -> float:
        """Standard deviation from sample to sample, the converter's steps included; NaN before
        there are enough."""
        if len(self._values) < _FEWEST_SAMPLES:
            return np.nan
        if self._scatter is None:
            steps = resolution(np.array(self._values)) / np.sqrt(12.0)
            white = white_noise_level(np.array(self._residuals))
            self._scatter = float(max(white, steps, _LEAST[self.quantity]))
        return self._scatter

    def read(
        self, allowed: float, sides: int, fewest: int, window: float, threshold: float = np.inf
    ) -> BinStatistics | None:
        """What the bins of the last `window` s say, None while there are too few.

        Args:
            allowed: slow drift that the sensor may have, in the signal's unit.
            sides: how many there are; fewest: bins that make a verdict.
            threshold: a surprising gap beyond it is not learned as noise.
        """
        scatter = self.scatter
        if len(self._bins) < fewest or np.isnan(scatter):
            return None
        columns = np.array([(b.time, b.residual, b.count, b.off, b.cause, b.side)
                            for b in self._bins])  # fmt: skip
        time, residual, count, off, cause, side = columns.T
        steady = np.hypot(scatter, allowed)
        # Bins in which the moment of a reading matters count as much as they inform.
        level = residual * steady / np.hypot(steady, off)
        last = slice(min(int(np.searchsorted(time, time[-1] - window)), len(time) - fewest), None)
        noise = self._learned
        if noise is None or noise.usual != allowed:
            noise = self._noise(level, time, count, last.start, scatter, allowed)
        tolerance = np.hypot(steady, off)
        squares = (residual / tolerance)[last] ** 2
        gap = np.full(sides, np.nan)
        for k in range(sides):
            here = side[last] == k
            if here.any():
                gap[k] = np.sqrt(squares[here].sum() / len(squares))
        power = float(cause @ cause)
        informative = power > 0.1 * float(tolerance @ tolerance)
        energy, surprise = judge(noise, level[last])
        size = float(np.sqrt(np.mean(squares)))
        if self._learned is not None and size >= STAYS * threshold:
            surprise = max(surprise, SURPRISING)  # once it has come, it is there until it goes
        self._learned = noise if size >= threshold * STAYS and surprise >= SURPRISING else None
        return BinStatistics(
            energy, surprise, gap, noise, scatter, residual[last], cause[last], tolerance[last],
            float(residual @ cause) / power if informative else np.nan,
        )

    @staticmethod
    def _noise(
        level: Array, time: Array, count: Array, stop: int, scatter: float, allowed: float
    ) -> Noise:
        """Noise that the bins up to `stop` show, but no more than a sensor may have; as much while
        they are too few for an estimate."""
        white = scatter / float(np.sqrt(np.median(count)))
        period = max(round(float(np.median(np.diff(time))), 2), 0.01)
        if stop < 2:
            return Noise(white, allowed, _FAST, period, allowed)
        found = estimate_noise([level[:stop]], white, period, allowed)
        # As fast as it was seen to go, and as far as it may: nobody has seen that within a minute.
        share = allowed / max(found.drift, 1e-3 * allowed)
        seen = max(share**2 * found.time, period)
        # So few bins may have shown a slower one by chance.
        surely = seen * float(chi2.ppf(_CHANCE, stop)) / stop
        return Noise(
            min(found.white, _MOST_WHITE * white), allowed, min(seen, max(surely, _FAST)),
            period, allowed,
        )  # fmt: skip


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
    from_level = abs(float(ones @ white)) / float(np.sqrt(ones @ ones))
    return energy, max(from_energy, from_level)


def _whitened(noise: Noise, level: Array) -> Array:
    """The level (n,) and ones, each with the noise as unit variance; exact from the first bin on,
    unlike the recursion that whitens long records."""
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
# has changed by more than its noise (as in diagnose/chain.py). So the mechanical bins come a
# second after the others.

_LATE = 0.2  # s that a reading may come after the voltages of its moment
_AHEAD = 5  # bins on either side that smooth a bin's temperatures
_SMOOTHING = 2.0  # bins, standard deviation
_WEIGHTS = np.exp(-0.5 * (np.arange(-_AHEAD, _AHEAD + 1) / _SMOOTHING) ** 2)
_PLAY = 3.0 / np.sqrt(2.0 * np.sqrt(np.pi) * _SMOOTHING)  # of a bin's noise, thrice what is left
_CLOCK_STD = 0.02  # s, of one instrument's stamps behind the voltages'
_SURELY = 1.0  # s after a wire has been found martensite or austenite; the bench may be later
_ZERO_STD = 0.2  # K, of a camera's zero


class Comparison:
    """Bins of all signals since a moment of the free run.

    Attributes:
        currents, temperatures: one a wire; driven: the mechanical signal against the model led by
            temperatures; free: against the free run.
        late: readings that came after their bin had been closed.
    """

    def __init__(self, run: FreeRun, drift: float) -> None:
        """Begin where the run is now; `drift` K that a thermometer may have."""
        parameters, wires = run.parameters, len(run.parameters["bench.channels"])
        self._moves = load_kind(parameters) != "clamped"
        mechanics = "deflection" if self._moves else "force"
        self.currents = [SignalBins("current", k) for k in range(wires)]
        self.temperatures = [SignalBins("temperature", k) for k in range(wires)]
        self.driven, self.free = SignalBins(mechanics, 0), SignalBins(mechanics, 0)
        self.late = 0
        self._side = side_of_channels(parameters)
        self._ambient = float(parameters["environment.ambient_temperature"])
        self._start, self._closed = run.time, 0
        self._sums: dict[tuple[int, int], Array] = defaultdict(lambda: np.zeros(4))
        self._mechanics: dict[int, list[tuple[Array, Array]]] = defaultdict(list)
        self._led = TemperatureDriven(parameters, run.state)
        # The same a little warmer on one side and cooler on the other: what a camera's unknown
        # zero, and its drift, do to the mechanics.
        self._warmer = TemperatureDriven(parameters, run.state)
        self._last_led = run.trajectory.mechanics[-1]
        self._doubt = float(np.hypot(_ZERO_STD, drift))
        self._sign = np.where(self._side == 0, 1.0, -1.0)
        self._correction = np.zeros(wires)
        self._differences: deque[Array] = deque(maxlen=2 * _AHEAD + 1)
        self._doubts: deque[Array] = deque(maxlen=2 * _AHEAD + 1)

    def current(self, wire: int, time: Array, value: Array, predicted: Array) -> None:
        """Samples (n,) of a current [A]."""
        self._samples(self.currents[wire], wire, time, value, predicted, np.zeros(len(time)))

    def temperature(
        self, wire: int, time: Array, value: Array, predicted: Array, std: Array
    ) -> None:
        """Samples (n,) of a temperature [K], and their own standard deviations."""
        own = self.temperatures[wire]
        self._samples(own, len(self.currents) + wire, time, value, predicted, std)

    def mechanics(self, time: Array, value: Array, predicted: Array) -> None:
        """Samples (n,) of the deflection [m], or of the force [N]."""
        numbers = self._numbers(time)
        for number in np.unique(numbers).tolist():
            here = numbers == number
            if number < self._closed - _AHEAD:
                self.late += int(here.sum())
            else:
                self._mechanics[number].append((time[here], value[here]))
        for signal in (self.driven, self.free):
            signal.samples(value, value - predicted)

    def _samples(
        self, signal: SignalBins, key: int, time: Array, value: Array, predicted: Array, std: Array,
    ) -> None:
        numbers, residual = self._numbers(time), value - predicted
        for number in np.unique(numbers).tolist():
            here = numbers == number
            count = int(here.sum())
            if number < self._closed:
                self.late += count
            else:
                self._sums[number, key] += (
                    residual[here].sum(), count, predicted[here].sum(), std[here].sum()
                )
        signal.samples(value, residual)

    def _numbers(self, time: Array) -> NDArray[np.int64]:
        return np.floor((time - self._start) / BIN).astype(np.int64)

    def close(self, run: FreeRun) -> int:
        """Close the bins that are complete; how many."""
        count = 0
        while run.time >= self._start + (self._closed + 1) * BIN + _LATE:
            self._close_temperatures(run, self._closed)
            if self._closed >= _AHEAD:
                self._close_mechanics(run, self._closed - _AHEAD)
            self._closed += 1
            count += 1
        return count

    def _span(self, number: int) -> tuple[float, float]:
        return self._start + number * BIN, self._start + (number + 1) * BIN

    def _close_temperatures(self, run: FreeRun, number: int) -> None:
        start, stop = self._span(number)
        rows = run.trajectory.rows(start, stop)
        reading = run.trajectory.reading[rows]
        change = np.abs(reading[-1] - reading[0])
        moments = change / BIN * self._moment(run)
        wires = len(self.currents)
        difference, doubt = np.full(wires, np.nan), np.zeros(wires)
        for k in range(wires):
            side = int(self._side[k])
            if (found := self._taken(number, k)) is not None:
                residual, count, predicted, _ = found
                self.currents[k].add(Bin(stop, residual, count, 0.0, predicted, side))
            if (found := self._taken(number, wires + k)) is not None:
                residual, count, predicted, doubt[k] = found
                difference[k] = residual
                rise = predicted - self._ambient
                # Of pixels, emissivity and background: much the same in every picture.
                off = float(np.hypot(moments[k], doubt[k]))
                self.temperatures[k].add(Bin(stop, residual, count, off, rise, side))
        self._differences.append(difference)
        self._doubts.append(doubt)

    def _taken(self, number: int, key: int) -> tuple[float, int, float, float] | None:
        sums = self._sums.pop((number, key), None)
        if sums is None:
            return None
        residual, predicted, std = (float(sums[k] / sums[1]) for k in (0, 2, 3))
        return residual, int(sums[1]), predicted, std

    @staticmethod
    def _moment(run: FreeRun) -> float:
        """How well the moment of a reading, and of a jump between two voltages, is known [s]."""
        return float(np.hypot(_CLOCK_STD, run.spacing / np.sqrt(3.0)))

    def _close_mechanics(self, run: FreeRun, number: int) -> None:
        start, stop = self._span(number)
        trajectory, rows = run.trajectory, run.trajectory.rows(start, stop)
        time = trajectory.time[rows]
        if len(time) < 2:
            return
        own = self._differences[-1 - _AHEAD]
        # Measured less predicted temperatures (w,) of the middle bin, smoothed, with play.
        differences = np.array(self._differences)
        weights = _WEIGHTS[-len(differences):, np.newaxis] * np.isfinite(differences)
        total = weights.sum(axis=0)
        smooth = (weights * np.nan_to_num(differences)).sum(axis=0)
        smooth /= np.where(total > 0.0, total, 1.0)
        play = np.array([signal.play for signal in self.temperatures])
        before, after = self._correction, np.clip(self._correction, smooth - play, smooth + play)
        self._correction = after
        share = np.clip((time[1:] - start) / BIN, 0.0, 1.0)[:, np.newaxis]
        kelvin = trajectory.temperature[rows][1:] + before + share * (after - before)
        rough = np.nan_to_num(np.abs(own - after))
        led = np.insert(self._mechanics_of(self._led, time, kelvin), 0, self._last_led)
        self._last_led = float(led[-1])
        doubt = self._sign * np.sqrt(self._doubt**2 + rough**2 + self._doubts[-1 - _AHEAD] ** 2)
        warmer = self._mechanics_of(self._warmer, time, kelvin + doubt)
        free = trajectory.mechanics[rows]
        samples = self._mechanics.pop(number, [])
        if not samples or start < run.known_since + _SURELY:
            return
        at, values = (np.concatenate(part) for part in zip(*samples, strict=True))
        side = int(self._side[trajectory.driven[rows][-1]])
        spread = float(np.mean(np.abs(warmer - led[1:])))
        for signal, predicted in ((self.driven, led), (self.free, free)):
            moving = abs(float(predicted[-1] - predicted[0])) / BIN * self._moment(run)
            residual = float(np.mean(values - np.interp(at, time, predicted)))
            off = float(np.hypot(moving, spread))
            cause = float(np.mean(predicted))
            signal.add(Bin(stop, residual, len(values), off, cause, side))

    def _mechanics_of(self, bench: TemperatureDriven, time: Array, kelvin: Array) -> Array:
        deflection, force = bench.run(time, kelvin)
        return deflection if self._moves else force[:, 0]
