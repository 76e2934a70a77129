"""What a diagnosis costs: by stage, its derivatives beside a plain simulation, and long records."""

import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np

from examination.blind.make import make
from examination.perf.figures import Figure, Outcome, at_most
from examination.perf.timing import exponent, interleaved, processor, ratio
from examination.perf.whole_commands import ROOT, diagnosis_case, run
from sma_bench.diagnose import diagnose
from sma_bench.estimation import side_by_side
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameter import EFFECT_NAMES
from sma_bench.physics import simulate
from sma_bench.protocols import load_protocol
from sma_bench.records import Record, Signal, read_record

RATE = 100.0  # Hz
TRIANGLES, STEPS = "composite_diagnosis_triangles", "composite_diagnosis_steps"
_LENGTHS = {"10 minutes": 600.0, "an hour": 3600.0, "8 hours": 28_800.0}
_NOISE = {"voltage": 2e-3, "current": 0.01, "temperature": 0.1}
_DEFLECTION_NOISE = 5e-5  # m
_HIDDEN = {"effect.side_heat_coupling.conductance": 0.03}


def measure(tiny: bool = False) -> list[Outcome]:
    """Of the composite bag of the section `commands`, and of synthetic records in memory."""
    with TemporaryDirectory() as name:
        bag, file = diagnosis_case(Path(name))
        record, lab = read_record(bag), read_parameters(file)
        outcomes = [*_derivatives(record, lab, 2 if tiny else 9)]
        if tiny:
            return outcomes
        diagnose([record], lab)  # compiles
        outcomes += [*_stages(record, lab), *_cores(record, lab)]
        wall, cpu = run(["diagnose", str(bag), "--params", str(file)])
        outcomes.append(Figure("a composite bag", "command: on the wall", wall, "s"))
        outcomes.append(Figure("a composite bag", "command: processor", cpu, "s"))
    return [*outcomes, *_cases(), *_lengths()]


def _cases(number: int = 24) -> list[Outcome]:
    """The command on cases of the examination's development split."""
    with TemporaryDirectory() as name:
        made = Path(name) / "cases"
        make(made, 1000, number)
        seconds = [
            run(["diagnose", str(case / "record"), "--params", str(case / "nominal.yaml"),
                 "--hold-out", str(case / "hold_out")])[0]
            for case in sorted((made / "cases").iterdir())
        ]  # fmt: skip
    case = f"{number} development cases"
    return [
        Figure(case, "median command, on the wall", float(np.median(seconds)), "s", at_most(5.0)),
        Figure(case, "90th percentile", float(np.quantile(seconds, 0.9)), "s", at_most(10.0)),
    ]


def _derivatives(record: Record, lab: Parameters, rounds: int) -> list[Outcome]:
    problem = Problem.of([observe(record, lab)])
    unknowns = unknowns_of_records(lab, problem.observations[0].quantities)
    x = unknowns.start()
    predicted = problem.predict(unknowns.parameters(x))
    own = Problem(problem.observations, problem.noise, problem.nuisances, voltage_noise=True)
    which = range(unknowns.baseline)
    ways = {
        "plain": lambda: problem.predict(unknowns.parameters(x)),
        "derivatives": lambda: problem.derivatives(unknowns, x, predicted, which),
    }
    seconds = interleaved(ways, rounds)
    off = [
        np.linalg.slogdet(np.eye(len(x)) + rows.T @ rows)[1]
        for rows in (problem.whiten(of.derivatives(unknowns, x, predicted, which))
                     for of in (problem, own))
    ]  # fmt: skip
    case = f"a composite record, {unknowns.baseline} derivatives"
    times = ratio(seconds["derivatives"], seconds["plain"])
    return [
        Figure(case, "plain simulations", times, "", at_most(15.0)),
        Figure(case, "information off by", 0.5 * float(off[0] - off[1]), "nats"),
    ]


