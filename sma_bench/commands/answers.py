"""From records to answers: identify, diagnose, try, batch, investigate."""

import os
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median, stdev
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.border import make_folder, printable
from sma_bench.commands import options, terminal
from sma_bench.commands.records import import_tables
from sma_bench.errors import InputError
from sma_bench.findings import Finding, fold_audit
from sma_bench.lifeline import interrupts_held
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import part
from sma_bench.report.tables import Table, diagnosis_tables
from sma_bench.results import Invocation, with_unit

if TYPE_CHECKING:
    from sma_bench.parameters import Parameters
    from sma_bench.tasks.batch import Outcome

_CELLS_SHOWN = 6  # rows of the table of where the gap lies
_IDENTIFYING, _DIAGNOSING = 0.3, 0.9  # share of the time after which each is done, about
BAD_INPUT, MISFIT = 2, 3  # exit status: a record failed; the model does not fit the records


@options.command("identify")
def run_identify(args: SimpleNamespace) -> int:
    from sma_bench.records.open import parse_stated
    from sma_bench.tasks.work import identify_files, write_identified

    parameters, column = options.parameters_from_options(args), options.column_of(args)
    stated = parse_stated(args.stated) if args.stated else {}
    phases: dict[str, Any] = dict(options.pair("--phase", text, "FILE=martensite or FILE=austenite")
                                  for text in args.phases)
    with terminal.progress("identify") as report:
        result = identify_files(args.records, parameters, args.experiments or None, args.namespace,
                                report, phases, stated)
    terminal.write_json(args.json, result.to_json())
    if args.out:
        write_identified(args.out, result, "sma-bench identify", args.records, args.params)
    # Only bags can be diagnosed next.
    bags = [r for r in args.records if Path(r).is_dir() or {".mcap", ".db3"} & {*Path(r).suffixes}]
    terminal.print_card(result, _asked(args, bags))
    terminal.print_findings(result.notes)
    for experiment in result.experiments:
        terminal.say(f"\n{experiment.name} {experiment.title} ({experiment.source})")
        terminal.print_findings(experiment.findings)
    for line in result.accounts:
        terminal.say(line)
    _write_report(args, result, column, args.records)
    return MISFIT if result.is_misfit else 0


@options.command("diagnose")
def run_diagnose(args: SimpleNamespace) -> int:
    from sma_bench.estimation.observation import QUANTITIES
    from sma_bench.tasks.work import diagnose_files, write_improved

    parameters, column = options.parameters_from_options(args), options.column_of(args)
    with terminal.progress("diagnose") as report:
        compared = args.signals or QUANTITIES
        result = diagnose_files(args.records, args.hold_out, parameters, compared, report)
    terminal.write_json(args.json, result.to_json())
    if args.out:
        write_improved(args.out, result, "sma-bench diagnose")
    terminal.print_card(result, _asked(args, args.records))
    for name, table in diagnosis_tables(result).items():
        rows = table.rows[:_CELLS_SHOWN] if name == "where" else table.rows
        terminal.print_table(replace(table, rows=rows))
        print()
    for sentence in result.why:
        terminal.output_console().print(printable(sentence), markup=False)
    own, audit = fold_audit(result.findings)
    terminal.print_findings([*own, *audit[:1]])
    _write_report(args, result, column, args.records, args.hold_out)
    return 0


def _asked(args: SimpleNamespace, records: Sequence[str]) -> Invocation:
    """The parts of the command that the card's advice repeats."""
    return Invocation(tuple(records), args.params or "", args.out or "", args.report or "")


def _write_report(args: SimpleNamespace, result: Any, column: Any, *inputs: Any) -> None:
    """Write the page of a result if --report asks for one."""
    if args.report:
        made = options.provenance_of(args, *inputs)
        with terminal.progress("drawing the report") as report:
            page = result.report(args.report, report, made, column)
        terminal.say(f"report {page}")


