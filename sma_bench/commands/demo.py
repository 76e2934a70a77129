"""sma-bench demo: Table I of a wire, and the diagnosis of a composite with a hidden effect."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from sma_bench.border import make_folder, read_yaml
from sma_bench.commands import options, terminal
from sma_bench.installation import share_directory
from sma_bench.lifeline import tied_to_this_process
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.parameter import BY_NAME, EFFECT_PREFIX, EFFECTS
from sma_bench.progress import COMPILING, Report, part, shares
from sma_bench.protocols import load_protocol
from sma_bench.report.tables import Table, diagnosis_tables

# Part 1: short versions of the paper's E1 to E3; mass and size of the wire are given.
TABLE_ONE = {"wire.resistance": "R", "wire.heat_transfer_coefficient": "h",
             "wire.specific_heat": "c_p"}
QUICK = ("quick_staircase", "quick_ramp")
SIGMAS, LARGEST_ERROR = 2.0, 0.01  # largest deviation in standard errors; error over value
_PAPER = Parameters.of_paper()
_WEIGHED = {name: _PAPER[name] for name in ("wire.mass", "wire.surface_area", "wire.diameter")}

# Part 2: the gap.
HIDEABLE: dict[str, dict[str, tuple[float, float]]]
HIDEABLE = read_yaml(Path(__file__).with_name("demo.yaml"))["hideable"]
RECORD, HOLD_OUT = "composite_diagnosis_triangles", "composite_diagnosis_steps"
LAB_FILE = share_directory() / "config" / "demo_rig.yaml"  # the lab's stated parameters
_EITHER_SIGN = ("phase_dependent_resistance",)  # effects whose number may be negative
_FARTHEST = 2.0  # stated standard deviations by which a hidden parameter is off at most
_NEARLY_CERTAIN = 0.8  # probability of a candidate
# The Uno's own range is 5 V: over 10 V, one of its 1024 steps heats as much as a small effect.
_INSTRUMENTS = {"sensor.voltage_resolution": 5.0 / 1023}
# Hz of commands and readings: messages cost more CPU time than the simulation. c_p has its small
# error only with 20 Hz; a diagnosis is hardly less certain with 10 Hz.
_FAST, _SLOW = 20.0, 10.0
_PROTOCOLS = share_directory() / "config" / "protocols"
_PATIENCE = 600.0  # s: the service may have to wait for the compiler
# s that each step takes on two idle cores, to show the time left.
_STARTING, _COMPILING, _IDENTIFYING, _DRAWING, _DIAGNOSING = 3.0, 20.0, 4.0, 3.0, 12.0
_REACHED = 30.0  # times real time: nodes are hardly faster, whatever --speed


@options.command("demo")
def run_demo(args: SimpleNamespace) -> int:
    """Run both parts. Exit status 1: Table I or the diagnosis is wrong. InputError: no ROS 2."""
    from sma_bench.compiled import is_compiled
    from sma_bench.diagnose.result import diagnosis_from
    from sma_bench.physics import core
    from sma_bench.report.reports import write_identification_report
    from sma_bench.tasks.work import identify_files

    started, console, speed = time.monotonic(), terminal.output_console(), args.speed
    truth = read_parameters(share_directory() / "config" / "wire_rig.yaml")
    seed, lab = time.time_ns() % 2**31, read_parameters(LAB_FILE)
    if args.draw is not None:  # a wire within +-10 % of Table I
        seed, rng = args.draw, np.random.default_rng(args.draw)
        truth = truth.replace({n: float(truth[n] * rng.uniform(0.9, 1.1)) for n in TABLE_ONE})
    out = Path(args.out or time.strftime("sma_bench_demo_%Y%m%d_%H%M%S"))
    gap = out / "simulated_gap"
    for folder in (out / "bags", out / "logs", gap / "bags", gap / "logs"):
        make_folder(folder)
    write_parameters(out / "truth.yaml", truth, "True parameters of the simulated bench.")
    hidden_file = gap / "hidden.yaml"
    write_parameters(hidden_file, hidden_bench(lab, seed), "True parameters of the bench.")
    # Estimated time of each step, to show the time left of the whole demo.
    pace = min(speed, _REACHED)
    plan = {COMPILING: 0.0 if is_compiled(core.run) else _COMPILING}
    plan |= {name: _STARTING + load_protocol(name, truth).duration / pace for name in QUICK}
    plan |= {"identify": _IDENTIFYING, "report": _DRAWING}
    plan |= {n: _STARTING + load_protocol(n, lab).duration / pace for n in (RECORD, HOLD_OUT)}
    plan |= {"diagnose": _DIAGNOSING}
    state = terminal.WorkState()
    steps = {step: part(state.report, *ends) for step, ends in shares(plan).items()}
    console.print("[bold]1. From commanded voltages to Table I[/]")
    with terminal.progress("demo", state):
        if not is_compiled(core.run):  # ./bench may be compiling already
            begin, command = time.monotonic(), [sys.executable, "-P", "-m", "sma_bench.physics"]
            with subprocess.Popen(command, env=tied_to_this_process()) as process:
                while process.poll() is None:
                    steps[COMPILING]((time.monotonic() - begin) / _COMPILING, COMPILING)
                    time.sleep(0.1)
        bags = [str((out / "bags" / name).resolve()) for name in QUICK]
        found = _recorded_and_asked(
            out, "/demo", out / "truth.yaml", bags, _FAST, {"speed": speed}, steps,
            "identification/identify", {"output_directory": ".", **_WEIGHED, "record": bags})
        result = identify_files(bags, Parameters(_WEIGHED))  # again as in the node, for the page
        page = write_identification_report(out / "report", result, steps["report"])
    estimates, rows = found["parameters"], []
    for name, symbol in TABLE_ONE.items():
        cells = ["-", "-", "-"]  # not identified; the warnings say why
        if own := estimates.get(name):
            off = _deviation(own, truth[name])
            cells = [f"{own['value']:.5g}", f"{own['std']:.2g}", f"{off:+.2f}"]
        known = f"{_PAPER[name]:.5g}", f"{truth[name]:.5g}"
        rows.append((symbol, BY_NAME[name].unit, *known, *cells))
    header = ("", "unit", "paper", "true", "identified", "std error", "deviation")
    terminal.print_table(Table(header, rows, frozenset(range(2, 7)), title="Table I"))
    for warning in found["warnings"]:
        terminal.say(f"note {warning}")
    # R, h and c_p are identified, near the truth, and with small errors apart from sensor scales.
    holds = all(name in estimates and abs(_deviation(estimates[name], truth[name])) <= SIGMAS
                and estimates[name]["statistical"] <= LARGEST_ERROR * estimates[name]["value"]
                for name in TABLE_ONE)
    terminal.say(f"within {SIGMAS:g} standard errors of the true values, statistical errors under "
                 f"{LARGEST_ERROR:.0%}: {'yes' if holds else 'NO'}")
    loaded = out / "identified.yaml"
    terminal.say(f"report     {page}\nbags       {out / 'bags'}\nnodes load {loaded}")
    # Part 2: card and candidates, then the true parameters, which only the simulator has read.
    console.print("\n[bold]2. The gap between simulation and bench[/]")
    terminal.say("Synthetic: a simulated bench with an effect unknown to the lab; real nodes.")
    gap_page, improved = gap / "report" / "index.html", gap / "improved.yaml"
    with terminal.progress("demo", state):
        simulator = {"speed": speed, **_INSTRUMENTS}
        bags = [str((gap / "bags" / name).resolve()) for name in (RECORD, HOLD_OUT)]
        answer = _recorded_and_asked(
            gap, "/demo_gap", hidden_file, bags, _SLOW, simulator, steps, "diagnosis/diagnose",
            {"record": bags[:1], "hold_out": bags[1:], "improved": str(improved.resolve()),
             "report": str(gap_page.parent.resolve())}, (LAB_FILE,))
    terminal.write_json(str(gap / "diagnosis.json"), answer)
    diagnosis = diagnosis_from(answer, "diagnosis")
    terminal.print_card(diagnosis)
    terminal.print_table(diagnosis_tables(diagnosis)["candidates"])
    terminal.say(f"report     {gap_page}\nbags       {gap / 'bags'}\nnodes load {improved}")
    hidden = read_parameters(hidden_file)
    terminal.say(f"\nTrue parameters, from {hidden_file}")
    for sentence in reveal(answer, hidden):
        terminal.say(sentence)
    terminal.say(f"Repeat this demo: --draw {seed}\n{time.monotonic() - started:.0f} s")

    right = {"table_one": holds, "gap": not confidently_wrong(answer, hidden)}
    effect, numbers = hidden_effect(hidden)
    true = {"table_one": {name: truth[name] for name in TABLE_ONE},
            "gap": {"effect": effect, "numbers": numbers}}
    pages = {"table_one": str(page), "gap": str(gap_page)}
    terminal.write_json(args.json, {
        "synthetic": True, "folder": str(out), "holds": right, "truth": true, "report": pages,
        "estimates": estimates, "diagnosis": answer, "draw": seed})
    return 0 if all(right.values()) else 1


def _recorded_and_asked(folder: Path, namespace: str, file: Path, bags: Sequence[str],
                        rate: float, simulator: Mapping[str, Any], steps: Mapping[str, Report],
                        service: str, settings: Mapping[str, Any],
                        files: tuple[Path, ...] = ()) -> Any:
    """Record a simulated bench: bags, each named after its protocol. Returns the answer of a node's
    `service`, with parameters `files` and `settings`."""
    node, _, work = service.partition("/")
    with options.needs_ros("demo"):
        from sma_bench.ros.bench_client import BenchClient
        from sma_bench.ros.processes import NodeProcesses, private_ros_environment
    private_ros_environment()
    bench, kinds = read_parameters(file), ("power", "temperature")
    readings = [f"{channel}/{kind}" for channel in bench["bench.channels"] for kind in kinds]

    def look() -> None:
        """While the client waits: check that the nodes live, and show the service's progress."""
        nodes.check()
        if share := client.progress(node):
            steps[work](*share)

    def record(bag: str) -> None:
        protocol, begin = Path(bag).name, list[float]()
        duration = load_protocol(protocol, bench).duration

        def heed(state: str) -> None:
            if state.startswith("running"):
                begin[:] = begin or [client.simulated_seconds]
                gone = client.simulated_seconds - begin[0]
                steps[protocol](gone / duration,
                                f"{protocol}, {gone:.0f} of {duration:.0f} simulated s")

        steps[protocol](0.0, protocol)
        client.run_recorded(_PROTOCOLS / f"{protocol}.yaml", protocol, duration, bag, heed,
                            simulated_time=True,
                            needed=["voltage_command", "experiment/marker", *readings])

    first, root = Path(bags[0]).name, str(folder.resolve())
    driven = {"protocol": first, "protocol_root": str(_PROTOCOLS), "use_sim_time": True,
              "command_rate": rate}
    rates = {f"rate.{kind}": rate for kind in ("power", "temperature", "mechanics")}
    with (NodeProcesses(namespace, folder / "logs") as nodes,
          BenchClient(namespace, meanwhile=look) as client):
        nodes.start("simulator", {**rates, **simulator, "command_rate": rate}, (file,))
        nodes.start("experiment", driven, (file,))
        for bag in bags:
            record(bag)
        for name in ("experiment", "simulator"):  # no longer needed
            nodes.end(name)
        nodes.start(node, {"record_root": root, "output_root": root, **settings}, files)
        steps[work](0.0, work)
        client.follow(node)
        return json.loads(client.trigger(service, _PATIENCE))


