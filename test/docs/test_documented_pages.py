"""Every command and every piece of Python in the README and in docs/ is run, page by page."""

import json
import os
from pathlib import Path

import pytest
from page_runner import ROOT, PageRunner, blocks_of, is_command, runs_in_a_test

from sma_bench import compiled
from sma_bench.cards import card
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.report.page import Picture

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# Pages that another test plays, or whose text a command writes, which cannot carry comments.
ELSEWHERE = {
    "docs/tutorials/rest_deflection.md": "played by test/diagnose/test_tutorial.py",
    "docs/first_power_on.md": "played on the emulated bench by test/nodes/test_first_power_on.py",
    "docs/blind/results.md": "hours of examination; a small one is in test/blind",
}
MOST_NOT_RUN = 19


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def is_played(page: Path) -> bool:
    """Whether a page holds anything to run."""
    if name_of(page) in ELSEWHERE:
        return False
    return any(
        not block.not_run
        and (block.kind == "python" or any(map(runs, block.commands)) or block.file)
        for block in blocks_of(page)
    )


def runs(command: str) -> bool:
    return is_command(command) and runs_in_a_test(command)


PLAYED = [page for page in PAGES if is_played(page)]


@pytest.fixture(scope="module")
def left_by():
    """The page that left a file or a folder of this name."""
    return {}


@pytest.mark.slow
@pytest.mark.skipif(compiled.numba is None, reason="some pages take minutes uncompiled")
@pytest.mark.usefixtures("papers_experiments_once")
@pytest.mark.parametrize("page", PLAYED, ids=name_of)
def test_page_can_be_played(page, tmp_path, monkeypatch, left_by):
    if name_of(page) != "README.md":  # its reports have the same figures; they are drawn there
        monkeypatch.setattr(Picture, "_file", lambda *_, **__: b"\x89PNG")
    folder = tmp_path / "empty"
    folder.mkdir()
    monkeypatch.chdir(folder)
    assert PageRunner(tmp_path / "home").play(page) > 0
    # In the folder of another page it does the same, in any order: no two leave the same name.
    for name in os.listdir(folder):
        assert left_by.setdefault(name, page) == page
    if name_of(page) == "docs/how_to/ten_tasks.md":
        assert json.loads(Path("gap.json").read_text())["cause"] == ["ambient_drift"]
        assert "ambient_drift explains the gap" in page.read_text()
    if name_of(page) == "docs/tutorials/first_diagnosis.md":
        answer = json.loads(Path("gap.json").read_text())
        check_first_diagnosis(answer)
        told = card(diagnosis_from(answer, "gap.json"))
        place = dict(told.rows)["where"].partition(",")[0]
        for shown in (page, ROOT / "README.md"):
            assert told.title in shown.read_text()
            assert f"where   {place}," in shown.read_text()


def check_first_diagnosis(answer):
    """The page says what the reader sees."""
    assert answer["verdict"] == "effect" and answer["cause"] == ["side_heat_coupling"]
    where = answer["where"]
    assert (where["signal"], where["phase"], where["stage"]) == ("deflection", "drive", "thermal")
    # What convicts are the temperatures.
    assert max(where["chain"], key=lambda block: block["gap"])["block"] == "V -> temperature"
    assert answer["shrinkage"]["temperature"]["fraction"] > 0.5


def test_what_is_not_run_is_little_and_says_why(record_property):
    left_out = [(name_of(p), b.not_run) for p in PAGES for b in blocks_of(p) if b.not_run]
    left_out += ELSEWHERE.items()
    record_property("not_run", left_out)
    for where, reason in left_out:
        print(f"{where}: {reason}")
    assert len(PLAYED) >= 15
    assert len(left_out) <= MOST_NOT_RUN
    assert all(len(reason) > 10 for _, reason in left_out)
    assert all((ROOT / page).is_file() for page in ELSEWHERE)


PAGE = """
Words. `./bench nothing`

```
mkdir made
cd made   # a comment
sma-bench parameters --out lab.yaml
ros2 run nothing
```

<!-- file: drive.yaml -->
```yaml
steps: []
```
<!-- shown: drive.yaml -->
```yaml
steps: []
```
```python
x = 1
```
<!-- not run: it would fail -->
```
./bench nothing
```
```text
./bench nothing
```
"""


def test_a_page_is_run_in_order_and_only_what_can_be(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text(PAGE)
    assert PageRunner(tmp_path / "home").play(tmp_path / "page.md") == 4
    assert "wire:" in (tmp_path / "made" / "lab.yaml").read_text()
    assert (tmp_path / "made" / "drive.yaml").read_text() == "steps: []\n"


@pytest.mark.parametrize(
    "text",
    [
        "```\n./bench identfy x\n```",
        "```\nsma-bench info nowhere | cat\n```",
        "```\nsma-bench info nowhere > told\n```",
        "```\ncd nowhere\n```",
        "<!-- file: a -->\n```text\nx\n```\n<!-- shown: a -->\n```text\ny\n```",
        "```python\n1 / 0\n```",
    ],
)
def test_a_page_that_does_not_run_is_found(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text(text + "\n")
    with pytest.raises((AssertionError, ZeroDivisionError, FileNotFoundError)):
        PageRunner(tmp_path / "home").play(tmp_path / "page.md")
