"""The simulation beside stiff solvers at equal error."""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from examination.perf.figures import Figure, Outcome, Skipped, at_least
from examination.perf.stiff_rivals import CVODE, Problem, Solver, cvode, lsoda
from examination.perf.timing import interleaved, ratio
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate

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
    """Ratios to the solvers; many parameter sets on all cores."""
    outcomes: list[Outcome] = []
    for case, parameters in list(benches().items())[:: 3 if tiny else 1]:
        outcomes += _beside_solvers(case, parameters, 161 if tiny else 10_001, tiny)
    return outcomes + _many_sets(1000 if tiny else 40_000)


# --- solvers ------------------------------------------------------------------------------------


def _beside_solvers(case: str, parameters: Parameters, n: int, tiny: bool) -> list[Outcome]:
    time_, voltage = drive(n, len(parameters["bench.channels"]))
    problem = Problem.of(parameters)
    tight = cvode if CVODE else lsoda
    truth = problem.solve(time_, voltage, tight(REFERENCE))
    run = simulate(parameters, time_, voltage)
    own = _error(np.hstack([run.temperature, run.martensite_fraction]), truth)
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
        calls[name] = partial(problem.solve, time_, voltage, make(rtol))
        if not tiny:
            calls[f"{name}, restarted at each sample"] = partial(
                problem.solve, time_[:HOLD], voltage[:HOLD], make(rtol), restart_at_samples=True
            )
        if name == "scipy LSODA" and not tiny:
            calls["scipy LSODA, right side in Python"] = partial(
                problem.solve, time_, voltage, lsoda(rtol, compiled=False)
            )
    seconds = interleaved(calls, 2 if tiny else 5, budget=20.0)
    for name in list(calls)[1:]:
        # A restarted solver ran one hold only: as many samples as that.
        share = n / HOLD if "restarted" in name else 1.0
        times = share * ratio(seconds[name], seconds["ours"])
        outcomes.append(Figure(case, f"{name}: times slower", times, "x", at_least(100.0)))
    return outcomes


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


def _error(states: np.ndarray, truth: np.ndarray) -> float:
    """Largest difference of T and xi, as a share of the range that each runs through."""
    w = truth.shape[1] // 2
    off = np.abs(states - truth)
    kelvin = off[:, :w].max() / np.ptp(truth[:, :w])
    return float(max(kelvin, off[:, w:].max() / np.ptp(truth[:, w:])))


def _many_sets(n: int) -> list[Outcome]:
    """Many parameter sets on one thread and on all cores."""
    cores = len(os.sched_getaffinity(0))
    four = benches()["four wires"]
    time_, voltage = drive(n, 4)
    sets = [four.replace({"wire.resistance": 2.5 + 0.01 * k}) for k in range(SETS)]

    def through(pool: ThreadPoolExecutor) -> object:
        return list(pool.map(lambda p: simulate(p, time_, voltage), sets))

    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(cores) as every:
        calls = {"one": lambda: through(one), "every": lambda: through(every)}
        seconds = interleaved(calls, 5, budget=15.0, clock=time.perf_counter)
    rate = SETS * n * 4 / np.median(seconds["one"])
    gain = ratio(seconds["one"], seconds["every"])
    case = f"{SETS} parameter sets, four wires"
    return [
        Figure(case, f"gain of {cores} threads over one", gain, "x"),
        Figure(case, "wire samples a second, one thread", float(rate), "1/s"),
    ]
