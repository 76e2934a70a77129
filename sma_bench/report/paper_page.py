"""The paper redrawn: its figures, tables and errata as one page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import resources

from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.result import Experiment
from sma_bench.parameters.table import (
    BY_NAME,
    DSC_CYCLES,
    RESISTANCE_COOLING,
    THERMAL_EXPANSION,
    TRANSITIONS,
    UPFR_FINISH,
    UPFR_START,
)
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.record import Record
from sma_bench.records.tensile import TensileRecord
from sma_bench.report.composite_figures import (
    CompositeRun,
    composite_deflection_picture,
    composite_voltage_picture,
    errata_picture,
)
from sma_bench.report.drawing import FAINT
from sma_bench.report.errata import Erratum, errata_sections
from sma_bench.report.experiment_figures import (
    dsc_overview_picture,
    has_diagram,
    plateau_picture,
    ramp_picture,
    slope_picture,
    stress_temperature_picture,
    tensile_picture,
    thermal_expansion_picture,
    upfr_picture,
)
from sma_bench.report.page import Drawing, Picture, Section, Table, captions

# --- What the figures and tables of the paper are drawn from: records in, experiments out.

THERMAL = ("E1", "E2", "E3")


@dataclass(frozen=True)
class LabRecords:
    """Records of a laboratory, sorted by what they are good for.

    Attributes:
        thermal: E1 to E3, voltage staircases and ramps below A_s of one wire.
        validation: E4, voltages that no parameter is fitted to.
        dsc: E5; upfr: E6 at one low load; isobaric: E6 at several loads; tensile: E7;
        clamped: E8, a wire between clamps with its force.
        composite: E12.
    """

    thermal: tuple[Record, ...] = ()
    validation: tuple[Record, ...] = ()
    dsc: tuple[DscRecord, ...] = ()
    upfr: tuple[IsobaricRecord, ...] = ()
    isobaric: tuple[IsobaricRecord, ...] = ()
    tensile: tuple[TensileRecord, ...] = ()
    clamped: tuple[Record, ...] = ()
    composite: tuple[Record, ...] = ()

    def only(self, names: Sequence[str]) -> "LabRecords":
        """These groups and no others."""
        return LabRecords(**{f.name: getattr(self, f.name) for f in fields(self)
                             if f.name in names})


@dataclass(frozen=True)
class ExperimentResults:
    """Results of one kind of experiment.

    `experiments` one a record, `estimates` joined over them, `synthetic` whether the records are.
    """

    experiments: tuple[Experiment, ...]
    estimates: dict[str, Estimate]
    synthetic: bool


# Kinds of experiment by the group of records that feeds them.
KINDS = {
    "thermal": THERMAL,
    "dsc": ("E5",),
    "upfr": ("E6",),
    "isobaric": ("E6 stresses",),
    "tensile": ("E7",),
    "clamped": ("E8",),
}


# --- Tables I to III of the paper, and its numbers outside the tables, beside identified values.

CSV_HEADER = (
    "quantity", "description", "unit", "paper", "paper_std", "identified", "standard_error",
    "data", "source",
)
_HEADER = ("", "", "paper", "identified", "standard error", "unit", "from")


@dataclass(frozen=True)
class Printed:
    """A number of the paper and where its counterpart is found.

    Attributes:
        symbol, description, unit: as in the paper's table.
        value, std: printed, in `unit`; std NaN where none is printed.
        kind: of experiment, "" for what is weighed or measured and not identified.
        estimate: name among the estimates of that kind, or among the details of its experiments.
        scale: from SI to `unit`.
    """

    symbol: str
    description: str
    unit: str
    value: float
    std: float
    kind: str
    estimate: str
    scale: float = 1.0


@dataclass(frozen=True)
class Row:
    """A printed number beside the identified one (None: not identified)."""

    printed: Printed
    estimate: Estimate | None
    synthetic: bool
    source: str

    @property
    def value(self) -> float:
        """Identified, in the unit of the table; NaN if there is none."""
        return self.estimate.value * self.printed.scale if self.estimate else math.nan

    @property
    def std(self) -> float:
        """Its standard error, likewise."""
        return self.estimate.std * self.printed.scale if self.estimate else math.nan


_NONE = math.nan


def _of_table(
    symbol: str, description: str, unit: str, kind: str, name: str, scale: float = 1.0,
    has_std: bool = False,
) -> Printed:
    """A number of Table I or III, which is the default of a parameter."""
    parameter = BY_NAME[name]
    assert isinstance(parameter.default, float)
    std = scale * (parameter.uncertainty or 0.0) if has_std else _NONE
    return Printed(symbol, description, unit, scale * parameter.default, std, kind, name, scale)


_TABLE_I = (
    _of_table("R", "Resistance", "Ω", "E1", "wire.resistance"),
    _of_table("h", "Heat transfer coefficient", "W/(m² K)", "E2", "wire.heat_transfer_coefficient"),
    _of_table("C_p", "Specific heat", "J/(kg K)", "E3", "wire.specific_heat"),
    _of_table("m", "Mass of wire", "g", "", "wire.mass", 1e3),
    _of_table("A_c", "Area of wire", "mm²", "", "wire.surface_area", 1e6),
    _of_table("T_∞", "Ambient temperature", "K", "E2", "environment.ambient_temperature"),
)
_TABLE_II = tuple(
    Printed(symbol, f"heat cycle {cycle}", "K", value, _NONE, "E5", f"cycle {cycle}, *: {symbol}")
    for cycle, values in enumerate(DSC_CYCLES, start=1)
    for symbol, value in values.items()
) + tuple(
    Printed(symbol, "E6, under a held load, stress free", "K", _NONE, _NONE, "E6", name)
    for symbol, name in TRANSITIONS.items()
)
_TABLE_III = (
    _of_table("E_M", "Martensitic modulus at 293.15 K", "GPa", "E7", "wire.martensite_modulus",
              1e-9, has_std=True),
    _of_table("E_A", "Austenitic modulus at 403.15 K", "GPa", "E7", "wire.austenite_modulus",
              1e-9, has_std=True),
)
_UPFR = "UPFR under 1 N, section III.B.1"
_TEXT = (
    Printed("R, cooling", "section II.B.1", "Ω", RESISTANCE_COOLING, _NONE, "E1", "cooling"),
    Printed("A_s", _UPFR, "K", *UPFR_START, "E6", "A_s (tangent) at *"),
    Printed("A_f", _UPFR, "K", *UPFR_FINISH, "E6", "A_f (tangent) at *"),
    _of_table("ε_L", "UPFR, section III.B.1", "%", "E6", "wire.maximum_recoverable_strain", 100.0),
    Printed("Θ_T", "section III.B.3; see erratum 10", "MPa/K", 1e-6 * THERMAL_EXPANSION, _NONE,
            "E8", "wire.thermal_expansion_factor", 1e-6),
    Printed("C_A", "eq. (10); not printed", "MPa/K", _NONE, _NONE, "E6 stresses",
            "wire.stress_influence_austenite", 1e-6),
    Printed("C_M", "eq. (11); not printed", "MPa/K", _NONE, _NONE, "E6 stresses",
            "wire.stress_influence_martensite", 1e-6),
)
TABLES: dict[str, tuple[str, tuple[Printed, ...]]] = {
    "table_1": ("Table I: parameters of the wire", _TABLE_I),
    "table_2": ("Table II: DSC results after two heating cycles", _TABLE_II),
    "table_3": ("Table III: elastic moduli", _TABLE_III),
    "numbers_in_the_text": ("Numbers that the paper gives in its text", _TEXT),
}


def table_rows(name: str, outcomes: Mapping[str, ExperimentResults]) -> list[Row]:
    """Rows of a table of TABLES with what the outcomes identified."""
    return [_row(printed, outcomes.get(printed.kind)) for printed in TABLES[name][1]]


def _row(printed: Printed, outcome: ExperimentResults | None) -> Row:
    if outcome is None:
        return Row(printed, None, False, "not identified" if printed.kind else "taken as given")
    estimate = outcome.estimates.get(printed.estimate) or _detail(printed.estimate, outcome)
    source = "; ".join(dict.fromkeys(e.source for e in outcome.experiments))
    return Row(printed, estimate, outcome.synthetic, source)


def _detail(name: str, outcome: ExperimentResults) -> Estimate | None:
    """A detail of the first experiment that has it; a star stands for anything."""
    head, _, tail = name.partition("*")
    for experiment in outcome.experiments:
        for key, estimate in experiment.details.items():
            exact = key == name
            if exact or ("*" in name and key.startswith(head) and key.endswith(tail)):
                return estimate
    return None


def html_table(name: str, rows: Sequence[Row]) -> Table:
    """A table in the paper's form; Table II one line a cycle."""
    if name == "table_2":
        return _by_cycle(rows)
    shown = [
        (
            row.printed.symbol, row.printed.description, _paper(row.printed),
            *_identified(row), row.printed.unit, _origin(row),
        )
        for row in rows
    ]
    return Table(_HEADER, shown, frozenset({2, 3, 4}))


