"""Every command's help ends in examples that its own parser takes; errors, colours, JSON."""

import json
import shlex
import subprocess
import sys

import pytest
from test_documented_commands import check_command

from sma_bench.cli import COMMANDS, main

ESCAPE = "\x1b"
PRINT_NO_RESULT = {"run", "dashboard", "example"}


def help_of(name, capsys):
    assert main([name, "--help"]) == 0
    return capsys.readouterr().out


def examples(text):
    """Command lines below `examples:`, without the program and what the shell takes."""
    lines = text.partition("\nexamples:\n")[2].splitlines()
    shown = [line.strip() for line in lines if line.startswith("  sma-bench ")]
    return [shlex.split(line.partition(">")[0])[1:] for line in shown]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_that_the_command_takes(name, capsys):
    text = help_of(name, capsys)
    assert name in PRINT_NO_RESULT or "--json" in text
    shown = examples(text)
    assert shown, f"no examples in the help of {name}"
    for words in shown:
        assert words[0] == name and check_command(words) == "", words


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["identfy", "x"], "did you mean identify?"),
        (["identify"], "RECORD"),
        (["simulate", "--rate", "fast"], "'--rate': 'fast'"),
        (["audit", "--nothing"], "unknown option --nothing"),
        (["simulate", "--out", "x"], "--protocol or --input"),
        (["linearise", "--deflection", "-0.01", "--voltage", "1"], "--deflection and --voltage"),
        (["completion", "bash"], "_SMA_BENCH_COMPLETE"),
        (["blind", "run"], "./bench blind"),
        (["--nothing"], "--help"),
        (["identify", "bag", "--parms", "lab.yaml"], "did you mean --params?"),
        (["simulate", "--protokol", "ramp", "--out", "bag"], "did you mean --protocol?"),
        (["simulate", "--protocol", "quick_stairs", "--out", "bag"],
         "did you mean quick_staircase?"),
        (["info", "nothing.bag"], "nothing.bag"),
        (["run", "simulater"], "simulator"),
        (["call", "experiment/start", "--patience", "0"], "expected more than 0"),
        (["call", "experiment"], "expected NODE/SERVICE"),
        (["call", "exp riment/start"], "no ROS name"),
        (["audit", "--set", "wire.resistance"], "expected NAME=VALUE"),
        (["audit", "--set", "wire.resistence=2.7"], "did you mean wire.resistance?"),
        (["audit", "--set", "wire.resistance=2.7 ohm"], "expected a number in ohm"),
        (["audit", "--set", "wire.resistance=.nan"], "finite"),
        (["audit", "--set", "environment.ambient_temperature=23.0"], "degrees Celsius"),
        (["audit", "--json", "-", "--set", "wire.resistance=x"], "wire.resistance"),
    ],
)  # fmt: skip
def test_a_mistyped_command_line_is_one_line(words, said, capsys):
    assert main(words) == 2
    printed = capsys.readouterr()
    assert said in printed.err and printed.err.count("\n") == 1
    assert printed.err.startswith("sma-bench: ") and printed.out == ""


def test_a_terminal_gets_colours(capsys, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert main(["audit"]) == 0
    assert ESCAPE in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--json"], ["--json", "-"]])
def test_without_a_file_it_is_all_there_is_on_standard_output(words, capsys):
    assert main(["audit", *words]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["findings"]
    assert "checks found a clash" in printed.err


def test_parameters_as_json_are_the_table(tmp_path, capsys):
    target = tmp_path / "p.json"
    words = ["parameters", "--set", "wire.resistance=2.8", "--json", str(target)]
    assert main(words) == 0
    entries = {entry["name"]: entry for entry in json.loads(target.read_text())["parameters"]}
    assert entries["wire.resistance"]["value"] == 2.8
    assert entries["wire.resistance"]["unit"] == "ohm"
    assert entries["wire.resistance"]["std"] > 0.0
    assert entries["bench.channels"]["value"] == ["wire"]


def test_a_simulation_as_json_says_what_was_simulated_and_where_its_bag_is(tmp_path, capsys):
    bag = tmp_path / "bag"
    words = ["simulate", "--protocol", "ramp", "--rate", "10", "--noise", "3",
             "--effect", "latent_heat=12e3", "--out", str(bag), "--json"]  # fmt: skip
    assert main(words) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["bag"] == str(bag) and "simulated samples" in printed.err
    assert found["protocol"] == "ramp" and found["noise_seed"] == 3
    assert found["effects"] == ["latent_heat=12e3"]
    assert found["signals"]["wire.temperature"] == "K"
    assert found["samples"] == pytest.approx(10.0 * found["duration"], abs=2)


def test_help_loads_nothing_heavy():
    """It is there in a moment, of every command."""
    code = (
        "import contextlib, io, sys\n"
        "from sma_bench.cli import COMMANDS, load_command, main\n"
        "for words in [[c] for c in COMMANDS]:\n"
        "    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "        main([*words, '--help'])\n"
        "print(sorted({'scipy', 'numba', 'matplotlib', 'rclpy'} & set(sys.modules)))"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout.strip() == "[]", process.stderr
