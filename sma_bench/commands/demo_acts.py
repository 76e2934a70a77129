"""The demo's acts: Table I of a simulated wire, a hidden effect to be named, by the real nodes."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from sma_bench.cards import card_text
from sma_bench.commands.diagnose import print_tables
from sma_bench.commands.terminal import print_table, write_json
from sma_bench.compiled import is_compiled
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.errors import InputError
from sma_bench.estimation.unknowns import BACK, FRONT
from sma_bench.installation import share_directory
from sma_bench.lifeline import tied_to_this_process
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import core
from sma_bench.physics.effects import EFFECTS, active_effects
from sma_bench.progress import COMPILING, Report, part, silent
from sma_bench.protocols import load_protocol
from sma_bench.tasks.jobs import told_share

if TYPE_CHECKING:
    from sma_bench.ros.bench_client import BenchClient
    from sma_bench.ros.processes import NodeProcesses

# The first act: the paper's E1 to E3 on short forms of its protocols, and what a lab knows of its
# wire without a volt, by a scale and a ruler.
TABLE_ONE = {
    "wire.resistance": "R",
    "wire.heat_transfer_coefficient": "h",
    "wire.specific_heat": "c_p",
}
QUICK = ("quick_staircase", "quick_ramp")
_WEIGHED = {
    name: Parameters.of_paper()[name]
    for name in ("wire.mass", "wire.surface_area", "wire.diameter")
}
_SIGMAS, _LARGEST_ERROR = 2.0, 0.01

# The second act. Lowest and highest of each hidden number, drawn evenly in its logarithm: sizes to
# be met at a bench of config/demo_rig.yaml, of effects that its sensors separate.
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
RECORD, HOLD_OUT = "composite_diagnosis_triangles", "composite_diagnosis_steps"
# An Uno's own 5 V range. Over the usual 10 V, 10 bit are steps of 10 mV, far above the noise: a
# held level would be off by what heats the wire as much as a small effect.
_INSTRUMENTS = {"sensor.voltage_resolution": 5.0 / 1023}

# One a command: nodes that talk cost more of the processor than all that is computed.
_RATES = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), 20.0)
_READINGS = ("power", "temperature")
_PROTOCOLS = share_directory() / "config" / "protocols"
_PATIENCE = 600.0  # s: a service may have to wait for the compiler
# Quiet seconds of two cores: until a bench's nodes and a recorder are there, and what else takes
# long; nodes do not exceed so many times real time by much.
_STARTING, _COMPILING, _IDENTIFYING, _DRAWING, _DIAGNOSING = 3.0, 20.0, 4.0, 3.0, 12.0
_REACHED = 30.0


def planned(speed: float) -> dict[str, float]:
    """s that each step takes, about, on two quiet cores; in order."""
    wire, lab = Parameters.defaults(), read_parameters(lab_file())
    pace = min(speed, _REACHED)

    def recording(name: str, bench: Parameters) -> float:
        return _STARTING + load_protocol(name, bench).duration / pace

    return {
        COMPILING: 0.0 if is_compiled(core.run) else _COMPILING,
        **{name: recording(name, wire) for name in QUICK},
        "identify": _IDENTIFYING, "report": _DRAWING,
        **{name: recording(name, lab) for name in (RECORD, HOLD_OUT)},
        "diagnose": _DIAGNOSING,
    }  # fmt: skip


def wait_for_compiler(report: Report) -> None:
    """Wait until there is machine code of what both acts need; ./bench may be making it."""
    if is_compiled(core.run):
        return
    begin = time.monotonic()
    command = [sys.executable, "-P", "-m", "sma_bench.physics"]
    with subprocess.Popen(command, env=tied_to_this_process()) as process:
        while process.poll() is None:
            report((time.monotonic() - begin) / _COMPILING, COMPILING)
            time.sleep(0.1)


def make_folder(folder: Path) -> None:
    """Make a new folder, and those above it; InputError where that cannot be."""
    try:
        folder.mkdir(parents=True)
        for name in ("bags", "logs"):
            (folder / name).mkdir()
    except FileExistsError:
        raise InputError(f"{folder}: exists already, expected a new folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None


# --- The nodes of an act: a simulator, the experiment, a recorder for each bag, a service.


class Stage:
    """Nodes of one namespace, as processes, and a script's own node that asks them."""

    def __init__(self, folder: Path) -> None:
        """`nodes` and `client` are there from `_bench` on."""
        self.folder = folder
        self.nodes: NodeProcesses
        self.client: BenchClient
        self._asked = ""
        self._report: Report = silent

    def look(self) -> None:
        """While the client waits: do the nodes live, and how far is the service?"""
        self.nodes.check()
        if self._asked and (told := told_share(self.client.state(self._asked))):
            self._report(*told)

    def record(self, bench: Parameters, protocol: str, report: Report) -> str:
        """Run a protocol of config/protocols into a bag of its name; the bag's path."""
        duration = load_protocol(protocol, bench).duration
        bag = (self.folder / "bags" / protocol).resolve()
        begin: list[float] = []

        def heed(state: str) -> None:
            if state.startswith("running"):
                begin[:] = begin or [self.client.simulated_seconds]
                gone = self.client.simulated_seconds - begin[0]
                report(gone / duration, f"{protocol}, {gone:.0f} of {duration:.0f} simulated s")

        report(0.0, protocol)
        channels = bench["bench.channels"]
        self.client.run_recorded(
            _PROTOCOLS / f"{protocol}.yaml",
            protocol,
            duration,
            bag,
            heed,
            simulated_time=True,
            needed=[
                "voltage_command",
                "experiment/marker",
                *(f"{channel}/{what}" for channel in channels for what in _READINGS),
            ],
        )
        return str(bag)

    def ask(
        self,
        node: str,
        service: str,
        settings: Mapping[str, Any],
        files: tuple[Path, ...],
        report: Report,
    ) -> dict[str, Any]:
        """Start a node in place of the bench, which has done its part, and call its service."""
        for name in ("experiment", "simulator"):
            self.nodes.end(name)
        roots = dict.fromkeys(("record_root", "output_root"), str(self.folder.resolve()))
        self.nodes.start(node, {**roots, **settings}, files)
        self._asked, self._report = node, part(report, 0.0, 1.0, service)
        self._report(0.0, "")
        self.client.follow(node)
        answer: dict[str, Any] = json.loads(self.client.trigger(f"{node}/{service}", _PATIENCE))
        return answer


