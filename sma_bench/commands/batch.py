"""sma-bench batch: many records, each identified or diagnosed by itself, side by side."""

import os
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

from sma_bench.border import make_folder
from sma_bench.commands import options
from sma_bench.commands.terminal import (
    output_console,
    print_findings,
    print_table,
    progress,
    write_json,
)
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.lifeline import interrupts_held
from sma_bench.parameters import write_parameters
from sma_bench.progress import counted
from sma_bench.tasks.batch import IDENTIFY, Outcome, Task, do_tasks

_BAD_INPUT = 2


@options.command("batch")
def run(args: SimpleNamespace) -> int:
    """Do every record, print a table in their order; 2 where one failed, the others unharmed."""
    parameters = options.parameters_from_options(args)
    paths = [str(Path(path).absolute()) for path in args.records]
    tasks = [Task(args.kind, path, parameters) for path in paths]
    names = _names(paths)
    if args.out:
        files = [Path(args.out) / f"{name}{end}" for name in names for end in (".json", ".yaml")]
        given = [Path(path) for path in (*paths, args.params) if path and Path(path).exists()]
        options.keep_safe({str(file): (file, options.FILE) for file in files}, given, args.force)
        make_folder(Path(args.out))
    outcomes: list[Outcome | None] = [None] * len(tasks)
    try:
        jobs = len(os.sched_getaffinity(0)) if args.jobs is None else args.jobs
        done_so_far = closing(do_tasks(tasks, jobs, args.dask))
        with progress(f"batch {args.kind}") as report, done_so_far as work:
            count = counted(report, len(tasks), "record")
            for done, (k, outcome) in enumerate(work, start=1):
                outcomes[k] = outcome
                if args.out and outcome.result is not None and outcome.parameters is not None:
                    comment = f"By sma-bench batch from {outcome.path}".replace("\n", " ")
                    file = str(Path(args.out) / names[k])
                    with interrupts_held():  # both or none
                        write_json(f"{file}.json", outcome.result)
                        write_parameters(f"{file}.yaml", outcome.parameters, comment)
                count(done)
    except (KeyboardInterrupt, InputError) as error:
        if any(outcomes):
            reason = str(error) if isinstance(error, InputError) else "interrupted"
            _print_outcomes(args, paths, outcomes, f"not done: {reason}")
        raise
    _print_outcomes(args, paths, outcomes)
    return _BAD_INPUT if any(o is None or o.error for o in outcomes) else 0


def _names(paths: list[str]) -> list[str]:
    """A name a record for its files: the record's own, numbered where it comes again."""
    seen: dict[str, int] = {}
    names = []
    for path in paths:
        name = Path(path).name
        seen[name] = seen.get(name, 0) + 1
        names.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    while len(set(names)) < len(names):  # a record may be called as another's number makes it
        names = [f"{k + 1}_{name}" for k, name in enumerate(names)]
    return names


def _print_outcomes(
    args: SimpleNamespace, paths: list[str], outcomes: list[Outcome | None], stopped: str = ""
) -> None:
    whole = [o or Outcome(path, error=stopped) for path, o in zip(paths, outcomes, strict=True)]
    if args.json:
        entries = [
            {"record": o.path, "seconds": o.seconds, "error": o.error or None, "result": o.result}
            for o in whole
        ]
        write_json(args.json, {"kind": args.kind, "records": entries})
    rows = [
        (given, "failed" if o.error else "done", _summary(args.kind, o), f"{o.seconds:.1f}")
        for given, o in zip(args.records, whole, strict=True)
    ]
    headings = ("record", "", "result", "s")
    print_table(output_console(), headings, rows, right=(3,))
    failed = [o for o in whole if o.error]
    print_findings(Finding("error", "batch", o.error) for o in failed)
    print(f"\n{len(whole) - len(failed)} of {len(whole)} records done")


def _summary(kind: str, outcome: Outcome) -> str:
    if outcome.result is None:
        return ""
    if kind == IDENTIFY:
        found = outcome.result["parameters"]
        return ", ".join(f"{name} {entry['value']:.5g}" for name, entry in found.items())
    cause = ", ".join(outcome.result["cause"])
    return f"{outcome.result['verdict']}{': ' if cause else ''}{cause}"
