"""Synthetic tensile tests at constant temperature (E7, Fig. 9).

Austenite follows the package's own law: under load the range of eq. (11) rises until the wire
turns to martensite, eps = sigma/E(xi) + eps_L xi. Martensite is a test curve, not a model:
the paper's law starts from detwinned martensite and knows no detwinning, so the curve is an elastic
rise E_M, a plateau up to 4 % of strain as Fig. 9 is described, and a rise E_M again, its corners
rounded. Both begin with a toe, as a specimen that is not quite straight gives.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.paper_numbers import DETWINNED_AT
from sma_bench.physics.phase import cooled_fraction
from sma_bench.physics.stress import modulus
from sma_bench.records.tensile import TensileRecord

Array = NDArray[np.float64]

_DETWINNING_STRESS = 130e6  # Pa, assumed: 100 to 200 MPa on NiTi
_DETWINNING_SLOPE = 0.6e9  # Pa, assumed
_LARGEST_STRAIN = 0.06
_TOE = 0.0015
_ROUNDING = 0.0008
_NOISE = 0.6e6  # Pa, 0.04 N of a 500 N load cell on a 0.3 mm wire
_POINTS = 1500


def tensile_test(parameters: Parameters, temperature: float, name: str, seed: int) -> TensileRecord:
    """One test of the wire of `parameters`: martensite below M_f, austenite above A_f.

    Args:
        temperature: K.
        name: of the specimen.
    """
    strain = np.linspace(0.0, _LARGEST_STRAIN, _POINTS)
    cold = temperature <= parameters["wire.martensite_finish_temperature"]
    curve = _martensite(parameters) if cold else _austenite(parameters, temperature)
    stress = np.interp(np.maximum(strain - _TOE, 0.0), *_rounded(*curve))
    noise = _NOISE * np.random.default_rng(seed).standard_normal(_POINTS)
    return TensileRecord(Path(name), strain, stress + noise, temperature)


def _austenite(parameters: Parameters, temperature: float) -> tuple[Array, Array]:
    """Strain and stress (Pa) of eqs. (6), (7), (9), (11) loaded from austenite."""
    stress = np.linspace(0.0, 2e9, 20001)
    xi = cooled_fraction(temperature, stress, parameters)
    transformed = parameters["wire.maximum_recoverable_strain"] * xi
    return stress / modulus(xi, parameters) + transformed, stress


def _martensite(parameters: Parameters) -> tuple[Array, Array]:
    e_m = parameters["wire.martensite_modulus"]
    begins = _DETWINNING_STRESS / e_m
    ends = _DETWINNING_STRESS + _DETWINNING_SLOPE * (DETWINNED_AT - begins)
    last = 2.0 * _LARGEST_STRAIN
    strain = np.array([0.0, begins, DETWINNED_AT, last])
    stress = np.array([0.0, _DETWINNING_STRESS, ends, ends + e_m * (last - DETWINNED_AT)])
    return strain, stress


def _rounded(strain: Array, stress: Array) -> tuple[Array, Array]:
    """The curve with its corners rounded by a moving mean over `_ROUNDING`."""
    fine = np.linspace(0.0, 1.5 * _LARGEST_STRAIN, 20001)
    width = int(_ROUNDING / (fine[1] - fine[0]))
    padded = np.pad(np.interp(fine, strain, stress), width, mode="reflect", reflect_type="odd")
    window = np.ones(2 * width + 1) / (2 * width + 1)
    return fine, np.convolve(padded, window, mode="valid")
