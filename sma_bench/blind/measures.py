"""Every measure of the withheld-effect check: a number with its interval from judged cases.

A case without an answer (a crash, no time, against the contract) counts against the answerer: it
detects nothing, alarms and is not right; it claims no shrinkage. DETECTABLE cases have a measured
gap above twice the noise.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from sma_bench.blind.judgement import Judged
from sma_bench.blind.statistics import (
    NOTHING,
    Measured,
    calibration_error,
    mean,
    proportion,
    quantile,
)

Cases = Sequence[Judged]
Bound = float | tuple[float, float] | None
DETECTABLE = 2.0


@dataclass(frozen=True)
class Measure:
    """One row of the result.

    Attributes:
        name: as in the table of floors and aims.
        definition: over which cases, and what counts.
        of: the number, from all judged cases.
        better: a higher or a lower value, or one inside a band (floor and aim are (low, high)).
        style: how it is printed.
        floor, aim: None for a measure that is reported only.
        given: measure in which another examinee must be as good before its value counts as better:
            who always raises an alarm detects everything.
    """

    name: str
    definition: str
    of: Callable[[Cases], Measured]
    better: Literal["higher", "lower", "inside"] = "higher"
    style: Literal["share", "number", "points", "seconds"] = "share"
    floor: Bound = None
    aim: Bound = None
    given: str = ""

    def reaches(self, value: float, bound: Bound) -> bool:
        """Whether a value is at least as good as a bound."""
        if bound is None or math.isnan(value):
            return False
        if isinstance(bound, tuple):
            return bound[0] <= value <= bound[1]
        return value >= bound if self.better == "higher" else value <= bound

    def better_than(self, one: float, other: float) -> bool:
        """Whether `one` is the better value; inside a band, the nearer one to its middle."""
        if self.better == "inside" and isinstance(self.aim, tuple):
            middle = sum(self.aim) / 2.0
            return abs(one - middle) < abs(other - middle)
        return one > other if self.better == "higher" else one < other

    def met(self, measured: Measured) -> str:
        """`aim`, `floor` or `missed` by the value itself; "" without cases or floor."""
        if self.floor is None or not measured.n:
            return ""
        if self.reaches(measured.value, self.aim):
            return "aim"
        return "floor" if self.reaches(measured.value, self.floor) else "missed"


def share_of(outcome: Callable[[Judged], bool], among: Callable[[Judged], bool]) -> Callable:
    """Proportion of the cases `among` that have the `outcome`."""
    return lambda cases: proportion([outcome(c) for c in cases if among(c)])


def single(case: Judged) -> bool:
    """One effect of the library."""
    return case.label.kind == "single"


def distinguishable(case: Judged) -> bool:
    """One effect, five standard deviations off every rival."""
    return single(case) and case.label.distinguishable


def pair(case: Judged) -> bool:
    """Two effects."""
    return case.label.kind == "pair"


def detectable(case: Judged) -> bool:
    """Something is wrong, with a measured gap above twice the noise."""
    return case.label.kind != "none" and case.label.severity > DETECTABLE


def clean(case: Judged) -> bool:
    """Nothing is wrong."""
    return case.label.kind == "none" and not case.label.kinetics


def kinetics(case: Judged) -> bool:
    """Nothing is wrong but mildly different kinetics."""
    return case.label.kind == "none" and case.label.kinetics


def outside(case: Judged) -> bool:
    """Detectable effect that no library has."""
    return case.label.kind == "outside" and detectable(case)


def placed(case: Judged) -> bool:
    """Detectable, and the label says where."""
    return detectable(case) and bool(case.label.where)


def anyone(_: Judged) -> bool:
    """Every case."""
    return True


def not_pair(case: Judged) -> bool:
    """Every case but pairs."""
    return not pair(case)


def place(key: str) -> Callable[[Cases], Measured]:
    """Share of `placed` cases whose signal, phase, side or stage is right."""
    return share_of(lambda c: c.place_right(key), placed)


def _claims(cases: Cases) -> list[tuple[float, float, tuple[float, float]]]:
    """(claimed, true, interval) of every case that claims to shrink a gap that is there."""
    pairs = [case.claim for case in cases]
    return [(pair[0].fraction, pair[1], pair[0].ci90) for pair in pairs if pair]


def shrinkage_error(level: float) -> Callable[[Cases], Measured]:
    """Quantile of |claimed - true fraction|."""
    return lambda cases: quantile([abs(said - true) for said, true, _ in _claims(cases)], level)


def shrinkage_bias(cases: Cases) -> Measured:
    """Median of claimed - true fraction."""
    return quantile([said - true for said, true, _ in _claims(cases)], 0.5)


def shrinkage_coverage(cases: Cases) -> Measured:
    """Share of claimed 90 % intervals that hold the true fraction."""
    return proportion([low <= true <= high for _, true, (low, high) in _claims(cases)])


def true_shrinkage(cases: Cases) -> Measured:
    """Median true fraction where one is claimed."""
    return quantile([true for _, true, _ in _claims(cases)], 0.5)


def first_choice_calibration(cases: Cases) -> Measured:
    """Calibration error of the most probable candidates' probabilities."""
    stated = [(c.first_choice.probability, c.first_choice_right) for c in cases if c.first_choice]
    return calibration_error([p for p, _ in stated], [right for _, right in stated])


def parameter_error(which: int) -> Callable[[Cases], Measured]:
    """Median parameter error, of the lab's file (0) or the improved one (1)."""
    def of(cases: Cases) -> Measured:
        errors = [case.parameter_error[which] for case in cases]
        return quantile([error for error in errors if not math.isnan(error)], 0.5)

    return of


def seconds(level: float) -> Callable[[Cases], Measured]:
    """Quantile of the time to answer."""
    return lambda cases: quantile([c.seconds for c in cases if not math.isnan(c.seconds)], level)


def set_size(cases: Cases) -> Measured:
    """Mean number of candidates in the 90 % set."""
    sizes = [float(len(case.credible_set)) for case in cases if case.answer]
    return mean(sizes) if sizes else NOTHING
