"""Tables of calorimeters, load frames and tensile machines, with faults; own equations, nothing of
`sma_bench.physics`."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from sma_bench.records import DscRecord, DscSegment, Record, Signal
from sma_bench.records.isobaric import IsobaricRecord, find_cycles
from sma_bench.records.tensile import TensileRecord

A_S, A_F = "wire.austenite_start_temperature", "wire.austenite_finish_temperature"
M_S, M_F = "wire.martensite_start_temperature", "wire.martensite_finish_temperature"
C_A, C_M = "wire.stress_influence_austenite", "wire.stress_influence_martensite"
E_A, E_M = "wire.austenite_modulus", "wire.martensite_modulus"
EPS_L, THETA = "wire.maximum_recoverable_strain", "wire.thermal_expansion_factor"


@dataclass(frozen=True)
class Alloy:
    """Stress-free temperatures in K, moduli and slopes in Pa and Pa/K."""

    a_s: float = 340.0
    a_f: float = 356.0
    m_s: float = 330.0
    m_f: float = 315.0
    c_a: float = 7.2e6
    c_m: float = 6.4e6
    e_a: float = 55e9
    e_m: float = 25e9
    eps_l: float = 0.043
    theta: float = -0.17e6

    @classmethod
    def drawn(cls, random) -> "Alloy":
        shift, martensite = random.uniform(-6.0, 6.0), random.uniform(21e9, 27e9)
        return cls(
            340.0 + shift, 356.0 + shift + random.uniform(-3.0, 3.0), 330.0 + shift,
            315.0 + shift + random.uniform(-2.0, 2.0), random.uniform(6e6, 8.5e6),
            random.uniform(6e6, 8.5e6), random.uniform(50e9, 60e9), martensite,
            random.uniform(0.038, 0.048), -random.uniform(6.0e-6, 7.5e-6) * martensite,
        )

    def truth(self, *names: str) -> dict[str, float]:
        own = {A_S: self.a_s, A_F: self.a_f, M_S: self.m_s, M_F: self.m_f, C_A: self.c_a,
               C_M: self.c_m, E_A: self.e_a, E_M: self.e_m, EPS_L: self.eps_l, THETA: self.theta}
        return {name: own[name] for name in names}

    def martensite(self, kelvin, stress, heating: bool, tail: float = 0.0):
        """Fraction along a full branch; `tail`: share that transforms in an R-phase step later."""
        low, high = (self.a_s, self.a_f) if heating else (self.m_f, self.m_s)
        shift = stress / (self.c_a if heating else self.c_m)
        return (1.0 - tail) * _half(kelvin, low + shift, high + shift) + tail * _half(
            kelvin, high + shift + 4.0, high + shift + 16.0
        )


def _half(kelvin, low, high):
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((kelvin - low) / (high - low), 0.0, 1.0))


# --- Calorimeter (E5).


def dsc(alloy: Alloy, random, *, rate=5.0, lag=3.0, noise=0.3e-6, zero=0.0, bow=10e-6, cycles=2,
        span=(273.15, 453.15), top=math.inf, step=0.0, peaks=0.0, spikes=0, turned=False,
        scale=1.0, drift=0.0) -> DscRecord:
    """Heating and cooling at `rate` K/min; `lag` s between sample and its thermometer.

    `zero`, `scale`: of the thermometer, K; `drift` K a cycle; `peaks` share in a second step;
    `step` W of a baseline that jumps in the middle of the peak; `top` W where the signal clips.
    """
    segments, began, mass, heat = [], 0.0, 8e-6, 18e3
    per_second = rate / 60.0
    for cycle in range(cycles):
        for sign in (1.0, -1.0):
            time = np.arange(0.0, (span[1] - span[0]) / per_second, 0.5)
            kelvin = (span[0] if sign > 0 else span[1]) + sign * per_second * time
            xi = alloy.martensite(kelvin - drift * cycle, 0.0, sign > 0, peaks)
            flow = mass * (470.0 * sign * per_second - heat * np.gradient(xi, time))
            flow = _relaxed(flow, 0.5 / lag) if lag else flow
            share = (kelvin - span[0]) / (span[1] - span[0])
            flow = flow + 20e-6 * share + bow * share**2
            flow = flow + step * (kelvin > alloy.a_s + 0.5 * (alloy.a_f - alloy.a_s))
            flow = flow + noise * random.standard_normal(len(time))
            for at in random.integers(50, len(time) - 50, spikes):
                flow[at : at + 4] += 60e-6
            flow = np.clip(flow, -top, top) * (-1.0 if turned else 1.0)
            told = scale * (kelvin - 273.15) + 273.15 + zero
            segments.append(DscSegment(
                len(segments) + 1, "heating" if sign > 0 else "cooling", sign * per_second,
                began + time, flow, np.zeros(len(time)), told, told,
            ))
            began += float(time[-1])
    return DscRecord(Path("attacked DSC"), mass, {"Sample ID": "synthetic"}, tuple(segments),
                     instrument="synthetic")


def _relaxed(values, share):
    out, state = np.empty_like(values), values[0]
    for k, value in enumerate(values.tolist()):
        state += share * (value - state)
        out[k] = state
    return out


# --- Held loads (E6, E9).

LOADS = (14e6, 60e6, 120e6, 180e6)


def isobaric(
    alloy: Alloy, stress: float, random, *, zero=0.0, lag=0.0, gauge=1.0, area=1.0, creep=0.0,
    slip=0.0, noise=3e-5, tail=0.0, span=(285.0, 420.0), points=700, cycles=2, stuck=False,
    swapped=False, friction=0.0, percent=False, drift=0.0, top=math.inf,
) -> IsobaricRecord:
    """Full loops under one stress (Pa).

    `zero`, `lag` K of the thermometer (late both ways); `gauge`, `area`: true over stated; `creep`
    strain a branch; `slip` strain at once in a branch; `friction` Pa against the motion; `drift` K
    of the alloy a cycle; `top` the strain where the extensometer ends.
    """
    t, eps = [], []
    for cycle in range(cycles):
        for sign in (1.0, -1.0):
            grid = np.linspace(*span, points)
            kelvin = grid if sign > 0 else grid[::-1]
            felt = stress + sign * friction
            xi = alloy.martensite(kelvin - drift * cycle, felt, sign > 0, tail)
            modulus = alloy.e_a + xi * (alloy.e_m - alloy.e_a)
            strain = (felt - alloy.theta * (kelvin - 296.0)) / modulus
            strain = strain - alloy.eps_l * (1.0 - xi) + alloy.eps_l
            strain = strain + creep * (len(t) + np.linspace(0.0, 1.0, points))
            strain = strain + slip * (np.arange(points) > 0.5 * points) * (len(t) == 0)
            t.append(kelvin + zero - sign * lag + 0.05 * random.standard_normal(points))
            eps.append(strain / gauge + noise * random.standard_normal(points))
    kelvin, strain = np.concatenate(t), np.minimum(np.concatenate(eps), top)
    if stuck:
        at = len(strain) // 3
        strain[at : at + points // 3] = strain[at]
    if percent:
        strain = 100.0 * strain
    told = stress * area
    name = f"{told / 1e6:.0f} MPa"
    held = np.full(len(strain), told)
    if swapped:
        strain, held = held / 1e6 + 0.01 * random.standard_normal(len(held)), strain * 1e6
    found, remarks = find_cycles(kelvin, strain, held, name)
    return IsobaricRecord(Path(f"{name}.txt"), name, float(np.median(held)), "1", tuple(found),
                          tuple(remarks))


# --- Tensile tests (E7).


def tensile(
    alloy: Alloy, phase: str, number: int, random, *, compliance=0.0, gauge=1.0, area=1.0,
    force_top=math.inf, toe=0.0015, noise=0.5e6, end=0.06, slip=0.0, points=1200, zero=0.0,
    said: str | None = None, yielding=math.inf,
) -> TensileRecord:
    """One test; `compliance` strain per Pa of grips; `slip` strain lost in the rise that counts."""
    modulus = alloy.e_m if phase == "martensite" else alloy.e_a
    if phase == "martensite":
        plateau, level, after = 0.04, 130e6, 0.6e9
    else:
        plateau, level, after = 0.07, 500e6, 1e9
    fine = np.linspace(0.0, end, 8000)
    first = level / modulus
    stress = np.where(fine < first, modulus * fine, level + after * (fine - first))
    last = level + after * (plateau - first)
    stress = np.where(fine > plateau, last + modulus * (fine - plateau), stress)
    above = np.maximum(stress - yielding, 0.0)
    stress = stress - 0.7 * above
    width = 60
    padded = np.pad(stress, width, mode="reflect", reflect_type="odd")
    stress = np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    travel = fine + compliance * stress
    at_slip = 0.5 * (last + stress[-1]) if phase == "martensite" else 0.5 * level
    travel = travel + slip * (stress > at_slip)
    strain = np.linspace(0.0, float(travel[-1]) + toe, points)
    read = np.interp(np.maximum(strain - toe, 0.0), travel, stress)
    read = np.minimum(read + noise * random.standard_normal(points) + zero, force_top)
    kelvin = 293.15 if phase == "martensite" else 403.15
    return TensileRecord(Path(f"{phase}_{number}.csv"), strain / gauge, read / area, kelvin,
                         phase=said or phase)


# --- The clamped wire (E8).


def clamped(
    alloy: Alloy, random, *, preload=60e6, diameter=0.3e-3, force_gain=1.0, force_drift=0.0,
    clamps=0.0, camera=1.0, turned=False, above=math.inf, creep=0.0, stuck=False, room=296.0,
    late=0.0, levels=7, zero=0.0,
) -> Record:
    """A staircase of temperature up and down below A_s under tension.

    `camera`: of the excess over the room; `clamps` m of strain a K that they give way (as strain);
    `force_drift` N over the record; `creep` Pa/s; `late` s of the force's stamps.
    """
    hold = 20.0
    up = np.linspace(298.0, 322.0, levels)
    steps = np.concatenate([up, up[-2::-1]])
    time = np.arange(0.0, hold * len(steps), 0.05)
    place = np.clip((time / hold).astype(int), 0, len(steps) - 1)
    before = np.concatenate([[steps[0]], steps[:-1]])[place]
    kelvin = steps[place] + (before - steps[place]) * np.exp(-(time - place * hold) / 2.0)
    stress = preload + alloy.theta * (kelvin - steps[0]) - clamps * alloy.e_m * (kelvin - steps[0])
    stress = stress + 10e6 * np.maximum(kelvin - above, 0.0) - creep * time
    force = np.maximum(stress, 0.0) * math.pi * diameter**2 / 4.0
    force = force_gain * force + force_drift * time / time[-1] + zero
    force = force + 0.02 * random.standard_normal(len(time))
    seen = room + camera * (kelvin - room) + 0.1 * random.standard_normal(len(time))
    if stuck:
        force[len(force) // 4 :] = force[len(force) // 4]
    return Record(Path("clamped"), 0, {
        "force": Signal("force", "N", time + 0.01 + late, -force if turned else force),
        "wire.temperature": Signal("wire.temperature", "K", time, seen),
    })


# --- A beam with a wire on each side (E10): eqs. (1), (6) to (13) with the corrected stiffness.


@dataclass(frozen=True)
class Beam:
    """Two wires on a strip of silicone; alpha in m, beta in Pa/m."""

    alloy: Alloy
    alpha: float = 0.9
    beta: float = 4.5e9
    resistance: float = 2.7
    heat_loss: float = 0.024  # W/K
    capacity: float = 0.04  # J/K
    room: float = 296.0


def bend(beam: Beam, random, *, top=2.6, rate=50.0, gains=None, zeros=None, swapped=False,
         volts_lag=0.0, stuck=None, clip=math.inf, residual=0.0, late=0.0, stroke=4.0) -> Record:
    """Triangles of the front, then of the back wire; readings with gains and zeros by quantity."""
    gains, zeros = {**dict.fromkeys(("current", "temperature", "deflection", "voltage"), 1.0),
                    **(gains or {})}, zeros or {}
    alloy, step, duration = beam.alloy, 0.01, 36.0
    time = np.arange(0.0, duration, step)
    one = np.interp(time, [0, 1, 1 + stroke, 1 + 2 * stroke, 36], [0, 0, top, 0, 0])
    other = np.interp(time, [0, 14, 14 + stroke, 14 + 2 * stroke, 36], [0, 0, top, 0, 0])
    volts = np.column_stack([one, other])
    kelvin = np.empty_like(volts)
    deflection = np.zeros((len(time), 2))
    for side in range(2):
        hot, xi, turn, sigma, warm = beam.room, 1.0, (beam.room, 1.0), 0.0, True
        for k, v in enumerate(volts[:, side].tolist()):
            before = hot
            steady = beam.room + v * v / beam.resistance / beam.heat_loss
            hot = steady + (hot - steady) * math.exp(-step * beam.heat_loss / beam.capacity)
            if (hot > before) != warm and abs(hot - before) > 1e-9:
                warm, turn = hot > before, (before, xi)
            kelvin[k, side] = hot

            def fraction(stress, hot=hot, warm=warm, turn=turn):
                def curve(t):
                    return float(alloy.martensite(t, stress, warm))
                if warm:
                    return turn[1] * curve(hot) / max(curve(turn[0]), 1e-12)
                left = max(1.0 - curve(turn[0]), 1e-12)
                return 1.0 - (1.0 - turn[1]) * (1.0 - curve(hot)) / left

            def pull(stress, hot=hot, fraction=fraction):
                x = fraction(stress)
                e = alloy.e_a + x * (alloy.e_m - alloy.e_a)
                free = alloy.theta * (hot - beam.room) + alloy.eps_l * e * (1.0 - x)
                return free / (beam.beta + e / beam.alpha) * beam.beta, x

            # What the wire pulls with and what the strip asks for meet at one stress.
            if pull(sigma)[0] - sigma > 1e3 or sigma - pull(sigma)[0] > 1e3:
                low, high = -50e6, 400e6
                sigma = brentq(lambda s: pull(s)[0] - s, low, high, xtol=1e2)
            xi = fraction(sigma)
            deflection[k, side] = sigma / beam.beta
    rest = residual * (time > 14.0)
    tip = deflection[:, 0] - deflection[:, 1] + rest
    stamps = np.arange(0.0, duration - step, 1.0 / rate)

    def seen(name, quantity, unit, truth, noise, zero=0.0, delay=0.0):
        values = np.interp(stamps, time, truth) - zero
        values = gains[quantity] * values + zero + zeros.get(quantity, 0.0)
        values = np.minimum(values + noise * random.standard_normal(len(stamps)), clip
                            if quantity == "deflection" else math.inf)
        if stuck == quantity:
            values[len(values) // 3 :] = values[len(values) // 3]
        return Signal(name, unit, stamps + delay, values)

    signals = {}
    sides = ("back_1", "front_1") if swapped else ("front_1", "back_1")
    for side, name in enumerate(("front_1", "back_1")):
        current = volts[:, side] / beam.resistance
        signals[f"{name}.voltage"] = seen(f"{name}.voltage", "voltage", "V", volts[:, side], 0.004)
        signals[f"{name}.current"] = seen(f"{name}.current", "current", "A", current, 0.015)
        told = sides[side]
        signals[f"{told}.temperature"] = seen(
            f"{told}.temperature", "temperature", "K", kelvin[:, side], 0.1, 273.15
        )
    signals["deflection"] = seen("deflection", "deflection", "m", tip, 1e-4, delay=late)
    return Record(Path("beam"), 0, signals)
