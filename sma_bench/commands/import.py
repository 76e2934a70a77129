"""sma-bench import: tables of other loggers to bags of the contract."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, write_json
from sma_bench.errors import InputError

if TYPE_CHECKING:
    from sma_bench.records.import_proposal import BenchHints

MAP_SUFFIX = ".map.yaml"


@options.command(
    "import run.csv --params rig.yaml --out run",
    "import monday.xlsx tuesday.xlsx --map run.map.yaml --out week --json week.json",
)
@options.argument(
    "files",
    "FILE...",
    "CSV, TSV or text, Excel (.xlsx), MATLAB (.mat), HDF5 or Parquet; each is one run",
)
@options.option(
    "--map MAP.yaml",
    "which column is what; proposed and written beside --out when not given",
    dest="map_file",
    type=options.Files(),
)
@options.option(
    "--params P.yaml",
    "the rig's parameter file: channels, load.kind, bench.drive, bench.supply_voltage",
    type=options.Files(),
)
@options.output(
    "--out BAG",
    options.OWN,
    "bag to write (new folder); of several files, a folder with a bag for each",
    required=True,
)
@options.json_option("what was imported")
def run(args: SimpleNamespace) -> int:
    """Read every file, then write every bag: a file that is wrong leaves none of them."""
    from sma_bench.records.import_map import read_map
    from sma_bench.records.import_proposal import BenchHints

    given = read_map(args.map_file) if args.map_file else None
    bench = _bench(args.params) if args.params else BenchHints()
    outputs = _outputs([Path(file) for file in args.files], Path(args.out))
    _protect(args, outputs)
    made = [_read(source, out, given, bench, args) for source, out in outputs]
    for one in made:
        _write(one, args.force)
        _print_import(one)
    if args.json:
        keys = ("source", "sha256", "format", "bag", "map", "signals", "how", "notes")
        write_json(args.json, {"imported": [{key: one[key] for key in keys} for one in made]})
    return 0


def _bench(path: str) -> "BenchHints":
    from sma_bench.parameters.yaml_file import read_parameter_names
    from sma_bench.records.import_proposal import bench_of

    return bench_of(read_parameter_names(path), path)


def _outputs(files: list[Path], out: Path) -> list[tuple[Path, Path]]:
    """Each file with its bag."""
    if len(files) == 1:
        return [(files[0], out)]
    stems = [re.sub(r"[^\w.-]+", "_", file.stem).strip(".") or "run" for file in files]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        raise InputError(f"--out {out}: two files would become {twice}, expected different names")
    return [(file, out / stem) for file, stem in zip(files, stems, strict=True)]


def _protect(args: SimpleNamespace, outputs: list[tuple[Path, Path]]) -> None:
    """No output replaces a file without --force, and no input ever."""
    inputs = options.paths_in([args.files, args.map_file, args.params])
    targets = {str(out): (out, options.BAG) for _, out in outputs}
    if not args.map_file:  # a map that is proposed; one that exists is looked at when it is written
        inputs_of_maps = {str(_map_of(out)): (_map_of(out), options.FILE) for _, out in outputs}
        options.keep_safe(inputs_of_maps, inputs, True)
    options.keep_safe(targets, inputs, args.force)


def _map_of(out: Path) -> Path:
    return out.with_name(out.name + MAP_SUFFIX)


def _read(
    source: Path, out: Path, given: Any, bench: "BenchHints", args: SimpleNamespace
) -> dict[str, Any]:
    from sma_bench.records.import_map import convert, map_text
    from sma_bench.records.import_proposal import propose
    from sma_bench.records.tables import read_table_file

    table = read_table_file(source)
    used, text, map_file = given, None, args.map_file
    questions: list[str] = []
    if given is None:
        used, questions, remarks = propose(table, bench)
        text, map_file = map_text(used, table, remarks), str(_map_of(out))
    if questions:
        _write_map(Path(map_file), text, args.force)
        more = f" (and {len(questions) - 1} more)" if len(questions) > 1 else ""
        raise InputError(
            f"{source}: unsure of {questions[0]}{more}: fill in {map_file} and call again with "
            f"--map {map_file}"
        )
    signals, sentences, start_ns = convert(table, used)
    return {
        "source": str(source), "sha256": table.sha256, "format": table.format, "bag": str(out),
        "map": map_file, "how": sentences, "notes": list(table.notes), "text": text,
        "start_ns": start_ns, "made": signals,
        "signals": {
            s.name: {
                "unit": s.unit, "samples": len(s), "min": float(s.values.min()),
                "max": float(s.values.max()),
            }
            for s in signals
        },
    }  # fmt: skip


def _write_map(path: Path, text: str | None, force: bool) -> None:
    """Write a proposed map, but not over one that somebody has edited."""
    from sma_bench.parameters.yaml_file import write_text_atomically

    if text is None:
        return
    if path.exists() and not force:
        if path.is_file() and path.read_text(errors="replace") == text:
            return
        raise InputError(f"{path}: exists already; --map {path} uses it, --force replaces it")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text_atomically(path, text)


def _write(one: dict[str, Any], force: bool) -> None:
    from sma_bench.records.bag_writer import write_record

    out = Path(one["bag"])
    if one["text"] is not None:
        _write_map(Path(one["map"]), one["text"], force)
    write_record(out, one["made"], start_ns=one["start_ns"], replace=force, provenance={
        "source": Path(one["source"]).name, "sha256": one["sha256"], "how": one["how"],
    })  # fmt: skip


def _print_import(one: dict[str, Any]) -> None:
    from sma_bench.border import printable
    from sma_bench.findings import Finding
    from sma_bench.records.check import check_record
    from sma_bench.records.record import Record

    print(printable(f"{one['bag']}: from {one['source']} by {one['map']}"))
    for sentence in one["how"]:
        print(printable(f"  {sentence}"))
    signals = {signal.name: signal for signal in one["made"]}
    record = Record(Path(one["bag"]), one["start_ns"], signals)
    print_findings([
        *(Finding("warning", one["source"], note) for note in one["notes"]),
        *(finding for finding in check_record(record) if finding.severity != "info"),
    ])  # fmt: skip
