"""sma-bench report: records and result files as one page that opens from disk and prints."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sma_bench.commands.output import add_json_option, write_json
from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.commands.progress_bar import progress
from sma_bench.progress import in_turn, part
from sma_bench.records import open_record
from sma_bench.records.record import Record
from sma_bench.report.page import Section, Table, write_report
from sma_bench.report.provenance import digest, parameter_section, provenance_section, versions
from sma_bench.report.record_section import record_section
from sma_bench.report.result_file import IdentifyResult, read_result
from sma_bench.report.result_section import diagnose_section, identify_section

_RESULT = ".json"
_READING = 0.3  # of the time, about


@dataclass(frozen=True)
class Shown:
    """One input: what it is, its sentence in the summary, its section, and what to beware of."""

    path: str
    kind: str
    said: str
    section: Section
    warnings: Sequence[str]
    sha256: str
    size: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "inputs", nargs="+", metavar="RECORD|RESULT",
        help="bag, instrument file, or a result of identify or diagnose (.json)",
    )
    parser.add_argument(
        "--out", metavar="DIR", required=True,
        help="folder for index.html, and its figures (PNG, SVG) and tables (CSV) for papers",
    )
    parser.add_argument("--title", default="SMA bench report", help="head of the page")
    parser.add_argument("--namespace", help="where two benches are in one bag: the one to show")
    add_json_option(parser, "summary and provenance")
    add_parameter_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read everything, then write everything; 0 whatever the inputs say."""
    parameters = parameters_from_options(args)
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), lambda path: f"reading {path}")
        shown = [_shown(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        digests = [(one.path, one.sha256, one.size) for one in shown]
        if args.params:
            digests.append((args.params, *digest(Path(args.params))))
        sections = [_summary(shown), *(one.section for one in shown)]
        if parameters.given:
            given = " and ".join([*([args.params] if args.params else []), *args.overrides])
            sections.append(parameter_section(parameters, given))
        made = datetime.now(UTC)
        sections.append(provenance_section(digests, args.command_line, made))
        page = write_report(
            args.out, args.title, f"{_counted(shown)}, {made:%Y-%m-%d}.", sections,
            for_papers=True, report=part(report, _READING, 1.0),
        )
    if args.json:
        write_json(args.json, _document(shown, args.command_line, page))
    for one in shown:
        print(f"{one.path}: {one.said}")
    warnings = sum(len(one.warnings) for one in shown)
    size = page.stat().st_size / 1e6
    print(f"warnings {warnings}\nreport   {page}, {size:.1f} MB")
    return 0


def _shown(path: str, number: int, namespace: str | None) -> Shown:
    """Read one input.

    Raises:
        InputError: it is neither a record nor a result.
    """
    name = f"input_{number}"
    if path.endswith(_RESULT):
        result = read_result(path)
        if isinstance(result, IdentifyResult):
            kind, (section, said) = "identification", identify_section(result, name)
        else:
            kind, (section, said) = "diagnosis", diagnose_section(result, name)
        worth = [f"{path}: {text}" for text in result.warnings if not text.startswith("info:")]
    else:
        record = open_record(path, namespace)
        kind = "bag" if isinstance(record, Record) else "instrument file"
        section, said, worth = record_section(record, name)
    return Shown(path, kind, said, section, worth, *digest(Path(path)))


def _summary(shown: Sequence[Shown]) -> Section:
    rows = [(str(k), one.path, one.kind, one.said) for k, one in enumerate(shown, 1)]
    warnings = [text for one in shown for text in one.warnings]
    table = Table(("", "input", "kind", "what it says"), rows, frozenset({0}), "summary")
    told = f"{len(warnings)} warnings." if warnings else "No warnings."
    return Section("Summary", [told], warnings, [table])


def _counted(shown: Sequence[Shown]) -> str:
    kinds = [one.kind for one in shown]
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items())


def _document(shown: Sequence[Shown], command: str, page: Path) -> dict[str, Any]:
    return {
        "inputs": [
            {"path": one.path, "kind": one.kind, "says": one.said, "sha256": one.sha256,
             "bytes": one.size, "warnings": list(one.warnings)}
            for one in shown
        ],
        "command": command, "versions": versions(), "page": str(page),
    }  # fmt: skip


