"""The files of examples/ are what their maker writes, and `sma-bench example` hands them out."""

import re
import sys
from pathlib import Path

import pytest

from sma_bench.cli import main
from sma_bench.parameters import read_parameters

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples"))

import make  # noqa: E402

FOLDERS = sorted(path.parent for path in (ROOT / "examples").glob("*/lab.yaml"))


def test_the_tables_are_those_that_the_maker_writes(tmp_path, monkeypatch, capsys):
    """But for the last digit, which another machine may round the other way."""
    for folder in make.TABLES:
        (tmp_path / folder).mkdir()
    monkeypatch.setattr(make, "HERE", tmp_path)
    make.main()
    assert capsys.readouterr().out.count("synthetic") == sum(map(len, make.TABLES.values()))
    for path in tmp_path.rglob("*.*"):
        kept = (ROOT / "examples" / path.relative_to(tmp_path)).read_text()
        kept, made = (re.split(r"(-?\d+\.\d+)", text) for text in (kept, path.read_text()))
        assert made[::2] == kept[::2], path.name
        for new, old in zip(made[1::2], kept[1::2], strict=True):
            last_digit = 10.0 ** -len(old.partition(".")[2])
            assert float(new) == pytest.approx(float(old), abs=1.01 * last_digit), path.name


def test_examples_are_small_and_each_is_handed_out_as_a_folder_of_the_readers_own(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert len(FOLDERS) >= 4
    assert sum(path.stat().st_size for path in (ROOT / "examples").rglob("*.*")) < 500_000
    assert main(["example"]) == 0
    assert "ten_tasks: lab.yaml, run.csv" in capsys.readouterr().out
    # One that is not there is one line with the nearest.
    assert main(["example", "ten_task"]) == 2
    assert "ten_tasks" in capsys.readouterr().err
    for source in [*FOLDERS, ROOT / "config" / "wire_rig.yaml"]:
        name = source.stem
        assert main(["example", name]) == 0
        made = {path.name: path.read_text() for path in Path(name).iterdir()}
        given = source.iterdir() if source.is_dir() else [source]
        assert sorted(made.values()) == sorted(path.read_text() for path in given)
        assert "wire.resistance" in read_parameters(Path(name, "lab.yaml"))
        Path(name, "lab.yaml").write_text("mine")
        assert main(["example", name]) == 2
        assert Path(name, "lab.yaml").read_text() == "mine"
    assert main(["example", name, "--out", "elsewhere"]) == 0
    assert Path("elsewhere", "lab.yaml").read_text() == made["lab.yaml"]
