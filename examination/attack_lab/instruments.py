"""Records of calorimeters, load frames and tensile machines, with faults; by equations of its own,
without `sma_bench.physics`."""

import math
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import yaml
from scipy.signal import lfilter

from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records import DscRecord, DscSegment, Record, Signal
from sma_bench.records.instruments import IsobaricRecord, TensileRecord, find_cycles

ZERO = 273.15
LOADS = (14e6, 60e6, 120e6, 180e6)
FAULTS = yaml.safe_load(Path(__file__).with_name("attacks.yaml").read_text(encoding="utf-8"))
NAMES = dict(zip(("a_s", "a_f", "m_s", "m_f"), TRANSITIONS.values(), strict=True)) | FAULTS["names"]


def named(**own: float) -> dict[str, float]:
    return {NAMES[symbol]: value for symbol, value in own.items()}


class Alloy(namedtuple("Alloy", "a_s a_f m_s m_f c_a c_m e_a e_m eps_l theta")):
    """Stress-free temperatures in K, moduli and slopes in Pa and Pa/K."""

    @classmethod
    def drawn(cls, random) -> "Alloy":
        shift, martensite = random.uniform(-6.0, 6.0), random.uniform(21e9, 27e9)
        a_f = 356.0 + shift + random.uniform(-3.0, 3.0)
        m_f = 315.0 + shift + random.uniform(-2.0, 2.0)
        slopes = random.uniform(6e6, 8.5e6), random.uniform(6e6, 8.5e6)
        moduli = random.uniform(50e9, 60e9), martensite
        strain, expansion = random.uniform(0.038, 0.048), random.uniform(6.0e-6, 7.5e-6)
        temperatures = 340.0 + shift, a_f, 330.0 + shift, m_f
        return cls(*temperatures, *slopes, *moduli, strain, -expansion * martensite)

    def truth(self, *names: str) -> dict[str, float]:
        return named(**{name: getattr(self, name) for name in names or NAMES})

    def martensite(self, kelvin, stress, heating: bool, tail: float = 0.0):
        """Martensite fraction on a full branch; `tail`: share that follows in an R-phase step."""
        low, high = (self.a_s, self.a_f) if heating else (self.m_f, self.m_s)
        shift = stress / (self.c_a if heating else self.c_m)
        late = _half(kelvin, high + shift + 4.0, high + shift + 16.0)
        return (1.0 - tail) * _half(kelvin, low + shift, high + shift) + tail * late

    def modulus(self, xi):
        return self.e_a + xi * (self.e_m - self.e_a)


def faulty(instrument: str, faults: dict) -> SimpleNamespace:
    """Settings of an instrument with its faults; without, as `sound` in attacks.yaml."""
    sound = FAULTS["sound"][instrument]
    if unknown := faults.keys() - sound.keys():
        raise TypeError(f"no fault {', '.join(unknown)}")
    return SimpleNamespace(**(sound | faults))


def _half(kelvin, low, high):
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((kelvin - low) / (high - low), 0.0, 1.0))


def relaxed(values, share):
    """First-order lag: the reading follows by this share per sample."""
    rest = 1.0 - share
    return lfilter([share], [1.0, -rest], values, zi=[rest * values[0]])[0]


