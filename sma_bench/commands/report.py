"""sma-bench report: records and result files as one page that opens from disk and prints."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import progress, say, write_json
from sma_bench.progress import in_turn, part

_READING = 0.3  # of the time, about


@options.command("report")
def run(args: SimpleNamespace) -> int:
    """Read everything, then write everything; 0 whatever the inputs say."""
    from sma_bench.report.page import Made, versions
    from sma_bench.report.reports import shown_input, write_collected_report

    args.column = args.column or "double"
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    given = " and ".join([*([args.params] if args.params else []), *args.overrides])
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), lambda path: f"reading {path}")
        shown = [shown_input(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        made = Made(args.command_line, [*args.inputs, *filter(None, [args.params])])
        drawing = part(report, _READING, 1.0)
        page = write_collected_report(args.out, args.title, shown, parameters, given, made, column,
                                      drawing)
    about = {"command": args.command_line, "versions": versions(), "page": str(page)}
    write_json(args.json, {"inputs": [one.to_json() for one in shown], **about})
    for one in shown:
        say(f"{one.path}: {one.said}")
    warnings = sum(len(one.warnings) for one in shown)
    say(f"warnings {warnings}\nreport   {page}, {page.stat().st_size / 1e6:.1f} MB")
    return 0
