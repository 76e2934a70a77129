"""Bending: the corrected equations against first principles, the printed ones beside them."""

from dataclasses import replace

import numpy as np
import pytest
from effect_references import FOUR
from scipy.integrate import trapezoid

from sma_bench.parameters import Parameters
from sma_bench.physics import bending
from sma_bench.physics.bending import Beam

LAYER = {"layer_thickness": 0.4e-3, "layer_modulus": 22.8e9, "layer_width": 0.4e-3}
SILICONE = {"length": 0.12, "width": 0.03, "thickness": 6e-3, "modulus": 1.2e6}
BEAM = Beam(**SILICONE, **LAYER, offset=3e-3, wire_section=7e-8)


def integrated_stiffness(beam: Beam) -> float:
    """EI of the two layers about their neutral axis, by quadrature."""
    points, weights = np.polynomial.legendre.leggauss(8)

    def integral(function):
        total = 0.0
        matrix = (0.0, beam.thickness, beam.modulus, beam.width)
        layer = (beam.thickness, beam.layer_thickness, beam.layer_modulus, beam.layer_width)
        for base, height, modulus, width in (matrix, layer):
            y = base + 0.5 * height * (points + 1.0)
            total += modulus * width * 0.5 * height * np.sum(weights * function(y))
        return total

    neutral = integral(lambda y: y) / integral(np.ones_like)
    return integral(lambda y: (y - neutral) ** 2)


@pytest.mark.parametrize("modulus", [1e5, 1.2e6, 1e9, 22.8e9])
@pytest.mark.parametrize("layer_thickness", [1e-6, 0.4e-3, 6e-3])
def test_stiffness_is_the_integral_over_both_layers(modulus, layer_thickness):
    beam = replace(BEAM, modulus=modulus, layer_thickness=layer_thickness)
    assert bending.bending_stiffness(beam) == pytest.approx(integrated_stiffness(beam), rel=1e-12)


def test_printed_stiffness_is_not_the_integral():
    printed = bending.bending_stiffness_as_printed(BEAM)
    # The width is missing at the leading term, 12 at E h: by hand from the printed line.
    heights = 4 * 6e-3**2 + 6 * 6e-3 * 0.4e-3 + 4 * 0.4e-3**2
    numerator = 0.03 * 1.2e6**2 * 6e-3**4 + 0.4e-3**4 * 22.8e9**2
    numerator += 1.2e6 * 22.8e9 * 6e-3 * 0.4e-3 * heights
    assert printed == pytest.approx(numerator / (12 * 1.2e6 * 6e-3 + 22.8e9 * 0.4e-3))
    assert printed / integrated_stiffness(BEAM) > 100.0


def test_curvature_is_that_of_a_layer_which_shrinks_on_its_matrix():
    """Equilibrium of forces and moments of the two layers, solved without eq. (16)."""
    strain, b = 0.01, BEAM
    own = (b.modulus * b.thickness * b.width, b.layer_modulus * b.layer_thickness * b.layer_width)
    stiff = np.array(own)
    height = np.array([b.thickness, b.layer_thickness])
    centre = np.array([0.5 * b.thickness, b.thickness + 0.5 * b.layer_thickness])
    # Unknown: strain at y = 0 and curvature; the layer carries E (eps + kappa y - strain).
    first, second = (stiff * centre).sum(), (stiff * (centre**2 + height**2 / 12.0)).sum()
    matrix = np.array([[stiff.sum(), first], [first, second]])
    load = np.array([stiff[1] * strain, stiff[1] * strain * centre[1]])
    _, kappa = np.linalg.solve(matrix, load)
    assert bending.curvature(strain, BEAM) == pytest.approx(kappa, rel=1e-9)


def test_deflection_is_the_curvature_integrated_twice():
    x = np.linspace(0.0, BEAM.length, 20001)
    slope = bending.curvature(0.01, BEAM) * x
    assert bending.deflection(0.01, BEAM) == pytest.approx(trapezoid(slope, x))
    sheet = replace(BEAM, layer_width=BEAM.width)
    printed = bending.deflection_as_printed(0.01, BEAM)
    assert printed == pytest.approx(2.0 * bending.deflection(0.01, sheet), rel=1e-12)


def test_the_active_layer_is_as_wide_as_its_wires_and_not_as_the_beam():
    """Four wires, two a side: alpha 1.714 m; the printed single width makes them a 30 mm sheet."""
    rig = Parameters.of_paper().replace(FOUR)
    assert bending.wire_layer_width(rig) == pytest.approx(2 * np.pi * 0.3e-3 / 4)
    assert bending.bending_coefficients(rig)[0] == pytest.approx(1.714, abs=5e-4)
    printed = bending.deflection_per_strain(bending.as_printed(Beam.of(rig)))
    assert printed == pytest.approx(1.0557, abs=1e-4)
    sheet = rig.replace({"composite.wire_layer_width": 0.03})
    assert bending.bending_coefficients(sheet)[0] == pytest.approx(1.0557, abs=1e-4)
    pairs = rig.replace({"wire.count": 2})
    assert bending.wire_layer_width(pairs) == 2.0 * bending.wire_layer_width(rig)
