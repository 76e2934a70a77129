"""The paper's errata: printed and corrected forms side by side, with numbers where there are any.

Words, and where the numbers stand in them, are in errata.yaml. Geometry, C_A and C_M are not in the
paper; the parameter table's defaults, marked assumed there, stand in. All others are the paper's.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from sma_bench.border import read_yaml
from sma_bench.findings import Finding
from sma_bench.paper import printed as paper
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import audit
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.physics import bending, kernel, material
from sma_bench.physics.bending import Beam
from sma_bench.physics.boundary import Boundary
from sma_bench.physics.linearised import OperatingPoint, maximum_deflection
from sma_bench.physics.simulate import TemperatureDriven
from sma_bench.synthetic import paper_specimens as specimens

HEADER = ("", "as printed", "corrected", "independent check")
_STRAIN = 0.01  # at which laws of the beam are compared
# Section III.B.3, printed as "23.91 MPa" [Pa/K if "/K" is what is missing].
_THERMAL_EXPANSION = 23.91e6
_PRINTED_STRESS = 13e6  # Pa, section III.B.1
_CURRENT_RANGE, _VOLTAGE_RANGE = 3.0, 10.0  # A, V, section IV
Facts = dict[int, dict[str, object]]
"""numbers by the number of the erratum and a name of errata.yaml; "check" in it: from elsewhere"""


@dataclass(frozen=True)
class Erratum:
    """One item."""

    number: int  # 1 to 19
    place: str  # in the paper
    printed: str  # the form, in words or as a formula
    corrected: str
    # quantity, printed, corrected and independently checked value with units, ready to read
    lines: tuple[tuple[str, ...], ...]
    remark: str  # what follows


def paper_errata() -> list[Erratum]:
    """All items, evaluated with the paper's numbers."""
    numbers = Parameters.defaults()
    rig = numbers.replace(specimens.COMPOSITE)
    point = OperatingPoint.at_deflection(rig, 0.5 * maximum_deflection(rig), "heating")
    # The printed thermal expansion is not the table's default.
    printed = {"wire.thermal_expansion_factor": _THERMAL_EXPANSION}
    audited = {finding.subject: finding for finding in audit(numbers.replace(printed))}
    facts: Facts = _beam(Beam.of(rig)) | _linearised(point) | _audited(audited)
    facts |= _loads(numbers) | _history(numbers) | {19: _layers(rig)}
    errata = []
    for number, said in read_yaml(Path(__file__).with_name("errata.yaml")).items():
        own = facts.get(number, {})
        lines = [tuple(cell.format(**own) for cell in line) for line in said.get("lines", ())]
        form = (said["place"], said["printed"], said["corrected"])
        errata.append(Erratum(number, *form, tuple(lines), said["remark"].format(**own)))
    return errata


# --- Equations that are printed wrong, evaluated in both forms.


def _beam(beam: Beam) -> Facts:
    """1 and 2, of eqs. (14) and (17)."""
    lengths = ("length", "width", "thickness", "layer_thickness", "layer_width", "offset")
    units = {**dict.fromkeys(lengths, 1e3), "modulus": 1e-6, "layer_modulus": 1e-6}
    millimetres = replace(beam, **{n: unit * getattr(beam, n) for n, unit in units.items()})
    # EI of two layers about their common neutral axis, from first principles.
    passive, active = beam.thickness, beam.layer_thickness
    layers = ((beam.width * beam.modulus, passive, 0.5 * passive),
              (beam.layer_width * beam.layer_modulus, active, passive + 0.5 * active))
    neutral = sum(e * h * z for e, h, z in layers) / sum(e * h for e, h, _ in layers)
    parallel = sum(e * (h**3 / 12.0 + h * (z - neutral) ** 2) for e, h, z in layers)
    x = np.linspace(0.0, beam.length, 2001)
    stiffnesses: dict[str, object] = {"check": parallel}
    for form, law in (("printed", paper.bending_stiffness_as_printed),
                      ("corrected", bending.bending_stiffness)):
        stiffnesses |= {form: law(beam), f"{form}_mm": 1e-6 * law(millimetres)}
    return {1: stiffnesses, 2: {"printed": paper.deflection_as_printed(_STRAIN, beam),
                                "corrected": bending.deflection(_STRAIN, beam),
                                "check": trapezoid(bending.curvature(_STRAIN, beam) * x, x)}}


