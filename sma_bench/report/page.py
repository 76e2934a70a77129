"""A report: sections of text, tables and figures, as one HTML file that opens from disk."""

import base64
import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from sma_bench.border import csv_cell, printable, read_bytes, write_files
from sma_bench.cards import Card
from sma_bench.errors import InputError
from sma_bench.progress import Report, in_turn, silent
from sma_bench.report.drawing import curves_of, policy, script

_SHORT, _LONG = 24, 48
"""letters of a table's cell"""
_PAGE = "index.html"
_MARK = '<meta name="generator" content="sma_bench">'
_LARGEST_PAGE = 1 << 30

_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="sma_bench">
<meta http-equiv="Content-Security-Policy" content="{{ policy }}">
<title>{{ title }}</title>
<style>
:root {
  color-scheme: light dark; --line: #8884; --soft: #8881; --accent: #1f77b4; --paper: #fff;
  --shade: #0004;
}
@media (prefers-color-scheme: dark) { :root { --paper: #121212; --shade: #fff6; } }
body {
  background: var(--paper); font: 16px/1.5 system-ui, sans-serif; margin: 0 auto;
  max-width: 62rem; overflow-wrap: anywhere; padding: 1rem;
}
h1 { line-height: 1.2; } h2 { border-bottom: 1px solid var(--line); margin-top: 2.5rem; }
/* What is too wide scrolls in itself; a shade at its edge says that there is more. */
table, .wide {
  background:
    linear-gradient(to right, var(--paper) 1rem, #0000) left / 2rem 100% no-repeat local,
    linear-gradient(to left, var(--paper) 1rem, #0000) right / 2rem 100% no-repeat local,
    linear-gradient(to right, var(--shade), #0000) left / .6rem 100% no-repeat,
    linear-gradient(to left, var(--shade), #0000) right / .6rem 100% no-repeat;
  overflow-x: auto;
}
table { border-collapse: collapse; display: block; overflow-wrap: normal; }
th, td { border-bottom: 1px solid var(--line); padding: .3rem .8rem; text-align: left; }
th { vertical-align: bottom; }
td.number, th.number { text-align: right; }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
td.short { white-space: nowrap; } td.long { min-width: 16rem; overflow-wrap: anywhere; }
caption { font-weight: 600; padding: .8rem 0 .3rem; text-align: left; }
figure { margin: 1.5rem 0; } figcaption { font-size: .9rem; opacity: .85; }
figure img { background: #fff; border-radius: 6px; display: block; height: auto; max-width: 100%; }
.note { background: var(--soft); border-left: 4px solid var(--accent); padding: .5rem 1rem; }
.card { background: var(--soft); border-left: 6px solid var(--accent); padding: .5rem 1rem; }
.card p { font-size: 1.15rem; margin: .3rem 0; }
.card dl {
  display: grid; gap: .2rem 1rem; grid-template-columns: max-content 1fr; margin: .5rem 0;
}
.card dt { font-weight: 600; } .card dt + dd { margin: 0; }
.view canvas { display: block; height: 10rem; touch-action: pan-y; width: 100%; }
.view .legend { display: flex; flex-wrap: wrap; font-size: .85rem; gap: 0 1rem; }
.view .swatch {
  border-top: 3px solid; display: inline-block; margin-right: .3rem; vertical-align: middle;
  width: 1.1rem;
}
.view .dashed { border-top-style: dashed; }
/* Of one width, lest the figure moves under the pointer when a value appears. */
.view .value {
  display: inline-block; font-variant-numeric: tabular-nums; min-width: 5.5em; padding-left: .3em;
}
.view .hint { font-size: .85rem; margin: .2rem 0; opacity: .85; }
@media screen { .drawn .wide { display: none; } }
/* Figures are drawn on white, for papers: light and dark change places, hues stay, and white
   becomes the page's own #121212. */
@media screen and (prefers-color-scheme: dark) {
  figure img { filter: invert(.93) hue-rotate(180deg); }
}
@media screen and (max-width: 44rem) {
  th, td { padding: .25rem .5rem; } table { font-size: .9rem; }
  .wide img { max-width: none; width: 40rem; }
  .view .hint { min-height: 3em; }
}
@media print {
  .view { display: none; }
  :root { color-scheme: light; --paper: #fff; --shade: #0000; } table, .wide { background: none; }
  body { font-size: 10pt; max-width: none; padding: 0; }
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
{% if section.card %}<div class="card"><p><strong>{{ section.card.title }}</strong></p>
<dl>{% for label, text in section.card.rows %}<dt>{{ label }}</dt><dd>{{ text }}</dd>
{% endfor %}</dl>
</div>
{% endif %}
{% for paragraph in section.paragraphs %}<p>{{ paragraph }}</p>
{% endfor %}
{% for note in section.notes %}<p class="note">{{ note }}</p>
{% endfor %}
{% for table in section.tables %}
<table>{% if table.title %}<caption>{{ table.title }}</caption>{% endif %}
<thead><tr>{% for head in table.header -%}
<th{% if loop.index0 in table.numeric %} class="number"{% endif %}>{{ head }}</th>
{%- endfor %}</tr></thead>
<tbody>{% for row in table.rows %}<tr>{% for cell in row -%}
<td class="{{ 'number' if loop.index0 in table.numeric else width_of(cell) }}">{{ cell }}</td>
{%- endfor %}</tr>
{% endfor %}</tbody></table>
{% endfor %}
{% for picture in section.pictures %}
<figure{% if picture.over_time %} class="curves"{% endif %}><div class="wide" tabindex="0"
><img alt="{{ picture.title }}" src="data:image/png;base64,{{ picture.base64 }}"></div>
<figcaption><strong>{{ picture.title }}.</strong> {{ picture.caption }}</figcaption>
{% if picture.over_time -%}
<script type="application/json">{{ curves_of(picture.figure) | tojson }}</script>
{%- endif %}</figure>
{% endfor %}
{% endfor %}
{% if script %}<script>{{ script | safe }}</script>
{% endif %}</body>
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

    `drawn` are the numbers in it, for a CSV file of its name; none where that says nothing. One
    that is `over_time` answers to the pointer where the page may run its script.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    drawn: Table | None = None
    over_time: bool = False

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
    """One heading with what stands below it, in this order; a card first."""

    title: str
    paragraphs: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = field(default_factory=tuple)
    card: Card | None = None


def write_report(
    directory: str | Path, title: str, summary: str, sections: Sequence[Section],
    *, for_papers: bool = False, report: Report = silent,
) -> Path:
    """Write `index.html` (everything inside, all text escaped) and one PNG a figure.

    Figures over time answer to the pointer, by a script in the page; without it, and on paper, the
    PNG stands there.

    All files appear, or none: a report that lies there already is replaced once all are made, as a
    whole; other files are not.

    Args:
        directory: made if it does not exist.
        title, summary: head of the page.
        sections: in reading order.
        for_papers: write every figure as SVG too, and as CSV what is drawn and the named tables.
        report: called before each figure is drawn.

    Returns:
        Path of index.html.

    Raises:
        InputError: the folder cannot be written, or holds a file of a name in the report that is
            not a report's.
    """
    directory = Path(directory)
    pictures = [picture for section in sections for picture in section.pictures]
    files = {}
    for picture in in_turn(pictures, report, lambda p: p.title):
        files[f"{picture.name}.png"] = picture.png
        if for_papers:
            files[f"{picture.name}.svg"] = picture.svg
    page = _template().render(
        title=title, summary=summary, sections=sections, width_of=_width,
        curves_of=curves_of, policy=policy(),
        script=script() if any(picture.over_time for picture in pictures) else "",
    )
    if for_papers:
        tables = {t.name: t for section in sections for t in section.tables if t.name}
        tables |= {p.name: p.drawn for p in pictures if p.drawn is not None}
        files |= {f"{name}.csv": csv_text(table) for name, table in tables.items()}
    write_together(directory, {**files, _PAGE: page.encode("utf-8")})
    return directory / _PAGE


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, finalize=_without_controls
    )
    return environment.from_string(_TEMPLATE)


def _width(cell: str) -> str:
    """Class of a table's cell: names and units stay on a line, sentences get room."""
    if len(cell) <= _SHORT:
        return "short"
    return "long" if len(cell) > _LONG else ""


def _without_controls(shown: object) -> object:
    """Names from outside without what ends or turns a text."""
    return printable(shown, "\n") if type(shown) is str else shown


def csv_text(table: Table) -> bytes:
    """A table as a CSV file, in which no text is a formula to a spreadsheet."""
    text = io.StringIO()
    rows = [map(csv_cell, row) for row in (table.header, *table.rows)]
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8")


def write_together(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a report into a folder: all of them, or none.

    Raises:
        InputError: the folder cannot be written, or a file that is not a report's lies in the way;
            then it is as it was.
    """
    new = not directory.exists()
    foreign = [] if new or _is_report(directory) else [n for n in files if (directory / n).exists()]
    if foreign:
        raise InputError(
            f"{directory}: holds {foreign[0]}, which is not of a report of sma-bench; expected "
            "another folder"
        )
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_files({directory / name: content for name, content in files.items()})
    except OSError as error:
        if new and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()
        raise InputError(f"{directory}: cannot write the report: {error.strerror}") from None


def _is_report(directory: Path) -> bool:
    page = directory / _PAGE
    try:
        return page.exists() and _MARK.encode() in read_bytes(page, _LARGEST_PAGE)
    except (InputError, OSError):
        return False
