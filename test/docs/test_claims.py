"""The pages that claim safety name tests that are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("page", ["threats", "safety", "reliability"])
def test_every_test_that_a_claim_names_is_there(page):
    named = set(re.findall(r"\btest_[a-z0-9_]+", (ROOT / "docs" / f"{page}.md").read_text()))
    files = [path for path in (ROOT / "test").rglob("test_*.py")]
    there = {path.stem for path in files}
    for path in files:
        there |= set(re.findall(r"def (test_\w+)", path.read_text()))
    assert named - there == set()
