"""--json everywhere: into a file, or alone on standard output."""

import argparse
import importlib
import json

import pytest

from sma_bench.cli import COMMANDS, main

PRINT_NO_RESULT = {"run", "completion", "dashboard"}
WITH_RESULT = {
    name: importlib.import_module(f"sma_bench.commands.{name}").add_arguments
    for name in COMMANDS if name not in PRINT_NO_RESULT
}


@pytest.mark.parametrize("name", WITH_RESULT)
def test_every_command_with_a_result_takes_json(name):
    parser = argparse.ArgumentParser()
    WITH_RESULT[name](parser)
    (json_option,) = [a for a in parser._actions if "--json" in a.option_strings]
    assert json_option.nargs == "?" and json_option.const == "-"


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
