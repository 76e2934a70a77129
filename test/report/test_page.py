"""The report is one self-contained, escaped HTML file."""

from html.parser import HTMLParser

import pytest
from matplotlib.figure import Figure

from sma_bench.errors import InputError
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
    return [
        Section(
            "Result <b>", ["a & b"], ["note"],
            [Table(["name", "value"], [["<script>", "1.0"]], frozenset({1}))],
            [Picture("fig", "A line", "from nothing", figure)],
        )
    ]


def test_page_is_well_formed_escaped_and_needs_nothing_else(tmp_path):
    tags = parse(write_report(tmp_path / "r", "T < U", "summary", sections()))
    assert "script" not in [tag for tag, _ in tags.seen]
    assert "<script>" in tags.text and "T < U" in tags.text
    sources = [attrs["src"] for tag, attrs in tags.seen if tag == "img"]
    assert len(sources) == 1 and sources[0].startswith("data:image/png;base64,iVBOR")
    assert (tmp_path / "r" / "fig.png").stat().st_size > 1000


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot write the report"):
        write_report(tmp_path / "file" / "r", "T", "s", sections())
