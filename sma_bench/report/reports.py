"""Reports of an identification, of a diagnosis, and of collected records and results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sma_bench.border import read_json, read_text
from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.result import NO_GAP, UNEXPLAINED, DiagnosisResult, diagnosis_from
from sma_bench.diagnose.sizes import sample_noise
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.findings import fold_audit
from sma_bench.identify.result import Identification, identification_from
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TABLE
from sma_bench.progress import Report, silent
from sma_bench.records import Record, describe, open_record
from sma_bench.report import plots
from sma_bench.report.drawing import PaperColumn
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.report.page import Made, Picture, Section, Table, digest, write_report
from sma_bench.report.tables import cell_of, diagnosis_tables, record_line, record_tables, table_of
from sma_bench.results import LARGEST, card, for_people, sentences, signed, with_error


def write_identification_report(directory: str | Path, result: Identification,
                                report: Report = silent, made: Made | None = None,
                                column: PaperColumn | None = None) -> Path:
    """Write the page of an identification; its path. Arguments as `write_report`. InputError: the
    folder cannot be written."""
    pictures = _present(plots.agreement_picture(result))
    sections = [
        Section("", notes=list(map(str, result.notes)), pictures=pictures,
                card=card(result, numbers=True)),
        *(Section(f"{e.name} {e.title}", [e.source], list(map(str, e.findings)),
                  pictures=experiment_pictures(e)) for e in result.experiments),
        Section("How each number was found",
                tables=[table_of(result, "plain_numbers", result.estimates, name="numbers")])]
    sources = "; ".join(dict.fromkeys(experiment.source for experiment in result.experiments))
    return write_report(directory, "Identified parameters", f"From {sources}.", sections,
                        made or Made("sma_bench.identify"), column=column, report=report)


def write_diagnosis_report(directory: str | Path, result: Diagnosis, report: Report = silent,
                           made: Made | None = None, column: PaperColumn | None = None) -> Path:
    """Write the page of a diagnosis, as `write_identification_report`."""
    tables = diagnosis_tables(result)
    # The noise of every sensor; the quantity with the largest error comes first.
    problem, order = result.model.problem, [*(q for q, _ in result.worst_first), *QUANTITIES]
    names = sorted(problem.noise, key=lambda name: order.index(name.rpartition(".")[2]))
    noises = [(name, sample_noise(problem, name), max(problem.noise[name].drift, 0.0),
               problem.noise[name].time) for name in names]
    sections = [
        Section("Is there a gap beyond the noise?", sentences(result, "is_there"),
                tables=[table_of(result, "noise_table", noises)],
                pictures=plots.signal_pictures(result)),
        Section("Where is it?", sentences(result, "where"), pictures=[plots.gap_picture(result)]),
        Section("Which effect, and how sure?", [*sentences(result, "which"), *result.why],
                tables=[tables["candidates"]],
                pictures=[plots.evidence_picture(result)])]
    if result.verdict == UNEXPLAINED:
        text = ("What a further effect would have to do to the readings. The figures can only "
                "suggest its cause.")
        shape = plots.missing_pictures(result)
        sections.append(Section("What no effect explains", [text], pictures=shape))
    # The data used.
    parts = [("fitted", v) for v in result.fitted] + [("held out", v) for v in result.held_out]
    rows = [(view.path, part, s.name, f"{s.time[0]:.1f} to {s.time[-1]:.1f}",
             f"{int(s.count.sum())}", f"{s.period:.2g}") for part, view in parts
            for s in view.signals]
    header = ("record", "used", "signal", "time [s]", "samples", "bin [s]")
    left_out = dict.fromkeys(name for view in result.observations for name in view.left_out)
    paragraphs = [f"Recorded but not compared: {', '.join(left_out)}."] if left_out else []
    findings, audit = (list(map(str, own)) for own in fold_audit(result.findings))
    sections += [
        Section("How far does it shrink?", sentences(result, "how_far"),
                tables=[tables["shrinkage"],
                        *([] if result.verdict == NO_GAP else [improvements(result)])]),
        Section("What next?", sentences(result, "next", None)),
        Section("Which data were used?", paragraphs, findings,
                [Table(header, rows, frozenset({4, 5}))], folded=audit)]
    numbered = [replace(s, title=f"{k}. {s.title}") for k, s in enumerate(sections, 1)]
    sources = list(dict.fromkeys(view.path for view in result.observations))
    return write_report(directory, "The gap between simulation and bench",
                        f"From {'; '.join(sources)}.", [Section("", card=card(result)), *numbered],
                        made or Made("sma_bench.diagnose", sources), column=column, report=report)


def improvements(result: Diagnosis) -> Table:
    """The parameters of the best model, compared with the stated ones."""
    unknowns, at, rows = result.model.unknowns, result.model.x, []
    for item, x, value, std in zip(unknowns.items, unknowns.deviations(at), unknowns.values(at),
                                   result.model.errors, strict=True):
        name, stated = item.name, item.value(0.0)  # some follow from the geometry
        moved = "" if name.startswith("effect.") or not item.std else signed(float(x), ".1f")
        unit, factor = for_people(BY_NAME[name].unit, value)
        rows.append((name, f"{factor * stated:.6g}", with_error(factor * value, factor * std), unit,
                     moved))
    header = ("parameter", "as stated", "improved", "unit", "moved by [std]")
    return Table(header, rows, frozenset({1, 2, 4}))


@dataclass(frozen=True)
class ReportedInput:
    """An input of a collected report: its kind, one-line summary, section, warnings and card."""

    path: str
    kind: str
    summary: str
    section: Section
    warnings: Sequence[str]
    sha256: str
    size: int
    answer: Section | None = None

    def to_json(self) -> dict[str, Any]:
        return {"path": self.path, "kind": self.kind, "says": self.summary, "sha256": self.sha256,
                "bytes": self.size, "warnings": list(self.warnings)}


def shown_input(path: str, number: int, namespace: str | None) -> ReportedInput:
    """Read one input. Raises InputError: it is neither a record nor a result."""
    name = f"input_{number}"
    if not path.endswith(".json"):
        record = open_record(path, namespace)
        described = describe(record)
        summary = record_line(described)
        lines = [(f["severity"], f"{f['subject']}: {f['text']}") for f in described["findings"]]
        worth = [f"{path}: {text}" for severity, text in lines if severity != "info"]
        kind, figures = "instrument file", list[Picture]()
        if isinstance(record, Record):
            kind = "bag"
            figures = _present(plots.record_picture(record, f"{name}_signals_over_time"))
        section = Section(f"Record {path}", [f"{summary}."], [": ".join(line) for line in lines],
                          record_tables(described, name), figures)
        return ReportedInput(path, kind, summary, section, worth, *digest(Path(path)))

    result = read_result(path)
    if isinstance(result, Identification):
        kind, warnings = "identification", [*result.warnings]
        tables = [table_of(result, "plain_numbers", result.estimates, name=f"{name}_parameters",
                           title="Parameters")]
        shown = {key: (n.value, n.std) for key, n in result.estimates.items()}
        for k, e in enumerate(result.experiments, 1):
            own = {key: n for key, n in {**e.estimates, **e.details}.items()
                   if (n.value, n.std) != shown.get(key)}
            if own:
                tables.append(table_of(result, "plain_numbers", own, name=f"{name}_experiment_{k}",
                                       title=f"{e.name} {e.title}, from {e.source}"))
        pictures = _present(plots.agreement_picture(result, f"{name}_agreement"))
        section = Section(f"Identification {path}", [], warnings, tables, pictures)
    else:
        kind = "diagnosis"
        notes = [str(f) for f in result.findings]
        warnings = [note for note in notes if not note.startswith("info")]
        tables = [replace(t, name=f"{name}_{t.name}") for t in diagnosis_tables(result).values()]
        section = Section(f"Diagnosis {path}", result.why, notes, tables)
    (summary,) = sentences(result, "headline")
    worth = [f"{path}: {text}" for text in warnings]
    answer = Section(path, card=card(result, numbers=True))
    return ReportedInput(path, kind, summary, section, worth, *digest(Path(path)), answer)


def write_collected_report(directory: str | Path, title: str, shown: Sequence[ReportedInput],
                           parameters: Parameters, given: str, made: Made,
                           column: PaperColumn | None, report: Report) -> Path:
    """Write one page: cards of all results, a summary with one line per input and all warnings, a
    section per input, and the parameters from `given`. InputError: the folder cannot be written."""
    cards = [one.answer for one in shown if one.answer is not None]
    cards = cards if len(cards) > 1 else [replace(section, title="") for section in cards]
    rows = [(str(k), one.path, one.kind, one.summary) for k, one in enumerate(shown, 1)]
    warnings = [text for one in shown for text in one.warnings]
    table = Table(("", "input", "kind", "result"), rows, frozenset({0}), "summary")
    head = f"{len(warnings)} warning{'s' if len(warnings) != 1 else ''}"
    summary = Section("Summary", [] if warnings else ["No warnings."], tables=[table],
                      folded=[head, *warnings] if warnings else ())
    sections = [*cards, summary, *(one.section for one in shown)]
    if parameters.given:
        rows = []
        for p in (p for p in TABLE if p.name in parameters.given):
            known = p.uncertainty is not None or p.name in parameters.given_uncertainty
            std = f"{parameters.std(p.name):.2g}" if known else ""
            rows.append((p.name, cell_of(parameters[p.name]), std, p.unit))
        header = ("parameter", "value", "standard deviation", "unit")
        table = Table(header, rows, frozenset({1, 2}), "parameters")
        text = f"As given in {given}; all others as in docs/parameters.md."
        sections.append(Section("Parameters", [text], tables=[table]))
    sources = f"From {'; '.join(dict.fromkeys(one.path for one in shown))}."
    return write_report(directory, title, sources, sections, made, column=column, report=report)


def read_result(path: str | Path) -> Identification | DiagnosisResult:
    """A result of identify or diagnose. InputError: unreadable, not JSON, or not a result."""
    document = read_json(read_text(path, LARGEST), str(path), LARGEST)
    if not isinstance(document, dict) or not {"verdict", "parameters"} & {*document}:
        raise InputError(f"{path}: not a result of identify or diagnose: has neither "
                         "parameters nor verdict")
    read = diagnosis_from if "verdict" in document else identification_from
    return read(document, str(path))


def _present(*pictures: Picture | None) -> list[Picture]:
    return [picture for picture in pictures if picture is not None]