@contextmanager
def _bench(
    folder: Path, namespace: str, bench: Path, protocol: str, simulator: Mapping[str, Any]
) -> Iterator[Stage]:
    """A simulated bench that is what the file says, and the experiment node at its protocol."""
    try:
        from sma_bench.ros.bench_client import BenchClient
        from sma_bench.ros.processes import NodeProcesses, private_ros_environment
    except ModuleNotFoundError as error:
        raise InputError(f"demo: {error.name} is not installed, the demo needs ROS 2") from None
    private_ros_environment()
    stage = Stage(folder)
    with (
        NodeProcesses(namespace, folder / "logs") as nodes,
        BenchClient(namespace, meanwhile=stage.look) as client,
    ):
        stage.nodes, stage.client = nodes, client
        nodes.start("simulator", {**_RATES, **simulator}, (bench,))
        nodes.start(
            "experiment",
            {"protocol": protocol, "protocol_root": str(_PROTOCOLS), "use_sim_time": True},
            (bench,),
        )
        yield stage


# --- First act: from a commanded volt to Table I on a simulated wire.


def simulated_truth(seed: int | None) -> Parameters:
    """Table I, or where a seed is given a wire drawn within +-10 % of it."""
    truth = read_parameters(share_directory() / "config" / "wire_rig.yaml")
    if seed is None:
        return truth
    rng = np.random.default_rng(seed)
    drawn = {name: float(truth[name] * rng.uniform(0.9, 1.1)) for name in TABLE_ONE}
    return truth.replace(drawn)


def identified(
    out: Path, truth: Parameters, speed: float, steps: Mapping[str, Report]
) -> tuple[dict[str, Any], Path]:
    """What the service makes of the bags, and a page of the same by the same code at the desk."""
    from sma_bench.identify import identify
    from sma_bench.records import read_record
    from sma_bench.report.collected_report import write_identification_report

    truth_file = out / "truth.yaml"
    write_parameters(truth_file, truth, "What the simulated bench is made of.")
    with _bench(out, "/demo", truth_file, QUICK[0], {"speed": speed}) as stage:
        bags = [stage.record(truth, protocol, steps[protocol]) for protocol in QUICK]
        settings = {"output_directory": ".", **_WEIGHED, "record": bags}
        answer = stage.ask("identification", "identify", settings, (), steps["identify"])
    result = identify([read_record(bag) for bag in bags], Parameters(_WEIGHED))
    return answer, write_identification_report(out / "report", result, steps["report"])


def deviation(estimate: Mapping[str, Any], true: float) -> float:
    """Estimate less truth, in stated standard errors."""
    return float((estimate["value"] - true) / estimate["std"])


def promise_holds(estimates: Mapping[str, Any], truth: Parameters) -> bool:
    """Whether R, h and c_p are all there, within two stated errors of the truth, and what the
    scales of the sensors leave of these is below 1 % of the value."""
    return all(
        name in estimates
        and abs(deviation(estimates[name], truth[name])) <= _SIGMAS
        and estimates[name]["statistical"] <= _LARGEST_ERROR * estimates[name]["value"]
        for name in TABLE_ONE
    )


