"""What one would pick for the simulation otherwise: stiff solvers on the model's differential form.

LSODA of scipy and CVODE of scikit-sundae integrate T and xi of all wires, with d xi/dt from
implicit differentiation of xi = X(T, sigma) and sigma(T, xi). They have every chance: the right
side is compiled by numba, a held voltage is one segment however many samples lie in it, and a
restart happens only where a voltage changes.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
from scipy.integrate import solve_ivp
from sksundae.cvode import CVODE

from sma_bench.parameters import Parameters
from sma_bench.parameters.table import TRANSITIONS
from sma_bench.physics import bending_coefficients

Array = np.ndarray
_OF_PHASE = "effect.phase_dependent_resistance"
NUMBERS = [*TRANSITIONS.values()]
NUMBERS += [f"wire.stress_influence_{phase}" for phase in ("austenite", "martensite")]
NUMBERS += [f"wire.{phase}_modulus" for phase in ("austenite", "martensite")]
NUMBERS += ["wire.maximum_recoverable_strain", "wire.thermal_expansion_factor"]
NUMBERS += ["environment.ambient_temperature", "wire.mass", "wire.specific_heat"]
NUMBERS += ["wire.heat_transfer_coefficient", "wire.surface_area", "wire.resistance"]
NUMBERS += [f"{_OF_PHASE}.austenite_change", f"{_OF_PHASE}.temperature_coefficient"]
NUMBERS += ["effect.temperature_dependent_convection.rise", "effect.latent_heat.heat"]
LEAST = 0.05  # of resistance and loss that a slope in temperature leaves, as the contract has it
_MOST_STEPS = 100_000


@numba.njit(cache=True, error_model="numpy")
def rate(y, dy, of_wires, volts, turned, numbers, sides, stiffness):
    """Write d(T, xi)/dt (2 w,) at held voltages (w,), and each wire's heating [K/s], f, g (3, w).

    `turned` (2, w) is 1 or -1 for a wire that heats or cools, and what its last reversal makes of
    f or g; `sides` (w,) the side of each wire, `stiffness` that of each side, infinite in clamps.
    """
    n, w = numbers, sides.size
    modulus, own, matrix, slopes = np.empty(w), np.empty(w), np.eye(w), np.empty((2, w))
    pull, total = np.zeros(w), stiffness.copy()
    change, martensite, austenite = n[7] - n[6], n[2] - n[3], n[1] - n[0]
    for i in range(w):
        modulus[i] = n[6] + change * y[w + i]
        pull[sides[i]] += n[9] * (y[i] - n[10]) + modulus[i] * n[8] * (1.0 - y[w + i])
        total[sides[i]] += modulus[i]
    for i in range(w):
        xi, excess = y[w + i], y[i] - n[10]
        stretch = n[8] * (1.0 - xi) - pull[sides[i]] / total[sides[i]]
        own[i] = change * stretch - n[8] * modulus[i]
        sigma = modulus[i] * stretch + n[9] * excess
        # The transformation's two branches; the slope in T and in sigma of the one that holds.
        x = math.pi * min(max((n[1] - y[i] + sigma / n[4]) / austenite, 0.0), 1.0)
        z = math.pi * min(max((y[i] - sigma / n[5] - n[3]) / martensite, 0.0), 1.0)
        of_wires[1, i], of_wires[2, i] = 0.5 - 0.5 * math.cos(x), 0.5 - 0.5 * math.cos(z)
        heats = turned[0, i] > 0.0
        slope = -math.sin(x) / austenite if heats else math.sin(z) / martensite
        slopes[0, i] = 0.5 * math.pi * turned[1, i] * slope
        slopes[1, i] = -slopes[0, i] / (n[4] if heats else n[5])
        # Heat, without what the phase takes up.
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
    """The numbers of a bench as the right side takes them."""

    numbers: Array
    sides: Array
    stiffness: Array

    @classmethod
    def of(cls, parameters: Parameters) -> "Problem":
        names, sides = np.unique(parameters["bench.channel_sides"], return_inverse=True)
        stiffness = np.full(sides.size, np.inf)
        if names.size > 1:
            alpha, front, back = bending_coefficients(parameters)
            stiffness[:2] = alpha * back, alpha * front
        numbers = np.array([float(parameters[name]) for name in NUMBERS])
        return cls(numbers, sides, stiffness)

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
            # A wire that turns round goes on from its own fraction, as the contract says.
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

    def solve(time: Array, y: Array, given: tuple) -> Array:
        def fun(_: float, state: Array, dy: Array) -> None:
            rate(state, dy, *given)

        solver = CVODE(fun, max_num_steps=_MOST_STEPS, **_tolerances(rtol, y))
        solution = solver.solve(time, y)
        if not solution.success:
            raise RuntimeError(str(solution.message))
        # Of two times it makes a span, and gives its own steps within.
        return solution.y[1:] if time.size > 2 else solution.y[-1:]

    return solve


def _tolerances(rtol: float, y: Array) -> dict:
    """Of T [K] and xi, about a hundredth of what rtol allows where they are large."""
    return {"rtol": rtol, "atol": np.repeat([rtol, 0.01 * rtol], y.size // 2)}
