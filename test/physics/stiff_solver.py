"""The baseline model as a differential equation for a stiff solver of scipy.

Independent of sma_bench.physics on purpose: it starts from the contract alone, and where the
kernel solves phase and stress as equations, it integrates d xi/dt, from implicit differentiation
of xi = X(T, sigma) and sigma(T, xi). Restarts at every sample of the voltage; no rule for ranges
that stress moves against the temperature.
"""

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np
from scipy.integrate import solve_ivp


@dataclass
class Wires:
    """The contract's numbers [SI]; side of each wire; stiffness of each side, None if clamped."""

    parameters: object
    side: np.ndarray
    stiffness: np.ndarray | None
    latent_heat: float = 0.0
    load: float = 0.0  # Pa on each side, borne by martensite at rest: strains count from there

    def __post_init__(self):
        p = self.parameters
        self.capacity = p["wire.mass"] * p["wire.specific_heat"]
        self.loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
        self.ambient = p["environment.ambient_temperature"]
        self.e_a, self.e_m = p["wire.austenite_modulus"], p["wire.martensite_modulus"]
        self.eps_l = p["wire.maximum_recoverable_strain"]
        self.theta = p["wire.thermal_expansion_factor"]
        self.member = np.equal.outer(np.unique(self.side), self.side).astype(float)
        self.borne = (self.load / self.e_m / self.member.sum(axis=1)) @ self.member

    def stress(self, kelvin, xi):
        """sigma of each wire and contraction of each side."""
        modulus = self.e_a + xi * (self.e_m - self.e_a)
        strain = self.eps_l * (1 - xi) + self.borne
        free = self.theta * (kelvin - self.ambient) + modulus * strain
        if self.stiffness is None:
            contraction = np.zeros(len(self.member))
        else:
            pull = self.member @ free - self.load
            contraction = pull / (self.member @ modulus + self.stiffness)
        return free - modulus * (self.member.T @ contraction), contraction

    def ramps(self, kelvin, sigma):
        """(f, df/dT, df/dsigma) and (g, dg/dT, dg/dsigma) of the contract."""
        p = self.parameters
        a_s, a_f = p["wire.austenite_start_temperature"], p["wire.austenite_finish_temperature"]
        m_s, m_f = p["wire.martensite_start_temperature"], p["wire.martensite_finish_temperature"]
        c_a, c_m = p["wire.stress_influence_austenite"], p["wire.stress_influence_martensite"]
        f = cosine((kelvin - a_s - sigma / c_a) / (a_f - a_s), a_f - a_s, c_a)
        rest = cosine((kelvin - m_f - sigma / c_m) / (m_s - m_f), m_s - m_f, c_m)
        return f, (1 - rest[0], -rest[1], -rest[2])

    def rate(self, y, heating, memory):
        """d(T, xi)/dt."""
        w = len(self.side)
        kelvin, xi = y[:w], y[w:]
        sigma, contraction = self.stress(kelvin, xi)
        by_t, by_s = np.empty(w), np.empty(w)
        for i, (rising, xi_r, f_r, g_r) in enumerate(memory):
            f, g = self.ramps(kelvin[i], sigma[i])
            scale, slopes = (xi_r / f_r, f) if rising else (-(1 - xi_r) / g_r, g)
            by_t[i], by_s[i] = scale * slopes[1], scale * slopes[2]
        d_t = (heating - self.loss * (kelvin - self.ambient)) / self.capacity
        modulus = self.e_a + xi * (self.e_m - self.e_a)
        strain = self.eps_l * (1 - xi) - self.member.T @ contraction + self.borne
        own = (self.e_m - self.e_a) * strain - self.eps_l * modulus
        s_xi, s_t = np.diag(own), np.eye(w) * self.theta
        if self.stiffness is not None:
            stiff = 1 / (self.member @ modulus + self.stiffness)
            give = self.member.T @ np.diag(stiff) @ self.member
            s_xi -= np.outer(modulus, own) * give
            s_t -= np.outer(modulus, np.full(w, self.theta)) * give
        # xi' = by_t T' + by_s (s_t T' + s_xi xi'),  T' = d_t + latent xi'
        latent = self.latent_heat * self.parameters["wire.mass"] / self.capacity
        drive = np.diag(by_t) + by_s[:, None] * s_t
        matrix = np.eye(w) - by_s[:, None] * s_xi - drive * latent
        d_xi = np.linalg.solve(matrix, drive @ d_t)
        return np.concatenate([d_t + latent * d_xi, d_xi])


def triangle(time, peak, period):
    """Triangular voltage [V] from 0 to `peak` and back every `period` [s]."""
    return peak * (1.0 - np.abs(time / period % 1.0 * 2.0 - 1.0))


def solve(wires, time, voltage, rtol=1e-10):
    """From rest; by name of the signals, a row a sample."""
    w = len(wires.side)
    y = np.concatenate([np.full(w, wires.ambient), np.ones(w)])
    memory = [(True, 1.0, 1.0, 0.0)] * w  # rising, xi, f, g at the last reversal
    rows = [y]
    for k in range(len(time) - 1):
        heating = voltage[k] ** 2 / wires.parameters["wire.resistance"]
        excess = wires.ambient + heating / wires.loss - y[:w]
        sigma, _ = wires.stress(y[:w], y[w:])
        for i in range(w):
            if excess[i] != 0 and (excess[i] > 0) != memory[i][0]:
                f, g = wires.ramps(y[i], sigma[i])
                memory[i] = (excess[i] > 0, y[w + i], f[0], g[0])
        solution = solve_ivp(
            lambda _, y, heating=heating: wires.rate(y, heating, memory), (time[k], time[k + 1]), y,
            method="LSODA", rtol=rtol, atol=rtol * 1e-2,
        )  # fmt: skip
        assert solution.success, solution.message
        y = solution.y[:, -1]
        rows.append(y)
    kelvin, xi = np.split(np.array(rows), 2, axis=1)
    stress, contraction = zip(*(wires.stress(*np.split(row, 2)) for row in rows), strict=True)
    return {
        "temperature": kelvin, "martensite_fraction": xi, "stress": np.array(stress),
        "contraction": np.array(contraction),
    }  # fmt: skip


def cosine(x, width, influence):
    if x <= 0:
        return 1.0, 0.0, 0.0
    if x >= 1:
        return 0.0, 0.0, 0.0
    slope = -0.5 * pi / width * sin(pi * x)
    return 0.5 + 0.5 * cos(pi * x), slope, -slope / influence
