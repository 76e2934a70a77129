"""sma-bench report: records and result files as one page that opens from disk and prints."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import progress, say, write_json
from sma_bench.progress import in_turn, part

_READING = 0.3  # of the time, about


@options.command("report")
def run(args: SimpleNamespace) -> int:
    """Read everything, then write everything; 0 whatever the inputs say."""
    from sma_bench.report.collected_report import (
        answers,
        counted,
        document,
        parameter_section,
        shown_input,
        summary_section,
    )
    from sma_bench.report.page import Made, write_report

    args.column = args.column or "double"
    parameters, column = options.parameters_from_options(args), options.column_of(args)
    with progress("report") as report:
        reading = in_turn(args.inputs, part(report, 0.0, _READING), lambda path: f"reading {path}")
        shown = [shown_input(path, k, args.namespace) for k, path in enumerate(reading, 1)]
        made = Made(args.command_line, [*args.inputs, *filter(None, [args.params])])
        own = [one.section for one in shown]
        sections = [*answers(shown), summary_section(shown), *own]
        if parameters.given:
            given = " and ".join([*([args.params] if args.params else []), *args.overrides])
            sections.append(parameter_section(parameters, given))
        sections.append(made.section())
        page = write_report(
            args.out,
            args.title,
            f"{counted(shown)}. {made.head}",
            sections,
            column=column,
            report=part(report, _READING, 1.0),
        )
    if args.json:
        write_json(args.json, document(shown, args.command_line, page))
    for one in shown:
        say(f"{one.path}: {one.said}")
    warnings = sum(len(one.warnings) for one in shown)
    size = page.stat().st_size / 1e6
    say(f"warnings {warnings}\nreport   {page}, {size:.1f} MB")
    return 0
