"""The tables that sma-bench blind score prints, and its result as plain data."""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from sma_bench.blind.case_files import CaseSet
from sma_bench.blind.measures import OTHERS, TARGETS, Measured
from sma_bench.blind.score import (
    COLUMNS,
    MEASURE_HEADER,
    Score,
    confusion,
    groups,
    measure_row,
    reliability,
    side_by_side,
    summary,
)
from sma_bench.commands.terminal import output_console, print_table

_MET_STYLE = {"aim": "green", "floor": "yellow", "missed": "red", "": ""}


def result_document(cases: CaseSet, scores: Sequence[Score]) -> dict:
    """Everything as plain data."""
    return {
        "set": {"seed": cases.seed, "split": cases.split, "n": len(cases.names),
                "sha256": cases.sealed_sha256},
        "scores": {score.name: score.to_json() for score in scores},
    }  # fmt: skip


def print_scores(cases: CaseSet, scores: Sequence[Score]) -> None:
    """All tables, as wide as they are where no terminal sets a width."""
    console = output_console()
    console.print(f"{len(cases.names)} cases, seed {cases.seed} ({cases.split})")
    for one in scores:
        _print_score(console, one)
    if len(scores) > 1:
        header = ("measure", *(one.name for one in scores))
        rows = side_by_side(scores, TARGETS)
        _print_table(console, "side by side: value (95 % interval)", header, rows)
    for one in scores:
        console.print(escape(summary(one)), soft_wrap=True)


def _print_score(console: Console, one: Score) -> None:
    rows = [measure_row(m, one.measured[m.name]) for m in TARGETS]
    styles = [_MET_STYLE[row[-1]] for row in rows]
    _print_table(console, f"{one.name}: measures", MEASURE_HEADER, rows, styles)
    others = [measure_row(m, one.measured[m.name])[:4] for m in OTHERS]
    _print_table(console, f"{one.name}: besides", MEASURE_HEADER[:4], others)
    for title, by_group in groups(one.cases).items():
        names = list(next(iter(by_group.values()), {}))
        lines = [
            (group, str(row[names[0]].n), *(_short(row[name]) for name in names))
            for group, row in by_group.items()
        ]
        _print_table(console, f"{one.name}: {title}", ("", "cases", *names), lines)
    bins = [
        (f"{b.low:.1f} to {b.high:.1f}", str(b.n), f"{b.stated:.2f}",
         f"{b.right:.2f} ({b.right_low:.2f} to {b.right_high:.2f})")
        for b in reliability(one.cases)
    ]  # fmt: skip
    header = ("probability of the first choice", "cases", "stated", "right")
    _print_table(console, f"{one.name}: reliability", header, bins)
    _print_confusion(console, one)


def _short(measured: Measured) -> str:
    return f"{measured.value:.2f} ({measured.low:.2f} to {measured.high:.2f})"


def _print_confusion(console: Console, one: Score) -> None:
    """Truth down, first choice across, by number; columns that nobody chose are left out."""
    matrix = confusion(one.cases)
    used = [c for c in COLUMNS if any(row[c] for row in matrix.values())]
    header = ("truth", *(str(k) for k in range(1, len(used) + 1)))
    rows = [(name, *(str(row[c] or "·") for c in used)) for name, row in matrix.items()]
    _print_table(console, f"{one.name}: truth against first choice", header, rows)
    console.print("  " + ", ".join(f"{k} {name}" for k, name in enumerate(used, 1)))


def _print_table(
    console: Console,
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    styles: Sequence[str] = (),
) -> None:
    console.print()
    print_table(console, header, rows, range(1, len(header)), title=title, styles=styles)
