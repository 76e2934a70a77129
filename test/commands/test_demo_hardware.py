"""sma-bench demo --hardware: refused in one line without its tools, right with them."""

import pytest
from rich.console import Console

from sma_bench.cli import main
from sma_bench.commands import demo_acts
from sma_bench.commands.demo_acts import EMULATED, promise_holds
from sma_bench.commands.demo_stage import retried
from sma_bench.emulation import emulated_uno
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

TRUTH = Parameters.defaults()


def estimates(relative_std=0.01, **factors):
    """Table I, but for factors of its symbols; a factor of 0 leaves it out."""
    return {
        name: {"value": TRUTH[name] * factors.get(symbol, 1.0), "std": relative_std * TRUTH[name],
               "statistical": relative_std * TRUTH[name]}
        for name, symbol in demo_acts.TABLE_ONE.items()
        if factors.get(symbol, 1.0)
    }


def test_without_the_tools_it_says_which_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(emulated_uno.shutil, "which", lambda name: None)
    assert main(["demo", "--hardware", "--out", str(tmp_path / "demo")]) == 2
    error = capsys.readouterr().err
    assert "the emulated Uno needs the Debian packages gcc-avr" in error
    assert error.count("\n") == 1


def test_a_uno_cannot_be_built_without_the_tools_either(tmp_path, monkeypatch):
    monkeypatch.setattr(emulated_uno.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="needs the Debian packages"):
        emulated_uno.build_uno(tmp_path)


def test_firmware_that_does_not_compile_is_one_line(firmware_image, tmp_path):
    with pytest.raises(InputError, match="^make: [^\n]+$"):
        emulated_uno.build_firmware(tmp_path, "-DCOMMAND_TIMEOUT_MS=0")


def test_numbers_hold_within_three_stated_errors_and_only_when_all_are_there():
    assert promise_holds(EMULATED, estimates(), TRUTH)
    assert promise_holds(EMULATED, estimates(R=1.029, h=0.971), TRUTH)
    assert not promise_holds(EMULATED, estimates(c_p=1.031), TRUTH)
    assert not promise_holds(EMULATED, estimates(0.001, R=1.004), TRUTH)
    assert not promise_holds(EMULATED, estimates(c_p=0.0), TRUTH)


def test_a_large_stated_error_excuses_nothing():
    assert promise_holds(EMULATED, estimates(0.099), TRUTH)
    assert not promise_holds(EMULATED, estimates(0.101), TRUTH)


def test_the_table_shows_the_deviation_in_stated_errors():
    console = Console(record=True, width=120)
    demo_acts._print_hardware_table(console, estimates(0.01, R=1.025), TRUTH)
    row = next(line for line in console.export_text().splitlines() if line.startswith("R "))
    assert row.split()[-2:] == ["+2.50%", "+2.50"]


def test_a_call_is_retried_until_it_succeeds_or_patience_ends():
    answers = [InputError("not yet"), InputError("not yet"), "ready"]

    def call():
        answer = answers.pop(0)
        if isinstance(answer, InputError):
            raise answer
        return answer

    assert retried(call, 5.0, 0.001) == "ready"
    answers[:] = [InputError("never")] * 1000
    with pytest.raises(InputError, match="never"):
        retried(call, 0.02, 0.001)


@pytest.mark.acceptance
def test_a_wire_is_identified_over_a_serial_port_and_through_a_camera(emulator, tmp_path, capfd):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    out = tmp_path / "demo"
    status = main(["demo", "--hardware", "--out", str(out)])
    said = capfd.readouterr()
    assert status == 0, said.out + said.err
    assert "within 3 standard errors of the truth, statistical errors under 10%: yes" in said.out
    assert (out / "identified.yaml").is_file()
