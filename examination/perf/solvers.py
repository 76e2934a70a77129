"""The simulation compared with stiff solvers, the usual alternative, at equal error.

LSODA of scipy and CVODE of scikit-sundae integrate T and xi of all wires, with d xi/dt from
implicit differentiation of xi = X(T, sigma) and sigma(T, xi). The comparison is fair: the right
side is compiled by numba, a constant voltage is one segment whatever its number of samples, and
the solvers restart only when a voltage changes.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numba
import numpy as np
from scipy.integrate import solve_ivp

from examination.perf.measuring import Array, Figure, interleaved, ratio
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.physics import bending_coefficients, simulate

_OF_PHASE = "effect.phase_dependent_resistance"
NUMBERS = [*TRANSITIONS.values(), *(f"wire.{name}" for name in (
    "stress_influence_austenite", "stress_influence_martensite", "austenite_modulus",
    "martensite_modulus", "maximum_recoverable_strain", "thermal_expansion_factor"))]
NUMBERS += ["environment.ambient_temperature", *(f"wire.{name}" for name in (
    "mass", "specific_heat", "heat_transfer_coefficient", "surface_area", "resistance"))]
NUMBERS += [f"{_OF_PHASE}.austenite_change", f"{_OF_PHASE}.temperature_coefficient"]
NUMBERS += ["effect.temperature_dependent_convection.rise", "effect.latent_heat.heat"]
LEAST = 0.05  # least factor of resistance and loss by their temperature slopes, as in the contract
_MOST_STEPS = 100_000


@numba.njit(cache=True, error_model="numpy")
def rate(y, dy, of_wires, volts, turned, numbers, sides, stiffness, loads):
    """Write d(T, xi)/dt (2 w,) at fixed voltages (w,), and each wire's heating [K/s], f, g (3, w).
    `turned` (2, w): 1 or -1 for a wire that heats or cools, and the factor of f or g from its last
    reversal; `sides` (w,): side of each wire; `stiffness`: of each side, infinite between clamps;
    `loads` (w,): stress of each wire at rest [Pa], where strains are 0."""
    n, w = numbers, sides.size
    modulus, own, matrix, slopes = np.empty(w), np.empty(w), np.eye(w), np.empty((2, w))
    pull, total = np.zeros(w), stiffness.copy()
    change, martensite, austenite = n[7] - n[6], n[2] - n[3], n[1] - n[0]
    for i in range(w):
        modulus[i] = n[6] + change * y[w + i]
        stretch = n[8] * (1.0 - y[w + i]) + loads[i] / n[7]
        pull[sides[i]] += n[9] * (y[i] - n[10]) + modulus[i] * stretch - loads[i]
        total[sides[i]] += modulus[i]
    for i in range(w):
        xi, excess = y[w + i], y[i] - n[10]
        stretch = n[8] * (1.0 - xi) + loads[i] / n[7] - pull[sides[i]] / total[sides[i]]
        own[i] = change * stretch - n[8] * modulus[i]
        sigma = modulus[i] * stretch + n[9] * excess
        # The two branches of the transformation; slopes in T and in sigma of the active one.
        x = math.pi * min(max((n[1] - y[i] + sigma / n[4]) / austenite, 0.0), 1.0)
        z = math.pi * min(max((y[i] - sigma / n[5] - n[3]) / martensite, 0.0), 1.0)
        of_wires[1, i], of_wires[2, i] = 0.5 - 0.5 * math.cos(x), 0.5 - 0.5 * math.cos(z)
        heats = turned[0, i] > 0.0
        slope = -math.sin(x) / austenite if heats else math.sin(z) / martensite
        slopes[0, i] = 0.5 * math.pi * turned[1, i] * slope
        slopes[1, i] = -slopes[0, i] / (n[4] if heats else n[5])
        # Heating, without latent heat.
        ohm = n[15] * (1.0 + n[16] * (1.0 - xi)) * max(1.0 + n[17] * excess, LEAST)
        loss = n[13] * n[14] * max(1.0 + n[18] * excess, LEAST)
        of_wires[0, i] = (volts[i] ** 2 / ohm - loss * excess) / (n[11] * n[12])
    # xi' = by_t T' + by_s (s_t T' + s_xi xi'),  T' = heating + latent xi'
    latent = n[19] / n[12]
    for i in range(w):
        dy[w + i] = 0.0
        for j in range(w):
            give = 1.0 if i == j else 0.0
            by = give * slopes[0, i]
            if sides[i] == sides[j]:
                give -= modulus[i] / total[sides[i]]
            by += slopes[1, i] * n[9] * give
            matrix[i, j] -= slopes[1, i] * own[j] * give + by * latent
            dy[w + i] += by * of_wires[0, j]
    if w == 1:
        dy[1] /= matrix[0, 0]
    else:
        dy[w:] = np.linalg.solve(matrix, dy[w:])
    for i in range(w):
        dy[i] = of_wires[0, i] + latent * dy[w + i]


class Problem(NamedTuple):
    """The parameters of a bench as arguments of the right side."""

    numbers: Array
    sides: Array
    stiffness: Array
    loads: Array

    @classmethod
    def of(cls, parameters: Parameters) -> "Problem":
        names, sides = np.unique(parameters["bench.channel_sides"], return_inverse=True)
        stiffness = np.full(sides.size, np.inf)
        if names.size > 1:
            alpha, front, back = bending_coefficients(parameters)
            stiffness[:2] = alpha * back, alpha * front
        numbers = np.array([float(parameters[name]) for name in NUMBERS])
        return cls(numbers, sides, stiffness, np.zeros(sides.size))

    def solve(self, time: Array, voltage: Array, solver: "Solver", restart: bool = False) -> Array:
        """(n, 2 w): T and xi of all wires at every sample, from rest; `restart` at each of them."""
        n, w = voltage.shape
        states = np.tile(np.repeat([self.numbers[10], 1.0], w), (n, 1))
        turned, of_wires = np.ones((2, w)), np.empty((3, w))
        changed = np.any(np.diff(voltage[:-1], axis=0) != 0.0, axis=1) | restart
        starts = [0, *(np.flatnonzero(changed) + 1), n - 1]
        for start, stop in zip(starts, starts[1:], strict=False):
            y, volts = states[start].copy(), voltage[start]
            rate(y, np.empty(2 * w), of_wires, volts, turned, *self)
            heating, f, g = of_wires
            # After a reversal, a wire continues from its own fraction, as in the contract.
            for i in np.flatnonzero(heating * turned[0] < 0.0):
                branch, left = (g[i], y[w + i] - 1.0) if turned[0, i] > 0.0 else (f[i], y[w + i])
                turned[:, i] = -turned[0, i], left / branch if branch > 0.0 else 0.0
            given = of_wires, volts, turned, *self
            states[start + 1 : stop + 1] = solver(time[start : stop + 1], y, given)
        return states


Solver = Callable[[Array, Array, tuple], Array]


def lsoda(rtol: float, right_side: Callable[..., None] = rate) -> Solver:
    """scipy's LSODA; its right side compiled unless `rate.py_func` is given."""

    def solve(time: Array, y: Array, given: tuple) -> Array:
        dy, span = np.empty_like(y), (time[0], time[-1])

        def fun(_: float, state: Array) -> Array:
            right_side(state, dy, *given)
            return dy.copy()

        solution = solve_ivp(fun, span, y, "LSODA", t_eval=time[1:], **_tolerances(rtol, y))
        if not solution.success:
            raise RuntimeError(solution.message)
        return solution.y.T

    return solve


