"""What one would pick for the simulation otherwise: stiff solvers on the model's differential form.

LSODA of scipy and CVODE of scikit-sundae integrate T and xi of all wires, with d xi/dt from
implicit differentiation of xi = X(T, sigma) and sigma(T, xi). They have every chance: the right
side is compiled by numba, a held voltage is one segment however many samples lie in it, and a
restart happens only where a voltage changes.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numba
import numpy as np
from scipy.integrate import solve_ivp

from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at
from sma_bench.physics.kernel import Kernel

try:
    from sksundae.cvode import CVODE
except ImportError:
    CVODE = None

Solver = Callable[..., np.ndarray]
RISING, FRACTION, F, G = range(4)  # columns of `turned`: the state at the last reversal
_MOST_STEPS = 100_000


@numba.njit(cache=True, error_model="numpy")
def ramps(constants, kelvin, sigma):
    """f and g, with their slopes in T and sigma."""
    x = (constants[0] - kelvin + sigma * constants[2]) * constants[1]
    y = (kelvin - sigma * constants[5] - constants[3]) * constants[4]
    f, f_slope = (0.0 if x <= 0.0 else 1.0), 0.0
    g, g_slope = (0.0 if y <= 0.0 else 1.0), 0.0
    if 0.0 < x < 1.0:
        f = math.sin(0.5 * math.pi * x) ** 2
        f_slope = 0.5 * math.pi * math.sin(math.pi * x)
    if 0.0 < y < 1.0:
        g = math.sin(0.5 * math.pi * y) ** 2
        g_slope = 0.5 * math.pi * math.sin(math.pi * y)
    return (
        f, -f_slope * constants[1], f_slope * constants[1] * constants[2],
        g, g_slope * constants[4], -g_slope * constants[4] * constants[5],
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def contraction_of(constants, side, stiffness, y, s):
    """Contraction of side s, 0 where it is clamped (stiffness below 0)."""
    if stiffness[s] < 0.0:
        return 0.0
    w = side.size
    pull, total = 0.0, stiffness[s]
    for i in range(w):
        if side[i] == s:
            modulus = constants[6] + y[w + i] * constants[7]
            pull += constants[9] * (y[i] - constants[10])
            pull += modulus * constants[8] * (1.0 - y[w + i])
            total += modulus
    return pull / total


@numba.njit(cache=True, error_model="numpy")
def rate(y, dy, voltage, turned, constants, side, stiffness):
    """d(T, xi)/dt at held voltages (w,), written to dy."""
    w = side.size
    by_t, by_s, cooling = np.empty(w), np.empty(w), np.empty(w)
    modulus, own, weight = np.empty(w), np.empty(w), np.zeros(stiffness.size)
    for s in range(stiffness.size):
        contraction = contraction_of(constants, side, stiffness, y, s)
        total = stiffness[s]
        for i in range(w):
            if side[i] != s:
                continue
            xi = y[w + i]
            modulus[i] = constants[6] + xi * constants[7]
            stretch = constants[8] * (1.0 - xi) - contraction
            sigma = modulus[i] * stretch + constants[9] * (y[i] - constants[10])
            own[i] = constants[7] * stretch - constants[8] * modulus[i]
            total += modulus[i]
            f, f_t, f_s, g, g_t, g_s = ramps(constants, y[i], sigma)
            if turned[i, RISING] > 0.0:
                scale = turned[i, FRACTION] / turned[i, F] if turned[i, F] > 0.0 else 0.0
                by_t[i], by_s[i] = scale * f_t, scale * f_s
            else:
                scale = (turned[i, FRACTION] - 1.0) / turned[i, G] if turned[i, G] > 0.0 else 0.0
                by_t[i], by_s[i] = scale * g_t, scale * g_s
        if stiffness[s] >= 0.0:
            weight[s] = 1.0 / total
    for i in range(w):
        excess = y[i] - constants[10]
        of_phase = 1.0 + constants[14] * (1.0 - y[w + i])
        ohm = constants[13] * of_phase * max(1.0 + constants[15] * excess, 0.05)
        loss = constants[12] * max(1.0 + constants[16] * excess, 0.05)
        cooling[i] = (voltage[i] ** 2 / ohm - loss * excess) / constants[11]
    matrix, drive = np.eye(w), np.zeros(w)
    latent, theta = constants[17], constants[9]
    for i in range(w):
        for j in range(w):
            give = modulus[i] * weight[side[i]] if side[i] == side[j] else 0.0
            s_xi = (own[i] if i == j else 0.0) - give * own[j]
            s_t = (theta if i == j else 0.0) - give * theta
            by = by_s[i] * s_t + (by_t[i] if i == j else 0.0)
            matrix[i, j] -= by_s[i] * s_xi + by * latent
            drive[i] += by * cooling[j]
    if w == 1:
        drive[0] /= matrix[0, 0]
    else:
        drive = np.linalg.solve(matrix, drive)
    for i in range(w):
        dy[i] = cooling[i] + latent * drive[i]
        dy[w + i] = drive[i]


@numba.njit(cache=True, error_model="numpy")
def turn(y, voltage, turned, constants, side, stiffness):
    """Note the state of every wire that turns round at these voltages, as the contract does."""
    w = side.size
    for i in range(w):
        excess = y[i] - constants[10]
        of_phase = 1.0 + constants[14] * (1.0 - y[w + i])
        ohm = constants[13] * of_phase * max(1.0 + constants[15] * excess, 0.05)
        loss = constants[12] * max(1.0 + constants[16] * excess, 0.05)
        above = excess - voltage[i] ** 2 / (ohm * loss)
        if above * turned[i, RISING] > 0.0:
            contraction = contraction_of(constants, side, stiffness, y, side[i])
            modulus = constants[6] + y[w + i] * constants[7]
            sigma = modulus * (constants[8] * (1.0 - y[w + i]) - contraction)
            sigma += constants[9] * excess
            f, _, _, g, _, _ = ramps(constants, y[i], sigma)
            turned[i, RISING] = -turned[i, RISING]
            turned[i, FRACTION], turned[i, F], turned[i, G] = y[w + i], f, g


@dataclass
class Problem:
    """The numbers of a bench as the right side takes them."""

    constants: np.ndarray
    side: np.ndarray
    stiffness: np.ndarray

    @classmethod
    def of(cls, parameters: Parameters) -> "Problem":
        wires, sides = Kernel(parameters, None).rows
        columns = [
            at.AUSTENITE_FINISH, at.AUSTENITE_SLOPE, at.AUSTENITE_SHIFT,
            at.MARTENSITE_FINISH, at.MARTENSITE_SLOPE, at.MARTENSITE_SHIFT,
            at.AUSTENITE_MODULUS, at.MODULUS_CHANGE, at.RECOVERABLE_STRAIN, at.EXPANSION,
            at.AMBIENT, at.CAPACITY, at.LOSS, at.RESISTANCE,
            at.AUSTENITE_RESISTANCE, at.RESISTANCE_SLOPE, at.CONVECTION_RISE, at.LATENT_RISE,
        ]  # fmt: skip
        clamped = sides[:, at.PRESCRIBED] > 0.0
        stiffness = np.where(clamped, -1.0, sides[:, at.STIFFNESS])
        return cls(
            np.ascontiguousarray(wires[0, columns]), wires[:, at.SIDE].astype(np.int64), stiffness
        )

    def solve(
        self, time: np.ndarray, voltage: np.ndarray, solver: Solver, *,
        restart_at_samples: bool = False,
    ) -> np.ndarray:
        """(n, 2 w): T and xi of all wires at every sample, from rest."""
        n, w = voltage.shape
        states = np.empty((n, 2 * w))
        states[0, :w], states[0, w:] = self.constants[10], 1.0
        turned = np.tile([1.0, 1.0, 1.0, 0.0], (w, 1))
        for start, stop in _segments(voltage, restart_at_samples):
            volts = voltage[start]
            turn(states[start], volts, turned, self.constants, self.side, self.stiffness)
            states[start + 1 : stop + 1] = solver(
                self, time[start : stop + 1], states[start].copy(), volts, turned
            )
        return states


def _segments(voltage: np.ndarray, restart_at_samples: bool = False) -> Iterable[tuple[int, int]]:
    """First and last sample of each stretch of a held voltage, or of each step."""
    changes = np.flatnonzero(np.any(np.diff(voltage[:-1], axis=0) != 0.0, axis=1)) + 1
    starts = list(range(len(voltage) - 1)) if restart_at_samples else [0, *changes.tolist()]
    return zip(starts, [*starts[1:], len(voltage) - 1], strict=True)


def lsoda(rtol: float, compiled: bool = True) -> Solver:
    """scipy's LSODA; its right side compiled, or the same lines as plain Python."""
    right_side = rate if compiled else _plain_rate

    def solve(problem, time, y, volts, turned):
        dy = np.empty_like(y)

        def fun(_, state):
            right_side(
                state, dy, volts, turned, problem.constants, problem.side, problem.stiffness
            )
            return dy.copy()

        span = (time[0], time[-1])
        solution = solve_ivp(
            fun, span, y, "LSODA", t_eval=time[1:], rtol=rtol, atol=_absolute(rtol, y)
        )
        if not solution.success:
            raise RuntimeError(solution.message)
        return solution.y.T

    return solve


def cvode(rtol: float) -> Solver:
    """CVODE (BDF) of SUNDIALS, right side compiled."""

    def solve(problem, time, y, volts, turned):
        def fun(_, state, dy):
            rate(state, dy, volts, turned, problem.constants, problem.side, problem.stiffness)

        solution = CVODE(
            fun, rtol=rtol, atol=_absolute(rtol, y), max_num_steps=_MOST_STEPS
        ).solve(time, y)
        if not solution.success:
            raise RuntimeError(str(solution.message))
        # Of two times it makes a span, and gives its own steps within.
        return solution.y[1:] if time.size > 2 else solution.y[-1:]

    return solve


def _absolute(rtol: float, y: np.ndarray) -> np.ndarray:
    """Of T [K] and xi, about a hundredth of what rtol allows where they are large."""
    return np.repeat([rtol, 0.01 * rtol], y.size // 2)


def _plain_rate(y, dy, voltage, turned, constants, side, stiffness):
    """`rate` as plain Python; what it calls stays compiled, which only helps it."""
    rate.py_func(y, dy, voltage, turned, constants, side, stiffness)