def _by_cycle(rows: Sequence[Row]) -> Table:
    symbols = list(dict.fromkeys(row.printed.symbol for row in rows))
    lines = []
    for description in dict.fromkeys(row.printed.description for row in rows):
        mine = {row.printed.symbol: row for row in rows if row.printed.description == description}
        lines.append([description, "paper", *(_paper(mine[s].printed) for s in symbols)])
        cells = [" ± ".join(filter(None, _identified(mine[s]))) for s in symbols]
        lines.append(["", f"identified, {_origin(mine[symbols[0]])}", *cells])
    header = ("", "", *(f"{symbol} [K]" for symbol in symbols))
    return Table(header, lines, frozenset(range(2, 2 + len(symbols))))


def _paper(printed: Printed) -> str:
    if math.isnan(printed.value):
        return "none"
    if math.isnan(printed.std):
        return f"{printed.value:g}"
    return f"{printed.value:g} ± {printed.std:g}"


def _identified(row: Row) -> tuple[str, str]:
    """Value and standard error, as many decimals as two digits of the error need."""
    if row.estimate is None:
        return "", ""
    decimals = max(1 - math.floor(math.log10(row.std)), 0) if row.std > 0.0 else 4
    return f"{row.value:.{decimals}f}", f"{row.std:.{decimals}f}"


