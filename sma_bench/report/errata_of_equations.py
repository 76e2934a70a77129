"""Errata 1 to 6: equations that are printed wrong, evaluated in both forms."""

from dataclasses import replace

import numpy as np

from sma_bench.physics import bending, phase, stress
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.physics.operating_point import OperatingPoint
from sma_bench.report.erratum import Erratum, Line, line

_EPSILON = 1e-6


def stiffness(beam: Beam) -> Erratum:
    """Item 1: EI."""
    millimetres = replace(
        beam, length=1e3 * beam.length, width=1e3 * beam.width, thickness=1e3 * beam.thickness,
        modulus=1e-6 * beam.modulus, layer_thickness=1e3 * beam.layer_thickness,
        layer_modulus=1e-6 * beam.layer_modulus, offset=1e3 * beam.offset,
    )
    lines = tuple(
        line(f"EI, {what}", "N m²", factor * bending.bending_stiffness_as_printed(b),
              factor * bending.bending_stiffness(b), _parallel_axes(beam), "parallel axes")
        for what, factor, b in (
            ("computed in m and Pa", 1.0, beam), ("computed in mm and MPa", 1e-6, millimetres),
        )
    )
    return Erratum(
        1, "EI below eq. (14)",
        "[w_c E_c² h_c⁴ + E_c E h_c h (4h_c² + 6h_c h + 4h²) + h⁴E²] / 12 E_c h_c + E h",
        "w_c [E_c² h_c⁴ + E_c E h_c h (4h_c² + 6h_c h + 4h²) + E² h⁴] / [12 (E_c h_c + E h)]",
        lines,
        "The width belongs to every term and 12 to the whole denominator. As printed the "
        "dimensions disagree, so the result depends on the units it is computed in.",
    )


def _parallel_axes(beam: Beam) -> float:
    """EI of two layers about their common neutral axis, from first principles."""
    layers = (
        (beam.modulus, beam.thickness, 0.5 * beam.thickness),
        (beam.layer_modulus, beam.layer_thickness, beam.thickness + 0.5 * beam.layer_thickness),
    )
    tension = sum(e * h for e, h, _ in layers)
    neutral = sum(e * h * z for e, h, z in layers) / tension
    each = (e * (h**3 / 12.0 + h * (z - neutral) ** 2) for e, h, z in layers)
    return beam.width * sum(each)


def deflection_of_strain(beam: Beam) -> Erratum:
    """Item 2: the factor of eq. (17)."""
    strain = 0.01
    x = np.linspace(0.0, beam.length, 2001)
    slope = bending.curvature(strain, beam) * x
    integral = float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))
    return Erratum(
        2, "eq. (17)", "δ = 6 ε l²/h_c · ...", "δ = κ l²/2 = 3 ε l²/h_c · ...",
        (line("δ at ε = 1 %", "m", bending.deflection_as_printed(strain, beam),
               bending.deflection(strain, beam), integral, "eq. (16) integrated twice"),),
        "The constant curvature of eq. (16) integrated twice gives half of what is printed. "
        "β of eq. (23) is consistent with the corrected form.",
    )


def signs(point: OperatingPoint) -> Erratum:
    """Item 3: the strain is a contraction."""
    parameters = point.parameters
    alpha, beta = linear.alpha(parameters), linear.beta(parameters)
    modulus = float(linear.a1(point.martensite_fraction[0], parameters))
    wires = 2

    def pull(deflection: float) -> float:
        """beta delta less what the wires of the side give, at the point's temperature, xi."""
        sigma = stress.stress(
            point.temperature[:wires], point.martensite_fraction[:wires], deflection / alpha,
            parameters,
        )
        return beta * deflection - float(sigma.sum())

    step = 1e-5
    numerical = (pull(point.deflection + step) - pull(point.deflection - step)) / (2.0 * step)
    return Erratum(
        3, "eqs. (22), (23)", "ε = +δ/α, σ = βδ", "ε - ε_0 = -δ/α, Σσ = βδ",
        (
            line("strain at δ = 10 mm", "", 0.01 / alpha, -0.01 / alpha),
            line("stiffness, β - E/α against β + ΣE/α", "Pa/m", beta - modulus / alpha,
                  beta + wires * modulus / alpha, numerical, "nonlinear model"),
        ),
        "The strain is a contraction. With both signs positive the coupled model has a negative "
        "stiffness.",
    )


