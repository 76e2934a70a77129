"""sma-bench diagnose: where simulation and bench disagree, which effect causes it, how far."""

import argparse
from typing import TYPE_CHECKING

from sma_bench.border import printable
from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.parser import one_of
from sma_bench.commands.terminal import (
    add_json_option,
    output_console,
    print_findings,
    print_table,
    progress,
    say,
    write_json,
)

if TYPE_CHECKING:
    from sma_bench.diagnose import Diagnosis

_Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

_LEAST_SHOWN = 0.005
_CELLS_SHOWN = 6


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("records", nargs="+", metavar="RECORD", help="bag (folder, .mcap, .db3)")
    add_parameter_options(parser)
    parser.add_argument(
        "--hold-out", metavar="RECORD", nargs="+", action="extend", default=[],
        help="bags on which the shrinkage is measured, unseen by its fit",
    )
    parser.add_argument(
        "--signals", metavar="QUANTITY", nargs="+", type=one_of(quantities),
        help="compare these only, of current, temperature, deflection: what would the record "
        "have shown without the others?",
    )
    add_json_option(parser, "the result")
    parser.add_argument("--report", metavar="DIR", help="write a page with figures")
    parser.add_argument(
        "--out", metavar="improved.yaml", help="write a ROS 2 parameter file with the improvement"
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose, print the argument, write the files that were asked for."""
    from sma_bench.tasks.work import diagnose_files, write_improved

    parameters = parameters_from_options(args)
    with progress("diagnose") as report:
        compared = args.signals or quantities()
        result = diagnose_files(args.records, args.hold_out, parameters, compared, report)
    if args.json:
        write_json(args.json, result.to_json())
    if args.out:
        write_improved(args.out, result, "sma-bench diagnose")
    print_result(result)
    if args.report:
        from sma_bench.report.diagnosis_report import write_diagnosis_report

        with progress("drawing the report") as report:
            page = write_diagnosis_report(args.report, result, report)
        say(f"report {page}")
    return 0


def quantities() -> tuple[str, ...]:
    """Quantities that a diagnosis compares."""
    from sma_bench.estimation.observation import QUANTITIES

    return QUANTITIES


def print_result(result: "Diagnosis") -> None:
    """The argument in a few tables."""
    from sma_bench.report.diagnosis_words import headline, what_next

    console = output_console()
    console.print(f"{result.decision.verdict}: {headline(result)}\n", markup=False)
    for headings, rows in (_candidates(result), _where(result), _chain(result), _shrinkage(result)):
        print_table(console, headings, rows, right=range(1, len(headings)))
        console.print()
    for sentence in what_next(result):
        console.print(f"{printable(sentence)}\n", markup=False)
    print_findings(result.findings)


def _candidates(result: "Diagnosis") -> _Table:
    return ("candidate", "probability", "gap/noise", "log evidence"), [
        (c.name, f"{c.probability:.3f}", f"{c.gap:.2f}", f"{c.gain:.1f}")
        for c in result.decision.candidates if c.probability >= _LEAST_SHOWN
    ]


def _where(result: "Diagnosis") -> _Table:
    return ("where", "phase", "side", "gap/noise", "share"), [
        (cell.signal, cell.phase, cell.side, f"{cell.gap:.2f}", f"{100.0 * cell.share:.0f} %")
        for cell in result.where[:_CELLS_SHOWN]
    ]


def _chain(result: "Diagnosis") -> _Table:
    return ("block, no effect", "gap/noise", "90 % interval"), [
        (link.block, f"{link.gap:.2f}", f"{link.ci90[0]:.2f} to {link.ci90[1]:.2f}")
        for link in result.chain
    ]


def _shrinkage(result: "Diagnosis") -> _Table:
    headings = ("held out", "RMSE before", "after", "noise", "gap gone", "90 % interval")
    rows: list[tuple[str, ...]] = []
    for name, s in result.shrinkage.items():
        low, high = s.ci90
        rows.append(
            (name, f"{s.rmse_before:.3g}", f"{s.rmse_after:.3g}", f"{s.noise_floor:.3g}",
             f"{100.0 * s.fraction:.0f} %", f"{100.0 * low:.0f} to {100.0 * high:.0f} %")
        )
    return headings, rows
