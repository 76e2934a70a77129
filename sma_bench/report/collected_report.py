"""Sections of a collected report, records and results of other commands, their answers first; and
the report of an identification: its card, and measured against model under it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sma_bench.cards import identification_card, verdict_card
from sma_bench.findings import Finding
from sma_bench.identify import Identification
from sma_bench.identify.estimate import Experiment
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import TABLE
from sma_bench.progress import Report, silent
from sma_bench.records import Record, describe, open_record
from sma_bench.records.open import AnyRecord
from sma_bench.report.diagnosis_words import result_tables
from sma_bench.report.drawing import PaperColumn
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.report.page import Made, Section, Table, digest, versions, write_report
from sma_bench.report.plots import (
    agreement_picture,
    candidate_bars,
    chain_picture,
    correlation_picture,
    record_picture,
)
from sma_bench.results import DiagnoseResult, IdentifyResult, ShownNumber, read_result, with_error

# --- Each input, and all together.

_RESULT = ".json"


@dataclass(frozen=True)
class ReportedInput:
    """One input: what it is, its sentence in the summary, its section, and what to beware of."""

    path: str
    kind: str
    said: str
    section: Section
    warnings: Sequence[str]
    sha256: str
    size: int
    answer: Section | None = None


def shown_input(path: str, number: int, namespace: str | None) -> ReportedInput:
    """Read one input.

    Raises:
        InputError: it is neither a record nor a result.
    """
    name, answer = f"input_{number}", None
    if path.endswith(_RESULT):
        result = read_result(path)
        if isinstance(result, IdentifyResult):
            kind, (section, said) = "identification", identify_section(result, name)
            card = identification_card(result)
        else:
            kind, (section, said) = "diagnosis", diagnose_section(result, name)
            card = verdict_card(result)
        answer = Section(path, card=card)
        worth = [f"{path}: {text}" for text in result.warnings if not text.startswith("info:")]
    else:
        record = open_record(path, namespace)
        kind = "bag" if isinstance(record, Record) else "instrument file"
        section, said, worth = record_section(record, name)
    return ReportedInput(path, kind, said, section, worth, *digest(Path(path)), answer)


def answers(shown: Sequence[ReportedInput]) -> list[Section]:
    """The cards of all results; one that stands alone needs no heading."""
    found = [one.answer for one in shown if one.answer is not None]
    return found if len(found) > 1 else [replace(section, title="") for section in found]


def summary_section(shown: Sequence[ReportedInput]) -> Section:
    """A line an input, and folded above them all their warnings, which stand in their sections."""
    rows = [(str(k), one.path, one.kind, one.said) for k, one in enumerate(shown, 1)]
    warnings = [text for one in shown for text in one.warnings]
    table = Table(("", "input", "kind", "what it says"), rows, frozenset({0}), "summary")
    if not warnings:
        return Section("Summary", ["No warnings."], tables=[table])
    head = f"{len(warnings)} warning{'s' if len(warnings) != 1 else ''}"
    return Section("Summary", tables=[table], folded=[head, *warnings])


def counted(shown: Sequence[ReportedInput]) -> str:
    """How many of each kind: "2 bags, 1 diagnosis"."""
    kinds = [one.kind for one in shown]
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return ", ".join(f"{n} {_several(kind) if n > 1 else kind}" for kind, n in counts.items())


def _several(kind: str) -> str:
    return "diagnoses" if kind == "diagnosis" else f"{kind}s"


def document(shown: Sequence[ReportedInput], command: str, page: Path) -> dict[str, Any]:
    """The page's inputs as plain data."""
    return {
        "inputs": [
            {"path": one.path, "kind": one.kind, "says": one.said, "sha256": one.sha256,
             "bytes": one.size, "warnings": list(one.warnings)}
            for one in shown
        ],
        "command": command, "versions": versions(), "page": str(page),
    }  # fmt: skip


# --- The part of a report that shows one record as it was measured.

_Columns = Sequence[tuple[str, str, str]]

