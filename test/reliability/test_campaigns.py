"""Sections of `./bench check reliability`, small: what they found once stays mended."""

import resource

import pytest

from examination.campaign import inputs
from sma_bench.cli import main


def failed(outcomes):
    return [f"{o.what}: {o.found}" for o in outcomes if not o.met]


@pytest.mark.parametrize(
    "words", ["simulate --protocol quick_ramp --out {}/bag", "parameters --out {}/good --force"]
)
def test_a_full_disk_costs_one_line_and_nothing_good(tmp_path, capsys, words):
    good, limits = tmp_path / "good", resource.getrlimit(resource.RLIMIT_FSIZE)
    good.write_text("good")
    main(words.replace("{}/", f"{tmp_path}/warm_").split())  # it compiles
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        status = main(words.replace("{}", str(tmp_path)).split())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    said = [line for line in capsys.readouterr().err.splitlines() if "cannot" in line]
    assert status == 2 and len(said) == 1 and good.read_text() == "good"
    left = {path.name for path in tmp_path.iterdir() if not path.name.startswith("warm")}
    assert left <= {"good", "bag"}


def test_parsers_take_anything(tmp_path):
    outcomes = inputs.edited_inputs(10, 1, tmp_path)
    assert len(outcomes) == len(inputs.parsers())
    assert failed(outcomes) == []
    # What edited inputs found: a single row of numbers, a rate of two points, names of two lines.
    found = {parser.name: parser for parser in inputs.parsers()}
    pyris, protocol = found["calorimeter, Pyris"], found["protocol"]
    metadata = found["metadata of a bag"]
    two_lines = metadata.good.replace(b"[bag", rb'["a\nb').replace(b".mcap]", b'.mcap"]')
    for parser, content in (
        (found["isobaric test"], b"20.0\t4.0\t99.0\n"),
        (pyris, pyris.good.replace(b"at 10.00", b"at 10.0.0")),
        (metadata, two_lines),
        (protocol, protocol.good.replace(b"name: heat", b'name: "a\\nb", rise: x')),
    ):
        assert inputs.try_input(parser, content, tmp_path) == ""


def test_well_formed_hostile_inputs_end_every_command_in_a_line_or_a_result(tmp_path):
    outcomes = inputs.hostile_inputs(8, 0, tmp_path)
    assert sum(outcome.tried for outcome in outcomes) == 8
    results = " ".join(outcome.found for outcome in outcomes)
    assert [command for command in inputs.FOR_ALL if f" {command}" not in results] == []
    assert failed(outcomes) == []


@pytest.mark.slow
def test_nodes_go_on_under_foreign_traffic(ros_domain, nodes_forked, tmp_path):
    from examination.campaign.nodes import foreign_traffic

    assert failed(foreign_traffic(5, 1, tmp_path)) == []


@pytest.mark.slow
def test_a_group_of_running_nodes_ends(ros_domain, monkeypatch):
    """For signals while a node starts see test_lifeline.py."""
    from examination.check import stops

    monkeypatch.setattr(stops, "LIMIT", 20.0)  # beside other tests; 3 s is the check's
    found = stops.stopped(2, 1, 3)
    assert len(found) == 3 and [one for one in found if one["wrong"]] == []
    assert all(one["ready"] for one in found)


@pytest.mark.parametrize("parser", inputs.parsers(), ids=lambda parser: parser.name)
def test_long_runs_of_one_sign_take_no_longer_than_their_length(parser, tmp_path):
    runs = (b"9" * 20_000 + b"x", b"x" + b" " * 20_000 + b"x", b"_" * 20_000, b"temperature" * 2000)
    for run in runs:
        for place in (0.02, 0.3, 0.8):
            content = inputs.edited(parser.good, [("insert", place, 1, run)])
            assert inputs.try_input(parser, content, tmp_path) == "", (run[:12], place)
