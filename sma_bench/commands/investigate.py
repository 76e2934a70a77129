"""sma-bench investigate: record, diagnose, propose, run, until the cause is named."""

import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sma_bench.commands import options
from sma_bench.commands.terminal import print_table, progress, say, write_json
from sma_bench.errors import InputError

if TYPE_CHECKING:
    from sma_bench.parameters import Parameters


@options.command("investigate")
def run(args: SimpleNamespace) -> int:
    """Go on until named, inseparable, or out of time; 0 whatever the verdict."""
    from sma_bench.report.tables import Table
    from sma_bench.tasks.investigation import HEADER, OPEN, QUANTITIES, TEST, Investigation

    options.one_only(args, "simulated", "namespace")
    if not args.budget > 0.0:
        raise InputError(f"--budget is {args.budget:g} min, expected more than 0")
    options.written_by_nobody_else([Path(args.folder)])
    case = Investigation(args.folder, args.budget, args.signals or QUANTITIES)
    case.begin(options.parameters_from_options(args), args.records)
    while True:
        if case.pending:
            with progress("investigate") as report:
                result = case.diagnose(report)
            say(f"{result}\n")
        if case.state != OPEN:
            break
        following = case.next_run()
        if not _agreed(following, args.yes):
            say(f"stopped; the same command goes on from {args.folder}")
            break
        if args.simulated:
            _run_simulated(following, args.simulated, case.believed)
        else:
            run_bench(following, args.namespace)
    if case.chapters:
        print_table(Table(HEADER, case.rows(), frozenset({0, 1}), title="the story"))
        say(f"{case.summary()}; page {case.write_page(args.command_line)}")
        if case.state == TEST:
            say(f"next: {case.chapters[-1].proposed['why']}; put what it gives into "
                f"{case.folder}/believed.yaml, or record with the sensor and give the bag, then go "
                "on with the same command")
    write_json(args.json, case.to_json())
    return 0


def _agreed(offer: Mapping[str, Any], yes: bool) -> bool:
    """Whether the wires may be driven so."""
    say(f"next: {offer['protocol']}, {offer['minutes']:.1f} min, up to {offer['volts']:.2f} V "
        f"({offer['file']})")
    if yes:
        return True
    if not sys.stdin.isatty():
        say("not confirmed: no terminal to ask on; --yes runs without asking")
        return False
    with suppress(EOFError):
        return input("run it? [y/N] ").strip().lower() in ("y", "yes")
    return False


def _run_simulated(run: Mapping[str, Any], bench: str, believed: "Parameters") -> None:
    """Drive the bench of a file in software, and record it."""
    from sma_bench.live.virtual_bench import SimulatedRun
    from sma_bench.parameters import read_parameters
    from sma_bench.protocols import load_protocol
    from sma_bench.records.bag_writer import write_record

    hidden, seed = read_parameters(bench), run["bag"].rpartition("_")[2]
    protocol = load_protocol(run["file"], believed)
    with progress(protocol.name):
        signals, markers = SimulatedRun(hidden, believed, int(seed)).follow(protocol)
    made = {"how": "simulated bench", "source": bench}
    write_record(run["bag"], signals, start_ns=time.time_ns(), markers=markers, provenance=made)


def run_bench(run: Mapping[str, Any], namespace: str | None) -> None:
    """Drive a bench by its experiment node, with a recorder of our own."""
    with options.needs_ros("investigate", "--simulated needs no ROS 2"):
        from sma_bench.ros.bench_client import BenchClient
    name, seconds = run["protocol"], 60.0 * run["minutes"]
    with progress(name) as report, BenchClient(options.namespace_of(namespace)) as client:
        client.run_recorded(run["file"], name, seconds, run["bag"], lambda s: report(0.0, s))