def _origin(row: Row) -> str:
    if row.estimate is None:
        return row.source
    data = "synthetic" if row.synthetic else "record given"
    return f"{row.printed.kind.partition(' ')[0]}, {data}"


_FAR = 3.0  # standard errors
# What is known of numbers that do not come out as printed; others are a plain remark.
_REASONS = {
    "R, cooling": "the model has one resistance and the synthetic wire with it; the paper's two "
    "differ by 0.32 %, as a resistance does that depends on the phase "
    "(effect phase_dependent_resistance)",
    "Θ_T": "the printed value is not believable, erratum 10",
}


def row_remarks(rows: Sequence[Row]) -> list[str]:
    """A line for every number of the paper's synthetic wire that lies far from the printed one, by
    the errors of both; another wire's numbers are its own."""
    found = []
    for row in rows:
        printed = row.printed
        if not row.synthetic or not row.std > 0.0 or math.isnan(printed.value):
            continue
        error = math.hypot(row.std, 0.0 if math.isnan(printed.std) else printed.std)
        apart = (row.value - printed.value) / error
        if abs(apart) <= _FAR:
            continue
        reason = _REASONS.get(printed.symbol)
        text = (
            f"{printed.symbol} ({printed.description}): {row.value:.6g} {printed.unit}, "
            f"{apart:+.0f} standard errors from the paper's {printed.value:g}"
        )
        found.append(f"{text}: {reason}" if reason else text)
    return found


