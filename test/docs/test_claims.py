"""What the pages of claims name as their proof is there."""

import json
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@cache
def functions() -> set[str]:
    """Every test, as file::name."""
    return {
        f"{path.relative_to(ROOT)}::{name}"
        for path in (ROOT / "test").rglob("test_*.py")
        for name in re.findall(r"^ *def (test_\w+)", path.read_text(), re.MULTILINE)
    }


@pytest.mark.parametrize("page", ["threats", "safety", "reliability", "how_to/ten_tasks"])
def test_every_test_that_a_page_names_exists(page: str) -> None:
    named = re.findall(r"`((?:test/|test_)[^`\s]*)`", (ROOT / "docs" / f"{page}.md").read_text())
    assert named
    files = {path.name for path in (ROOT / "test").rglob("*.py")}
    names = {function.partition("::")[2] for function in functions()}
    for name in named:
        there = (
            name in functions() if "::" in name
            else (ROOT / name).exists() if name.startswith("test/")
            else name in files or name in names
        )  # fmt: skip
        assert there, f"docs/{page}.md names {name}"


def test_pictures_are_small_and_each_is_shown_on_a_page() -> None:
    pictures = sorted((ROOT / "docs" / "pictures").glob("*.png"))
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text() for page in pages)
    known = json.loads((ROOT / "docs" / "pictures" / "pictures.json").read_text())
    assert pictures and sorted(known) == [picture.name for picture in pictures]
    assert sum(picture.stat().st_size for picture in pictures) < 1_000_000
    assert [p.name for p in pictures if f"pictures/{p.name}" not in text] == []
