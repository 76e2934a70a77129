"""Equations of the effects written by plain means, and the rigs and drives that tests share.

Independent of sma_bench.physics on purpose: the numbers come from the parameters alone, rates are
integrated by scipy, histories (largest austenite, plastic stretch) are followed sample by sample.
"""

from collections.abc import Sequence
from math import exp

import numpy as np
from scipy.integrate import solve_ivp

from sma_bench.parameters import TABLE, Parameters
from sma_bench.parameters.table import TRANSITIONS

FOUR = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}
COMPOSITE = Parameters.of_paper().replace(
    {
        **FOUR,
        "composite.deflection_per_strain": 1.0,
        "composite.stress_per_deflection_front": 5.0e9,
        "composite.stress_per_deflection_back": 4.0e9,
    }
)
INFLUENCES = ("wire.stress_influence_austenite", "wire.stress_influence_martensite")
SWITCHES = [p for p in TABLE if p.name.startswith("effect.") and p.default == 0.0]
SECONDARY = {
    "effect.matrix_thermal_mass.inner_share": 0.3,
    "effect.transition_drift.cycles": 1.0,
    "effect.viscoelastic_matrix.time_constant": 4.0,
    "effect.opposing_wires.detwinning_stress": 60e6,
}


def on_sides(parameters: Parameters, sides: Sequence[str]) -> Parameters:
    """The rig with a wire on each of these sides."""
    channels = tuple(f"w{i}" for i in range(len(sides)))
    return parameters.replace({"bench.channels": channels, "bench.channel_sides": tuple(sides)})


def alloy(ranges: Sequence[float], influences: Sequence[float]) -> dict[str, float]:
    """Start and width of austenite's range, finish and width of martensite's, K; C_A, C_M, Pa/K."""
    a_s, a_width, m_f, m_width = ranges
    numbers = (a_s, a_s + a_width, m_f + m_width, m_f, *influences)
    return dict(zip((*TRANSITIONS.values(), *INFLUENCES), numbers, strict=True))


def typical(parameters: Parameters, name: str) -> Parameters:
    """One effect with its size, and secondary numbers that make it show soon."""
    own = {p.name: p.uncertainty for p in SWITCHES if p.name.split(".")[1] == name}
    return parameters.replace(own | SECONDARY)


def all_on(parameters: Parameters) -> Parameters:
    """Every effect with its typical size."""
    return parameters.replace({p.name: p.uncertainty for p in SWITCHES} | SECONDARY)


def pulses(step: float, duration: float = 24.0) -> tuple[np.ndarray, np.ndarray]:
    """Time and four voltages: strong and weak pulses of either side, partial loops among them."""
    time = np.arange(round(duration / step)) * step
    slot = (time // 0.5).astype(int)
    front = np.array([0, 5.6, 6.6, 3.0, 5.4, 0, 0, 6.0, 0, 0, 0, 0])[slot % 12]
    back = np.array([0, 0, 0, 0, 0, 6.4, 4.8, 5.6, 6.2, 0, 3.0, 0])[slot % 12]
    return time, np.column_stack([front, 0.97 * front, back, 1.02 * back])


def refined(time: np.ndarray, voltage: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """The same held voltages at `parts` times the rate."""
    fine = np.interp(np.arange((len(time) - 1) * parts + 1) / parts, np.arange(len(time)), time)
    return fine, np.repeat(voltage, parts, axis=0)[: len(fine)]


class Heat:
    """Two nodes a wire below its transformation (xi = 1): the wire and the silicone around it."""

    def __init__(self, parameters: Parameters) -> None:
        p = self.p = parameters
        self.capacity = p["wire.mass"] * p["wire.specific_heat"]
        self.loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
        self.ambient = p["environment.ambient_temperature"]
        side = np.array(p["bench.channel_sides"])
        across = np.not_equal.outer(side, side).astype(float)
        most = max(np.sum(side == "front"), np.sum(side == "back"))
        self.pair = across * p["effect.side_heat_coupling.conductance"] / most

    def effect(self, name: str) -> float:
        return float(self.p[f"effect.{name}"])

    def rate(self, t: float, y: np.ndarray, volt: np.ndarray) -> np.ndarray:
        wire, silicone = np.split(y, 2)
        air = (
            self.ambient
            + (self.effect("ambient_drift.rate") + self.effect("ambient_drift.bend") * t) * t
        )
        slope = self.effect("phase_dependent_resistance.temperature_coefficient")
        ohm = self.p["wire.resistance"] * (1 + slope * (wire - self.ambient))
        heating = ohm * (volt / (ohm + self.effect("supply_drop.resistance"))) ** 2
        capacity = self.effect("matrix_thermal_mass.heat_capacity")
        surface = silicone if capacity else wire
        loss = self.loss * (
            1 + self.effect("temperature_dependent_convection.rise") * (surface - air)
        )
        exchanged = self.pair.sum(axis=1) * surface - self.pair @ surface
        if not capacity:
            d_wire = (heating - loss * (wire - air) - exchanged) / self.capacity
            return np.concatenate([d_wire, np.zeros_like(d_wire)])
        share = self.effect("matrix_thermal_mass.inner_share")
        inward = self.loss / share * (wire - silicone)
        outward = loss / (1 - share) * (silicone - air) + exchanged
        return np.concatenate([(heating - inward) / self.capacity, (inward - outward) / capacity])

    def solve(self, time: np.ndarray, voltage: np.ndarray) -> np.ndarray:
        """(n, w) K of the wires, from rest."""
        y = np.full(2 * voltage.shape[1], self.ambient)
        rows = [y]
        for k in range(len(time) - 1):
            solution = solve_ivp(
                self.rate,
                (time[k], time[k + 1]),
                y,
                method="LSODA",
                args=(voltage[k],),
                rtol=1e-10,
                atol=1e-9,
            )
            y = solution.y[:, -1]
            rows.append(y)
        return np.array(rows)[:, : voltage.shape[1]]


def lagged_heating(elapsed: np.ndarray, rise: float, tau: float, lag: float) -> np.ndarray:
    """What a first-order sensor reads of rise [1 - exp(-t/tau)]."""
    return rise * (1 - (tau * np.exp(-elapsed / tau) - lag * np.exp(-elapsed / lag)) / (tau - lag))


def done(cycles: float, scale: float) -> float:
    return 1 - exp(-cycles / scale)


def forces_of_passive_wires(
    felt: np.ndarray, modulus: float, limit: float, hardening: float
) -> tuple[np.ndarray, np.ndarray]:
    """Force and stretch along a path of what the wires feel, hardening, by radial return."""
    stretch, path = 0.0, []
    for reach in felt:
        beyond = modulus * (reach - stretch) - hardening * stretch
        if abs(beyond) > limit:
            stretch += np.sign(beyond) * (abs(beyond) - limit) / (modulus + hardening)
        path.append((modulus * (reach - stretch), stretch))
    force, stretched = np.array(path).T
    return force, stretched
