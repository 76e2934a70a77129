"""The part of a report that shows one record as it was measured, with its pictures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from sma_bench.records import DscRecord, Record, Signal, describe
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.courses import thinned
from sma_bench.report.drawing import FAINT, drawable, new_figure
from sma_bench.report.page import Picture, Section, Table

# --- Pictures of what a record holds, before anything is made of it.

Array = NDArray[np.float64]

_COLOURS = ("#1f4e79", "#c0504d", "#2e7d32", "#7b4ea3", "#e08214", "#4a4a4a")
MOST_POINTS = 3000
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
            t, v = thinned(time, drawable(row.factor * values), MOST_POINTS)
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
