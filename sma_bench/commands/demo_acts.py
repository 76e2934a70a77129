"""The demo's acts: Table I of a simulated wire, a hidden effect to be named."""

import json
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from sma_bench.cards import card_text
from sma_bench.commands import investigate
from sma_bench.commands.demo_stage import COMPILED_AFTER, DemoStage, recording_time
from sma_bench.commands.diagnose import print_tables
from sma_bench.commands.options import run_command
from sma_bench.commands.terminal import WorkState, print_table, progress, write_json
from sma_bench.compiled import is_compiled
from sma_bench.diagnose.drives import Drive
from sma_bench.estimation.unknowns import BACK, FRONT
from sma_bench.installation import share_directory
from sma_bench.live.simulated_run import SimulatedRun
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import core, simulate
from sma_bench.physics.effects import EFFECTS, active_effects
from sma_bench.progress import COMPILING, Report, part
from sma_bench.protocols import parse_protocol
from sma_bench.records.bag_writer import write_record
from sma_bench.results import diagnosis_from, in_print

# --- What the demo's bench hides: an effect drawn at random, and parameters a little off.

# Lowest and highest of each number, drawn evenly in its logarithm: sizes to be met at a bench of
# config/demo_rig.yaml, of effects that currents, temperatures and deflection together separate.
HIDEABLE: dict[str, dict[str, tuple[float, float]]] = {
    "phase_dependent_resistance": {"austenite_change": (0.05, 0.2)},
    "supply_drop": {"resistance": (0.25, 0.5)},
    "latent_heat": {"heat": (6e3, 25e3)},
    "side_heat_coupling": {"conductance": (1e-3, 6e-3)},
    "residual_strain": {"share": (0.04, 0.25)},
    "viscoelastic_matrix": {"relaxation": (0.08, 0.3), "time_constant": (4.0, 15.0)},
    "slack": {"strain": (2e-3, 8e-3)},
    "temperature_lag": {"time_constant": (0.15, 1.5)},
}
_EITHER_SIGN = ("phase_dependent_resistance",)
_FARTHEST = 2.0  # standard errors
_ALL_BUT_CERTAIN = 0.8  # probability of a candidate


def hidden_bench(lab: Parameters, seed: int) -> Parameters:
    """The bench as it is: its parameters off by the lab's standard errors, one effect on.

    Args:
        lab: parameters as believed, with the uncertainties that were stated.
        seed: draws everything.
    """
    rng = np.random.default_rng(seed)
    effect = str(rng.choice(list(HIDEABLE)))
    sign = rng.choice((-1.0, 1.0)) if effect in _EITHER_SIGN else 1.0
    numbers = {
        f"{EFFECT_PREFIX}{effect}.{number}": float(sign * np.exp(rng.uniform(*np.log(ends))))
        for number, ends in HIDEABLE[effect].items()
    }
    errors = np.clip(rng.standard_normal(len(lab.given_uncertainty)), -_FARTHEST, _FARTHEST)
    off = {
        name: float(lab[name] + error * std)
        for (name, std), error in zip(lab.given_uncertainty.items(), errors, strict=True)
    }
    if lab[FRONT] == lab[BACK]:  # sides that are built alike are off alike
        off[BACK] = off[FRONT]
    return Parameters({name: lab[name] for name in lab.given} | off | numbers)


def hidden_effect(bench: Parameters) -> str:
    """The one effect of a bench that hides one."""
    (effect,) = active_effects(bench)
    return effect


def hidden_numbers(bench: Parameters) -> Mapping[str, float]:
    """Its numbers, by their full names."""
    effect = hidden_effect(bench)
    names = (f"{EFFECT_PREFIX}{effect}.{number}" for number in HIDEABLE[effect])
    return {name: bench[name] for name in names}


# --- First act of the demo: from a commanded volt to Table I on a simulated wire.

WIRE_NAMESPACE = "/demo"
# The paper's experiments in their order: E1 and E2 share the staircase, E3, E4.
FITTED = ("staircase", "ramp")
QUICK = ("quick_staircase", "quick_ramp")
VALIDATION = "triangle"
TABLE_ONE = {
    "wire.resistance": "R",
    "wire.heat_transfer_coefficient": "h",
    "wire.specific_heat": "c_p",
}


