"""From a lab's files to one page: `sma-bench try`."""

import json
from pathlib import Path

import pytest
from planted import few_effects

from sma_bench.cli import main
from sma_bench.installation import share_directory
from sma_bench.parameters import read_parameters


@pytest.fixture(autouse=True)
def _quick(undrawn):
    """Without drawings, and with one effect."""
    with few_effects(("ambient_drift",)):
        yield


EXAMPLES = share_directory() / "examples"
TABLE, LAB = EXAMPLES / "ten_tasks" / "run.csv", EXAMPLES / "ten_tasks" / "lab.yaml"


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """Exit status and JSON of `try` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def ask(*words):
        path = Path("answer.json")
        path.unlink(missing_ok=True)
        status = main(["try", *map(str, words), "--json", str(path)])
        return status, json.loads(path.read_text()) if path.is_file() else None

    return ask


def test_a_logger_table_and_stated_parameters_become_one_page(asked, tmp_path):
    status, answer = asked(TABLE, "--params", LAB)
    assert status == 0
    assert answer["records"] == ["run_tried/run"] and Path("run_tried/run/metadata.yaml").is_file()
    assert "wire.resistance" in answer["identified"]["parameters"]
    assert answer["diagnosis"]["verdict"] in ("effect", "recalibration", "ambiguous")
    page = Path(answer["page"]).read_text()
    for shown in ("wire.resistance", answer["diagnosis"]["candidates"][0]["name"], "run_tried/run"):
        assert shown in page
    for name in ("identified", "improved"):
        assert read_parameters(tmp_path / f"run_tried/{name}.yaml")["wire.resistance"] > 0.0


def test_without_parameters_no_gap_is_diagnosed_and_old_results_are_removed(asked):
    asked(TABLE, "--params", LAB, "--out", "first_look")
    old = Path("first_look/diagnosis.json").read_bytes()
    assert asked(TABLE, "--out", "first_look")[0] == 2
    assert Path("first_look/diagnosis.json").read_bytes() == old
    status, answer = asked(TABLE, "--out", "first_look", "--force")
    assert status == 0 and "diagnosis" not in answer
    assert not Path("first_look/diagnosis.json").exists()


def test_an_instruments_file_needs_no_import(asked):
    status, answer = asked(EXAMPLES / "instruments" / "DSC.txt")
    assert status == 0
    assert answer["records"] == [str(EXAMPLES / "instruments" / "DSC.txt")]
    assert "wire.austenite_start_temperature" in answer["identified"]["parameters"]


def test_a_column_in_doubt_is_asked_about_and_the_map_answers(asked, capsys):
    text = TABLE.read_text().replace("time [s]", "time")
    Path("mine.csv").write_text("\n".join(
        f"{1000 * float(row.split(',')[0]):.0f},{row.partition(',')[2]}" if k else row
        for k, row in enumerate(text.splitlines())
    ))  # fmt: skip
    assert asked("mine.csv")[0] == 2
    (said,) = [line for line in capsys.readouterr().err.splitlines() if "unsure" in line]
    assert "mine_tried/mine.map.yaml" in said and not Path("mine_tried/page").exists()
    status, answer = asked("mine.csv", "--unit", "time=ms", "--force")
    assert status == 0 and "wire.resistance" in answer["identified"]["parameters"]


def test_an_unreadable_file_is_an_error_of_one_line_and_leaves_no_page(asked, capsys):
    Path("notes.txt").write_text("remember to buy wire\n")
    assert asked("notes.txt")[0] == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "notes.txt" in line and not Path("notes_tried/page").exists()
