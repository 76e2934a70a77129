"""The twin: measured readings in, predictions, residuals and a verdict out. No ROS, no clock.

The verdict says where along the chain the model has stopped following, from what the signals' bins
say: a stage is named where its signal is off by more than a threshold times the noise, and where
that is no coloured noise. What an earlier stage explains is not held against a later one.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.noise_model import estimate_noise
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded
from sma_bench.physics.boundary import side_names
from sma_bench.twin.comparison import BIN, STAYS, SURPRISING, BinStatistics, Comparison
from sma_bench.twin.free_run import FreeRun, MeasuredVoltages

Array = NDArray[np.float64]

NANOSECONDS = 1_000_000_000
CURRENT, TEMPERATURE, MECHANICS = "current", "temperature", "mechanics"
_WAIT_FOR_TEMPERATURES = 1.0  # s
_FRESH = 0.5  # s
_FAR_AHEAD = 2.0  # s; readings of a record's last round
_QUEUE = 4000
_EVERY = 5  # bins between two verdicts
_CLAMPED = 1e-4  # m; a wire whose end has moved further is not the one that is modelled


@dataclass(frozen=True)
class Prediction:
    """What the model says at a time (ns): (w,) A and K, and the deflection [m] or force [N]."""

    stamp: int
    voltage: Array
    current: Array
    temperature: Array
    mechanics: float


@dataclass(frozen=True)
class Residual:
    """Measured less predicted, of one reading; `wire` is 0 for the mechanics."""

    kind: str
    wire: int
    stamp: int
    value: float


class Twin:
    """Runs the model on measured voltages and compares what else is measured.

    Stamps are ns, readings SI. What cannot be used (NaN, late, out of order) is counted.

    Attributes:
        verdict: the newest; restarts: how often the twin began anew, and `reason` why.
    """

    def __init__(
        self, parameters: Parameters, settings: Mapping[str, Any],
        on_prediction: Callable[[Prediction], None], on_residual: Callable[[Residual], None],
    ) -> None:
        """`settings` are the twin node's own parameters; the callbacks get the output."""
        self._parameters = as_recorded(parameters)  # readings are direct volts, whatever switches
        self._on_prediction, self._on_residual = on_prediction, on_residual
        self._channels = parameters["bench.channels"]
        self._wires = len(self._channels)
        self._period = 1.0 / settings["publish_rate"]
        self.tune(settings)
        self._voltages = MeasuredVoltages(self._wires, settings["voltage_timeout"])
        self._judge = Judge(side_names(parameters))
        self._origin: int | None = None
        self._ignored = 0
        self.restarts, self.reason = 0, ""
        self._begin_anew()

    def tune(self, settings: Mapping[str, Any]) -> None:
        """Take over the settings of the judgement."""
        self._rules = Rules(
            settings["threshold"], settings["window"], round(settings["learning"] / BIN),
            {q: settings[f"allowed.{q}"]
             for q in ("current", "temperature", "deflection", "force")},
        )  # fmt: skip

    def _begin_anew(self) -> None:
        self._run: FreeRun | None = None
        self._comparison: Comparison | None = None
        self._waited_since: float | None = None
        self._kelvin: dict[int, tuple[float, float]] = {}
        self._pending: dict[tuple[str, int], deque[tuple[float, int, float, float, float]]] = {}
        self._next_due: dict[tuple[str, int], float] = {}
        self._unjudged = 0
        self._judge.forget()
        self.verdict = Verdict(LEARNING, "learning: waiting for voltages")

    def power(self, wire: int, stamp: int, volt: float, ampere: float) -> None:
        """A reading of a channel's voltage [V] and current [A], NaN for what is not measured."""
        time = self._time(stamp)
        if reason := self._voltages.take(wire, time, volt):
            self._begin_anew()
            self.restarts, self.reason = self.restarts + 1, reason
        if math.isfinite(ampere) and math.isfinite(volt):
            self._queue(CURRENT, wire, time, stamp, ampere, volt)

    def temperature(self, wire: int, stamp: int, kelvin: float, std: float = 0.0) -> None:
        """A reading of a wire's temperature, and its own standard deviation [K], 0 if not known."""
        time = self._time(stamp)
        if not math.isfinite(kelvin):
            self._ignored += 1
            return
        self._kelvin[wire] = time, kelvin
        self._queue(TEMPERATURE, wire, time, stamp, kelvin, std=std)

    def mechanics(self, stamp: int, value: float, elongation: float = 0.0) -> None:
        """A deflection [m], or the force [N] of a clamped wire elongated by so much [m]."""
        if not math.isfinite(value) or abs(elongation) > _CLAMPED:
            self._ignored += 1
            return
        self._queue(MECHANICS, 0, self._time(stamp), stamp, value)

    def change(self, parameters: Parameters) -> None:
        """Go on with other parameters of the same channels; the last minute is lived again."""
        self._parameters = as_recorded(parameters)
        if self._run is not None:
            self._run.change(self._parameters)
            self._comparison = Comparison(self._run, self._rules.allowed["temperature"])
            self._unjudged = 0
            self.verdict = Verdict(LEARNING, "learning: parameters have changed")

    def accept(self) -> None:
        """Take the present gap as known: only more of it counts as grown."""
        self._judge.accept()

    @property
    def counts(self) -> dict[str, int]:
        """What was left out, by reason, and how often the twin began anew."""
        late = self._comparison.late if self._comparison else 0
        return {
            "voltages_not_a_number": self._voltages.dropped["not a number"],
            "voltages_out_of_order": self._voltages.dropped["out of order"],
            "readings_not_usable": self._ignored, "readings_late": late,
            "restarts": self.restarts,
        }

    @property
    def stamp(self) -> int:
        """ns, up to which the model has run; 0 before it has begun."""
        return self._stamp(self._run.time) if self._run else 0

    def _time(self, stamp: int) -> float:
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) / NANOSECONDS

    def _stamp(self, time: float) -> int:
        return (self._origin or 0) + round(time * NANOSECONDS)

    def _queue(
        self, kind: str, wire: int, time: float, stamp: int, value: float, factor: float = 1.0,
        std: float = 0.0,
    ) -> None:
        key = kind, wire
        if key not in self._pending:
            self._pending[key] = deque(maxlen=_QUEUE)
        self._pending[key].append((time, stamp, value, factor, std))

    def advance(self) -> None:
        """Run the model as far as the voltages are known, compare, and judge every second."""
        time, volts = self._voltages.changes()
        if self._run is None:
            self._join(time, volts)
            time = time[:0]
        run, comparison = self._run, self._comparison
        if run is None or comparison is None:
            missing = [self._channels[k] for k in self._voltages.missing()]
            said = f"voltage of {', '.join(missing)}" if missing else "temperatures to begin with"
            self.verdict = Verdict(LEARNING, f"learning: waiting for {said}")
        elif len(time):
            run.advance(time, volts)
            trajectory = run.trajectory
            rows = np.searchsorted(trajectory.time, time)
            for k in self._due("prediction", 0, time):
                row = min(int(rows[k]), len(trajectory.time) - 1)
                self._on_prediction(Prediction(
                    self._stamp(float(time[k])), volts[k], volts[k] * trajectory.conductance[row],
                    trajectory.reading[row], float(trajectory.mechanics[row]),
                ))  # fmt: skip
            for (kind, wire), waiting in self._pending.items():
                count = sum(1 for _ in takewhile(lambda one: one[0] <= run.time, waiting))
                if not count:
                    if waiting and waiting[0][0] > run.time + _FAR_AHEAD:
                        self._ignored += len(waiting)
                        waiting.clear()
                    continue
                taken = [waiting.popleft() for _ in range(count)]
                time, value, factor, std = np.array([(at, v, f, d) for at, _, v, f, d in taken]).T
                predicted = np.interp(time, run.trajectory.time, _column(run, kind, wire)) * factor
                if kind == CURRENT:
                    comparison.current(wire, time, value, predicted)
                elif kind == TEMPERATURE:
                    comparison.temperature(wire, time, value, predicted, std)
                else:
                    comparison.mechanics(time, value, predicted)
                residual = (value - predicted).tolist()
                for k in self._due(kind, wire, time):
                    self._on_residual(Residual(kind, wire, taken[k][1], residual[k]))
            self._unjudged += comparison.close(run)
            if self._unjudged >= _EVERY:
                self._unjudged = 0
                self.verdict = self._judge.judge(comparison, self._rules)

    def _join(self, time: Array, volts: Array) -> None:
        """Begin where temperatures are known, or a second later without those that never came."""
        known = np.flatnonzero(~np.isnan(volts).any(axis=1))
        if not len(known):
            return
        now = float(time[-1])
        if self._waited_since is None:
            self._waited_since = float(time[known[0]])
        fresh = {w: v for w, (then, v) in self._kelvin.items() if abs(then - now) < _FRESH}
        if len(fresh) < self._wires and now - self._waited_since < _WAIT_FOR_TEMPERATURES:
            return
        kelvin = np.array([fresh.get(w, math.nan) for w in range(self._wires)])
        # At the newest moment: a wire may be heating by the time its temperature is heard.
        self._run = FreeRun(self._parameters, now, kelvin, volts[-1])
        self._comparison = Comparison(self._run, self._rules.allowed["temperature"])
        self.verdict = Verdict(LEARNING, "learning the noise")

    def _due(self, kind: str, wire: int, time: Array) -> list[int]:
        """Which of the times (n,) are to be published."""
        due, chosen = self._next_due.get((kind, wire), -math.inf), []
        for k, at in enumerate(time.tolist()):
            if at >= due - 1e-6:
                due = max(due + self._period, at + 0.5 * self._period)
                chosen.append(k)
        self._next_due[kind, wire] = due
        return chosen


