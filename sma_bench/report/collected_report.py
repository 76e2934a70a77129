"""Sections of a collected report: records, results of other commands, and what it was made of."""

import hashlib
import math
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from sma_bench import __version__
from sma_bench.border import is_inside
from sma_bench.cards import verdict_card
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME, TABLE
from sma_bench.records import DscRecord, Record, Signal, describe, open_record
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.diagnosis_figures import STAGE_COLOURS
from sma_bench.report.diagnosis_words import result_tables
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, drawable, new_figure, thinned
from sma_bench.report.page import Picture, Section, Table
from sma_bench.results import DiagnoseResult, IdentifyResult, Number, read_result

Array = NDArray[np.float64]


# --- Each input, and all together.

_RESULT = ".json"


@dataclass(frozen=True)
class Shown:
    """One input: what it is, its sentence in the summary, its section, and what to beware of."""

    path: str
    kind: str
    said: str
    section: Section
    warnings: Sequence[str]
    sha256: str
    size: int


def shown_input(path: str, number: int, namespace: str | None) -> Shown:
    """Read one input.

    Raises:
        InputError: it is neither a record nor a result.
    """
    name = f"input_{number}"
    if path.endswith(_RESULT):
        result = read_result(path)
        if isinstance(result, IdentifyResult):
            kind, (section, said) = "identification", identify_section(result, name)
        else:
            kind, (section, said) = "diagnosis", diagnose_section(result, name)
        worth = [f"{path}: {text}" for text in result.warnings if not text.startswith("info:")]
    else:
        record = open_record(path, namespace)
        kind = "bag" if isinstance(record, Record) else "instrument file"
        section, said, worth = record_section(record, name)
    return Shown(path, kind, said, section, worth, *digest(Path(path)))


def summary_section(shown: Sequence[Shown]) -> Section:
    """A line an input, and below it all their warnings."""
    rows = [(str(k), one.path, one.kind, one.said) for k, one in enumerate(shown, 1)]
    warnings = [text for one in shown for text in one.warnings]
    table = Table(("", "input", "kind", "what it says"), rows, frozenset({0}), "summary")
    said = f"{len(warnings)} warnings." if warnings else "No warnings."
    return Section("Summary", [said], warnings, [table])


def counted(shown: Sequence[Shown]) -> str:
    """How many of each kind: "2 bags, 1 diagnosis"."""
    kinds = [one.kind for one in shown]
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items())


def document(shown: Sequence[Shown], command: str, page: Path) -> dict[str, Any]:
    """The page's inputs as plain data."""
    return {
        "inputs": [
            {"path": one.path, "kind": one.kind, "says": one.said, "sha256": one.sha256,
             "bytes": one.size, "warnings": list(one.warnings)}
            for one in shown
        ],
        "command": command, "versions": versions(), "page": str(page),
    }  # fmt: skip


# --- Pictures of what a record holds, before anything is made of it.

_COLOURS = ("#1f4e79", "#c0504d", "#2e7d32", "#7b4ea3", "#e08214", "#4a4a4a")
_MOST_DRAWN = 3000
_MOST_MARKERS = 40


class _Row(NamedTuple):
    """One quantity of a bag: unit on paper, and the factor from SI to it."""

    quantity: str
    unit: str
    factor: float


_ROWS = (
    _Row("voltage_command", "V", 1.0),
    _Row("voltage", "V", 1.0),
    _Row("current", "A", 1.0),
    _Row("temperature", "K", 1.0),
    _Row("deflection", "mm", 1e3),
    _Row("range", "mm", 1e3),
    _Row("elongation", "mm", 1e3),
    _Row("force", "N", 1.0),
)


