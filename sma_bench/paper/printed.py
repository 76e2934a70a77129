"""Wrong equations as the paper prints them, and the coefficients of eqs. (18) to (23), printed and
corrected, linearised from rest (sigma_0 = 0, xi_0 = 1, T_0 = T_inf) about a point *:

    sigma = E(xi)(eps - eps_0) + Theta_T (T - T_0) - eps_L E(xi)(xi - xi_0)           (6), (7), (9)
    dsigma/deps = E(xi*) = a_1,    dsigma/dT = Theta_T,    dsigma/dxi = -eps_L E_A + a_2,

so that a_2 = (E_M - E_A) [eps_L (xi_0 - 2 xi*) + eps* - eps_0], and a_3 makes the line pass through
the point. xi = b_1 (T* - T + (sigma - sigma*)/C_A) + b_2 is eq. (10) to first order, eq. (21)
likewise with C_M."""

import math
from dataclasses import replace
from typing import NamedTuple

from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import bending, kernel, material
from sma_bench.physics.bending import Beam
from sma_bench.physics.boundary import side_of_channels
from sma_bench.physics.linearised import OperatingPoint, linearise
from sma_bench.physics.material import heated_resistance


def as_printed(beam: Beam) -> Beam:
    """The beam of eqs. (14) to (17) as printed: one width, as if its wires were a sheet."""
    return replace(beam, layer_width=beam.width)


def bending_stiffness_as_printed(beam: Beam) -> float:
    """EI as printed below eq. (14): the width at the first term only, 12 at E_c h_c only."""
    matrix, layer = beam.modulus * beam.thickness, beam.layer_modulus * beam.layer_thickness
    return bending.stiffness_terms(beam, beam.width) / (12.0 * matrix + layer)


def deflection_as_printed(strain: float, beam: Beam) -> float:
    """Deflection [m] as eq. (17) is printed: twice the integral of eq. (16), with one width."""
    return beam.length**2 * bending.curvature(strain, as_printed(beam))


class Coefficient(NamedTuple):
    """A row of `coefficient_table`: printed and corrected values."""

    name: str
    equation: str
    unit: str
    printed: float
    corrected: float
    remark: str


def coefficient_table(point: OperatingPoint, wire: int = 0) -> list[Coefficient]:
    """Every coefficient of eqs. (18) to (23) for one wire at a point."""
    parameters, number = point.parameters, int(side_of_channels(point.parameters)[wire])
    of_wires = (point.temperature, point.stress, point.martensite_fraction, point.voltage)
    kelvin, sigma, xi, volt = (float(values[wire]) for values in of_wires)
    stretch = float(point.boundary.stretch_of_wires(parameters)[wire])
    strain = stretch - float(point.contraction[number])
    # Eq. (18), of the constitutive law: the sign of eps* - eps_0 is flipped.
    change = parameters["wire.martensite_modulus"] - parameters["wire.austenite_modulus"]
    limit = parameters["wire.maximum_recoverable_strain"]
    modulus = float(material.modulus(xi, parameters))
    a2 = [change * (limit * (1.0 - 2.0 * xi) + sign * strain) for sign in (-1, 1)]
    a3 = [change * xi * (limit * xi + sign * strain) for sign in (1, -1)]
    # Eq. (19), heating V^2/R: as printed it cools and adds a number to a voltage. The corrected one
    # is that of the drive: for a duty, V V_supply/R.
    ohm = heated_resistance(parameters)
    heat = float(material.heating_voltage(volt, parameters)) ** 2 / ohm
    per_volt = float(material.power_per_volt(volt, parameters))
    drive = "" if parameters["bench.drive"] != "duty" else ", and a duty heats by V V_supply/R"
    # Eqs. (20), (21), of the kinetics: as printed [1], corrected for K [1/K] and for Pa [1/Pa].
    kinetics = []
    laws = {"austenite": kernel.heated_fraction, "martensite": kernel.cooled_fraction}
    for phase, law in laws.items():
        share = float(law(kelvin, sigma, parameters))
        slope = math.sqrt(share * (1.0 - share))  # sin(x)/2 where the ramp is (1 +- cos x)/2
        ends = [parameters[f"wire.{phase}_{end}_temperature"] for end in ("start", "finish")]
        per_kelvin = math.pi / abs(ends[1] - ends[0]) * slope
        per_pascal = per_kelvin / parameters[f"wire.stress_influence_{phase}"]
        kinetics.append((slope, per_kelvin, per_pascal, share))
    (b1, b1_kelvin, b1_pascal, b2), (b3, b3_kelvin, b3_pascal, b4) = kinetics
    sign = "sign of eps* - eps_0"
    rows = [
        ("a_1", "(18)", "Pa", modulus, modulus, "right"),
        ("a_2", "(18)", "Pa", *a2, sign),
        ("a_3", "(18)", "Pa", *a3, sign),
        ("heating at V*", "(19)", "W", -volt / ohm * (1.0 + 2.0 * volt), heat,
         f"+(V*/R)(2V - V*), not -(V*/R)(1 + 2V){drive}"),
        ("heating per volt", "(19)", "W/V", -2.0 * volt / ohm, per_volt, f"sign{drive}"),
        ("b_1", "(20)", "1/K", b1, b1_kelvin, "factor pi/(A_f - A_s)"),
        ("b_1 of stress", "(20)", "1/Pa", b1, b1_pascal, "sigma needs 1/C_A"),
        ("b_2", "(20)", "1", b2, b2, "right"),
        ("b_3", "(21)", "1/K", b3, b3_kelvin, "factor pi/(M_s - M_f)"),
        ("b_3 of stress", "(21)", "1/Pa", b3, b3_pascal, "sigma needs 1/C_M"),
        ("b_4", "(21)", "1", b4, b4, "right"),
    ]
    # Eqs. (22), (23), of a beam, and the gain of all equations together, for one wire.
    if point.boundary.contraction is None and load_kind(parameters) == "beam":
        alpha, *betas = bending.bending_coefficients(parameters)
        beta = betas[parameters["bench.channel_sides"][wire] == "back"]
        beam = Beam.of(parameters)
        alpha_printed, ei = deflection_as_printed(1.0, beam), bending_stiffness_as_printed(beam)
        beta_printed = 2.0 * ei / (beam.offset * beam.wire_section * beam.length**2)
        together = int((side_of_channels(parameters) == number).sum())
        # beta delta = a_1 delta/alpha + Theta T + pull xi,  xi = rate (-T + beta delta)
        pull = a2[0] - limit * parameters["wire.austenite_modulus"]
        rate = b1 if point.branch == "heating" else b3
        stiffness = beta_printed - modulus / alpha_printed
        gain = parameters["wire.thermal_expansion_factor"] - pull * rate
        gain /= stiffness - pull * rate * beta_printed
        rows += [
            ("alpha", "(22)", "m", alpha_printed, alpha,
             "3 l^2/h_c, not 6: eq. (16) integrated twice"),
            ("strain per deflection", "(22)", "1/m", 1.0 / alpha_printed, -1.0 / alpha,
             "the strain is a contraction"),
            ("beta", "(23)", "Pa/m", beta_printed, beta, "EI of eq. (14): width and brackets"),
            ("stiffness", "(22), (23)", "Pa/m", stiffness,
             beta + together * modulus / alpha, "beta + sum E/alpha, not beta - E/alpha"),
            ("deflection per kelvin", "(18)-(23)", "m/K", gain,
             abs(float(linearise(point).deflection_per_kelvin[wire])),
             "all of the above; magnitude, one wire"),
        ]
    return [Coefficient(*row) for row in rows]
