"""sma-bench diagnose: where simulation and bench disagree, which effect causes it, how far."""

from collections.abc import Container
from types import SimpleNamespace
from typing import TYPE_CHECKING

from rich.console import Console

from sma_bench.border import printable
from sma_bench.commands import options
from sma_bench.commands.terminal import (
    output_console,
    print_findings,
    print_table,
    progress,
    say,
    write_json,
)
from sma_bench.findings import fold_audit
from sma_bench.results import Invocation

if TYPE_CHECKING:
    from sma_bench.diagnose import Diagnosis
    from sma_bench.diagnose.result import DiagnosisResult

_CELLS_SHOWN = 6


@options.command("diagnose")
def run(args: SimpleNamespace) -> int:
    """Diagnose, print the argument, write the files that were asked for."""
    from sma_bench.estimation.observation import QUANTITIES
    from sma_bench.tasks.work import diagnose_files, write_improved

    parameters, column = options.parameters_from_options(args), options.column_of(args)
    with progress("diagnose") as report:
        compared = args.signals or QUANTITIES
        result = diagnose_files(args.records, args.hold_out, parameters, compared, report)
    if args.json:
        write_json(args.json, result.to_json())
    if args.out:
        write_improved(args.out, result, "sma-bench diagnose")
    params, out, page = (text or "" for text in (args.params, args.out, args.report))
    print_result(result, Invocation(tuple(args.records), params, out, page))
    if args.report:
        from sma_bench.report.diagnosis_report import write_diagnosis_report
        from sma_bench.report.page import Made

        files = [*args.records, *args.hold_out, *filter(None, [args.params])]
        made = Made(args.command_line, files)
        with progress("drawing the report") as report:
            page = write_diagnosis_report(args.report, result, report, made, column)
        say(f"report {page}")
    return 0


def print_result(result: "Diagnosis", asked: Invocation) -> None:
    """The card, then the argument in a few tables."""
    from sma_bench.cards import card_text

    console = output_console()
    card = card_text(result, console.width, asked)
    console.print(f"{card}\n", markup=False, soft_wrap=True)
    print_tables(console, result)
    for sentence in result.why:
        console.print(printable(sentence), markup=False)
    own, audit = fold_audit(result.findings)
    print_findings([*own, *audit[:1]])


def print_tables(console: Console, result: "DiagnosisResult", names: Container[str] = ()) -> None:
    """The tables of a result, those of `names` where they are given."""
    from sma_bench.report.tables import diagnosis_tables

    for name, table in diagnosis_tables(result).items():
        if not names or name in names:
            rows = table.rows[:_CELLS_SHOWN] if name == "where" else table.rows
            print_table(console, table.header, rows, table.numeric, title=table.title)
            console.print()