def csv_table(rows: Sequence[Row]) -> Table:
    """The rows as they are written, one number a line, full precision."""
    lines = []
    for row in rows:
        printed = row.printed
        data = "" if row.estimate is None else "synthetic" if row.synthetic else "record"
        numbers = [_number(x) for x in (printed.value, printed.std, row.value, row.std)]
        lines.append(
            (printed.symbol, printed.description, printed.unit, *numbers, data, row.source)
        )
    return Table(CSV_HEADER, lines)


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.10g}"


# --- The paper redrawn: its figures, tables and errata as one page.

# Figure of the paper: (kind of experiment, how it is drawn).
EXPERIMENT_FIGURES = (
    (2, "E1", plateau_picture),
    (3, "E2", plateau_picture),
    (4, "E3", ramp_picture),
    (5, "E3", slope_picture),
    (7, "E5", dsc_overview_picture),
    (8, "E6", upfr_picture),
    (9, "E7", tensile_picture),
    (10, "E8", thermal_expansion_picture),
)
_SECTIONS = (
    # (title, figures, table)
    ("Set-up for the identification, section II.B", (1,), None),
    ("Resistance, section II.B.1", (2,), None),
    ("Heat transfer coefficient, section II.B.2", (3,), None),
    ("Specific heat, section II.B.3", (4, 5), None),
    ("Thermal parameters", (), "table_1"),
    ("Heat transfer simulation, section II.C", (6,), None),
    ("Transition temperatures by DSC, section III.B.1", (7,), "table_2"),
    ("Transition temperatures by UPFR, section III.B.1", (8,), None),
    ("Young's modulus, section III.B.2", (9,), "table_3"),
    ("Thermal expansion factor, section III.B.3", (10,), None),
    ("Numbers outside the tables", (), "numbers_in_the_text"),
    ("Test bench of the composite, section IV", (11, 12), None),
    ("Bending and block diagram, section IV.A", (13, 14), None),
    ("Simulation and experiment of the composite, section IV.C", (15, 16), None),
)


# Set-ups and diagrams of the paper's own rigs, as they ship.
DRAWINGS = {
    1: "figure_01_wire_rig", 11: "figure_11_bench", 12: "figure_12_specimen",
    13: "figure_13_moment", 14: "figure_14_block_diagram",
}


def _drawing(number: int) -> Drawing:
    name = DRAWINGS[number]
    svg = resources.files("sma_bench.report").joinpath("drawings", f"{name}.svg").read_bytes()
    caption = f"{captions()[name]['caption']} Data: none, the numbers are the paper's."
    return Drawing(name, f"Fig. {number}: {captions()[name]['title']}", caption, svg)


