"""A report: sections of text, tables and figures, as one HTML file that opens from disk."""

import base64
import csv
import hashlib
import io
import os
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib import metadata, resources
from pathlib import Path
from typing import ClassVar

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from sma_bench import border
from sma_bench.errors import InputError, errors_in
from sma_bench.installation import VERSION
from sma_bench.progress import Report, in_turn, silent
from sma_bench.report import drawing
from sma_bench.report.drawing import COLUMNS, CURVE_HEADER, PaperColumn
from sma_bench.report.tables import Table
from sma_bench.results import TEMPLATES, Card

_PAGE, _LARGEST_PAGE = "index.html", 1 << 30  # bytes
_MARK = b'<meta name="generator" content="sma_bench">'


@dataclass(frozen=True)
class Picture:
    """A figure with its file name, title and caption (equation and data source); with `over_time`
    the page's script redraws it, with readings under the pointer."""

    name: str
    title: str
    caption: str
    figure: Figure
    over_time: bool = False

    kind: ClassVar[str] = "png"

    @cached_property
    def content(self) -> bytes:
        """The figure as a PNG file; cached, because drawing is slow."""
        return self._file(self.figure, "png")

    def files(self, column: PaperColumn) -> dict[str, bytes]:
        """SVG and PDF in the width of a column (text stays text), and the curves as CSV."""
        shown = drawing.in_column(self.figure, column)
        kinds = ("svg", "pdf", "csv") if drawing.curve_rows(self.figure) else ("svg", "pdf")
        return {f"{self.name}.{kind}": self._file(shown, kind) for kind in kinds}

    def save(self, path: str | Path, column: PaperColumn = COLUMNS["double"]) -> None:
        """Write PNG, SVG or PDF in a column's width, or CSV. InputError: suffix, or no access."""
        path = Path(path)
        kind = path.suffix[1:].lower()
        if kind not in ("png", "svg", "pdf", "csv"):
            raise InputError(f"{path}: expected a name that ends in .png, .svg, .pdf or .csv")
        if kind == "csv" and not drawing.curve_rows(self.figure):
            raise InputError(f"{path}: {self.name} has no curves, expected .png, .svg or .pdf")
        content = self._file(drawing.in_column(self.figure, column), kind, dpi=300)
        with errors_in(f"{path}: cannot be written"):
            border.write_files({path: content})

    def _repr_png_(self) -> bytes:
        return self.content

    def _file(self, figure: Figure, kind: str, dpi: float = 130) -> bytes:
        """PNG, SVG or PDF, or the curves as CSV."""
        if kind == "csv":
            return csv_text(Table(CURVE_HEADER, drawing.curve_rows(figure)))
        buffer = io.BytesIO()
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": self.name, "pdf.fonttype": 42}):
            figure.savefig(buffer, format=kind, dpi=dpi, metadata=dates.get(kind))
        return buffer.getvalue()


@dataclass(frozen=True)
class Drawing:
    """An SVG drawing that ships with the package; it has no fixed size."""

    name: str
    title: str
    caption: str
    content: bytes

    over_time: ClassVar[bool] = False
    kind: ClassVar[str] = "svg"


@cache
def captions() -> dict[str, dict[str, str]]:
    """Title, caption, and origin of synthetic data, by figure."""
    found: dict[str, dict[str, str]] = border.read_yaml(Path(__file__).with_name("captions.yaml"))
    return found


def pictured(key: str, figure: Figure, name: str = "", over_time: bool = False,
             **facts: object) -> Picture:
    """A figure with title and caption from `key` in captions.yaml, filled in with `facts`."""
    title, caption = (captions()[key][part].format(**facts) for part in ("title", "caption"))
    return Picture(name or key, title, caption, figure, over_time)


@dataclass(frozen=True)
class Section:
    """The contents below a heading, card first; of `folded` only the first line shows at once."""

    title: str
    paragraphs: Sequence[str] = ()
    notes: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture | Drawing] = ()
    card: Card | None = None
    folded: Sequence[str] = ()


@dataclass(frozen=True)
class Made:
    """Provenance of a page: the command as typed, and its inputs, which are hashed."""

    command: str = ""
    inputs: Sequence[str] = ()
    when: datetime = field(default_factory=lambda: datetime.now(UTC))