def _stages(record: Record, lab: Parameters) -> list[Outcome]:
    """Processor seconds between what a diagnosis says that it does."""
    marks: list[tuple[str, float]] = []
    diagnose([record], lab, progress=lambda text: marks.append((text, processor())))
    marks.append(("", processor()))
    spent: dict[str, float] = {}
    for (text, begin), (_, end) in zip(marks, marks[1:], strict=False):
        stage = "each effect alone" if text in EFFECT_NAMES else text
        spent[stage] = spent.get(stage, 0.0) + end - begin
    return [
        Figure("a composite bag", f"{stage}: processor", seconds, "s")
        for stage, seconds in spent.items()
    ]


def _cores(record: Record, lab: Parameters) -> list[Outcome]:
    """What the second core brings."""

    def diagnosed(threads: int) -> None:
        with mock.patch.object(side_by_side, "threads_to_spare", lambda: threads):
            diagnose([record], lab)

    ways = {"one core": lambda: diagnosed(0), "a thread beside": lambda: diagnosed(2)}
    seconds = interleaved(ways, 3, clock=time.perf_counter)
    return [
        Figure("a composite bag", f"{way}: on the wall", float(np.median(taken)), "s")
        for way, taken in seconds.items()
    ]


def _lengths() -> list[Outcome]:
    """Each in a process of its own, whose memory is then its own."""
    outcomes: list[Outcome] = []
    found = []
    records = [(f"{name} of triangles", TRIANGLES, length) for name, length in _LENGTHS.items()]
    for name, protocol, length in (*records, ("10 minutes of steps", STEPS, 600.0)):
        said = subprocess.run(
            [sys.executable, __file__, protocol, str(length)],
            capture_output=True, text=True, check=True,
        ).stdout
        wall, cpu, memory = map(float, said.split())
        if protocol == TRIANGLES:
            found.append((length, cpu))
        case = f"{name} at {RATE:g} Hz"
        aim = at_most(6.0) if length == 600.0 else None
        outcomes += [
            Figure(case, "diagnosis: on the wall", wall, "s", aim),
            Figure(case, "diagnosis: processor", cpu, "s"),
            Figure(case, "largest memory", memory, "MB"),
        ]
    sizes, seconds = np.array(found).T
    what = "exponent from 10 minutes to 8 hours"
    growth = exponent(sizes, seconds)
    return [*outcomes, Figure("diagnosis over the length", what, growth, "", at_most(1.15))]


def long_record(lab: Parameters, protocol: str, length: float) -> Record:
    """Synthetic, in memory: a protocol again and again, noise of sensors."""
    once = load_protocol(protocol, lab).sample(1.0 / RATE)[1]
    time_ = np.arange(int(length * RATE)) / RATE
    volts = np.take(once, np.arange(time_.size), axis=0, mode="wrap")
    bench = simulate(lab.replace(_HIDDEN), time_, volts)
    rng = np.random.default_rng(0)
    signals: dict[str, Signal] = {}
    courses: Mapping[str, tuple[str, np.ndarray]] = {
        "voltage": ("V", volts), "current": ("A", bench.current),
        "temperature": ("K", bench.temperature_reading),
    }
    for k, channel in enumerate(lab["bench.channels"]):
        for quantity, (unit, values) in courses.items():
            noise = rng.normal(0.0, _NOISE[quantity], time_.size) * (values[:, k] > 0.0)
            name = f"{channel}.{quantity}"
            signals[name] = Signal(name, unit, time_, values[:, k] + noise)
    reading = bench.deflection_reading + rng.normal(0.0, _DEFLECTION_NOISE, time_.size)
    signals["deflection"] = Signal("deflection", "m", time_, reading)
    return Record(Path("synthetic"), 0, signals)


if __name__ == "__main__":
    lab_ = read_parameters(ROOT / "config" / "composite_rig.yaml")
    long_ = long_record(lab_, sys.argv[1], float(sys.argv[2]))
    begin_, before_ = time.perf_counter(), processor()
    diagnose([long_], lab_)
    memory_ = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(time.perf_counter() - begin_, processor() - before_, memory_)