class Promise(NamedTuple):
    """Numbers within so many stated errors of the truth, and these, but for what the scales of the
    sensors may be off by, below a share of the value."""

    sigmas: float
    relative_std: float


SIMULATED = Promise(2.0, 0.01)

_PATIENCE = 600.0  # s: a service may have to wait for the compiler
# Quiet seconds of two cores.
_IDENTIFYING = 4.0
_DRAWING = 3.0
_HEADER = ("", "unit", "paper", "truth", "identified", "std error", "deviation")


# What the lab of Table I knows of its wire without a volt: by a scale and a ruler.
_WEIGHED = {
    name: Parameters.of_paper()[name]
    for name in ("wire.mass", "wire.surface_area", "wire.diameter")
}


def planned(fitted: tuple[str, ...], speed: float) -> tuple[float, float]:
    """Seconds that both acts take, about: by what the first fits, and how fast time goes."""
    wire, lab = Parameters.defaults(), read_parameters(lab_file())
    first = sum(_table_plan(fitted, wire, speed).values())
    composite = sum(recording_time(name, lab, speed) for name in (RECORD, HOLD_OUT))
    return first + _DRAWING, composite + _DIAGNOSING


def _table_plan(fitted: tuple[str, ...], wire: Parameters, speed: float) -> dict[str, float]:
    """s of each step; where the physics is being compiled beside, identification waits for it."""
    plan = {name: recording_time(name, wire, speed) for name in (*fitted, VALIDATION)}
    waiting = 0.0 if is_compiled(core.run) else max(COMPILED_AFTER - sum(plan.values()), 0.0)
    return {**plan, COMPILING: waiting, "identify": _IDENTIFYING}


def table_act(
    console: Console, out: Path, fitted: tuple[str, ...], speed: float, truth: Parameters,
    share: float, state: WorkState, compiler: subprocess.Popen[bytes] | None = None,
) -> dict[str, Any]:
    """Simulate `truth`, identify it from the protocols `fitted` and print Table I.

    Args:
        share: of the whole demo that this act is; compiler: a process beside, to wait for.

    Returns:
        For the demo's JSON; `holds`, whether it holds what the demo promises.
    """
    truth_file = out / "truth.yaml"
    write_parameters(truth_file, truth, "What the simulated bench is made of.")
    plan = _table_plan(fitted, truth, speed)
    drawing = share * sum(plan.values()) / (sum(plan.values()) + _DRAWING)
    with progress("demo", state) as report:
        own = part(report, 0.0, drawing)
        answer = _identified(own, out, truth_file, fitted, plan, speed, compiler)
        estimates = answer["parameters"]
        report(drawing, "report")
        page = _report(out, fitted, estimates, truth, part(report, drawing, share))
    right = range(2, len(_HEADER))
    print_table(console, _HEADER, _rows(estimates, truth), right, title="Table I")
    for warning in answer["warnings"]:
        console.print(f"[yellow]note[/] {escape(warning)}")
    holds = _print_promise(console, SIMULATED, estimates, truth)
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


def promise_holds(promise: Promise, estimates: Mapping[str, Any], truth: Parameters) -> bool:
    """Whether R, h and c_p are all there, right within their stated errors, and these small."""
    return all(
        name in estimates
        and abs(deviation(estimates[name], truth[name])) <= promise.sigmas
        and estimates[name]["statistical"] <= promise.relative_std * estimates[name]["value"]
        for name in TABLE_ONE
    )


def deviation(estimate: Mapping[str, Any], true: float) -> float:
    """Estimate less truth, in stated standard errors."""
    return float((estimate["value"] - true) / estimate["std"])


def _print_promise(
    console: Console, promise: Promise, estimates: Mapping[str, Any], truth: Parameters
) -> bool:
    """Print whether the promise holds; the same."""
    holds = promise_holds(promise, estimates, truth)
    console.print(
        f"within {promise.sigmas:g} standard errors of the truth, statistical errors under "
        f"{promise.relative_std:.0%}: {'yes' if holds else 'NO'}"
    )
    return holds


