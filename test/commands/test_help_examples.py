"""Every command's help ends in examples that its own parser takes; errors, colours, JSON;
tables fit the terminal."""

import json
import shlex
import subprocess
import sys

import pytest
from rich.cells import cell_len
from test_documented_commands import check_command

from sma_bench.cli import COMMANDS, main
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS

ESCAPE = "\x1b"
PRINT_NO_RESULT = {"run", "dashboard", "example"}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_that_the_command_takes(name, capsys):
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert name in PRINT_NO_RESULT or "--json" in text
    lines = [line.strip() for line in text.partition("\nexamples:\n")[2].splitlines()]
    shown = [shlex.split(line.partition(">")[0]) for line in lines if "sma-bench " in line[:10]]
    assert shown, f"no examples in the help of {name}"
    for _, *words in shown:
        assert words[0] == name and check_command(words) == "", words


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("identfy x", "did you mean identify?"),
        ("identify", "RECORD"),
        ("simulate --rate fast", "'--rate': 'fast'"),
        ("audit --nothing", "unknown option --nothing"),
        ("simulate --out x", "--protocol or --input"),
        ("compare a b --column wide", "--column"),
        ("compare a b --font 8", "--column with it"),
        ("linearise --deflection -0.01 --voltage 1", "--deflection and --voltage"),
        ("completion bash", "_SMA_BENCH_COMPLETE"),
        ("blind run", "./bench blind"),
        ("--nothing", "--help"),
        ("identify bag --parms lab.yaml", "did you mean --params?"),
        ("simulate --protocol quick_stairs --out bag", "did you mean quick_staircase?"),
        ("info nothing.bag", "nothing.bag"),
        ("run simulater", "simulator"),
        ("call experiment/start --patience 0", "expected more than 0"),
        ("call experiment", "expected NODE/SERVICE"),
        ("call 'exp riment/start'", "no ROS name"),
        ("audit --set wire.resistance", "expected NAME=VALUE"),
        ("audit --set wire.resistence=2.7", "did you mean wire.resistance?"),
        ("audit --set 'wire.resistance=2.7 ohm'", "expected a number in ohm"),
        ("audit --set wire.resistance=.nan", "finite"),
        ("audit --set environment.ambient_temperature=23.0", "degrees Celsius"),
        ("audit --json - --set wire.resistance=x", "wire.resistance"),
    ],
)
def test_a_mistyped_command_line_is_one_line(line, said, capsys):
    assert main(shlex.split(line)) == 2
    printed = capsys.readouterr()
    assert said in printed.err and printed.err.count("\n") == 1
    assert printed.err.startswith("sma-bench: ") and printed.out == ""


def test_a_terminal_gets_colours(capsys, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert main(["audit"]) == 0
    assert ESCAPE in capsys.readouterr().out


def test_json_is_all_there_is_on_standard_output_unless_it_goes_to_a_file(tmp_path, capsys):
    for words in (["--json"], ["--json", "-"]):
        assert main(["audit", *words]) == 0
        printed = capsys.readouterr()
        assert json.loads(printed.out)["findings"] and "checks found a clash" in printed.err
    target, bag = tmp_path / "p.json", tmp_path / "bag"
    assert main(["parameters", "--set", "wire.resistance=2.8", "--json", str(target)]) == 0
    entries = {entry["name"]: entry for entry in json.loads(target.read_text())["parameters"]}
    resistance = entries["wire.resistance"]
    assert (resistance["value"], resistance["unit"]) == (2.8, "ohm") and resistance["std"] > 0.0
    assert entries["bench.channels"]["value"] == ["wire"]
    capsys.readouterr()
    line = f"simulate --protocol ramp --rate 10 --noise 3 --effect latent_heat=12e3 --out {bag}"
    assert main([*line.split(), "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["bag"] == str(bag) and "simulated samples" in printed.err
    assert found["protocol"] == "ramp" and found["noise_seed"] == 3
    assert found["effects"] == ["latent_heat=12e3"]
    assert found["signals"]["wire.temperature"] == "K"
    assert found["samples"] == pytest.approx(10.0 * found["duration"], abs=2)


@pytest.mark.parametrize("columns", ["80", "60", "40"])
@pytest.mark.parametrize("words", [["effects"], ["parameters"], ["audit"]])
def test_what_commands_print_fits_and_names_can_be_looked_up(words, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    assert main(words) == 0
    out = capsys.readouterr().out
    assert max(cell_len(line.rstrip()) for line in out.splitlines()) <= int(columns)
    names = {"effects": EFFECTS, "parameters": BY_NAME}.get(words[0], {})
    if columns == "80":
        assert [name for name in names if len(name) <= 36 and name not in out] == []


HELP = """
import contextlib, io, sys
from sma_bench.cli import COMMANDS, main
for command in COMMANDS:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main([command, "--help"])
print(sorted({"scipy", "numba", "matplotlib", "rclpy"} & set(sys.modules)))
"""


def test_help_loads_nothing_heavy():
    """It is there in a moment, of every command."""
    process = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True)
    assert process.stdout.strip() == "[]", process.stderr
