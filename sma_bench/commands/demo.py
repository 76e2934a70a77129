"""sma-bench demo: nodes, bag, identification service and figures on a simulated bench."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.protocols import load_protocol
from sma_bench.share import share_directory

NAMESPACE = "/demo"
# The paper's experiments in their order: E1 and E2 share the staircase, E3, E4.
PROTOCOLS = ("staircase", "ramp", "triangle")
FITTED = ("staircase", "ramp")
TABLE_ONE = {
    "wire.resistance": "R",
    "wire.heat_transfer_coefficient": "h",
    "wire.specific_heat": "c_p",
}
RECORDED = ("wire/power", "wire/temperature", "voltage_command", "experiment/marker")
WITHIN_SIGMAS = 2.0
LARGEST_RELATIVE_STD = 0.01
# Nothing may take longer than this without a sign of life, on however loaded a machine.
PATIENCE = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--out", metavar="DIR", help="new folder (default: sma_bench_demo_<time>)")
    parser.add_argument(
        "--speed", type=float, default=40.0, metavar="X",
        help="at most X times real time (default 40)",
    )
    parser.add_argument(
        "--draw", type=int, metavar="SEED",
        help="simulate a wire drawn at random around Table I instead of Table I itself",
    )


def run(args: argparse.Namespace) -> int:
    """Run the demo; 0 when the identified values hold what the demo promises, 1 when not."""
    started = time.monotonic()
    console = Console(highlight=False)
    out = _output_folder(args.out)
    truth_file = out / "truth.yaml"
    truth = simulated_truth(args.draw)
    write_parameters(truth_file, truth, "What the simulated bench is made of.")
    answer = _drive_bench(console, out, truth_file, args.speed)
    estimates = answer["parameters"]
    console.print(_result_table(estimates, truth))
    for warning in answer["warnings"]:
        console.print(f"[yellow]note[/] {escape(warning)}")
    page = _report(out, estimates, truth)
    holds = promise_holds(estimates, truth)
    console.print(
        f"within {WITHIN_SIGMAS:g} standard errors of the simulated truth, errors under "
        f"{LARGEST_RELATIVE_STD:.0%}: {'yes' if holds else 'NO'}"
    )
    places = {"report": page, "bags": out / "bags", "nodes load": out / "identified.yaml"}
    for what, path in places.items():
        console.print(f"{what:11}{escape(str(path))}", soft_wrap=True)
    console.print(f"{time.monotonic() - started:.0f} s")
    return 0 if holds else 1


def simulated_truth(seed: int | None) -> Parameters:
    """Table I, or a wire drawn within +-10 % of it.

    Args:
        seed: None for Table I.
    """
    truth = read_parameters(share_directory() / "config" / "wire_rig.yaml")
    if seed is None:
        return truth
    rng = np.random.default_rng(seed)
    drawn = {name: float(truth[name] * rng.uniform(0.9, 1.1)) for name in TABLE_ONE}
    return truth.replace(drawn)


def promise_holds(estimates: dict[str, Any], truth: Parameters) -> bool:
    """Whether R, h and c_p lie within two standard errors, themselves under 1 %."""
    rows = [(estimates[name], truth[name]) for name in TABLE_ONE]
    return all(
        abs(e["value"] - true) <= WITHIN_SIGMAS * e["std"]
        and e["std"] < LARGEST_RELATIVE_STD * e["value"]
        for e, true in rows
    )


def _output_folder(out: str | None) -> Path:
    folder = Path(out or time.strftime("sma_bench_demo_%Y%m%d_%H%M%S"))
    try:
        folder.mkdir(parents=True)
        (folder / "logs").mkdir()
        (folder / "bags").mkdir()
    except FileExistsError:
        raise InputError(f"{folder}: exists already, expected a new folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


def _drive_bench(console: Console, out: Path, truth_file: Path, speed: float) -> dict[str, Any]:
    """Run the protocols on the nodes, record them, and ask the service; its JSON answer."""
    try:
        from sma_bench.nodes.bench_client import BenchClient
        from sma_bench.nodes.processes import NodeProcesses, private_ros_environment
    except ModuleNotFoundError as error:
        raise InputError(f"demo: {error.name} is not installed, the demo needs ROS 2") from None
    private_ros_environment()
    with (
        NodeProcesses(NAMESPACE, out / "logs") as nodes,
        BenchClient(NAMESPACE, meanwhile=nodes.check) as client,
        _progress(console) as progress,
    ):
        nodes.start("simulator", {"speed": speed}, (truth_file,))
        nodes.start(
            "experiment", {"protocol": PROTOCOLS[0], "use_sim_time": True}, (truth_file,)
        )
        nodes.start("identification", {"output_directory": str(out)})
        client.follow("experiment")
        client.follow("recorder")
        for protocol in PROTOCOLS:
            _record(client, nodes, progress, out, protocol)
        task = progress.add_task("identify", total=None)
        records = [str((out / "bags" / name).resolve()) for name in FITTED]
        client.set_parameters("identification", {"record": records}, PATIENCE)
        answer = client.trigger("identification/identify", timeout=PATIENCE)
        progress.update(task, total=1, completed=1)
    return json.loads(answer)


def _record(client: Any, nodes: Any, progress: Progress, out: Path, protocol: str) -> None:
    """One protocol into one bag."""
    duration = load_protocol(protocol, Parameters.defaults()).duration
    task = progress.add_task(f"{protocol} ({duration:.0f} simulated s)", total=duration)
    bag = str(out / "bags" / protocol)
    nodes.start("recorder", {"output": bag, "use_sim_time": True})
    client.wait("recorder", lambda: set(RECORDED) <= set(client.recorded(bag)), PATIENCE)
    client.set_parameters("experiment", {"protocol": protocol}, PATIENCE)
    client.trigger("experiment/start", PATIENCE)
    begin = client.simulated_seconds

    def finished() -> bool:
        progress.update(task, completed=min(client.simulated_seconds - begin, duration))
        state = client.state("experiment")
        if state.startswith("aborted"):
            raise InputError(f"experiment {state}")
        return state == f"done: {protocol}"

    client.wait(protocol, finished, timeout=duration + PATIENCE)
    progress.update(task, completed=duration)
    nodes.end("recorder")


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description:32}"), BarColumn(), TextColumn("{task.percentage:>4.0f} %"),
        TimeElapsedColumn(), console=console,
    )


_HEADER = ("", "unit", "paper", "truth", "identified", "std error", "deviation")


def _rows(estimates: dict[str, Any], truth: Parameters) -> list[tuple[str, ...]]:
    """One row a parameter; the deviation from the simulated truth in standard errors."""
    paper = Parameters.defaults()
    rows = []
    for name, symbol in TABLE_ONE.items():
        value, std = estimates[name]["value"], estimates[name]["std"]
        numbers = [f"{number:.5g}" for number in (paper[name], truth[name], value)]
        deviation = f"{(value - truth[name]) / std:+.2f}"
        rows.append((symbol, estimates[name]["unit"], *numbers, f"{std:.2g}", deviation))
    return rows


def _result_table(estimates: dict[str, Any], truth: Parameters) -> RichTable:
    table = RichTable(title="Table I", box=None, pad_edge=False)
    for k, head in enumerate(_HEADER):
        table.add_column(head, justify="right" if k > 1 else "left", no_wrap=True)
    for row in _rows(estimates, truth):
        table.add_row(*(escape(cell) for cell in row))
    return table


def _report(out: Path, estimates: dict[str, Any], truth: Parameters) -> Path:
    """Figures 2 to 6 from the bags, fitted anew at the desk by the same code as the service."""
    from sma_bench.identify import identify
    from sma_bench.records import read_record
    from sma_bench.report.identification_report import experiment_section
    from sma_bench.report.page import Section, Table, write_report
    from sma_bench.report.thermal_figures import validation_picture

    records = [read_record(out / "bags" / name) for name in FITTED]
    result = identify(records, Parameters.defaults())
    picture, _ = validation_picture(read_record(out / "bags" / "triangle"), result.parameters)
    table = Table(_HEADER, _rows(estimates, truth), frozenset(range(2, 7)))
    sections = [
        Section("Table I", notes=["Synthetic: simulated bench, real nodes."], tables=[table]),
        *(experiment_section(experiment) for experiment in result.experiments),
        Section("E4 Thermal validation", pictures=[picture]),
    ]
    summary = "The paper's experiments E1 to E4 on a simulated bench, from volts to Table I."
    return write_report(out / "report", "From a commanded volt to Table I", summary, sections)
