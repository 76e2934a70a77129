"""Tables of results and of records, the same on a terminal, on a page and in a notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sma_bench.border import read_yaml
from sma_bench.results import cells, lines_of

if TYPE_CHECKING:
    from sma_bench.diagnose.result import DiagnosisResult

LEAST_SHOWN = 0.005  # probability of a candidate
_NOTHING = 1e-12  # rounding errors of times smaller than this are shown as 0


@dataclass(frozen=True)
class Table:
    """Rows of text; `numeric` columns are flush right. With a `name` it is also written as CSV."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: frozenset[int] = frozenset()
    name: str = ""
    title: str = ""


def table_of(result: Any, macro: str, *more: Any, name: str = "", title: str = "") -> Table:
    """A table from a macro of the result's template: headings first, # marks numeric columns."""
    header, *rows = cells(result, macro, *more)
    numeric = frozenset(k for k, cell in enumerate(header) if cell.startswith("#"))
    return Table([cell.lstrip("#") for cell in header], rows, numeric, name, title)


def diagnosis_tables(result: "DiagnosisResult") -> dict[str, Table]:
    """Tables by name: the candidates, where the gap lies, how far it shrinks."""
    return {
        "candidates": table_of(result, "candidate_table", LEAST_SHOWN, name="candidates_table",
                               title="Candidates"),
        "where": table_of(result, "place_table", name="where", title="Where the gap lies"),
        "shrinkage": table_of(result, "shrinkage_table", name="shrinkage",
                              title="How far the gap shrinks on held-out data")}


def cell_of(value: Any, form: str = "") -> str:
    """A value in a format; without one, a float has six digits."""
    if isinstance(value, list | tuple):
        return ", ".join(value)
    if isinstance(value, float):
        return format(0.0 if form and abs(value) < _NOTHING else value, form or ".6g")
    return "" if value is None else format(value, form)


def record_tables(described: Mapping[str, Any], name: str = "") -> list[Table]:
    """Tables of a record as returned by `records.describe`; `name` is the prefix of their names."""
    tables = []
    for key, columns in read_yaml(Path(__file__).with_name("records.yaml")).items():
        rows = [[cell_of(row[of], form) for of, form in columns.values()]
                for row in described.get(key) or ()]
        numeric = frozenset(k for k, (_, form) in enumerate(columns.values()) if form)
        if rows:
            tables.append(Table([*columns], rows, numeric, f"{name}_{key}", key.capitalize()))
    return tables


def record_line(described: Mapping[str, Any]) -> str:
    """A record in one line."""
    return lines_of("record.j2", "line", described)[0]
