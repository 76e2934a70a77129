"""Plain reference implementations of the effects' equations, and rigs and drives of the tests.

Independent of sma_bench.physics on purpose: the numbers come from the parameters alone, rates are
integrated by scipy, histories (largest austenite, plastic stretch) are followed sample by sample.
"""

from math import exp

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sma_bench.parameters import TABLE, Parameters
from sma_bench.parameters.parameter import TRANSITIONS

FOUR = {"bench.channels": ("front_1", "front_2", "back_1", "back_2"),
        "bench.channel_sides": ("front", "front", "back", "back")}  # fmt: skip
INFLUENCES = ("wire.stress_influence_austenite", "wire.stress_influence_martensite")
WIRE = Parameters.of_paper()
# Two wires a side that bend a composite by a few centimetres.
COMPOSITE = WIRE.replace({**FOUR, **dict(zip(INFLUENCES, (7.3e6, 8.0e6), strict=True)),
                          "composite.deflection_per_strain": 1.0,
                          "composite.stress_per_deflection_front": 5.0e9,
                          "composite.stress_per_deflection_back": 4.0e9})  # fmt: skip
SWITCHES = [p for p in TABLE if p.name.startswith("effect.") and p.default == 0.0]
SECONDARY = {"effect.matrix_thermal_mass.inner_share": 0.3, "effect.transition_drift.cycles": 1.0,
             "effect.viscoelastic_matrix.time_constant": 4.0, "effect.supply_drop.knee": 1.4,
             "effect.supply_drop.battery_time": 300.0,
             "effect.ambient_drift.instant": 3.0, "effect.ambient_drift.fading": 8.0,
             "effect.matrix_thermal_mass.clamp_time": 4.0,
             "effect.stress_dependent_transition.bend_stress": 400e6,
             "effect.opposing_wires.detwinning_stress": 60e6}  # fmt: skip


def on_sides(parameters, sides):
    """The rig with a wire on each of these sides."""
    channels = tuple(f"w{i}" for i in range(len(sides)))
    return parameters.replace({"bench.channels": channels, "bench.channel_sides": tuple(sides)})


def alloy(ranges, influences):
    """Start and width of austenite's range, finish and width of martensite's, K; C_A, C_M, Pa/K."""
    a_s, a_width, m_f, m_width = ranges
    numbers = (a_s, a_s + a_width, m_f + m_width, m_f, *influences)
    return dict(zip((*TRANSITIONS.values(), *INFLUENCES), numbers, strict=True))


def typical(parameters, name):
    """One effect at its typical size, with secondary numbers that make it visible early."""
    own = {p.name: p.uncertainty for p in SWITCHES if p.name.split(".")[1] == name}
    return parameters.replace(own | SECONDARY)


def all_on(parameters):
    """Every effect with its typical size."""
    return parameters.replace({p.name: p.uncertainty for p in SWITCHES} | SECONDARY)