def bag_picture(record: Record, name: str) -> Picture | None:
    """Every signal over time, a row a quantity; None where the bag has none.

    Long signals are drawn by the least and the largest sample of each stretch of time.
    """
    found = [(row, chosen) for row in _ROWS if (chosen := _signals(record, row.quantity))]
    if not found:
        return None
    figure, axes = new_figure(len(found), height=1.0 + 1.5 * len(found))
    drawn = []
    for ax, (row, signals) in zip(axes, found, strict=True):
        curves = [curve for signal in signals for curve in _curves(signal)]
        for k, (label, time, values) in enumerate(curves):
            t, v = thinned(time, drawable(row.factor * values), _MOST_DRAWN)
            colour = _COLOURS[k % len(_COLOURS)]
            ax.plot(t, v, lw=0.9, color=colour, label=label.rpartition(".")[0] or label)
            drawn += [(label, row.unit, f"{a:.6f}", f"{b:.8g}") for a, b in zip(t, v, strict=True)]
        ax.set_ylabel(f"{row.quantity.replace('_', ' ')}\n[{row.unit}]")
        if len(curves) > 1:
            ax.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    _mark(axes, record.markers)
    axes[-1].set_xlabel("time since the start of the record [s]")
    caption = f"All signals of {record.path}; vertical lines: steps of the protocol."
    table = Table(("signal", "unit", "time_s", "value"), drawn)
    return Picture(name, "Signals over time", caption, plain(figure), table, True)


def dsc_picture(record: DscRecord, name: str) -> Picture | None:
    """Heat flow over temperature of every scan; None where there is none."""
    scans = [s for s in record.segments if s.kind != "isothermal"]
    if not scans:
        return None
    curves = [
        (f"{s.number} {s.kind}", s.temperature, 1e-3 * record.specific_heat_flow(s)) for s in scans
    ]
    return _loops(name, "Heat flow", curves, "heat flow [W/g], the file's sign", str(record.path))


def isobaric_picture(record: IsobaricRecord, name: str) -> Picture:
    """Strain over temperature of every branch."""
    relative = record.strain_unit == "relative"
    curves = [
        (f"cycle {cycle.number} {branch.direction}", branch.temperature,
         (1.0 if relative else 100.0) * branch.strain)
        for cycle in record.cycles for branch in cycle.branches
    ]  # fmt: skip
    label = "strain over its range" if relative else "strain [%]"
    title = f"Strain at {record.stress / 1e6:.1f} MPa"
    return _loops(name, title, curves, label, str(record.path))


def tensile_picture(record: TensileRecord, name: str) -> Picture:
    """Stress over strain."""
    curves = [("test", 100.0 * record.strain, record.stress / 1e6)]
    return _loops(
        name, "Stress against strain", curves, "stress [MPa]", str(record.path), "strain [%]"
    )


def plain(figure: Figure) -> Figure:
    """Names from files are no formulas: a dollar sign stays one."""
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
    return figure


def _signals(record: Record, quantity: str) -> list[Signal]:
    return [
        signal for name, signal in record.signals.items()
        if name.rpartition(".")[2] == quantity and len(signal)
    ]


def _curves(signal: Signal) -> Iterable[tuple[str, Array, Array]]:
    if signal.values.ndim == 1:
        yield signal.name, signal.time, signal.values
        return
    for k in range(signal.values.shape[1]):
        yield f"{signal.name}[{k}]", signal.time, signal.values[:, k]


def _mark(axes: Sequence[Axes], markers: Sequence[tuple[float, str]]) -> None:
    if len(markers) > _MOST_MARKERS:
        return
    for time, text in markers:
        for ax in axes:
            ax.axvline(time, color=FAINT, lw=0.6, ls=":")
        axes[0].annotate(
            text, (time, 1.0), xycoords=("data", "axes fraction"), fontsize=6, rotation=30,
            color=FAINT, annotation_clip=True,
        )


def _loops(
    name: str, title: str, curves: Sequence[tuple[str, Array, Array]], label: str, source: str,
    across: str = "temperature [K]",
) -> Picture:
    figure, (ax,) = new_figure(height=4.2)
    drawn = []
    for k, (what, x, y) in enumerate(curves):
        ax.plot(drawable(x), drawable(y), lw=1.0, color=_COLOURS[k % len(_COLOURS)], label=what)
        drawn += [(what, f"{a:.8g}", f"{b:.8g}") for a, b in zip(x, y, strict=True)]
    ax.set(xlabel=across, ylabel=label)
    if len(curves) > 1:
        ax.legend(fontsize=7, ncols=2)
    return Picture(name, title, source, plain(figure), Table(("curve", across, label), drawn))


# --- The part of a report that shows one record as it was measured.

