"""The paper redrawn as one page: figures, tables next to identified numbers, errata."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.rig import find_rig
from sma_bench.findings import Finding
from sma_bench.identify.result import Experiment
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS
from sma_bench.physics import simulate
from sma_bench.records.record import Record, drive_of
from sma_bench.report import experiment_figures as draw
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, new_figure
from sma_bench.report.page import Drawing, Picture, Section, captions, pictured
from sma_bench.report.tables import Table
from sma_bench.synthetic.paper_specimens import DSC_CYCLES

_OFF, _REST = 0.02, 1.0  # a rest of the composite: at most, of the largest voltage; at least, s
_PAGE: dict[str, Any] = read_yaml(Path(__file__).with_name("page.yaml"))


class Erratum(NamedTuple):
    """One of errata.yaml."""

    number: int  # 1 to 19
    place: str  # in the paper
    printed: str  # in words or as a formula
    corrected: str
    lines: tuple[tuple[str, ...], ...]  # quantity, printed, corrected and independently checked
    remark: str  # consequences


def paper_errata() -> list[Erratum]:
    items = read_yaml(Path(__file__).with_name("errata.yaml")).items()
    return [Erratum(number, **item | {"lines": tuple(map(tuple, item.get("lines", ())))})
            for number, item in items]


class ExperimentResults(NamedTuple):
    """Results of one kind of experiment: per record, and estimates combined over all records."""

    experiments: tuple[Experiment, ...]
    estimates: dict[str, Estimate]
    synthetic: bool


@dataclass(frozen=True)
class Row:
    """A number of the paper (of tables.yaml) and, where a record gave it, the identified one."""

    symbol: str
    description: str
    unit: str
    printed: float  # in `unit`, NaN where none is printed
    printed_std: float
    kind: str
    name: str
    scale: float = 1.0
    reason: str = ""  # why synthetic data give another number
    estimate: Estimate | None = None  # None where it was not identified
    synthetic: bool = False  # identified from synthetic data
    source: str = ""  # its records, or why it was not identified

    @property
    def value(self) -> float:
        """The identified number in the unit of the table, NaN if none; `std`: its error."""
        return self.estimate.value * self.scale if self.estimate else math.nan

    @property
    def std(self) -> float:
        return self.estimate.std * self.scale if self.estimate else math.nan

    @property
    def cells(self) -> tuple[str, str, str]:
        """The paper's number with its deviation, the identified one, its error to two digits."""
        std = "" if math.isnan(self.printed_std) else f" ± {self.printed_std:g}"
        paper = "none" if math.isnan(self.printed) else f"{self.printed:g}{std}"
        if self.estimate is None:
            return paper, "", ""
        decimals = max(1 - math.floor(math.log10(self.std)), 0) if self.std > 0.0 else 4
        return paper, f"{self.value:.{decimals}f}", f"{self.std:.{decimals}f}"

    @property
    def origin(self) -> str:
        """Experiment and origin of its data; for synthetic data, why the number differs."""
        if self.estimate is None:
            return self.source
        data = "synthetic" if self.synthetic else "record given"
        why = f"; {self.reason}" if self.synthetic and self.reason else ""
        return f"{self.kind.partition(' ')[0]}, {data}{why}"


def _tables() -> dict[str, tuple[str, list[Row]]]:
    found: dict[str, tuple[str, list[Row]]] = {}
    for table, content in read_yaml(Path(__file__).with_name("tables.yaml")).items():
        found[table] = content["title"], []
        for row in content["rows"]:
            # A row without a printed value shows the default of its parameter.
            value, std = row.pop("printed", None), row.pop("std", math.nan)
            if value is None:
                known, scale = BY_NAME[row["name"]], row.get("scale", 1.0)
                std = scale * (known.uncertainty or 0.0) if std is True else std
                value = scale * known.default  # type: ignore[operator]
            found[table][1].append(Row(printed=value, printed_std=std, **row))
    rows, loaded = found["table_2"][1], "E6, under a held load, stress free"
    rows += [Row(symbol, f"heat cycle {k}", "K", value, math.nan, "E5", f"cycle {k}, *: {symbol}")
             for k, values in enumerate(DSC_CYCLES, 1) for symbol, value in values.items()]
    rows += [Row(k, loaded, "K", math.nan, math.nan, "E6", n) for k, n in TRANSITIONS.items()]
    return found


TABLES = _tables()  # title and rows by name, in the order of tables.yaml


