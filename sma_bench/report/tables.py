"""Tables of results and of records, the same on a terminal, on a page and in a notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sma_bench.border import read_yaml
from sma_bench.results import in_print, percent, two_errors, with_error

if TYPE_CHECKING:
    from sma_bench.diagnose.result import DiagnosisResult
    from sma_bench.estimation.estimate import Estimate

LEAST_SHOWN = 0.005  # probability of a candidate
_NOTHING = 1e-12  # the last bits of doubles, of a signal's times


@dataclass(frozen=True)
class Table:
    """Header and rows of text; `numeric` are the columns set flush right.

    A table with a `name` is written as CSV beside a page too; its `title` stands above it.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: frozenset[int] = frozenset()
    name: str = ""
    title: str = ""


def diagnosis_tables(result: "DiagnosisResult") -> dict[str, Table]:
    """Candidates, where the gap lies, and what shrinks, by name."""
    candidates = [
        (
            c.name, c.stage, f"{c.probability:.3f}", _or_empty(c.gap_over_noise, ".2f"),
            _or_empty(c.log_evidence, "+.1f"),
            "; ".join(f"{name.removeprefix('effect.')} = {two_errors(number)}"
                      for name, number in c.parameters.items()),
        )
        for c in result.candidates if c.probability >= LEAST_SHOWN
    ]  # fmt: skip
    where = [
        (c.signal, c.phase, c.side, f"{c.gap:.2f}", percent(c.share), in_print(c.rms, c.signal))
        for c in result.where.table
    ]
    shrinkage = [
        (
            q, *(in_print(rms, q) for rms in (s.rmse_before, s.rmse_after, s.noise_floor)),
            _or_empty(100 * s.fraction, ".0f", " %"),
            f"{100 * s.ci90[0]:.0f} to {100 * s.ci90[1]:.0f} %" if np.isfinite(s.ci90[0]) else "",
        )
        for q, s in result.worst_first
    ]
    return {
        "candidates": Table(
            ("candidate", "stage", "probability", "gap over noise", "log evidence [nats]",
             "numbers"), candidates, frozenset({2, 3, 4}), "candidates_table", "Candidates",
        ),
        "where": Table(
            ("signal", "phase", "side", "gap over noise", "share", "rms"), where,
            frozenset({3, 4, 5}), "where", "Where the gap lies",
        ),
        "shrinkage": Table(
            ("held-out quantity", "rms before", "rms after", "noise", "gap that is gone",
             "90 % interval"), shrinkage, frozenset({1, 2, 3, 4, 5}), "shrinkage",
            "How far the gap shrinks, on data that no fit saw",
        ),
    }  # fmt: skip


def estimate_table(numbers: "Mapping[str, Estimate]", name: str, title: str = "") -> Table:
    """Numbers with all that is known of them, a plain number a cell."""
    rows = [
        (
            key, with_error(n.value, n.statistical).partition(" ")[0], f"{n.statistical:.2g}",
            f"{n.systematic:.2g}" if n.systematic else "", n.unit, _or_empty(n.informed, ".3f"),
            str(n.n) if n.n else "", n.method,
        )
        for key, n in numbers.items()
    ]
    header = ("parameter", "value", "statistical", "systematic", "unit", "informed", "points",
              "method")  # fmt: skip
    return Table(header, rows, frozenset({1, 2, 3, 5, 6}), name, title)


def _or_empty(value: float, form: str, unit: str = "") -> str:
    """JSON has null for a number that does not exist."""
    return format(value, form) + unit if np.isfinite(value) else ""


def value_cell(value: Any) -> str:
    """A parameter's value."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return ", ".join(value) if isinstance(value, tuple) else str(value)


def record_tables(described: Mapping[str, Any], name: str = "") -> list[Table]:
    """Of a record as `records.describe` has it; `name` leads those of the tables."""
    tables = []
    for key, columns in read_yaml(Path(__file__).with_name("records.yaml")).items():
        rows = []
        for row in described.get(key) or ():
            cells = [(row[of], form) for of, form in columns.values()]
            cells = [(0.0 if form and v and abs(v) < _NOTHING else v, form) for v, form in cells]
            rows.append([
                "" if v is None else ", ".join(v) if isinstance(v, list) else format(v, form)
                for v, form in cells
            ])  # fmt: skip
        numeric = frozenset(k for k, (_, form) in enumerate(columns.values()) if form)
        if rows:
            tables.append(Table([*columns], rows, numeric, f"{name}_{key}", key.capitalize()))
    return tables


def record_line(described: Mapping[str, Any]) -> str:
    """What a record is, in a line."""
    of = described
    match of["kind"]:
        case "bag":
            # One from arrays, or a simulated one, has no date.
            since = "" if of["start"].startswith("1970-01-01") else f" from {of['start']}"
            channels = ", ".join(of["channels"]) or "none"
            return (
                f"{of['duration']:.3f} s{since}, channels: {channels}, {len(of['signals'])} "
                f"signals, {len(of['markers'])} markers"
            )
        case "dsc":
            sign = {True: "endothermic up", False: "exothermic up", None: "sign unknown"}
            return (
                f"{of['instrument']}, {of['sample']}, {1e6 * of['mass']:.3f} mg, "
                f"{sign[of['endothermic_up']]}"
            )
        case "isobaric":
            relative = ", strain over its own range" * (of["strain_unit"] == "relative")
            return f"isobaric test at {of['stress'] / 1e6:.1f} MPa{relative}"
    kelvin, strain, stress = of["temperature"], of["largest_strain"], of["largest_stress"]
    where = "temperature unknown" if kelvin is None else f"at {kelvin:.2f} K"
    far = f"{strain * 1e3:.4g} mm" if of["is_extension"] else f"{strain:.4f} strain"
    hard = f"{stress:.1f} N" if of["is_force"] else f"{stress / 1e6:.1f} MPa"
    return f"tensile test {where}, {of['samples']} samples, to {far} and {hard}"
