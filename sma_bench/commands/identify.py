"""sma-bench identify: parameters of Table I from bags and instrument files."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_findings, progress, say, write_json
from sma_bench.results import Invocation

MISFIT = 3  # exit status: the model does not fit the records


@options.command("identify")
def run(args: SimpleNamespace) -> int:
    """Identify, print a table, write files; 3 where the model does not fit the records."""
    from sma_bench.records.open import parse_stated
    from sma_bench.results import card, card_lines, card_text
    from sma_bench.tasks.work import identify_files, write_identified

    parameters, column = options.parameters_from_options(args), options.column_of(args)
    stated = parse_stated(args.stated) if args.stated else {}
    phases: dict[str, Any] = dict(options.pair("--phase", text, "FILE=martensite or FILE=austenite")
                                  for text in args.phases)
    with progress("identify") as report:
        result = identify_files(args.records, parameters, args.experiments or None, args.namespace,
                                report, phases, stated)
    write_json(args.json, result.to_json())
    if args.out:
        write_identified(args.out, result, "sma-bench identify", args.records, args.params)

    # The card, with advice that depends on what was asked: only bags can be diagnosed.
    bags = [r for r in args.records if Path(r).is_dir() or {".mcap", ".db3"} & {*Path(r).suffixes}]
    asked = Invocation(tuple(bags), *(text or "" for text in (args.params, args.out, args.report)))
    console, text = output_console(), card_text(result, asked=asked)
    if max(map(len, text.splitlines())) > console.width:  # no room for columns
        text = "\n".join(card_lines(card(result, asked, numbers=True), console.width))
    console.print(f"{text}\n", markup=False, soft_wrap=True)
    print_findings(result.notes)
    for experiment in result.experiments:
        say(f"\n{experiment.name} {experiment.title} ({experiment.source})")
        print_findings(experiment.findings)
    for line in result.accounts:
        say(line)
    if args.report:
        from sma_bench.report.reports import write_identification_report

        made = options.made_of(args, args.records)
        with progress("drawing the report") as report:
            page = write_identification_report(args.report, result, report, made, column)
        say(f"report {page}")
    return MISFIT if result.is_misfit else 0