def constitutive(point: OperatingPoint) -> Erratum:
    """Item 4: a_2 and a_3."""
    parameters, xi = point.parameters, float(point.martensite_fraction[0])
    kelvin, contraction = float(point.temperature[0]), float(point.contraction[0])
    strain = -contraction
    pull = -parameters["wire.maximum_recoverable_strain"] * parameters["wire.austenite_modulus"]

    def sigma(fraction: float) -> float:
        return float(stress.stress(kelvin, fraction, contraction, parameters))

    def by_equation(a2: float, a3: float, fraction: float) -> float:
        elastic = float(linear.a1(xi, parameters)) * strain
        thermal = float(stress.clamped_stress(kelvin, parameters))
        transformed = pull * (fraction - linear.FRACTION_AT_REST) + a2 * fraction + a3
        return elastic + thermal + transformed

    printed = (float(linear.a2_as_printed(xi, strain, parameters)),
               float(linear.a3_as_printed(xi, strain, parameters)))
    corrected = (float(linear.a2(xi, strain, parameters)),
                 float(linear.a3(xi, strain, parameters)))
    slope = (sigma(xi + _EPSILON) - sigma(xi - _EPSILON)) / (2.0 * _EPSILON)
    return Erratum(
        4, "eq. (18)",
        "a_2 = (E_M - E_A)[ε_L(ξ_0 - 2ξ*) - ε* + ε_0]; a_3 = (E_M - E_A)[ε_L ξ*² + (ε* - ε_0)ξ*]",
        "a_2 = (E_M - E_A)[ε_L(ξ_0 - 2ξ*) + ε* - ε_0]; a_3 = (E_M - E_A) ξ* [ε_L ξ* - (ε* - ε_0)]",
        (
            line("a_2", "Pa", printed[0], corrected[0]),
            line("a_3", "Pa", printed[1], corrected[1]),
            line("∂σ/∂ξ = -ε_L E_A + a_2", "Pa", pull + printed[0], pull + corrected[0], slope,
                  "difference quotient of eq. (6)"),
            *(
                line(f"σ at ξ* - {away:g}", "Pa", by_equation(*printed, xi - away),
                      by_equation(*corrected, xi - away), sigma(xi - away), "eq. (6)")
                for away in (0.0, 0.02)
            ),
        ),
        "The signs of (ε* - ε_0) are flipped. At the operating point itself (half of the largest "
        "deflection) the two slips cancel; beside it they do not.",
    )


def heating(point: OperatingPoint) -> Erratum:
    """Item 5: the linearised heating."""
    volt, ohm = float(point.voltage[0]), point.parameters["wire.resistance"]
    quotient = ((volt + _EPSILON) ** 2 - (volt - _EPSILON) ** 2) / (2.0 * _EPSILON * ohm)
    return Erratum(
        5, "eq. (19)", "-(V*/R)(1 + 2V)", "+(V*/R)(2V - V*)",
        (
            line(f"heating at V = V* = {volt:.3f} V", "W",
                  float(linear.linear_heating_as_printed(volt, volt, ohm)),
                  float(linear.linear_heating(volt, volt, ohm)), volt**2 / ohm, "V²/R"),
            line("heating per volt", "W/V", -2.0 * volt / ohm, 2.0 * volt / ohm, quotient,
                  "difference quotient of V²/R"),
        ),
        "As printed the current cools the wire, and a number is added to a voltage.",
    )


def kinetics(point: OperatingPoint) -> Erratum:
    """Item 6: the linearised kinetics."""
    parameters = point.parameters
    kelvin, sigma = float(point.temperature[0]), float(point.stress[0])
    cold = 0.5 * (parameters["wire.martensite_start_temperature"]
                  + parameters["wire.martensite_finish_temperature"])
    lines: list[Line] = []
    for name, ramp, at, printed, corrected, of_stress in (
        ("eq. (20), heating", phase.heated_fraction, (kelvin, sigma), linear.b1_as_printed,
         linear.b1, linear.b1_of_stress),
        ("eq. (21), cooling", phase.cooled_fraction, (cold, 0.0), linear.b3_as_printed, linear.b3,
         linear.b3_of_stress),
    ):
        t, s = at
        by_t = (ramp(t + 1e-3, s, parameters) - ramp(t - 1e-3, s, parameters)) / 2e-3
        by_s = (ramp(t, s + 1e3, parameters) - ramp(t, s - 1e3, parameters)) / 2e3
        lines += [
            line(f"∂ξ/∂T, {name}", "1/K", -float(printed(t, s, parameters)),
                  -float(corrected(t, s, parameters)), float(by_t), "difference quotient"),
            line(f"∂ξ/∂σ, {name}", "1/Pa", float(printed(t, s, parameters)),
                  float(of_stress(t, s, parameters)), float(by_s), "difference quotient"),
        ]
    return Erratum(
        6, "eqs. (20), (21)", "b_1 = ½ sin[...], ξ = b_1 (T* - T + σ - σ*) + b_2; b_3 likewise",
        "b_1 = π/(2(A_f - A_s)) sin[...], ξ = b_1 (T* - T + (σ - σ*)/C_A) + b_2; b_3 with "
        "π/(M_s - M_f) and C_M",
        tuple(lines), "The factor of the chain rule is missing, and kelvins are added to pascals.",
    )
