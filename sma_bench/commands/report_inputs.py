"""What sma-bench report shows of each of its inputs, and of all together."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.records import open_record
from sma_bench.records.record import Record
from sma_bench.report.page import Section, Table
from sma_bench.report.provenance import digest, versions
from sma_bench.report.record_section import record_section
from sma_bench.report.result_section import diagnose_section, identify_section
from sma_bench.results import IdentifyResult, read_result

_RESULT = ".json"


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


def shown_input(path: str, number: int, namespace: str | None) -> Shown:
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


def summary_section(shown: Sequence[Shown]) -> Section:
    """A line an input, and below it all their warnings."""
    rows = [(str(k), one.path, one.kind, one.said) for k, one in enumerate(shown, 1)]
    warnings = [text for one in shown for text in one.warnings]
    table = Table(("", "input", "kind", "what it says"), rows, frozenset({0}), "summary")
    told = f"{len(warnings)} warnings." if warnings else "No warnings."
    return Section("Summary", [told], warnings, [table])


def counted(shown: Sequence[Shown]) -> str:
    """How many of each kind: "2 bags, 1 diagnosis"."""
    kinds = [one.kind for one in shown]
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items())


def document(shown: Sequence[Shown], command: str, page: Path) -> dict[str, Any]:
    """The page's inputs as plain data."""
    return {
        "inputs": [
            {"path": one.path, "kind": one.kind, "says": one.said, "sha256": one.sha256,
             "bytes": one.size, "warnings": list(one.warnings)}
            for one in shown
        ],
        "command": command, "versions": versions(), "page": str(page),
    }  # fmt: skip
