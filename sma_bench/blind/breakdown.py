"""Results by what was hidden: the confusion matrix, the reliability diagram, groups of cases."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.blind.answers import PAIR_SIGN
from sma_bench.blind.effect_names import NO_EFFECT, STAGE_OF
from sma_bench.blind.judgement import Judged
from sma_bench.blind.statistics import Measured, bin_of, mean, proportion

JOINT, OTHER, FAILED = "two effects", "other effect", "no answer"
COLUMNS = (*STAGE_OF, JOINT, OTHER, *NO_EFFECT, FAILED)
_ROWS = (*STAGE_OF, "pair", "none", "mild kinetics", "recalibration", "outside")
_EDGES = (0.0, 1.5, 3.0, 6.0, 12.0, np.inf)
_BINS = 10


@dataclass(frozen=True)
class Bin:
    """Most probable candidates stated with a probability from `low` to `high`.

    Attributes:
        n: how many; stated: their mean probability.
        right: share that was right, with its 95 % interval right_low to right_high.
    """

    low: float
    high: float
    n: int
    stated: float
    right: float
    right_low: float
    right_high: float


def confusion(cases: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """What is true (rows, as they occur) against the most probable candidate (all columns)."""
    table: dict[str, dict[str, int]] = {}
    for case in cases:
        row = table.setdefault(truth_of(case), dict.fromkeys(COLUMNS, 0))
        row[_column(case, row)] += 1
    return {name: table[name] for name in sorted(table, key=_place)}


def truth_of(case: Judged) -> str:
    """Name of a case's row."""
    if case.label.kind == "single":
        return next(iter(case.label.names))
    if case.label.kind == "none" and case.label.kinetics:
        return "mild kinetics"
    return case.label.kind


def _place(name: str) -> int:
    return _ROWS.index(name) if name in _ROWS else len(_ROWS)


def _column(case: Judged, columns: Mapping[str, int]) -> str:
    if case.first_choice is None:
        return FAILED
    name = case.first_choice.name
    if name in columns:
        return name
    return JOINT if PAIR_SIGN in name else OTHER


def reliability(cases: Sequence[Judged]) -> list[Bin]:
    """Stated probability of the most probable candidate against how often it was right."""
    stated = np.array([c.first_choice.probability for c in cases if c.first_choice])
    right = np.array([c.first_choice_right for c in cases if c.first_choice], dtype=bool)
    which = bin_of(stated, _BINS)
    bins = []
    for k in range(_BINS):
        here = which == k
        if here.any():
            share = proportion(right[here].tolist())
            bins.append(
                Bin(k / _BINS, (k + 1) / _BINS, share.n, float(stated[here].mean()), share.value,
                    share.low, share.high)
            )  # fmt: skip
    return bins


GROUP_MEASURES: Mapping[str, Callable[[Sequence[Judged]], Measured]] = {
    "gap seen": lambda cases: proportion([c.says_gap for c in cases]),
    "first choice right": lambda cases: proportion([c.first_choice_right for c in cases]),
    "90 % set holds the truth": lambda cases: proportion([c.set_holds_truth for c in cases]),
    "probability of the truth": lambda cases: mean([c.truth_probability for c in cases]),
    "confident and wrong": lambda cases: proportion([c.confident_and_wrong for c in cases]),
}

Groups = dict[str, dict[str, dict[str, Measured]]]


def groups(cases: Sequence[Judged]) -> Groups:
    """Title -> group -> measure: singles by severity, by signals and by effect; all by kind."""
    singles = [c for c in cases if c.label.kind == "single"]
    return {
        "single effects by severity (gap over noise)": _by(singles, _severity),
        "single effects by signals": _by(singles, lambda c: c.label.signals),
        "single effects by distinguishability": _by(
            singles, lambda c: "distinguishable" if c.label.distinguishable else "not by 5 sigma"
        ),
        "single effects by name": _by(singles, truth_of),
        "all cases by kind": _by(cases, _kind),
        "all cases by noise": _by(cases, lambda c: c.label.noise),
    }


def _kind(case: Judged) -> str:
    return truth_of(case) if case.label.kind == "none" else case.label.kind


def _severity(case: Judged) -> str:
    k = int(np.searchsorted(_EDGES, case.label.severity, side="right")) - 1
    if k == len(_EDGES) - 2:
        return f"{k + 1}: above {_EDGES[k]:g}"
    return f"{k + 1}: {_EDGES[k]:g} to {_EDGES[k + 1]:g}"


def _by(
    cases: Sequence[Judged], group_of: Callable[[Judged], str]
) -> dict[str, dict[str, Measured]]:
    split: dict[str, list[Judged]] = {}
    for case in cases:
        split.setdefault(group_of(case), []).append(case)
    return {
        group: {name: of(split[group]) for name, of in GROUP_MEASURES.items()}
        for group in sorted(split, key=lambda name: (_place(name), name))
    }
