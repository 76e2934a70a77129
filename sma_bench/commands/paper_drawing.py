"""What sma-bench paper draws: records given, synthetic ones for the rest, compared with print."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from sma_bench.commands.paper_records import sort_records, synthetic_records
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, in_turn, part, silent
from sma_bench.report.composite_figures import CompositeRun, composite_run
from sma_bench.report.errata import paper_errata
from sma_bench.report.page import Picture
from sma_bench.report.paper_page import (
    KINDS,
    TABLES,
    THERMAL,
    LabRecords,
    Outcome,
    PaperPage,
    Row,
    identified_parameters,
    identify_lab,
    table_rows,
)
from sma_bench.report.thermal_figures import validation_picture
from sma_bench.synthetic.paper_specimens import composite_rig, wire_rig

_MEASURED, _SYNTHESISED = 0.1, 0.9
"""shares of the time, about: the records given done, the synthetic ones done"""


def paper_page(
    records: Sequence[object], parameters: Parameters, report: Report = silent
) -> PaperPage:
    """Identify the given records, simulate the paper's for what they do not hold, compare.

    Args:
        records: the user's, already read; none for a page of synthetic data.
        parameters: what is known of the bench that they come from. Synthetic data are made of the
            paper's own numbers.
        report: told how far it is.

    Raises:
        InputError: records were given and none of them can be used.
    """
    report(0.0, "experiments")
    measured, notes = sort_records(records, parameters)
    outcomes, reasons = identify_lab(measured, parameters, synthetic=False)
    notes += reasons
    validation = _validation(measured, parameters, outcomes, notes)
    runs = _runs(measured, parameters, notes)
    if records and not (outcomes or validation or runs):
        raise InputError("; ".join(f"{note.subject}: {note.text}" for note in notes))
    paper = Parameters.defaults()
    outcomes |= _synthetic_outcomes(paper, outcomes, part(report, _MEASURED, _SYNTHESISED))
    report(_SYNTHESISED, "composite")
    made = synthetic_records(paper, ["validation", "composite"])
    drawn = validation or _validation(made, paper, outcomes, notes, synthetic=True)
    assert drawn is not None
    return PaperPage(
        outcomes, drawn, validation is None, runs or _runs(made, paper, notes), not runs,
        {name: table_rows(name, outcomes) for name in TABLES}, paper_errata(), notes,
    )


def _synthetic_outcomes(
    paper: Parameters, measured: Mapping[str, Outcome], report: Report
) -> dict[str, Outcome]:
    """Outcomes of the kinds of experiment that no measured record gave."""
    groups = [g for g, kinds in KINDS.items() if not set(kinds) <= set(measured)]
    found: dict[str, Outcome] = {}
    for group in in_turn(groups, report, lambda name: f"{name} experiments"):
        found |= identify_lab(synthetic_records(paper, [group]), paper, synthetic=True)[0]
    return {kind: outcome for kind, outcome in found.items() if kind not in measured}


def _validation(
    records: LabRecords, parameters: Parameters, outcomes: Mapping[str, Outcome],
    notes: list[Finding], *, synthetic: bool = False,
) -> Picture | None:
    """Fig. 6, simulated with what was identified from data of the same origin."""
    if not records.validation:
        return None
    alike = [outcomes[k] for k in THERMAL if k in outcomes and outcomes[k].synthetic == synthetic]
    record = records.validation[0]
    channel = next(c for c in record.channels if f"{c}.voltage" in record.signals)
    wire = wire_rig(identified_parameters(parameters, alike))
    try:
        return validation_picture(record, wire.replace({"bench.channels": (channel,)}))[0]
    except InputError as error:
        notes.append(Finding("warning", "E4", str(error)))
        return None


def _runs(
    records: LabRecords, parameters: Parameters, notes: list[Finding]
) -> list[CompositeRun]:
    several = len(parameters["bench.channels"]) > 1
    rig = parameters if several else composite_rig(parameters)
    found = []
    for record in records.composite:
        try:
            found.append(composite_run(record, rig))
        except InputError as error:
            notes.append(Finding("warning", "E12", str(error)))
    return found


def to_json(page: PaperPage) -> dict[str, Any]:
    """Tables, errata, captions and remarks."""
    return {
        "figures": {
            str(number): [{"title": p.title, "caption": p.caption, "file": f"{p.name}.png"}
                          for p in pictures]
            for number, pictures in page.pictures().items()
        },
        "tables": {name: [_row(row) for row in rows] for name, rows in page.tables.items()},
        "errata": [
            {f.name: getattr(erratum, f.name) for f in fields(erratum)} for erratum in page.errata
        ],
        "warnings": [f"{note.subject}: {note.text}" for note in page.notes],
    }


def _row(row: Row) -> dict[str, Any]:
    identified = None if math.isnan(row.value) else {"value": row.value, "std": row.std}
    return {
        "quantity": row.printed.symbol, "description": row.printed.description,
        "unit": row.printed.unit, "paper": row.printed.value, "identified": identified,
        "synthetic": row.synthetic, "source": row.source,
    }
