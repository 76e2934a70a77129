"""Scores answers by the labels, once every case is answered, and writes the result as a page."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy import stats

from examination.blind import case_files as files
from examination.blind import judgement
from examination.blind.case_files import STAGE_OF, CaseSet
from examination.blind.examination import NOMINAL, open_cases
from examination.blind.judgement import OF_GROUPS, OTHERS, TARGETS, Bound, Judged, Measure, Measured
from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters import read_parameters

Labels = Mapping[str, Mapping[str, Any]]
DIAGNOSIS, FOLLOWED_UP = "diagnosis", "diagnosis, followed up"


@dataclass(frozen=True)
class Score:
    name: str
    cases: tuple[Judged, ...]
    measured: Mapping[str, Measured]

    def to_json(self) -> dict[str, Any]:
        """Measures and confusion matrix as plain data."""
        measures = {}
        for m in (*TARGETS, *OTHERS):
            found = self.measured[m.name]
            bounds = {"floor": m.floor, "aim": m.aim, "met": m.met(found)}
            measures[m.name] = {**vars(found), **bounds, "definition": m.definition}
        failed = {c.label.id: c.failure for c in self.cases if c.answer is None}
        return {"measures": measures, "confusion": confusion(self.cases), "failed": failed}


def handed_in(cases: CaseSet, answers: Path) -> list[files.Kept]:
    """All answers to a set; raises InputError where one is missing."""
    if missing := open_cases(cases.names, answers):
        raise InputError(f"{answers}: {len(missing)} of {len(cases.names)} cases have no answer "
                         f"yet, the first is {missing[0]}: the labels stay sealed until all are "
                         "asked; ./bench blind run asks")
    return [files.read_kept(answers, name) for name in cases.names]


def open_labels(cases: CaseSet) -> dict[str, dict[str, Any]]:
    """The labels by case; raises InputError where the seal is broken, or the labels are others'."""
    sealed = files.unseal(cases.root / files.LABELS, cases.sealed_sha256)
    labels = {label["id"]: label for label in sealed}
    if set(labels) != set(cases.names):
        raise InputError(f"{cases.root}: labels and cases do not belong together")
    return labels


def score(cases: CaseSet, labels: Labels, answers: Path) -> list[Score]:
    """Judge the answers to a set, and the last ones if experiments were performed."""
    first, last = [], []
    for given in handed_in(cases, answers):
        label, unseen = labels[given.case], judgement.UnseenRecord(labels[given.case])
        nominal = read_parameters(cases.folder / given.case / NOMINAL)
        history = files.answers_of(answers, given.case)
        judged = []
        for kept in (given, *history[1:][-1:]):
            improved = read_parameters(kept.improved) if kept.improved else nominal
            tied = kept.answer is not None and kept.answer.verdict == "ambiguous"
            before, after = (judgement.parameter_error(label["truth"], nominal, p)
                             for p in (nominal, improved))
            judged.append(Judged(msgspec.convert(label, judgement.Label), kept.answer,
                                 unseen.shrunk(nominal, improved),
                                 judgement.moved_parameters(nominal, improved),
                                 history[-1].answer if len(history) > 1 else None,
                                 tied and len(history) > 1, before, after, kept.seconds, kept.line))
        first.append(judged[0])
        last.append(judged[-1])
    both = {DIAGNOSIS: tuple(first)} | ({} if first == last else {FOLLOWED_UP: tuple(last)})
    return [Score(name, of, {m.name: m.of(of) for m in (*TARGETS, *OTHERS)})
            for name, of in both.items()]


# --- Results by what was hidden: the confusion matrix, groups of cases.
_ROWS = (*STAGE_OF, "pair", "none", "mild kinetics", "recalibration", "outside")
_SEVERITIES = {0.0: "1: 0 to 1.5", 1.5: "2: 1.5 to 3", 3.0: "3: 3 to 6", 6.0: "4: 6 to 12",
               12.0: "5: above 12"}