_Columns = Sequence[tuple[str, str, str]]

# Heading with its unit, key of `describe`, format.
_SIGNALS: _Columns = (
    ("signal", "name", ""), ("unit", "unit", ""), ("samples", "samples", "d"),
    ("rate [Hz]", "rate", ".4g"), ("jitter [s]", "jitter", ".2g"),
    ("longest gap [s]", "longest_gap", ".3g"), ("delay [s]", "delay", ".3g"),
    ("min", "min", ".5g"), ("mean", "mean", ".5g"), ("max", "max", ".5g"),
)  # fmt: skip
_SEGMENTS: _Columns = (
    ("segment", "number", "d"), ("kind", "kind", ""), ("rate [K/s]", "rate", ".4f"),
    ("samples", "samples", "d"), ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
)  # fmt: skip
_BRANCHES: _Columns = (
    ("cycle", "cycle", "d"), ("kind", "kind", ""), ("samples", "samples", "d"),
    ("from [K]", "from", ".2f"), ("to [K]", "to", ".2f"),
    ("strain from", "strain_from", ".5f"), ("strain to", "strain_to", ".5f"),
)  # fmt: skip
_TABLE_ROWS: dict[str, tuple[str, _Columns]] = {
    "bag": ("signals", _SIGNALS), "dsc": ("segments", _SEGMENTS),
    "isobaric": ("branches", _BRANCHES),
}  # fmt: skip
_SAID: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "bag": lambda d: (
        f"{d['duration']:.1f} s from {d['start']}, channels: {', '.join(d['channels']) or 'none'}, "
        f"{len(d['signals'])} signals, {len(d['markers'])} markers"
    ),
    "dsc": lambda d: f"{d['instrument']}, {d['sample']}, {d['mass'] * 1e6:.3f} mg",
    "isobaric": lambda d: f"isobaric test at {d['stress'] / 1e6:.1f} MPa",
    "tensile": lambda d: (
        f"tensile test, {d['samples']} samples, to {d['largest_strain']:.4f} strain and "
        f"{d['largest_stress'] / 1e6:.1f} MPa"
    ),
}


def record_section(record: AnyRecord, name: str) -> tuple[Section, str, list[str]]:
    """Heading, tables and figure of a record.

    Args:
        record: already read.
        name: that its files begin with.

    Returns:
        The section, a sentence for the summary, and what should be known before it is trusted.
    """
    described = describe(record)
    kind = described["kind"]
    said = _SAID[kind](described)
    tables = []
    if kind in _TABLE_ROWS:
        key, columns = _TABLE_ROWS[kind]
        tables.append(_table(described[key], columns, f"{name}_{key}", key.capitalize()))
    findings = described["findings"]
    lines = [f"{f['severity']}: {f['subject']}: {f['text']}" for f in findings]
    worth = [
        f"{record.path}: {f['subject']}: {f['text']}" for f in findings if f["severity"] != "info"
    ]
    picture = _picture(record, name)
    section = Section(
        f"Record {record.path}", [f"{said}."], lines, tables, [picture] if picture else []
    )
    return section, said, worth


def _picture(record: AnyRecord, name: str) -> Picture | None:
    if isinstance(record, Record):
        return bag_picture(record, f"{name}_signals_over_time")
    if isinstance(record, DscRecord):
        return dsc_picture(record, f"{name}_heat_flow")
    if isinstance(record, IsobaricRecord):
        return isobaric_picture(record, f"{name}_strain")
    return tensile_picture(record, f"{name}_stress")


def _table(rows: Sequence[Mapping[str, Any]], columns: _Columns, name: str, title: str) -> Table:
    cells = [[_cell(row[key], form) for _, key, form in columns] for row in rows]
    numeric = frozenset(k for k, (_, _, form) in enumerate(columns) if form)
    return Table([heading for heading, _, _ in columns], cells, numeric, name, title)


def _cell(value: Any, form: str) -> str:
    return "" if value is None else format(value, form)


# --- The parts of a report that show result files of `identify` and `diagnose`.

_LEAST_SHOWN = 0.005
_MOST_BARS = 12
_NUMBER_HEADER = ("parameter", "value", "standard error", "unit", "points", "method")


