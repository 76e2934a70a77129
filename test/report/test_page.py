"""The report is one self-contained, escaped HTML file."""

import os
from html.parser import HTMLParser

import pytest
from matplotlib.figure import Figure

from sma_bench.errors import InputError
from sma_bench.report.drawing import COLUMNS
from sma_bench.report.page import Picture, Section, Table, write_report


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.seen, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def parse(path):
    tags = Tags()
    tags.feed(path.read_text())
    assert tags.open == []
    return tags


def sections():
    figure = Figure()
    figure.subplots().plot([0, 1], [1, 0])
    table = Table(["name", "value"], [["<script>", "1.0"]], frozenset({1}))
    picture = Picture("fig", "A line", "from nothing", figure)
    return [Section("Result <b>", ["a & b"], ["note"], [table], [picture])]


def test_a_report_replaces_a_report_whole_and_nothing_else(tmp_path, monkeypatch):
    folder = tmp_path / "r"
    folder.mkdir()
    (folder / "index.html").write_text("<p>my page</p>")
    with pytest.raises(InputError, match="index.html, which is not of a report"):
        write_report(folder, "T", "s", sections())
    assert [p.name for p in folder.iterdir()] == ["index.html"]
    (folder / "index.html").unlink()
    (folder / "notes.txt").write_text("mine")
    write_report(folder, "one", "s", sections())
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    replace, calls = os.replace, []

    def fail_at_the_second(source, target):
        calls.append(target)
        if len(calls) == 2:
            raise OSError(5, "Input/output error")
        return replace(source, target)

    monkeypatch.setattr(os, "replace", fail_at_the_second)
    with pytest.raises(InputError, match="cannot write the report: Input/output error"):
        write_report(folder, "two", "s", sections())
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    monkeypatch.undo()
    write_report(folder, "two", "s", sections())
    assert "<title>two</title>" in (folder / "index.html").read_text()
    assert (folder / "notes.txt").read_text() == "mine"


def test_names_from_outside_are_text_in_page_and_table(tmp_path):
    hostile = "=HYPERLINK(1)\x1b[2J\udcff\u202e"
    table = Table(["name"], [[hostile], ["-1.5"]], name="names")
    page = write_report(
        tmp_path / "r",
        hostile,
        "s",
        [Section("S", [hostile], tables=[table])],
        column=COLUMNS["single"],
    )
    text = page.read_text(encoding="utf-8")
    assert "=HYPERLINK(1)\\x1b[2J\\udcff\\u202e" in text and "\x1b" not in text
    rows = (tmp_path / "r" / "names.csv").read_text().splitlines()
    assert rows == ["name", "'=HYPERLINK(1)\\x1b[2J\\udcff\\u202e", "-1.5"]
