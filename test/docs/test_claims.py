"""What the pages of claims name as their proof is there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FUNCTIONS = {
    f"{path.relative_to(ROOT)}::{node.name}"
    for path in (ROOT / "test").rglob("test_*.py")
    for node in ast.walk(ast.parse(path.read_text()))
    if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
}
NAMES = {function.partition("::")[2] for function in FUNCTIONS}


@pytest.mark.parametrize("page", ["threats", "safety", "reliability"])
def test_every_test_that_a_page_names_exists(page: str) -> None:
    named = re.findall(r"`((?:test/|test_)[^`\s]*)`", (ROOT / "docs" / f"{page}.md").read_text())
    assert named
    files = {path.name for path in (ROOT / "test").rglob("*.py")}
    for name in named:
        there = (
            name in FUNCTIONS if "::" in name
            else (ROOT / name).exists() if name.startswith("test/")
            else name in files or name in NAMES
        )  # fmt: skip
        assert there, f"docs/{page}.md names {name}"
