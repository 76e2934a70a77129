"""The simulation beside stiff solvers at equal error, and beside the same recurrence in C."""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from examination.perf.c_limit import NoCompiler, PlainC
from examination.perf.figures import Figure, Outcome, Skipped, at_least, at_most
from examination.perf.stiff_rivals import CVODE, Problem, Solver, cvode, lsoda, side_by_side
from examination.perf.timing import interleaved, ratio
from sma_bench.parameters import Parameters
from sma_bench.physics import Simulation, simulate
from sma_bench.physics.sensitivities import Sensitivities, carries

COMPOSITE = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}
LATENT = {"effect.latent_heat.heat": 12e3}
EFFECTS = {
    **LATENT,
    "effect.phase_dependent_resistance.austenite_change": -0.1,
    "effect.phase_dependent_resistance.temperature_coefficient": 4e-4,
    "effect.temperature_dependent_convection.rise": 2e-3,
}
STEP = 0.01  # s, the bench's 100 Hz
HOLD = 200  # samples: voltages of the drive change every 2 s
REFERENCE = 1e-12
LADDER = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
# A solver need not be better than this where the simulation is: a millionth of the range.
ENOUGH = 1e-6
SETS = 32
DERIVED = (
    "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
    "wire.austenite_start_temperature", "wire.austenite_finish_temperature",
    "wire.martensite_start_temperature", "wire.martensite_finish_temperature",
    "wire.stress_influence_austenite", "wire.stress_influence_martensite",
    "wire.austenite_modulus", "wire.martensite_modulus", "wire.maximum_recoverable_strain",
    "environment.ambient_temperature",
)
# Derivatives need not be better: a fit's steps bear far more. The relative step of differences.
ENOUGH_OF_DERIVATIVES = 5e-3
_MOVED = 1e-5


def benches() -> dict[str, Parameters]:
    """The cases: one clamped wire, and four that bend a composite and feel each other's stress."""
    wire = Parameters.defaults()
    four = wire.replace(COMPOSITE)
    return {
        "one wire": wire,
        "one wire, effects on": wire.replace(EFFECTS),
        "four wires": four,
        "four wires, effects on": four.replace(EFFECTS),
    }


