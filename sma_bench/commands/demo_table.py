"""First act of the demo: from a commanded volt to Table I on a simulated wire."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from sma_bench.commands.demo_stage import Stage, recording_time
from sma_bench.commands.progress_bar import Course, progress
from sma_bench.commands.tables import print_table
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.progress import Report, part
from sma_bench.share import share_directory

NAMESPACE = "/demo"
# The paper's experiments in their order: E1 and E2 share the staircase, E3, E4.
FITTED = ("staircase", "ramp")
QUICK = ("quick_staircase", "quick_ramp")
VALIDATION = "triangle"
TABLE_ONE = {
    "wire.resistance": "R",
    "wire.heat_transfer_coefficient": "h",
    "wire.specific_heat": "c_p",
}
WITHIN_SIGMAS = 2.0
LARGEST_RELATIVE_STD = 0.01
SHARE = 0.5
"""of the demo's time, about"""

_DRAWING = 0.93  # share of this act's time at which the report is due
_IDENTIFYING = 6.0  # s
_HEADER = ("", "unit", "paper", "truth", "identified", "std error", "deviation")


def table_act(
    console: Console, out: Path, fitted: tuple[str, ...], speed: float, truth: Parameters,
    course: Course,
) -> dict[str, Any]:
    """Simulate `truth`, identify it from the protocols `fitted` and print Table I.

    Returns:
        For the demo's JSON; `holds`, whether it holds what the demo promises.
    """
    truth_file = out / "truth.yaml"
    write_parameters(truth_file, truth, "What the simulated bench is made of.")
    with progress("demo", course) as report:
        own = part(report, 0.0, SHARE)
        answer = _identified(part(own, 0.0, _DRAWING), out, truth_file, fitted, speed, truth)
        estimates = answer["parameters"]
        own(_DRAWING, "report")
        page = _report(out, fitted, estimates, truth, part(own, _DRAWING, 1.0))
    right = range(2, len(_HEADER))
    print_table(console, _HEADER, _rows(estimates, truth), right, title="Table I")
    for warning in answer["warnings"]:
        console.print(f"[yellow]note[/] {escape(warning)}")
    holds = promise_holds(estimates, truth)
    console.print(
        f"within {WITHIN_SIGMAS:g} standard errors of the simulated truth, errors under "
        f"{LARGEST_RELATIVE_STD:.0%}: {'yes' if holds else 'NO'}"
    )
    places = {"report": page, "bags": out / "bags", "nodes load": out / "identified.yaml"}
    for what, path in places.items():
        console.print(f"{what:11}{escape(str(path))}", soft_wrap=True)
    return {
        "holds": holds, "truth": {name: truth[name] for name in TABLE_ONE},
        "estimates": estimates, "report": str(page),
    }


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


def _identified(
    report: Report, out: Path, truth_file: Path, fitted: tuple[str, ...], speed: float,
    truth: Parameters,
) -> dict[str, Any]:
    """Run the protocols on the nodes, record them, and ask the service; its answer."""
    protocols = (*fitted, VALIDATION)
    plan = {protocol: recording_time(protocol, truth, speed) for protocol in protocols}
    with Stage(out, NAMESPACE, report, {**plan, "identify": _IDENTIFYING}) as stage:
        stage.start_bench(truth_file, protocols[0], {"speed": speed})
        stage.start_service("identification", {"output_directory": "."})
        bags = {protocol: stage.record(protocol) for protocol in protocols}
        stage.end_bench()
        records = [str(bags[protocol]) for protocol in fitted]
        return stage.ask("identification", "identify", {"record": records})


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


def _report(
    out: Path, fitted: tuple[str, ...], estimates: dict[str, Any], truth: Parameters,
    report: Report,
) -> Path:
    """Figures 2 to 6 from the bags, fitted anew at the desk by the same code as the service."""
    from sma_bench.identify import identify
    from sma_bench.records import read_record
    from sma_bench.report.identification_report import experiment_section
    from sma_bench.report.page import Section, Table, write_report
    from sma_bench.report.thermal_figures import validation_picture

    records = [read_record(out / "bags" / name) for name in fitted]
    result = identify(records, Parameters.defaults())
    picture, _ = validation_picture(read_record(out / "bags" / VALIDATION), result.parameters)
    table = Table(_HEADER, _rows(estimates, truth), frozenset(range(2, 7)))
    sections = [
        Section("Table I", notes=["Synthetic: simulated bench, real nodes."], tables=[table]),
        *(experiment_section(experiment) for experiment in result.experiments),
        Section("E4 Thermal validation", pictures=[picture]),
    ]
    summary = "The paper's experiments E1 to E4 on a simulated bench, from volts to Table I."
    title = "From a commanded volt to Table I"
    return write_report(out / "report", title, summary, sections, report=report)