def compile_model(parameters: Parameters) -> None:
    """Compile what a twin runs, which may take seconds, before readings arrive."""
    wires = len(parameters["bench.channels"])
    run = FreeRun(as_recorded(parameters), 0.0, np.full(wires, math.nan), np.zeros(wires))
    run.advance(np.array([BIN]), np.zeros((1, wires)))
    estimate_noise([np.zeros(2)], 1.0, BIN)


def _column(run: FreeRun, kind: str, wire: int) -> Array:
    """(n,) trajectory of what a sensor reads; of a current, the conductance."""
    if kind == MECHANICS:
        return run.trajectory.mechanics
    return (run.trajectory.conductance if kind == CURRENT else run.trajectory.reading)[:, wire]


# --- the verdict

ELECTRICAL, THERMAL, MECHANICAL, SENSOR = STAGES = (
    "electrical", "thermal", "mechanical", "sensor",
)
MEASURED_STAGES = STAGES[:3]
LEARNING, QUIET, GAP, GREW = "learning", "quiet", "gap", "grew"
_ACQUAINTANCE = 60  # verdicts, one a second
_GROWN = 1.5  # times what was known
_ALIKE = 0.5  # of the larger side
_MUCH = 2.0  # times, as in diagnose/chain.py


@dataclass(frozen=True)
class StageState:
    """What one stage shows.

    Attributes:
        energy: mean square of its whitened residuals, 1 for noise; NaN while learning.
        gap: root mean square of its residuals over the noise of a sample, of the worse side.
        counted: the part of it, a side, that is this stage's own and no noise.
    """

    stage: str
    energy: float
    gap: float
    counted: Array


