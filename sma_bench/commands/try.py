"""sma-bench try: from a logger's table, an instrument's file or a bag to one page."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sma_bench.border import make_folder
from sma_bench.commands import options, terminal
from sma_bench.commands.identify import MISFIT
from sma_bench.errors import InputError

_IDENTIFYING, _DIAGNOSING = 0.3, 0.9  # of the time, about


@options.command("try")
def run(args: SimpleNamespace) -> int:
    """Import tables, identify, diagnose what the bench's file states, draw; 3 where the model does
    not fit, and 2 with the reason of identify where nothing can be found."""
    from sma_bench.progress import part
    from sma_bench.records.open import parse_stated
    from sma_bench.records.storage import is_bag
    from sma_bench.report.page import Made
    from sma_bench.report.reports import shown_input, write_collected_report
    from sma_bench.results import Invocation, card_text
    from sma_bench.tasks.work import (
        diagnose_files,
        identify_files,
        write_identified,
        write_improved,
    )

    out = Path(args.out or f"{Path(args.files[0]).stem}_tried")
    given = options.paths_in([args.files, args.map_file, args.params])
    names = "identified.json", "identified.yaml", "diagnosis.json", "improved.yaml"
    written, page = {name: out / name for name in names}, out / "page"
    kept = {name: (path, options.FILE) for name, path in written.items()}
    options.keep_safe({**kept, "page": (page, options.FOLDER)}, given, args.force)
    parameters = options.parameters_from_options(args)
    stated = parse_stated(args.stated) if args.stated else {}
    make_folder(out)
    for path in written.values():  # what this run does not find again
        path.unlink(missing_ok=True)
    records = _imported(args, out, stated)
    bags = [record for record in records if is_bag(Path(record))]

    results, pages, misfit = dict[str, Any](), [*records], False
    asked = Invocation(tuple(bags), args.params or "", "", str(page))
    with terminal.progress("try") as report:
        try:
            found = identify_files(records, parameters, None, None, part(report, 0.0, _IDENTIFYING),
                                   {}, stated)
        except InputError as error:
            if not (bags and args.params):
                raise
            terminal.say(f"identify: {error}")
        else:
            misfit = found.is_misfit
            write_identified(written["identified.yaml"], found, "sma-bench try", records,
                             args.params)
            results["identified"] = found, replace(asked, out=str(written["identified.yaml"]))
        if bags and args.params:
            share = part(report, _IDENTIFYING, _DIAGNOSING)
            gap = diagnose_files(bags, [], parameters, report=share)
            write_improved(written["improved.yaml"], gap, "sma-bench try")
            results["diagnosis"] = gap, replace(asked, out=str(written["improved.yaml"]))
        for name, (result, _) in results.items():
            terminal.write_json(str(written[f"{name}.json"]), result.to_json())
            pages.append(str(written[f"{name}.json"]))
        written_page = write_collected_report(
            page, f"First look at {', '.join(Path(file).name for file in args.files)}",
            [shown_input(path, k, None) for k, path in enumerate(pages, 1)], parameters,
            args.params or "", Made(args.command_line, [*map(str, given)]), None,
            part(report, _DIAGNOSING, 1.0),
        )  # fmt: skip
    console = terminal.output_console()
    for result, own in results.values():
        console.print(f"{card_text(result, console.width, own)}\n", markup=False, soft_wrap=True)
    if bags and not args.params:
        terminal.say("no --params: nothing is believed of this bench, so no gap was looked for")
    terminal.say(f"page {written_page}")
    entries = {name: result.to_json() for name, (result, _) in results.items()}
    terminal.write_json(args.json, {"page": str(written_page), "records": records, **entries})
    return MISFIT if misfit else 0


def _imported(args: SimpleNamespace, out: Path, stated: dict[str, float]) -> list[str]:
    """Paths of records: those of the files, and of loggers' tables the bags made of them."""
    from sma_bench.records import open_records

    records, tables = [], []
    for file in args.files:
        try:
            open_records(file, None, stated)
            records.append(file)
        except InputError:  # import says what is wrong with what is no logger's table either
            tables.append(file)
    for files in [tables] if args.together and tables else [[table] for table in tables]:
        bag = str(out / Path(files[0]).stem)
        asked = [*files, "--out", bag]
        for option, values in (("--map", [args.map_file]), ("--params", [args.params]),
                               ("--unit", args.units)):
            asked += [word for value in values if value for word in (option, value)]
        asked += [f"--{name}" for name in ("together", "force") if getattr(args, name)]
        options.run_command(import_module("sma_bench.commands.import").run, "sma-bench try", asked)
        made = Path(bag)
        records += [bag] if (made / "metadata.yaml").is_file() else map(str, sorted(made.iterdir()))
    return records
