"""Synthetic isobaric tests: the simulated wire heated and cooled while a load is held (E6, Fig. 8).

The frame keeps the force and records the travel; the wire is led through a triangle of temperature
that is slow against its time constant. Not a measurement: the model behind instruments.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.paper_numbers import HOLDING_FORCE
from sma_bench.physics import Boundary, simulate
from sma_bench.physics.bending import wire_section
from sma_bench.physics.heat import heat_loss
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.thermal_cycles import find_cycles

Array = NDArray[np.float64]

_RATE = 0.5  # K/s
_ABOVE_FINISH = 25.0  # K
_PERIOD = 0.2  # s
_TEMPERATURE_NOISE = 0.05  # K, a thermocouple in a chamber
_STRAIN_NOISE = 2e-5  # 4 micrometres of traverse on 0.2 m of wire
# Of a cosine ramp the steepest tangent takes 2/pi of its width.
_COSINE_WIDTH = 0.5 * math.pi


def isobaric_test(
    parameters: Parameters, stress: float, name: str, seed: int = 1
) -> IsobaricRecord:
    """One heating and cooling of the wire of `parameters` under a held stress [Pa]."""
    random = np.random.default_rng(seed)
    shift = stress / parameters["wire.stress_influence_austenite"]
    hottest = parameters["wire.austenite_finish_temperature"] + shift + _ABOVE_FINISH
    time, voltage = _triangle(parameters, hottest)
    run = simulate(parameters, time, voltage, boundary=Boundary.held_stress(stress))
    strain = -run.contraction[:, 0] + _STRAIN_NOISE * random.standard_normal(len(time))
    temperature = run.temperature[:, 0] + _TEMPERATURE_NOISE * random.standard_normal(len(time))
    held = np.full(len(time), stress)
    cycles, findings = find_cycles(temperature, strain, held, name)
    return IsobaricRecord(Path(name), name, stress, "1", cycles, tuple(findings))


def upfr_tests(
    parameters: Parameters,
    start: Sequence[float],
    finish: Sequence[float],
) -> tuple[IsobaricRecord, ...]:
    """Repeats of a UPFR test on specimens whose tangents meet at given temperatures.

    Args:
        parameters: the wire; A_s and A_f are replaced for each specimen.
        start, finish: K under the holding force, one a specimen, as tangents tell them. The
            cosine of eq. (10) with these tangents reaches further out at both ends.
    """
    stress = HOLDING_FORCE / wire_section(parameters)
    shift = stress / parameters["wire.stress_influence_austenite"]
    tests = []
    for k, (a_s, a_f) in enumerate(zip(start, finish, strict=True)):
        middle, half = 0.5 * (a_s + a_f) - shift, 0.5 * (a_f - a_s) * _COSINE_WIDTH
        specimen = parameters.replace(
            {
                "wire.austenite_start_temperature": middle - half,
                "wire.austenite_finish_temperature": middle + half,
            }
        )
        tests.append(isobaric_test(specimen, stress, f"synthetic UPFR test {k + 1}", seed=k))
    return tuple(tests)


def _triangle(parameters: Parameters, hottest: float) -> tuple[Array, Array]:
    """Time (n,) s and the voltage (n,) V that eq. (2) asks for a triangle of temperature."""
    ambient = parameters["environment.ambient_temperature"]
    rise = (hottest - ambient) / _RATE
    time = np.arange(0.0, 2.0 * rise, _PERIOD)
    above = _RATE * np.minimum(time, 2.0 * rise - time)
    rate = np.where(time < rise, _RATE, -_RATE)
    capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    power = np.maximum(heat_loss(parameters) * above + capacity * rate, 0.0)
    return time, np.sqrt(power * parameters["wire.resistance"])
