"""--json everywhere: into a file, or alone on standard output."""

import json

import pytest

from sma_bench.cli import COMMANDS, load_command, main

PRINT_NO_RESULT = {"run", "dashboard", "example"}


@pytest.mark.parametrize("name", [n for n in COMMANDS if n not in PRINT_NO_RESULT])
def test_every_command_with_a_result_takes_json(name):
    assert any("--json" in parameter.opts for parameter in load_command(name).params)


@pytest.mark.parametrize("words", [["--json"], ["--json", "-"]])
def test_without_a_file_it_is_all_there_is_on_standard_output(words, capsys):
    assert main(["audit", *words]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["findings"]
    assert "checks found a clash" in printed.err


def test_a_simulation_says_where_its_bag_is_beside_the_json(tmp_path, capsys):
    bag = tmp_path / "bag"
    words = ["simulate", "--protocol", "ramp", "--rate", "10", "--out", str(bag), "--json"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["bag"] == str(bag)
    assert "simulated samples" in printed.err


def test_an_error_leaves_standard_output_empty(capsys):
    assert main(["audit", "--json", "-", "--set", "wire.resistance=x"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
