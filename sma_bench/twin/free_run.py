"""The bench's model on the measured voltages, and what it did lately."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench
from sma_bench.physics.heat import time_constant
from sma_bench.physics.kernel import State
from sma_bench.physics.material import current
from sma_bench.physics.simulate import Simulation, warmed_from_rest

Array = NDArray[np.float64]


# --- Measured voltages of all channels in the order of their stamps, and what is wrong with them.

_BACK = 0.5  # s; a stamp further back than that is a clock set back, or a record that begins anew
_QUEUE = 5000


class MeasuredVoltages:
    """Readings of each channel until every channel has one as late: only then is it known what
    drove the bench up to there. A voltage is held until the channel's next reading.

    Attributes:
        dropped: readings left out by reason.
    """

    def __init__(self, wires: int, timeout: float) -> None:
        """`timeout` s: a longer hole between two readings of a channel hides what drove it."""
        self._timeout = timeout
        self.dropped = {"not a number": 0, "out of order": 0}
        self._waiting: list[deque[tuple[float, float]]] = [
            deque(maxlen=_QUEUE) for _ in range(wires)
        ]
        self._latest = [-math.inf] * wires
        self._held = [math.nan] * wires

    def take(self, wire: int, time: float, volt: float) -> str:
        """A reading at `time` s; why the twin must begin anew, or ""."""
        if not math.isfinite(volt):
            self.dropped["not a number"] += 1
            return ""
        passed, reason = time - self._latest[wire], ""
        if passed < -_BACK:
            reason = f"time went back by {-passed:.3g} s"
        elif passed <= 0.0:
            self.dropped["out of order"] += 1
            return ""
        elif self._timeout < passed < math.inf:
            reason = f"no voltages for {passed:.3g} s"
        if reason:
            self.clear()
        self._latest[wire] = time
        self._waiting[wire].append((time, volt))
        return reason

    def clear(self) -> None:
        """Forget everything but the counts."""
        for k, waiting in enumerate(self._waiting):
            waiting.clear()
            self._latest[k], self._held[k] = -math.inf, math.nan

    def missing(self) -> list[int]:
        """Wires not heard of."""
        return [k for k, latest in enumerate(self._latest) if latest == -math.inf]

    def changes(self) -> tuple[Array, Array]:
        """Times (n,) s of the readings, as far as all channels are known, and the voltages (n, w) V
        held from each on; NaN for a wire whose first reading is yet to come."""
        until = min(self._latest)  # -inf until every channel has been heard
        times: list[float] = []
        volts: list[list[float]] = []
        while True:
            time = min((w[0][0] for w in self._waiting if w), default=math.inf)
            if time > until:
                break
            for k, waiting in enumerate(self._waiting):
                if waiting and waiting[0][0] == time:
                    self._held[k] = waiting.popleft()[1]
            times.append(time)
            volts.append(list(self._held))
        return np.array(times), np.array(volts).reshape(len(times), len(self._held))


# --- The model on these voltages, and the same with other parameters.

_LONGEST_STEP = 0.01  # s
_RECENT = 4.0  # s that can be looked up
_MEMORY = 60.0  # s of voltages, lived through again when parameters change
_CHECKPOINT = 10.0  # s
_OFF = 0.1  # V


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What the model did, a row a step.

    Attributes:
        time: (n,) s; temperature, reading: (n, w) K, of the wires and of their sensors.
        conductance: (n, w) A/V of the electrical readings.
        mechanics: (n,) deflection [m], or force [N] of a clamped wire.
        driven: (n,) number of the wire with the highest voltage, of the last one in a rest.
    """

    time: Array
    temperature: Array
    reading: Array
    conductance: Array
    mechanics: Array
    driven: NDArray[np.int64]

    def rows(self, start: float, stop: float) -> slice:
        """Rows in (start, stop], and the one before them."""
        first = max(int(np.searchsorted(self.time, start, side="right")) - 1, 0)
        return slice(first, int(np.searchsorted(self.time, stop, side="right")))

    def followed_by(self, other: Self) -> "Trajectory":
        """The last seconds of this one, then the other one without its first row."""
        kept = int(np.searchsorted(self.time, self.time[-1] - _RECENT))
        return Trajectory(*(
            np.concatenate([own[kept:], more[1:]])
            for own, more in zip(vars(self).values(), vars(other).values(), strict=True)
        ))  # fmt: skip