def table_rows(name: str, outcomes: Mapping[str, ExperimentResults]) -> list[Row]:
    """Rows of one of TABLES with identified numbers: estimate or first detail of that name."""
    rows = []
    for row in TABLES[name][1]:
        outcome = outcomes.get(row.kind)
        if outcome is None:
            rows.append(replace(row, source="not identified" if row.kind else "taken as given"))
            continue
        head, star, tail = row.name.partition("*")
        details = (estimate for e in outcome.experiments for key, estimate in e.details.items()
                   if (key.startswith(head) and key.endswith(tail) if star else key == head))
        estimate = outcome.estimates.get(row.name) or next(details, None)
        source = "; ".join(dict.fromkeys(e.source for e in outcome.experiments))
        rows.append(replace(row, estimate=estimate, synthetic=outcome.synthetic, source=source))
    return rows


def html_table(name: str, rows: Sequence[Row]) -> Table:
    """Rows as a page shows them, the paper's number next to the identified one."""
    header = ("", "", "paper", "identified", "standard error", "unit", "from")
    cells = [(r.symbol, r.description, *r.cells, r.unit, r.origin) for r in rows]
    return Table(header, cells, frozenset({2, 3, 4}), name)


class CompositeRun(NamedTuple):
    """One record of the composite and its simulation."""

    record: Record  # its source
    time: Array  # (n,) s
    voltage: Array  # (n,) V, front positive and back negative
    simulated: Array  # (n,) m
    measured: tuple[Array, Array]  # time (m,) s and deflection (m,) m
    rests: list[tuple[float, float]]  # (start, stop) s at zero voltage after a drive

    def left_over(self) -> list[list[float]]:
        """Deflection [m] measured and simulated in the last second of every rest with readings."""
        both = (self.measured, (self.time, self.simulated))
        ends = [[values[(time > stop - _REST) & (time <= stop)] for time, values in both]
                for _, stop in self.rests]
        return [[float(np.mean(own)) for own in pair] for pair in ends if all(map(len, pair))]


def composite_run(record: Record, parameters: Parameters) -> CompositeRun:
    """Simulate a record's voltages for comparison with its deflection. `parameters`: of the rig.
    Raises InputError: a channel without voltage, or no deflection."""
    measured = next(m for m in find_rig(record, parameters).measured if m.quantity == "deflection")
    driven, time, voltage, _ = drive_of(record, parameters)
    simulated = simulate(driven, time, voltage).deflection
    front = np.array(parameters["bench.channel_sides"]) == "front"
    forward, back = (voltage[:, of].max(axis=1) if of.any() else 0.0 for of in (front, ~front))
    signed = np.asarray(forward - back)
    off = np.abs(signed) < _OFF * np.abs(signed).max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]]).astype(int)))
    spans = [(float(time[i]), float(time[k - 1])) for i, k in edges.reshape(-1, 2)]
    rests = [span for span in spans[int(off[0]) :] if span[1] - span[0] > _REST]
    found = (measured.time, measured.values)
    return CompositeRun(record, time, signed, simulated, found, rests)


def composite_pictures(runs: Sequence[CompositeRun]) -> tuple[Picture, Picture]:
    """Figs. 15 and 16: voltages, and deflections measured and simulated; a panel a record."""
    source = "; ".join(str(run.record.path) for run in runs)
    volts, above = new_figure(len(runs), 1.0 + 2.1 * len(runs), shared=False)
    bent, below = new_figure(len(runs), 1.0 + 2.4 * len(runs), shared=False)
    for k, (run, upper, lower) in enumerate(zip(runs, above, below, strict=True)):
        time, deflection = run.measured
        upper.plot(run.time, run.voltage, color=MEASURED, lw=1.2)
        lower.plot(time, 1e3 * deflection, color=MEASURED, lw=3, alpha=0.45, label="measured")
        lower.plot(run.time, 1e3 * run.simulated, color=MODEL, lw=1.1, label="simulated")
        for ax, label in ((upper, "voltage [V]"), (lower, "deflection [mm]")):
            for start, stop in run.rests:
                ax.axvspan(start, stop, color=FAINT, alpha=0.13, lw=0)
            ax.axhline(0.0, color=FAINT, lw=0.6)
            ax.set(xlabel="time [s]", ylabel=label)
            ax.set_title(f"({chr(ord('a') + k)})", loc="left", fontsize=10)
    below[0].legend(loc="upper right", fontsize=8)
    left, text = [pair for run in runs for pair in run.left_over()], ""
    if left:
        measured, simulated = 1e3 * np.max(np.abs(left), axis=0)
        text = captions()["figure_16_deflection"]["left_over"].format(
            measured=measured, simulated=simulated)
    return (pictured("figure_15_voltage", volts, source=source),
            pictured("figure_16_deflection", bent, left_over=text, source=source))


