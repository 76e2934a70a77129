"""Are the heaters switched off when something fails? Every fault on the emulated bench, as a table.

The real firmware on an emulated Uno, the real serial_bridge node, and a wire at the pins; for
faults that concern them also ir_camera, its synthetic camera and the recorder. For each fault: how
long the outputs stayed on, measured at the pins by the Uno's clock, and the cause that the bench
reported. Five minutes in real time; on a busy computer the bridge reacts late, the device does not.

    ./bench check faults [-k NAME]
"""

from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = "test/nodes/test_bridge_faults.py::test_outputs_go_to_zero_in_time_and_the_cause_is_shown"
ROW = "{:48.48} {:>10} {:>9}  {:5} {}"


class FaultTable:
    """Prints a line for every fault."""

    tried = failed = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called three times for each test: for its setup, call and teardown."""
        if report.failed or (report.skipped and report.when == "setup"):
            self.failed += 1
            print(ROW.format(report.nodeid.split("[")[-1].rstrip("]"), "", "", "FAIL", ""))
            crash = getattr(report.longrepr, "reprcrash", None)
            print(crash.message if crash else str(report.longrepr).strip().splitlines()[-1])
        found = dict(report.user_properties)
        if report.when == "call" and "hazard" in found:
            again = report.outcome == "rerun"
            self.tried += not again
            word = "ok" if report.passed else "again" if again else "FAIL"
            limit, measured = (f"{1e3 * found[key]:.0f} ms" for key in ("limit", "measured"))
            print(ROW.format(found["hazard"], limit, measured, word, found["told"]), flush=True)


def main(arguments: Sequence[str]) -> int:
    """0 if the outputs went to 0 V in time at every fault."""
    print(ROW.format("fault", "off within", "measured", "", "reported"))
    table = FaultTable()
    options = ["-q", "-s", "--acceptance", "-p", "no:terminalreporter", "--rootdir", str(ROOT)]
    status = pytest.main([*options, str(ROOT / TESTS), *arguments], plugins=[table])
    print(f"{table.tried - table.failed} of {table.tried} faults ended with outputs at 0 V in time")
    return 0 if status == 0 and table.tried and not table.failed else 1
