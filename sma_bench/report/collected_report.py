"""Sections of a collected report, records and results of other commands, their answers first; and
the report of an identification: its card, and measured against model under it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sma_bench.border import read_json, read_text
from sma_bench.cards import card, sentences
from sma_bench.diagnose.result import DiagnosisResult, diagnosis_from
from sma_bench.errors import InputError
from sma_bench.identify.result import Identification, identification_from
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import TABLE
from sma_bench.progress import Report, silent
from sma_bench.records import Record, describe, open_record
from sma_bench.records.open import AnyRecord
from sma_bench.report.diagnosis_figures import candidate_picture, chain_picture
from sma_bench.report.drawing import PaperColumn
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.report.page import Made, Section, digest, versions, write_report
from sma_bench.report.plots import (
    agreement_picture,
    correlation_picture,
    record_picture,
)
from sma_bench.report.tables import Table, diagnosis_tables, estimate_table
from sma_bench.results import LARGEST

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
        if isinstance(result, Identification):
            kind, section = "identification", identify_section(result, name)
            warnings = [*result.warnings]
        else:
            kind, section = "diagnosis", diagnose_section(result, name)
            warnings = [str(f) for f in result.findings if f.severity != "info"]
        (said,) = sentences(result, "headline")
        answer = Section(path, card=card(result, numbers=True))
        worth = [f"{path}: {text}" for text in warnings]
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
    several = {kind: f"{kind}s" for kind in kinds} | {"diagnosis": "diagnoses"}
    return ", ".join(f"{n} {several[kind] if n > 1 else kind}" for kind, n in counts.items())


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
        cells = [
            # The last bits of doubles, of a signal's times, are nothing.
            ["" if row[of] is None else format(
                0.0 if isinstance(row[of], float) and abs(row[of]) < 1e-12 else row[of], form
            ) for _, of, form in columns]
            for row in described[key]
        ]
        numeric = frozenset(k for k, (_, _, form) in enumerate(columns) if form)
        header = [heading for heading, _, _ in columns]
        tables.append(Table(header, cells, numeric, f"{name}_{key}", key.capitalize()))
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


# --- The parts of a report that show result files of `identify` and `diagnose`.

def read_result(path: str | Path) -> Identification | DiagnosisResult:
    """Read a result file, whichever command has written it.

    Raises:
        InputError: unreadable, not JSON, or not a result; one line that names what is missing.
    """
    document = read_json(read_text(path, LARGEST), str(path), LARGEST)
    if not isinstance(document, dict) or not {"verdict", "parameters"} & {*document}:
        raise InputError(f"{path}: not a result of identify or diagnose: neither parameters nor "
                         "verdict in it")
    if "verdict" in document:
        return diagnosis_from(document, str(path))
    return identification_from(document, str(path))


def identify_section(result: Identification, name: str) -> Section:
    """How the numbers agree with what is known, how their errors hang together, and what each
    experiment gave beside them."""
    tables = [estimate_table(result.estimates, f"{name}_parameters", "Parameters")]
    told = {key: (n.value, n.std) for key, n in result.estimates.items()}
    for k, e in enumerate(result.experiments, 1):
        own = {key: n for key, n in {**e.estimates, **e.details}.items()
               if (n.value, n.std) != told.get(key)}
        if own:
            title = f"{e.name} {e.title}, from {e.source}"
            tables.append(estimate_table(own, f"{name}_experiment_{k}", title))
    drawn = (
        agreement_picture(result, f"{name}_agreement"),
        correlation_picture(result, f"{name}_correlation"),
    )
    return Section(
        f"Identification {result.path}", [], result.warnings, tables,
        [picture for picture in drawn if picture is not None], pictures_first=True,
    )


def diagnose_section(result: DiagnosisResult, name: str) -> Section:
    """Candidates, where, and how far the gap shrinks."""
    tables = [replace(t, name=f"{name}_{t.name}") for t in diagnosis_tables(result).values()]
    pictures = [candidate_picture(result, f"{name}_candidates")]
    if result.where.chain:
        pictures.append(chain_picture(result, f"{name}_chain"))
    findings = [str(f) for f in result.findings]
    return Section(f"Diagnosis {result.path}", result.why, findings, tables, pictures)


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
    made = made or Made("sma_bench.identify")
    drawn = (agreement_picture(result, "agreement"), correlation_picture(result, "correlation"))
    sections = [
        Section(
            "", notes=list(map(str, result.notes)),
            pictures=[picture for picture in drawn if picture is not None],
            card=card(result, numbers=True),
        ),
        *(
            Section(f"{e.name} {e.title}", [e.source], list(map(str, e.findings)),
                    pictures=experiment_pictures(e))
            for e in result.experiments
        ),
        Section("How each number was found", tables=[estimate_table(result.estimates, "numbers")]),
        made.section(),
    ]
    sources = "; ".join(dict.fromkeys(experiment.source for experiment in result.experiments))
    return write_report(
        directory, "Identified parameters", f"From {sources}. {made.head}", sections,
        column=column, report=report,
    )