def cvode(rtol: float) -> Solver:
    """CVODE (BDF) of SUNDIALS, right side compiled."""
    from sksundae.cvode import CVODE  # only installed for ./bench perf and tests

    def solve(time: Array, y: Array, given: tuple) -> Array:
        def fun(_: float, state: Array, dy: Array) -> None:
            rate(state, dy, *given)

        solver = CVODE(fun, max_num_steps=_MOST_STEPS, **_tolerances(rtol, y))
        solution = solver.solve(time, y)
        if not solution.success:
            raise RuntimeError(str(solution.message))
        # It takes two times as a span, and returns its own steps within.
        return solution.y[1:] if time.size > 2 else solution.y[-1:]

    return solve


def _tolerances(rtol: float, y: Array) -> dict:
    """Absolute tolerances of T [K] and xi: about a hundredth of rtol at their usual size."""
    return {"rtol": rtol, "atol": np.repeat([rtol, 0.01 * rtol], y.size // 2)}


# --- The cases; errors are measured against a solver with far smaller error.
COMPOSITE = {"bench.channels": ("front_1", "front_2", "back_1", "back_2"),
             "bench.channel_sides": ("front", "front", "back", "back")}  # fmt: skip
EFFECTS = {"effect.latent_heat.heat": 12e3, "effect.temperature_dependent_convection.rise": 2e-3}
EFFECTS |= {f"{_OF_PHASE}.austenite_change": -0.1, f"{_OF_PHASE}.temperature_coefficient": 4e-4}
STEP = 0.01  # s, the bench's 100 Hz
HOLD = 200  # samples: voltages of the drive change every 2 s
REFERENCE = 1e-12
LADDER = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
# A solver need not be more accurate than this, even if the simulation is: a millionth of the range.
ENOUGH = 1e-6
RIVALS: dict[str, Callable[[float], Solver]] = {"scipy LSODA": lsoda, "scikit-sundae CVODE": cvode}


def drive(n: int, wires: int) -> tuple[Array, Array]:
    """Time [s] and voltages [V] at random levels, each held for HOLD samples. The wires of a side
    are driven alike, as in the paper: the solvers' differential form lacks the contract's rule for
    a wire whose transformation range is shifted by the stress of another."""
    levels = np.random.default_rng(0).uniform(0.0, 6.5, (n // HOLD + 1, min(wires, 2)))
    sides = np.repeat(levels, max(wires // 2, 1), axis=1)
    return np.arange(n) * STEP, np.repeat(sides, HOLD, axis=0)[:n]


def simulation(tiny: bool = False) -> Iterator[Figure]:
    """One clamped wire, and four that bend a composite and share its stress."""
    wire = Parameters.defaults()
    bare = {"one wire": wire, "four wires": wire.replace(COMPOSITE)}
    benches = bare | {f"{name}, effects on": p.replace(EFFECTS) for name, p in bare.items()}
    for case, parameters in benches.items():
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
