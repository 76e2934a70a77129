"""Tables I to III of the paper, and its numbers outside the tables, beside identified values."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sma_bench.identify.estimate import Estimate
from sma_bench.parameters.paper_numbers import (
    DSC_CYCLES,
    RESISTANCE_COOLING,
    THERMAL_EXPANSION,
    UPFR_FINISH,
    UPFR_START,
)
from sma_bench.parameters.table import BY_NAME
from sma_bench.report.page import Table
from sma_bench.report.paper_results import Outcome

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
    return Printed(
        symbol, description, unit, scale * parameter.default, std, kind, name, scale
    )


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


def table_rows(name: str, outcomes: Mapping[str, Outcome]) -> list[Row]:
    """Rows of a table of TABLES with what the outcomes identified."""
    return [_row(printed, outcomes.get(printed.kind)) for printed in TABLES[name][1]]


def _row(printed: Printed, outcome: Outcome | None) -> Row:
    if outcome is None:
        return Row(printed, None, False, "not identified" if printed.kind else "taken as given")
    estimate = outcome.estimates.get(printed.estimate) or _detail(printed.estimate, outcome)
    source = "; ".join(dict.fromkeys(e.source for e in outcome.experiments))
    return Row(printed, estimate, outcome.synthetic, source)


def _detail(name: str, outcome: Outcome) -> Estimate | None:
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
        told = [" ± ".join(filter(None, _identified(mine[s]))) for s in symbols]
        lines.append(["", f"identified, {_origin(mine[symbols[0]])}", *told])
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


def csv_text(rows: Sequence[Row]) -> str:
    """The rows as CSV, one number a line, full precision."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_HEADER)
    for row in rows:
        printed = row.printed
        data = "" if row.estimate is None else "synthetic" if row.synthetic else "record"
        numbers = [_number(x) for x in (printed.value, printed.std, row.value, row.std)]
        writer.writerow(
            [printed.symbol, printed.description, printed.unit, *numbers, data, row.source]
        )
    return text.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.10g}"