def _deviation(estimate: Mapping[str, Any], true: float) -> float:
    """Estimate minus true value, in standard errors."""
    return float((estimate["value"] - true) / estimate["std"])


def hidden_bench(lab: Parameters, seed: int) -> Parameters:
    """The lab's parameters with random errors as stated, and one effect; all drawn by `seed`."""
    from sma_bench.estimation.unknowns import BACK, FRONT

    rng = np.random.default_rng(seed)
    effect = str(rng.choice(list(HIDEABLE)))
    sign = rng.choice((-1.0, 1.0)) if effect in _EITHER_SIGN else 1.0
    numbers = {f"{EFFECT_PREFIX}{effect}.{number}": float(sign * np.exp(rng.uniform(*np.log(ends))))
               for number, ends in HIDEABLE[effect].items()}
    errors = np.clip(rng.standard_normal(len(lab.given_uncertainty)), -_FARTHEST, _FARTHEST)
    off = {name: float(lab[name] + error * std)
           for (name, std), error in zip(lab.given_uncertainty.items(), errors, strict=True)}
    if lab[FRONT] == lab[BACK]:  # sides that are built alike have the same error
        off[BACK] = off[FRONT]
    return Parameters({name: lab[name] for name in lab.given} | off | numbers)


def hidden_effect(bench: Parameters) -> tuple[str, dict[str, float]]:
    """The effect that is on in a bench with exactly one, and its numbers by full name."""
    (effect,) = (name for name, effect in EFFECTS.items() if effect.is_on(bench))
    names = [f"{EFFECT_PREFIX}{effect}.{number}" for number in HIDEABLE[effect]]
    return effect, {name: bench[name] for name in names}


