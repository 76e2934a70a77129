"""The checks of the emulated bench that are scripts: they find what they look for."""

from pathlib import Path

import numpy as np
import pytest

from examination.check import fuzz, table_one
from sma_bench.commands.demo_acts import EMULATED, TABLE_ONE


def program(folder: Path, text: str) -> Path:
    path = folder / "program"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_fuzzing_counts_what_was_survived(fuzzer: Path) -> None:
    (tried, drove_on, stopped), problem = fuzz.fuzzed(fuzzer, 3000, 1)
    assert problem == ""
    assert tried == 3000
    assert min(drove_on, stopped) > 50


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("echo 'input 7: driven in silence' >&2; exit 134", "seed 5: input 7: driven in silence"),
        ("kill -SEGV $$", "seed 5: crashed"),
        ("exec sleep 60", "seed 5: hangs"),
    ],
)
def test_fuzzing_tells_a_part_that_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, problem: str
) -> None:
    monkeypatch.setattr(fuzz, "LONGEST", 1.0)
    assert fuzz.fuzzed(program(tmp_path, text), 10, 5) == ((0, 0, 0), problem)


@pytest.mark.acceptance
def test_stated_errors_hold_behind_firmware_and_camera(
    emulator: Path, firmware_image: Path, tmp_path: Path
) -> None:
    row = table_one.one_wire(emulator, firmware_image, 11, tmp_path)
    assert set(row) == set(TABLE_ONE)
    z = np.array([found["z"] for found in row.values()])
    assert (np.abs(z) <= EMULATED.sigmas).all()
    assert all(found["std"] < EMULATED.relative_std * found["value"] for found in row.values())
