"""Errata 7 to 11: numbers and words that do not fit, as the audit finds them."""

from sma_bench.findings import Finding
from sma_bench.parameters import Parameters, audit
from sma_bench.parameters.paper_numbers import DSC_CYCLES, THERMAL_EXPANSION
from sma_bench.report.erratum import Erratum


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