def identify_section(result: IdentifyResult, name: str) -> tuple[Section, str]:
    """Numbers with their errors, and where they lie to the parameter table's.

    Returns:
        The section and a sentence for the summary.
    """
    tables = [_number_table(result.parameters, f"{name}_parameters", "Parameters")]
    for k, (title, source, numbers) in enumerate(result.experiments, 1):
        tables.append(_number_table(numbers, f"{name}_experiment_{k}", f"{title}, from {source}"))
    picture = _comparison(result, f"{name}_comparison")
    section = Section(
        f"Identification {result.path}", [], result.warnings, tables,
        [picture] if picture else [],
    )
    done = ", ".join(dict.fromkeys(title.split()[0] for title, _, _ in result.experiments))
    return section, f"{len(result.parameters)} parameters identified by {done or 'no experiment'}"


def diagnose_section(result: DiagnoseResult, name: str) -> tuple[Section, str]:
    """Verdict, candidates, where, and how far the gap shrinks.

    Returns:
        The section and a sentence for the summary.
    """
    said = verdict(result)
    tables = [
        Table(t.header, t.rows, t.numeric, f"{name}_{t.name}", t.title)
        for t in result_tables(result)
    ]
    pictures = [_bars(result, f"{name}_candidates")]
    if result.chain:
        pictures.append(_chain_picture(result, f"{name}_chain"))
    section = Section(
        f"Diagnosis {result.path}", result.why, result.warnings, tables, pictures,
        verdict_card(result),
    )
    return section, said


def verdict(result: DiagnoseResult) -> str:
    """Verdict, cause and the probability of the first candidate, in one line."""
    cause = f" {' and '.join(result.cause)}" if result.cause else ""
    stage = f", {result.stage} stage" if result.stage and result.cause else ""
    first = result.candidates[0] if result.candidates else None
    sure = f" ({first.name} has probability {100 * first.probability:.0f} %)" if first else ""
    return f"{result.verdict}{cause}{stage}{sure}"


def _number_table(numbers: Sequence[Number], name: str, title: str) -> Table:
    rows = [
        (n.name, f"{n.value:.6g}", f"{n.std:.2g}", n.unit, str(n.n) if n.n else "", n.method)
        for n in numbers
    ]
    return Table(_NUMBER_HEADER, rows, frozenset({1, 2, 4}), name, title)


def _comparison(result: IdentifyResult, name: str) -> Picture | None:
    """Deviation from the table's defaults in percent, with one and two standard errors."""
    shown = [(n, default) for n in result.parameters if (default := _default(n))]
    if not shown:
        return None
    figure, (ax,) = new_figure(height=1.2 + 0.32 * len(shown))
    place = np.arange(len(shown))[::-1]
    off = [100.0 * (n.value / default - 1.0) for n, default in shown]
    error = [100.0 * abs(n.std / default) for n, default in shown]
    ax.errorbar(off, place, xerr=2.0 * np.array(error), fmt="none", ecolor=FAINT, elinewidth=1.0)
    ax.errorbar(off, place, xerr=error, fmt="o", color=MEASURED, elinewidth=2.5, ms=4)
    ax.axvline(0.0, color=MODEL, lw=1.0, ls="--")
    assumed = [BY_NAME[n.name].provenance.startswith("assumed") for n, _ in shown]
    labels = [f"{n.name} *" if a else n.name for (n, _), a in zip(shown, assumed, strict=True)]
    ax.set_yticks(place, labels, fontsize=8)
    ax.set_ylim(-0.6, len(shown) - 0.4)
    ax.set_xlabel("off the parameter table [%], one and two standard errors")
    drawn = [
        (n.name, f"{default:.6g}", f"{n.value:.6g}", f"{n.std:.2g}", n.unit)
        for n, default in shown
    ]
    caption = (
        "Reference: the default of docs/parameters.md, which is the paper's where it gives one; "
        "marked *: assumed."
    )
    table = Table(("parameter", "reference", "identified", "standard error", "unit"), drawn)
    return Picture(name, "Identified against the parameter table", caption, plain(figure), table)


