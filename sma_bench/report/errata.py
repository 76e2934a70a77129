"""The paper's errata: printed and corrected forms side by side, with numbers and figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np

from sma_bench.border import load_yaml
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters, audit
from sma_bench.parameters.table import (
    DSC_CYCLES,
    HOLDING_FORCE,
    THERMAL_EXPANSION,
    UPFR_FINISH,
    UPFR_START,
)
from sma_bench.physics import bending, material
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection
from sma_bench.report.page import Section, Table

# --- One slip of the paper: printed and corrected form, with numbers.

_HEADER = ("", "as printed", "corrected", "independent check")

Line = tuple[str, str, str, str]


@cache
def _texts() -> dict[int, dict[str, str]]:
    text = resources.files("sma_bench.report").joinpath("errata.yaml").read_text("utf-8")
    found: dict[int, dict[str, str]] = load_yaml(text)
    return found


@dataclass(frozen=True)
class Erratum:
    """One item.

    Attributes:
        number: 1 to 19; place: in the paper.
        printed, corrected: the forms, in words or as a formula.
        lines: (quantity, printed, corrected, check) with units, ready to read.
        remark: what follows.
    """

    number: int
    place: str
    printed: str
    corrected: str
    lines: tuple[Line, ...]
    remark: str

    def section(self) -> Section:
        """For a report."""
        table = Table(_HEADER, [("form", self.printed, self.corrected, ""), *self.lines])
        title = f"Erratum {self.number}: {self.place}"
        return Section(title, tables=[table], notes=[self.remark])


def _erratum(number: int, *lines: Line, **facts: object) -> Erratum:
    """The item of errata.yaml with its numbers; facts stand in its remark."""
    text = {**_texts()[number]}
    text["remark"] = text["remark"].format(**facts)
    return Erratum(number=number, lines=lines, **text)


def line(
    quantity: str, unit: str, printed: float, corrected: float, check: float | None = None,
    how: str = "",
) -> Line:
    """Numbers of one quantity; `check` comes from elsewhere, `how` says from where."""
    first, second, third = (
        "" if value is None else f"{value:.5g} {unit}".rstrip()
        for value in (printed, corrected, check)
    )
    return quantity, first, second, third and f"{third}, {how}"


# --- Errata 1 to 6: equations that are printed wrong, evaluated in both forms.

_EPSILON = 1e-6


def stiffness(beam: Beam) -> Erratum:
    """Item 1: EI."""
    millimetres = replace(
        beam, length=1e3 * beam.length, width=1e3 * beam.width, thickness=1e3 * beam.thickness,
        modulus=1e-6 * beam.modulus, layer_thickness=1e3 * beam.layer_thickness,
        layer_modulus=1e-6 * beam.layer_modulus, layer_width=1e3 * beam.layer_width,
        offset=1e3 * beam.offset,
    )
    # EI of two layers about their common neutral axis, from first principles.
    layers = (
        (beam.width * beam.modulus, beam.thickness, 0.5 * beam.thickness),
        (beam.layer_width * beam.layer_modulus, beam.layer_thickness,
         beam.thickness + 0.5 * beam.layer_thickness),
    )
    neutral = sum(e * h * z for e, h, z in layers) / sum(e * h for e, h, _ in layers)
    parallel = sum(e * (h**3 / 12.0 + h * (z - neutral) ** 2) for e, h, z in layers)
    return _erratum(1, *(
        line(f"EI, {what}", "N m²", factor * bending.bending_stiffness_as_printed(b),
             factor * bending.bending_stiffness(b), parallel, "parallel axes")
        for what, factor, b in (
            ("computed in m and Pa", 1.0, beam), ("computed in mm and MPa", 1e-6, millimetres),
        )
    ))


def deflection_of_strain(beam: Beam) -> Erratum:
    """Item 2: the factor of eq. (17)."""
    strain = 0.01
    x = np.linspace(0.0, beam.length, 2001)
    slope = bending.curvature(strain, beam) * x
    integral = float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))
    return _erratum(2, line(
        "δ at ε = 1 %", "m", bending.deflection_as_printed(strain, beam),
        bending.deflection(strain, beam), integral, "eq. (16) integrated twice",
    ))


def signs(point: OperatingPoint) -> Erratum:
    """Item 3: the strain is a contraction."""
    parameters = point.parameters
    alpha, beta = linear.alpha(parameters), linear.beta(parameters)
    modulus = float(linear.a1(point.martensite_fraction[0], parameters))
    wires = 2

    def pull(deflection: float) -> float:
        """beta delta less what the wires of the side give, at the point's temperature, xi."""
        sigma = material.stress(
            point.temperature[:wires], point.martensite_fraction[:wires], deflection / alpha,
            parameters,
        )
        return beta * deflection - float(sigma.sum())

    step = 1e-5
    numerical = (pull(point.deflection + step) - pull(point.deflection - step)) / (2.0 * step)
    return _erratum(
        3, line("strain at δ = 10 mm", "", 0.01 / alpha, -0.01 / alpha),
        line("stiffness, β - E/α against β + ΣE/α", "Pa/m", beta - modulus / alpha,
             beta + wires * modulus / alpha, numerical, "nonlinear model"),
    )