def _identified(
    report: Report, out: Path, truth_file: Path, fitted: tuple[str, ...],
    plan: Mapping[str, float], speed: float, compiler: subprocess.Popen[bytes] | None,
) -> dict[str, Any]:
    """Run the protocols on the nodes, record them, and ask the service; its answer."""
    protocols = (*fitted, VALIDATION)
    with DemoStage(out, WIRE_NAMESPACE, report, plan) as stage:
        stage.start_bench(truth_file, protocols[0], {"speed": speed})
        stage.start_service("identification", {"output_directory": ".", **_WEIGHED})
        bags = {protocol: stage.record(protocol) for protocol in protocols}
        stage.end_bench()
        stage.wait_for_compiler(compiler)
        records = [str(bags[protocol]) for protocol in fitted]
        return stage.ask("identification", "identify", {"record": records}, _PATIENCE)


def _rows(estimates: dict[str, Any], truth: Parameters) -> list[tuple[str, ...]]:
    """One row a parameter; the deviation from the simulated truth in standard errors."""
    paper = Parameters.defaults()
    rows: list[tuple[str, ...]] = []
    for name, symbol in TABLE_ONE.items():
        cells = ["-", "-", "-"]  # not identified: the warnings say why
        if found := estimates.get(name):
            off = deviation(found, truth[name])
            cells = [f"{found['value']:.5g}", f"{found['std']:.2g}", f"{off:+.2f}"]
        known = f"{paper[name]:.5g}", f"{truth[name]:.5g}"
        rows.append((symbol, BY_NAME[name].unit, *known, *cells))
    return rows


def _report(
    out: Path, fitted: tuple[str, ...], estimates: dict[str, Any], truth: Parameters,
    report: Report,
) -> Path:
    """Figures 2 to 6 from the bags, fitted anew at the desk by the same code as the service."""
    from sma_bench.identify import identify
    from sma_bench.records import read_record
    from sma_bench.report.collected_report import experiment_section
    from sma_bench.report.experiment_figures import validation_picture
    from sma_bench.report.page import Made, Section, Table, write_report

    records = [read_record(out / "bags" / name) for name in fitted]
    result = identify(records, Parameters(_WEIGHED))
    picture, _ = validation_picture(read_record(out / "bags" / VALIDATION), result.parameters)
    table = Table(_HEADER, _rows(estimates, truth), frozenset(range(2, 7)))
    sections = [
        Section("Table I", notes=["Synthetic: simulated bench, real nodes."], tables=[table]),
        *(experiment_section(experiment) for experiment in result.experiments),
        Section("E4 Thermal validation", pictures=[picture]),
    ]
    made = Made("sma-bench demo", [str(out / "bags" / name) for name in (*fitted, VALIDATION)])
    sections.append(made.section())
    summary = (
        f"The paper's experiments E1 to E4 on a simulated bench, from volts to Table I. {made.head}"
    )
    title = "From a commanded volt to Table I"
    return write_report(out / "report", title, summary, sections, report=report)


# --- End of the demo's second act: what the bench had hidden, and whether the diagnosis was
# right.

_PERIOD = 0.02  # s
# Of neither record: levels and order are others.
_NEW_DRIVE = {
    "steps": [
        {"kind": "ramp", "drive": "back", "start": 0.0, "stop": 2.2, "duration": 6.0},
        {"kind": "hold", "drive": "back", "level": 2.2, "duration": 5.0},
        {"kind": "rest", "duration": 4.0},
        {"kind": "staircase", "drive": "front", "start": 1.5, "stop": 2.25, "increment": 0.25,
         "dwell": 4.0},
        {"kind": "rest", "duration": 15.0},
    ]
}  # fmt: skip


def confidently_wrong(answer: Mapping[str, Any], hidden: Parameters) -> bool:
    """Whether an effect is named, or anything held for all but certain, that is not the truth.

    Args:
        answer: the diagnosis result of the contract.
        hidden: the bench as it is.
    """
    effect = hidden_effect(hidden)
    if answer["cause"] and effect not in answer["cause"]:
        return True
    return any(
        c["probability"] >= _ALL_BUT_CERTAIN and effect not in _parts(c)
        for c in answer["candidates"]
    )


def reveal(
    answer: Mapping[str, Any], hidden: Parameters, lab: Parameters, improved: Parameters
) -> Iterator[str]:
    """The truth beside what was said, a sentence a line.

    Args:
        answer, hidden: of `confidently_wrong`.
        lab: parameters as believed; improved: as the diagnosis leaves them.
    """
    effect = hidden_effect(hidden)
    numbers = ", ".join(
        f"{_short(name)} {_amount(name, value)}" for name, value in hidden_numbers(hidden).items()
    )
    yield f"The bench hid {effect} ({EFFECTS[effect].stage}): {numbers}."
    yield _first_choice(answer, effect)
    yield from _sizes(answer, hidden)
    yield _live(hidden, lab, improved)


