"""Tables of results, the same on a terminal, on a page and in a notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.cards import two_errors
from sma_bench.diagnose.result import DiagnosisResult, Explanation
from sma_bench.estimation.estimate import Estimate
from sma_bench.results import in_print, percent, with_error

LEAST_SHOWN = 0.005  # probability of a candidate


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


def diagnosis_tables(result: DiagnosisResult) -> dict[str, Table]:
    """Candidates, where the gap lies, the chain where there is one, and what shrinks, by name."""
    candidates = [
        (
            c.name, c.stage, f"{c.probability:.3f}", _or_empty(c.gap_over_noise, ".2f"),
            _or_empty(c.log_evidence, "+.1f"), effect_numbers(c),
        )
        for c in result.candidates if c.probability >= LEAST_SHOWN
    ]  # fmt: skip
    where = [
        (c.signal, c.phase, c.side, f"{c.gap:.2f}", percent(c.share), in_print(c.rms, c.signal))
        for c in result.where.table
    ]
    chain = [
        (link.block, f"{link.gap:.2f}", f"{link.ci90[0]:.2f} to {link.ci90[1]:.2f}",
         in_print(link.rms, link.block.rpartition(" ")[2]))
        for link in result.where.chain
    ]  # fmt: skip
    shrinkage = [
        (
            q, *(in_print(rms, q) for rms in (s.rmse_before, s.rmse_after, s.noise_floor)),
            _or_empty(100 * s.fraction, ".0f", " %"),
            f"{100 * s.ci90[0]:.0f} to {100 * s.ci90[1]:.0f} %" if np.isfinite(s.ci90[0]) else "",
        )
        for q, s in result.worst_first
    ]
    tables = {
        "candidates": Table(
            ("candidate", "stage", "probability", "gap over noise", "log evidence [nats]",
             "numbers"), candidates, frozenset({2, 3, 4}), "candidates_table", "Candidates",
        ),
        "where": Table(
            ("signal", "phase", "side", "gap over noise", "share", "rms"), where,
            frozenset({3, 4, 5}), "where", "Where the gap lies",
        ),
        "chain": Table(
            ("block, driven by what was measured", "gap over noise", "90 % interval", "rms"), chain,
            frozenset({1, 2, 3}), "chain_table", "The chain, block by block",
        ),
        "shrinkage": Table(
            ("held-out quantity", "rms before", "rms after", "noise", "gap that is gone",
             "90 % interval"), shrinkage, frozenset({1, 2, 3, 4, 5}), "shrinkage",
            "How far the gap shrinks, on data that no fit saw",
        ),
    }  # fmt: skip
    return {name: table for name, table in tables.items() if table.rows or name != "chain"}


def effect_numbers(candidate: Explanation) -> str:
    """The numbers of a candidate's effects."""
    return "; ".join(
        f"{name.removeprefix('effect.')} = {two_errors(n)}"
        for name, n in candidate.parameters.items()
    )


def estimate_table(numbers: Mapping[str, Estimate], name: str, title: str = "") -> Table:
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