@options.command("try")
def run_try(args: SimpleNamespace) -> int:
    """From tables to a page, by identify and diagnose. Exit status 3: the model does not fit."""
    from sma_bench.records.open import parse_stated
    from sma_bench.records.storage import is_bag
    from sma_bench.report.page import Made
    from sma_bench.report.reports import shown_input, write_collected_report
    from sma_bench.tasks import work

    out = Path(args.out or f"{Path(args.files[0]).stem}_tried")
    given = options.paths_in([args.files, args.map_file, args.params])
    names = "identified.json", "identified.yaml", "diagnosis.json", "improved.yaml"
    written, page = {name: out / name for name in names}, out / "page"
    kept = {name: (path, options.FILE) for name, path in written.items()}
    options.keep_safe({**kept, "page": (page, options.FOLDER)}, given, args.force)
    parameters = options.parameters_from_options(args)
    stated = parse_stated(args.stated) if args.stated else {}
    make_folder(out)
    for path in written.values():  # no result of an earlier run may remain
        path.unlink(missing_ok=True)
    records = _imported(args, out, stated)
    bags = [record for record in records if is_bag(Path(record))]

    results, pages, misfit = dict[str, Any](), [*records], False
    asked = Invocation(tuple(bags), args.params or "", "", str(page))
    with terminal.progress("try") as report:
        try:
            share = part(report, 0.0, _IDENTIFYING)
            found = work.identify_files(records, parameters, report=share, stated=stated)
        except InputError as error:
            if not (bags and args.params):
                raise
            terminal.say(f"identify: {error}")
        else:
            misfit = found.is_misfit
            file = written["identified.yaml"]
            work.write_identified(file, found, "sma-bench try", records, args.params)
            results["identified"] = found, replace(asked, out=str(file))
        if bags and args.params:
            share = part(report, _IDENTIFYING, _DIAGNOSING)
            gap = work.diagnose_files(bags, [], parameters, report=share)
            work.write_improved(written["improved.yaml"], gap, "sma-bench try")
            results["diagnosis"] = gap, replace(asked, out=str(written["improved.yaml"]))
        for name, (result, _) in results.items():
            terminal.write_json(str(written[f"{name}.json"]), result.to_json())
            pages.append(str(written[f"{name}.json"]))
        title = f"First look at {', '.join(Path(file).name for file in args.files)}"
        shown = [shown_input(path, k, None) for k, path in enumerate(pages, 1)]
        written_page = write_collected_report(
            page, title, shown, parameters, args.params or "",
            Made(args.command_line, [*map(str, given)]), None, part(report, _DIAGNOSING, 1.0))
    for result, own in results.values():
        terminal.print_card(result, own)
    if bags and not args.params:
        terminal.say("no --params: without stated parameters no gap was looked for")
    terminal.say(f"page {written_page}")
    entries = {name: result.to_json() for name, (result, _) in results.items()}
    terminal.write_json(args.json, {"page": str(written_page), "records": records, **entries})
    return MISFIT if misfit else 0


def _imported(args: SimpleNamespace, out: Path, stated: dict[str, float]) -> list[str]:
    """Paths of the records: files that are records themselves, and bags made of logger tables."""
    from sma_bench.records import open_records

    records, tables = [], []
    for file in args.files:
        try:
            if not all(getattr(one, "signals", True) for one in open_records(file, None, stated)):
                raise InputError(f"{file}: a bag of another bench")
            records.append(file)
        except InputError:  # perhaps a logger's table; if not, import reports what is wrong
            tables.append(file)
    for files in [tables] if args.together and tables else [[table] for table in tables]:
        bag = out / Path(files[0]).stem
        own = {"files": files, "out": str(bag), "json": None, "namespace": None}
        import_tables(SimpleNamespace(**(vars(args) | own)))
        is_one = (bag / "metadata.yaml").is_file()
        records += map(str, [bag] if is_one else sorted(bag.iterdir()))
    return records


@options.command("batch")
def run_batch(args: SimpleNamespace) -> int:
    """Process all records, print a table in their order. Exit status 2: one failed, 3: a misfit."""
    from sma_bench.tasks.batch import Outcome, Task, do_tasks

    parameters = options.parameters_from_options(args)
    paths = [str(Path(path).absolute()) for path in args.records]
    params = args.params and str(Path(args.params).absolute())
    tasks, names = [Task(args.kind, p, parameters, params) for p in paths], file_names(paths)
    if args.out:
        files = [Path(args.out) / f"{name}{end}" for name in names for end in (".json", ".yaml")]
        given = options.paths_in([*paths, args.params])
        options.keep_safe({str(file): (file, options.FILE) for file in files}, given, args.force)
        make_folder(Path(args.out))
    outcomes: dict[int, Outcome] = {}
    try:
        jobs = len(os.sched_getaffinity(0)) if args.jobs is None else args.jobs
        work = do_tasks(tasks, jobs, args.dask)
        with terminal.progress(f"batch {args.kind}") as report, closing(work):
            for k, outcome in work:
                outcomes[k] = outcome
                if args.out and outcome.result is not None:
                    file = str(Path(args.out) / names[k])
                    with interrupts_held():  # both files or none
                        terminal.write_json(f"{file}.json", outcome.result)
                        write_text_atomically(f"{file}.yaml", outcome.yaml)
                report(len(outcomes) / len(tasks), f"{len(outcomes)} of {len(tasks)} records done")
    except (KeyboardInterrupt, InputError) as error:
        if outcomes:
            reason = str(error) if isinstance(error, InputError) else "interrupted"
            lost = (Outcome(path, error=f"not done: {reason}") for path in paths)
            _print_outcomes(args, [outcomes.get(k, other) for k, other in enumerate(lost)])
        raise
    return _print_outcomes(args, [outcome for _, outcome in sorted(outcomes.items())])


def file_names(paths: list[str]) -> list[str]:
    """File names, one per record: the record's own; all numbered if two are the same."""
    names = [Path(path).name for path in paths]
    return names if len({*names}) == len(names) else [f"{k}_{n}" for k, n in enumerate(names, 1)]