def dsc(alloy: Alloy, random, span=(ZERO, 453.15), **faults: float) -> DscRecord:
    """E5: heating and cooling alternately, `cycles` times at `rate` K/min."""
    f = faulty("dsc", faults)
    segments, began, mass, heat = [], 0.0, 8e-6, 18e3
    per_second, (low, high) = f.rate / 60.0, span
    for k in range(2 * f.cycles):
        sign = 1.0 - 2.0 * (k % 2)
        time = np.arange(0.0, (high - low) / per_second, 0.5)
        kelvin = (low if sign > 0 else high) + sign * per_second * time
        xi = alloy.martensite(kelvin - f.drift * (k // 2), 0.0, sign > 0, f.peaks)
        flow = mass * (470.0 * sign * per_second - heat * np.gradient(xi, time))
        share = (kelvin - low) / (high - low)
        flow = relaxed(flow, 0.5 / f.lag) + 20e-6 * share + f.bow * share**2
        flow = flow + f.step * (kelvin > alloy.a_s + 0.5 * (alloy.a_f - alloy.a_s))
        flow = flow + f.noise * random.standard_normal(len(time))
        for at in random.integers(50, len(time) - 50, f.spikes):
            flow[at : at + 4] += 60e-6
        flow = np.clip(flow, -f.top, f.top) * (-1.0 if f.turned else 1.0)
        read = f.scale * (kelvin - ZERO) + ZERO + f.zero
        if f.scatter:
            read = read + f.scatter * random.standard_normal()
        time, nothing = began + time, np.zeros(len(time))
        segments.append(DscSegment(k + 1, sign * per_second, time, flow, nothing, read, read))
        began = float(time[-1])
    notes = {"Sample ID": "synthetic"}
    return DscRecord(Path("attacked DSC"), mass, notes, tuple(segments), instrument="synthetic")


def loops(alloy: Alloy, stress: float, random, span=(285.0, 420.0), **faults: float):
    """E6, E9: full loops at one stress (Pa): temperature, strain and stress as read."""
    f = faulty("loops", faults)
    t, eps, points = [], [], 700
    for cycle in range(f.cycles):
        differs = f.scatter * random.standard_normal() if f.scatter else 0.0
        for sign in (1.0, -1.0):
            kelvin = np.linspace(*span, points)[:: int(sign)]
            felt = stress + sign * f.friction
            xi = alloy.martensite(kelvin - f.drift * cycle, felt, sign > 0, f.tail)
            strain = (felt - alloy.theta * (kelvin - 296.0)) / alloy.modulus(xi)
            strain = strain - alloy.eps_l * (1.0 - xi) + alloy.eps_l
            strain = strain + f.creep * (len(t) + np.linspace(0.0, 1.0, points))
            strain = strain + f.slip * (np.arange(points) > 0.5 * points) * (len(t) == 0)
            read = kelvin + f.zero - sign * f.lag
            t.append(read + f.noise * random.standard_normal(points) + differs)
            eps.append(strain / f.gauge + 3e-5 * random.standard_normal(points))
    kelvin, strain = np.concatenate(t), np.minimum(np.concatenate(eps), f.top)
    if f.stuck:
        at = len(strain) // 3
        strain[at : at + points // 3] = strain[at]
    held = np.full(len(strain), stress * f.area)
    if f.swapped:
        strain, held = held / 1e6 + 0.01 * random.standard_normal(len(held)), strain * 1e6
    return kelvin, strain, held


def isobaric(alloy: Alloy, stress: float, random, *, area=1.0, **faults) -> IsobaricRecord:
    kelvin, strain, held = loops(alloy, stress, random, area=area, **faults)
    name = f"{stress * area / 1e6:.0f} MPa"
    cycles, remarks = find_cycles(kelvin, strain, held, name)
    path, median = Path(f"{name}.txt"), float(np.median(held))
    return IsobaricRecord(path, name, median, "1", tuple(cycles), tuple(remarks))


def tensile(alloy: Alloy, phase: str, number: int, random, *, said: str | None = None,
            **faults: float) -> TensileRecord:
    """E7: one test; `said`: the phase that its file states."""
    f = faulty("tensile", faults)
    cold = phase == "martensite"
    modulus, kelvin = (alloy.e_m, 293.15) if cold else (alloy.e_a, 403.15)
    plateau, level, after = (0.04, 130e6, 0.6e9) if cold else (0.07, 500e6, 1e9)
    fine = np.linspace(0.0, f.end, 8000)
    first = level / modulus
    stress = np.where(fine < first, modulus * fine, level + after * (fine - first))
    last = level + after * (plateau - first)
    stress = np.where(fine > plateau, last + modulus * (fine - plateau), stress)
    stress = stress - 0.7 * np.maximum(stress - f.yielding, 0.0)
    width = 60
    padded = np.pad(stress, width, mode="reflect", reflect_type="odd")
    stress = np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    travel = fine + f.compliance * stress
    at_slip = 0.5 * (last + stress[-1]) if cold else 0.5 * level
    travel = travel + f.slip * (stress > at_slip)
    strain = np.linspace(0.0, float(travel[-1]) + f.toe, f.points)
    read = np.interp(np.maximum(strain - f.toe, 0.0), travel, stress)
    read = np.minimum(read + f.noise * random.standard_normal(f.points), f.force_top)
    path, phase = Path(f"{phase}_{number}.csv"), said or phase
    return TensileRecord(path, strain / f.gauge, read / f.area, kelvin, phase=phase)


def clamped(alloy: Alloy, random, up=(298.0, 322.0), **faults: float) -> Record:
    """E8: a staircase of temperatures `up` and down below A_s, under tension."""
    f = faulty("clamped", faults)
    hold, room, diameter = 20.0, 296.0, 0.3e-3
    levels = np.linspace(*up, 7)
    steps = np.concatenate([levels, levels[-2::-1]])
    time = np.arange(0.0, hold * len(steps), 0.05)
    place = np.clip((time / hold).astype(int), 0, len(steps) - 1)
    before = np.concatenate([[steps[0]], steps[:-1]])[place]
    kelvin = steps[place] + (before - steps[place]) * np.exp(-(time - place * hold) / 2.0)
    warmer = kelvin - steps[0]
    stress = f.preload + alloy.theta * warmer - f.clamps * alloy.e_m * warmer
    stress = stress + 10e6 * np.maximum(kelvin - f.above, 0.0) - f.creep * time
    force = np.maximum(stress, 0.0) * math.pi * diameter**2 / 4.0 * f.area
    force = f.force_gain * force + f.force_drift * time / time[-1]
    force = force + 0.02 * random.standard_normal(len(time))
    seen = room + f.camera * (kelvin - room) + f.noise * random.standard_normal(len(time))
    if f.stuck:
        force[len(force) // 4 :] = force[len(force) // 4]
    force, stamps = -force if f.turned else force, time + 0.01 + f.late
    force_read = Signal("force", "N", stamps, force)
    temperature = Signal("wire.temperature", "K", time, seen)
    return Record(Path("clamped"), 0, {s.name: s for s in (force_read, temperature)})