def print_table_one(
    console: Console, out: Path, answer: Mapping[str, Any], truth: Parameters, page: Path
) -> bool:
    """The table, remarks, whether the promise holds (which is returned), and where all lies."""
    paper, estimates, rows = Parameters.defaults(), answer["parameters"], []
    for name, symbol in TABLE_ONE.items():
        cells = ["-", "-", "-"]  # not identified: the warnings say why
        if found := estimates.get(name):
            off = deviation(found, truth[name])
            cells = [f"{found['value']:.5g}", f"{found['std']:.2g}", f"{off:+.2f}"]
        known = f"{paper[name]:.5g}", f"{truth[name]:.5g}"
        rows.append((symbol, BY_NAME[name].unit, *known, *cells))
    header = ("", "unit", "paper", "truth", "identified", "std error", "deviation")
    print_table(console, header, rows, range(2, len(header)), title="Table I")
    for warning in answer["warnings"]:
        console.print(f"[yellow]note[/] {escape(warning)}")
    holds = promise_holds(estimates, truth)
    console.print(
        f"within {_SIGMAS:g} standard errors of the truth, statistical errors under "
        f"{_LARGEST_ERROR:.0%}: {'yes' if holds else 'NO'}"
    )
    places = {"report": page, "bags": out / "bags", "nodes load": out / "identified.yaml"}
    for what, path in places.items():
        console.print(f"{what:11}{escape(str(path))}", soft_wrap=True)
    return holds


# --- Second act: a composite bench hides an effect, and the diagnosis has to name it.


def lab_file() -> Path:
    """What the lab believes of its composite bench."""
    return share_directory() / "config" / "demo_rig.yaml"


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


def diagnosed(
    out: Path, lab: Parameters, speed: float, steps: Mapping[str, Report]
) -> dict[str, Any]:
    """Two bags of the bench, and what the diagnosis service says of them."""
    simulator = {"speed": speed, **_INSTRUMENTS}
    with _bench(out, "/demo_gap", out / "hidden.yaml", RECORD, simulator) as stage:
        bags = [stage.record(lab, name, steps[name]) for name in (RECORD, HOLD_OUT)]
        settings = {
            "record": bags[:1], "hold_out": bags[1:],
            "improved": str((out / "improved.yaml").resolve()),
            "report": str((out / "report").resolve()),
        }  # fmt: skip
        return stage.ask("diagnosis", "diagnose", settings, (lab_file(),), steps["diagnose"])


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
        c["probability"] >= _ALL_BUT_CERTAIN and effect not in c["name"].split("+")
        for c in answer["candidates"]
    )


def reveal(answer: Mapping[str, Any], hidden: Parameters) -> Iterator[str]:
    """The truth beside what was said, a sentence a line; arguments of `confidently_wrong`."""
    effect = hidden_effect(hidden)
    amounts = {}
    for name, value in hidden_numbers(hidden).items():
        unit = BY_NAME[name].unit
        amounts[name] = f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"
    numbers = ", ".join(f"{n.removeprefix(EFFECT_PREFIX)} {a}" for n, a in amounts.items())
    yield f"The bench hid {effect} ({EFFECTS[effect].stage}): {numbers}."

    first = answer["candidates"][0]
    said = f"First choice of the diagnosis: {first['name']}, probability {first['probability']:.2f}"
    if effect in (parts := first["name"].split("+")):
        yield f"{said}: right{'.' if len(parts) == 1 else ', but not alone.'}"
    else:
        candidates = answer["candidates"]
        given = sum(c["probability"] for c in candidates if effect in c["name"].split("+"))
        yield f"{said}: WRONG; it gave the truth {given:.2f}."

    for name, true in hidden_numbers(hidden).items():
        if found := first["parameters"].get(name):
            off = f" ({deviation(found, true):+.1f} standard errors)" if found["std"] else ""
            short = name.removeprefix(EFFECT_PREFIX)
            yield f"{short}: found {found['value']:.4g}, true {amounts[name]}{off}"


def print_argument(console: Console, answer: Mapping[str, Any]) -> None:
    """The verdict card and the candidates."""
    result = diagnosis_from(answer, "diagnosis")
    console.print(f"{card_text(result, console.width)}\n", markup=False, soft_wrap=True)
    print_tables(console, result, ("candidates",))


def print_gap(
    console: Console, out: Path, answer: Mapping[str, Any], seed: int
) -> tuple[Parameters, Path]:
    """The argument, then the truth, which only now anybody but the bench's own nodes reads: the
    bench as it is, and the diagnosis's page."""
    write_json(str(out / "diagnosis.json"), dict(answer))
    print_argument(console, answer)
    page = out / "report" / "index.html"
    places = {"report": page, "bags": out / "bags", "nodes load": out / "improved.yaml"}
    for what, path in places.items():
        console.print(f"{what:11}{escape(str(path))}", soft_wrap=True)
    hidden = read_parameters(out / "hidden.yaml")
    console.print(f"\n[bold]The truth[/], from {escape(str(out / 'hidden.yaml'))}", soft_wrap=True)
    for sentence in reveal(answer, hidden):
        console.print(escape(sentence), soft_wrap=True)
    console.print(f"The same again: --draw {seed}")
    return hidden, page
