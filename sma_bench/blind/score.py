"""Answers and labels brought together, once every answer is there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.blind.breakdown import confusion, groups, reliability
from sma_bench.blind.case_set import CaseSet
from sma_bench.blind.examination import open_cases
from sma_bench.blind.examinee import NOMINAL
from sma_bench.blind.judgement import Judged, Label
from sma_bench.blind.kept import (
    EXAMINATION,
    SECOND,
    Examination,
    Kept,
    is_kept,
    read_examination,
    read_kept,
)
from sma_bench.blind.measure_table import OTHERS, TARGETS
from sma_bench.blind.measures import Measure
from sma_bench.blind.shrinkage import UnseenRecord, parameter_error, parameters_of
from sma_bench.blind.statistics import Measured
from sma_bench.errors import InputError

Labels = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Paper:
    """All answers of one examinee, as handed in."""

    folder: Path
    examination: Examination
    kept: tuple[Kept, ...]

    @property
    def name(self) -> str:
        """How tables call it."""
        return self.examination.name


@dataclass(frozen=True)
class Score:
    """One examinee judged."""

    name: str
    cases: tuple[Judged, ...]
    measured: Mapping[str, Measured]

    def to_json(self) -> dict[str, Any]:
        """Measures, confusion matrix, reliability and groups as plain data."""
        return {
            "measures": {m.name: _row(m, self.measured[m.name]) for m in (*TARGETS, *OTHERS)},
            "confusion": confusion(self.cases),
            "reliability": [vars(bin_) for bin_ in reliability(self.cases)],
            "groups": {
                title: {group: {k: vars(v) for k, v in row.items()} for group, row in rows.items()}
                for title, rows in groups(self.cases).items()
            },
            "failed": {c.label.id: c.failure for c in self.cases if c.answer is None},
        }


def handed_in(cases: CaseSet, folders: Sequence[Path]) -> list[Paper]:
    """The complete papers of all examinees; the labels are not touched.

    Args:
        cases: the set.
        folders: of the answers; empty: every folder of answers that lies in the set.

    Raises:
        InputError: nobody has answered, an answer is missing, or it is to another set.
    """
    found = list(folders) or sorted(path.parent for path in cases.answers.glob(f"*/{EXAMINATION}"))
    if not found:
        raise InputError(f"{cases.answers}: no answers: run sma-bench blind run first")
    return [_paper(cases, folder) for folder in found]


def _paper(cases: CaseSet, folder: Path) -> Paper:
    examination = read_examination(folder)
    if examination.sealed != cases.sealed_sha256:
        raise InputError(f"{folder}: holds answers to another set than {cases.root}")
    missing = open_cases(cases.names, folder)
    if missing:
        raise InputError(
            f"{folder}: {len(missing)} of {len(cases.names)} cases have no answer yet, the first "
            f"is {missing[0]}: the labels stay sealed until sma-bench blind run has asked all"
        )
    return Paper(folder, examination, tuple(read_kept(folder, name) for name in cases.names))


def open_labels(cases: CaseSet) -> dict[str, dict[str, Any]]:
    """The labels by case.

    Raises:
        InputError: the seal is broken, or the labels are not those of the cases.
    """
    labels = {label["id"]: label for label in cases.labels()}
    if set(labels) != set(cases.names):
        raise InputError(f"{cases.root}: labels and cases do not belong together")
    return labels


def score(
    cases: CaseSet,
    papers: Sequence[Paper],
    labels: Labels,
    report: Callable[[int], None] = lambda done: None,
) -> list[Score]:
    """Judge every paper; each case's world is played once for all of them.

    Args:
        cases: the set; labels: by case.
        papers: complete ones.
        report: told the number of cases done.
    """
    judged: list[list[Judged]] = [[] for _ in papers]
    for done, name in enumerate(cases.names, 1):
        unseen = UnseenRecord(labels[name])
        for paper, into in zip(papers, judged, strict=True):
            kept = paper.kept[done - 1]
            into.append(_judged(cases, paper.folder, kept, labels[name], unseen))
        report(done)
    return [
        Score(paper.name, tuple(found), {m.name: m.of(found) for m in (*TARGETS, *OTHERS)})
        for paper, found in zip(papers, judged, strict=True)
    ]


def _judged(
    cases: CaseSet, folder: Path, kept: Kept, label: Mapping[str, Any], unseen: UnseenRecord
) -> Judged:
    nominal, improved = parameters_of(cases.folder / kept.case / NOMINAL, kept.improved)
    truth = label["truth"]
    followed = is_kept(folder / SECOND, kept.case)
    second = read_kept(folder / SECOND, kept.case).answer if followed else None
    return Judged(
        Label.of(label),
        kept.answer,
        unseen.shrunk(nominal, improved),
        (parameter_error(truth, nominal, nominal), parameter_error(truth, nominal, improved)),
        second,
        followed,
        kept.seconds,
        kept.line,
    )


def _row(measure: Measure, measured: Measured) -> dict[str, Any]:
    bounds = {"floor": measure.floor, "aim": measure.aim, "met": measure.met(measured)}
    return {**vars(measured), **bounds, "definition": measure.definition}
