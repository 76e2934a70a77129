"""The paper's errata: printed and corrected forms side by side, with numbers and figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.findings import Finding
from sma_bench.parameters import Parameters, audit
from sma_bench.parameters.table import DSC_CYCLES, THERMAL_EXPANSION
from sma_bench.physics import bending, phase, stress
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.bending import Beam
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture, Section, Table

# --- One slip of the paper: printed and corrected form, with numbers.

_HEADER = ("", "as printed", "corrected", "independent check")

Line = tuple[str, str, str, str]


@dataclass(frozen=True)
class Erratum:
    """One item.

    Attributes:
        number: 1 to 11; place: in the paper.
        printed, corrected: the forms, in words or as a formula.
        lines: (quantity, printed, corrected, check) with units, ready to read.
        remark: what follows.
    """

    number: int
    place: str
    printed: str
    corrected: str
    lines: tuple[Line, ...] = ()
    remark: str = ""

    def section(self) -> Section:
        """For a report."""
        table = Table(_HEADER, [("form", self.printed, self.corrected, ""), *self.lines])
        return Section(
            f"Erratum {self.number}: {self.place}", tables=[table],
            notes=[self.remark] if self.remark else [],
        )


def line(
    quantity: str, unit: str, printed: float, corrected: float, check: float | None = None,
    how: str = "",
) -> Line:
    """Numbers of one quantity; `check` comes from elsewhere, `how` says from where."""
    shown = "" if check is None else f"{check:.5g} {unit}, {how}"
    return quantity, f"{printed:.5g} {unit}", f"{corrected:.5g} {unit}", shown


# --- Errata 1 to 6: equations that are printed wrong, evaluated in both forms.

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


# --- Errata 7 to 11: numbers and words that do not fit, as the audit finds them.

def order(finding: Finding) -> Erratum:
    """Item 7: the order of the transition temperatures."""
    lines = tuple(
        (f"M_s - A_s, heat cycle {number}", "below 0 K", f"{cycle['M_s'] - cycle['A_s']:+.2f} K",
         "Table II")
        for number, cycle in enumerate(DSC_CYCLES, start=1)
    )
    return Erratum(
        7, "section III.B.1", "A_f > A_s > M_s > M_f", "M_s lies above A_s in both cycles",
        lines, f"Audit: {finding.text}.",
    )


def lengths(length: Finding, resistivity: Finding) -> Erratum:
    """Item 8: two lengths of one wire."""
    by_mass, by_area = (length.numbers[f"length_from_{what}"] for what in ("mass", "area"))
    rho = [resistivity.numbers[f"resistivity_from_{what}_length"] * 1e8
           for what in ("area", "mass")]
    h = length.numbers["heat_transfer_coefficient_for_length_from_mass"]
    return Erratum(
        8, "Table I", "m = 0.091 g, A_c = 395.84 mm², R = 2.6987 Ω of one wire",
        "m and R agree on 0.2 m of wire, A_c does not",
        (
            ("length of the wire", f"{by_area:.3f} m from A_c", f"{by_mass:.3f} m from m",
             "6450 kg/m³, 0.3 mm"),
            ("resistivity", f"{rho[0]:.0f} µΩ cm with A_c", f"{rho[1]:.0f} µΩ cm with m",
             "NiTi: 70 to 110 µΩ cm"),
            ("h", "403.26 W/(m² K)", f"{h:.0f} W/(m² K) over 0.2 m", "h A_c is what is measured"),
        ),
        f"Audit: {length.text}.",
    )


def convection(heat: Finding, time: Finding) -> Erratum:
    """Item 9: a heat transfer coefficient that still air does not give."""
    low, high = heat.numbers["still_air_low"], heat.numbers["still_air_high"]
    short, long = time.numbers["still_air_low"], time.numbers["still_air_high"]
    return Erratum(
        9, "h of Table I", "h = 403.26 W/(m² K)",
        "not explained by still air; measure anew with a camera whose spot fits the wire",
        (
            ("h", "403.26 W/(m² K)", f"{low:.0f} to {high:.0f} W/(m² K)",
             "Churchill-Chu and radiation"),
            ("time constant m c_p/(h A_c)", f"{time.numbers['time_constant']:.3f} s",
             f"{short:.2f} to {long:.2f} s", "same correlation"),
        ),
        f"Audit: {heat.text}.",
    )


def expansion(paper: Parameters) -> Erratum:
    """Item 10: Theta_T."""
    printed = paper.replace({"wire.thermal_expansion_factor": THERMAL_EXPANSION})
    finding = next(f for f in audit(printed) if f.subject == "thermal expansion")
    low, high = finding.numbers["alpha_E_low"], finding.numbers["alpha_E_high"]
    return Erratum(
        10, "section III.B.3", "Θ = 23.91 MPa", "Θ_T in MPa/K, negative, of the size of α E",
        (
            ("Θ_T", f"+{THERMAL_EXPANSION / 1e6:.2f} MPa/K, if so",
             f"-{low / 1e6:.2f} to -{high / 1e6:.2f} MPa/K",
             "-α E of martensite and of austenite"),
            ("stress after 30 K below A_s", f"{30.0 * THERMAL_EXPANSION / 1e6:+.0f} MPa",
             f"{-30.0 * low / 1e6:+.1f} MPa", "eq. (8)"),
        ),
        f"Audit: {finding.text}.",
    )


def purge_gas() -> Erratum:
    """Item 11."""
    return Erratum(
        11, "section III.B.1", '"nitrate as purge gas"', "nitrogen",
        remark="A nitrate is a salt; DSCs are purged with nitrogen.",
    )


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
        purge_gas(),
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


# --- What the slips of eqs. (17) and (20) do, drawn.

def errata_picture(parameters: Parameters | None = None) -> Picture:
    """Eq. (20) as a tangent of eq. (10), and eq. (17) against eq. (16) integrated twice."""
    paper = parameters or Parameters.defaults()
    figure, (kinetics, deflection) = new_figure(rows=2, height=6.4, shared=False)
    start = paper["wire.austenite_start_temperature"]
    finish = paper["wire.austenite_finish_temperature"]
    at, kelvin = 0.5 * (start + finish), np.linspace(start - 8.0, finish + 8.0, 400)
    here = float(phase.heated_fraction(at, 0.0, paper))
    kinetics.plot(
        kelvin, phase.heated_fraction(kelvin, 0.0, paper), color=MEASURED, lw=2, label="eq. (10)"
    )
    for slope, colour, label in (
        (linear.b1_as_printed, SECOND, "eq. (20) as printed"),
        (linear.b1, MODEL, "eq. (20) corrected"),
    ):
        line = here - float(slope(at, 0.0, paper)) * (kelvin - at)
        kinetics.plot(kelvin, line, "--", color=colour, label=label)
    kinetics.plot([at], [here], "o", color=FAINT, ms=5)
    kinetics.set(xlabel="temperature [K]", ylabel="martensite fraction ξ", ylim=(-0.15, 1.15))
    kinetics.legend(fontsize=8)
    beam = Beam.of(paper)
    strain = np.linspace(0.0, paper["wire.maximum_recoverable_strain"], 9)
    for law, style, colour, label in (
        (bending.deflection_as_printed, "--", SECOND, "eq. (17) as printed"),
        (bending.deflection, "-", MODEL, "eq. (17) corrected"),
    ):
        bent = [1e3 * law(float(e), beam) for e in strain]
        deflection.plot(100.0 * strain, bent, style, color=colour, label=label)
    twice = [1e3 * _integrated_twice(float(e), beam) for e in strain]
    deflection.plot(
        100.0 * strain, twice, "o", mfc="none", color=MEASURED, label="eq. (16) integrated twice"
    )
    deflection.set(xlabel="contraction of the active layer [%]", ylabel="deflection [mm]")
    deflection.legend(fontsize=8)
    caption = (
        "Errata 6 and 2: the tangent that eq. (20) is meant to be, at no stress and half of the "
        "transformation; and eq. (17). Data: none, evaluated from the equations with Table II and "
        "an assumed geometry."
    )
    return Picture("errata", "Two of the errata", caption, figure)


def _integrated_twice(strain: float, beam: Beam) -> float:
    x = np.linspace(0.0, beam.length, 401)
    slope = bending.curvature(strain, beam) * x
    return float(np.sum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x)))
