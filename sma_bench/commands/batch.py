"""sma-bench batch: many records, each identified or diagnosed by itself, side by side."""

import os
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

from sma_bench.border import make_folder
from sma_bench.commands import options
from sma_bench.commands.identify import MISFIT
from sma_bench.commands.terminal import print_findings, print_table, progress, write_json
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.lifeline import interrupts_held
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import counted
from sma_bench.tasks.batch import IDENTIFY, Outcome, Task, do_tasks

_BAD_INPUT = 2


@options.command("batch")
def run(args: SimpleNamespace) -> int:
    """Do every record, print a table in their order; 2 where one failed, 3 where one misfits."""
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
        with progress(f"batch {args.kind}") as report, closing(work):
            count = counted(report, len(tasks), "record")
            for k, outcome in work:
                outcomes[k] = outcome
                if args.out and outcome.result is not None:
                    file = str(Path(args.out) / names[k])
                    with interrupts_held():  # both or none
                        write_json(f"{file}.json", outcome.result)
                        write_text_atomically(f"{file}.yaml", outcome.yaml)
                count(len(outcomes))
    except (KeyboardInterrupt, InputError) as error:
        if outcomes:
            reason = str(error) if isinstance(error, InputError) else "interrupted"
            lost = (Outcome(path, error=f"not done: {reason}") for path in paths)
            _print_outcomes(args, [outcomes.get(k, other) for k, other in enumerate(lost)])
        raise
    return _print_outcomes(args, [outcome for _, outcome in sorted(outcomes.items())])


def file_names(paths: list[str]) -> list[str]:
    """A name a record for its files: the record's own, numbered where it comes again."""
    own = [Path(path).name for path in paths]
    counts = [own[: k + 1].count(name) for k, name in enumerate(own)]
    names = [f"{name}_{n}" if n > 1 else name for name, n in zip(own, counts, strict=True)]
    while len(set(names)) < len(names):  # a record may be called as another's number makes it
        names = [f"{k + 1}_{name}" for k, name in enumerate(names)]
    return names


def _print_outcomes(args: SimpleNamespace, outcomes: list[Outcome]) -> int:
    from sma_bench.report.tables import Table

    entries = [
        {"record": o.path, "seconds": o.seconds, "error": o.error or None, "result": o.result}
        for o in outcomes
    ]
    write_json(args.json, {"kind": args.kind, "records": entries})
    rows, misfit = [], False
    for given, o in zip(args.records, outcomes, strict=True):
        said, state = "", "failed" if o.error else "done"
        if o.result is not None and args.kind == IDENTIFY:
            found = o.result["parameters"].items()
            said = ", ".join(f"{name} {entry['value']:.5g}" for name, entry in found)
            if any(fit["verdict"] == "misfit" for fit in o.result["fit"].values()):
                state, misfit, said = "misfit", True, f"{o.result['card'][0][1]}. {said}"
        elif o.result is not None:
            said = ": ".join(filter(None, (o.result["verdict"], ", ".join(o.result["cause"]))))
        rows.append((given, state, said, f"{o.seconds:.1f}"))
    print_table(Table(("record", "", "result", "s"), rows, frozenset({3})))
    failed = [o for o in outcomes if o.error]
    print_findings(Finding("error", "batch", o.error) for o in failed)
    print(f"\n{len(outcomes) - len(failed)} of {len(outcomes)} records done")
    return _BAD_INPUT if failed else MISFIT if misfit else 0
