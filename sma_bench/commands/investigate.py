"""sma-bench investigate: record, diagnose, propose, run, until the cause is named."""

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from sma_bench.commands.diagnose import quantities
from sma_bench.commands.parameters import add_parameter_options, parameters_from_options
from sma_bench.commands.parser import one_of
from sma_bench.commands.terminal import (
    add_json_option,
    output_console,
    print_table,
    progress,
    say,
    write_json,
)
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import node_groups
from sma_bench.progress import Report
from sma_bench.protocols import Protocol

_PATIENCE = 60.0
_YES = ("y", "yes")

# Runs a protocol (its file, its content) into a bag.
Runner = Callable[[Path, Protocol, Path], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "records", nargs="*", metavar="RECORD", help="bags that there are already"
    )
    add_parameter_options(parser)
    parser.add_argument(
        "--folder", required=True, metavar="DIR",
        help="records, diagnoses and the story; the same folder goes on where it was stopped",
    )
    parser.add_argument(
        "--budget", type=float, default=30.0, metavar="MINUTES",
        help="that the bench may be driven in all (default 30)",
    )
    parser.add_argument("--yes", action="store_true", help="run what is proposed without asking")
    parser.add_argument(
        "--signals", metavar="QUANTITY", nargs="+", type=one_of(quantities),
        help="compare these only, of current, temperature, deflection",
    )
    bench = parser.add_mutually_exclusive_group()
    bench.add_argument(
        "--simulated", metavar="BENCH.yaml",
        help="a bench in software that is what this file says, without ROS",
    )
    bench.add_argument(
        "--namespace", default="/bench", help="of the running experiment node (default /bench)"
    )
    add_json_option(parser, "the story")


def run(args: argparse.Namespace) -> int:
    """Go on until named, inseparable, or out of time; 0 whatever the verdict."""
    from sma_bench.tasks.investigation import HEADER, OPEN, TEST, Investigation

    if not args.budget > 0.0:
        raise InputError(f"--budget is {args.budget:g} min, expected more than 0")
    case = Investigation(args.folder, args.budget, args.signals or quantities())
    case.begin(parameters_from_options(args), args.records)
    runner = _simulated(args.simulated, case.believed) if args.simulated else _bench(args)
    while True:
        if case.pending:
            with progress("investigate") as report:
                result = case.diagnose(report)
            say(f"{result}\n")
        if case.state != OPEN:
            break
        path, protocol, bag = case.next_run()
        if not _agreed(path, protocol, args.yes):
            say(f"stopped; the same command goes on from {args.folder}")
            break
        runner(path, protocol, bag)
    if case.chapters:
        print_table(output_console(), HEADER, case.rows(), (0, 1), title="the story")
        say(f"{case.summary()}; page {case.write_page(args.command_line)}")
        if case.state == TEST:
            say(f"next: {case.chapters[-1].proposed['why']}; put what it gives into "
                f"{case.folder}/believed.yaml, or record with the sensor and give the bag, then go "
                "on with the same command")
    if args.json:
        write_json(args.json, {**case.to_json(), "state": case.state})
    return 0


def _agreed(path: Path, protocol: Protocol, yes: bool) -> bool:
    """Whether the wires may be driven so."""
    highest = max(max(*s.start, *s.stop) for s in protocol.segments)
    minutes = protocol.duration / 60.0
    say(f"next: {protocol.name}, {minutes:.1f} min, up to {highest:.2f} V ({path})")
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

    def follow(_: Path, protocol: Protocol, bag: Path) -> None:
        seed = int(bag.name.rpartition("_")[2])
        with progress(protocol.name):
            signals, markers = SimulatedRun(hidden, believed, seed).follow(protocol)
        made = {"how": "simulated bench", "source": bench}
        write_record(bag, signals, start_ns=time.time_ns(), markers=markers, provenance=made)

    return follow


def _bench(args: argparse.Namespace) -> Runner:
    """The experiment node of a bench that runs, and a recorder of our own."""

    def follow(path: Path, protocol: Protocol, bag: Path) -> None:
        try:
            from sma_bench.ros.bench_client import BenchClient
            from sma_bench.ros.processes import NodeProcesses
        except ModuleNotFoundError as error:
            raise InputError(
                f"investigate: {error.name} is not installed: nodes need ROS 2, --simulated none"
            ) from None
        namespace = "/" + args.namespace.strip("/")
        with (
            progress(protocol.name) as report, NodeProcesses(namespace, path.parent) as nodes,
            BenchClient(namespace, nodes.check) as client,
        ):
            client.follow("experiment")
            client.follow("recorder")
            client.find("experiment/start")
            client.wait("experiment", lambda: client.state("experiment"), _PATIENCE)
            if _is_done(client.state("experiment"), protocol):
                raise InputError(f"experiment: has run {protocol.name}, expected another name")
            nodes.start("recorder", {"output": str(bag)})
            client.wait("recorder", lambda: client.recorded(str(bag)), _PATIENCE)
            client.set_parameters("experiment", {"protocol": str(path.resolve())})
            try:
                client.trigger("experiment/start", _PATIENCE)
                client.wait(
                    protocol.name, lambda: _done(client.state("experiment"), protocol, report),
                    protocol.duration * 2.0 + _PATIENCE,
                )
            except BaseException:
                client.trigger("experiment/stop", _PATIENCE)
                nodes.end("recorder")
                if bag.exists():  # of a run that was not finished: kept, but no record of ours
                    bag.rename(bag.with_name(f"{bag.name}_aborted_{time.time_ns()}"))
                raise
            nodes.end("recorder")

    return follow


def _done(state: str, protocol: Protocol, report: Report) -> bool:
    report(0.0, state)
    if state.startswith("aborted"):
        raise InputError(f"experiment {state}")
    return _is_done(state, protocol)


def _is_done(state: str, protocol: Protocol) -> bool:
    return state == f"done: {protocol.name}"
