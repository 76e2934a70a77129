"""Where along the chain the model has stopped following, from what the signals' bins say.

A stage is named where its signal is off by more than a threshold times the noise, and where that is
no coloured noise. What an earlier stage explains is not held against a later one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.twin.comparison import STAYS, SURPRISING, BinStatistics, Comparison

Array = NDArray[np.float64]

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
            self._get_to_know(stage, size, seen.get(stage, 0.0) >= settings.threshold)
            if stage in self._open:
                gaps.append(stage)
                if size > max(least, _GROWN * self._known[stage]):
                    grown.append(stage)
        return self._verdict(gaps, grown, measured, comparison)

    def _get_to_know(self, stage: str, size: float, seen: bool) -> None:
        """A gap that was there from the first verdict on is known at its largest of a minute."""
        if stage not in self._known:
            first = stage != SENSOR  # which shows only once the mechanics contradict it
            self._known[stage] = size if first else 0.0
            self._unknown[stage] = _ACQUAINTANCE if first and seen else 0
        elif self._unknown.get(stage, 0) > 0:
            self._known[stage] = max(self._known[stage], size)
            self._unknown[stage] -= 1

    def _verdict(
        self, gaps: list[str], grown: list[str], measured: list[StageState],
        comparison: Comparison,
    ) -> Verdict:
        waiting = [s.stage for s in measured if np.isnan(s.energy)]
        if not gaps:
            apart = f"; not judged: {', '.join(waiting)}" if waiting else ""
            return Verdict(
                QUIET, f"no gap beyond the noise{apart}", measured=tuple(measured)
            )
        stages = tuple(grown or gaps)
        sides = tuple(dict.fromkeys(s for stage in stages for s in self._sides_of(stage)))
        places = "; ".join(
            ", ".join(filter(None, [_words(stage, comparison), self._side_words(stage)]))
            for stage in stages
        )
        said = "gap grew" if grown else "gap, as it was known"
        return Verdict(
            GREW if grown else GAP, f"{said}: {places}", stages, sides, tuple(measured)
        )

    def _sides_of(self, stage: str) -> tuple[str, ...]:
        counted = self._latest[stage]
        there = counted >= _ALIKE * counted.max()
        return tuple(n for n, here in zip(self._sides, there, strict=True) if here)

    def _side_words(self, stage: str) -> str:
        if len(self._sides) == 1:
            return ""
        sides = self._sides_of(stage)
        return "both sides" if len(sides) > 1 else f"{sides[0]} side"


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
        rules.allowed[comparison.free.quantity], sides, rules.fewest, rules.window,
        rules.threshold,
    )
    if not wrong or free is None or np.nanmax(free.gap) >= rules.threshold:
        return {}
    return {SENSOR: named[THERMAL], THERMAL: np.zeros(sides), MECHANICAL: np.zeros(sides)}


def _words(stage: str, comparison: Comparison) -> str:
    if stage == SENSOR:
        return "temperature sensor"
    blind = any(not s.bins for s in comparison.temperatures)
    if stage == MECHANICAL and blind:
        return "thermal or mechanical stage (wires without temperatures)"
    return f"{stage} stage"
