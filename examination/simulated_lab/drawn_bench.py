"""A bench drawn at random within believable ranges, and what its lab knows of it beforehand."""

import math
from dataclasses import dataclass

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import NITI_DENSITY
from sma_bench.parameters.table import EXACT_SENSORS

RIG = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}
# What a lab knows from data sheets: relative where a number of the contract is a product of many,
# else in its unit.
RELATIVE, ABSOLUTE = True, False
ERRORS = {
    "wire.resistance": (0.03, RELATIVE),
    "wire.heat_transfer_coefficient": (0.15, RELATIVE),
    "wire.specific_heat": (0.10, RELATIVE),
    "wire.austenite_start_temperature": (3.0, ABSOLUTE),
    "wire.austenite_finish_temperature": (3.0, ABSOLUTE),
    "wire.martensite_start_temperature": (3.0, ABSOLUTE),
    "wire.martensite_finish_temperature": (3.0, ABSOLUTE),
    "wire.martensite_modulus": (0.10, RELATIVE),
    "wire.austenite_modulus": (0.10, RELATIVE),
    "wire.maximum_recoverable_strain": (0.08, RELATIVE),
    "wire.thermal_expansion_factor": (0.05e6, ABSOLUTE),
    "wire.stress_influence_austenite": (0.15, RELATIVE),
    "wire.stress_influence_martensite": (0.15, RELATIVE),
    "environment.ambient_temperature": (0.5, ABSOLUTE),
    "composite.deflection_per_strain": (0.10, RELATIVE),
    "composite.stress_per_deflection_front": (0.15, RELATIVE),
    "composite.stress_per_deflection_back": (0.15, RELATIVE),
}
IDENTIFIED = tuple(ERRORS)
EXACT = ("wire.mass", "wire.surface_area", "wire.diameter")
_FARTHEST = 2.5  # stated errors


@dataclass(frozen=True)
class DrawnBench:
    """`truth` simulates the bench, `known` is the parameter file of its lab."""

    truth: Parameters
    known: Parameters


def draw_bench(random: np.random.Generator) -> DrawnBench:
    """One bench: its true parameters, and nominal ones that are off by their stated errors."""
    truth = Parameters(_numbers(random) | RIG)
    # The simulated instruments have noise and steps, but no scale of their own.
    std = {n: size * float(truth[n]) if of else size for n, (size, of) in ERRORS.items()}
    while True:
        nominal = {name: truth[name] + std[name] * _within(random) for name in IDENTIFIED}
        a_s, a_f, m_s, m_f = (nominal[name] for name in IDENTIFIED[3:7])
        if min(a_f - a_s, m_s - m_f) > 1.0:
            exact = dict.fromkeys(EXACT, 0.0) | EXACT_SENSORS
            return DrawnBench(truth, truth.replace(nominal, std | exact))


def _within(random: np.random.Generator) -> float:
    while True:
        deviation = float(random.standard_normal())
        if abs(deviation) < _FARTHEST:
            return deviation


def _numbers(random: np.random.Generator) -> dict[str, float]:
    diameter, length = random.uniform(0.2e-3, 0.3e-3), random.uniform(0.15, 0.25)
    section = math.pi * diameter**2 / 4.0
    soft = random.uniform(18e9, 35e9)
    drawn = {
        "wire.diameter": diameter,
        "wire.mass": NITI_DENSITY * section * length,
        "wire.surface_area": math.pi * diameter * length,
        "wire.resistance": random.uniform(75e-8, 100e-8) * length / section,
        "wire.heat_transfer_coefficient": random.uniform(90.0, 200.0),
        "wire.specific_heat": random.uniform(350.0, 550.0),
        "wire.martensite_modulus": soft,
        "wire.austenite_modulus": random.uniform(45e9, 80e9),
        "wire.maximum_recoverable_strain": random.uniform(0.03, 0.05),
        "wire.thermal_expansion_factor": -random.uniform(6e-6, 9e-6) * soft,
        "wire.stress_influence_austenite": random.uniform(5e6, 9e6),
        "wire.stress_influence_martensite": random.uniform(5e6, 9e6),
        "composite.deflection_per_strain": random.uniform(0.6, 1.3),
        "composite.stress_per_deflection_front": random.uniform(2e9, 6e9),
        "composite.stress_per_deflection_back": random.uniform(2e9, 6e9),
        "environment.ambient_temperature": random.uniform(291.0, 299.0),
    }
    # Every order of the ranges that is seen on NiTi, M_s above A_s as in the paper included.
    while True:
        a_s = random.uniform(322.0, 345.0)
        a_f = a_s + random.uniform(10.0, 25.0)
        m_s = a_s + random.uniform(-18.0, 6.0)
        m_f = m_s - random.uniform(10.0, 25.0)
        if m_f > drawn["environment.ambient_temperature"] + 10.0 and m_s < a_f - 2.0:
            return drawn | dict(zip(IDENTIFIED[3:7], (a_s, a_f, m_s, m_f), strict=True))
