"""The documentation builds as a site, strictly, and what the code tells is on it."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sma_bench import api
from sma_bench.cli import COMMANDS
from sma_bench.parameters.node_tables import NODE_TABLES

ROOT = Path(__file__).resolve().parents[2]
MISSING = [n for n in ("mkdocs", "material", "mkdocstrings") if importlib.util.find_spec(n) is None]

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(MISSING), reason="no tools for a site")]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "examination.check", "docs", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() == str(folder / "index.html")
    return folder


def text_of(page):
    return re.sub(r"<[^>]*>", "", page.read_text())


def test_every_page_of_docs_is_on_the_site(site):
    pages = [p.relative_to(ROOT / "docs") for p in (ROOT / "docs").rglob("*.md")]
    assert len(pages) > 25
    for page in pages:
        name = "index" if page.name == "README.md" else page.stem
        assert (site / page.with_name(f"{name}.html")).is_file(), page
    tabs = re.findall(r'<li class="md-tabs__item.*?</li>', (site / "index.html").read_text(), re.S)
    titles = [re.sub(r"<[^>]*>", "", tab).strip() for tab in tabs]
    assert "Explanation" in titles and "More" not in titles  # every page has its place
    # Nothing is fetched from elsewhere.
    fetched = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="https?://', re.I)
    assert [p.name for p in sorted(site.rglob("*.html")) if fetched.search(p.read_text())] == []


def test_commands_nodes_and_functions_are_what_the_package_says_of_them(site):
    page = text_of(site / "reference" / "commands.html")
    assert [name for name in COMMANDS if f"Usage: sma-bench {name}" not in page] == []
    assert "--hold-out RECORD" in page
    page = (site / "reference" / "nodes.html").read_text().replace("<wbr>", "")
    parts = re.split(r'<h2 id="(\w+)"[^\n]*\n', page)[1:]
    nodes = dict(zip(parts[::2], parts[1::2], strict=True))
    assert list(nodes) == list(NODE_TABLES)
    for node, table in NODE_TABLES.items():
        first = re.search(r"<p>(.*?)</p>", nodes[node])
        assert first and len(first[1]) > 30, f"nothing is said of {node}"
        assert all(f"<code>{parameter.name}</code>" in nodes[node] for parameter in table)
    assert "~/enable" in nodes["serial_bridge"] and "voltage_command" in nodes["experiment"]
    python = text_of(site / "reference" / "python.html")
    assert [said for said in (*api.__all__, "Raises InputError") if said not in python] == []


def test_pages_have_their_equations_notebook_and_tables(site):
    # Equations in the page itself, with their source to be read aloud.
    for page, least in (("explanation/model", 9), ("effects", 17), ("diagnosis", 3)):
        text = (site / f"{page}.html").read_text()
        assert len(re.findall(r'<svg role="img" aria-label="[^"]{8,}"', text)) >= least
        assert "language-math" not in text
    errata = text_of(site / "explanation" / "errata.html")
    assert len(re.findall(r"^\s*\d+\. ", errata, re.MULTILINE)) >= 11 and "N m²" in errata
    # The notebook is a page, whose tables scroll as all do, and a file; sources are neither.
    assert json.loads((site / "tutorials" / "notebook.ipynb").read_text())["nbformat"] == 4
    notebook = site / "tutorials" / "notebook.html"
    assert "sma_bench.diagnose" in text_of(notebook) and "wire.resistance" in text_of(notebook)
    assert "dataframe" not in notebook.read_text() and not (site / "site").exists()
