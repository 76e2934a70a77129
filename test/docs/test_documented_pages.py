"""Every command and every piece of Python in the README and in docs/ is run, page by page; what the
pages of claims name as their proof is there."""

import json
import os
import re
from pathlib import Path

import page_runner
import pytest
from page_runner import blocks_of

from sma_bench import compiled
from sma_bench.cli import main
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.results import card

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Pages that another test plays, or whose text a command writes, which cannot carry comments.
ELSEWHERE = {
    "README.md": "its commands are among those of docs/at_a_desk.md",
    "docs/first_power_on.md": "played on the emulated bench by test/nodes/test_first_power_on.py",
    "docs/blind/results.md": "hours of examination; a small one is in test/blind",
}
MOST_NOT_RUN = 20


def name_of(page):
    return str(page.relative_to(ROOT))


PLAYED = [page for page in PAGES if name_of(page) not in ELSEWHERE
          and any(block.runs for block in blocks_of(page))]  # fmt: skip


@pytest.fixture(scope="module")
def left_by():
    """The page that left a file or a folder of this name."""
    return {}


@pytest.mark.slow
@pytest.mark.skipif(compiled.numba is None, reason="some pages take minutes uncompiled")
@pytest.mark.usefixtures("papers_experiments_once", "undrawn")
@pytest.mark.parametrize("page", PLAYED, ids=name_of)
def test_page_can_be_played(page, tmp_path, monkeypatch, left_by):
    folder = tmp_path / "empty"
    folder.mkdir()
    monkeypatch.chdir(folder)
    answers = {}

    def kept(words):
        """`main`, of which the answer of every diagnosis is kept."""
        if words[0] != "diagnose" or "--json" in words:
            return main(words)
        status = main([*words, "--json", "answer.json", "--force"])
        answers[words[1], "--signals" not in words] = json.loads(Path("answer.json").read_text())
        return status

    monkeypatch.setattr(page_runner, "main", kept)
    assert page_runner.play(page, tmp_path / "home") > 0
    # In the folder of another page it does the same, in any order: no two leave the same name.
    for name in os.listdir(folder):
        assert left_by.setdefault(name, page) == page
    if name_of(page) in CHECKS:
        CHECKS[name_of(page)](page, answers)


def ten_tasks(page, _):
    assert json.loads(Path("gap.json").read_text())["cause"] == ["ambient_drift"]
    assert "ambient_drift explains the gap" in page.read_text()


def first_diagnosis(page, _):
    """The page says what the reader sees."""
    answer = json.loads(Path("gap.json").read_text())
    assert answer["verdict"] == "effect" and answer["cause"] == ["side_heat_coupling"]
    at = [answer["where"][key] for key in ("signal", "phase", "stage")]
    assert at == ["front_2.temperature", "drive", "thermal"]
    assert answer["shrinkage"]["temperature"]["fraction"] > 0.5
    shown = card(diagnosis_from(answer, "gap.json"))
    place = dict(shown.rows)["where"].partition(",")[0]
    for text in (page.read_text(), (ROOT / "README.md").read_text()):
        assert shown.title in text and f"where   {place}," in text


def rest_deflection(_, answers):
    """The causes of both records, with and without the camera."""
    for with_camera in (False, True):  # residual strain shows at rest
        strained = answers["strained", with_camera]
        assert strained["cause"] == ["residual_strain"] and strained["where"]["phase"] == "rest"
    # Heat coupling hides in the parameters without a camera, which tells it.
    hidden, told = answers["coupled", False], answers["coupled", True]
    assert (hidden["verdict"], hidden["where"]["phase"]) == ("recalibration", "drive")
    assert told["cause"] == ["side_heat_coupling"]
    found = {c["name"]: c["log_evidence"] for c in told["candidates"]}
    assert found["side_heat_coupling"] > 1000.0
    # The residual strain acts after the temperature.
    coupled, apart = (
        max(c["gap"] for c in answer["where"]["table"] if c["signal"].endswith("temperature"))
        for answer in (told, strained)
    )
    assert coupled > 3.0 and apart < 0.1


CHECKS = {"docs/how_to/ten_tasks.md": ten_tasks,
          "docs/tutorials/rest_deflection.md": rest_deflection,
          "docs/tutorials/first_diagnosis.md": first_diagnosis}  # fmt: skip


def test_few_blocks_are_not_run_and_each_says_why():
    left_out = [(name_of(p), b.not_run) for p in PAGES for b in blocks_of(p) if b.not_run]
    left_out += ELSEWHERE.items()
    assert len(PLAYED) >= 15 and len(left_out) <= MOST_NOT_RUN
    assert all(len(reason) > 10 for _, reason in left_out)
    assert all((ROOT / page).is_file() for page in ELSEWHERE)
    played, desk = ([c for b in blocks_of(ROOT / page) for c in b.commands[2:]]
                    for page in ("README.md", "docs/at_a_desk.md"))
    assert len(played) > 3 and [command for command in desk if command in played] == played


@pytest.mark.parametrize("page", ["threats", "safety", "reliability", "how_to/ten_tasks"])
def test_every_test_that_a_page_names_exists(page):
    files = {name_of(path): path for path in (ROOT / "test").rglob("*.py")}
    there = {path.name for path in files.values()}
    for file, path in files.items():
        tests = re.findall(r"^ *def (test_\w+)", path.read_text(), re.MULTILINE)
        there |= {*tests, *(f"{file}::{test}" for test in tests)}
    named = re.findall(r"`((?:test/|test_)[^`\s]*)`", (ROOT / "docs" / f"{page}.md").read_text())
    absent = {n for n in named if n not in there and not (n[:5] == "test/" and (ROOT / n).exists())}
    assert named and absent == set(), f"named in docs/{page}.md"


def test_every_file_that_the_tour_of_the_code_names_is_there():
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = re.findall(r"`([\w/]+\.py)`", text)
    there = {n for n in named if (ROOT / n).is_file() or any(ROOT.glob(f"sma_bench/**/{n}"))}
    assert len(named) > 30 and {*named} == there


def test_pictures_are_small_and_each_is_shown_on_a_page():
    pictures = sorted((ROOT / "docs" / "pictures").glob("*.png"))
    text = "".join(page.read_text() for page in PAGES)
    assert pictures and sum(picture.stat().st_size for picture in pictures) < 1_000_000
    assert [p.name for p in pictures if f"pictures/{p.name}" not in text] == []
