"""The twin: measured readings in, predictions, residuals and a verdict out. No ROS, no clock.

The verdict says at which stage the model no longer follows the bench, from the bins of all signals:
a stage is named if its residual exceeds a threshold times the noise and is no correlated noise. A
gap that an earlier stage explains is not counted for a later one."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.laws import benches_within
from sma_bench.estimation.noise_model import estimate_noise
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded, load_kind
from sma_bench.physics.boundary import side_names
from sma_bench.twin.comparison import BIN, STAYS, SURPRISING, Band, Comparison, FreeRun, Voltages

Settings = Mapping[str, Any]

NANOSECONDS = 1_000_000_000
CURRENT, TEMPERATURE, MECHANICS = "current", "temperature", "mechanics"
_WAIT_FOR_TEMPERATURES, _FRESH = 1.0, 0.5  # s at the start; s that a temperature holds there
_FAR_AHEAD = 2.0  # s: readings further ahead are from an earlier playback
_QUEUE = 4000  # readings that wait for the voltages of their time
_EVERY = 5  # bins between two verdicts
_BENCHES = 12  # models drawn for a band
_CLAMPED = 1e-4  # m; a wire elongated by more is not clamped as in the model

ELECTRICAL, THERMAL, MECHANICAL, SENSOR = "electrical", "thermal", "mechanical", "sensor"
MEASURED_STAGES = (ELECTRICAL, THERMAL, MECHANICAL)
LEARNING, QUIET, GAP, GREW = "learning", "quiet", "gap", "grew"
_FIRST_VERDICTS = 60  # one a second, in which the size of an initial gap becomes known
_GROWN = 1.5  # times the known size of a gap: it has grown
_ALIKE = 0.5  # of the gap on the worse side: the other side is named, too
_MUCH = 2.0  # times the gap with measured temperatures: the free run's has an earlier cause


class Prediction(NamedTuple):
    """Prediction of the model at one time."""

    stamp: int  # ns
    voltage: Array  # (w,) V
    current: Array  # (w,) A
    temperature: Array  # (w,) K
    mechanics: float  # deflection [m] or force [N]
    off: "Prediction | None" = None  # half-width of the band, if asked for

    def moved(self, share: float) -> "Prediction":
        """Limit of the band: the prediction plus `share` times `off`."""
        assert self.off is not None
        return Prediction(self.stamp, self.voltage, self.current + share * self.off.current,
                          self.temperature + share * self.off.temperature,
                          self.mechanics + share * self.off.mechanics)


class Residual(NamedTuple):
    """Measured less predicted, of one reading; `wire` is 0 for the mechanics."""

    kind: str
    wire: int
    stamp: int
    value: float


class StageState(NamedTuple):
    """State of one stage."""

    stage: str
    energy: float  # mean square of its whitened residuals, 1 for noise, NaN while learning
    gap: float  # rms of its residuals over the noise of a sample, of the worse side
    counted: Array  # by side, the part of it that is neither noise nor explained by other stages


class Verdict(NamedTuple):
    """`state`: learning, quiet, gap (known), grew; `stages`, `sides`: in the message."""

    state: str
    message: str
    stages: tuple[str, ...] = ()
    sides: tuple[str, ...] = ()
    measured: tuple[StageState, ...] = ()


class Twin:
    """Runs the model on measured voltages and compares it with all other signals; counts readings
    that cannot be used (NaN, late, out of order). Stamps are ns, readings SI."""

    def __init__(self, parameters: Parameters, settings: Settings,
                 on_prediction: Callable[[Prediction], None],
                 on_residual: Callable[[Residual], None]) -> None:
        """`settings` are the twin node's own parameters; the callbacks get the output. InputError:
        a bench with imposed motion, which the twin does not get in time."""
        if (kind := load_kind(parameters)) == "displacement":
            raise InputError(f"twin: load.kind is {kind}, expected a load that follows the wires")
        self._parameters = as_recorded(parameters)  # voltages are read as direct ones
        self._on_prediction, self._on_residual = on_prediction, on_residual
        self._channels = parameters["bench.channels"]
        self._voltages = Voltages(len(self._channels))
        self._share = math.nan  # of readings within the band that is asked for
        self.tune(settings)
        self._judge, self._ignored = Judge(side_names(parameters)), 0
        self._origin: int | None = None
        self.restarts, self.reason = 0, ""  # how often the twin began anew, and why last
        self._begin_anew()

    def tune(self, settings: Settings) -> None:
        self._settings, self._period = settings, 1.0 / settings["publish_rate"]
        self._voltages.timeout = settings["voltage_timeout"]
        if settings["band"] != self._share:
            self._share = settings["band"]
            self._draw()

    def _draw(self) -> None:
        """Draw the models of a band, if one is asked for."""
        self._benches: list[Parameters] = []
        self._band: Band | None = None
        self.no_band = ""  # why there is none
        if self._share:
            try:
                self._benches = benches_within(self._parameters, _BENCHES)
            except InputError as error:
                self.no_band = str(error)

    def _begin_anew(self) -> None:
        self._run: FreeRun | None = None
        self._band = None
        self._comparison: Comparison | None = None
        self._waited_since: float | None = None
        self._kelvin: dict[int, tuple[float, float]] = {}
        # By kind and wire: time, stamp, value, factor of the prediction, own error.
        self._pending: dict[tuple[str, int], deque[tuple[float, int, float, float, float]]] = {}
        self._next_due, self._unjudged = dict[tuple[str, int], float](), 0
        self._judge.forget()
        self.verdict = Verdict(LEARNING, "learning: waiting for voltages")

    def power(self, wire: int, stamp: int, volt: float, ampere: float) -> None:
        """A reading of a channel's voltage [V] and current [A], NaN for what is not measured."""
        if reason := self._voltages.take(wire, self._time(stamp), volt):
            self._begin_anew()
            self.restarts, self.reason = self.restarts + 1, reason
        if math.isfinite(ampere) and math.isfinite(volt):
            self._queue(CURRENT, wire, stamp, ampere, volt)

    def temperature(self, wire: int, stamp: int, kelvin: float, std: float = 0.0) -> None:
        """A reading of a wire's temperature, and its own standard deviation [K], 0 if not known."""
        time = self._time(stamp)
        if not math.isfinite(kelvin):
            self._ignored += 1
            return
        self._kelvin[wire] = time, kelvin
        self._queue(TEMPERATURE, wire, stamp, kelvin, std=std)

    def mechanics(self, stamp: int, value: float, elongation: float = 0.0) -> None:
        """A deflection [m], or the force [N] of a clamped wire elongated by so much [m]."""
        if not math.isfinite(value) or abs(elongation) > _CLAMPED:
            self._ignored += 1
            return
        self._queue(MECHANICS, 0, stamp, value)

    def change(self, parameters: Parameters) -> None:
        """Go on with other parameters of the same channels; the last minute is re-simulated."""
        self._parameters = as_recorded(parameters)
        self._draw()
        if self._run is not None:
            self._run.change(self._parameters)
            self._comparison = Comparison(self._run, self._settings["allowed.temperature"])
            self._unjudged = 0
            self.verdict = Verdict(LEARNING, "learning: parameters have changed")

    def accept(self) -> None:
        """Take the present gap as known: only more of it counts as grown."""
        self._judge.accept()

    @property
    def counts(self) -> dict[str, int]:
        """What was left out, by reason, and how often the twin began anew."""
        return {"voltages_not_a_number": self._voltages.dropped["not a number"],
                "voltages_out_of_order": self._voltages.dropped["out of order"],
                "readings_not_usable": self._ignored,
                "readings_late": self._comparison.late if self._comparison else 0,
                "restarts": self.restarts}

    @property
    def stamp(self) -> int:
        """ns, up to which the model has run; 0 before it has begun."""
        return self._stamp(self._run.time) if self._run else 0

    def _time(self, stamp: int) -> float:
        self._origin = stamp if self._origin is None else self._origin
        return (stamp - self._origin) / NANOSECONDS

    def _stamp(self, time: float) -> int:
        return (self._origin or 0) + round(time * NANOSECONDS)

    def _queue(self, kind: str, wire: int, stamp: int, value: float, factor: float = 1.0,
               std: float = 0.0) -> None:
        waiting = self._pending.setdefault((kind, wire), deque(maxlen=_QUEUE))
        waiting.append((self._time(stamp), stamp, value, factor, std))

    def advance(self) -> None:
        """Run the model as far as the voltages are known, compare, and judge every second."""
        time, volts = self._voltages.changes()
        run, comparison = self._run, self._comparison
        if run is None or comparison is None:
            self._join(time, volts)
            return
        if not len(time):
            return
        if self._benches and self._band is None:
            self._band = Band(run, self._benches, self._share)
        run.advance(time, volts)
        if (band := self._band) is not None:
            band.advance(time, volts)
        trajectory = run.trajectory
        rows = np.minimum(np.searchsorted(trajectory.time, time), len(trajectory.time) - 1)
        for k in self._due("prediction", 0, time):
            row, stamp, off = int(rows[k]), self._stamp(float(time[k])), None
            if band is not None:
                w, away = len(volts[k]), band.off(row)
                off = Prediction(stamp, volts[k], volts[k] * away[:w], away[w:-1], float(away[-1]))
            self._on_prediction(Prediction(stamp, volts[k], volts[k] * trajectory.conductance[row],
                                           trajectory.reading[row],
                                           float(trajectory.mechanics[row]), off))
        columns = {CURRENT: trajectory.conductance, TEMPERATURE: trajectory.reading,
                   MECHANICS: trajectory.mechanics[:, np.newaxis]}
        for (kind, wire), waiting in self._pending.items():
            ready = []
            while waiting and waiting[0][0] <= run.time:
                ready.append(waiting.popleft())
            if ready:
                at, stamps, *numbers = zip(*ready, strict=True)
                moments, (value, factor, std) = np.array(at), np.array(numbers)
                model = np.interp(moments, trajectory.time, columns[kind][:, wire])
                comparison.take(kind, wire, moments, value, model * factor, std)
                for k in self._due(kind, wire, moments):
                    residual = float(value[k] - model[k] * factor[k])
                    self._on_residual(Residual(kind, wire, stamps[k], residual))
            elif waiting and waiting[0][0] > run.time + _FAR_AHEAD:
                self._ignored += len(waiting)
                waiting.clear()
        self._unjudged += comparison.close(run)
        if self._unjudged >= _EVERY:
            self._unjudged = 0
            self.verdict = self._judge.judge(comparison, self._settings)

    def _join(self, time: Array, volts: Array) -> None:
        """Start once all temperatures are known, or a second later without the missing ones."""
        missing = [self._channels[k] for k in self._voltages.missing()]
        awaited = f"voltage of {', '.join(missing)}" if missing else "temperatures to begin with"
        self.verdict = Verdict(LEARNING, f"learning: waiting for {awaited}")
        known = np.flatnonzero(~np.isnan(volts).any(axis=1))
        if not len(known):
            return
        now = float(time[-1])
        if self._waited_since is None:
            self._waited_since = float(time[known[0]])
        kelvin = np.full(len(self._channels), math.nan)
        for wire, (then, value) in self._kelvin.items():
            kelvin[wire] = value if abs(then - now) < _FRESH else math.nan
        if np.isnan(kelvin).any() and now - self._waited_since < _WAIT_FOR_TEMPERATURES:
            return
        # At the newest time: a wire may already be heating when its temperature arrives.
        self._run = FreeRun(self._parameters, now, kelvin, volts[-1])
        self._comparison = Comparison(self._run, self._settings["allowed.temperature"])
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


