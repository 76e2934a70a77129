"""The rig and the drives on which the reality is tested."""

import numpy as np
import pytest
from numpy.typing import NDArray

from sma_bench import compiled
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

needs_numba = pytest.mark.skipif(compiled.numba is None, reason="slow without numba")

CHANNELS = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}

# Numbers of a believable composite: wire in silicone, transformation 307 to 353 K, 1.7 s slow.
COMPOSITE = Parameters(
    {
        **CHANNELS,
        "wire.resistance": 3.05138,
        "wire.heat_transfer_coefficient": 115.772,
        "wire.specific_heat": 416.626,
        "wire.mass": 9.1e-05,
        "wire.surface_area": 0.0001885,
        "wire.austenite_start_temperature": 334.001,
        "wire.austenite_finish_temperature": 353.2866,
        "wire.martensite_start_temperature": 319.834,
        "wire.martensite_finish_temperature": 307.5032,
        "wire.martensite_modulus": 21.6498e9,
        "wire.austenite_modulus": 56.5743e9,
        "wire.maximum_recoverable_strain": 0.038434,
        "wire.thermal_expansion_factor": -122509.3,
        "wire.stress_influence_austenite": 7.29789e6,
        "wire.stress_influence_martensite": 8.00789e6,
        "environment.ambient_temperature": 293.4596,
        "composite.deflection_per_strain": 1.011392,
        "composite.stress_per_deflection_front": 4.89955e9,
        "composite.stress_per_deflection_back": 4.89955e9,
    }
)

# The paper's own wire: M_s lies above A_s, so the two ranges overlap.
PAPER = Parameters(
    {
        **CHANNELS,
        "composite.deflection_per_strain": 1.0,
        "composite.stress_per_deflection_front": 5.0e9,
        "composite.stress_per_deflection_back": 4.0e9,
    }
)

RIGS = {"composite": (COMPOSITE, 1.0), "paper": (PAPER, 2.3)}  # and what its voltages are times

# Corner times [s] and volts of a side; the nested ones turn back within a transformation.
CORNERS = {
    "triangles": (
        [(1, 0), (8, 2.6), (15, 0), (26, 0), (31, 2.3), (36, 0)],
        [(13, 0), (19, 2.5), (25, 0)],
    ),
    "steps": (
        [(1, 0), (1.02, 2.3), (9, 2.3), (9.02, 0), (24, 0), (24.02, 1.85), (31, 1.85), (31.02, 0)],
        [(12, 0), (12.02, 2.2), (20, 2.2), (20.02, 0)],
    ),
    "nested": (
        [(1, 0), (8, 2.5), (13, 1.25), (18, 1.95), (23, 1.3), (28, 2.4), (34, 0)],
        [(20, 0), (26, 2.3), (30, 1.2), (34, 2.35), (38, 0)],
    ),
}
DRIVES = tuple(CORNERS)


def drive(name: str, duration: float = 40.0, scale: float = 1.0) -> tuple[Array, Array]:
    """Time (n,) s every 20 ms and voltage (n, 4)."""
    time = np.arange(0.0, duration, 0.02)
    front, back = (
        np.interp(time, [t for t, _ in corners], [v for _, v in corners], left=0.0, right=0.0)
        for corners in CORNERS[name]
    )
    return time, scale * np.column_stack([front, front, back, back])
