"""sma-bench diagnose: where simulation and bench disagree, which effect causes it, how far."""

import argparse

from rich.console import Console
from rich.table import Table

from sma_bench.commands.output import print_findings, write_json
from sma_bench.commands.parameter_options import add_parameter_options, parameters_from_options
from sma_bench.diagnose import Diagnosis, diagnose
from sma_bench.diagnose.view import QUANTITIES
from sma_bench.parameters import write_parameters
from sma_bench.records import read_record
from sma_bench.report.diagnosis_words import headline, what_next

_LEAST_SHOWN = 0.005
_CELLS_SHOWN = 6
_WIDE = 160  # letters: names are long, and a cut one cannot be looked up


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("records", nargs="+", metavar="RECORD", help="bag (folder, .mcap, .db3)")
    add_parameter_options(parser)
    parser.add_argument(
        "--hold-out", metavar="RECORD", nargs="+", action="extend", default=[],
        help="bags on which the shrinkage is measured, unseen by its fit",
    )
    parser.add_argument(
        "--signals", metavar="QUANTITY", nargs="+", choices=QUANTITIES, default=QUANTITIES,
        help="compare these only, of current, temperature, deflection: what would the record "
        "have told without the others?",
    )
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")
    parser.add_argument("--report", metavar="DIR", help="write a page with figures")
    parser.add_argument(
        "--out", metavar="improved.yaml", help="write a ROS 2 parameter file with the improvement"
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose, print the argument, write the files that were asked for."""
    parameters = parameters_from_options(args)
    records = [read_record(path) for path in args.records]
    held_out = [read_record(path) for path in args.hold_out]
    console = Console(stderr=True)
    with console.status("diagnosing") as status:
        result = diagnose(
            records, parameters, held_out,
            lambda text: status.update(f"diagnosing: {text}"), args.signals,
        )
    if args.json:
        write_json(args.json, result.to_json())
    if args.out:
        write_improved(args.out, result, "sma-bench diagnose")
    print_result(result)
    if args.report:
        from sma_bench.report.diagnosis_report import write_diagnosis_report

        print(f"report {write_diagnosis_report(args.report, result)}")
    return 0


def write_improved(path: str, result: Diagnosis, author: str) -> None:
    """Write the improved parameters, those only that are not left at their default.

    Raises:
        InputError: the file cannot be written.
    """
    names = [n for n in result.improved if n in result.improved.given]
    sources = ", ".join(dict.fromkeys(view.path for view in result.views))
    comment = f"Improved by {author} from {sources}".replace("\n", " ")
    write_parameters(path, result.improved, comment, names)


def print_result(result: Diagnosis) -> None:
    """The argument in a few tables."""
    console = Console(highlight=False, markup=False, width=max(Console().width, _WIDE))
    console.print(f"{result.decision.verdict}: {headline(result)}\n", soft_wrap=True)
    console.print(_candidates(result))
    console.print(_where(result))
    console.print(_chain(result))
    console.print(_shrinkage(result))
    for sentence in what_next(result):
        console.print(f"{sentence}\n", soft_wrap=True)
    print_findings(result.findings)


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="left" if k == 0 else "right", no_wrap=True)
    return table


def _candidates(result: Diagnosis) -> Table:
    table = _table("candidate", "probability", "gap/noise", "log evidence")
    for c in result.decision.candidates:
        if c.probability >= _LEAST_SHOWN:
            table.add_row(c.name, f"{c.probability:.3f}", f"{c.gap:.2f}", f"{c.gain:.1f}")
    return table


def _where(result: Diagnosis) -> Table:
    table = _table("where", "phase", "side", "gap/noise", "share")
    for cell in result.where[:_CELLS_SHOWN]:
        table.add_row(
            cell.signal, cell.phase, cell.side, f"{cell.gap:.2f}", f"{100.0 * cell.share:.0f} %"
        )
    return table


def _chain(result: Diagnosis) -> Table:
    table = _table("block, no effect", "gap/noise", "90 % interval")
    for link in result.chain:
        low, high = link.ci90
        table.add_row(link.block, f"{link.gap:.2f}", f"{low:.2f} to {high:.2f}")
    return table


def _shrinkage(result: Diagnosis) -> Table:
    table = _table("held out", "RMSE before", "after", "noise", "gap gone", "90 % interval")
    for name, s in result.shrinkage.items():
        low, high = s.ci90
        table.add_row(
            name, f"{s.rmse_before:.3g}", f"{s.rmse_after:.3g}", f"{s.noise_floor:.3g}",
            f"{100.0 * s.fraction:.0f} %", f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
        )
    return table
