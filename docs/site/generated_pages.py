"""A hook of mkdocs (`hooks:` in mkdocs.yml), run at every build.

It makes the reference pages from the code, replaces patterns in the nav by pages, and puts pages
that the nav does not name under "More".
"""

import ast
import fnmatch
import html
import io
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from matplotlib import mathtext, rc_context
from matplotlib.font_manager import FontProperties
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from sma_bench import api
from sma_bench.cli import COMMANDS, load_command
from sma_bench.nodes.start import NODES
from sma_bench.paper.page import paper_errata
from sma_bench.parameters.node_tables import NODE_TABLES, markdown

ROOT = Path(__file__).resolve().parents[2]
MORE = "More"
_WIDTH = "96"
_INK = "#010203"  # of equations; becomes the colour of the text around them


# Wide tables fit: a wider page, narrower cells, and no space for an empty table of contents.
_STYLE = """.md-grid { max-width: 76rem; }
.md-sidebar--secondary:not(:has(li)) { display: none; }
.md-typeset table:not([class]) { font-size: .66rem; }
.md-typeset table:not([class]) th { min-width: 3rem; }
.md-typeset table:not([class]) :is(th, td) { padding: .5em .55em; }
.md-typeset pre > code { font-size: .62rem; }
.md-typeset svg[role] { max-width: none; }
.md-typeset td code { overflow-wrap: normal; word-break: normal; }
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, then complete the nav."""
    for path, text in {
        "reference/commands.md": commands_page(),
        "reference/python.md": python_page(),
        "reference/nodes.md": nodes_page(),
        "explanation/errata.md": errata_page(),
        "site.css": _STYLE,
        **{
            f.src_uri.replace(".ipynb", ".md"): notebook_page(Path(f.abs_src_path or ""))
            for f in files
            if f.src_uri.endswith(".ipynb")
        },
    }.items():
        files.append(File.generated(config, path, content=text))
    pages = [f.src_uri for f in files.documentation_pages()]
    if config.nav is not None:
        named: set[str] = set()
        config.nav = list(_filled(config.nav, pages, named))
        others = sorted(set(pages) - named)
        if others:
            config.nav.append({MORE: others})
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Typeset the equations (```math blocks, as on GitHub), without a script or a download."""
    if page.file.src_uri == "effects.md":
        markdown = re.sub(r"^    (?=\S)(.+)$", _plain_equation, markdown, flags=re.MULTILINE)
    return re.sub(r"^```math\n(.*?)\n```$", _typeset, markdown, flags=re.MULTILINE | re.DOTALL)


def on_page_content(html: str, **_: Any) -> str:
    """Names in tables break at their dots and underlines, not within words."""
    return re.sub(r"(?<=<td><code>)[\w.]+(?=</code>)",
                  lambda found: re.sub(r"([._])", r"\1<wbr>", found[0]), html)


# The effects' texts are also shown in terminals: their equations use plain letters.
_SYMBOLS = {"inf": "infty", "eps": "epsilon"} | {
    name: name
    for name in ("alpha", "beta", "xi", "sigma", "delta", "tau", "nu", "sum", "exp", "min", "max")
}
_SHORT_WORDS = {"to", "at", "of", "its", "are", "the", "and", "two", "past", "over", "eq"}
_MOST_WORDS = 6  # of a formula; a longer text is a sentence and is not typeset
_TOKEN = re.compile(r"d(\w+)/dt|_([a-zA-Z]+)|([A-Za-z]+)|(<=)|(\.\.\.)|( +)")


def _plain_equation(found: re.Match[str]) -> str:
    if len(re.findall(r"\b[a-z]{4,}\b", found[1])) > _MOST_WORDS:
        return found[0]
    return f"```math\n{_TOKEN.sub(_in_tex, found[1])}\n```"


def _in_tex(found: re.Match[str]) -> str:
    rate, below, word, at_most, dots, gap = found.groups()
    if rate:
        return rf"\frac{{d {_TOKEN.sub(_in_tex, rate)}}}{{dt}}"
    if below:
        known = f"\\{_SYMBOLS[below]}" if below in _SYMBOLS else below
        return f"_{{{known}}}" if len(below) == 1 or below in _SYMBOLS else rf"_\mathrm{{{below}}}"
    if gap:
        return r"\quad " if len(gap) > 1 else r"\ "
    if word and (symbol := re.fullmatch(r"(d?)(\w+)", word)) and symbol[2] in _SYMBOLS:
        return rf"{symbol[1]}\{_SYMBOLS[symbol[2]]} "
    if word and (len(word) > 3 or word in _SHORT_WORDS):
        return rf"\mathrm{{{word}}}"
    return r"\leq " if at_most else r"\ldots " if dots else found[0]


def _typeset(found: re.Match[str]) -> str:
    formula = " ".join(found[1].split()).replace(r"\frac", r"\dfrac")
    stream, formula = io.StringIO(), f"${formula}$"
    with rc_context({"savefig.transparent": True}):
        mathtext.math_to_image(formula, stream, FontProperties(size=14), format="svg", color=_INK)
    drawn = re.sub(r"<metadata>.*?</metadata>", "", stream.getvalue(), flags=re.DOTALL)
    drawn = drawn[drawn.index("<svg") :].replace(_INK, "currentColor").replace("\n", " ")
    said = html.escape(found[1], quote=True)
    named = f'<svg role="img" aria-label="{said}"'
    style = "margin: 1em 0; overflow: auto hidden"
    return f'<div style="{style}">{drawn.replace("<svg", named, 1)}</div>'


def _filled(nav: list[Any], pages: list[str], named: set[str]) -> Iterator[Any]:
    """The nav with every pattern replaced by pages not named before it, E10 after E9."""
    for entry in nav:
        if isinstance(entry, dict):
            ((title, below),) = entry.items()
            if isinstance(below, list):
                yield {title: list(_filled(below, pages, named))}
            else:
                named.add(below)
                yield entry
        elif "*" in entry:
            fitting = set(fnmatch.filter(pages, entry)) - named
            found = sorted(fitting, key=_numbers_by_size)
            named.update(found)
            yield from found
        else:
            named.add(entry)
            yield entry


def _numbers_by_size(path: str) -> list[Any]:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]


def commands_page() -> str:
    """Every command with the output of its --help."""
    os.environ["COLUMNS"], os.environ["NO_COLOR"] = _WIDTH, "1"
    lines = [
        "# Commands", "",
        "The output of `sma-bench COMMAND --help`. In a clone, `./bench` replaces `sma-bench`. "
        "Commands end with 0 on success, and with 2 and one line on bad input. An output file is "
        "written completely or not at all.",
    ]  # fmt: skip
    for name in COMMANDS:
        command = load_command(name)
        text = command.get_help(click.Context(command, info_name=f"sma-bench {name}")).rstrip()
        lines += ["", f"## {name}", "", "```text", text, "```"]
    return "\n".join(lines) + "\n"


def python_page() -> str:
    """Functions and results of the Python interface, from their docstrings."""
    functions = [n for n in api.__all__ if n[0].islower()]
    classes = [n for n in api.__all__ if n[0].isupper()]
    lines = [
        "# Python", "",
        "`import sma_bench` gives these names, in SI units; each is imported at its first use. "
        "Examples are in [the notebook](../tutorials/notebook.md).",
        "", "## Functions",
    ]  # fmt: skip
    for name in functions:
        lines += ["", f"::: {_home(name)}"]
    lines += ["", "## Results"]
    for name in classes:
        lines += ["", f"::: {_home(name)}"]
    return "\n".join(lines) + "\n"


def _home(name: str) -> str:
    thing = getattr(api, name)
    return f"{thing.__module__}.{thing.__qualname__}"



def nodes_page() -> str:
    """Every node: what it does and its topics (docs/nodes.md), its own parameters (its table)."""
    told = node_rows((ROOT / "docs" / "nodes.md").read_text())
    lines = [
        "# Nodes", "",
        "`ros2 run sma_bench NODE`, or `sma-bench run NODE` without a ROS 2 installation. Names "
        "are relative to the namespace; `~` is the node itself. Every node takes "
        "[the parameters of the bench](../parameters.md) too, and a node that drives sends "
        "0 V when it ends. [Topics](../topics.md) lists types and units.",
    ]  # fmt: skip
    for node, table in NODE_TABLES.items():
        lines += ["", f"## {node}"]
        for text in told.get(node) or [_first_line(node)]:
            lines += ["", f"{text[:1].upper()}{text[1:].rstrip('.')}."]
        lines += ["", *markdown("table", table).splitlines()]
    return "\n".join(lines) + "\n"


def _first_line(node: str) -> str:
    """The first line of a node's docstring: for a node without its own row in the table."""
    module, _, kind = NODES[node].partition(".")
    source = ast.parse((ROOT / "sma_bench" / "nodes" / f"{module}.py").read_text())
    (found,) = (n for n in source.body if isinstance(n, ast.ClassDef) and n.name == kind)
    return (ast.get_docstring(found) or "").partition("\n\n")[0].replace("\n", " ")


def node_rows(page: str) -> dict[str, list[str]]:
    """The cells of each node's row in that page's table."""
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \|$", page, re.MULTILINE)
    return {node: [cell.replace("](", "](../") for cell in cells] for node, *cells in rows}


def errata_page() -> str:
    """The paper's errata, printed and corrected, with the numbers of `sma-bench paper`."""
    lines = [
        "# Errata of the paper", "",
        "Errors of the paper, and the formulas that the package uses instead, with the paper's "
        "numbers. Geometry, C_A and C_M are not in the paper and are [assumed](../parameters.md).",
    ]  # fmt: skip
    for erratum in paper_errata():
        lines += [
            "", f"## {erratum.number}. {erratum.place}", "",
            "| | as printed | corrected | independent check |", "| --- | --- | --- | --- |",
            _row("form", erratum.printed, erratum.corrected, ""),
            *(_row(*line) for line in erratum.lines), "", erratum.remark,
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _shown(output: dict[str, Any]) -> list[str]:
    """The output of a cell: a picture, a table, or text."""
    data = output.get("data", {})
    if "image/png" in data:
        return [f'<img alt="figure" src="data:image/png;base64,{data["image/png"]}">']
    if "text/html" in data:
        table = "".join(data["text/html"])
        table = re.sub(r"<style.*?</style>", "", table, flags=re.DOTALL)
        table = re.sub(r"<table[^>]*>", "<table>", table)  # as tables of the site look and scroll
        return [re.sub(r"\n\s*", "", table)]
    return ["```text", "".join(output.get("text") or data.get("text/plain", "")).rstrip(), "```"]


def notebook_page(path: Path) -> str:
    """The cells of a notebook as a page."""
    lines = []
    for cell in json.loads(path.read_text())["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines += [text, ""]
            continue
        lines += ["```python", text, "```", ""]
        for output in cell["outputs"]:
            lines += [*_shown(output), ""]
    return "\n".join([*lines, f"As a notebook: [{path.name}]({path.name}).", ""])
