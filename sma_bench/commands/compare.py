"""sma-bench compare: records and models over each other, their differences in numbers."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_table, progress, say, write_json
from sma_bench.errors import InputError

_LEAST_SHIFT = 1e-3  # s, worth a line


@options.command("compare")
def run(args: SimpleNamespace) -> int:
    from sma_bench.api import compare, load
    from sma_bench.records.overlay import HEADER
    from sma_bench.report.tables import Table

    column = options.column_of(args)
    if args.signals and not args.out:
        raise InputError("--signals is what the page shows, expected --out DIR with it")
    with progress("compare") as report:
        report(0.1, "reading and simulating")
        found = compare([load(path, args.namespace) for path in args.records], args.models)
    write_json(args.json, found.to_json())
    rows = [d.cells() for d in found.differences]
    print_table(Table(HEADER, rows, frozenset({2, 3, 4, 5})))
    for name, shift in found.shifts.items():
        if abs(shift) >= _LEAST_SHIFT:
            say(f"{name}: its clock was shifted by {shift:+.3f} s")
    for remark in found.remarks:
        say(remark)
    if args.out:
        from sma_bench.report.page import Section, write_report
        from sma_bench.report.plots import overlay_picture

        table = Table(HEADER, rows, frozenset({2, 3, 4, 5}), "differences", "Largest first")
        sections = [
            Section("", found.remarks, pictures=[overlay_picture(found, "overlay", args.signals)]),
            Section("Differences from the first", tables=[table]),
        ]
        *others, last = found.records
        title = f"{', '.join(others)} and {last}, compared" if others else f"{last}, compared"
        made = options.made_of(args, args.records, args.models)
        with progress("drawing the page") as report:
            page = write_report(args.out, title, "", sections, made, column=column, report=report)
        say(f"report {page}")
    return 0