def _linearised(point: OperatingPoint) -> Facts:
    """3 to 6, of eqs. (18) to (23), against difference quotients of the laws themselves."""
    parameters, small = point.parameters, 1e-6
    table = {row.name: row for row in paper.coefficient_table(point)}
    of_wires = (point.temperature, point.stress, point.voltage, point.martensite_fraction)
    kelvin, sigma, volt, xi = (float(values[0]) for values in of_wires)
    contraction, modulus = float(point.contraction[0]), table["a_1"].corrected
    # 3, the strain is a contraction: beta delta less what the two wires of the side give.
    alpha, beta, _ = bending.bending_coefficients(parameters)
    ends, two = point.deflection + np.array([1e-5, -1e-5]), (of_wires[0][:2], of_wires[3][:2])
    pull = [material.stress(*two, end / alpha, parameters).sum() for end in ends]
    found: Facts = {3: {
        "strain": 0.01 / alpha, "check": np.subtract(*(beta * ends - pull)) / np.ptp(ends),
        "printed": beta - modulus / alpha, "corrected": beta + 2.0 * modulus / alpha,
    }}  # fmt: skip
    # 4, a_2 and a_3 of the constitutive law, and the line that they make, at the point and off it.
    tension = -parameters["wire.maximum_recoverable_strain"] * parameters["wire.austenite_modulus"]
    thermal = float(material.clamped_stress(kelvin, parameters))
    a2, a3 = table["a_2"], table["a_3"]

    def law(fraction: float) -> float:
        return float(material.stress(kelvin, fraction, contraction, parameters))

    found[4] = {"check": (law(xi + small) - law(xi - small)) / (2.0 * small)}
    for form in ("printed", "corrected"):
        of_a2, of_a3 = getattr(a2, form), getattr(a3, form)
        found[4] |= {f"a2_{form}": of_a2, f"a3_{form}": of_a3, f"slope_{form}": tension + of_a2}
        for where, away in (("at", 0.0), ("off", 0.02)):
            transformed = tension * (xi - away - 1.0) + of_a2 * (xi - away) + of_a3
            found[4][f"{where}_{form}"] = -modulus * contraction + thermal + transformed
            found[4][f"{where}_check"] = law(xi - away)
    # 5, the heating.
    ohm, at, per = parameters["wire.resistance"], table["heating at V*"], table["heating per volt"]
    found[5] = {"volt": volt, "at_printed": at.printed, "at_corrected": at.corrected,
                "at_check": volt**2 / ohm, "per_printed": per.printed,
                "per_corrected": per.corrected,
                "per_check": ((volt + small) ** 2 - (volt - small) ** 2) / (2.0 * small * ohm)}
    # 6, the kinetics, on heating at the point and in the middle of an unloaded cooling.
    ends_of = (parameters[f"wire.martensite_{end}_temperature"] for end in ("start", "finish"))
    found[6] = {}
    places: dict[paper.Branch, Any] = {
        "heating": (kernel.heated_fraction, kelvin, sigma),
        "cooling": (kernel.cooled_fraction, 0.5 * sum(ends_of), 0.0),
    }
    for name, (ramp, t, s) in places.items():
        printed, per_kelvin, per_pascal = paper.kinetics_slopes(name, t, s, parameters)
        by_t = (ramp(t + 1e-3, s, parameters) - ramp(t - 1e-3, s, parameters)) / 2e-3
        by_s = (ramp(t, s + 1e3, parameters) - ramp(t, s - 1e3, parameters)) / 2e3
        values = (printed, -printed, -per_kelvin, by_t, per_pascal, by_s)
        names = ("printed", "minus", "kelvin", "kelvin_check", "pascal", "pascal_check")
        found[6] |= {f"{name}_{n}": value for n, value in zip(names, values, strict=True)}
    return found


