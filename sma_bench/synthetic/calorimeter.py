"""Synthetic DSC run: what the model's wire would do to a calorimeter (E5, Fig. 7).

Heat into the sample is m (c_p dT/dt - L dxi/dt), eq. (1) with xi of eqs. (10), (11) at no stress.
The instrument adds a start-up transient, a baseline that drifts, and noise. Thermal lag is left
out, so that the onsets are those of the material.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.physics.phase import cooled_fraction, heated_fraction
from sma_bench.records.dsc import DscRecord, DscSegment

Array = NDArray[np.float64]

COLDEST, HOTTEST = 273.15, 453.15  # K, section III.B.1
RATE = 5.0 / 60.0  # K/s, section III.B.1
SAMPLE_MASS = 8e-6  # kg, assumed: a few millimetres of wire
LATENT_HEAT = 20e3  # J/kg, assumed: NiTi has 10 to 25 kJ/kg
_PERIOD = 0.5  # s
_NOISE = 0.2e-6  # W, sensitivity of the Q2000
_DRIFT = (25e-6, 12e-6)  # W, linear and quadratic over a scan
_START_UP = 12.0  # s


def dsc_run(cycles: Sequence[Parameters], seed: int = 1) -> DscRecord:
    """One heating and one cooling for each cycle, with that cycle's transition temperatures."""
    random = np.random.default_rng(seed)
    segments: list[DscSegment] = []
    for parameters in cycles:
        for sign in (1.0, -1.0):
            segments.append(_scan(parameters, sign, len(segments) + 1, random))
    header = {"Sample ID": "synthetic NiTi wire"}
    path = Path(f"synthetic DSC run of {len(cycles)} cycles")
    return DscRecord(path, SAMPLE_MASS, header, tuple(segments), instrument="synthetic")


def _scan(
    parameters: Parameters, sign: float, number: int, random: np.random.Generator
) -> DscSegment:
    time = np.arange(0.0, (HOTTEST - COLDEST) / RATE, _PERIOD)
    temperature = (COLDEST if sign > 0.0 else HOTTEST) + sign * RATE * time
    fraction = heated_fraction if sign > 0.0 else cooled_fraction
    xi = fraction(temperature, 0.0, parameters)
    settled = sign * RATE * (1.0 - np.exp(-time / _START_UP))
    heat = SAMPLE_MASS * (
        parameters["wire.specific_heat"] * settled - LATENT_HEAT * np.gradient(xi, time)
    )
    share = (temperature - COLDEST) / (HOTTEST - COLDEST)
    drift = _DRIFT[0] * share + _DRIFT[1] * share**2
    noise = _NOISE * random.standard_normal(len(time))
    began = (number - 1) * (HOTTEST - COLDEST) / RATE
    return DscSegment(
        number, "heating" if sign > 0.0 else "cooling", sign * RATE, began + time,
        heat + drift + noise, np.zeros(len(time)), temperature, temperature,
    )