def write_report(directory: str | Path, title: str, summary: str, sections: Sequence[Section],
                 made: Made | None = None, *, column: PaperColumn | None = None,
                 report: Report = silent) -> Path:
    """Write `index.html` (self-contained, all text escaped) and one PNG per figure; its path. All
    files are written, or none; an existing report is replaced as a whole, other files are kept.
    `made` adds the date to the summary, and a last section with the hashes of the inputs. With
    `column`, every figure is also written as SVG and PDF, and its curves and the named tables as
    CSV. `report` is called for each figure. Raises InputError: the folder cannot be written or has
    a foreign file of the same name, an input is gone, or another report is being written there."""
    directory = Path(directory)
    with border.claimed(os.path.realpath(directory), "being written as a report already"):
        if made is not None:
            summary = f"{summary} {made.when:%Y-%m-%d}, sma_bench {VERSION}.".strip()
            sections = [*sections, _provenance(made)]
        pictures = [picture for section in sections for picture in section.pictures]
        files = {}
        for picture in in_turn(pictures, report, lambda p: p.title):
            files[f"{picture.name}.{picture.kind}"] = picture.content
            if column is not None and isinstance(picture, Picture):
                files |= picture.files(column)
        if column is not None:
            tables = [t for section in sections for t in section.tables if t.name]
            files |= {f"{table.name}.csv": csv_text(table) for table in tables}
        # The page loads nothing from elsewhere and runs no script but its own, by its hash.
        own = base64.b64encode(hashlib.sha256(drawing.script().encode()).digest()).decode("ascii")
        script = drawing.script() if any(picture.over_time for picture in pictures) else ""
        style = resources.files("sma_bench.dashboard").joinpath("uPlot.min.css").read_text("utf-8")
        page = _template().render(title=title, summary=summary, sections=sections, own=own,
                                  curves_of=drawing.curves_of, plot_style=style, script=script)
        _write_together(directory, {**files, _PAGE: page.encode("utf-8")})
        return directory / _PAGE


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        # Names from files may contain control characters.
        finalize=lambda shown: border.printable(shown, "\n").replace(" +- ", " ± ")
        if type(shown) is str else shown)
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode("ascii")
    return environment.get_template("page.html.j2")


def csv_text(table: Table) -> bytes:
    """A table as a CSV file; no text is taken for a formula by a spreadsheet."""
    text = io.StringIO()
    rows = [map(border.csv_cell, row) for row in (table.header, *table.rows)]
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8")


def _write_together(directory: Path, files: Mapping[str, bytes]) -> None:
    """Write all files, or leave the folder as it was."""
    new, page, is_report = not os.path.exists(directory), directory / _PAGE, False
    with suppress(InputError, OSError):
        is_report = page.exists() and _MARK in border.read_bytes(page, _LARGEST_PAGE)
    if foreign := [] if is_report else [n for n in files if os.path.exists(directory / n)]:
        raise InputError(f"{directory}: holds {foreign[0]}, which is not part of a report of "
                         "sma-bench; expected another folder")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        border.write_files({directory / name: content for name, content in files.items()})
    except OSError as error:
        if new and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()
        raise InputError(f"{directory}: cannot write the report: {error.strerror}") from None


def digest(path: Path) -> tuple[str, int]:
    """SHA-256 and size in bytes of a file, or of all names and files inside a folder. Raises
    InputError: a file cannot be read."""
    total, size = hashlib.sha256(), 0
    with errors_in(f"{path}: cannot be read"):
        inside = sorted(p for p in path.rglob("*") if p.is_file() and border.is_inside(p, path))
        for part in inside if path.is_dir() else [path]:
            size += part.stat().st_size
            if path.is_dir():
                head = f"{part.relative_to(path)}\0{part.stat().st_size}\0"
                total.update(head.encode("utf-8", "surrogateescape"))
            with part.open("rb") as stream:
                hashlib.file_digest(stream, lambda: total)
    return total.hexdigest(), size


@cache
def versions() -> dict[str, str]:
    """Versions of this package, the numerical libraries, Python and the system."""
    found = {"sma_bench": VERSION, "Python": platform.python_version()}
    for name in ("numpy", "scipy", "numba", "matplotlib", "rosbags"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found | {"system": f"{platform.system()} {platform.machine()}"}


def _provenance(made: Made) -> Section:
    """The last section: files with their hashes, versions and the command."""
    rows = [(path, *map(str, digest(Path(path)) if Path(path).exists() else ("not a file", 0)))
            for path in dict.fromkeys(made.inputs)]
    when = made.when.astimezone().isoformat(timespec="seconds")
    about = {"command": made.command, "made": when, **versions()}
    files = Table(("file", "SHA-256", "bytes"), rows, frozenset({2}), "provenance_files", "Files")
    by = Table(("", ""), list(about.items()), frozenset(), "provenance_versions", "Made by")
    text = "Made from the package's own numbers; no file was read." if not rows else (
        "A folder's hash covers the names, sizes and contents of its files in alphabetical order.")
    return Section("Provenance", [text], tables=[files, by] if rows else [by])
