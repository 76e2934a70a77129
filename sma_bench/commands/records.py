"""Commands that read records: info, and import of tables of other loggers."""

import re
from pathlib import Path
from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, print_table, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.findings import Finding

_MOST_MARKERS = 20


@options.command("info")
def run_info(args: SimpleNamespace) -> int:
    """Print topics, signals and findings. InputError: no record, or no bench topics in it."""
    from sma_bench.records import describe, open_records
    from sma_bench.records.open import parse_stated
    from sma_bench.report.tables import record_line, record_tables

    stated = parse_stated(args.stated) if args.stated else {}
    with progress("reading"):
        found = [describe(record) for record in open_records(args.record, args.namespace, stated)]
    write_json(args.json, {**found[0], **({"sheets": found[1:]} if len(found) > 1 else {})})
    for description in found:
        say(f"{description['path']}: {record_line(description)}")
        for table in record_tables(description):
            print_table(table)
        markers = description.get("markers", [])
        for marker in markers[:_MOST_MARKERS]:
            say(f"  {marker['time']:10.3f} s  {marker['text']}")
        if len(markers) > _MOST_MARKERS:
            say(f"  and {len(markers) - _MOST_MARKERS} more markers")
        print_findings(Finding(**finding) for finding in description["findings"])
        if not description["findings"]:
            say("no findings")
        say(description["account"])
    if found[0]["kind"] == "bag" and not found[0]["signals"] + found[0]["markers"]:
        raise InputError(f"{args.record}: holds no topic of a bench, expected those of "
                         "docs/topics.md, e.g. <channel>/power, joint_states; sma-bench import "
                         "reads topics of another bench")
    return 0


@options.command("import")
def run_import(args: SimpleNamespace) -> int:
    return import_tables(args)


def import_tables(args: SimpleNamespace) -> int:
    """Read all files before writing any bag: if one file is wrong, no bag is written."""
    from sma_bench.parameters import Parameters, read_parameters
    from sma_bench.parameters.parameters import load_kind
    from sma_bench.parameters.yaml_file import write_text_atomically
    from sma_bench.records import import_map as maps
    from sma_bench.records.bag_tables import read_bag_tables
    from sma_bench.records.bag_writer import write_record
    from sma_bench.records.check import check_record
    from sma_bench.records.clocks import started
    from sma_bench.records.storage import is_bag
    from sma_bench.records.tables import read_table_file

    given = maps.read_map(args.map_file) if args.map_file else None
    bench = read_parameters(args.params) if args.params else Parameters.defaults()
    units = dict(options.pair("--unit", text, "COLUMN=UNIT") for text in args.units)
    # A bag and a map for each file or sheet; maps lie next to the folder: `week/*` is bags only.
    out, tables = Path(args.out), [
        read_bag_tables(Path(file), args.namespace) if is_bag(Path(file)) else read_table_file(file)
        for file in args.files]
    runs = [(f, *run) for f, t in zip(args.files, tables, strict=True) for run in maps.runs_of(t)]
    runs = [(args.files[0], "", maps.together(tables))] if args.together else runs
    starts = dict(options.pair("--start", text, "CLOCK=WHEN") for text in args.starts)
    for _, _, table in runs:
        maps.require_columns(table, starts)
    runs = [(file, sheet, started(table, starts)) for file, sheet, table in runs]
    stems = [re.sub(r"[^\w.-]+", "_", f"{Path(file).stem} {sheet}".strip()).strip(".") or "run"
             for file, sheet, _ in runs]  # fmt: skip
    if twice := next((stem for stem in stems if stems.count(stem) > 1), ""):
        raise InputError(f"--out {out}: two files would both become {twice}, expected other names")
    is_one = len(runs) == 1
    bags = [out if is_one else out / stem for stem in stems]
    paths = [out.with_name(f"{out.name}{'' if is_one else f'.{s}'}.map.yaml") for s in stems]
    inputs = options.paths_in([args.files, args.map_file, args.params])
    if given is None:  # write_map checks maps that exist
        options.keep_safe({str(path): (path, options.FILE) for path in paths}, inputs, True)
    options.keep_safe({str(bag): (bag, options.BAG) for bag in bags}, inputs, args.force)

    def write_map(path: Path, text: str) -> None:
        """Write a proposed map; one that was edited is replaced with --force only."""
        is_same = path.is_file() and path.read_text(errors="replace") == text
        if path.exists() and not is_same and not args.force:
            raise InputError(f"{path}: exists already; --map {path} uses it, --force replaces it")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, text)
    # Nothing is written before everything is read, except a map that the user must complete.
    read = []
    for (source, _, table), bag, path in zip(runs, bags, paths, strict=True):
        used, asked, remarks = (given, [], {}) if given else maps.propose(table, bench, units)
        account = maps.account_of(table, used, remarks, asked)
        text = "" if given else maps.map_text(used, table, remarks)
        if asked:
            write_map(path, text)
            say(str(account))
            more = f" (and {len(asked) - 1} more)" if len(asked) > 1 else ""
            fill = f"write the answer into {path}, then repeat with --map {path}"
            raise InputError(f"{source}: unsure of {asked[0]}{more}; {fill}")
        assumed = [f"{name}: {remark}" for name, remark in remarks.items() if " as " in remark]
        converted = maps.convert(table, used, bag)
        read.append((source, path, table, used, text, account, assumed, *converted))
    entries = []
    imposed = "elongation" if load_kind(bench) == "displacement" else ""  # not moved by the wire
    for source, path, table, used, text, account, assumed, record, how in read:
        notes = [*table.notes, *assumed]
        if given is None:
            write_map(path, text)
        clocks = [column.values for column in table.columns if column.name in used.time]
        repeated = sum(int((clock[1:] == clock[:-1]).sum()) for clock in clocks)
        name, digest = Path(source).name, table.sha256
        about = {"source": name, "sha256": digest, "how": how, "repeated": repeated}
        write_record(record.path, record, replace=args.force, provenance=about)
        map_file = args.map_file or str(path)
        say("\n  ".join([f"{record.path}: from {source} by {map_file}", *how]))
        print_findings([Finding("warning", source, note) for note in notes])
        found = [f for f in check_record(record) if f.severity != "info"]
        print_findings(f for f in found if f.subject != imposed)
        say(str(account))
        spans = {name: {"unit": s.unit, "samples": len(s), "min": float(s.values.min()),
                        "max": float(s.values.max())} for name, s in record.signals.items()}
        entries.append({**about, "source": source, "format": table.format, "bag": str(record.path),
                        "map": map_file, "signals": spans, "notes": notes,
                        "account": vars(account)})
    write_json(args.json, {"imported": entries})
    return 0
