"""Measured against predicted, bin by bin, with the chain broken at the measured temperatures.

    V -> I, V -> T         the free run's readings
    T -> deflection        the model led through the measured temperatures
    V -> deflection        the free run's reading

The measured temperature is the model's plus the smoothed difference, which moves only when it has
changed by more than its noise (as in diagnose/chain.py). So the mechanical bins come a second after
the others.
"""

from collections import defaultdict, deque

import numpy as np
from numpy.typing import NDArray

from sma_bench.physics.boundary import side_of_channels
from sma_bench.physics.simulate import TemperatureDriven
from sma_bench.twin.free_run import FreeRun
from sma_bench.twin.signal_bins import BIN, Bin, SignalBins

Array = NDArray[np.float64]

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
        self._bends = wires > 1
        mechanics = "deflection" if self._bends else "force"
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
        self._last_led = run.course.mechanics[-1]
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
        self, signal: SignalBins, key: int, time: Array, value: Array, predicted: Array,
        std: Array,
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
        rows = run.course.rows(start, stop)
        reading = run.course.reading[rows]
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
        course, rows = run.course, run.course.rows(start, stop)
        time = course.time[rows]
        if len(time) < 2:
            return
        own = self._differences[-1 - _AHEAD]
        before, after = self._correction, self._corrected()
        self._correction = after
        share = np.clip((time[1:] - start) / BIN, 0.0, 1.0)[:, np.newaxis]
        kelvin = course.temperature[rows][1:] + before + share * (after - before)
        rough = np.nan_to_num(np.abs(own - after))
        led = np.insert(self._mechanics_of(self._led, time, kelvin), 0, self._last_led)
        self._last_led = float(led[-1])
        doubt = self._sign * np.sqrt(self._doubt**2 + rough**2 + self._doubts[-1 - _AHEAD] ** 2)
        warmer = self._mechanics_of(self._warmer, time, kelvin + doubt)
        free = course.mechanics[rows]
        samples = self._mechanics.pop(number, [])
        if not samples or start < run.known_since + _SURELY:
            return
        at, values = (np.concatenate(part) for part in zip(*samples, strict=True))
        side = int(self._side[course.driven[rows][-1]])
        spread = float(np.mean(np.abs(warmer - led[1:])))
        for signal, predicted in ((self.driven, led), (self.free, free)):
            moving = abs(float(predicted[-1] - predicted[0])) / BIN * self._moment(run)
            residual = float(np.mean(values - np.interp(at, time, predicted)))
            off = float(np.hypot(moving, spread))
            cause = float(np.mean(predicted))
            signal.add(Bin(stop, residual, len(values), off, cause, side))

    def _corrected(self) -> Array:
        """(w,) K, measured less predicted temperatures of the middle bin, smoothed, with play."""
        rows = np.array(self._differences)
        weights = _WEIGHTS[-len(rows):, np.newaxis] * np.isfinite(rows)
        total = weights.sum(axis=0)
        smooth = (weights * np.nan_to_num(rows)).sum(axis=0) / np.where(total > 0.0, total, 1.0)
        play = np.array([self._play_of(signal) for signal in self.temperatures])
        return np.clip(self._correction, smooth - play, smooth + play)

    @staticmethod
    def _play_of(signal: SignalBins) -> float:
        scatter, rate = signal.scatter, signal.samples_a_bin
        if np.isnan(scatter) or not rate:
            return 0.0
        return float(_PLAY * scatter / np.sqrt(rate))

    def _mechanics_of(self, bench: TemperatureDriven, time: Array, kelvin: Array) -> Array:
        deflection, force = bench.run(time, kelvin)
        return deflection if self._bends else force[:, 0]
