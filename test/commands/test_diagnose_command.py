"""sma-bench diagnose: files, and tables that show whole names."""

import json

import pytest
from planted import ONE_WIRE, believed, few_effects, supply_drop_lab

from sma_bench.cli import main
from sma_bench.parameters import read_parameters

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")


def test_a_diagnosis_prints_the_argument_and_writes_every_file(tmp_path, capsys):
    lab = supply_drop_lab(tmp_path)
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