def _print_outcomes(args: SimpleNamespace, outcomes: "list[Outcome]") -> int:
    entries = [{"record": o.path, "seconds": o.seconds, "error": o.error or None,
                "result": o.result} for o in outcomes]
    terminal.write_json(args.json, {"kind": args.kind, "records": entries})
    rows, numbers = [], defaultdict[str, list[dict[str, Any]]](list)
    for given, o in zip(args.records, outcomes, strict=True):
        result: dict[str, Any] = o.result or {"card": []}
        fits = [fit["verdict"] for fit in result.get("fit", {}).values()]
        state = "failed" if o.error else "misfit" if "misfit" in fits else "done"
        card = [text for k, (label, text) in enumerate(result["card"]) if not k or label == "fit"]
        rows.append((given, state, ". ".join(card), f"{o.seconds:.1f}"))
        for name, number in result.get("parameters", {}).items():
            numbers[name].append(number)
    terminal.print_table(Table(("record", "", "result", "s"), rows, frozenset({3})))
    repeats = list[tuple[str, str, str]]()
    for name, own in numbers.items():
        values, error = [one["value"] for one in own], median(one["std"] for one in own)
        scatter = stdev(values) if len(own) > 1 else 0.0
        shown = with_unit(own[0]["unit"], fmean(values), scatter, error)
        repeats.append((name, f"{len(own)}", shown))
    if repeats:
        header = ("parameter", "records", "mean ± scatter ± error of one record")
        terminal.print_table(Table(header, repeats, frozenset({1})))
    failed = [o for o in outcomes if o.error]
    terminal.print_findings(Finding("error", "batch", o.error) for o in failed)
    print(f"\n{len(outcomes) - len(failed)} of {len(outcomes)} records done")
    return BAD_INPUT if failed else MISFIT if any(row[1] == "misfit" for row in rows) else 0


@options.command("investigate")
def run_investigate(args: SimpleNamespace) -> int:
    """Repeat until the cause is named, inseparable, or time is up. Exit 0 with any verdict."""
    from sma_bench.tasks.investigation import HEADER, OPEN, QUANTITIES, TEST, Investigation

    options.one_only(args, "simulated", "namespace")
    options.claim_outputs([Path(args.folder)])
    case = Investigation(args.folder, args.budget, args.signals or QUANTITIES)
    case.begin(options.parameters_from_options(args), args.records)
    while True:
        if case.pending:
            with terminal.progress("investigate") as report:
                result = case.diagnose(report)
            terminal.say(f"{result}\n")
        if case.state != OPEN:
            break
        following = case.next_run()
        if not _agreed(following, args.yes):
            terminal.say(f"stopped; the same command continues in {args.folder}")
            break
        if args.simulated:
            _run_simulated(following, args.simulated, case.believed)
        else:
            run_bench(following, args.namespace)
    if case.chapters:
        terminal.print_table(Table(HEADER, case.rows(), frozenset({0, 1}), title="History"))
        terminal.say(f"{case.summary()}; page {case.write_page(args.command_line)}")
        if case.state == TEST:
            terminal.say(f"next: {case.chapters[-1].proposed['why']}; enter its result in "
                         f"{case.folder}/believed.yaml, or record with the sensor and add the "
                         "bag to the command, then run the same command again")
    terminal.write_json(args.json, case.to_json())
    return 0


def _agreed(offer: Mapping[str, Any], yes: bool) -> bool:
    """Show the proposed run and ask; True if the wires may be driven."""
    terminal.say(f"next: {offer['protocol']}, {offer['minutes']:.1f} min, "
                 f"up to {offer['volts']:.2f} V ({offer['file']})")
    if yes:
        return True
    if not sys.stdin.isatty():
        terminal.say("not confirmed: no terminal to ask; --yes runs without asking")
        return False
    with suppress(EOFError):
        return input("run it? [y/N] ").strip().lower() in ("y", "yes")
    return False


def _run_simulated(run: Mapping[str, Any], bench: str, stated: "Parameters") -> None:
    """Drive a simulated bench with the parameters of a file, and record it."""
    from sma_bench.live.virtual_bench import SimulatedRun
    from sma_bench.parameters import read_parameters
    from sma_bench.protocols import load_protocol
    from sma_bench.records.bag_writer import write_record

    hidden, seed = read_parameters(bench), run["bag"].rpartition("_")[2]
    protocol = load_protocol(run["file"], stated)
    with terminal.progress(protocol.name):
        signals, markers = SimulatedRun(hidden, stated, int(seed)).follow(protocol)
    made = {"how": "simulated bench", "source": bench}
    write_record(run["bag"], signals, start_ns=time.time_ns(), markers=markers, provenance=made)


def run_bench(run: Mapping[str, Any], namespace: str | None) -> None:
    """Drive a bench through its experiment node, and record it with a recorder started here."""
    with options.needs_ros("investigate", "--simulated needs no ROS 2"):
        from sma_bench.ros.bench_client import BenchClient
    name, seconds = run["protocol"], 60.0 * run["minutes"]
    with terminal.progress(name) as report, BenchClient(options.namespace_of(namespace)) as client:
        client.run_recorded(run["file"], name, seconds, run["bag"], lambda s: report(0.0, s))