class FreeRun:
    """The model from the moment at which the twin joined.

    Attributes:
        parameters: now; trajectory: the last seconds; time: s, up to which it has run.
        spacing: s, the longest time between two of the newest readings of a voltage.
        known_since: s, when the martensite fraction of every wire was known; inf before: a wire
            that was joined warm may have been heated or cooled there.
    """

    def __init__(
        self, parameters: Parameters, time: float, temperature: Array, voltage: Array
    ) -> None:
        """Begin at `time` s with measured temperatures (w,) K, NaN where there is none; voltages
        (w,) V are held from then on."""
        self._measured = temperature
        self._take(parameters)
        self._bench = Bench(parameters, initial=self._joined_state())
        self.time = self._joined = time
        self.known_since = np.inf
        self._known = np.zeros(len(temperature), dtype=bool)
        self.spacing = 0.0
        self._volts, self._driven = voltage, 0
        self._checkpoints: deque[tuple[float, State | None]] = deque([(time, None)])
        self._log: deque[tuple[Array, Array]] = deque()
        here = self._bench.follow([0.0], voltage[np.newaxis])
        self.trajectory = self._trajectory(np.array([time]), here)

    @property
    def state(self) -> State:
        """The model's state."""
        return self._bench.state

    def advance(self, time: Array, voltage: Array) -> None:
        """Go on to times (n,) s; voltage (n, w) V is held from each of them on."""
        begins = np.concatenate([[self.time], time])
        held = np.vstack([self._volts, voltage])
        self.spacing = float(np.max(np.diff(begins)))
        self._log.append((begins, held))
        grid, volts = _in_steps(begins, held)
        run = self._bench.follow(grid - grid[0], volts)
        self.trajectory = self.trajectory.followed_by(self._trajectory(grid, run))
        self.time, self._volts, self._driven = float(time[-1]), held[-1], self.trajectory.driven[-1]
        if not self._known.all():
            xi, kelvin = run.martensite_fraction, run.temperature
            surely = (xi < 1e-6) | ((xi > 1.0 - 1e-6) & (kelvin < self._cold))
            settled = np.isfinite(self._measured) | (self.time - self._joined > self._settling)
            self._known |= surely.any(axis=0) & settled
            if self._known.all():
                self.known_since = self.time
        if self.time - self._checkpoints[-1][0] > _CHECKPOINT:
            self._checkpoints.append((self.time, self._bench.state))
            while len(self._checkpoints) > 1 and self._checkpoints[1][0] <= self.time - _MEMORY:
                self._checkpoints.popleft()
            while self._log[0][0][0] < self._checkpoints[0][0]:
                self._log.popleft()

    def change(self, parameters: Parameters) -> None:
        """Live the last minute again with other parameters, and go on with them."""
        self._take(parameters)
        start, state = self._checkpoints[0]
        self._checkpoints = deque([(start, state)])
        self._bench = Bench(parameters, initial=state or self._joined_state())
        if not self._log:
            return
        begins = np.concatenate([self._log[0][0][:1], *(time[1:] for time, _ in self._log)])
        held = np.vstack([self._log[0][1][:1], *(volts[1:] for _, volts in self._log)])
        grid, volts = _in_steps(begins, held)
        run = self._bench.follow(grid - grid[0], volts)
        trajectory = self._trajectory(grid, run)
        self.trajectory = trajectory.followed_by(trajectory)

    def _take(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self._moves = load_kind(parameters) != "clamped"
        self._cold = float(parameters["wire.martensite_finish_temperature"])
        self._settling = 10.0 * float(time_constant(parameters))

    def _joined_state(self) -> State:
        ambient = self.parameters["environment.ambient_temperature"]
        return warmed_from_rest(self.parameters, np.nan_to_num(self._measured, nan=ambient))

    def _trajectory(self, time: Array, run: Simulation) -> Trajectory:
        conductance = current(self.parameters, 1.0, run.temperature, run.martensite_fraction)
        mechanics = run.deflection_reading if self._moves else run.force[:, 0]
        # Voltages noise around 0 in a rest: what counts is what heats.
        drives = run.voltage.max(axis=1) > _OFF
        newest = np.maximum.accumulate(np.where(drives, np.arange(len(time)), -1))
        strongest = np.argmax(run.voltage, axis=1)
        driven = np.where(newest < 0, self._driven, strongest[newest])
        return Trajectory(
            time, run.temperature, run.temperature_reading, conductance, mechanics, driven
        )


def _in_steps(time: Array, voltage: Array) -> tuple[Array, Array]:
    """The same held voltages with no step longer than _LONGEST_STEP."""
    counts = np.maximum(np.ceil(np.diff(time) / _LONGEST_STEP - 1e-6), 1.0).astype(int)
    if np.all(counts == 1):
        return time, voltage
    which = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    grid = time[which] + within * (np.diff(time) / counts)[which]
    return np.append(grid, time[-1]), np.vstack([voltage[which], voltage[-1:]])
