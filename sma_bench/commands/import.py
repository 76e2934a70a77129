"""sma-bench import: tables of other loggers to bags of the contract."""

import re
from pathlib import Path
from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, say, write_json
from sma_bench.errors import InputError

MAP_SUFFIX = ".map.yaml"


@options.command("import")
def run(args: SimpleNamespace) -> int:
    """Read every file, then write every bag: a file that is wrong leaves none of them."""
    import numpy as np

    from sma_bench.border import printable
    from sma_bench.findings import Finding
    from sma_bench.parameters.yaml_file import read_parameter_names
    from sma_bench.records.bag_writer import write_record
    from sma_bench.records.check import check_record
    from sma_bench.records.import_map import account_of, convert, map_text, read_map
    from sma_bench.records.import_proposal import BenchHints, bench_of, propose
    from sma_bench.records.record import Record
    from sma_bench.records.tables import read_table_file, runs_of, together

    given = read_map(args.map_file) if args.map_file else None
    bench = BenchHints()
    if args.params:
        bench = bench_of(read_parameter_names(args.params), args.params)
    units = dict(text.rpartition("=")[::2] for text in args.units)
    if "" in units:
        raise InputError(f"--unit {units['']!r}, expected COLUMN=UNIT")
    # Each file, and each sheet that is a run of its own, with its bag and its map.
    out = Path(args.out)
    tables = [read_table_file(Path(file)) for file in args.files]
    runs = [(f, *run) for f, t in zip(args.files, tables, strict=True) for run in runs_of(t)]
    if args.together:
        runs = [(args.files[0], "", together(tables))]
    stems = [re.sub(r"[^\w.-]+", "_", f"{Path(file).stem} {sheet}".strip()).strip(".") or "run"
             for file, sheet, _ in runs]  # fmt: skip
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        raise InputError(f"--out {out}: two files would become {twice}, expected different names")
    bags = [out] if len(stems) == 1 else [out / stem for stem in stems]
    # Maps lie beside the folder of bags, where `identify week/*` does not trip over them.
    maps = [out.with_name((out.name if bag == out else f"{out.name}.{stem}") + MAP_SUFFIX)
            for bag, stem in zip(bags, stems, strict=True)]  # fmt: skip
    inputs = options.paths_in([args.files, args.map_file, args.params])
    if given is None:  # a map that exists is looked at when it is written
        options.keep_safe({str(path): (path, options.FILE) for path in maps}, inputs, True)
    options.keep_safe({str(bag): (bag, options.BAG) for bag in bags}, inputs, args.force)
    # Everything is read before anything is written, but for a map that is to be filled in.
    read = []
    for (source, _, table), bag, path in zip(runs, bags, maps, strict=True):
        used, questions, remarks = (given, [], {}) if given else propose(table, bench, units)
        text = None if given else map_text(used, table, remarks)
        account = account_of(table, used, remarks, questions)
        if questions:
            _write_map(path, text, args.force)
            say(printable(str(account)))
            more = f" (and {len(questions) - 1} more)" if len(questions) > 1 else ""
            raise InputError(
                f"{source}: unsure of {questions[0]}{more}: fill in {path} and call again with "
                f"--map {path}"
            )
        read.append((source, bag, path, table, used, text, account, *convert(table, used)))
    entries = []
    for source, bag, path, table, used, text, account, signals, how, start_ns in read:
        map_file = args.map_file or str(path)
        _write_map(path, text, args.force)
        clocks = [column.values for column in table.columns if column.name in used.clocks]
        repeated = sum(int(np.sum(np.diff(clock) == 0.0)) for clock in clocks)
        provenance = {"source": Path(source).name, "sha256": table.sha256, "how": how,
                      "repeated": repeated}
        write_record(bag, signals, start_ns=start_ns, replace=args.force, provenance=provenance)
        print(printable("\n  ".join([f"{bag}: from {source} by {map_file}", *how]), "\n"))
        record = Record(bag, start_ns, {signal.name: signal for signal in signals})
        print_findings([Finding("warning", source, note) for note in table.notes])
        print_findings(f for f in check_record(record) if f.severity != "info")
        say(f"{account}")
        shown = {
            s.name: {"unit": s.unit, "samples": len(s), "min": float(s.values.min()),
                     "max": float(s.values.max())}
            for s in signals
        }  # fmt: skip
        entries.append({
            "source": source, "sha256": table.sha256, "format": table.format, "bag": str(bag),
            "map": map_file, "signals": shown, "how": how, "notes": list(table.notes),
            "account": account.to_json(),
        })  # fmt: skip
    if args.json:
        write_json(args.json, {"imported": entries})
    return 0


def _write_map(path: Path, text: str | None, force: bool) -> None:
    """Write a proposed map, but not over one that somebody has edited."""
    from sma_bench.parameters.yaml_file import write_text_atomically

    is_there = path.exists() and not force
    if text is None or (is_there and path.is_file() and path.read_text(errors="replace") == text):
        return
    if is_there:
        raise InputError(f"{path}: exists already; --map {path} uses it, --force replaces it")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text_atomically(path, text)
