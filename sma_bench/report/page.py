"""A report: sections of text, tables and figures, as one HTML file that opens from disk."""

import base64
import csv
import hashlib
import html
import io
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from sma_bench.border import csv_cell, is_inside, printable, read_bytes, write_files
from sma_bench.cards import Card
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.progress import Report, in_turn, silent
from sma_bench.report.drawing import (
    COLUMNS,
    TABLE_HEADER,
    PaperColumn,
    curves_of,
    drawn_rows,
    in_column,
    on_dark_paper,
    policy,
    script,
)
from sma_bench.report.tables import Table

_SHORT, _LONG = 24, 48
"""letters of a table's cell"""
_LABEL = 12
"""letters of a card's label"""
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
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; }
h2 { border-bottom: 1px solid var(--line); margin-top: 2.5rem; }
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
td.short { white-space: nowrap; } td.long { min-width: 11rem; overflow-wrap: anywhere; }
table.many { font-size: .85rem; } .many th, .many td { padding: .3rem .45rem; }
caption { font-weight: 600; padding: .8rem 0 .3rem; text-align: left; }
figure { margin: 1.5rem 0; } figcaption { font-size: .9rem; opacity: .85; }
figure img { background: #fff; border-radius: 6px; display: block; height: auto; max-width: 100%; }
.note { background: var(--soft); border-left: 4px solid var(--accent); padding: .5rem 1rem; }
.card { background: var(--soft); border-left: 6px solid var(--accent); padding: .5rem 1rem; }
.card p { font-size: 1.15rem; margin: .3rem 0; }
.card dl {
  display: grid; gap: .2rem 1rem; grid-template-columns: max-content 1fr; margin: .5rem 0;
}
.keep { white-space: nowrap; } .card dt { font-weight: 600; } .card dt + dd { margin: 0; }
details { background: var(--soft); margin: .5rem 0; padding: .3rem 1rem; }
.view canvas { display: block; height: 10rem; touch-action: pan-y; width: 100%; }
.view .legend { display: flex; flex-wrap: wrap; font-size: .85rem; gap: 0 1rem; }
.view canvas.swatch {
  display: inline-block; height: 10px; margin-right: .3rem; vertical-align: middle; width: 34px;
}
.view .band { background: #8884; padding: 0 .4rem; }
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
  figure picture img { background: none; filter: none; }
}
@media screen and (max-width: 44rem) {
  th, td { padding: .25rem .5rem; } table { font-size: .9rem; }
  body { padding: .6rem; } h1 { font-size: 1.25rem; margin: .2rem 0; } .head { margin: .3rem 0; }
  .card { font-size: .85rem; line-height: 1.3; padding: .3rem .6rem; }
  .card dl.tall { display: block; } .card dl.tall dd { margin: 0 0 .2rem; }
  .card p { font-size: 1rem; } .card dl { gap: .15rem .6rem; margin: .2rem 0; }
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
<p class="head">{{ summary }}</p>
{% macro tables_of(section) -%}
{% for table in section.tables %}
<table{% if table.header | length > 6 %} class="many"{% endif %}>
{% if table.title %}<caption>{{ table.title }}</caption>{% endif %}
<thead><tr>{% for head in table.header -%}
<th{% if loop.index0 in table.numeric %} class="number"{% endif %}>{{ head }}</th>
{%- endfor %}</tr></thead>
<tbody>{% for row in table.rows %}<tr>{% for cell in row -%}
<td class="{{ 'number' if loop.index0 in table.numeric else width_of(cell) }}"
>{{ together(cell) | safe }}</td>
{%- endfor %}</tr>
{% endfor %}</tbody></table>
{% endfor %}
{% endmacro %}
{% for section in sections %}
{% if section.title %}<h2>{{ section.title }}</h2>
{% endif %}
{% if section.card %}<div class="card">
<p><strong>{{ together(section.card.title) | safe }}</strong></p>
<dl{% if is_tall(section.card) %} class="tall"{% endif %}>
{% for label, text in section.card.rows %}<dt>{{ label }}</dt><dd>{{ together(text) | safe }}</dd>
{% endfor %}</dl>
</div>
{% endif %}
{% for paragraph in section.paragraphs %}<p>{{ together(paragraph) | safe }}</p>
{% endfor %}
{% for note in section.notes %}<p class="note">{{ together(note) | safe }}</p>
{% endfor %}
{% if section.folded %}<details><summary>{{ section.folded[0] }}</summary><ul>
{% for line in section.folded[1:] %}<li>{{ together(line) | safe }}</li>
{% endfor %}</ul></details>
{% endif %}
{% if not section.pictures_first %}{{ tables_of(section) }}{% endif %}
{% for picture in section.pictures %}
<figure{% if picture.over_time %} class="curves"{% endif %}><div class="wide" tabindex="0"
>{% if picture.shaded %}<picture><source media="screen and (prefers-color-scheme: dark)"
srcset="data:image/png;base64,{{ picture.dark }}">{% endif -%}
<img alt="{{ picture.title }}" src="data:image/png;base64,{{ picture.base64 }}">
{%- if picture.shaded %}</picture>{% endif %}</div>
<figcaption><strong>{{ picture.title }}.</strong>
{{ together(picture.caption) | safe }}</figcaption>
{% if picture.over_time -%}
<script type="application/json">{{ curves_of(picture.figure) | tojson }}</script>
{%- endif %}</figure>
{% endfor %}
{% if section.pictures_first %}{{ tables_of(section) }}{% endif %}
{% endfor %}
{% if script %}<script>{{ script | safe }}</script>
{% endif %}</body>
</html>
"""


@dataclass(frozen=True)
class Picture:
    """A figure with its file name, title and caption (equation and data source).

    One that is `over_time` answers to the pointer where the page may run its script; one that is
    `shaded` has colours that mean numbers, which dark paper must not turn.
    """

    name: str
    title: str
    caption: str
    figure: Figure
    over_time: bool = False
    shaded: bool = False

    @cached_property
    def png(self) -> bytes:
        """The figure as a PNG file; drawing takes its time, so it is drawn once."""
        return self._file("png")

    @property
    def base64(self) -> str:
        """The PNG file as text."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def dark(self) -> str:
        """The same for dark paper."""
        with on_dark_paper(self.figure):
            return base64.b64encode(self._file("png")).decode("ascii")

    def files(self, column: PaperColumn) -> dict[str, bytes]:
        """SVG and PDF in the width of a column, their text as text, and as CSV what is drawn."""
        with in_column(self.figure, column):
            found = {f"{self.name}.{kind}": self._file(kind) for kind in ("svg", "pdf")}
        return {**found, f"{self.name}.csv": csv_text(self.drawn)}

    @property
    def drawn(self) -> Table:
        """All that is drawn, in plain numbers."""
        return Table(TABLE_HEADER, drawn_rows(self.figure))

    def save(self, path: str | Path, column: PaperColumn = COLUMNS["double"]) -> None:
        """Write the figure: PNG, SVG or PDF in the width of a column, or CSV of what is drawn.

        Raises:
            InputError: another kind of file, or one that cannot be written.
        """
        path = Path(path)
        kind = path.suffix[1:].lower()
        if kind not in ("png", "svg", "pdf", "csv"):
            raise InputError(f"{path}: expected a name that ends in .png, .svg, .pdf or .csv")
        if kind == "csv":
            content = csv_text(self.drawn)
        else:
            with in_column(self.figure, column):
                content = self._file(kind, dpi=300)
        try:
            write_files({path: content})
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None

    def _repr_png_(self) -> bytes:
        """What a notebook shows."""
        return self.png

    def _file(self, kind: str, dpi: float = 130) -> bytes:
        buffer = io.BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": self.name, "pdf.fonttype": 42}):
            self.figure.savefig(buffer, format=kind, dpi=dpi, metadata=dates.get(kind))
        return buffer.getvalue()


@dataclass(frozen=True)
class Section:
    """One heading with what stands below it, in this order; a card first. Of `folded` the first
    line is seen, the others when it is opened. `pictures_first`: they stand above the tables."""

    title: str
    paragraphs: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = field(default_factory=tuple)
    card: Card | None = None
    folded: Sequence[str] = ()
    pictures_first: bool = False


def write_report(
    directory: str | Path, title: str, summary: str, sections: Sequence[Section],
    *, column: PaperColumn | None = None, report: Report = silent,
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
        column: of a paper, for which every figure is written as SVG and PDF too, and as CSV what is
            drawn and the named tables.
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
        if column is not None:
            files |= picture.files(column)
    page = _template().render(
        title=title, summary=summary, sections=sections, width_of=_width, together=_together,
        is_tall=_is_tall, curves_of=curves_of, policy=policy(),
        script=script() if any(picture.over_time for picture in pictures) else "",
    )
    if column is not None:
        tables = [t for section in sections for t in section.tables if t.name]
        files |= {f"{table.name}.csv": csv_text(_in_plain_numbers(table)) for table in tables}
    write_together(directory, {**files, _PAGE: page.encode("utf-8")})
    return directory / _PAGE


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined,
        finalize=lambda shown: _shown(shown) if type(shown) is str else shown,
    )
    return environment.from_string(_TEMPLATE)


def _width(cell: str) -> str:
    """Class of a table's cell: names and units stay on a line, sentences get room."""
    if len(cell) <= _SHORT:
        return "short"
    return "long" if len(cell) > _LONG else ""


def _is_tall(card: Card) -> bool:
    """Whether its labels are too long to stand beside their texts on a phone."""
    return any(len(label) > _LABEL for label, _ in card.rows)


_MEASURED = re.compile(r"(?<![A-Za-z]\d)(?<=\d) (?=%|(?:K|mA|A|mm|ohm|min|s|V)\b)")
_KEPT = re.compile(r"--[a-z][\w-]*|\[-?[\d.]+, -?[\d.]+\]")


def _together(text: str) -> str:
    """Escaped; no line ends between a number and its unit, or within an option or an interval."""
    safe = _MEASURED.sub("&nbsp;", html.escape(_shown(text)))
    return _KEPT.sub(lambda found: f'<span class="keep">{found[0]}</span>', safe)


def _shown(text: str) -> str:
    """Names from outside without what ends or turns a text."""
    return printable(text, "\n").replace(" +- ", " ± ")


def csv_text(table: Table) -> bytes:
    """A table as a CSV file, in which no text is a formula to a spreadsheet."""
    text = io.StringIO()
    rows = [map(csv_cell, row) for row in (table.header, *table.rows)]
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8")


_MEASURE = re.compile(r"([-+]?[\d.]+(?:e[-+]?\d+)?)(?: to ([-+]?[\d.]+))?(?: (\D\S*))?")


def _in_plain_numbers(table: Table) -> Table:
    """Its columns of numbers without units, which stand in columns of their own, as the upper ends
    of intervals do."""
    columns = []
    for k, head in enumerate(table.header):
        cells = [row[k] for row in table.rows]
        found = [_MEASURE.fullmatch(cell) for cell in cells]
        if k not in table.numeric or any(c and not f for c, f in zip(cells, found, strict=True)):
            columns.append((head, cells))
            continue
        parts = [f.groups(default="") if f else ("", "", "") for f in found]
        for name, own in zip((head, f"{head}, to", f"{head}, unit"), zip(*parts, strict=True),
                             strict=False):
            if name == head or any(own):
                columns.append((name, list(own)))
    rows = [[own[r] for _, own in columns] for r in range(len(table.rows))]
    return Table([name for name, _ in columns], rows, name=table.name)


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


# --- What a report was made of: files with their hashes, versions, the command.

_PACKAGES = ("numpy", "scipy", "numba", "matplotlib", "rosbags")
_BLOCK = 1 << 20


def digest(path: Path) -> tuple[str, int]:
    """SHA-256 and size in bytes of a file; of a folder, over names and contents of its files,
    not of those that links lead to outside.

    Raises:
        InputError: a file cannot be read.
    """
    total, size = hashlib.sha256(), 0
    try:
        for part in _own_files(path) if path.is_dir() else [path]:
            if path.is_dir():
                head = f"{part.relative_to(path)}\0{part.stat().st_size}\0"
                total.update(head.encode("utf-8", "surrogateescape"))
            for block in _blocks(part):
                total.update(block)
                size += len(block)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return total.hexdigest(), size


def _own_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file() and is_inside(p, folder))


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            yield block


@cache
def versions() -> dict[str, str]:
    """Of this package, what it computes with, Python and the machine."""
    found = {"sma_bench": VERSION, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found | {"system": f"{platform.system()} {platform.machine()}"}


@dataclass(frozen=True)
class Made:
    """What a page was made of: the command as typed, and its inputs, read anew for their hashes."""

    command: str = ""
    inputs: Sequence[str] = ()
    when: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def head(self) -> str:
        """Date and version."""
        return f"{self.when:%Y-%m-%d}, sma_bench {VERSION}."

    def section(self) -> Section:
        """Files, versions and the command; what was never a file has no hash.

        Raises:
            InputError: an input cannot be read any more.
        """
        files = []
        for path in dict.fromkeys(self.inputs):
            sha, size = digest(Path(path)) if Path(path).exists() else ("not a file", 0)
            files.append((path, sha, f"{size}"))
        made = self.when.astimezone().isoformat(timespec="seconds")
        about = {"command": self.command, "made": made, **versions()}
        table = Table(("file", "SHA-256", "bytes"), files, frozenset({2}), "provenance_files",
                      "Files")
        tables = [table] if files else []
        return Section(
            "Provenance",
            ["A folder's hash covers the names, sizes and contents of its files in alphabetical "
             "order." if files else "Made of the package's own numbers: no file was read."],
            tables=[
                *tables,
                Table(("", ""), list(about.items()), frozenset(), "provenance_versions", "Made by"),
            ],
        )  # fmt: skip