def _default(number: Number) -> float:
    """0 where there is nothing to compare with."""
    known = BY_NAME.get(number.name)
    finite = math.isfinite(number.value) and math.isfinite(number.std) and number.std >= 0.0
    return float(known.default) if finite and known and isinstance(known.default, float) else 0.0


def _bars(result: DiagnoseResult, name: str) -> Picture:
    shown = [c for c in result.candidates if c.probability >= _LEAST_SHOWN][:_MOST_BARS]
    figure, (ax,) = new_figure(height=1.2 + 0.32 * max(len(shown), 1))
    place = np.arange(len(shown))[::-1]
    colours = [STAGE_COLOURS.get(c.stage, FAINT) for c in shown]
    ax.barh(place, [c.probability for c in shown], color=colours, height=0.7)
    for y, c in zip(place, shown, strict=True):
        label = f"{c.probability:.3f}" + (f"  {c.stage}" if c.stage else "")
        ax.text(c.probability + 0.01, y, label, va="center", fontsize=8)
    ax.set_yticks(place, [c.name for c in shown], fontsize=8)
    ax.set(xlabel="probability", xlim=(0.0, 1.3), xticks=np.linspace(0.0, 1.0, 6))
    drawn = [(c.name, c.stage, f"{c.probability:.6g}") for c in shown]
    table = Table(("candidate", "stage", "probability"), drawn)
    return Picture(name, "Candidates", f"From {result.path}.", plain(figure), table)


def _chain_picture(result: DiagnoseResult, name: str) -> Picture:
    figure, (ax,) = new_figure(height=1.2 + 0.4 * len(result.chain))
    place = np.arange(len(result.chain))[::-1]
    gap = np.array([link[1] for link in result.chain])
    low, high = (np.array([link[k] for link in result.chain]) for k in (2, 3))
    error = np.maximum([gap - low, high - gap], 0.0)
    ax.errorbar(gap, place, xerr=error, fmt="o", color=MEASURED, capsize=4)
    ax.axvline(0.0, color=FAINT, lw=0.8)
    ax.set_yticks(place, [link[0] for link in result.chain], fontsize=8)
    ax.set_ylim(-0.6, len(result.chain) - 0.4)
    ax.set_xlabel("gap over noise, 90 % interval")
    drawn = [(b, *(f"{x:.6g}" for x in numbers)) for b, *numbers in result.chain]
    table = Table(("block", "gap over noise", "5 %", "95 %"), drawn)
    caption = "Each block of the model driven by what was measured before it."
    return Picture(name, "Where the chain breaks", caption, plain(figure), table)


# --- What a report was made of: files with their hashes, versions, parameters, the command.

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
    found = {"sma_bench": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found | {"system": f"{platform.system()} {platform.machine()}"}


def provenance_section(
    digests: Sequence[tuple[str, str, int]], command: str, made: datetime
) -> Section:
    """Files, versions and the command.

    Args:
        digests: path, SHA-256 and bytes of every input.
        command: as typed; made: when.
    """
    files = [(path, sha, f"{size}") for path, sha, size in digests]
    about = {
        "command": command, "made": made.astimezone().isoformat(timespec="seconds"), **versions()
    }
    return Section(
        "Provenance",
        ["A folder's hash covers the names, sizes and contents of its files in alphabetical "
         "order."],
        tables=[
            Table(("file", "SHA-256", "bytes"), files, frozenset({2}), "provenance_files", "Files"),
            Table(("", ""), list(about.items()), frozenset(), "provenance_versions",
                  "Made by"),
        ],
    )  # fmt: skip


def parameter_section(parameters: Parameters, path: str) -> Section:
    """The parameters that were given, with their uncertainties."""
    rows = []
    for p in TABLE:
        if p.name not in parameters.given:
            continue
        value = parameters[p.name]
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        known = p.uncertainty is not None or p.name in parameters.given_uncertainty
        rows.append((p.name, shown, f"{parameters.std(p.name):.2g}" if known else "", p.unit))
    header = ("parameter", "value", "standard deviation", "unit")
    table = Table(header, rows, frozenset({1, 2}), "parameters")
    return Section("Parameters", [f"As given in {path}; all others as in docs/parameters.md."],
                   tables=[table])  # fmt: skip
