"""What the paper is redrawn from: synthetic records, and the user's sorted by what they feed."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify import identify
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.instruments.tensile import identify_tensile
from sma_bench.identify.instruments.thermal_expansion import identify_thermal_expansion
from sma_bench.identify.instruments.transition_temperatures import identify_heating_rates
from sma_bench.identify.load_frame import (
    holds_frame,
    is_clamped_wire,
    isobaric_tests,
    tensile_tests,
)
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import find_drives
from sma_bench.identify.whole_model import moves
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, in_turn, part, silent
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.record import Record, has_samples
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.composite_figures import CompositeRun, composite_run
from sma_bench.report.errata import paper_errata
from sma_bench.report.experiment_figures import validation_picture
from sma_bench.report.page import Picture
from sma_bench.report.paper_page import (
    KINDS,
    TABLES,
    THERMAL,
    ExperimentResults,
    LabRecords,
    PaperPage,
    table_rows,
)
from sma_bench.synthetic import paper_specimens as specimens
from sma_bench.synthetic.paper_specimens import composite_rig, wire_rig

_SAME_STRESS = 5e6  # Pa
_ONE_RECORD = ("validation", "dsc", "clamped")
"""groups of LabRecords of which the simulated laboratory makes one"""


def synthetic_records(parameters: Parameters, groups: Sequence[str]) -> LabRecords:
    """Records of the simulated laboratory for these groups of LabRecords.

    Args:
        parameters: what the simulated wire and composite are made of.
    """
    made = {
        group: (getattr(specimens, f"{group}_record")(parameters),) if group in _ONE_RECORD
        else getattr(specimens, f"{group}_records")(parameters)
        for group in groups
    }
    return LabRecords(**made)


def sort_records(
    records: Sequence[object], parameters: Parameters
) -> tuple[LabRecords, list[Finding]]:
    """Sort a laboratory's records by the figures that they can feed.

    A bag with several driven wires and a deflection is of the composite; one with a force and
    clamps that stay is of E8, one with held loads of E6; staircases and ramps below A_s are for
    E1 to E3, other voltages for the validation of Fig. 6. Isobaric tests at one stress are repeats
    (Fig. 8); of several, the lowest stress is drawn there, all in the stress-temperature diagram.

    Returns:
        The sorted records, and a warning for each that feeds nothing.
    """
    found: dict[str, list[object]] = {}
    notes: list[Finding] = []
    for record in records:
        uses = _uses(record, parameters)
        for group, use in uses:
            found.setdefault(group, []).append(use)
        if not uses:
            path = str(getattr(record, "path", record))
            notes.append(Finding("warning", path, "feeds no figure of the paper"))
    tests = [test for test in found.get("isobaric", ()) if isinstance(test, IsobaricRecord)]
    if tests:
        lowest = min(test.stress for test in tests)
        found["upfr"] = [test for test in tests if test.stress - lowest < _SAME_STRESS]
        if len(found["upfr"]) == len(tests):
            del found["isobaric"]
    return LabRecords(**{group: tuple(held) for group, held in found.items()}), notes  # type: ignore[arg-type]


def _uses(record: object, parameters: Parameters) -> list[tuple[str, object]]:
    """Groups of LabRecords that a record belongs to, and what it is there."""
    for kind, group in (
        (DscRecord, "dsc"),
        (IsobaricRecord, "isobaric"),
        (TensileRecord, "tensile"),
    ):
        if isinstance(record, kind):
            return [(group, record)]
    if not isinstance(record, Record):
        return []

    # Bags of the composite and of a load frame.
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    if moves(record, parameters):
        return [("composite", record)] if len(driven) > 1 else []
    if pulls := tensile_tests(record, parameters):
        return [("tensile", test) for test in pulls]
    uses: list[tuple[str, object]] = []
    if is_clamped_wire(record):
        uses.append(("clamped", record))
    elif holds_frame(record):
        with suppress(InputError):
            uses += [("isobaric", test) for test in isobaric_tests(record, parameters)]

    # One driven wire: staircases, ramps below A_s, or any other voltage.
    if len(driven) != 1:
        return uses
    try:
        drives = find_drives(record)
    except InputError:
        return uses
    if any(drive.staircases for drive in drives):
        return [*uses, ("thermal", record)]
    temperature = f"{driven[0]}.temperature"
    if not has_samples(record, temperature):
        return uses
    hottest = float(np.nanmax(record[temperature].values))
    cold = hottest < parameters["wire.austenite_start_temperature"]
    is_ramp = any(drive.segments.ramps for drive in drives)
    return [*uses, ("thermal" if is_ramp and cold else "validation", record)]


# --- From a laboratory's sorted records to the results of its experiments.

# One wire record need not hold all three; the first choice that it holds counts.
_THERMAL_CHOICES = (THERMAL, ("E1", "E2"), ("E3",), ("E1",), ("E2",))


def identify_lab(
    records: LabRecords, parameters: Parameters, *, synthetic: bool
) -> tuple[dict[str, ExperimentResults], list[Finding]]:
    """Run every experiment that the records allow.

    Args:
        parameters: what is known beforehand.
        synthetic: whether the records are.

    Returns:
        Outcomes by kind ("E1" to "E3", "E5" to "E8", "E6 stresses"), and why others are missing.
    """
    found: dict[str, ExperimentResults] = {}
    notes: list[Finding] = []
    if records.thermal:
        found.update(_thermal(records.thermal, parameters, synthetic, notes))
    wanted: tuple[tuple[str, Sequence[object], Callable[[], Experiment]], ...] = (
        ("E5", records.dsc, lambda: identify_heating_rates(records.dsc)),
        ("E6", records.upfr, lambda: identify_isobaric(records.upfr, parameters)),
        (
            "E6 stresses",
            records.isobaric,
            lambda: identify_isobaric(records.isobaric, parameters),
        ),
        (
            "E7",
            records.tensile,
            lambda: identify_tensile(
                records.tensile, identified_parameters(parameters, list(found.values()))
            ),
        ),
        (
            "E8",
            records.clamped,
            lambda: identify_thermal_expansion(
                records.clamped,
                parameters,
                temperature=f"{records.clamped[0].channels[0]}.temperature",
            ),
        ),
    )
    for kind, given, run in wanted:
        if not given:
            continue
        try:
            experiment = run()
        except InputError as error:
            notes.append(Finding("warning", kind, str(error)))
        else:
            found[kind] = ExperimentResults((experiment,), experiment.estimates, synthetic)
    return found, notes


def _thermal(
    records: Sequence[Record], parameters: Parameters, synthetic: bool, notes: list[Finding]
) -> dict[str, ExperimentResults]:
    reasons: list[str] = []
    for choice in _THERMAL_CHOICES:
        try:
            result = identify(records, parameters, choice)
        except InputError as error:
            reasons.append(str(error))
            continue
        notes.extend(note for note in result.notes if note.severity != "info")
        found = {}
        for kind in choice:
            mine = tuple(e for e in result.experiments if e.name == kind)
            names = {name for e in mine for name in e.estimates}
            estimates = {n: e for n, e in result.estimates.items() if n in names}
            found[kind] = ExperimentResults(mine, estimates, synthetic)
        return found
    notes.append(Finding("warning", "E1 to E3", reasons[0]))
    return {}


def identified_parameters(
    parameters: Parameters, outcomes: Sequence[ExperimentResults]
) -> Parameters:
    """The given parameters with what the outcomes identified put in."""
    estimates = {name: e for outcome in outcomes for name, e in outcome.estimates.items()}
    return parameters.replace(
        {name: e.value for name, e in estimates.items()},
        {name: e.std for name, e in estimates.items()},
        "identified",
    )


# --- What sma-bench paper draws: records given, synthetic ones for the rest, compared with print.

_MEASURED, _SYNTHESISED = 0.1, 0.9
"""shares of the time, about: the records given done, the synthetic ones done"""


def paper_page(
    records: Sequence[object], parameters: Parameters, report: Report = silent
) -> PaperPage:
    """Identify the given records, simulate the paper's for what they do not hold, compare.

    Args:
        records: the user's, already read; none for a page of synthetic data.
        parameters: what is known of the bench that they come from. Synthetic data beside records
            are made of the paper's own numbers; without records, of these.
        report: called with how far it is.

    Raises:
        InputError: records were given and none of them can be used.
    """
    report(0.0, "experiments")
    measured, notes = sort_records(records, parameters)
    outcomes, reasons = identify_lab(measured, parameters, synthetic=False)
    notes += reasons
    validation = _validation(measured, parameters, outcomes, notes)
    several = len(parameters["bench.channels"]) > 1
    runs = _runs(measured, parameters if several else composite_rig(parameters), notes)
    if records and not (outcomes or validation or runs):
        raise InputError("; ".join(f"{note.subject}: {note.text}" for note in notes))
    paper, own = Parameters.of_paper(), bool(parameters.given) and not records
    if own:  # what this file does not state is the paper's
        stated = {name: parameters[name] for name in parameters.given}
        paper = paper.replace(stated, parameters.given_uncertainty)
    outcomes |= _synthetic_outcomes(paper, outcomes, part(report, _MEASURED, _SYNTHESISED))
    report(_SYNTHESISED, "composite")
    made = synthetic_records(paper, ["validation", "composite"])
    drawn = validation or _validation(made, paper, outcomes, notes, synthetic=True)
    assert drawn is not None
    is_drawn = bool(runs)
    runs = runs or _runs(made, composite_rig(paper), notes, synthetic=True)
    return PaperPage(
        outcomes,
        drawn,
        validation is None,
        runs,
        not is_drawn,
        {name: table_rows(name, outcomes) for name in TABLES},
        paper_errata(),
        notes,
        own,
    )


def _synthetic_outcomes(
    paper: Parameters, measured: Mapping[str, ExperimentResults], report: Report
) -> dict[str, ExperimentResults]:
    """Outcomes of the kinds of experiment that no measured record gave."""
    groups = [g for g, kinds in KINDS.items() if not set(kinds) <= set(measured)]
    found: dict[str, ExperimentResults] = {}
    for group in in_turn(groups, report, lambda name: f"{name} experiments"):
        found |= identify_lab(synthetic_records(paper, [group]), paper, synthetic=True)[0]
    return {kind: outcome for kind, outcome in found.items() if kind not in measured}


def _validation(
    records: LabRecords,
    parameters: Parameters,
    outcomes: Mapping[str, ExperimentResults],
    notes: list[Finding],
    *,
    synthetic: bool = False,
) -> Picture | None:
    """Fig. 6, simulated with what was identified from data of the same origin."""
    if not records.validation:
        return None
    alike = [outcomes[k] for k in THERMAL if k in outcomes and outcomes[k].synthetic == synthetic]
    record = records.validation[0]
    channel = next(c for c in record.channels if f"{c}.voltage" in record.signals)
    wire = wire_rig(identified_parameters(parameters, alike))
    try:
        return validation_picture(record, wire.replace({"bench.channels": (channel,)}))
    except InputError as error:
        notes.append(Finding("warning", "E4", str(error)))
        return None


def _runs(
    records: LabRecords, rig: Parameters, notes: list[Finding], *, synthetic: bool = False
) -> list[CompositeRun]:
    found = []
    for record in records.composite:
        try:
            found.append(composite_run(record, rig, with_rest_deflection=synthetic))
        except InputError as error:
            notes.append(Finding("warning", "E12", str(error)))
    return found


def to_json(page: PaperPage) -> dict[str, Any]:
    """Tables, errata, captions and remarks."""
    return {
        "figures": {
            str(number): [
                {"title": p.title, "caption": p.caption, "file": f"{p.name}.png"} for p in pictures
            ]
            for number, pictures in page.pictures().items()
        },
        "tables": {
            name: [
                {
                    "quantity": row.printed.symbol,
                    "description": row.printed.description,
                    "unit": row.printed.unit,
                    "paper": row.printed.value,
                    "identified": (
                        None if math.isnan(row.value) else {"value": row.value, "std": row.std}
                    ),
                    "synthetic": row.synthetic,
                    "source": row.source,
                }
                for row in rows
            ]
            for name, rows in page.tables.items()
        },
        "errata": [
            {f.name: getattr(erratum, f.name) for f in fields(erratum)} for erratum in page.errata
        ],
        "warnings": [f"{note.subject}: {note.text}" for note in page.notes],
    }
