"""The bench's model on the measured voltages, and what it did lately."""

import math
from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.estimation.laws import FLOOR, reach_of
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench
from sma_bench.physics.kernel import State
from sma_bench.physics.material import current, time_constant
from sma_bench.physics.simulate import warmed_from_rest

_BACK = 0.5  # s; a stamp further back than that is a clock set back, or a record that begins anew
_QUEUE = 5000  # readings of a channel that wait for the others'
_LONGEST_STEP = 0.01  # s
_RECENT = 4.0  # s that can be looked up
_MEMORY = 60.0  # s of voltages, simulated again when parameters change
_OFF = 0.1  # V


class MeasuredVoltages:
    """Readings of each channel until every channel has one as late: only then is it known what
    drove the bench up to there. A voltage is held until the channel's next reading."""

    timeout: float  # s; a longer hole between two readings of a channel hides what drove it

    def __init__(self, wires: int) -> None:
        self._wires = wires
        self.dropped = {"not a number": 0, "out of order": 0}  # readings left out, by reason
        self._forget()

    def _forget(self) -> None:
        self._waiting = [deque[tuple[float, float]](maxlen=_QUEUE) for _ in range(self._wires)]
        self._latest = [-math.inf] * self._wires
        self._held = [math.nan] * self._wires

    def take(self, wire: int, time: float, volt: float) -> str:
        """A reading at `time` s; why the twin must begin anew, or ""."""
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
        """Channels that have not been heard."""
        return [k for k, latest in enumerate(self._latest) if latest == -math.inf]

    def changes(self) -> tuple[Array, Array]:
        """Times (n,) s of the readings, as far as all channels are known, and the voltages (n, w) V
        held from each on; NaN for a wire whose first reading is yet to come."""
        until = min(self._latest)  # -inf until every channel has been heard
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
    """What the model did, a row a step."""

    time: Array  # (n,) s
    temperature: Array  # (n, w) K
    reading: Array  # (n, w) K, of the sensors
    conductance: Array  # (n, w) A/V of the electrical readings
    mechanics: Array  # (n,) deflection [m], or force [N] of a clamped wire
    driven: IntArray  # wire with the highest voltage, of the last one in a rest

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
    """The model from the moment at which the twin joined."""

    def __init__(self, parameters: Parameters, time: float, temperature: Array,
                 voltage: Array) -> None:
        """Begin at `time` s with measured temperatures (w,) K, NaN where there is none; voltages
        (w,) V are held from then on."""
        self._measured = temperature
        self.time = self._joined = time  # s, up to which it has run
        self.spacing = 0.0  # s, the longest between two of the newest readings of a voltage
        # s, when every wire's martensite was known: a warm one may have been heated or cooled.
        self.known_since = np.inf
        self._known = np.zeros(len(temperature), dtype=bool)
        self._volts, self._driven = voltage, 0
        # Of each advance: the state before, None for that at which the twin joined; times, volts.
        self._log: deque[tuple[State | None, Array, Array]] = deque()
        self._begin(parameters, None)
        self.trajectory = self._followed(np.array([time]), voltage[np.newaxis])

    @property
    def state(self) -> State:
        return self._bench.state

    def advance(self, time: Array, voltage: Array) -> None:
        """Go on to times (n,) s; voltage (n, w) V is held from each of them on."""
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
        """Simulate the last minute again with other parameters, and go on with them."""
        state = self._log[0][0] if self._log else None
        self._begin(parameters, state)
        if self._log:
            _, times, volts = zip(*self._log, strict=True)
            begins = np.concatenate([times[0][:1], *(time[1:] for time in times)])
            held = np.vstack([volts[0][:1], *(volt[1:] for volt in volts)])
            self._log = deque([(state, begins, held)])
            self.trajectory = self._followed(begins, held)

    def of_another(self, parameters: Parameters) -> Self:
        """The same run of a bench with other parameters, its last minute simulated again."""
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
        """What the bench does, voltages (n, w) V held from each time (n,) s, in short steps."""
        counts = np.maximum(np.ceil(np.diff(time) / _LONGEST_STEP - 1e-6), 1.0).astype(int)
        if np.any(counts > 1):
            which = np.repeat(np.arange(len(counts)), counts)
            within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
            grid = time[which] + within * (np.diff(time) / counts)[which]
            time, voltage = np.append(grid, time[-1]), np.vstack([voltage[which], voltage[-1:]])
        run = self._bench.follow(time - time[0], voltage)
        xi, kelvin, p = run.martensite_fraction, run.temperature, self.parameters
        cold = float(p["wire.martensite_finish_temperature"])
        self._surely = (xi < 1e-6) | ((xi > 1.0 - 1e-6) & (kelvin < cold))
        mechanics = run.deflection_reading if load_kind(p) != "clamped" else run.force[:, 0]
        # Voltages noise around 0 in a rest: what counts is what heats.
        drives = run.voltage.max(axis=1) > _OFF
        newest = np.maximum.accumulate(np.where(drives, np.arange(len(time)), -1))
        driven = np.where(newest < 0, self._driven, np.argmax(run.voltage, axis=1)[newest])
        conductance = current(p, 1.0, kelvin, xi)
        return Trajectory(time, kelvin, run.temperature_reading, conductance, mechanics, driven)


class Doubt:
    """How far a sound bench may be from the prediction, its sensors' noise not counted: benches
    within what is open of the parameters run along, each by itself (estimation/laws.py)."""

    def __init__(self, run: FreeRun, benches: Sequence[Parameters], probability: float) -> None:
        self._run, self._reach = run, reach_of(probability)
        self._others = [run.of_another(bench) for bench in benches]
        self._least, self._most = (self._columns(run, slice(-1, None))[0] for _ in range(2))
        self._least[: run.trajectory.conductance.shape[1]] = 0.0  # a current spans from none

    def advance(self, time: Array, voltage: Array) -> None:
        """Go on as the run itself has done."""
        for other in self._others:
            other.advance(time, voltage)
        new = self._columns(self._run, slice(-len(time), None))
        self._least = np.minimum(self._least, new.min(axis=0))
        self._most = np.maximum(self._most, new.max(axis=0))

    def off(self, row: int) -> Array:
        """(2 w + 1,) how far the conductances, temperatures and the mechanics may be off there, in
        their units; a band has a floor of a share of what each has spanned."""
        rows = slice(row, row + 1)
        mean = self._columns(self._run, rows)[0]
        drawn = np.vstack([self._columns(other, rows) for other in self._others])
        floor = FLOOR * (self._most - self._least)
        return np.asarray(self._reach * np.sqrt(np.mean((drawn - mean) ** 2, axis=0) + floor**2))

    @staticmethod
    def _columns(run: FreeRun, rows: slice) -> Array:
        at = run.trajectory
        return np.column_stack([at.conductance[rows], at.reading[rows], at.mechanics[rows]])
