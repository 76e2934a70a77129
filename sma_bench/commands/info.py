"""sma-bench info: what a record holds, and whether it can be trusted."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import print_findings, print_table, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.findings import Finding

_MOST_MARKERS = 20


@options.command("info")
def run(args: SimpleNamespace) -> int:
    """Print topics, signals and findings. InputError: no record, or another robot's."""
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
        raise InputError(
            f"{args.record}: nothing of a bench in it, expected topics of docs/topics.md, e.g. "
            "<channel>/power, joint_states"
        )
    return 0
