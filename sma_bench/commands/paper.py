"""sma-bench paper: the figures and tables of the paper redrawn from data, and its errata."""

import time
from pathlib import Path
from types import SimpleNamespace

from sma_bench.border import read_yaml
from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, progress, write_json
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import in_turn, part

# Shares of the time, about: all records read, all experiments compared.
_READ, _COMPARED = 0.05, 0.5


@options.command("paper")
def run(args: SimpleNamespace) -> int:
    from sma_bench.paper.lab import paper_page
    from sma_bench.paper.page import csv_table
    from sma_bench.records import open_record
    from sma_bench.report.page import csv_text, write_report

    started, made = time.monotonic(), options.made_of(args, args.records)
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    given = ", ".join(args.records)
    own = ", ".join([*([args.params] if args.params else []), *args.overrides])
    text = read_yaml(Path(__file__).with_suffix(".yaml"))
    origin = text["own"].format(given=own) if own else text["synthetic"]
    summary = text["summary"].format(origin=text["mixed"].format(given=given) if given else origin)
    with progress("paper") as report:
        reading = in_turn(args.records, part(report, 0.0, _READ), lambda path: f"reading {path}")
        records = [open_record(path) for path in reading]
        page = paper_page(records, parameters, part(report, _READ, _COMPARED))
        index = write_report(args.out, text["title"], summary, page.sections(), made, column=column,
                             report=part(report, _COMPARED, 1.0))
    for name, rows in page.tables.items():
        write_text_atomically(Path(args.out) / f"{name}.csv", csv_text(csv_table(rows)).decode())
    write_json(args.json, page.to_json())
    print_findings(page.notes)
    synthetic = sum(outcome.synthetic for outcome in page.outcomes.values())
    measured = len(page.outcomes) - synthetic
    print(f"experiments: {measured} from the records given, {synthetic} synthetic")
    print(f"report   {index}\n{time.monotonic() - started:.0f} s")
    return 0
