"""sma-bench info: what a record holds, and whether it can be trusted."""

from types import SimpleNamespace
from typing import Any

from rich.console import Console
from rich.markup import escape

from sma_bench.border import printable
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

_MOST_MARKERS = 20

_Columns = tuple[tuple[str, str, str], ...]

# Heading, key of `describe`, format.
_SIGNAL_COLUMNS: _Columns = (
    ("signal", "name", ""),
    ("unit", "unit", ""),
    ("samples", "samples", ""),
    ("rate Hz", "rate", ".4g"),
    ("jitter s", "jitter", ".2g"),
    ("longest gap s", "longest_gap", ".3g"),
    ("delay s", "delay", ".3g"),
    ("min", "min", ".5g"),
    ("max", "max", ".5g"),
)
_TOPIC_COLUMNS: _Columns = (
    ("topic", "name", ""),
    ("type", "type", ""),
    ("messages", "count", ""),
    ("signals", "signals", ""),
)
_SEGMENT_COLUMNS: _Columns = (
    ("segment", "number", ""),
    ("kind", "kind", ""),
    ("K/s", "rate", ".4f"),
    ("samples", "samples", ""),
    ("start s", "start", ".0f"),
    ("end s", "end", ".0f"),
    ("from K", "from", ".2f"),
    ("to K", "to", ".2f"),
)
_BRANCH_COLUMNS: _Columns = (
    ("cycle", "cycle", ""),
    ("kind", "kind", ""),
    ("samples", "samples", ""),
    ("from K", "from", ".2f"),
    ("to K", "to", ".2f"),
    ("strain from", "strain_from", ".5f"),
    ("strain to", "strain_to", ".5f"),
)


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
    console = output_console()
    _SHOW[description["kind"]](console, description)
    findings = [Finding(**finding) for finding in description["findings"]]
    print_findings(findings)
    if not findings:
        console.print("no findings")
    if description["kind"] == "bag" and not description["signals"] + description["markers"]:
        raise InputError(
            f"{args.record}: nothing of a bench in it, expected topics of docs/topics.md, e.g. "
            "<channel>/power, joint_states"
        )
    return 0


def _show_bag(console: Console, description: dict[str, Any]) -> None:
    channels = ", ".join(description["channels"]) or "none"
    console.print(
        f"{_shown(description['path'])}: {description['duration']:.3f} s from "
        f"{description['start']}, channels: {_shown(channels)}"
    )
    _print_rows(console, description["topics"], _TOPIC_COLUMNS)
    if description["signals"]:
        _print_rows(console, description["signals"], _SIGNAL_COLUMNS)
    markers = description["markers"]
    for marker in markers[:_MOST_MARKERS]:
        console.print(f"  {marker['time']:10.3f} s  {_shown(marker['text'])}")
    if len(markers) > _MOST_MARKERS:
        console.print(f"  and {len(markers) - _MOST_MARKERS} more markers")


def _shown(text: str) -> str:
    """Text from outside, as text and not as markup or a terminal's commands."""
    return escape(printable(text))


def _show_dsc(console: Console, description: dict[str, Any]) -> None:
    sign = {True: "endothermic up", False: "exothermic up", None: "sign unknown"}
    console.print(
        f"{_shown(description['path'])}: {_shown(description['instrument'])}, "
        f"{_shown(description['sample'])}, {description['mass'] * 1e6:.3f} mg, "
        f"{sign[description['endothermic_up']]}"
    )
    _print_rows(console, description["segments"], _SEGMENT_COLUMNS)


def _show_isobaric(console: Console, description: dict[str, Any]) -> None:
    unit = {"1": "", "relative": ", strain over its own range"}[description["strain_unit"]]
    console.print(
        f"{_shown(description['path'])}: isobaric test at {description['stress'] / 1e6:.1f} MPa"
        f"{unit}"
    )
    _print_rows(console, description["branches"], _BRANCH_COLUMNS)


def _show_tensile(console: Console, description: dict[str, Any]) -> None:
    kelvin = description["temperature"]
    where = "temperature unknown" if kelvin is None else f"at {kelvin:.2f} K"
    console.print(
        f"{_shown(description['path'])}: tensile test {where}, {description['samples']} samples, "
        f"to {description['largest_strain']:.4f} strain and "
        f"{description['largest_stress'] / 1e6:.1f} MPa"
    )


_SHOW = {
    "bag": _show_bag,
    "dsc": _show_dsc,
    "isobaric": _show_isobaric,
    "tensile": _show_tensile,
}


def _print_rows(console: Console, rows: list[dict[str, Any]], columns: _Columns) -> None:
    first = rows[0] if rows else {}
    numbers = [k for k, c in enumerate(columns) if isinstance(first.get(c[1]), (int, float))]
    cells = [[_cell(row[key], form) for _, key, form in columns] for row in rows]
    print_table(console, [heading for heading, _, _ in columns], cells, right=numbers)


def _cell(value: Any, form: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return ", ".join(value)
    return format(value, form)
