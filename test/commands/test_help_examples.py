"""Every command's help ends in examples that its own parser accepts; shell completion; JSON; tables
fit the terminal."""

import json
import shlex
import subprocess
import sys

import pytest
from rich.cells import cell_len
from test_documented_commands import check_command

from sma_bench.cli import COMMANDS, load_command, main
from sma_bench.commands.terminal import print_table
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.report.tables import Table

PRINT_NO_RESULT = {"run", "dashboard", "example"}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_that_the_command_takes(name, capsys):
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "None]" not in text  # every number has a range
    assert name in PRINT_NO_RESULT or "--json" in text
    lines = [line.strip() for line in text.partition("\nexamples:\n")[2].splitlines()]
    shown = [shlex.split(line.partition(">")[0]) for line in lines if "sma-bench " in line[:10]]
    assert shown, f"no examples in the help of {name}"
    for _, *words in shown:
        assert words[0] == name and check_command(words) == "", words


def test_with_json_on_standard_output_there_is_nothing_else(tmp_path, capsys):
    for words in (["--json"], ["--json", "-"]):
        assert main(["audit", *words]) == 0
        printed = capsys.readouterr()
        assert json.loads(printed.out)["findings"] and "checks found a clash" in printed.err
    target, bag = tmp_path / "p.json", tmp_path / "bag"
    assert main(["parameters", "--set", "wire.resistance=2.8", "--json", str(target)]) == 0
    entries = {entry["name"]: entry for entry in json.loads(target.read_text())["parameters"]}
    sources = [entries[f"wire.{n}"]["source"] for n in ("resistance", "diameter")]
    assert entries["wire.resistance"]["value"] == 2.8 and sources == ["given", "section II.B"]
    assert entries["bench.channels"]["value"] == ["wire"]
    capsys.readouterr()
    line = f"simulate --protocol ramp --rate 10 --noise 3 --effect latent_heat=12e3 --out {bag}"
    assert main([*line.split(), "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    known = {"bag": str(bag), "protocol": "ramp", "noise_seed": 3, "effects": ["latent_heat=12e3"]}
    assert known.items() <= found.items() and "simulated samples" in printed.err
    assert found["samples"] == pytest.approx(10.0 * found["duration"], abs=2)


@pytest.mark.parametrize("columns", ["80", "40"])
def test_tables_fit_the_terminal_and_names_are_not_folded(columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    for command, names in (("effects", EFFECTS), ("parameters", BY_NAME), ("audit", ())):
        assert main([command]) == 0
        out = capsys.readouterr().out
        assert max(cell_len(line.rstrip()) for line in out.splitlines()) <= int(columns)
        if columns == "80":
            assert [name for name in names if len(name) <= 36 and name not in out] == []


def test_a_wide_table_is_printed_in_parts_with_whole_names_and_a_number_a_line(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    numbers = ["austenite_change = -0.1169 ± 0.0058", "hump = -0.0323 ± 0.0068"]
    names = ["phase_dependent_resistance", "temperature_dependent_convection"]
    header = ("candidate", "stage", "probability", "gap over noise", "nats", "numbers")
    row = (" + ".join(names), "electrical+thermal", "0.614", "3.86", "+2132.0", "; ".join(numbers))
    print_table(Table(header, [row], frozenset({2, 3, 4})))
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert max(map(cell_len, lines)) <= 80
    assert all(any(part in line for line in lines) for part in [*names, *numbers, row[1]])


HELP = """
import contextlib, io, sys
from sma_bench.cli import COMMANDS, load_command, main
from sma_bench.commands.terminal import print_table
from sma_bench.parameters.node_tables import NODE_TABLES
for command in COMMANDS:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main([command, "--help"])
print(sorted({"scipy", "numba", "matplotlib", "rclpy"} & set(sys.modules)))
"""


def test_help_loads_nothing_heavy():
    """So the help of every command appears at once."""
    process = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True)
    assert process.stdout.strip() == "[]", process.stderr


@pytest.mark.parametrize(("line", "offered"), [
    ("", list(COMMANDS)), ("di", ["diagnose"]), ("identify --exp", ["--experiment"]),
    ("identify --experiment E1", ["E1", "E10"]), ("identify my_", ["my_"]),
    ("identify my_bag --params ", ["FILE"]), ("diagnose --signals de", ["deflection"]),
    ("simulate --protocol composite_tri", ["composite_triangle"]),
    ("simulate --effect ", list(EFFECTS)), ("audit --set wire.res", ["wire.resistance"]),
    ("run ", list(NODE_TABLES)), ("calibrate supp", ["supply"]),
])  # fmt: skip
def test_shell_completion_offers_valid_words(line, offered, monkeypatch, capsys):
    words = line.split(" ")
    monkeypatch.setenv("_SMA_BENCH_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("COMP_WORDS", " ".join(["sma-bench", *words]))
    with pytest.raises(SystemExit):
        main([])
    shown = capsys.readouterr()
    assert shown.err == ""
    # Files are completed by the shell itself.
    assert [line.partition(",")[2] or "FILE" for line in shown.out.splitlines()] == offered


def parsed(*words):
    return load_command(words[0]).make_context(words[0], list(words[1:])).params


def test_several_values_follow_one_option_or_repeated_ones():
    wanted = ("a", "b")
    for words in (["--hold-out", "a", "b"], ["--hold-out", "a", "--hold-out", "b"]):
        found = parsed("diagnose", "bag", *words, "--params", "lab.yaml")
        assert found["hold_out"] == wanted and found["records"] == ("bag",)
    assert parsed("linearise", "--voltage", "-1", "2.5", "-3")["voltage"] == (-1.0, 2.5, -3.0)
    # Everything after --ros-args is for ROS.
    found = parsed("call", "a/b", "--json", "--ros-args", "-p", "x:=a b", "--set", "y")
    assert found["json"] == "-" and found["settings"] == ()
    assert found["ros_args"] == "-p 'x:=a b' --set y"
