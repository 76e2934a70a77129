"""What the paper is redrawn from: synthetic records, and the user's sorted by what they feed."""

from collections.abc import Callable, Sequence

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.load_frame import holds_frame, is_clamped_wire, isobaric_tests
from sma_bench.identify.signals import find_drives
from sma_bench.identify.whole_model import bends
from sma_bench.parameters import Parameters
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.record import Record, has_samples
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.paper_page import LabRecords
from sma_bench.synthetic import paper_specimens as specimens

_SAME_STRESS = 5e6  # Pa


def synthetic_records(parameters: Parameters, groups: Sequence[str]) -> LabRecords:
    """Records of the simulated laboratory for these groups of LabRecords.

    Args:
        parameters: what the simulated wire and composite are made of.
    """
    make: dict[str, Callable[[], tuple[object, ...]]] = {
        "thermal": lambda: specimens.thermal_records(parameters),
        "validation": lambda: (specimens.validation_record(parameters),),
        "dsc": lambda: (specimens.dsc_record(parameters),),
        "upfr": lambda: specimens.upfr_records(parameters),
        "isobaric": lambda: specimens.isobaric_records(parameters),
        "tensile": lambda: specimens.tensile_records(parameters),
        "clamped": lambda: (specimens.clamped_record(parameters),),
        "composite": lambda: specimens.composite_records(parameters),
    }
    return LabRecords(**{group: make[group]() for group in groups})  # type: ignore[arg-type]


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
        (DscRecord, "dsc"), (IsobaricRecord, "isobaric"), (TensileRecord, "tensile"),
    ):
        if isinstance(record, kind):
            return [(group, record)]
    return _bag_uses(record, parameters) if isinstance(record, Record) else []


def _bag_uses(record: Record, parameters: Parameters) -> list[tuple[str, object]]:
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    if bends(record):
        return [("composite", record)] if len(driven) > 1 else []
    uses: list[tuple[str, object]] = []
    if is_clamped_wire(record):
        uses.append(("clamped", record))
    elif holds_frame(record):
        uses += [("isobaric", test) for test in _isobaric_tests(record, parameters)]
    if len(driven) == 1:
        uses += [(group, record) for group in _wire_group(record, driven[0], parameters)]
    return uses


def _isobaric_tests(record: Record, parameters: Parameters) -> tuple[IsobaricRecord, ...]:
    try:
        return isobaric_tests(record, parameters)
    except InputError:
        return ()


def _wire_group(record: Record, channel: str, parameters: Parameters) -> list[str]:
    try:
        drives = find_drives(record)
    except InputError:
        return []
    measured = has_samples(record, f"{channel}.temperature")
    is_staircase = any(drive.staircases for drive in drives)
    is_ramp = any(drive.segments.ramps for drive in drives)
    if is_staircase:
        return ["thermal"]
    if not measured:
        return []
    hottest = float(np.nanmax(record[f"{channel}.temperature"].values))
    if is_ramp and hottest < parameters["wire.austenite_start_temperature"]:
        return ["thermal"]
    return ["validation"]
