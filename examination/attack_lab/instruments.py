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

NAMES = {
    "a_s": "wire.austenite_start_temperature", "a_f": "wire.austenite_finish_temperature",
    "m_s": "wire.martensite_start_temperature", "m_f": "wire.martensite_finish_temperature",
    "c_a": "wire.stress_influence_austenite", "c_m": "wire.stress_influence_martensite",
    "e_a": "wire.austenite_modulus", "e_m": "wire.martensite_modulus",
    "eps_l": "wire.maximum_recoverable_strain", "theta": "wire.thermal_expansion_factor",
}  # fmt: skip


def named(**own: float) -> dict[str, float]:
    """Numbers of an alloy by their names in a parameter file."""
    return {NAMES[symbol]: value for symbol, value in own.items()}


@dataclass(frozen=True)
class Alloy:
    """Stress-free temperatures in K, moduli and slopes in Pa and Pa/K."""

    a_s: float
    a_f: float
    m_s: float
    m_f: float
    c_a: float
    c_m: float
    e_a: float
    e_m: float
    eps_l: float
    theta: float

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
        return named(**{name: getattr(self, name) for name in names})

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


def dsc(alloy: Alloy, random, *, rate=5.0, lag=3.0, noise=0.3e-6, zero=0.0, bow=10e-6,
        top=math.inf, step=0.0, peaks=0.0, spikes=0, turned=False, scale=1.0,
        drift=0.0) -> DscRecord:
    """Heating and cooling at `rate` K/min; `lag` s between sample and its thermometer.

    `zero`, `scale`: of the thermometer, K; `drift` K a cycle; `peaks` share in a second step;
    `step` W of a baseline that jumps in the middle of the peak; `top` W where the signal clips.
    """
    segments, began, mass, heat = [], 0.0, 8e-6, 18e3
    per_second, low, high = rate / 60.0, 273.15, 453.15
    for k, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
        time = np.arange(0.0, (high - low) / per_second, 0.5)
        kelvin = (low if sign > 0 else high) + sign * per_second * time
        xi = alloy.martensite(kelvin - drift * (k // 2), 0.0, sign > 0, peaks)
        flow = mass * (470.0 * sign * per_second - heat * np.gradient(xi, time))
        flow = relaxed(flow, 0.5 / lag)
        share = (kelvin - low) / (high - low)
        flow = flow + 20e-6 * share + bow * share**2
        flow = flow + step * (kelvin > alloy.a_s + 0.5 * (alloy.a_f - alloy.a_s))
        flow = flow + noise * random.standard_normal(len(time))
        for at in random.integers(50, len(time) - 50, spikes):
            flow[at : at + 4] += 60e-6
        flow = np.clip(flow, -top, top) * (-1.0 if turned else 1.0)
        told = scale * (kelvin - 273.15) + 273.15 + zero
        segments.append(DscSegment(
            k + 1, "heating" if sign > 0 else "cooling", sign * per_second, began + time, flow,
            np.zeros(len(time)), told, told,
        ))
        began += float(time[-1])
    return DscRecord(Path("attacked DSC"), mass, {"Sample ID": "synthetic"}, tuple(segments),
                     instrument="synthetic")


def relaxed(values, share):
    """A reading that follows by this share a sample."""
    out, state = np.empty_like(values), values[0]
    for k, value in enumerate(values.tolist()):
        state += share * (value - state)
        out[k] = state
    return out


# --- Held loads (E6, E9).

LOADS = (14e6, 60e6, 120e6, 180e6)


def isobaric(
    alloy: Alloy, stress: float, random, *, zero=0.0, lag=0.0, gauge=1.0, area=1.0, creep=0.0,
    slip=0.0, tail=0.0, span=(285.0, 420.0), cycles=2, stuck=False, swapped=False, friction=0.0,
    drift=0.0, top=math.inf,
) -> IsobaricRecord:
    """Full loops under one stress (Pa).

    `zero`, `lag` K of the thermometer (late both ways); `gauge`, `area`: true over stated; `creep`
    strain a branch; `slip` strain at once in a branch; `friction` Pa against the motion; `drift` K
    of the alloy a cycle; `top` the strain where the extensometer ends.
    """
    t, eps, points = [], [], 700
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
            eps.append(strain / gauge + 3e-5 * random.standard_normal(points))
    kelvin, strain = np.concatenate(t), np.minimum(np.concatenate(eps), top)
    if stuck:
        at = len(strain) // 3
        strain[at : at + points // 3] = strain[at]
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
    force_top=math.inf, toe=0.0015, end=0.06, slip=0.0, points=1200, said: str | None = None,
    yielding=math.inf,
) -> TensileRecord:
    """One test; `compliance` strain per Pa of grips; `slip` strain lost in the rise that counts."""
    modulus = alloy.e_m if phase == "martensite" else alloy.e_a
    plateau, level, after = (
        (0.04, 130e6, 0.6e9) if phase == "martensite" else (0.07, 500e6, 1e9)
    )
    fine = np.linspace(0.0, end, 8000)
    first = level / modulus
    stress = np.where(fine < first, modulus * fine, level + after * (fine - first))
    last = level + after * (plateau - first)
    stress = np.where(fine > plateau, last + modulus * (fine - plateau), stress)
    stress = stress - 0.7 * np.maximum(stress - yielding, 0.0)
    width = 60
    padded = np.pad(stress, width, mode="reflect", reflect_type="odd")
    stress = np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    travel = fine + compliance * stress
    at_slip = 0.5 * (last + stress[-1]) if phase == "martensite" else 0.5 * level
    travel = travel + slip * (stress > at_slip)
    strain = np.linspace(0.0, float(travel[-1]) + toe, points)
    read = np.interp(np.maximum(strain - toe, 0.0), travel, stress)
    read = np.minimum(read + 0.5e6 * random.standard_normal(points), force_top)
    kelvin = 293.15 if phase == "martensite" else 403.15
    return TensileRecord(Path(f"{phase}_{number}.csv"), strain / gauge, read / area, kelvin,
                         phase=said or phase)


# --- The clamped wire (E8).


def clamped(alloy: Alloy, random, *, preload=60e6, force_gain=1.0, force_drift=0.0, clamps=0.0,
            camera=1.0, turned=False, above=math.inf, creep=0.0, stuck=False, late=0.0) -> Record:
    """A staircase of temperature up and down below A_s under tension.

    `camera`: of the excess over the room; `clamps` m of strain a K that they give way (as strain);
    `force_drift` N over the record; `creep` Pa/s; `late` s of the force's stamps.
    """
    hold, room, diameter = 20.0, 296.0, 0.3e-3
    up = np.linspace(298.0, 322.0, 7)
    steps = np.concatenate([up, up[-2::-1]])
    time = np.arange(0.0, hold * len(steps), 0.05)
    place = np.clip((time / hold).astype(int), 0, len(steps) - 1)
    before = np.concatenate([[steps[0]], steps[:-1]])[place]
    kelvin = steps[place] + (before - steps[place]) * np.exp(-(time - place * hold) / 2.0)
    stress = preload + alloy.theta * (kelvin - steps[0]) - clamps * alloy.e_m * (kelvin - steps[0])
    stress = stress + 10e6 * np.maximum(kelvin - above, 0.0) - creep * time
    force = np.maximum(stress, 0.0) * math.pi * diameter**2 / 4.0
    force = force_gain * force + force_drift * time / time[-1]
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


def bend(beam: Beam, random, *, gains=None, swapped=False, stuck=None, clip=math.inf,
         residual=0.0, late=0.0) -> Record:
    """Triangles of the front, then of the back wire; readings with gains by quantity."""
    alloy, step, duration, rate = beam.alloy, 0.01, 36.0, 50.0
    time = np.arange(0.0, duration, step)
    volts = np.column_stack([
        np.interp(time, [0, at, at + 4.0, at + 8.0, 36], [0, 0, 2.6, 0, 0]) for at in (1, 14)
    ])
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

    signals: dict[str, Signal] = {}

    def read(name, unit, truth, noise, zero=0.0):
        quantity = name.rpartition(".")[2]
        values = np.interp(stamps, time, truth) - zero
        values = (gains or {}).get(quantity, 1.0) * values + zero
        values = values + noise * random.standard_normal(len(stamps))
        if name == "deflection":
            values = np.minimum(values, clip)
        if stuck == quantity:
            values[len(values) // 3 :] = values[len(values) // 3]
        delay = late if name == "deflection" else 0.0
        signals[name] = Signal(name, unit, stamps + delay, values)

    sides = ("front_1", "back_1")
    for side, (name, told) in enumerate(zip(sides, sides[::-1] if swapped else sides, strict=True)):
        read(f"{name}.voltage", "V", volts[:, side], 0.004)
        read(f"{name}.current", "A", volts[:, side] / beam.resistance, 0.015)
        read(f"{told}.temperature", "K", kelvin[:, side], 0.1, 273.15)
    read("deflection", "m", tip, 1e-4)
    return Record(Path("beam"), 0, signals)