class Judge:
    """Remembers known gaps, to detect growth."""

    def __init__(self, sides: Sequence[str]) -> None:
        self._sides = tuple(sides)
        self.forget()

    def forget(self) -> None:
        """Start again: the gap in the first verdict of a stage will count as known."""
        self._known, self._unknown = dict[str, float](), dict[str, int]()
        self._open, self._latest = set[str](), dict[str, Array]()

    def accept(self) -> None:
        self._known |= {stage: float(counted.max()) for stage, counted in self._latest.items()}

    def judge(self, comparison: Comparison, settings: Settings) -> Verdict:
        """Verdict on the present bins: which stages have a gap, and which gaps have grown."""
        measured, sensor_suspect = stage_states(comparison, settings, len(self._sides))
        waiting = [s.stage for s in measured if np.isnan(s.energy)]
        named = {s.stage: s.counted for s in measured if s.stage not in waiting}
        if not named:
            return Verdict(LEARNING, "learning the noise", measured=measured)
        if sensor_suspect:
            none = 0.0 * named[THERMAL]
            named = {**named, SENSOR: named[THERMAL], THERMAL: none, MECHANICAL: none}
        self._latest = named
        seen = {s.stage: s.gap for s in measured}  # surprising or not
        gaps, grown = [], []
        for stage, counted in named.items():
            size = float(counted.max())
            least = settings["threshold"] * (STAYS if stage in self._open else 1.0)
            self._open = self._open | {stage} if size >= least else self._open - {stage}
            # A gap present from the first verdict on is known: its largest size in a minute.
            if stage not in self._known:
                first = stage != SENSOR  # a sensor gap shows only once the mechanics contradict it
                wide = seen.get(stage, 0.0) >= settings["threshold"]
                self._known[stage] = size if first else 0.0
                self._unknown[stage] = _FIRST_VERDICTS if first and wide else 0
            elif self._unknown.get(stage, 0) > 0:
                self._known[stage] = max(self._known[stage], size)
                self._unknown[stage] -= 1
            if stage in self._open:
                gaps.append(stage)
                if size > max(least, _GROWN * self._known[stage]):
                    grown.append(stage)
        if not gaps:
            apart = f"; not judged: {', '.join(waiting)}" if waiting else ""
            return Verdict(QUIET, f"no gap beyond the noise{apart}", measured=measured)
        # Name the stages, and the sides of each with a similar gap.
        stages, sides, places = tuple(grown or gaps), [], []
        for stage in stages:
            there = named[stage] >= _ALIKE * named[stage].max()
            here = [name for name, yes in zip(self._sides, there, strict=True) if yes]
            sides += here
            what = "temperature sensor" if stage == SENSOR else f"{stage} stage"
            if stage == MECHANICAL and any(not s.bins for s in comparison.temperatures):
                what = "thermal or mechanical stage (wires without temperatures)"
            where = "both sides" if len(here) > 1 else f"{here[0]} side"
            places.append(what if len(self._sides) == 1 else f"{what}, {where}")
        text = f"{'gap grew' if grown else 'known gap'}: {'; '.join(places)}"
        return Verdict(GREW if grown else GAP, text, stages, tuple(dict.fromkeys(sides)), measured)


