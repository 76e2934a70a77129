"""The firmware's C logic on this computer, under sanitizers."""

import re
from pathlib import Path

import pytest
from host_firmware import run_program

HERE = Path(__file__).resolve().parent
NAMES = re.findall(r"^TEST\((\w+)\)$", (HERE / "host" / "test_logic.c").read_text(), re.M)


def test_every_logic_test_is_run(logic_tests: Path) -> None:
    assert len(NAMES) > 40 and run_program(logic_tests, "--list").stdout.split() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_logic(logic_tests: Path, name: str) -> None:
    outcome = run_program(logic_tests, name)
    assert outcome.returncode == 0, outcome.stderr


@pytest.mark.parametrize("seed", [1, 2])
def test_hostile_bytes_neither_crash_nor_drive(fuzzer: Path, seed: int) -> None:
    outcome = run_program(fuzzer, "60000", str(seed))
    assert outcome.returncode == 0, outcome.stderr
    executed, drove_on, stopped = map(int, re.findall(r"\d+", outcome.stdout))
    assert executed == 60000
    # The armed inputs reach both ends, or the fuzzer proves nothing.
    assert drove_on > 1000
    assert stopped > 1000
