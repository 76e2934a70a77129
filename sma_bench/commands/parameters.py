"""Parameters and effects as tables, the audit of a lab's parameters, files to start from."""

import shutil
from pathlib import Path
from types import SimpleNamespace

from sma_bench.border import make_folder
from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, print_table, say, write_json
from sma_bench.errors import InputError, did_you_mean
from sma_bench.installation import share_directory
from sma_bench.parameters import write_parameters
from sma_bench.parameters.audit import audit
from sma_bench.parameters.node_tables import markdown, range_of
from sma_bench.parameters.parameter import EFFECTS, TABLE
from sma_bench.report.tables import Table, cell_of


@options.command("example")
def run_example(args: SimpleNamespace) -> int:
    share = share_directory()
    files = {folder.name: {path.name: path for path in sorted(folder.iterdir())}
             for folder in sorted((share / "examples").iterdir())
             if (folder / "lab.yaml").is_file()}
    files |= {rig.stem: {"lab.yaml": rig} for rig in sorted((share / "config").glob("*_rig.yaml"))}
    if args.name is None:
        for name, found in files.items():
            say(f"{name}: {', '.join(found)}")
        return 0
    if args.name not in files:
        hint = did_you_mean(args.name, files) or f", expected one of {', '.join(files)}"
        raise InputError(f"no example {args.name!r}{hint}")
    folder = Path(args.out or args.name)
    options.keep_safe({"--out": (folder, options.FOLDER)}, [], args.force)
    make_folder(folder)
    for name, path in files[args.name].items():
        shutil.copyfile(path, folder / name)
        say(f"{folder / name}")
    return 0


@options.command("parameters")
def run_parameters(args: SimpleNamespace) -> int:
    parameters = options.parameters_from_options(args)
    sources = [p.provenance if parameters[p.name] == p.default else "given" for p in TABLE]
    entries = [{"name": p.name, "unit": p.unit, "value": parameters[p.name],
                "std": parameters.std(p.name) if p.uncertainty is not None else None, "low": p.low,
                "high": p.high, "description": p.description, "source": source}
               for p, source in zip(TABLE, sources, strict=True)]
    write_json(args.json, {"parameters": entries})
    if args.markdown:
        print(markdown("parameters"), end="")
    elif args.out:
        comment = "Parameters of an SMA bench in SI units.\nLoad with: --ros-args --params-file"
        write_parameters(args.out, parameters, comment, template=args.params or args.out,
                         explain=True)
        print(args.out)
    else:
        rows = [(p.name, cell_of(parameters[p.name]), p.unit, source)
                for p, source in zip(TABLE, sources, strict=True)]
        print_table(Table(("parameter", "value", "unit", "source"), rows))
    return 0


@options.command("effects")
def run_effects(args: SimpleNamespace) -> int:
    numbers = ("name", "unit", "default", "low", "high")
    entries = [{"name": e.name, "stage": e.stage, "acts_on": list(e.acts_on), "shows": e.shows,
                "parameters": [{key: getattr(p, key) for key in numbers} for p in e.parameters]}
               for e in EFFECTS.values()]
    write_json(args.json, {"effects": entries})
    if args.markdown:
        print(markdown("effects"), end="")
    else:
        rows = [(e.name, e.stage, range_of(e.size), e.shows) for e in EFFECTS.values()]
        print_table(Table(("effect", "stage", "size", "signs in the data"), rows))
    return 0


@options.command("audit")
def run_audit(args: SimpleNamespace) -> int:
    """Print every finding. Exit code 0 in any case: a clash is a result, not an error."""
    if args.file and args.params:
        raise InputError(f"audit: {args.file} and --params {args.params} given, expected one file")
    args.params = args.params or args.file
    parameters = options.parameters_from_options(args)
    findings = audit(parameters, papers_own=args.paper or not parameters.given)
    write_json(args.json, {"findings": [finding.to_json() for finding in findings]})
    print_findings(findings)
    clashes = sum(finding.severity != "info" for finding in findings)
    print(f"{clashes} of {len(findings)} checks found a clash")
    return 0