def confusion(cases: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Counts of most probable candidates by true cause (rows)."""
    table = defaultdict[str, Counter[str]](Counter)
    for case in cases:
        chosen = case.first_choice.name if case.first_choice else "no answer"
        table[truth_of(case)]["two effects" if files.PAIR_SIGN in chosen else chosen] += 1
    return {name: dict(table[name]) for name in sorted(table, key=_place)}


def truth_of(case: Judged) -> str:
    if case.label.kind == "single":
        return case.label.effects[0]
    mild = case.label.kind == "none" and case.label.kinetics
    return "mild kinetics" if mild else case.label.kind


def _place(name: str) -> tuple[int, str]:
    return _ROWS.index(name) if name in _ROWS else len(_ROWS), name


def groups(cases: Sequence[Judged]) -> dict[str, dict[str, dict[str, Measured]]]:
    """Title -> group -> measure: singles by severity, by signals and by effect; all by kind."""
    singles = [c for c in cases if c.label.kind == "single"]
    titles: dict[str, tuple[Sequence[Judged], Callable[[Judged], str]]] = {
        "single effects by severity (gap over noise)": (singles, lambda c: (
            _SEVERITIES[max(least for least in _SEVERITIES if least <= c.label.severity)])),
        "single effects by signals": (singles, lambda c: c.label.signals),
        "single effects by distinguishability": (singles, lambda c: (
            "distinguishable" if c.label.distinguishable else "not by 5 sigma")),
        "single effects by name": (singles, truth_of),
        "all cases by kind": (cases, lambda c: (
            truth_of(c) if c.label.kind == "none" else c.label.kind)),
        "all cases by noise": (cases, lambda c: c.label.noise)}
    found = {}
    for title, (among, group_of) in titles.items():
        split = defaultdict[str, list[Judged]](list)
        for case in among:
            split[group_of(case)].append(case)
        found[title] = {group: {m.name: m.of(split[group]) for m in OF_GROUPS}
                        for group in sorted(split, key=_place)}
    return found


# --- The result as a page, for the terminal and for the documentation.
_MOST_SHOWN, _DASH = 4, "–"
_RANGES = (0.0, 0.4, 0.6, 0.7, 0.8, 0.9, 1.01)  # of a probability
# By style of a measure: factor, digits, unit behind the number.
_STYLES = {"share": (100.0, 1, " %"), "points": (100.0, 1, ""), "number": (1.0, 2, ""),
           "seconds": (1.0, 1, " s")}


def number(measure: Measure, value: float) -> str:
    factor, digits, unit = _STYLES[measure.style]
    return f"{value * factor:.{digits}f}{unit}" if math.isfinite(value) else _DASH


def interval(measure: Measure, measured: Measured) -> str:
    """Low to high, a dash where the cases are too few for a bound."""
    low, high = number(measure, measured.low), number(measure, measured.high)
    return f"{low.removesuffix(_STYLES[measure.style][2])} to {high}"


def bound(measure: Measure, value: Bound) -> str:
    factor, _, unit = _STYLES[measure.style]
    if isinstance(value, tuple):
        return f"{100 * value[0]:.0f} to {100 * value[1]:.0f} %"
    sign = "≥" if measure.better == "higher" else "≤"
    return "" if value is None else f"{sign} {value * factor:g}{unit}"


def side_by_side(scores: Sequence[Score]) -> list[tuple[Measure, list[str]]]:
    """Every target with each examinee's value and its interval."""
    return [(m, [f"{number(m, f.value)} ({interval(m, f)})" if f.n else _DASH
                 for f in (one.measured[m.name] for one in scores)]) for m in TARGETS]


def tables(one: Score) -> list[str]:
    """All tables of one examinee: measures, groups of cases, first choices by true cause."""
    header = ("measure", "cases", "value", "95 % interval")

    def row(m: Measure) -> tuple[str, ...]:
        found = one.measured[m.name]
        return m.title, str(found.n), number(m, found.value), interval(m, found)

    targets = [(*row(m), bound(m, m.floor), bound(m, m.aim), m.met(one.measured[m.name]))
               for m in TARGETS]
    lines = as_markdown((*header, "floor", "aim", "met"), targets)
    lines += ["", "Further measures:", "", *as_markdown(header, [row(m) for m in OTHERS])]
    for name, by_group in groups(one.cases).items():
        body = [(group, str(next(iter(found.values())).n),
                 *(f"{v.value:.2f} ({v.low:.2f} to {v.high:.2f})" for v in found.values()))
                for group, found in by_group.items()]
        if body:
            head = ("", "cases", *(m.name for m in OF_GROUPS))
            lines += ["", f"{name.capitalize()}:", "", *as_markdown(head, body)]
    stated = np.array([s for c in one.cases if (s := c.facts["stated"])], dtype=float)
    if len(stated):
        lines += ["", "Stated probability of the first choice, and the share that is right, with "
                  "joint 95 % intervals:", ""]
        body = stated_and_right(*stated.T, np.ones(len(stated)))
        lines += as_markdown(("stated", "cases", "mean", "right"), body)
    choices = []
    for truth, chosen in confusion(one.cases).items():
        often = [f"{chosen[name]} {name}" for name in sorted(chosen, key=lambda n: -chosen[n])]
        more = [f"{len(often) - _MOST_SHOWN} more"] if len(often) > _MOST_SHOWN else []
        choices.append((truth, str(sum(chosen.values())), ", ".join(often[:_MOST_SHOWN] + more)))
    header = ("truth", "cases", "most frequent first choices")
    return [*lines, "", "Truth against first choice:", "", *as_markdown(header, choices)]


def page(cases: CaseSet, scores: Sequence[Score], name: str) -> str:
    """The result page, to be stored as the file `name`."""
    lines = ["# The withheld-effect check", "",
             f"{len(cases.names)} cases of seed {cases.seed} ({cases.split}), sma_bench {VERSION}, "
             f"sealed labels {cases.sealed_sha256[:16]}.", "", "```",
             f"./bench blind make --seed {cases.seed} --n {len(cases.names)} --out cases"]
    lines += ["./bench blind run cases", f"./bench blind score cases --markdown {name}", "```", ""]
    # How many floors and aims each reaches, and which floors it misses.
    for one in scores:
        met = {m.name: how for m in TARGETS if (how := m.met(one.measured[m.name]))}
        missed = [name for name, how in met.items() if how == "missed"]
        aims, floors = list(met.values()).count("aim"), len(met) - len(missed)
        lines.append(f"- {one.name}: {aims} aims reached, {floors} of {len(met)} floors; missed: "
                     + (", ".join(missed) or "none"))
    lines += ["", "Value (95 % interval); Clopper-Pearson for shares.", ""]
    rows = [(m.title, bound(m, m.floor), bound(m, m.aim), *values)
            for m, values in side_by_side(scores)]
    lines += as_markdown(("measure", "floor", "aim", *(one.name for one in scores)), rows)
    for one in scores:
        lines += ["", f"## {one.name}", "", *tables(one), ""]
    lines += ["## Definitions", ""]
    lines += [f"- **{m.name}**: {m.definition}" for m in (*TARGETS, *OTHERS) if m.definition]
    return "\n".join(lines) + "\n"


def stated_and_right(stated: Array, right: Array, counts: Array) -> list[tuple[str, ...]]:
    """A row for each range of the stated probability of the first choice (n,): cases, mean, share
    that is right with its interval (all intervals hold jointly in 95 %); `counts` (n,): weights of
    the cases."""
    rows, level = [], 1.0 - 0.05 / (len(_RANGES) - 1)
    for low, high in pairwise(_RANGES):
        here = (stated >= low) & (stated < high)
        if not here.any():
            continue
        mean, share = (float(np.average(x[here], weights=counts[here])) for x in (stated, right))
        # Effective number of cases, if all had equal weight.
        n = round(counts[here].sum() ** 2 / (counts[here] ** 2).sum())
        ends = stats.binomtest(round(share * n), n).proportion_ci(level, method="exact")
        rows.append((f"{low:.1f} to {min(high, 1.0):.1f}", f"{int(here.sum())}", f"{mean:.2f}",
                     f"{share:.2f} ({ends.low:.2f} to {ends.high:.2f})"))
    return rows


def as_markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]
