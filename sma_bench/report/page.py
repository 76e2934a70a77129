"""A report: sections of text, tables and figures, as one HTML file that opens from disk."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import jinja2
from matplotlib.figure import Figure

from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

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
figure { margin: 1.5rem 0; } figcaption { font-size: .9rem; opacity: .85; }
figure img { background: #fff; border-radius: 6px; max-width: 100%; height: auto; }
.note { background: var(--soft); border-left: 4px solid var(--accent); padding: .5rem 1rem; }
@media print { body { max-width: none; } figure { break-inside: avoid; } }
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
<table><thead><tr>{% for head in table.header %}<th>{{ head }}</th>{% endfor %}</tr></thead>
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
    """Header and rows of text; `numeric` are the columns set flush right."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Picture:
    """A figure with its file name, title and caption (equation and data source)."""

    name: str
    title: str
    caption: str
    figure: Figure

    @cached_property
    def png(self) -> bytes:
        """The figure as a PNG file; drawing takes its time, so it is drawn once."""
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png", dpi=130)
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
    directory: str | Path, title: str, summary: str, sections: Sequence[Section]
) -> Path:
    """Write `index.html` (everything inside, all text escaped) and one PNG a figure.

    Args:
        directory: made if it does not exist.
        title, summary: head of the page.
        sections: in reading order.

    Returns:
        Path of index.html.

    Raises:
        InputError: the folder cannot be written.
    """
    directory = Path(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for section in sections:
            for picture in section.pictures:
                (directory / f"{picture.name}.png").write_bytes(picture.png)
    except OSError as error:
        raise InputError(f"{directory}: cannot write the report: {error.strerror}") from None
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(_TEMPLATE).render(
        title=title, summary=summary, sections=sections
    )
    write_text_atomically(directory / "index.html", page)
    return directory / "index.html"
