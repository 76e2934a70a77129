"""sma-bench diagnose: where simulation and bench disagree, which effect causes it, how far."""

from dataclasses import replace
from types import SimpleNamespace

from sma_bench.border import printable
from sma_bench.commands import options, terminal
from sma_bench.findings import fold_audit
from sma_bench.results import Invocation

_CELLS_SHOWN = 6


@options.command("diagnose")
def run(args: SimpleNamespace) -> int:
    from sma_bench.estimation.observation import QUANTITIES
    from sma_bench.report.tables import diagnosis_tables
    from sma_bench.results import card_text
    from sma_bench.tasks.work import diagnose_files, write_improved

    parameters, column = options.parameters_from_options(args), options.column_of(args)
    with terminal.progress("diagnose") as report:
        compared = args.signals or QUANTITIES
        result = diagnose_files(args.records, args.hold_out, parameters, compared, report)
    terminal.write_json(args.json, result.to_json())
    if args.out:
        write_improved(args.out, result, "sma-bench diagnose")

    # The card, the tables, what speaks for it, and what should be known of the records.
    params, out, page = (text or "" for text in (args.params, args.out, args.report))
    console, asked = terminal.output_console(), Invocation(tuple(args.records), params, out, page)
    console.print(f"{card_text(result, console.width, asked)}\n", markup=False, soft_wrap=True)
    for name, table in diagnosis_tables(result).items():
        rows = table.rows[:_CELLS_SHOWN] if name == "where" else table.rows
        terminal.print_table(replace(table, rows=rows))
        console.print()
    for sentence in result.why:
        console.print(printable(sentence), markup=False)
    own, audit = fold_audit(result.findings)
    terminal.print_findings([*own, *audit[:1]])
    if args.report:
        from sma_bench.report.reports import write_diagnosis_report

        made = options.made_of(args, args.records, args.hold_out)
        with terminal.progress("drawing the report") as report:
            page = str(write_diagnosis_report(args.report, result, report, made, column))
        terminal.say(f"report {page}")
    return 0
