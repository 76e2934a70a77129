"""Answers and labels brought together, once every answer is there."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from examination.blind import case_files as files
from examination.blind import judgement
from examination.blind.case_files import STAGE_OF, CaseSet, Kept
from examination.blind.examination import NOMINAL, asks_for_more, open_cases
from examination.blind.judgement import Judged
from examination.blind.measures import OF_GROUPS, OTHERS, TARGETS, Measured
from sma_bench.errors import InputError
from sma_bench.parameters import read_parameters

Labels = Mapping[str, Mapping[str, Any]]
FOLLOWED_UP = ", followed up"


@dataclass(frozen=True)
class Paper:
    """All answers of one examinee, as handed in."""

    folder: Path
    examination: files.Examination
    kept: tuple[Kept, ...]

    @property
    def name(self) -> str:
        return self.examination.name


@dataclass(frozen=True)
class Score:
    """One examinee judged."""

    name: str
    cases: tuple[Judged, ...]
    measured: Mapping[str, Measured]

    def to_json(self) -> dict[str, Any]:
        """Measures and confusion matrix as plain data."""
        return {
            "measures": {
                m.name: {**vars(found), "floor": m.floor, "aim": m.aim, "met": m.met(found),
                         "definition": m.definition}
                for m in (*TARGETS, *OTHERS) for found in [self.measured[m.name]]
            },
            "confusion": confusion(self.cases),
            "failed": {c.label.id: c.failure for c in self.cases if c.answer is None},
        }  # fmt: skip


def handed_in(cases: CaseSet, folders: Sequence[Path]) -> list[Paper]:
    """The complete papers of some folders, or of all that lie in the set; raises InputError where
    nobody has answered, an answer is missing, or it is to another set."""
    there = sorted(cases.answers.glob(f"*/{files.EXAMINATION}"))
    found = list(folders) or [path.parent for path in there]
    if not found:
        raise InputError(f"{cases.answers}: no answers: run ./bench blind run first")
    papers = []
    for folder in found:
        examination = files.read_examination(folder)
        if examination.sealed != cases.sealed_sha256:
            raise InputError(f"{folder}: holds answers to another set than {cases.root}")
        if missing := open_cases(cases.names, folder):
            raise InputError(
                f"{folder}: {len(missing)} of {len(cases.names)} cases have no answer yet, the "
                f"first is {missing[0]}: the labels stay sealed until all are asked"
            )
        kept = tuple(files.read_kept(folder, name) for name in cases.names)
        papers.append(Paper(folder, examination, kept))
    return papers


def open_labels(cases: CaseSet) -> dict[str, dict[str, Any]]:
    """The labels by case; raises InputError where the seal is broken, or the labels are others'."""
    sealed = files.unseal(cases.root / files.LABELS, cases.sealed_sha256)
    labels = {label["id"]: label for label in sealed}
    if set(labels) != set(cases.names):
        raise InputError(f"{cases.root}: labels and cases do not belong together")
    return labels


def score(cases: CaseSet, papers: Sequence[Paper], labels: Labels) -> list[Score]:
    """Judge every complete paper; each case's world is played once for all of them."""
    judged: list[list[Judged]] = [[] for _ in papers]
    for k, name in enumerate(cases.names):
        label, unseen = labels[name], judgement.UnseenRecord(labels[name])
        for paper, into in zip(papers, judged, strict=True):
            kept, history = paper.kept[k], files.answers_of(paper.folder, name)
            nominal = read_parameters(cases.folder / name / NOMINAL)
            improved = read_parameters(kept.improved) if kept.improved else nominal
            tied = kept.answer is not None and kept.answer.verdict == "ambiguous"
            before, after = (
                judgement.parameter_error(label["truth"], nominal, p) for p in (nominal, improved)
            )
            into.append(Judged(
                msgspec.convert(label, judgement.Label), kept.answer,
                unseen.shrunk(nominal, improved), judgement.moved_parameters(nominal, improved),
                history[-1].answer if len(history) > 1 else None,
                tied and (len(history) > 1 or not asks_for_more(kept)),
                before, after, kept.seconds, kept.line,
            ))  # fmt: skip
    return [
        Score(paper.name, tuple(found), {m.name: m.of(found) for m in (*TARGETS, *OTHERS)})
        for paper, found in zip(papers, judged, strict=True)
    ]


def followed_up(papers: Sequence[Paper]) -> list[Paper]:
    """Of everyone for whom an experiment was performed, the last answers."""
    found = []
    for paper in papers:
        last = tuple(files.answers_of(paper.folder, kept.case)[-1] for kept in paper.kept)
        if last != paper.kept:
            name = f"{paper.name}{FOLLOWED_UP}"
            found.append(Paper(paper.folder, replace(paper.examination, name=name), last))
    return found


# --- Results by what was hidden: the confusion matrix, groups of cases.

_ROWS = (*STAGE_OF, "pair", "none", "mild kinetics", "recalibration", "outside")
_EDGES = (0.0, 1.5, 3.0, 6.0, 12.0, np.inf)


def confusion(cases: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """What is true (rows) against the most probable candidate, as they occur."""
    table: dict[str, Counter[str]] = {}
    for case in cases:
        chosen = case.first_choice.name if case.first_choice else "no answer"
        chosen = "two effects" if files.PAIR_SIGN in chosen else chosen
        table.setdefault(truth_of(case), Counter())[chosen] += 1
    return {name: dict(table[name]) for name in sorted(table, key=_place)}


def truth_of(case: Judged) -> str:
    """Name of a case's row."""
    if case.label.kind == "single":
        return case.label.effects[0]
    mild = case.label.kind == "none" and case.label.kinetics
    return "mild kinetics" if mild else case.label.kind


def _place(name: str) -> tuple[int, str]:
    return _ROWS.index(name) if name in _ROWS else len(_ROWS), name


def groups(cases: Sequence[Judged]) -> dict[str, dict[str, dict[str, Measured]]]:
    """Title -> group -> measure: singles by severity, by signals and by effect; all by kind."""

    def severity(case: Judged) -> str:
        k = int(np.searchsorted(_EDGES, case.label.severity, side="right")) - 1
        above = "above " * (k == len(_EDGES) - 2)
        return f"{k + 1}: {above}{_EDGES[k]:g}" + f" to {_EDGES[k + 1]:g}" * (not above)

    singles = [c for c in cases if c.label.kind == "single"]
    found = {}
    for title, among, group_of in (
        ("single effects by severity (gap over noise)", singles, severity),
        ("single effects by signals", singles, lambda c: c.label.signals),
        ("single effects by distinguishability", singles,
         lambda c: "distinguishable" if c.label.distinguishable else "not by 5 sigma"),
        ("single effects by name", singles, truth_of),
        ("all cases by kind", cases,
         lambda c: truth_of(c) if c.label.kind == "none" else c.label.kind),
        ("all cases by noise", cases, lambda c: c.label.noise),
    ):  # fmt: skip
        split: dict[str, list[Judged]] = {}
        for case in among:
            split.setdefault(group_of(case), []).append(case)
        found[title] = {
            group: {m.name: m.of(split[group]) for m in OF_GROUPS}
            for group in sorted(split, key=_place)
        }
    return found