# --- Numbers that do not fit.


def _audited(found: Mapping[str, Finding]) -> Facts:
    """7 to 10, of the tables, as the audit finds them; 13, of E6 against the DSC."""
    length, rho = found["wire length"], found["resistivity"].numbers
    heat, time = found["heat transfer"], found["time constant"].numbers
    stretch, (first, second) = found["thermal expansion"], specimens.DSC_CYCLES
    agreement: dict[str, object] = {}
    for symbol, (mean, std) in (("A_s", specimens.UPFR_START), ("A_f", specimens.UPFR_FINISH)):
        for number, cycle in enumerate(specimens.DSC_CYCLES, start=1):
            apart = mean - cycle[symbol]
            agreement |= {f"{symbol}_{number}": apart, f"{symbol}_{number}_stds": apart / std}
    low, high = (stretch.numbers[f"alpha_E_{end}"] for end in ("low", "high"))
    order, micro = found["transition order"].text, "resistivity_from_{}_length".format
    return {
        7: {"audit": order, "first": first["M_s"] - first["A_s"],
            "second": second["M_s"] - second["A_s"]},
        8: {"audit": length.text, **length.numbers, "micro_area": 1e8 * rho[micro("area")],
            "micro_mass": 1e8 * rho[micro("mass")]},
        9: {"audit": heat.text, **heat.numbers, "time": time["time_constant"],
            "time_low": time["still_air_low"], "time_high": time["still_air_high"]},
        10: {"audit": stretch.text, "printed": _THERMAL_EXPANSION / 1e6, "low": low / 1e6,
             "high": high / 1e6, "after": 30.0 * _THERMAL_EXPANSION / 1e6,
             "after_low": -30.0 * low / 1e6},
        13: agreement,
    }  # fmt: skip


def _loads(numbers: Parameters) -> Facts:
    """12, the stress of E6; 15, a constant load; 16, volts and amperes of the supply."""
    diameter = numbers["wire.diameter"]
    angles = np.linspace(0.0, 2.0 * np.pi, 20001)
    x, y = 0.5 * diameter * np.cos(angles), 0.5 * diameter * np.sin(angles)
    shoelace = 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    sigma, kelvin = 100e6, np.linspace(300.0, 400.0, 100001)
    xi = [kernel.heated_fraction(kelvin, held, numbers) for held in (0.0, sigma)]
    middles = [float(np.interp(0.5, fraction[::-1], kelvin[::-1])) for fraction in xi]
    ohm, force = numbers["wire.resistance"], specimens.HOLDING_FORCE
    return {
        12: {"printed": _PRINTED_STRESS, "check": force / shoelace, "diameter": 1e3 * diameter,
             "corrected": force / bending.wire_section(numbers),
             "needed": 1e3 * np.sqrt(4.0 * force / (np.pi * _PRINTED_STRESS))},
        15: {"corrected": sigma / numbers["wire.stress_influence_austenite"],
             "check": middles[1] - middles[0]},
        16: {"ampere": _CURRENT_RANGE, "corrected": _VOLTAGE_RANGE / ohm, "volt": _VOLTAGE_RANGE,
             "check": np.sqrt(_VOLTAGE_RANGE**2 / ohm / ohm), "largest": _CURRENT_RANGE * ohm},
    }  # fmt: skip