@dataclass(frozen=True)
class Verdict:
    """`state` is learning, quiet, gap (as it was known) or grew; `stages` and `sides` are those
    named in the message."""

    state: str
    message: str
    stages: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    measured: tuple[StageState, ...] = ()


class Judge:
    """Remembers which gaps are known, to say what grew."""

    def __init__(self, sides: Sequence[str]) -> None:
        self._sides = tuple(sides)
        self._known: dict[str, float] = {}
        self._unknown: dict[str, int] = {}
        self._open: set[str] = set()
        self._latest: dict[str, Array] = {}

    def forget(self) -> None:
        """Begin anew: the first verdict of a stage becomes what is known of it."""
        self._known, self._unknown, self._open, self._latest = {}, {}, set(), {}

    def accept(self) -> None:
        """Take the present gaps as known."""
        for stage, counted in self._latest.items():
            self._known[stage] = float(counted.max())

    def judge(self, comparison: Comparison, settings: "Rules") -> Verdict:
        """What the bins say now."""
        measured = stage_states(comparison, settings, len(self._sides))
        judged = [s for s in measured if not np.isnan(s.energy)]
        if not judged:
            return Verdict(LEARNING, "learning the noise", measured=tuple(measured))
        named = {s.stage: s.counted for s in judged}
        seen = {s.stage: s.gap for s in judged}  # surprising or not
        named |= _sensor(comparison, settings, named, len(self._sides))
        self._latest = named
        gaps, grown = [], []
        for stage, counted in named.items():
            size = float(counted.max())
            least = settings.threshold * (STAYS if stage in self._open else 1.0)
            self._open = self._open | {stage} if size >= least else self._open - {stage}
            # A gap that was there from the first verdict on is known at its largest of a minute.
            if stage not in self._known:
                first = stage != SENSOR  # which shows only once the mechanics contradict it
                wide = seen.get(stage, 0.0) >= settings.threshold
                self._known[stage] = size if first else 0.0
                self._unknown[stage] = _ACQUAINTANCE if first and wide else 0
            elif self._unknown.get(stage, 0) > 0:
                self._known[stage] = max(self._known[stage], size)
                self._unknown[stage] -= 1
            if stage in self._open:
                gaps.append(stage)
                if size > max(least, _GROWN * self._known[stage]):
                    grown.append(stage)
        waiting = [s.stage for s in measured if np.isnan(s.energy)]
        if not gaps:
            apart = f"; not judged: {', '.join(waiting)}" if waiting else ""
            return Verdict(QUIET, f"no gap beyond the noise{apart}", measured=tuple(measured))
        stages = tuple(grown or gaps)
        sides = tuple(dict.fromkeys(s for stage in stages for s in self._sides_of(stage)))
        blind = any(not s.bins for s in comparison.temperatures)
        places = []
        for stage in stages:
            named_sides = self._sides_of(stage)
            where = "both sides" if len(named_sides) > 1 else f"{named_sides[0]} side"
            what = "temperature sensor" if stage == SENSOR else f"{stage} stage"
            if stage == MECHANICAL and blind:
                what = "thermal or mechanical stage (wires without temperatures)"
            places.append(what if len(self._sides) == 1 else f"{what}, {where}")
        said = f"{'gap grew' if grown else 'gap, as it was known'}: {'; '.join(places)}"
        return Verdict(GREW if grown else GAP, said, stages, sides, tuple(measured))

    def _sides_of(self, stage: str) -> tuple[str, ...]:
        counted = self._latest[stage]
        there = counted >= _ALIKE * counted.max()
        return tuple(n for n, here in zip(self._sides, there, strict=True) if here)