def pulses(step, duration=24.0):
    """Time and four voltages: strong and weak pulses of either side, with partial loops."""
    time = np.arange(round(duration / step)) * step
    slot = (time // 0.5).astype(int)
    front = np.array([0, 5.6, 6.6, 3.0, 5.4, 0, 0, 6.0, 0, 0, 0, 0])[slot % 12]
    back = np.array([0, 0, 0, 0, 0, 6.4, 4.8, 5.6, 6.2, 0, 3.0, 0])[slot % 12]
    return time, np.column_stack([front, 0.97 * front, back, 1.02 * back])


def triangle(time, peak, period):
    """Triangular voltage [V] from 0 to `peak` and back every `period` [s]."""
    return peak * (1.0 - np.abs(time / period % 1.0 * 2.0 - 1.0))


def stiffly(rig, time, voltage, rtol):
    """T, xi, stress and contraction by LSODA, restarted at every sample, on the contract's
    equations in d xi/dt."""
    pytest.importorskip("numba")
    from examination.perf.solvers import Problem, lsoda

    problem = Problem.of(rig)
    w = problem.sides.size
    member = np.equal.outer(np.unique(problem.sides), problem.sides).astype(float)
    states = problem.solve(time, voltage, lsoda(rtol), restart=True)
    kelvin, xi = states[:, :w], states[:, w:]
    modulus = rig["wire.austenite_modulus"] * (1 - xi) + rig["wire.martensite_modulus"] * xi
    free = modulus * rig["wire.maximum_recoverable_strain"] * (1 - xi)
    free += rig["wire.thermal_expansion_factor"] * (kelvin - rig["environment.ambient_temperature"])
    contraction = free @ member.T / (modulus @ member.T + problem.stiffness[: len(member)])
    return {"temperature": kelvin, "martensite_fraction": xi,
            "stress": free - modulus * (contraction @ member),
            "contraction": contraction[:, ::-1]}  # front before back


def refined(time, voltage, parts):
    """The same held voltages at `parts` times the rate."""
    fine = np.interp(np.arange((len(time) - 1) * parts + 1) / parts, np.arange(len(time)), time)
    return fine, np.repeat(voltage, parts, axis=0)[: len(fine)]


class Heat:
    """Heat below the transformation (xi = 1), three nodes per wire: wire, silicone, clamp."""

    def __init__(self, parameters):
        p = self.p = parameters
        self.capacity = p["wire.mass"] * p["wire.specific_heat"]
        self.loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
        self.ambient = p["environment.ambient_temperature"]
        side = np.array(p["bench.channel_sides"])
        across = np.not_equal.outer(side, side).astype(float)
        most = max(np.sum(side == "front"), np.sum(side == "back"))
        self.pair = across * p["effect.side_heat_coupling.conductance"] / most
        plume = p["effect.side_heat_coupling.plume"]
        warmed = (side == ("back" if plume > 0.0 else "front"))[:, np.newaxis]
        self.plume = abs(plume) * warmed * across / across.sum(axis=1, keepdims=True).clip(1.0)

    def effect(self, name):
        return float(self.p[f"effect.{name}"])

    def rate(self, t, y, volt):
        wire, silicone, clamp = np.split(y, 3)
        drift = self.effect("ambient_drift.rate") + self.effect("ambient_drift.bend") * t
        since = max(t - self.effect("ambient_drift.instant"), 0.0)
        gust = exp(-since / self.effect("ambient_drift.fading")) - exp(-since / 2.0)
        air = self.ambient + drift * t + self.effect("ambient_drift.gust") * gust
        air = air + self.plume @ (wire - air)
        slope = self.effect("phase_dependent_resistance.temperature_coefficient")
        ohm = self.p["wire.resistance"] * (1 + slope * (wire - self.ambient))
        volt = np.maximum(volt - self.effect("supply_drop.threshold"), 0.0)
        heating = ohm * (volt / (ohm + self.effect("supply_drop.resistance"))) ** 2
        capacity = self.effect("matrix_thermal_mass.heat_capacity")
        surface = silicone if capacity else wire
        rise = self.effect("temperature_dependent_convection.rise")
        loss = self.loss * (1 + rise * (surface - air))
        exchanged = self.pair.sum(axis=1) * surface - self.pair @ surface
        above = surface - clamp
        exchanged = exchanged + self.effect("matrix_thermal_mass.clamp_conductance") * above
        d_clamp = above / self.effect("matrix_thermal_mass.clamp_time")
        if not capacity:
            d_wire = (heating - loss * (wire - air) - exchanged) / self.capacity
            return np.concatenate([d_wire, np.zeros_like(d_wire), d_clamp])
        share = self.effect("matrix_thermal_mass.inner_share")
        inward = self.loss / share * (wire - silicone)
        outward = loss / (1 - share) * (silicone - air) + exchanged
        d_wire, d_silicone = (heating - inward) / self.capacity, (inward - outward) / capacity
        return np.concatenate([d_wire, d_silicone, d_clamp])

    def solve(self, time, voltage):
        """(n, w) K of the wires, from rest."""
        y = np.full(3 * voltage.shape[1], self.ambient)
        rows = [y]
        for k in range(len(time) - 1):
            exact = {"method": "LSODA", "rtol": 1e-10, "atol": 1e-9}
            y = solve_ivp(self.rate, time[k : k + 2], y, args=(voltage[k],), **exact).y[:, -1]
            rows.append(y)
        return np.array(rows)[:, : voltage.shape[1]]


def full_loop(rig, kelvin, sigma=0.0):
    """f and g of the contract's law."""
    a_s, a_f, m_s, m_f = (rig[name] for name in TRANSITIONS.values())
    hot, cold = (sigma / rig[name] for name in INFLUENCES)
    places = (a_f + hot - kelvin) / (a_f - a_s), (kelvin - m_f - cold) / (m_s - m_f)
    return [np.sin(0.5 * np.pi * np.clip(place, 0.0, 1.0)) ** 2 for place in places]


def lagged_heating(elapsed, rise, tau, lag):
    """Reading of a first-order sensor when the temperature is rise [1 - exp(-t/tau)]."""
    return rise * (1 - (tau * np.exp(-elapsed / tau) - lag * np.exp(-elapsed / lag)) / (tau - lag))


def done(cycles, scale):
    return 1 - exp(-cycles / scale)


def forces_of_passive_wires(felt, modulus, limit, hardening, buckled):
    """Force and plastic stretch along a path of stretches `felt`, with hardening, by radial return;
    `buckled` wires do not push."""
    stretch, path = 0.0, []
    for reach in felt:
        if buckled and reach < stretch:
            path.append((0.0, stretch))
            continue
        beyond = modulus * (reach - stretch) - hardening * stretch
        if abs(beyond) > limit:
            stretch += np.sign(beyond) * (abs(beyond) - limit) / (modulus + hardening)
        path.append((modulus * (reach - stretch), stretch))
    return np.array(path).T


def fraction_since_reversal(rising, fraction_reversed, ramps_reversed, ramps):
    """Martensite fraction by the rule of kinetics.py since xi_r at the last reversal; `ramps`:
    (f, g)."""
    f, g = ramps
    f_reversed, g_reversed = ramps_reversed
    if rising:
        return left_of(fraction_reversed, f, f_reversed, g, g_reversed)
    return 1.0 - left_of(1.0 - fraction_reversed, g, g_reversed, f, f_reversed)


def left_of(phase, own, own_reversed, other, other_reversed):
    """Fraction left of the vanishing phase, given its own ramp and the other's."""
    left = 0.0
    if own_reversed > 0.0:
        left = phase * own / own_reversed
    elif phase > 0.0 and other_reversed < 1.0:
        left = phase * (1.0 - other) / (1.0 - other_reversed)
    if other < other_reversed:
        left = max(left, min(1.0 - other / other_reversed, own))
    return min(left, 1.0)


def rule_errors(run, f, g, steady):
    """Largest difference of a sample's fraction from that rule, given ramps and steady temperatures
    (n, w), with reversals found from these; and the number of reversals."""
    trend, xi, largest, turned = np.sign(steady - run.temperature), run.martensite_fraction, 0.0, 0
    for i in range(xi.shape[1]):
        rising, since = True, (1.0, (f[0, i], g[0, i]))
        for k in range(1, len(xi)):
            if trend[k - 1, i] and (trend[k - 1, i] > 0) != rising:
                rising, turned = not rising, turned + 1
                since = xi[k - 1, i], (f[k - 1, i], g[k - 1, i])
            there = fraction_since_reversal(rising, *since, (f[k, i], g[k, i]))
            largest = max(largest, abs(there - xi[k, i]))
    return largest, turned
