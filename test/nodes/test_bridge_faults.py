"""Every fault of the list ends with outputs at 0 V, in time, and with its cause reported."""

import re
from pathlib import Path

import pytest
from emulated_rig import bridged_rig
from faults import FAULTS, Fault

# s beside the limit of what a host has to notice: it shares the machine with the emulator, and
# with others.
LOADED = 0.5
MARKED = [
    pytest.param(fault, id=fault.name, marks=[] if fault.quick else pytest.mark.acceptance)
    for fault in FAULTS
]


@pytest.mark.parametrize("fault", MARKED)
def test_outputs_go_to_zero_in_time_and_the_cause_is_told(bench, uno, fault, record_property):
    causes = fault.cause.split("|")
    with bridged_rig(bench, uno, camera=fault.camera, **fault.settings) as rig:
        if "temperature" not in fault.settings.get("feedback", ["temperature"]):
            rig.fever = None
        rig.enable()
        rig.drive(fault.volts)
        moment = fault.make(rig)
        if fault.told is Fault.told:  # outputs may pause before, where a machine is busy
            rig.until(lambda: any(cause in rig.state for cause in causes))
        measured = rig.off_after(moment)
        told = fault.told(rig)
    record_property("hazard", fault.hazard)
    record_property("limit", fault.limit)
    record_property("measured", measured)
    record_property("told", told)
    assert measured < fault.limit + (LOADED if fault.by_host else 0.0)
    assert any(cause in told for cause in causes), told


def test_the_page_has_every_fault_and_no_other():
    page = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
    section = page.read_text().partition("## Each fault")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.endswith("` |")]
    assert rows == [fault.row for fault in FAULTS]


def single_failures():
    """Rows of the page's table of single failures, as lists of cells."""
    page = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
    section = page.read_text().partition("## Single failures")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


def test_every_single_failure_says_what_cuts_it_and_where_that_is_shown():
    tests = "".join(path.read_text() for path in Path(__file__).parents[1].rglob("test_*.py"))
    shown = {fault.name for fault in FAULTS} | set(re.findall(r"def (test_\w+)", tests))
    rows = single_failures()
    assert len(rows) > 20
    for failure, _, _, _, _, cut_by, shown_by in rows:
        assert cut_by.startswith(("software", "hardware only", "nothing")), failure
        names = re.findall(r"`(\w+)`", shown_by)
        assert set(names) <= shown, failure
        assert names or not cut_by.startswith("software"), failure
    placed = {name for row in rows for name in re.findall(r"`(\w+)`", row[-1])}
    assert {fault.name for fault in FAULTS} - placed <= {"host_ended", "stop_requested"}
