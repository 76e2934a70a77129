"""A report of a bag whose folder and file names are markup shows them, and runs nothing."""

import html

import pytest

from sma_bench.cli import main

HOSTILE = "<img src=x onerror=alert(1)>&{{7*7}}"


@pytest.fixture
def hostile_bag(tmp_path, pytestconfig):
    bag = tmp_path / HOSTILE
    rig = pytestconfig.rootpath / "config" / "wire_rig.yaml"
    assert main([
        "simulate", "--protocol", "quick_staircase", "--params", str(rig), "--rate", "20",
        "--noise", "1", "--out", str(bag),
    ]) == 0  # fmt: skip
    return bag


def test_names_of_bags_are_escaped_in_the_report(hostile_bag, tmp_path):
    assert main(["report", str(hostile_bag), "--out", str(tmp_path / "report")]) == 0
    (page,) = (tmp_path / "report").glob("*.html")
    text = page.read_text()
    assert html.escape(HOSTILE) in text or html.escape(HOSTILE, quote=False) in text
    assert "<img src=x" not in text


def test_names_of_results_are_escaped_in_the_report(hostile_bag, tmp_path):
    result = tmp_path / f"{HOSTILE}.json"
    assert main(["identify", str(hostile_bag), "--json", str(result)]) == 0
    assert main(["report", str(result), "--out", str(tmp_path / "report")]) == 0
    (page,) = (tmp_path / "report").glob("*.html")
    assert "<img src=x" not in page.read_text()