def constitutive(point: OperatingPoint) -> Erratum:
    """Item 4: a_2 and a_3."""
    parameters, xi = point.parameters, float(point.martensite_fraction[0])
    kelvin, contraction = float(point.temperature[0]), float(point.contraction[0])
    strain = -contraction
    pull = -parameters["wire.maximum_recoverable_strain"] * parameters["wire.austenite_modulus"]

    def sigma(fraction: float) -> float:
        return float(material.stress(kelvin, fraction, contraction, parameters))

    def by_equation(a2: float, a3: float, fraction: float) -> float:
        elastic = float(linear.a1(xi, parameters)) * strain
        thermal = float(material.clamped_stress(kelvin, parameters))
        transformed = pull * (fraction - linear.FRACTION_AT_REST) + a2 * fraction + a3
        return elastic + thermal + transformed

    printed = (float(linear.a2_as_printed(xi, strain, parameters)),
               float(linear.a3_as_printed(xi, strain, parameters)))
    corrected = (float(linear.a2(xi, strain, parameters)),
                 float(linear.a3(xi, strain, parameters)))
    slope = (sigma(xi + _EPSILON) - sigma(xi - _EPSILON)) / (2.0 * _EPSILON)
    return _erratum(
        4, line("a_2", "Pa", printed[0], corrected[0]),
        line("a_3", "Pa", printed[1], corrected[1]),
        line("∂σ/∂ξ = -ε_L E_A + a_2", "Pa", pull + printed[0], pull + corrected[0], slope,
             "difference quotient of eq. (6)"),
        *(
            line(f"σ at ξ* - {away:g}", "Pa", by_equation(*printed, xi - away),
                 by_equation(*corrected, xi - away), sigma(xi - away), "eq. (6)")
            for away in (0.0, 0.02)
        ),
    )


def heating(point: OperatingPoint) -> Erratum:
    """Item 5: the linearised heating."""
    volt, ohm = float(point.voltage[0]), point.parameters["wire.resistance"]
    quotient = ((volt + _EPSILON) ** 2 - (volt - _EPSILON) ** 2) / (2.0 * _EPSILON * ohm)
    return _erratum(
        5,
        line(f"heating at V = V* = {volt:.3f} V", "W",
             float(linear.linear_heating_as_printed(volt, volt, ohm)),
             float(linear.linear_heating(volt, volt, ohm)), volt**2 / ohm, "V²/R"),
        line("heating per volt", "W/V", -2.0 * volt / ohm, 2.0 * volt / ohm, quotient,
             "difference quotient of V²/R"),
    )