# Heading with its unit, key of `describe`, format.
_SIGNALS: _Columns = (
    ("signal", "name", ""), ("unit", "unit", ""), ("samples", "samples", "d"),
    ("rate [Hz]", "rate", ".4g"), ("jitter [s]", "jitter", ".2g"),
    ("longest gap [s]", "longest_gap", ".3g"), ("delay [s]", "delay", ".3g"),
    ("min", "min", ".5g"), ("mean", "mean", ".5g"), ("max", "max", ".5g"),
)  # fmt: skip
_SEGMENTS: _Columns = (
    ("segment", "number", "d"), ("kind", "kind", ""), ("rate [K/s]", "rate", ".4f"),
    ("samples", "samples", "d"), ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
)  # fmt: skip
_BRANCHES: _Columns = (
    ("cycle", "cycle", "d"), ("kind", "kind", ""), ("samples", "samples", "d"),
    ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
    ("strain from", "strain_from", ".5f"), ("strain to", "strain_to", ".5f"),
)  # fmt: skip
_TABLE_ROWS: dict[str, tuple[str, _Columns]] = {
    "bag": ("signals", _SIGNALS), "dsc": ("segments", _SEGMENTS),
    "isobaric": ("branches", _BRANCHES),
}  # fmt: skip
_SAID: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "bag": lambda d: (
        f"{d['duration']:.1f} s{_since(d['start'])}, "
        f"channels: {', '.join(d['channels']) or 'none'}, {len(d['signals'])} signals, "
        f"{len(d['markers'])} markers"
    ),
    "dsc": lambda d: f"{d['instrument']}, {d['sample']}, {d['mass'] * 1e6:.3f} mg",
    "isobaric": lambda d: f"isobaric test at {d['stress'] / 1e6:.1f} MPa",
    "tensile": lambda d: (
        f"tensile test, {d['samples']} samples, to {d['largest_strain']:.4f} strain and "
        f"{d['largest_stress'] / 1e6:.1f} MPa"
    ),
}


def _since(start: str) -> str:
    """When a record began; one from arrays, or a simulated one, has no date."""
    return "" if start.startswith("1970-01-01") else f" from {start}"


def record_section(record: AnyRecord, name: str) -> tuple[Section, str, list[str]]:
    """Heading, tables and figure of a record.

    Args:
        record: already read.
        name: that its files begin with.

    Returns:
        The section, a sentence for the summary, and what should be known before it is trusted.
    """
    described = describe(record)
    kind = described["kind"]
    said = _SAID[kind](described)
    tables = []
    if kind in _TABLE_ROWS:
        key, columns = _TABLE_ROWS[kind]
        tables.append(_table(described[key], columns, f"{name}_{key}", key.capitalize()))
    findings = described["findings"]
    lines = [f"{f['severity']}: {f['subject']}: {f['text']}" for f in findings]
    worth = [
        f"{record.path}: {f['subject']}: {f['text']}" for f in findings if f["severity"] != "info"
    ]
    picture = record_picture(record, name)
    section = Section(
        f"Record {record.path}", [f"{said}."], lines, tables, [picture] if picture else []
    )
    return section, said, worth


def _table(rows: Sequence[Mapping[str, Any]], columns: _Columns, name: str, title: str) -> Table:
    cells = [[_cell(row[key], form) for _, key, form in columns] for row in rows]
    numeric = frozenset(k for k, (_, _, form) in enumerate(columns) if form)
    return Table([heading for heading, _, _ in columns], cells, numeric, name, title)


_NOTHING = 1e-12  # of a signal's times: the last bits of doubles


def _cell(value: Any, form: str) -> str:
    if isinstance(value, float) and abs(value) < _NOTHING:
        value = 0.0
    return "" if value is None else format(value, form)


# --- The parts of a report that show result files of `identify` and `diagnose`.

_NUMBER_HEADER = (
    "parameter", "value", "statistical", "systematic", "unit", "informed", "points", "method",
)


def identify_section(result: IdentifyResult, name: str) -> tuple[Section, str]:
    """How the numbers agree with what is known, how their errors hang together, and what each
    experiment gave beside them.

    Returns:
        The section and a sentence for the summary.
    """
    tables = [detail_table(result.parameters, f"{name}_parameters", "Parameters")]
    for k, (title, source, numbers) in enumerate(result.experiments, 1):
        own = [number for number in numbers if _is_new(number, result.parameters)]
        if own:
            tables.append(detail_table(own, f"{name}_experiment_{k}", f"{title}, from {source}"))
    drawn = (
        agreement_picture(result, f"{name}_agreement"),
        correlation_picture(result, f"{name}_correlation"),
    )
    section = Section(
        f"Identification {result.path}", [], result.warnings, tables,
        [picture for picture in drawn if picture is not None], pictures_first=True,
    )
    done = ", ".join(dict.fromkeys(title.split()[0] for title, _, _ in result.experiments))
    return section, f"{len(result.parameters)} parameters identified by {done or 'no experiment'}"


