"""sma-bench info: what a record holds, and whether it can be trusted."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sma_bench.border import printable, read_yaml
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


@options.command("info")
def run(args: SimpleNamespace) -> int:
    """Print topics, signals and findings, whatever they say.

    Raises:
        InputError: no record, or one of another robot.
    """
    from sma_bench.records import describe, open_records
    from sma_bench.records.roles import parse_stated

    with progress("reading"):
        records = open_records(args.record, args.namespace, parse_stated(args.stated))
        found = [describe(record) for record in records]
    if args.json:
        rest = {"sheets": found[1:]} if len(found) > 1 else {}
        write_json(args.json, {**found[0], **rest})
    for description in found:
        _show(description)
    if found[0]["kind"] == "bag" and not found[0]["signals"] + found[0]["markers"]:
        raise InputError(
            f"{args.record}: nothing of a bench in it, expected topics of docs/topics.md, e.g. "
            "<channel>/power, joint_states"
        )
    return 0


def _show(description: dict[str, Any]) -> None:
    say(f"{printable(description['path'])}: {_first_line(description)}")
    for name, columns in read_yaml(Path(__file__).with_suffix(".yaml")).items():
        if rows := description.get(name):
            keys = [key for key, _ in columns.values()]
            numbers = [k for k, key in enumerate(keys) if isinstance(rows[0][key], (int, float))]
            cells = [[_cell(row[key], form) for key, form in columns.values()] for row in rows]
            print_table(output_console(), list(columns), cells, right=numbers)
    markers = description.get("markers", [])
    for marker in markers[:_MOST_MARKERS]:
        say(f"  {marker['time']:10.3f} s  {printable(marker['text'])}")
    if len(markers) > _MOST_MARKERS:
        say(f"  and {len(markers) - _MOST_MARKERS} more markers")
    findings = [Finding(**finding) for finding in description["findings"]]
    print_findings(findings)
    if not findings:
        say("no findings")
    say(description["account"])


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
    strain, stress = found["largest_strain"], found["largest_stress"]
    far = f"{strain * 1e3:.4g} mm" if found["is_extension"] else f"{strain:.4f} strain"
    hard = f"{stress:.1f} N" if found["is_force"] else f"{stress / 1e6:.1f} MPa"
    return f"tensile test {where}, {found['samples']} samples, to {far} and {hard}"


def _cell(value: Any, form: str) -> str:
    if isinstance(value, list):
        return ", ".join(value)
    return "-" if value is None else format(value, form)