def kinetics(point: OperatingPoint) -> Erratum:
    """Item 6: the linearised kinetics."""
    parameters = point.parameters
    kelvin, sigma = float(point.temperature[0]), float(point.stress[0])
    cold = 0.5 * (parameters["wire.martensite_start_temperature"]
                  + parameters["wire.martensite_finish_temperature"])
    lines: list[Line] = []
    for name, ramp, at, printed, corrected, of_stress in (
        ("eq. (20), heating", material.heated_fraction, (kelvin, sigma), linear.b1_as_printed,
         linear.b1, linear.b1_of_stress),
        ("eq. (21), cooling", material.cooled_fraction, (cold, 0.0), linear.b3_as_printed,
         linear.b3, linear.b3_of_stress),
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
    return _erratum(6, *lines)


# --- Errata 7 to 11: numbers and words that do not fit, as the audit finds them.

def order(finding: Finding) -> Erratum:
    """Item 7: the order of the transition temperatures."""
    lines = tuple(
        (f"M_s - A_s, heat cycle {number}", "below 0 K", f"{cycle['M_s'] - cycle['A_s']:+.2f} K",
         "Table II")
        for number, cycle in enumerate(DSC_CYCLES, start=1)
    )
    return _erratum(7, *lines, audit=finding.text)


def lengths(length: Finding, resistivity: Finding) -> Erratum:
    """Item 8: two lengths of one wire."""
    by_mass, by_area = (length.numbers[f"length_from_{what}"] for what in ("mass", "area"))
    rho = [resistivity.numbers[f"resistivity_from_{what}_length"] * 1e8
           for what in ("area", "mass")]
    h = length.numbers["heat_transfer_coefficient_for_length_from_mass"]
    return _erratum(
        8,
        ("length of the wire", f"{by_area:.3f} m from A_c", f"{by_mass:.3f} m from m",
         "6450 kg/m³, 0.3 mm"),
        ("resistivity", f"{rho[0]:.0f} µΩ cm with A_c", f"{rho[1]:.0f} µΩ cm with m",
         "NiTi: 70 to 110 µΩ cm"),
        ("h", "403.26 W/(m² K)", f"{h:.0f} W/(m² K) over 0.2 m", "h A_c is what is measured"),
        audit=length.text,
    )


def convection(heat: Finding, time: Finding) -> Erratum:
    """Item 9: a heat transfer coefficient that still air does not give."""
    low, high = heat.numbers["still_air_low"], heat.numbers["still_air_high"]
    short, long = time.numbers["still_air_low"], time.numbers["still_air_high"]
    return _erratum(
        9,
        ("h", "403.26 W/(m² K)", f"{low:.0f} to {high:.0f} W/(m² K)",
         "Churchill-Chu and radiation"),
        ("time constant m c_p/(h A_c)", f"{time.numbers['time_constant']:.3f} s",
         f"{short:.2f} to {long:.2f} s", "same correlation"),
        audit=heat.text,
    )


def expansion(paper: Parameters) -> Erratum:
    """Item 10: Theta_T."""
    printed = paper.replace({"wire.thermal_expansion_factor": THERMAL_EXPANSION})
    finding = next(f for f in audit(printed) if f.subject == "thermal expansion")
    low, high = finding.numbers["alpha_E_low"], finding.numbers["alpha_E_high"]
    return _erratum(
        10,
        ("Θ_T", f"+{THERMAL_EXPANSION / 1e6:.2f} MPa/K, if so",
         f"-{low / 1e6:.2f} to -{high / 1e6:.2f} MPa/K", "-α E of martensite and of austenite"),
        ("stress after 30 K below A_s", f"{30.0 * THERMAL_EXPANSION / 1e6:+.0f} MPa",
         f"{-30.0 * low / 1e6:+.1f} MPa", "eq. (8)"),
        audit=finding.text,
    )


# --- Errata 12 to 19: loads, agreements and laws that do not hold as they are said.

_CURRENT_RANGE, _VOLTAGE_RANGE = 3.0, 10.0  # A, V, section IV
_PRINTED_STRESS = 13e6  # Pa, section III.B.1


def holding_stress(paper: Parameters) -> Erratum:
    """Item 12: the stress of E6."""
    diameter = paper["wire.diameter"]
    needed = float(np.sqrt(4.0 * HOLDING_FORCE / (np.pi * _PRINTED_STRESS)))
    angles = np.linspace(0.0, 2.0 * np.pi, 20001)
    x, y = 0.5 * diameter * np.cos(angles), 0.5 * diameter * np.sin(angles)
    shoelace = 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    return _erratum(
        12,
        line("σ under 1 N", "Pa", _PRINTED_STRESS, HOLDING_FORCE / bending.wire_section(paper),
             HOLDING_FORCE / shoelace, "area of a polygon of 20000 sides"),
        ("diameter", f"{1e3 * needed:.3f} mm, if 13 MPa", f"{1e3 * diameter:.3f} mm", ""),
    )


def agreement() -> Erratum:
    """Item 13: E6 against the DSC."""
    lines = tuple(
        (
            f"{symbol} of the UPFR less that of the DSC, cycle {number}", '"good agreement"',
            f"{mean - cycle[symbol]:+.2f} K",
            f"{(mean - cycle[symbol]) / std:+.1f} deviations of the UPFR's repeats",
        )
        for symbol, (mean, std) in (("A_s", UPFR_START), ("A_f", UPFR_FINISH))
        for number, cycle in enumerate(DSC_CYCLES, start=1)
    )
    return _erratum(13, *lines)


def omitted_stress(paper: Parameters) -> Erratum:
    """Item 15: constant load."""
    sigma = 100e6
    middles = []
    for held in (0.0, sigma):
        kelvin = np.linspace(300.0, 400.0, 100001)
        xi = material.heated_fraction(kelvin, held, paper)
        middles.append(float(np.interp(0.5, xi[::-1], kelvin[::-1])))
    return _erratum(15, line(
        "shift of A_s and A_f at 100 MPa", "K", 0.0,
        sigma / paper["wire.stress_influence_austenite"], middles[1] - middles[0],
        "eq. (10) at ξ = 1/2 with and without",
    ))


def current_range(paper: Parameters) -> Erratum:
    """Item 16: volts and amperes of the supply."""
    ohm = paper["wire.resistance"]
    return _erratum(
        16,
        line("current at 10 V", "A", _CURRENT_RANGE, _VOLTAGE_RANGE / ohm,
             float(np.sqrt(_VOLTAGE_RANGE**2 / ohm / ohm)), "√(P/R) of its heat"),
        line("largest voltage", "V", _VOLTAGE_RANGE, _CURRENT_RANGE * ohm),
    )


def stressed_reference(paper: Parameters) -> Erratum:
    """Item 17: eq. (6) from a reference that carries stress."""
    strain_limit = paper["wire.maximum_recoverable_strain"]
    kelvin = 340.0
    first, second = (0.6, 0.02), (0.2, 0.03)  # xi, contraction: reference and state

    def from_rest(xi: float, contraction: float) -> float:
        return float(material.stress(kelvin, xi, contraction, paper))

    def e(xi: float) -> float:
        return float(material.modulus(xi, paper))

    (xi_0, c_0), (xi, c) = first, second
    begun = from_rest(*first)
    printed = begun + e(xi) * (c_0 - c) - strain_limit * e(xi) * (xi - xi_0)
    # eps and xi count from rest, where the wire is martensite: eps_L (xi - 1) of its length.
    missing = (e(xi) - e(xi_0)) * (-c_0 - strain_limit * (xi_0 - 1.0))
    return _erratum(17, line(
        "σ at ξ = 0.2, ε = -3 %, from the state ξ_0 = 0.6, ε_0 = -2 %", "Pa", printed,
        printed + missing, from_rest(*second), "from the stress-free reference at once",
    ))


def partial_loops(paper: Parameters) -> Erratum:
    """Item 18: eqs. (10), (11) without the initial fractions."""
    a_s, a_f = (paper[f"wire.austenite_{end}_temperature"] for end in ("start", "finish"))
    m_s, m_f = (paper[f"wire.martensite_{end}_temperature"] for end in ("start", "finish"))
    turned, later = 0.5 * (a_s + a_f), 0.5 * (a_s + a_f) - 10.0

    def austenite(kelvin: float) -> float:
        return 0.5 - 0.5 * float(np.cos(np.pi * (kelvin - m_f) / (m_s - m_f)))

    def ramps(kelvin: float) -> tuple[float, float]:
        return (float(material.austenite_ramp(kelvin, 0.0, paper)),
                float(material.martensite_ramp(kelvin, 0.0, paper)))

    def corrected(kelvin: float) -> float:
        return material.fraction_since_reversal(False, 0.5, ramps(turned), ramps(kelvin))

    return _erratum(
        18,
        line("ξ as the wire, half transformed, turns to cooling", "", 1.0 - austenite(turned),
             corrected(turned), 0.5, "what it was a moment before"),
        line("ξ 10 K further down", "", 1.0 - austenite(later), corrected(later),
             1.0 - 0.5 * austenite(later) / austenite(turned),
             "eq. (11) in proportion to what was left"),
    )


def geometry(rig: Parameters) -> Erratum:
    """Item 19: widths, neutral axis, and a stiffness that counts twice."""
    beam = Beam.of(rig)
    wires = sum(side == "front" for side in rig["bench.channel_sides"])
    layer = beam.layer_width
    sheet = _two_layers(beam, beam.width, 1.0)
    real = _two_layers(beam, layer, 1.0)
    stiff = wires * rig["wire.austenite_modulus"] / sheet[1]
    beta, strain = bending.stress_per_deflection(bending.as_printed(beam)), 0.01
    coupled = strain * sheet[1] * stiff / (beta + stiff)
    layers = (
        (beam.modulus * beam.width * beam.thickness, 0.5 * beam.thickness),
        (beam.layer_modulus * beam.width * beam.layer_thickness,
         beam.thickness + 0.5 * beam.layer_thickness),
    )
    neutral = sum(e * z for e, z in layers) / sum(e for e, _ in layers)
    return _erratum(
        19,
        line("width of the SMA layer", "mm", 1e3 * beam.width, 1e3 * layer,
             1e3 * wires * np.pi * (0.5 * rig["wire.diameter"]) ** 2 / beam.layer_thickness,
             "wires times section over thickness"),
        line("δ per strain, α", "m", sheet[1], real[1], _by_energy(beam, layer),
             "least elastic energy"),
        line("neutral axis above the middle of the matrix, one width", "mm", 0.0,
             1e3 * (sheet[0] - 0.5 * beam.thickness),
             1e3 * (neutral - 0.5 * beam.thickness), "parallel axes"),
        line("δ at a free strain of 1 %", "m", coupled, strain * sheet[1],
             strain * _by_energy(beam, beam.width), "least elastic energy, one width"),
        low=1e3 * beam.thickness, high=1e3 * (beam.thickness + beam.layer_thickness),
        twice=1.0 - coupled / (strain * sheet[1]),
    )


def _two_layers(beam: Beam, layer_width: float, strain: float) -> tuple[float, float]:
    """Height of the neutral axis above the bottom and deflection, both m, of the matrix with a
    layer that shrinks by `strain` freely: equilibrium of force and moment."""
    parts = (
        (beam.modulus * beam.width, 0.0, beam.thickness, 0.0),
        (beam.layer_modulus * layer_width, beam.thickness,
         beam.thickness + beam.layer_thickness, strain),
    )
    system, load = np.zeros((2, 2)), np.zeros(2)
    for stiff, low, high, free in parts:
        area, first, second = (stiff * (high**k - low**k) / k for k in (1, 2, 3))
        system += [[area, first], [first, second]]
        load -= free * np.array([area, first])
    _, bent = np.linalg.solve(system, load)
    return float(system[0, 1] / system[0, 0]), float(-0.5 * bent * beam.length**2)


def _by_energy(beam: Beam, layer_width: float) -> float:
    """alpha [m]: layers of one curvature and of strains that differ by the curvature times their
    distance; the energy is least."""
    matrix = beam.modulus * beam.width * beam.thickness
    wires = beam.layer_modulus * layer_width * beam.layer_thickness
    own = (
        beam.modulus * beam.width * beam.thickness**3
        + beam.layer_modulus * layer_width * beam.layer_thickness**3
    ) / 12.0
    apart = 0.5 * (beam.thickness + beam.layer_thickness)
    series = matrix * wires / (matrix + wires)
    return 0.5 * beam.length**2 * series * apart / (own + series * apart**2)


# --- The paper's errata: printed and corrected forms side by side, with numbers where there are
# any.
#
# Geometry, C_A and C_M are not in the paper; the defaults of the parameter table, marked
# assumed there, stand in. All other numbers are the paper's own.

_RIG = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}