def gap_on_new_drive(
    bench: Parameters, model: Parameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) deflection [m] and (n, w) temperature [K] of a model less those of a bench, as sensors
    without noise read them, on a drive that no record holds."""
    time, voltage = parse_protocol(_NEW_DRIVE, bench).sample(_PERIOD)
    true, modelled = simulate(bench, time, voltage), simulate(model, time, voltage)
    return (
        modelled.deflection_reading - true.deflection_reading,
        modelled.temperature_reading - true.temperature_reading,
    )


def _first_choice(answer: Mapping[str, Any], effect: str) -> str:
    first = answer["candidates"][0]
    said = f"First choice of the diagnosis: {first['name']}, probability {first['probability']:.2f}"
    if _parts(first) == [effect]:
        return f"{said}: right."
    if effect in _parts(first):
        return f"{said}: right, but not alone."
    given = sum(c["probability"] for c in answer["candidates"] if effect in _parts(c))
    return f"{said}: WRONG; it gave the truth {given:.2f}."


def _sizes(answer: Mapping[str, Any], hidden: Parameters) -> Iterator[str]:
    """Found and true numbers of the effect, where the first choice has it."""
    found = answer["candidates"][0]["parameters"]
    for name, true in hidden_numbers(hidden).items():
        if name in found:
            value, std = found[name]["value"], found[name]["std"]
            off = f" ({(value - true) / std:+.1f} standard errors)" if std else ""
            yield f"{_short(name)}: found {value:.4g}, true {_amount(name, true)}{off}"


def _live(hidden: Parameters, lab: Parameters, improved: Parameters) -> str:
    before, after = (gap_on_new_drive(hidden, model) for model in (lab, improved))
    deflection, temperature = (
        f"{quantity} {in_print(quantity, _rms(old))} -> {in_print(quantity, _rms(new))}"
        for quantity, old, new in zip(("deflection", "temperature"), before, after, strict=True)
    )
    return (
        "On a new drive, without sensor noise, the simulator misses this bench by (as believed -> "
        f"improved): {deflection}, {temperature} rms."
    )


def _parts(candidate: Mapping[str, Any]) -> list[str]:
    return str(candidate["name"]).split("+")


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _short(name: str) -> str:
    return name.removeprefix(EFFECT_PREFIX)


def _amount(name: str, value: float) -> str:
    unit = BY_NAME[name].unit
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


# --- Second act of the demo: a composite bench hides an effect, and the diagnosis has to name it.

COMPOSITE_NAMESPACE = "/demo_gap"
RECORD, HOLD_OUT = "composite_diagnosis_triangles", "composite_diagnosis_steps"
# An Uno's own 5 V range. Over the usual 10 V, 10 bit are steps of 10 mV, far above the noise: a
# held level would be off by what heats the wire as much as a small effect.
INSTRUMENTS = {"sensor.voltage_resolution": 5.0 / 1023}
_DIAGNOSING = 12.0  # s, on two quiet cores


def lab_file() -> Path:
    """What the lab believes of its composite bench."""
    return share_directory() / "config" / "demo_rig.yaml"


def gap_act(
    console: Console, out: Path, speed: float, seed: int, share: float, state: WorkState
) -> dict[str, Any]:
    """Hide an effect, diagnose, print the argument, then reveal.

    Returns:
        For the demo's JSON; `holds` is False if the diagnosis is confidently wrong.
    """
    hidden_file = out / "hidden.yaml"
    console.print("Synthetic: a simulated bench that hides an effect from its lab, real nodes.")
    lab = read_parameters(lab_file())
    plan = {name: recording_time(name, lab, speed) for name in (RECORD, HOLD_OUT)}
    plan["diagnose"] = _DIAGNOSING
    with (
        progress("demo", state) as report,
        DemoStage(out, COMPOSITE_NAMESPACE, part(report, share, 1.0), plan) as stage,
    ):
        write_parameters(hidden_file, hidden_bench(lab, seed), "The truth of the simulated bench.")
        answer = _diagnosed(stage, out, hidden_file, speed)
    write_json(str(out / "diagnosis.json"), answer)
    print_argument(console, answer)
    places = {"report": "report/index.html", "bags": "bags", "nodes load": "improved.yaml"}
    for what, name in places.items():
        console.print(f"{what:11}{escape(str(out / name))}", soft_wrap=True)
    # Only now does anybody but the bench's own nodes read the file.
    hidden = read_parameters(hidden_file)
    console.print(f"\n[bold]The truth[/], from {escape(str(hidden_file))}", soft_wrap=True)
    improved = read_parameters(out / "improved.yaml")
    for sentence in reveal(answer, hidden, lab, improved):
        console.print(escape(sentence), soft_wrap=True)
    console.print(f"The same again: --draw {seed}")
    truth = {"effect": hidden_effect(hidden), "numbers": dict(hidden_numbers(hidden))}
    return {
        "holds": not confidently_wrong(answer, hidden), "truth": truth, "draw": seed,
        "diagnosis": answer, "report": str(out / places["report"]),
    }


def _diagnosed(
    stage: DemoStage, out: Path, hidden_file: Path, speed: float
) -> dict[str, Any]:
    """Two bags of the bench, and what the diagnosis service says of them."""
    stage.start_bench(hidden_file, RECORD, {"speed": speed, **INSTRUMENTS})
    record, hold_out = stage.record(RECORD), stage.record(HOLD_OUT)
    stage.end_bench()
    stage.start_service("diagnosis", {}, (lab_file(),))
    settings = {
        "record": [str(record)],
        "hold_out": [str(hold_out)],
        "improved": str((out / "improved.yaml").resolve()),
        "report": str((out / "report").resolve()),
    }
    return stage.ask("diagnosis", "diagnose", settings, _PATIENCE)


def print_argument(console: Console, answer: Mapping[str, Any]) -> None:
    """The verdict card and the candidates."""
    result = diagnosis_from(Path("diagnosis"), answer)
    console.print(f"{card_text(result, console.width)}\n", markup=False, soft_wrap=True)
    print_tables(console, result, ("candidates_table",))


# --- Instead of both: two causes that one record leaves, and the record that decides.

# After one stroke a side does not come back all the way: strain is left in it, or its transition
# temperatures have moved, which more strokes would move further.
_LEFT_BEHIND = {"effect.residual_strain.share": 0.012}
_ONE_STROKE = Drive("one side", "triangle", "full", 10.0, 15.0, 0.65)
_LEVEL = 2.33  # V


def investigation_act(
    console: Console, out: Path, seed: int, command_line: str
) -> dict[str, Any]:
    """A bench in software, one stroke of it, and `investigate` from there.

    Args:
        seed: draws what is off within its standard errors, and the noise.

    Returns:
        For the demo's JSON; `holds` if the cause was open first and is named rightly at last.
    """
    console.print("Synthetic: a bench in software that hides an effect from its lab.")
    lab, hidden_file, first = read_parameters(lab_file()), out / "hidden.yaml", out / "first"
    drawn = hidden_bench(lab, seed)
    off = {name: drawn[name] for name in drawn.given if not name.startswith(EFFECT_PREFIX)}
    hidden = Parameters(off | _LEFT_BEHIND)
    write_parameters(hidden_file, hidden, "The truth of the simulated bench.")
    sides = tuple(dict.fromkeys(lab["bench.channel_sides"]))
    protocol = parse_protocol(_ONE_STROKE.document(_LEVEL, sides), lab)
    signals, markers = SimulatedRun(hidden, lab, seed).follow(protocol)
    made = {"how": "simulated bench", "source": str(hidden_file)}
    write_record(first, signals, markers=markers, provenance=made)
    story_file = out / "story.json"
    words = [
        str(first), "--params", str(lab_file()), "--folder", str(out / "gap"), "--signals",
        "deflection", "--simulated", str(hidden_file), "--yes", "--json", str(story_file),
    ]
    run_command(investigate.run, "sma-bench investigate", words)
    story = json.loads(story_file.read_text(encoding="utf-8"))
    effect = hidden_effect(hidden)
    console.print(f"[bold]The truth[/]: {effect}, from {escape(str(hidden_file))}", soft_wrap=True)
    opening, last = story["chapters"][0], story["chapters"][-1]
    holds = opening["verdict"] == "ambiguous" and last["cause"] == [effect]
    return {"synthetic": True, "folder": str(out), "holds": holds, "truth": effect, "story": story}