def _history(numbers: Parameters) -> Facts:
    """17, eq. (6) from a reference that carries stress; 18, eqs. (10), (11) without fractions."""
    # From xi_0, a contraction c_0 to xi, c; both count from rest, martensite: eps_L (xi - 1).
    limit, xi_0, c_0, xi, c = numbers["wire.maximum_recoverable_strain"], 0.6, 0.02, 0.2, 0.03
    states = ((xi_0, c_0), (xi, c))
    begun, at_once = (float(material.stress(340.0, *state, numbers)) for state in states)
    e_0, e = (float(material.modulus(fraction, numbers)) for fraction in (xi_0, xi))
    printed = begun + e * (c_0 - c) - limit * e * (xi - xi_0)
    missing = (e - e_0) * (-c_0 - limit * (xi_0 - 1.0))
    # A wire that turns to cooling half transformed, then and 10 K further down.
    a_s, a_f, m_s, m_f = (numbers[name] for name in TRANSITIONS.values())
    kelvin = 0.5 * (a_s + a_f) + np.array([0.0, -10.0])
    full = 0.5 - 0.5 * np.cos(np.pi * (kelvin - m_f) / (m_s - m_f))  # austenite, eq. (11)
    wire = TemperatureDriven(numbers, boundary=Boundary.held_stress(0.0))
    wire.run([0.0, 1.0], kelvin[:1, np.newaxis])
    first = wire.state.martensite_fraction[0]
    wire.run([1.0, 2.0], kelvin[1:, np.newaxis])
    return {
        17: {"printed": printed, "corrected": printed + missing, "check": at_once},
        18: {"printed": 1.0 - full[0], "corrected": first, "later_printed": 1.0 - full[1],
             "later": wire.state.martensite_fraction[0],
             "later_check": 1.0 - 0.5 * full[1] / full[0]},
    }  # fmt: skip


def _layers(rig: Parameters) -> dict[str, object]:
    """19: widths, neutral axis, and a stiffness that counts twice."""
    beam, sides = Beam.of(rig), rig["bench.channel_sides"]
    thick, layer, top = beam.thickness, beam.layer_thickness, beam.thickness + beam.layer_thickness
    sheet, real = bending.deflection(1.0, paper.as_printed(beam)), bending.deflection(1.0, beam)

    def by_energy(width: float) -> float:
        """alpha [m] by least energy: one curvature, strains apart by it times their distance."""
        matrix, wires = beam.modulus * beam.width * thick, beam.layer_modulus * width * layer
        own = (matrix * thick**2 + wires * layer**2) / 12.0
        apart, series = 0.5 * top, matrix * wires / (matrix + wires)
        return 0.5 * beam.length**2 * series * apart / (own + series * apart**2)

    # The neutral axis, of one width, by parallel axes and by slices.
    matrix, wires = beam.modulus * thick, beam.layer_modulus * layer
    neutral = (matrix * 0.5 * thick + wires * (thick + 0.5 * layer)) / (matrix + wires)
    height = (np.arange(100_000) + 0.5) * top / 100_000
    weights = np.where(height < thick, beam.modulus, beam.layer_modulus)
    sliced = float(np.average(height, weights=weights))
    # The deflection at a free strain, with the bending stiffness once in alpha and once in beta.
    front = sum(side == "front" for side in sides)
    section = front * np.pi * (0.5 * rig["wire.diameter"]) ** 2
    beta = bending.stress_per_deflection(paper.as_printed(beam))
    stiff = front * rig["wire.austenite_modulus"] / sheet
    twice, once = _STRAIN * sheet * stiff / (beta + stiff), _STRAIN * sheet
    return {"sheet_width": 1e3 * beam.width, "width": 1e3 * beam.layer_width,
            "width_check": 1e3 * section / layer, "sheet": sheet, "real": real,
            "real_check": by_energy(beam.layer_width), "neutral": 1e3 * (neutral - 0.5 * thick),
            "neutral_check": 1e3 * (sliced - 0.5 * thick), "twice": twice, "once": once,
            "once_check": _STRAIN * by_energy(beam.width), "low": 1e3 * thick, "high": 1e3 * top,
            "lost": 1.0 - twice / once}
