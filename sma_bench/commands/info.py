"""sma-bench info: what a record holds, and whether it can be trusted."""

from types import SimpleNamespace
from typing import Any

from sma_bench.border import printable
from sma_bench.commands import options
from sma_bench.commands.terminal import (
    output_console,
    print_findings,
    print_table,
    progress,
    say,
    write_json,
)
from sma_bench.errors import InputError
from sma_bench.findings import Finding

_MOST_MARKERS = 20

# Of each table of `describe`: heading, key, format.
_TABLES = {
    "topics": (
        ("topic", "name", ""), ("type", "type", ""), ("messages", "count", ""),
        ("signals", "signals", ""),
    ),
    "signals": (
        ("signal", "name", ""), ("unit", "unit", ""), ("samples", "samples", ""),
        ("rate Hz", "rate", ".4g"), ("jitter s", "jitter", ".2g"),
        ("longest gap s", "longest_gap", ".3g"), ("delay s", "delay", ".3g"), ("min", "min", ".5g"),
        ("max", "max", ".5g"),
    ),
    "segments": (
        ("segment", "number", ""), ("kind", "kind", ""), ("K/s", "rate", ".4f"),
        ("samples", "samples", ""), ("start s", "start", ".0f"), ("end s", "end", ".0f"),
        ("from K", "from", ".2f"), ("to K", "to", ".2f"),
    ),
    "branches": (
        ("cycle", "cycle", ""), ("kind", "kind", ""), ("samples", "samples", ""),
        ("from K", "from", ".2f"), ("to K", "to", ".2f"), ("strain from", "strain_from", ".5f"),
        ("strain to", "strain_to", ".5f"),
    ),
}  # fmt: skip


@options.command(
    "info my_bag",
    "info two_benches --namespace /left --json info.json",
)
@options.argument("record", "RECORD", "bag, storage file or instrument file")
@options.option("--namespace NAME", "look only at the topics below this namespace")
@options.json_option("what is shown")
def run(args: SimpleNamespace) -> int:
    """Print topics, signals and findings, whatever they say.

    Raises:
        InputError: no record, or one of another robot.
    """
    from sma_bench.records import describe, open_record

    with progress("reading"):
        description = describe(open_record(args.record, args.namespace))
    if args.json:
        write_json(args.json, description)
    say(f"{printable(description['path'])}: {_first_line(description)}")
    for name, columns in _TABLES.items():
        if rows := description.get(name):
            numbers = [k for k, c in enumerate(columns) if isinstance(rows[0][c[1]], (int, float))]
            cells = [[_cell(row[key], form) for _, key, form in columns] for row in rows]
            print_table(output_console(), [column[0] for column in columns], cells, right=numbers)
    markers = description.get("markers", [])
    for marker in markers[:_MOST_MARKERS]:
        say(f"  {marker['time']:10.3f} s  {printable(marker['text'])}")
    if len(markers) > _MOST_MARKERS:
        say(f"  and {len(markers) - _MOST_MARKERS} more markers")
    findings = [Finding(**finding) for finding in description["findings"]]
    print_findings(findings)
    if not findings:
        say("no findings")
    if description["kind"] == "bag" and not description["signals"] + markers:
        raise InputError(
            f"{args.record}: nothing of a bench in it, expected topics of docs/topics.md, e.g. "
            "<channel>/power, joint_states"
        )
    return 0


def _first_line(found: dict[str, Any]) -> str:
    if found["kind"] == "bag":
        channels = ", ".join(found["channels"]) or "none"
        return f"{found['duration']:.3f} s from {found['start']}, channels: {printable(channels)}"
    if found["kind"] == "dsc":
        sign = {True: "endothermic up", False: "exothermic up", None: "sign unknown"}
        return (
            f"{printable(found['instrument'])}, {printable(found['sample'])}, "
            f"{found['mass'] * 1e6:.3f} mg, {sign[found['endothermic_up']]}"
        )
    if found["kind"] == "isobaric":
        unit = {"1": "", "relative": ", strain over its own range"}[found["strain_unit"]]
        return f"isobaric test at {found['stress'] / 1e6:.1f} MPa{unit}"
    kelvin = found["temperature"]
    where = "temperature unknown" if kelvin is None else f"at {kelvin:.2f} K"
    return (
        f"tensile test {where}, {found['samples']} samples, to {found['largest_strain']:.4f} "
        f"strain and {found['largest_stress'] / 1e6:.1f} MPa"
    )


def _cell(value: Any, form: str) -> str:
    if isinstance(value, list):
        return ", ".join(value)
    return "-" if value is None else format(value, form)