def confidently_wrong(answer: Mapping[str, Any], hidden: Parameters) -> bool:
    """True if the diagnosis names, or holds nearly certain, something other than the true cause."""
    effect, _ = hidden_effect(hidden)
    certain = [c["name"] for c in answer["candidates"] if c["probability"] >= _NEARLY_CERTAIN]
    named = [answer["cause"]] if answer["cause"] else []
    return any(effect not in own for own in (*named, *(name.split("+") for name in certain)))


def reveal(answer: Mapping[str, Any], hidden: Parameters) -> Iterator[str]:
    """The diagnosis compared with the truth, a sentence per line."""
    effect, numbers = hidden_effect(hidden)
    amounts = {name: f"{value:.4g} {BY_NAME[name].unit}".removesuffix(" 1")
               for name, value in numbers.items()}
    short = {name: name.removeprefix(EFFECT_PREFIX) for name in numbers}
    sizes = ", ".join(f"{short[name]} {amount}" for name, amount in amounts.items())
    yield f"The bench hid {effect} ({EFFECTS[effect].stage}): {sizes}."
    first = answer["candidates"][0]
    with_truth = [c for c in answer["candidates"] if effect in c["name"].split("+")]
    head = f"First choice of the diagnosis: {first['name']}, probability {first['probability']:.2f}"
    if first in with_truth:
        yield f"{head}: right{'.' if first['name'] == effect else ', but not alone.'}"
    else:
        chance = sum(c["probability"] for c in with_truth)
        yield f"{head}: WRONG; it gave the true cause {chance:.2f}."
    for name, true in numbers.items():
        if found := first["parameters"].get(name):
            off = f" ({_deviation(found, true):+.1f} standard errors)" if found["std"] else ""
            yield f"{short[name]}: found {found['value']:.4g}, true {amounts[name]}{off}"