def paper_errata() -> list[Erratum]:
    """All items, evaluated with the paper's numbers."""
    paper = Parameters.defaults()
    rig = paper.replace(_RIG)
    point = OperatingPoint.at_deflection(rig, 0.5 * maximum_deflection(rig), "heating")
    beam = Beam.of(rig)
    findings = {finding.subject: finding for finding in audit(paper)}
    return [
        stiffness(beam),
        deflection_of_strain(beam),
        signs(point),
        constitutive(point),
        heating(point),
        kinetics(point),
        order(findings["transition order"]),
        lengths(findings["wire length"], findings["resistivity"]),
        convection(findings["heat transfer"], findings["time constant"]),
        expansion(paper),
        _erratum(11),
        holding_stress(paper),
        agreement(),
        _erratum(
            14,
            ("h_c of eq. (5)", "h_c", "h, W/(m² K)", "(5) is (2) over m: the same coefficient"),
            ("h_c of eqs. (14) to (17), (22)", "h_c", "h_c, m", "thickness of the matrix"),
        ),
        omitted_stress(paper),
        current_range(paper),
        stressed_reference(paper),
        partial_loops(paper),
        geometry(rig),
    ]


def errata_sections(errata: Sequence[Erratum]) -> list[Section]:
    """For a report: one section each, after a word on what they are."""
    head = Section(
        "Errata",
        ["Where the paper is wrong, and what the package computes instead. Printed forms stay "
         "callable (functions named as_printed) and are evaluated here with the paper's numbers; "
         "geometry, C_A and C_M, which it does not give, are assumed (docs/parameters.md)."],
    )
    return [head, *(erratum.section() for erratum in errata)]
