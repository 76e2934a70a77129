"""The simulation beside stiff solvers at equal error."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from examination.perf.measuring import Array, Figure, interleaved, ratio
from examination.perf.rivals import Problem, Solver, cvode, lsoda, rate
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate

COMPOSITE = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}
EFFECTS = {"effect.latent_heat.heat": 12e3, "effect.temperature_dependent_convection.rise": 2e-3}
_OF_PHASE = "effect.phase_dependent_resistance"
EFFECTS |= {f"{_OF_PHASE}.austenite_change": -0.1, f"{_OF_PHASE}.temperature_coefficient": 4e-4}
STEP = 0.01  # s, the bench's 100 Hz
HOLD = 200  # samples: voltages of the drive change every 2 s
REFERENCE = 1e-12
LADDER = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
# A solver need not be better than this where the simulation is: a millionth of the range.
ENOUGH = 1e-6
RIVALS: dict[str, Callable[[float], Solver]] = {"scipy LSODA": lsoda, "scikit-sundae CVODE": cvode}


def benches() -> dict[str, Parameters]:
    """The cases: one clamped wire, and four that bend a composite and feel each other's stress."""
    wire = Parameters.defaults()
    four = wire.replace(COMPOSITE)
    bare = {"one wire": wire, "four wires": four}
    return bare | {f"{name}, effects on": p.replace(EFFECTS) for name, p in bare.items()}


def drive(n: int, wires: int) -> tuple[Array, Array]:
    """Time [s] and voltages [V] at random levels, each held for HOLD samples.

    The wires of a side are driven alike, as in the paper: where the stress of one moves the range
    of another, the solvers' differential form lacks the contract's rule for that.
    """
    levels = np.random.default_rng(0).uniform(0.0, 6.5, (n // HOLD + 1, min(wires, 2)))
    sides = np.repeat(levels, max(wires // 2, 1), axis=1)
    return np.arange(n) * STEP, np.repeat(sides, HOLD, axis=0)[:n]


def simulation(tiny: bool = False) -> Iterator[Figure]:
    """Ratios to the solvers."""
    for case, parameters in benches().items():
        if not tiny or case in ("one wire", "four wires, effects on"):
            yield from _beside_solvers(case, parameters, 161 if tiny else 10_001, tiny)


def _beside_solvers(case: str, parameters: Parameters, n: int, tiny: bool) -> Iterator[Figure]:
    time_, voltage = drive(n, len(parameters["bench.channels"]))
    problem = Problem.of(parameters)
    truth = problem.solve(time_, voltage, cvode(REFERENCE))
    run = simulate(parameters, time_, voltage)
    own = _error(np.hstack([run.temperature, run.martensite_fraction]), truth)
    yield Figure(case, "error, of the range", own)
    calls: dict[str, Callable[[], object]] = {"ours": lambda: simulate(parameters, time_, voltage)}
    solve = partial(problem.solve, time_, voltage)
    for name, make in RIVALS.items():
        # The loosest tolerance whose error is no larger than ours.
        for rtol in LADDER:
            error = _error(solve(make(rtol)), truth)
            if error <= max(own, ENOUGH):
                break
        yield Figure(case, f"{name}: rtol for equal error", rtol)
        yield Figure(case, f"{name}: its error", error)
        calls[name] = partial(solve, make(rtol))
        if not tiny:
            one_hold = partial(problem.solve, time_[:HOLD], voltage[:HOLD], restart=True)
            calls[f"{name}, restarted at each sample"] = partial(one_hold, make(rtol))
            if make is lsoda:
                calls[f"{name}, right side in Python"] = partial(solve, lsoda(rtol, rate.py_func))
    seconds = interleaved(calls, 2 if tiny else 5, budget=20.0)
    ours = seconds.pop("ours")
    for name, taken in seconds.items():
        share = n / HOLD if "restarted" in name else 1.0
        times = share * ratio(taken, ours)
        yield Figure(case, f"{name}: times slower", times, "x", least=100.0)


def _error(states: Array, truth: Array) -> float:
    """Largest difference of T and xi, as a share of the range that each runs through."""
    halves = zip(np.hsplit(states, 2), np.hsplit(truth, 2), strict=True)
    return float(max(np.abs(found - true).max() / np.ptp(true) for found, true in halves))