def stage_states(comparison: Comparison, settings: Settings,
                 sides: int) -> tuple[tuple[StageState, ...], bool]:
    """Every stage that has a signal, in the order of the chain; and whether the thermometer is
    suspect: the mechanics agree with the voltages but not with its readings."""
    threshold, fewest = settings["threshold"], round(settings["learning"] / BIN)
    signals = {ELECTRICAL: comparison.currents, THERMAL: comparison.temperatures,
               MECHANICAL: [comparison.driven], "free": [comparison.free]}
    readings = {name: [s.read(settings[f"allowed.{s.quantity}"], sides, fewest, settings["window"],
                              threshold) for s in own] for name, own in signals.items()}
    driven, free = readings[MECHANICAL][0], readings["free"][0]
    states = []
    for stage in MEASURED_STAGES:
        known = [reading for reading in readings[stage] if reading is not None]
        if not known:
            states.append(StageState(stage, np.nan, np.nan, np.zeros(sides)))
            continue
        energy = float(np.mean([reading.energy for reading in known]))
        gap = float(max(np.nanmax(reading.gap) for reading in known))
        # (signals, sides) gaps that are not noise.
        counted = np.array([np.nan_to_num(r.gap) if r and r.surprise >= SURPRISING
                            else np.zeros(sides) for r in readings[stage]])
        # Take off the thermal gap in proportion to an error of the current: once if the resistance
        # is wrong, twice if the voltage is; the smallest rest counts.
        for k, heat in enumerate(readings[stage] if stage == THERMAL else ()):
            current = readings[ELECTRICAL][k]
            if heat and current and counted[k].any() and not np.isnan(current.share):
                rest = [heat.residual - n * current.share * heat.cause for n in (0.0, 1.0, 2.0)]
                powers = [float(np.mean((residual / heat.tolerance) ** 2)) for residual in rest]
                counted[k] *= np.sqrt(min(powers) / powers[0])
        # A mechanical gap that measured temperatures remove has a cause before the temperature.
        hot = stage == MECHANICAL and states[-1].gap >= threshold
        if hot and driven and free and np.nanmax(free.gap) > _MUCH * np.nanmax(driven.gap):
            counted[:] = 0.0
        states.append(StageState(stage, energy, gap, np.max(counted, axis=0)))
    _, thermal, mechanical = states
    known_both = not (np.isnan(thermal.energy) or np.isnan(mechanical.energy))
    wrong = min(thermal.counted.max(), mechanical.counted.max()) >= threshold
    return tuple(states), bool(known_both and wrong and free and np.nanmax(free.gap) < threshold)