def paper_pictures(outcomes: Mapping[str, ExperimentResults], validation: Picture,
                   runs: Sequence[CompositeRun],
                   synthetic: Collection[int]) -> dict[int, list[Picture | Drawing]]:
    """Pictures by figure number of the paper, captions with equation and data source. `validation`:
    Fig. 6; `synthetic`: which of figures 6, 15 and 16 show synthetic data."""
    voltage, deflection = composite_pictures(runs)
    found: dict[int, list[Picture | Drawing]] = {
        number: [_captioned(picture, number in synthetic, number)]
        for number, picture in ((6, validation), (15, voltage), (16, deflection))
    }
    for number, (kind, picture_of) in draw.PAPERS_FIGURES.items():
        found[number] = []
        for k, experiment in enumerate(outcomes[kind].experiments, 1):
            picture = _captioned(picture_of(experiment), outcomes[kind].synthetic, number)
            name = f"{picture.name}_{k}" if k > 1 else picture.name
            found[number].append(replace(picture, name=name))
    for number, name in _PAGE["drawings"].items():
        text, file = captions()[name], Path(__file__).with_name("drawings") / f"{name}.svg"
        caption = f"{text['caption']} Data: none, the numbers are the paper's."
        title = f"Fig. {number}: {text['title']}"
        found[number] = [Drawing(name, title, caption, file.read_bytes())]
    return dict(sorted(found.items()))


def _captioned(picture: Picture, synthetic: bool, number: int = 0) -> Picture:
    """Add figure number, if any, and data source, which is also drawn into the picture."""
    text = "synthetic data" if synthetic else "data: record given"
    picture.figure.axes[0].set_title(text, loc="right", fontsize=8, color=FAINT, style="italic")
    origin = captions()[picture.name]["synthetic"]
    data = f"Data: synthetic ({origin})." if synthetic else "Data: record given."
    caption = f"{picture.caption.rstrip('. ')}. {data}"
    title = f"Fig. {number}: {picture.title}" if number else picture.title
    return replace(picture, title=title, caption=caption)


@dataclass(frozen=True)
class PaperPage:
    """Everything the page shows."""

    outcomes: Mapping[str, ExperimentResults]  # by kind of experiment
    pictures: Mapping[int, Sequence[Picture | Drawing]]  # by figure of the paper
    tables: Mapping[str, Sequence[Row]]  # by name of TABLES
    errata: Sequence[Erratum]
    notes: Sequence[Finding] = ()

    def sections(self) -> list[Section]:
        """Sections in the paper's order, with the warnings of the experiments shown."""
        sections = [Section("", [_PAGE["head"]], [str(note) for note in self.notes])]
        for title, numbers, name in _PAGE["sections"]:
            kinds = {kind for n, (kind, _) in draw.PAPERS_FIGURES.items() if n in numbers}
            findings = dict.fromkeys(f"{finding.subject}: {finding.text}" for kind in kinds
                                     for experiment in self.outcomes[kind].experiments
                                     for finding in experiment.findings
                                     if finding.severity != "info"
                                     or finding.subject == "prestrain")
            title = TABLES[name][0] if name and not numbers else title
            tables = [html_table(name, self.tables[name])] if name else []
            pictures = [picture for number in numbers for picture in self.pictures[number]]
            sections.append(Section(title, notes=[*findings], tables=tables, pictures=pictures))
        # C_A and C_M, which the paper uses but does not give; the errata.
        stresses = self.outcomes["E6 stresses"]
        pictures = [_captioned(draw.stress_temperature_picture(experiment), stresses.synthetic)
                    for experiment in stresses.experiments if draw.has_diagram(experiment)]
        sections.append(Section(_PAGE["stress"], pictures=pictures))
        sections.append(Section("Errata", [_PAGE["errata"]]))
        for e in self.errata:
            header = ("", "as printed", "corrected", "independent check")
            table = Table(header, [("form", e.printed, e.corrected, ""), *e.lines])
            title = f"Erratum {e.number}: {e.place}"
            sections.append(Section(title, tables=[table], notes=[e.remark]))
        return sections

    def to_json(self) -> dict[str, Any]:
        """Tables, errata, captions and remarks."""
        def of_row(row: Row) -> dict[str, Any]:
            found = {"value": row.value, "std": row.std} if row.estimate else None
            return {"quantity": row.symbol, "description": row.description, "unit": row.unit,
                    "paper": row.printed, "synthetic": row.synthetic, "source": row.source,
                    "identified": found}  # fmt: skip

        def of_picture(p: Picture | Drawing) -> dict[str, str]:
            return {"title": p.title, "caption": p.caption, "file": f"{p.name}.{p.kind}"}

        return {"figures": {str(n): [*map(of_picture, own)] for n, own in self.pictures.items()},
                "tables": {name: [*map(of_row, rows)] for name, rows in self.tables.items()},
                "errata": [erratum._asdict() for erratum in self.errata],
                "warnings": [f"{note.subject}: {note.text}" for note in self.notes]}
