"""A bench drawn at random within believable ranges, and what its lab knows of it beforehand."""

import math
from dataclasses import dataclass

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import NITI_DENSITY
from sma_bench.parameters.table import EXACT_SENSORS

CHANNELS = ("front_1", "front_2", "back_1", "back_2")
SIDES = ("front", "front", "back", "back")
IDENTIFIED = (
    "wire.resistance",
    "wire.heat_transfer_coefficient",
    "wire.specific_heat",
    "wire.austenite_start_temperature",
    "wire.austenite_finish_temperature",
    "wire.martensite_start_temperature",
    "wire.martensite_finish_temperature",
    "wire.martensite_modulus",
    "wire.austenite_modulus",
    "wire.maximum_recoverable_strain",
    "wire.thermal_expansion_factor",
    "wire.stress_influence_austenite",
    "wire.stress_influence_martensite",
    "environment.ambient_temperature",
    "composite.deflection_per_strain",
    "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
)
EXACT = ("wire.mass", "wire.surface_area", "wire.diameter")
# What a lab knows from data sheets: relative where a number of the contract is a product of many.
_RELATIVE_STD = {
    "wire.resistance": 0.03,
    "wire.heat_transfer_coefficient": 0.15,
    "wire.specific_heat": 0.10,
    "wire.martensite_modulus": 0.10,
    "wire.austenite_modulus": 0.10,
    "wire.maximum_recoverable_strain": 0.08,
    "wire.stress_influence_austenite": 0.15,
    "wire.stress_influence_martensite": 0.15,
    "composite.deflection_per_strain": 0.10,
    "composite.stress_per_deflection_front": 0.15,
    "composite.stress_per_deflection_back": 0.15,
}
_ABSOLUTE_STD = {
    "wire.austenite_start_temperature": 3.0,
    "wire.austenite_finish_temperature": 3.0,
    "wire.martensite_start_temperature": 3.0,
    "wire.martensite_finish_temperature": 3.0,
    "wire.thermal_expansion_factor": 0.05e6,
    "environment.ambient_temperature": 0.5,
}
_FARTHEST = 2.5
_COLDEST_FINISH = 10.0


@dataclass(frozen=True)
class DrawnBench:
    """`truth` simulates the bench, `known` is the parameter file of its lab."""

    truth: Parameters
    known: Parameters


def draw_bench(random: np.random.Generator) -> DrawnBench:
    """One bench: its true parameters, and nominal ones that are off by their stated errors."""
    values = {**_wire(random), **_composite(random)}
    values["environment.ambient_temperature"] = random.uniform(291.0, 299.0)
    values.update(_transitions(random, values["environment.ambient_temperature"]))
    rig = {"bench.channels": CHANNELS, "bench.channel_sides": SIDES}
    truth = Parameters({**values, **rig})
    # The simulated instruments have noise and steps, but no scale of their own.
    exact = dict.fromkeys(EXACT, 0.0) | EXACT_SENSORS
    std = {name: _std(name, truth) for name in IDENTIFIED} | exact
    while True:
        nominal = {
            name: truth[name] + std[name] * _within(random, _FARTHEST) for name in IDENTIFIED
        }
        if _ordered(nominal):
            break
    return DrawnBench(truth, truth.replace(nominal, std))


def _std(name: str, truth: Parameters) -> float:
    if name in _ABSOLUTE_STD:
        return _ABSOLUTE_STD[name]
    return _RELATIVE_STD[name] * float(truth[name])


def _within(random: np.random.Generator, farthest: float) -> float:
    while True:
        deviation = float(random.standard_normal())
        if abs(deviation) < farthest:
            return deviation


def _ordered(values: dict[str, float]) -> bool:
    austenite = values["wire.austenite_finish_temperature"] - values[
        "wire.austenite_start_temperature"
    ]
    martensite = values["wire.martensite_start_temperature"] - values[
        "wire.martensite_finish_temperature"
    ]
    return min(austenite, martensite) > 1.0


def _wire(random: np.random.Generator) -> dict[str, float]:
    diameter, length = random.uniform(0.2e-3, 0.3e-3), random.uniform(0.15, 0.25)
    section = math.pi * diameter**2 / 4.0
    soft = random.uniform(18e9, 35e9)
    return {
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
    }


def _transitions(random: np.random.Generator, ambient: float) -> dict[str, float]:
    """Every order of the ranges that is seen on NiTi, M_s above A_s as in the paper included."""
    while True:
        a_s = random.uniform(322.0, 345.0)
        a_f = a_s + random.uniform(10.0, 25.0)
        m_s = a_s + random.uniform(-18.0, 6.0)
        m_f = m_s - random.uniform(10.0, 25.0)
        if m_f > ambient + _COLDEST_FINISH and m_s < a_f - 2.0:
            return {
                "wire.austenite_start_temperature": a_s,
                "wire.austenite_finish_temperature": a_f,
                "wire.martensite_start_temperature": m_s,
                "wire.martensite_finish_temperature": m_f,
            }


def _composite(random: np.random.Generator) -> dict[str, float]:
    return {
        "composite.deflection_per_strain": random.uniform(0.6, 1.3),
        "composite.stress_per_deflection_front": random.uniform(2e9, 6e9),
        "composite.stress_per_deflection_back": random.uniform(2e9, 6e9),
    }
