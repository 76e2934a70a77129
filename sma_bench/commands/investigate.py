"""sma-bench investigate: record, diagnose, propose, run, until the cause is named."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING

from sma_bench.commands import options
from sma_bench.commands.terminal import output_console, print_table, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import node_groups

if TYPE_CHECKING:
    from sma_bench.tasks.investigation import NextRun

_YES = ("y", "yes")

# Drives the bench, and has it recorded.
Runner = Callable[["NextRun"], None]


@options.command("investigate")
def run(args: SimpleNamespace) -> int:
    """Go on until named, inseparable, or out of time; 0 whatever the verdict."""
    from sma_bench.tasks.investigation import HEADER, OPEN, QUANTITIES, TEST, Investigation

    options.one_only(args, "simulated", "namespace")
    if not args.budget > 0.0:
        raise InputError(f"--budget is {args.budget:g} min, expected more than 0")
    case = Investigation(args.folder, args.budget, args.signals or QUANTITIES)
    case.begin(options.parameters_from_options(args), args.records)
    runner = _simulated(args.simulated, case.believed) if args.simulated else _bench(args)
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
        runner(following)
    if case.chapters:
        print_table(output_console(), HEADER, case.rows(), (0, 1), title="the story")
        say(f"{case.summary()}; page {case.write_page(args.command_line)}")
        if case.state == TEST:
            say(
                f"next: {case.chapters[-1].proposed['why']}; put what it gives into "
                f"{case.folder}/believed.yaml, or record with the sensor and give the bag, then go "
                "on with the same command"
            )
    if args.json:
        write_json(args.json, case.to_json())
    return 0


def _agreed(following: "NextRun", yes: bool) -> bool:
    """Whether the wires may be driven so."""
    offer = following.to_json()
    say(
        f"next: {offer['protocol']}, {offer['minutes']:.1f} min, up to {offer['volts']:.2f} V "
        f"({offer['file']})"
    )
    if yes:
        return True
    if not sys.stdin.isatty():
        say("not confirmed: no terminal to ask on; --yes runs without asking")
        return False
    with suppress(EOFError):
        return input("run it? [y/N] ").strip().lower() in _YES
    return False


def _simulated(bench: str, believed: Parameters) -> Runner:
    from sma_bench.live.simulated_run import SimulatedRun
    from sma_bench.records.bag_writer import write_record

    hidden = read_parameters(bench, ignore=node_groups())

    def follow(run: "NextRun") -> None:
        seed = int(run.bag.name.rpartition("_")[2])
        with progress(run.protocol.name):
            signals, markers = SimulatedRun(hidden, believed, seed).follow(run.protocol)
        made = {"how": "simulated bench", "source": bench}
        write_record(run.bag, signals, start_ns=time.time_ns(), markers=markers, provenance=made)

    return follow


def _bench(args: SimpleNamespace) -> Runner:
    """The experiment node of a bench that runs, and a recorder of our own."""

    def follow(run: "NextRun") -> None:
        try:
            from sma_bench.ros.bench_client import BenchClient
        except ModuleNotFoundError as error:
            raise InputError(
                f"investigate: {error.name} is not installed: nodes need ROS 2, --simulated none"
            ) from None
        protocol, namespace = run.protocol, "/" + (args.namespace or "bench").strip("/")
        with progress(protocol.name) as report, BenchClient(namespace) as client:
            client.run_recorded(
                run.file, protocol.name, protocol.duration, run.bag, lambda s: report(0.0, s)
            )

    return follow
