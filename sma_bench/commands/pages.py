"""Commands that write pages: report, compare, paper."""

import time
from pathlib import Path
from types import SimpleNamespace

from sma_bench.border import read_yaml
from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, print_table, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.progress import in_turn, part

_LEAST_SHIFT = 1e-3  # s; smaller clock shifts are not reported
_READING = 0.3  # share of a report's time after which all inputs are read
_READ, _COMPARED = 0.05, 0.5  # the same for the paper: records read; experiments done


@options.command("report")
def run_report(args: SimpleNamespace) -> int:
    from sma_bench.report.page import versions
    from sma_bench.report.reports import shown_input, write_collected_report

    args.column = args.column or "double"
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), "reading {}".format)
        shown = [shown_input(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        page = write_collected_report(args.out, args.title, shown, parameters,
                                      options.stated_by(args),
                                      options.provenance_of(args, args.inputs), column,
                                      part(report, _READING, 1.0))
    about = {"command": args.command_line, "versions": versions(), "page": str(page)}
    write_json(args.json, {"inputs": [one.to_json() for one in shown], **about})
    for one in shown:
        say(f"{one.path}: {one.summary}")
    warnings = sum(len(one.warnings) for one in shown)
    say(f"warnings {warnings}\nreport   {page}, {page.stat().st_size / 1e6:.1f} MB")
    return 0


@options.command("compare")
def run_compare(args: SimpleNamespace) -> int:
    from sma_bench.api import compare, load
    from sma_bench.records.overlay import HEADER
    from sma_bench.report.tables import Table

    numeric, column = frozenset({2, 3, 4, 5}), options.column_of(args)
    if args.signals and not args.out:
        raise InputError("--signals selects what the page shows, expected --out DIR with it")
    with progress("compare") as report:
        report(0.1, "reading and simulating")
        found = compare([load(path, args.namespace) for path in args.records], args.models)
    write_json(args.json, found.to_json())
    rows = [d.cells() for d in found.differences]
    print_table(Table(HEADER, rows, numeric))
    for name, shift in found.shifts.items():
        if abs(shift) >= _LEAST_SHIFT:
            say(f"{name}: its clock was shifted by {shift:+.3f} s")
    for remark in found.remarks:
        say(remark)
    if args.out:
        from sma_bench.report.page import Section, write_report
        from sma_bench.report.plots import overlay_picture

        table = Table(HEADER, rows, numeric, "differences", "Largest first")
        picture = overlay_picture(found, args.signals)
        sections = [Section("", found.remarks, pictures=[picture]),
                    Section("Differences from the first", tables=[table])]
        *others, last = found.records
        title = f"{', '.join(others)} and {last}, compared" if others else f"{last}, compared"
        made = options.provenance_of(args, args.records, args.models)
        with progress("drawing the page") as report:
            page = write_report(args.out, title, "", sections, made, column=column, report=report)
        say(f"report {page}")
    return 0


@options.command("paper")
def run_paper(args: SimpleNamespace) -> int:
    from sma_bench.paper.lab import paper_page
    from sma_bench.records import open_record
    from sma_bench.report.page import write_report

    started, made = time.monotonic(), options.provenance_of(args, args.records)
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    text, own = read_yaml(Path(__file__).with_name("paper.yaml")), options.stated_by(args)
    if args.records:
        origin = text["mixed"].format(given=", ".join(args.records))
    else:
        origin = text["own"].format(given=own) if own else text["synthetic"]
    summary = text["summary"].format(origin=origin)
    with progress("paper") as report:
        reading = in_turn(args.records, part(report, 0.0, _READ), "reading {}".format)
        records = [open_record(path) for path in reading]
        page = paper_page(records, parameters, part(report, _READ, _COMPARED))
        index = write_report(args.out, text["title"], summary, page.sections(), made, column=column,
                             report=part(report, _COMPARED, 1.0))
    write_json(args.json, page.to_json())
    print_findings(page.notes)
    synthetic = sum(outcome.synthetic for outcome in page.outcomes.values())
    measured = len(page.outcomes) - synthetic
    print(f"experiments: {measured} from the records given, {synthetic} synthetic")
    print(f"report   {index}\n{time.monotonic() - started:.0f} s")
    return 0
