"""A report: sections of text, tables and figures, as one HTML file that opens from disk."""

import base64
import csv
import io
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from sma_bench.errors import InputError

_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
:root { color-scheme: light dark; --line: #8884; --soft: #8881; --accent: #1f77b4; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 62rem; padding: 1rem; }
h1 { line-height: 1.2; } h2 { border-bottom: 1px solid var(--line); margin-top: 2.5rem; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { border-bottom: 1px solid var(--line); padding: .3rem .8rem; text-align: left; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
caption { font-weight: 600; padding: .8rem 0 .3rem; text-align: left; }
figure { margin: 1.5rem 0; } figcaption { font-size: .9rem; opacity: .85; }
figure img { background: #fff; border-radius: 6px; max-width: 100%; height: auto; }
.note { background: var(--soft); border-left: 4px solid var(--accent); padding: .5rem 1rem; }
@media print {
  :root { color-scheme: light; } body { font-size: 10pt; max-width: none; padding: 0; }
  table { display: table; font-size: 8.5pt; width: 100%; } thead { display: table-header-group; }
  th, td { padding: .15rem .4rem; } td { overflow-wrap: anywhere; }
  td.number { white-space: nowrap; } figure, tr { break-inside: avoid; } h2 { break-after: avoid; }
}
</style>
</head>
<body>
<h1>{{ title }}</h1>
<p>{{ summary }}</p>
{% for section in sections %}
<h2>{{ section.title }}</h2>
{% for paragraph in section.paragraphs %}<p>{{ paragraph }}</p>
{% endfor %}
{% for note in section.notes %}<p class="note">{{ note }}</p>
{% endfor %}
{% for table in section.tables %}
<table>{% if table.title %}<caption>{{ table.title }}</caption>{% endif %}
<thead><tr>{% for head in table.header %}<th>{{ head }}</th>{% endfor %}</tr></thead>
<tbody>{% for row in table.rows %}<tr>{% for cell in row -%}
<td{% if loop.index0 in table.numeric %} class="number"{% endif %}>{{ cell }}</td>
{%- endfor %}</tr>
{% endfor %}</tbody></table>
{% endfor %}
{% for picture in section.pictures %}
<figure><img alt="{{ picture.title }}" src="data:image/png;base64,{{ picture.base64 }}">
<figcaption><strong>{{ picture.title }}.</strong> {{ picture.caption }}</figcaption></figure>
{% endfor %}
{% endfor %}
</body>
</html>
"""


@dataclass(frozen=True)
class Table:
    """Header and rows of text; `numeric` are the columns set flush right.

    A table with a `name` is written as CSV beside the page too; its `title` stands above it.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: frozenset[int] = frozenset()
    name: str = ""
    title: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure with its file name, title and caption (equation and data source).

    `drawn` are the numbers in it, for a CSV file of its name; none where that says nothing.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    drawn: Table | None = None

    @cached_property
    def png(self) -> bytes:
        """The figure as a PNG file; drawing takes its time, so it is drawn once."""
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=130)
        return buffer.getvalue()

    @property
    def svg(self) -> bytes:
        """The figure as an SVG file, its text as text."""
        buffer = io.BytesIO()
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": self.name}):
            self.figure.savefig(buffer, format="svg", metadata={"Date": None})
        return buffer.getvalue()

    @property
    def base64(self) -> str:
        """The PNG file as text."""
        return base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True)
class Section:
    """One heading with what stands below it, in this order."""

    title: str
    paragraphs: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = field(default_factory=tuple)


def write_report(
    directory: str | Path, title: str, summary: str, sections: Sequence[Section],
    *, for_papers: bool = False,
) -> Path:
    """Write `index.html` (everything inside, all text escaped) and one PNG a figure.

    All files appear, or none: what lies there already is replaced once all are made.

    Args:
        directory: made if it does not exist.
        title, summary: head of the page.
        sections: in reading order.
        for_papers: write every figure as SVG too, and as CSV what is drawn and the named tables.

    Returns:
        Path of index.html.

    Raises:
        InputError: the folder cannot be written.
    """
    directory = Path(directory)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(_TEMPLATE).render(
        title=title, summary=summary, sections=sections
    )
    pictures = [picture for section in sections for picture in section.pictures]
    files = {f"{picture.name}.png": picture.png for picture in pictures}
    if for_papers:
        files |= {f"{picture.name}.svg": picture.svg for picture in pictures}
        tables = {t.name: t for section in sections for t in section.tables if t.name}
        tables |= {p.name: p.drawn for p in pictures if p.drawn is not None}
        files |= {f"{name}.csv": csv_text(table) for name, table in tables.items()}
    write_together(directory, {**files, "index.html": page.encode("utf-8")})
    return directory / "index.html"


def csv_text(table: Table) -> bytes:
    """A table as a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([table.header, *table.rows])
    return text.getvalue().encode("utf-8")


def write_together(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder once all of them are on its disk; the last one last.

    Raises:
        InputError: the folder cannot be written; then it is as it was.
    """
    new = not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory, prefix=".report.") as staged:
            for name, content in files.items():
                (Path(staged) / name).write_bytes(content)
            for name in files:
                os.replace(Path(staged) / name, directory / name)
    except OSError as error:
        if new and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()
        raise InputError(f"{directory}: cannot write the report: {error.strerror}") from None