def drive(n: int, wires: int) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and voltages [V] at random levels, each held for HOLD samples.

    The wires of a side are driven alike, as in the paper: where the stress of one moves the range
    of another, the solvers' differential form lacks the contract's rule for that.
    """
    levels = np.random.default_rng(0).uniform(0.0, 6.5, (n // HOLD + 1, min(wires, 2)))
    sides = np.repeat(levels, max(wires // 2, 1), axis=1)
    return np.arange(n) * STEP, np.repeat(sides, HOLD, axis=0)[:n]


def measure(tiny: bool = False) -> list[Outcome]:
    """Ratios to the solvers and to C; many parameter sets on all cores."""
    outcomes: list[Outcome] = []
    for case, parameters in benches().items():
        outcomes += _beside_solvers(case, parameters, 161 if tiny else 10_001, tiny)
        if case == "one wire":
            outcomes += _derivatives(case, parameters, 1001 if tiny else 10_001, tiny)
        outcomes += _beside_c(case, parameters, 1000 if tiny else 200_000, tiny)
    return outcomes + _many_sets(1000 if tiny else 40_000)


# --- solvers ------------------------------------------------------------------------------------


def _beside_solvers(case: str, parameters: Parameters, n: int, tiny: bool) -> list[Outcome]:
    time_, voltage = drive(n, len(parameters["bench.channels"]))
    problem = Problem.of(parameters)
    tight = cvode if CVODE else lsoda
    truth = problem.solve(time_, voltage, tight(REFERENCE))
    own = _error(_states(simulate(parameters, time_, voltage)), truth)
    outcomes: list[Outcome] = [Figure(case, "error, of the range", own, "")]
    rivals: dict[str, Callable[[float], Solver]] = {"scipy LSODA": lsoda}
    if CVODE:
        rivals["scikit-sundae CVODE"] = cvode
    else:
        outcomes.append(Skipped(f"{case}: CVODE", "scikit-sundae is not installed"))
    calls: dict[str, Callable[[], object]] = {
        "ours": lambda: simulate(parameters, time_, voltage)
    }
    for name, make in rivals.items():
        rtol, error = _equal(problem, time_, voltage, make, truth, max(own, ENOUGH))
        outcomes.append(Figure(case, f"{name}: rtol for equal error", rtol, ""))
        outcomes.append(Figure(case, f"{name}: its error", error, ""))
        calls[name] = _solution(problem, time_, voltage, make(rtol), False)
        if not tiny:
            calls[f"{name}, restarted at each sample"] = _solution(
                problem, time_[:HOLD], voltage[:HOLD], make(rtol), True
            )
        if name == "scipy LSODA" and not tiny:
            calls["scipy LSODA, right side in Python"] = _solution(
                problem, time_, voltage, lsoda(rtol, compiled=False), False
            )
    seconds = interleaved(calls, 2 if tiny else 5, budget=20.0)
    for name in list(calls)[1:]:
        # A restarted solver ran one hold only: as many samples as that.
        share = n / HOLD if "restarted" in name else 1.0
        times = share * ratio(seconds[name], seconds["ours"])
        outcomes.append(Figure(case, f"{name}: times slower", times, "x", at_least(100.0)))
    return outcomes


def _solution(
    problem: Problem, time_: np.ndarray, voltage: np.ndarray, solver: Solver, restart: bool
) -> Callable[[], object]:
    return lambda: problem.solve(time_, voltage, solver, restart_at_samples=restart)


def _equal(
    problem: Problem, time_: np.ndarray, voltage: np.ndarray, make: Callable[[float], Solver],
    truth: np.ndarray, wanted: float,
) -> tuple[float, float]:
    """The loosest tolerance whose error is no more than wanted, and that error."""
    for rtol in LADDER:
        error = _error(problem.solve(time_, voltage, make(rtol)), truth)
        if error <= wanted:
            break
    return rtol, error


def _states(run: Simulation) -> np.ndarray:
    return np.hstack([run.temperature, run.martensite_fraction])


def _error(states: np.ndarray, truth: np.ndarray) -> float:
    """Largest difference of T and xi, as a share of the range that each runs through."""
    w = truth.shape[1] // 2
    off = np.abs(states - truth)
    kelvin = off[:, :w].max() / np.ptp(truth[:, :w])
    return float(max(kelvin, off[:, w:].max() / np.ptp(truth[:, w:])))


def _derivatives(case: str, parameters: Parameters, n: int, tiny: bool) -> list[Outcome]:
    """A trajectory and its derivatives, of the temperatures by relative changes of DERIVED; with
    latent heat, by which temperatures feel every one of them."""
    if not CVODE:
        return [Skipped(f"{case}: derivatives by CVODE", "scikit-sundae is not installed")]
    case, parameters = f"{case}, latent heat", parameters.replace(LATENT)
    assert carries(parameters)
    time_, voltage = drive(n, len(parameters["bench.channels"]))
    up, down = (
        [parameters.replace({name: parameters[name] * (1.0 + step)}) for name in DERIVED]
        for step in (_MOVED, -_MOVED)
    )
    problems = [Problem.of(bench) for bench in (parameters, *up)]
    both = side_by_side([Problem.of(b) for b in (*up, *down)], time_, voltage, REFERENCE)
    truth = (both[:, : len(up)] - both[:, len(up) :]) / (2.0 * _MOVED)

    def ours() -> np.ndarray:
        run = simulate(parameters, time_, voltage)
        carried = Sensitivities.of(run, up, np.full(len(up), _MOVED))
        return carried.temperature.transpose(1, 2, 0)

    def cvode_s(rtol: float) -> np.ndarray:
        states = side_by_side(problems, time_, voltage, rtol)
        return (states[:, 1:] - states[:, :1]) / _MOVED

    own = _derivative_error(ours(), truth)
    for rtol in LADDER:
        error = _derivative_error(cvode_s(rtol), truth)
        if error <= max(own, ENOUGH_OF_DERIVATIVES):
            break
    seconds = interleaved(
        {"plain": lambda: simulate(parameters, time_, voltage), "ours": ours,
         "CVODE": lambda: cvode_s(rtol)},
        2 if tiny else 5, budget=15.0,
    )
    what = f"with {len(DERIVED)} derivatives"
    return [
        Figure(case, f"{what}: error, of their size", own, ""),
        Figure(case, f"{what}: plain simulations", ratio(seconds["ours"], seconds["plain"]), ""),
        Figure(case, f"{what}, CVODE: rtol for equal error", rtol, ""),
        Figure(case, f"{what}, CVODE: its error", error, ""),
        Figure(case, f"{what}, CVODE: times slower", ratio(seconds["CVODE"], seconds["ours"]),
               "x", at_least(100.0)),
    ]


def _derivative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square difference of the derivatives of temperatures, the first w of a last axis,
    as a share of their own; the worst parameter's. Where a range begins or ends a derivative
    jumps, so its largest difference would say how near a sample lies to that."""
    w = truth.shape[2] // 2
    off = np.square(found[:, :, :w] - truth[:, :, :w]).mean(axis=(0, 2))
    return float(np.sqrt(np.max(off / np.square(truth[:, :, :w]).mean(axis=(0, 2)))))


