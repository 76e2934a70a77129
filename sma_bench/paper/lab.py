"""Records for redrawing the paper: the user's, sorted by figure, and synthetic ones."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify import identify
from sma_bench.identify.isobaric import isobaric_tests
from sma_bench.identify.signals import find_drives, holds_frame, is_clamped_wire, moves
from sma_bench.identify.tensile import tensile_tests
from sma_bench.paper import page
from sma_bench.paper.page import CompositeRun, ExperimentResults, PaperPage, composite_run
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, in_turn, part, silent
from sma_bench.records.instruments import DscRecord, IsobaricRecord, TensileRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.record import Record, has_samples
from sma_bench.report.experiment_figures import validation_picture
from sma_bench.report.page import Picture
from sma_bench.synthetic.paper_specimens import composite_rig, papers_records, wire_rig

LabRecords = Mapping[str, tuple[Any, ...]]
"""Records by group: one of KINDS, "validation" (E4, a record that nothing is fitted to) or
"composite" (E12)"""
THERMAL = ("E1", "E2", "E3")
# Kinds of experiment by the group of records that feeds them: "thermal" are staircases and ramps
# below A_s of one wire, "upfr" loops at one low load, "isobaric" those at several.
KINDS = {"thermal": THERMAL, "dsc": ("E5",), "upfr": ("E6",), "isobaric": ("E6 stresses",),
         "tensile": ("E7",), "clamped": ("E8",)}  # fmt: skip
_INSTRUMENTS = {DscRecord: "dsc", IsobaricRecord: "isobaric", TensileRecord: "tensile"}
_SAME_STRESS = 5e6  # Pa
_MEASURED, _SYNTHESISED = 0.1, 0.9  # of the progress: after the records given, the synthetic ones


def paper_page(records: Sequence[AnyRecord], parameters: Parameters,
               report: Report = silent) -> PaperPage:
    """Identify the user's records, if any, and synthetic ones where those lack data; compare with
    the paper. `parameters`: of the user's bench; synthetic data next to records use the paper's own
    numbers. Raises InputError: none of the records given can be used."""
    report(0.0, "experiments")
    measured, notes = sort_records(records, parameters)
    outcomes, reasons = identify_lab(measured, parameters, synthetic=False)
    notes += reasons
    validation = _validation(measured, parameters, outcomes, notes)
    several = len(parameters["bench.channels"]) > 1
    runs = _runs(measured, parameters if several else composite_rig(parameters), notes)
    if records and not (outcomes or validation or runs):
        raise InputError("; ".join(f"{note.subject}: {note.text}" for note in notes))
    # All else is synthetic: with stated parameters if there are no records, else the paper's.
    paper = Parameters.of_paper()
    if parameters.given and not records:
        stated = {name: parameters[name] for name in parameters.given}
        paper = paper.replace(stated, parameters.given_uncertainty)
    outcomes |= _synthetic_outcomes(paper, outcomes, part(report, _MEASURED, _SYNTHESISED))
    report(_SYNTHESISED, "composite")
    made, synthetic = {g: papers_records(g, paper) for g in ("validation", "composite")}, set[int]()
    if validation is None:
        synthetic.add(6)
        validation = _validation(made, paper, outcomes, notes, synthetic=True)
        assert validation is not None
    if not runs:
        synthetic |= {15, 16}
        runs = _runs(made, composite_rig(paper), notes)
    pictures = page.paper_pictures(outcomes, validation, runs, synthetic)
    tables = {name: page.table_rows(name, outcomes) for name in page.TABLES}
    return PaperPage(outcomes, pictures, tables, page.paper_errata(), notes)


def sort_records(records: Sequence[AnyRecord],
                 parameters: Parameters) -> tuple[LabRecords, list[Finding]]:
    """A laboratory's records by the figures that they feed; a warning for each that feeds none.
    Isobaric tests at one stress are repeats (Fig. 8); of several, the lowest stress is drawn there,
    all in the stress-temperature diagram."""
    found, notes = dict[str, list[Any]](), list[Finding]()
    for record in records:
        uses = (_uses_of_bag(record, parameters) if isinstance(record, Record)
                else [(_INSTRUMENTS[type(record)], record)])
        for group, use in uses:
            found.setdefault(group, []).append(use)
        if not uses:
            notes.append(Finding("warning", str(record.path), "feeds no figure of the paper"))
    if tests := found.get("isobaric"):
        lowest = min(test.stress for test in tests)
        found["upfr"] = [test for test in tests if test.stress - lowest < _SAME_STRESS]
        if len(found["upfr"]) == len(tests):
            del found["isobaric"]
    return {group: tuple(held) for group, held in found.items()}, notes


def _uses_of_bag(record: Record, parameters: Parameters) -> list[tuple[str, object]]:
    """Groups that a bag belongs to, each with the record in the form that is used there."""
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    if moves(record, parameters):
        return [("composite", record)] if len(driven) > 1 else []
    if pulls := tensile_tests(record, parameters):
        return [("tensile", test) for test in pulls]
    uses: list[tuple[str, object]] = []
    if is_clamped_wire(record):
        uses.append(("clamped", record))
    elif holds_frame(record, parameters):
        with suppress(InputError):
            uses += [("isobaric", test) for test in isobaric_tests(record, parameters)]
    drives: Sequence[Any] = ()
    with suppress(InputError):
        drives = find_drives(record) if len(driven) == 1 else ()
    if any(drive.is_staircase for drive in drives):
        uses.append(("thermal", record))
    elif drives and has_samples(record, temperature := f"{driven[0]}.temperature"):
        hottest = float(np.nanmax(record[temperature].values))
        cold = hottest < parameters["wire.austenite_start_temperature"]
        is_ramp = any(drive.segments.ramps for drive in drives)
        uses.append(("thermal" if is_ramp and cold else "validation", record))
    return uses


def identify_lab(records: LabRecords, parameters: Parameters, *,
                 synthetic: bool) -> tuple[dict[str, ExperimentResults], list[Finding]]:
    """Run all experiments that these records allow. Returns outcomes by kind (of KINDS), and why
    others are missing."""
    found, notes = dict[str, ExperimentResults](), list[Finding]()
    for group, kinds in KINDS.items():
        if not records.get(group):
            continue
        known = _identified(parameters, found.values()) if group == "tensile" else parameters
        try:
            result = identify(records[group], known)
        except InputError as error:
            notes.append(Finding("warning", ", ".join(kinds), str(error)))
            continue
        if group == "thermal":
            notes.extend(note for note in result.notes if note.severity != "info")
        for kind in kinds:
            mine = tuple(e for e in result.experiments if e.name == kind.partition(" ")[0])
            estimates = {name: e for one in mine for name, e in one.estimates.items()}
            if group == "thermal":  # joined over the records
                estimates = {name: result.estimates[name] for name in estimates}
            if mine:
                found[kind] = ExperimentResults(mine, estimates, synthetic)
    return found, notes


def _identified(parameters: Parameters, outcomes: Iterable[ExperimentResults]) -> Parameters:
    """The given parameters updated with the estimates of the outcomes."""
    estimates = {name: e for outcome in outcomes for name, e in outcome.estimates.items()}
    values = {name: e.value for name, e in estimates.items()}
    return parameters.replace(values, {n: e.std for n, e in estimates.items()}, "identified")


def _synthetic_outcomes(paper: Parameters, measured: Mapping[str, ExperimentResults],
                        report: Report) -> dict[str, ExperimentResults]:
    """Outcomes of the kinds of experiment that measured records did not give."""
    groups = [g for g, kinds in KINDS.items() if not measured.keys() >= {*kinds}]
    found: dict[str, ExperimentResults] = {}
    for group in in_turn(groups, report, lambda name: f"{name} experiments"):
        found |= identify_lab({group: papers_records(group, paper)}, paper, synthetic=True)[0]
    return {kind: outcome for kind, outcome in found.items() if kind not in measured}


def _validation(records: LabRecords, parameters: Parameters,
                outcomes: Mapping[str, ExperimentResults], notes: list[Finding], *,
                synthetic: bool = False) -> Picture | None:
    """Fig. 6, simulated with parameters identified from data of the same origin."""
    if not records.get("validation"):
        return None
    alike = [outcomes[k] for k in THERMAL if k in outcomes and outcomes[k].synthetic == synthetic]
    record = records["validation"][0]
    channel = next(c for c in record.channels if f"{c}.voltage" in record.signals)
    wire = wire_rig(_identified(parameters, alike))
    try:
        return validation_picture(record, wire.replace({"bench.channels": (channel,)}))
    except InputError as error:
        notes.append(Finding("warning", "E4", str(error)))
        return None


def _runs(records: LabRecords, rig: Parameters, notes: list[Finding]) -> list[CompositeRun]:
    found = []
    for record in records.get("composite", ()):
        try:
            found.append(composite_run(record, rig))
        except InputError as error:
            notes.append(Finding("warning", "E12", str(error)))
    return found
