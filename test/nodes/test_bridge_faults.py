"""Every fault of the list ends with outputs at 0 V, in time, and with its cause reported."""

from pathlib import Path

import pytest
from emulated_rig import bridged_rig
from faults import FAULTS

# s beside the limit of what a host has to notice: it shares the machine with the emulator, and
# with others.
LOADED = 0.5
MARKED = [
    pytest.param(fault, id=fault.name, marks=[] if fault.quick else pytest.mark.acceptance)
    for fault in FAULTS
]


@pytest.mark.parametrize("fault", MARKED)
def test_outputs_go_to_zero_in_time_and_the_cause_is_told(bench, uno, fault, record_property):
    with bridged_rig(bench, uno, camera=fault.camera, **fault.settings) as rig:
        if "temperature" not in fault.settings.get("feedback", ["temperature"]):
            rig.fever = None
        rig.enable()
        rig.drive(fault.volts)
        measured = rig.off_after(fault.make(rig))
        told = fault.told(rig)
    record_property("hazard", fault.hazard)
    record_property("limit", fault.limit)
    record_property("measured", measured)
    record_property("told", told)
    assert measured < fault.limit + (LOADED if fault.by_host else 0.0)
    assert fault.cause in told


def test_the_page_has_every_fault_and_no_other():
    page = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
    rows = [line for line in page.read_text().splitlines() if line.endswith("` |")]
    assert rows == [fault.row for fault in FAULTS]