@dataclass(frozen=True)
class Rules:
    """How gaps are judged.

    Attributes:
        threshold: root mean square residual over the noise from which on there is a gap.
        window: s that are looked at; fewest: bins that make a verdict.
        allowed: slow drift that a sensor may have, by quantity, SI.
    """

    threshold: float
    window: float
    fewest: int
    allowed: dict[str, float]


def stage_states(comparison: Comparison, rules: Rules, sides: int) -> list[StageState]:
    """Every stage that has a signal, in the order of the chain."""

    def read(signals: Sequence) -> list[BinStatistics | None]:
        return [
            s.read(rules.allowed[s.quantity], sides, rules.fewest, rules.window, rules.threshold)
            for s in signals
        ]

    currents, temperatures = read(comparison.currents), read(comparison.temperatures)
    driven, free = read([comparison.driven, comparison.free])
    states = []
    for stage, readings in ((ELECTRICAL, currents), (THERMAL, temperatures)):
        counted = [_counted(r) for r in readings]
        if stage == THERMAL:
            counted = [
                _beyond_current(c, r, of_current)
                for c, r, of_current in zip(counted, readings, currents, strict=True)
            ]
        states.append(_state(stage, readings, counted, sides))
    mechanical = _counted(driven)
    hot = states[-1].gap >= rules.threshold  # whoever is to blame for it
    if hot and driven and free and np.nanmax(free.gap) > _MUCH * np.nanmax(driven.gap):
        mechanical = None  # what is missing acts before the temperature
    states.append(_state(MECHANICAL, [driven], [mechanical], sides))
    return states


def _counted(reading: BinStatistics | None) -> Array | None:
    if reading is None or reading.surprise < SURPRISING:
        return None
    return np.nan_to_num(reading.gap)


def _beyond_current(
    counted: Array | None, reading: BinStatistics | None, current: BinStatistics | None
) -> Array | None:
    """The thermal gap that is left when a wire is heated in proportion to its current error.

    Once where the resistance is wrong, twice where the voltage is: the smaller rest counts.
    """
    if counted is None or reading is None or current is None or np.isnan(current.share):
        return counted
    def power(times: float) -> float:
        left = reading.residual - times * current.share * reading.cause
        return float(np.mean((left / reading.tolerance) ** 2))

    left, before = min(power(times) for times in (0.0, 1.0, 2.0)), power(0.0)
    return np.asarray(counted * np.sqrt(left / before))


def _state(
    stage: str, readings: Sequence[BinStatistics | None], counted: Sequence[Array | None],
    sides: int,
) -> StageState:
    known = [r for r in readings if r is not None]
    if not known:
        return StageState(stage, np.nan, np.nan, np.zeros(sides))
    own = [np.zeros(sides), *(c for c in counted if c is not None)]
    return StageState(
        stage, float(np.mean([r.energy for r in known])),
        float(max(np.nanmax(r.gap) for r in known)), np.max(own, axis=0),
    )


def _sensor(
    comparison: Comparison, rules: Rules, named: dict[str, Array], sides: int
) -> dict[str, Array]:
    """A thermometer to be doubted: what follows from the voltages is right, and what follows from
    the measured temperatures is not."""
    if THERMAL not in named or MECHANICAL not in named:
        return {}
    wrong = min(named[THERMAL].max(), named[MECHANICAL].max()) >= rules.threshold
    free = comparison.free.read(
        rules.allowed[comparison.free.quantity], sides, rules.fewest, rules.window, rules.threshold,
    )
    if not wrong or free is None or np.nanmax(free.gap) >= rules.threshold:
        return {}
    return {SENSOR: named[THERMAL], THERMAL: np.zeros(sides), MECHANICAL: np.zeros(sides)}
