"""No file is lost by accident: no command replaces one without --force, and never an input."""

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml

from sma_bench import border
from sma_bench.cli import COMMANDS, load_command, main
from sma_bench.commands.options import BAG, FILE, FOLDER, NEW, OWN, Output

PARAMETERS = [
    (name, parameter)
    for name in COMMANDS
    if name != "run"
    for parameter in load_command(name).params
    if isinstance(parameter, click.Option)
]
GIVEN = yaml.safe_load(Path(__file__).with_name("outputs.yaml").read_text())
WORDS, READ = GIVEN["words"], set(GIVEN["read"])


def outputs(*kinds, reading=False):
    """(command, option, kind) of every output; `reading`: only of commands that read a file."""
    return [
        (name, option.opts[0], option.type.kind)
        for name, option in PARAMETERS
        if isinstance(option.type, Output) and option.type.kind in kinds
        if "IN" in WORDS[name] or not reading
    ]


def words_for(name, option, target, given):
    words = WORDS[name].split()
    if option in words:
        words[words.index(option) + 1] = str(target)
    else:
        words += [option, str(target)]
    places = {"IN": str(given), "OUT": str(given) + "_elsewhere"}
    return [name, *(places.get(word, word) for word in words)]


def content(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def lab(tmp_path):
    """A file, a folder that looks like a bag, and a link: none may be lost."""
    (tmp_path / "given.csv").write_text("1,2\n")
    (tmp_path / "linked.csv").symlink_to(tmp_path / "given.csv")
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / "precious" / "run.mcap").write_bytes(b"samples")
    return tmp_path


@pytest.fixture
def refused(capsys):
    """Runs a command that must be refused in one line, and returns the line."""

    def run(*words):
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        (error,) = capsys.readouterr().err.splitlines()
        return error

    return run


def test_every_option_that_names_what_is_written_is_declared():
    undeclared = [
        (name, option.opts[0])
        for name, option in PARAMETERS
        if str(option.metavar).removesuffix(" ...").endswith(("FILE", "DIR", "BAG", ".yaml"))
        if not isinstance(option.type, Output) and not READ.intersection(option.opts)
    ]
    assert undeclared == []
    assert {name for name, option in PARAMETERS if isinstance(option.type, Output)} >= {
        *("identify", "simulate", "diagnose", "import", "report", "paper", "parameters", "demo"),
        *("batch", "calibrate"),
    }


@pytest.mark.parametrize(("name", "option", "kind"), outputs(FILE, FOLDER, BAG, NEW))
def test_existing_outputs_are_not_replaced(name, option, kind, lab, refused):
    target = lab / "given.csv" if kind == FILE else lab / "precious"
    other = lab / "other.csv"
    other.write_text("1,2\n")
    before = content(lab)
    said = refused(*words_for(name, option, target, other))
    assert "exists already" in said and ("--force replaces it" in said) == (kind != NEW)
    assert content(lab) == before


def test_of_two_commands_that_write_one_path_at_once_the_second_is_refused(lab, refused):
    writes = f"""
import sys
from sma_bench.commands import terminal
terminal.write_json = lambda *_: (print("at it", flush=True), sys.stdin.read())
from sma_bench.cli import main
main(["effects", "--json", {str(lab / "new.json")!r}])
"""
    command, pipe = [sys.executable, "-c", writes], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as first:
        assert first.stdout.readline() == "at it\n"
        said = refused("effects", "--json", lab / ".." / lab.name / "new.json")
        assert f"new.json is being written already: process {first.pid}" in said
    assert main(["effects", "--json", str(lab / "new.json")]) == 0


@pytest.mark.parametrize(("name", "option", "kind"), outputs(FILE, FOLDER, BAG, NEW, OWN))
def test_no_command_writes_what_another_is_writing(name, option, kind, lab, refused, monkeypatch):
    monkeypatch.setattr(border, "_STILL_HELD", 0.0)
    before, words = content(lab), words_for(name, option, lab / "shared", lab / "given.csv")
    with border.claimed(str(lab / "shared"), "being written already"):
        assert f"shared is being written already: process {os.getpid()}" in refused(*words)
    assert content(lab) == before


@pytest.mark.parametrize(("name", "option", "kind"), outputs(FILE, FOLDER, BAG, reading=True))
def test_an_input_and_its_folder_are_not_replaced_even_by_force(name, option, kind, lab, refused):
    folder, before = lab / "precious", content(lab)
    pairs = [(lab / "given.csv", lab / "given.csv"), (lab / "linked.csv", lab / "given.csv")]
    if kind != FILE:
        pairs = [(folder, folder), (folder, folder / "run.mcap")]
    for target, given in pairs:
        said = refused(*words_for(name, option, target, given), "--force")
        assert "is an input or contains one" in said
    assert content(lab) == before


def test_a_part_of_an_input_two_of_one_name_and_one_among_several_are_refused(lab, refused):
    bag, tables = lab / "precious", [lab / f"{day}.csv" for day in ("monday", "tuesday")]
    for table in tables:
        table.write_text("time_s,voltage_V\n0,1\n1,2\n")
    for kept in ("week/tuesday", "results"):
        (lab / kept).mkdir(parents=True)
    (lab / "results" / "run.json").write_text("kept\n")
    (lab / "run").write_text("not read\n")
    before = content(lab)
    assert "an input" in refused("info", bag, "--json", bag / "metadata.yaml", "--force")
    said = refused("parameters", "--out", lab / "both", "--json", lab / "both")
    assert "given for --out and --json" in said
    said = refused("import", *tables, "--out", lab / "week")
    assert "tuesday: exists already" in said and not (lab / "week" / "monday").exists()
    said = refused("batch", "identify", lab / "run", "--out", lab / "results")
    assert "run.json: exists already" in said
    assert content(lab) == before


def test_force_replaces_files_and_bags_and_nothing_else(lab, refused):
    file, bag = lab / "given.csv", lab / "bag"
    assert main(["effects", "--json", str(file), "--force"]) == 0
    assert "latent_heat" in file.read_text()
    words = ["simulate", "--protocol", "ramp", "--rate", "10", "--out", str(bag)]
    assert main(words) == 0
    first = content(bag)
    refused(*words)
    assert content(bag) == first
    assert main([*words, "--force", "--noise", "1"]) == 0
    assert content(bag).keys() == first.keys() and content(bag) != first
    (bag / "metadata.yaml").unlink()
    next(bag.glob("*.mcap")).rename(bag / "thesis.txt")
    kept = content(bag)
    assert "is not a bag; --force replaces bags only" in refused(*words, "--force")
    assert content(bag) == kept