@dataclass(frozen=True)
class PaperPage:
    """Everything the page shows.

    Attributes:
        outcomes: by kind of experiment.
        validation: Fig. 6; validation_synthetic: whether its record is.
        composite: runs of Figs. 15 and 16; composite_synthetic: whether they are.
        tables: rows by name of TABLES.
        errata, notes: at the end and at the beginning.
        own: whether the synthetic data are of another wire than the paper's.
    """

    outcomes: Mapping[str, ExperimentResults]
    validation: Picture
    validation_synthetic: bool
    composite: Sequence[CompositeRun]
    composite_synthetic: bool
    tables: Mapping[str, Sequence[Row]]
    errata: Sequence[Erratum]
    notes: Sequence[Finding] = ()
    own: bool = False

    def pictures(self) -> dict[int, list[Picture | Drawing]]:
        """Pictures by figure number of the paper, captions with equation and data source."""
        drawn = {
            number: [draw(experiment) for experiment in self.outcomes[kind].experiments]
            for number, kind, draw in EXPERIMENT_FIGURES
        }
        drawn |= {
            6: [self.validation], 15: [composite_voltage_picture(self.composite)],
            16: [composite_deflection_picture(self.composite)],
        }
        found: dict[int, list[Picture | Drawing]] = {
            number: [captioned(number, p, self.is_synthetic(number), k) for k, p in enumerate(own)]
            for number, own in drawn.items()
        }
        return dict(sorted((found | {n: [_drawing(n)] for n in DRAWINGS}).items()))

    def is_synthetic(self, number: int) -> bool:
        """Whether a figure's data are."""
        of_experiments = {n: self.outcomes[kind].synthetic for n, kind, _ in EXPERIMENT_FIGURES}
        of_experiments[6] = self.validation_synthetic
        return of_experiments.get(number, self.composite_synthetic)

    def sections(self) -> list[Section]:
        """In the paper's order."""
        pictures = self.pictures()
        sections = [self._contents(pictures)]
        for title, numbers, table in _SECTIONS:
            tables = [html_table(table, self.tables[table])] if table else []
            shown = [picture for number in numbers for picture in pictures[number]]
            heading = f"{TABLES[table][0]}" if table and not numbers else title
            rows = self.tables[table] if table else ()
            notes = [*self._remarks(numbers), *([] if self.own else row_remarks(rows))]
            sections.append(Section(heading, tables=tables, pictures=shown, notes=notes))
        sections.append(self._beyond())
        errata = errata_sections(self.errata)
        errata[0] = replace(errata[0], pictures=[errata_picture()])
        return sections + errata

    def _contents(self, pictures: Mapping[int, Sequence[Picture | Drawing]]) -> Section:
        rows = []
        for number, drawn in pictures.items():
            data = "synthetic" if self.is_synthetic(number) else "record given"
            data = "drawing" if number in DRAWINGS else data
            of = captions()[drawn[0].name].get("of", "")
            rows.append((f"Fig. {number}", drawn[0].title.partition(": ")[2], of, data))
        return Section(
            "Contents", tables=[Table(("", "shows", "of", "data"), rows)],
            paragraphs=["Figures 1 and 11 to 14 show set-ups and diagrams of the paper's own "
                        "rigs. Tables are written as CSV, figures as PNG beside this page."],
            notes=[str(note) for note in self.notes],
        )

    def _remarks(self, numbers: Sequence[int]) -> list[str]:
        """Warnings of the experiments behind these figures."""
        kinds = dict.fromkeys(kind for n, kind, _ in EXPERIMENT_FIGURES if n in numbers)
        found = [
            f"{finding.subject}: {finding.text}"
            for kind in kinds
            for experiment in self.outcomes[kind].experiments
            for finding in experiment.findings
            if finding.severity != "info" or finding.subject == "prestrain"
        ]
        return list(dict.fromkeys(found))

    def _beyond(self) -> Section:
        """C_A and C_M, which the paper uses and does not give."""
        outcome = self.outcomes["E6 stresses"]
        pictures = [
            _captioned(stress_temperature_picture(experiment), outcome.synthetic)
            for experiment in outcome.experiments
            if has_diagram(experiment)
        ]
        return Section("Influence of stress, section III.B.4 (no figure in the paper)",
                       pictures=pictures)


def captioned(number: int, picture: Picture, synthetic: bool, index: int = 0) -> Picture:
    """The picture as a figure of the paper: number and data source added, equation in it."""
    shown = _captioned(picture, synthetic)
    name = picture.name if not index else f"{picture.name}_{index + 1}"
    return replace(shown, title=f"Fig. {number}: {picture.title}", name=name)


def _captioned(picture: Picture, synthetic: bool) -> Picture:
    # The PNG may go its own way: it says by itself what it is not.
    text = "synthetic data" if synthetic else "data: record given"
    picture.figure.axes[0].set_title(text, loc="right", fontsize=8, color=FAINT, style="italic")
    origin = captions()[picture.name]["synthetic"]
    data = f"Data: synthetic ({origin})." if synthetic else "Data: record given."
    return replace(picture, caption=f"{picture.caption.rstrip('. ')}. {data}")