def _is_new(number: ShownNumber, known: Sequence[ShownNumber]) -> bool:
    """Whether it is not told already, as a parameter of the same value and error."""
    return all((n.name, n.value, n.std) != (number.name, number.value, number.std) for n in known)


def diagnose_section(result: DiagnoseResult, name: str) -> tuple[Section, str]:
    """Verdict, candidates, where, and how far the gap shrinks.

    Returns:
        The section and a sentence for the summary.
    """
    said = verdict(result)
    tables = [
        Table(t.header, t.rows, t.numeric, f"{name}_{t.name}", t.title)
        for t in result_tables(result)
    ]
    pictures = [candidate_bars(result, f"{name}_candidates")]
    if result.chain:
        pictures.append(chain_picture(result, f"{name}_chain"))
    section = Section(
        f"Diagnosis {result.path}", result.why, result.warnings, tables, pictures
    )
    return section, said


def verdict(result: DiagnoseResult) -> str:
    """Verdict, cause and the probability of the first candidate, in one line."""
    cause = f" {' and '.join(result.cause)}" if result.cause else ""
    stage = f", {result.stage} stage" if result.stage and result.cause else ""
    first = result.candidates[0] if result.candidates else None
    sure = f" ({first.name} has probability {100 * first.probability:.0f} %)" if first else ""
    return f"{result.verdict}{cause}{stage}{sure}"


def detail_table(numbers: Sequence[ShownNumber], name: str, title: str = "") -> Table:
    """Numbers with all that is known of them, a plain number a cell."""
    rows = [
        (
            n.name, with_error(n.value, n.statistical).partition(" ")[0], f"{n.statistical:.2g}",
            f"{n.systematic:.2g}" if n.systematic else "", n.unit,
            f"{n.informed:.3f}" if math.isfinite(n.informed) else "", str(n.n) if n.n else "",
            n.method,
        )
        for n in numbers
    ]
    return Table(_NUMBER_HEADER, rows, frozenset({1, 2, 3, 5, 6}), name, title)


def parameter_section(parameters: Parameters, path: str) -> Section:
    """The parameters that were given, with their uncertainties."""
    rows = []
    for p in TABLE:
        if p.name not in parameters.given:
            continue
        value = parameters[p.name]
        shown = ", ".join(value) if isinstance(value, tuple) else str(value)
        shown = f"{value:.6g}" if isinstance(value, float) else shown
        known = p.uncertainty is not None or p.name in parameters.given_uncertainty
        rows.append((p.name, shown, f"{parameters.std(p.name):.2g}" if known else "", p.unit))
    header = ("parameter", "value", "standard deviation", "unit")
    table = Table(header, rows, frozenset({1, 2}), "parameters")
    return Section("Parameters", [f"As given in {path}; all others as in docs/parameters.md."],
                   tables=[table])  # fmt: skip


def write_identification_report(
    directory: str | Path, result: Identification, report: Report = silent,
    made: Made | None = None, column: PaperColumn | None = None,
) -> Path:
    """Write the report's index.html and figures.

    Args:
        report: hears which figure comes.
        made: by which command and of which inputs.
        column: of a paper, for which the figures are written as well.

    Raises:
        InputError: the folder cannot be written.
    """
    shown, made = result.shown, made or Made("sma_bench.identify")
    drawn = (agreement_picture(shown, "agreement"), correlation_picture(shown, "correlation"))
    sections = [
        Section(
            "", notes=_lines(result.notes),
            pictures=[picture for picture in drawn if picture is not None],
            card=identification_card(shown),
        ),
        *(experiment_section(experiment) for experiment in result.experiments),
        Section("How each number was found", tables=[detail_table(shown.parameters, "numbers")]),
        made.section(),
    ]
    sources = "; ".join(dict.fromkeys(experiment.source for experiment in result.experiments))
    return write_report(
        directory, "Identified parameters", f"From {sources}. {made.head}", sections,
        column=column, report=report,
    )


def experiment_section(experiment: Experiment) -> Section:
    """Remarks and figures of one experiment."""
    return Section(
        f"{experiment.name} {experiment.title}",
        paragraphs=[experiment.source],
        notes=_lines(experiment.findings),
        pictures=experiment_pictures(experiment),
    )


def _lines(findings: tuple[Finding, ...]) -> list[str]:
    return [str(finding) for finding in findings]
