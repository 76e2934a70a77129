"""sma-bench diagnose: files, tables that show whole names, and one line for bad input."""

import json

import numpy as np
import pytest
from planted import ONE_WIRE, believed, few_effects, supply_drop_lab

from sma_bench.cli import main
from sma_bench.parameters import read_parameters
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = supply_drop_lab(tmp_path_factory.mktemp("lab"))
    time = np.arange(0.0, 5.0, 0.02)
    write_record(folder / "mute", [Signal("wire.temperature", "K", time, 300.0 + 0.0 * time)])
    write_record(folder / "lonely", [Signal("wire.voltage", "V", time, 1.0 + 0.0 * time)])
    return folder


def test_a_diagnosis_prints_the_argument_and_writes_every_file(lab, tmp_path, capsys):
    files = {name: tmp_path / name for name in ("gap.json", "improved.yaml", "page")}
    outputs = [*zip(("--json", "--out", "--report"), map(str, files.values()), strict=True)]
    words = ["diagnose", f"{lab}/bag", "--params", f"{lab}/lab.yaml"]
    with few_effects():
        status = main([*words, *(word for pair in outputs for word in pair)])
    out = capsys.readouterr().out
    assert status == 0
    assert out.startswith("supply_drop explains the gap (probability ")
    assert "…" not in out
    assert f"report {files['page'] / 'index.html'}" in out
    found = json.loads(files["gap.json"].read_text())
    assert found["cause"] == ["supply_drop"]
    assert "What next?" in (files["page"] / "index.html").read_text()
    improved = read_parameters(files["improved.yaml"])
    assert improved["effect.supply_drop.resistance"] == pytest.approx(0.3, abs=0.05)
    assert improved.given >= believed().replace(ONE_WIRE).given


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no_such_bag"], "no_such_bag"),
        (["bag", "--hold-out", "no_such_bag"], "no_such_bag"),
        (["mute"], "voltage"),
        (["lonely"], "lonely"),
        (["bag", "--params", "no.yaml"], "no.yaml"),
        (["bag", "--set", "wire.colour=3"], "wire.colour"),
        (["bag", "--set", "wire.resistance=-1.0"], "wire.resistance"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, words, lab, capsys, monkeypatch):
    monkeypatch.chdir(lab)
    given = [] if "--params" in arguments else ["--params", "lab.yaml"]
    assert main(["diagnose", *arguments, *given]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("sma-bench: ") and words in line
