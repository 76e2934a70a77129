"""The checks of the emulated bench that are scripts: they find what they look for."""

import numpy as np
import pytest
from uno import emulated_uno

from examination.check import fuzz, hardware, table_one
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

TRUTH = Parameters.defaults()


def test_numbers_hold_within_three_stated_errors_and_only_when_all_are_there():
    for std, factors, right in (
        (0.01, {}, True),
        (0.01, {"R": 1.029, "h": 0.971}, True),
        (0.01, {"c_p": 1.031}, False),
        (0.01, {"c_p": 0.0}, False),
        (0.101, {}, False),  # a large stated error excuses nothing
    ):
        found = {
            name: {
                "value": TRUTH[name] * factors.get(symbol, 1.0),
                "std": std * TRUTH[name],
                "statistical": std * TRUTH[name],
            }
            for name, symbol in hardware.TABLE_ONE.items()
            if factors.get(symbol, 1.0)
        }
        assert hardware.right(found, TRUTH) == right


def test_without_the_tools_or_a_firmware_that_compiles_it_is_one_line(
    firmware_image, tmp_path, monkeypatch, capsys
):
    with pytest.raises(InputError, match="^make: [^\n]+$"):
        emulated_uno.build_firmware(tmp_path, "-DCOMMAND_TIMEOUT_MS=0")
    monkeypatch.setattr(emulated_uno.shutil, "which", lambda name: None)
    assert hardware.main([]) == 2
    error = capsys.readouterr().err
    assert "gcc-avr" in error and error.count("\n") == 1


@pytest.mark.acceptance
def test_a_wire_is_identified_over_a_serial_port_and_through_a_camera(emulator, tmp_path, capfd):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    status = hardware.main(["--out", str(tmp_path / "bench")])
    said = capfd.readouterr()
    assert status == 0, said.out + said.err
    assert (tmp_path / "bench" / "identified.yaml").is_file()


def test_fuzzing_tells_a_part_that_failed(tmp_path):
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\necho 'input 7: driven in silence' >&2; exit 134\n")
    program.chmod(0o755)
    assert fuzz.fuzzed(program, 10, 5) == ((0, 0, 0), "seed 5: input 7: driven in silence")


@pytest.mark.acceptance
def test_stated_errors_hold_behind_firmware_and_camera(emulator, firmware_image, tmp_path):
    row = table_one.one_wire(emulator, firmware_image, 11, tmp_path)
    assert set(row) == set(hardware.TABLE_ONE)
    z = np.array([found["z"] for found in row.values()])
    assert (np.abs(z) <= hardware.SIGMAS).all()
    assert all(found["std"] < hardware.LARGEST_ERROR * found["value"] for found in row.values())
