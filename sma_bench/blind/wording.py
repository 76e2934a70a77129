"""How numbers of the examination are printed, the same on the terminal and on pages."""

import math
from collections.abc import Sequence

from sma_bench.blind.measure_table import TARGETS
from sma_bench.blind.measures import Bound, Measure
from sma_bench.blind.score import Score
from sma_bench.blind.statistics import Measured

DASH = "–"
MEASURE_HEADER = ("measure", "cases", "value", "95 % interval", "floor", "aim", "met")
_SCALE = {"share": 100.0, "points": 100.0, "number": 1.0, "seconds": 1.0}
_DIGITS = {"share": 1, "points": 1, "number": 2, "seconds": 1}
_UNIT = {"share": " %", "points": "", "number": "", "seconds": " s"}
_NAME_UNIT = {"points": " (points)"}


def title(measure: Measure) -> str:
    """Name of a row with its unit."""
    return measure.name + _NAME_UNIT.get(measure.style, "")


def number(measure: Measure, value: float) -> str:
    """A value in the style of its measure; a dash for none."""
    if not math.isfinite(value):
        return DASH
    digits = _DIGITS[measure.style]
    return f"{value * _SCALE[measure.style]:.{digits}f}{_UNIT[measure.style]}"


def interval(measure: Measure, measured: Measured) -> str:
    """Low to high; an open end where the cases are too few for a bound."""
    if not measured.n:
        return DASH
    low, high = number(measure, measured.low), number(measure, measured.high)
    if measured.high == math.inf:
        return f"above {low}" if math.isfinite(measured.low) else DASH
    if measured.low == -math.inf:
        return f"below {high}"
    return f"{low.removesuffix(_UNIT[measure.style])} to {high}"


def bound(measure: Measure, value: Bound) -> str:
    """A floor or an aim."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        low, high = (f"{100 * v:.0f}" for v in value)
        return f"{low} to {high} %"
    unit, scale = _UNIT[measure.style], _SCALE[measure.style]
    return f"{'≥' if measure.better == 'higher' else '≤'} {value * scale:g}{unit}"


def measure_row(measure: Measure, measured: Measured) -> tuple[str, ...]:
    """Cells of MEASURE_HEADER."""
    return (
        title(measure), str(measured.n), number(measure, measured.value),
        interval(measure, measured), bound(measure, measure.floor), bound(measure, measure.aim),
        measure.met(measured),
    )  # fmt: skip


def side_by_side(scores: Sequence[Score], measures: Sequence[Measure]) -> list[tuple[str, ...]]:
    """One row a measure: its name, and each examinee's value with its interval."""
    return [
        (title(m), *(f"{number(m, s.measured[m.name].value)} ({interval(m, s.measured[m.name])})"
                     if s.measured[m.name].n else DASH for s in scores))
        for m in measures
    ]  # fmt: skip


def summary(score: Score) -> str:
    """How many floors and aims an examinee reaches, and which floors it misses."""
    met = {m.name: m.met(score.measured[m.name]) for m in TARGETS}
    missed = [name for name, how in met.items() if how == "missed"]
    open_ = [name for name, how in met.items() if not how]
    aims = sum(how == "aim" for how in met.values())
    text = f"{score.name}: {aims} aims reached, {len(met) - len(missed) - len(open_)} of "
    text += f"{len(met) - len(open_)} floors"
    return text + (f"; missed: {', '.join(missed)}" if missed else "")


def beaten(score: Score, rivals: Sequence[Score]) -> list[str]:
    """Measures with a floor in which some rival is better than `score`."""
    return [
        measure.name
        for measure in TARGETS
        if any(_outdoes(measure, rival, score) for rival in rivals)
    ]


def _outdoes(measure: Measure, rival: Score, score: Score) -> bool:
    mine, theirs = score.measured[measure.name], rival.measured[measure.name]
    if not mine.n or not theirs.n or not measure.better_than(theirs.value, mine.value):
        return False
    condition = next((m for m in TARGETS if m.name == measure.given), None)
    if condition is None:
        return True
    here, there = (s.measured[condition.name].value for s in (score, rival))
    return not condition.better_than(here, there)