# --- C ------------------------------------------------------------------------------------------


def _beside_c(case: str, parameters: Parameters, n: int, tiny: bool) -> list[Outcome]:
    try:
        limit = PlainC(parameters)
    except NoCompiler as error:
        return [Skipped(f"{case}: the limit in C", str(error))]
    time_, voltage = drive(n, len(parameters["bench.channels"]))
    run = simulate(parameters, time_, voltage)
    history, _ = limit(time_, voltage)
    off = _error(_states(run), np.hstack([history[0], history[1]]))
    seconds = interleaved(
        {"ours": lambda: simulate(parameters, time_, voltage), "C": lambda: limit(time_, voltage)},
        2 if tiny else 15, budget=10.0,
    )
    rate = n * voltage.shape[1] / np.median(seconds["ours"])
    slower = ratio(seconds["ours"], seconds["C"])
    return [
        Figure(case, "difference from C, of the range", off, "", at_most(1e-9)),
        Figure(case, "times the time of C", slower, "x", at_most(1.5)),
        Figure(case, "wire samples a second", float(rate), "1/s"),
    ]


def _many_sets(n: int) -> list[Outcome]:
    """Many parameter sets on one thread and on all cores: this package and the loop in C."""
    cores = len(os.sched_getaffinity(0))
    four = benches()["four wires"]
    time_, voltage = drive(n, 4)
    sets = [four.replace({"wire.resistance": 2.5 + 0.01 * k}) for k in range(SETS)]

    def through(pool: ThreadPoolExecutor, call: Callable[[Parameters], object]) -> object:
        return list(pool.map(call, sets))

    runs: dict[str, Callable[[Parameters], object]] = {
        "ours": lambda p: simulate(p, time_, voltage)
    }
    skipped: list[Outcome] = []
    try:
        PlainC(four)
        runs["C"] = lambda p: PlainC(p)(time_, voltage)
    except NoCompiler as error:
        skipped = [Skipped(f"{SETS} parameter sets: C", str(error))]
    outcomes: list[Outcome] = []
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(cores) as all_cores:
        calls = {
            (name, pool): (lambda run=run, pool=pool: through(pool, run))
            for name, run in runs.items() for pool in (one, all_cores)
        }
        named = {f"{name} {id(pool)}": call for (name, pool), call in calls.items()}
        seconds = interleaved(named, 5, budget=15.0, clock=time.perf_counter)
        for name in runs:
            gain = ratio(seconds[f"{name} {id(one)}"], seconds[f"{name} {id(all_cores)}"])
            what = f"{name}: gain of {cores} threads over one"
            outcomes.append(Figure(f"{SETS} parameter sets, four wires", what, gain, "x"))
    return outcomes + skipped
