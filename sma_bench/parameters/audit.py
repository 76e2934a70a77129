"""Checks a lab's numbers against each other and against physics: the first suspects of any gap."""

import math
from dataclasses import replace
from typing import Any

from sma_bench.findings import Finding, Severity
from sma_bench.parameters import parameters as law
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS, read_declarations
from sma_bench.parameters.parameters import CONVECTION_FACTOR, GRAVITY, NITI_EXPANSION, Parameters

NITI_RESISTIVITY = (70e-8, 110e-8)  # ohm m, martensite 76 to 80, austenite 82 to 100 microohm cm
WIRE_EMISSIVITY = (0.2, 0.9)  # bright to oxidised
# J/(kg K): calorimetry of NiTi outside its transformation gives 440 to 550; data sheets have 322
# (0.077 cal/(g K), Nitinol Devices & Components) and 837 (0.2 cal/(g K), Dynalloy).
NITI_SPECIFIC_HEAT = (400.0, 650.0)
NITI_STRETCHES = 30e6  # Pa, martensite of annealed wires yields at 50 to 150
NITI_WORKING_STRESS = 250e6  # Pa, data sheets advise 170 to 200 for many cycles
NITI_STRENGTH = 800e6  # Pa, where austenite of most wires slips
LENGTH_TOLERANCE = 0.10
_TEXTS: dict[str, dict[str, Any]] = read_declarations("audit.yaml")


def audit(parameters: Parameters, *, papers_own: bool = True) -> list[Finding]:
    """Check a lab's numbers against each other and correlations: a "warning" where they clash (its
    text says which and by how much), else "info". `papers_own`: list findings on the paper's own
    numbers one by one, not in one line. Their warnings: PAPER_NOTES, 7 to 10 and 16."""
    found = [finding for check in (_wire, _thermal, _material, _drive_and_load)
             for finding in check(parameters)]
    if not papers_own:
        papers = [finding for finding in found if all(parameters[n] == BY_NAME[n].default
                                                      for n in _TEXTS[finding.subject]["of"])]
        clashes = [finding.subject for finding in papers if finding.severity != "info"]
        found = [finding for finding in found if finding not in papers]
        if papers:
            few = len(clashes)
            text = (f"{len(papers)} checks rest on the paper's own numbers, stated or by default; "
                    f"{few} of them clash")
            if clashes:
                text += f" ({', '.join(clashes)}); sma-bench audit --paper lists them"
            found.append(Finding("info", "the paper's numbers", text, {"clashes": float(few)}))
    return [replace(finding, audit=True) for finding in found]


def _judged(parameters: Parameters, subject: str, clash: str, numbers: dict[str, float],
            **facts: Any) -> Finding:
    """A finding with texts of audit.yaml: a warning with the text `clash`, or info without one."""
    texts = _TEXTS[subject]
    facts["wire"] = f"{parameters['wire.diameter'] * 1e3:.2g} mm NiTi wire"
    silent = [n for n in texts["of"] if parameters[n] and n not in parameters.given]
    facts["unstated"] = f"; not stated: {', '.join(silent)}" if parameters.given and silent else ""
    ending = texts[clash] if clash else texts.get("passed", ": plausible")
    if clash and parameters.given and texts["of"][0] not in parameters.given:
        ending = texts.get("unstated", ending)
    text = texts["text"] + ending
    severity: Severity = "warning" if clash else "info"
    return Finding(severity, subject, text.format(**numbers, **facts), numbers)


def _wire(p: Parameters) -> list[Finding]:
    """Length of the wire by mass, by area and as stated; its resistivity by the first two."""
    by_mass = law.wire_length_from_mass(p)
    by_area = float(p["wire.surface_area"]) / (math.pi * p["wire.diameter"])
    ratio = by_area / by_mass
    numbers = {"length_from_mass": by_mass, "length_from_area": by_area, "ratio": ratio}
    clash, stated = "", ""
    if length := p["wire.length"]:
        numbers["stated_length"], stated = length, f", wire.length is {length:.3f} m"
        clash = "other" if abs(length / by_mass - 1.0) > LENGTH_TOLERANCE else ""
    if abs(ratio - 1.0) > LENGTH_TOLERANCE:
        clash, name = "apart", "heat_transfer_coefficient"
        numbers[f"{name}_for_length_from_mass"] = p[f"wire.{name}"] * ratio
    lengths = _judged(p, "wire length", clash, numbers, grams=p["wire.mass"] * 1e3,
                      square=p["wire.surface_area"] * 1e6, stated=stated)
    ohm, (low, high) = p["wire.resistance"], NITI_RESISTIVITY
    numbers, verdicts, clash = {}, [], ""
    for name, length in (("mass", by_mass), ("surface_area", by_area)):
        implied = ohm * law.wire_section(p) / length
        numbers[f"resistivity_from_{name.removeprefix('surface_')}_length"] = implied
        clash = clash if low <= implied <= high else "unlike"
        fits = "fits" if low <= implied <= high else "does not fit"
        over = f"over the {length:.3f} m of wire.{name}"
        verdicts.append(f"{implied * 1e8:.0f} microohm cm {over} ({fits})")
    return [lengths, _judged(p, "resistivity", clash, numbers, verdicts=" and ".join(verdicts),
                             ohm=ohm, low=low * 1e8, high=high * 1e8)]


def _against(p: Parameters, subject: str, name: str, value: float, low: float, high: float,
             of_air: float = 1.0) -> Finding:
    """Compare a number with its usual range, widened by a factor `of_air` for still air."""
    ends = ("low", "high") if of_air == 1.0 else ("still_air_low", "still_air_high")
    clash, numbers = "", {name: value, **dict(zip(ends, (low, high), strict=True))}
    if not low / of_air <= value <= high * of_air:
        clash = "below" if value < low else "above"
        numbers["factor"] = value / (low if clash == "below" else high)
    return _judged(p, subject, clash, numbers)


def _thermal(p: Parameters) -> list[Finding]:
    """Heat transfer and time constant against still air, specific heat against calorimetry."""
    # Plausible h [W/(m2 K)] of the bare wire in still air: from 15 K above ambient to A_f,
    # convection plus radiation of a bright or an oxidised wire.
    h, ambient = p["wire.heat_transfer_coefficient"], p["environment.ambient_temperature"]
    warm, diameter = ambient + 15.0, p["wire.diameter"]
    hot = max(p["wire.austenite_finish_temperature"], warm + 1.0)
    low, high = (law.natural_convection(diameter, kelvin, ambient)
                 + law.radiation(grey, kelvin, ambient)
                 for grey, kelvin in zip(WIRE_EMISSIVITY, (warm, hot), strict=True))
    heat, capacity = p["wire.specific_heat"], p["wire.mass"] * p["wire.specific_heat"]
    area = math.pi * diameter * law.wire_length_from_mass(p)
    slow, fast = capacity / (low * area), capacity / (high * area)
    return [
        _against(p, "heat transfer", "heat_transfer_coefficient", h, low, high, CONVECTION_FACTOR),
        _against(p, "time constant", "time_constant", capacity / (h * p["wire.surface_area"]),
                 fast, slow, CONVECTION_FACTOR),
        _against(p, "specific heat", "specific_heat", heat, *NITI_SPECIFIC_HEAT)]


def _material(p: Parameters) -> list[Finding]:
    """Order of transition temperatures and of moduli; thermal expansion against that of NiTi."""
    kelvin = {symbol: p[name] for symbol, name in TRANSITIONS.items()}
    clashes = [f"{upper} lies {kelvin[upper] - kelvin[lower]:.2f} K above {lower}"
               for upper, lower in (("M_s", "A_s"), ("M_s", "A_f"), ("M_f", "A_s"))
               if kelvin[upper] >= kelvin[lower]]
    overlap = {"overlap": kelvin["M_s"] - kelvin["A_s"]}
    order = _judged(p, "transition order", "overlap" if clashes else "", overlap,
                    clashes=", ".join(clashes), **kelvin)
    low, high, theta = (p[f"wire.{name}"] for name in (
        "martensite_modulus", "austenite_modulus", "thermal_expansion_factor"))
    moduli = _judged(p, "moduli", "swapped" if low > high else "",
                     {"martensite": low, "austenite": high}, soft=low / 1e9, stiff=high / 1e9)
    soft, stiff = NITI_EXPANSION[0] * low, NITI_EXPANSION[1] * high
    numbers = {"thermal_expansion_factor": theta, "alpha_E_low": soft, "alpha_E_high": stiff}
    clashes, size = [], abs(theta)
    if theta > 0.0:
        clashes.append("of the other sign (a clamped wire that expands is pushed, not pulled)")
    if size > CONVECTION_FACTOR * stiff:
        numbers["factor"] = size / stiff
        clashes.append(f"{size / stiff:.0f} times the largest")
    elif size < soft / CONVECTION_FACTOR:
        numbers["factor"] = size / soft
        clashes.append(f"{size / soft:.2f} times the smallest")
    expansion = _judged(p, "thermal expansion", "clash" if clashes else "", numbers,
                        clashes=", ".join(clashes), theta=theta / 1e6, soft=soft / 1e6,
                        stiff=stiff / 1e6)
    return [order, moduli, expansion]


def _drive_and_load(p: Parameters) -> list[Finding]:
    """Current at the highest voltage; stress of a held load, and at a spring's full stroke."""
    found = []
    if p["bench.drive"] != "current":
        name = "bench.supply_voltage" if p["bench.drive"] == "duty" else "bench.maximum_voltage"
        volts, limit = p[name], p["bench.maximum_current"]
        ohm = p["wire.resistance"] + p["bench.lead_resistance"]
        numbers = {"current": volts / ohm, "limit": limit, "largest_voltage": limit * ohm}
        clash = "above" if volts / ohm > limit else ""
        found.append(_judged(p, "current", clash, numbers, name=name, volts=volts, ohm=ohm))
    if law.load_kind(p) in ("force", "spring", "antagonist"):
        force = abs(p["load.force"]) + abs(p["load.preload"])
        section = law.wire_section(p) * p["wire.count"]
        stroke = p["wire.maximum_recoverable_strain"] * law.wire_length(p)
        growth = p["load.stiffening"] * stroke
        grown = math.expm1(growth) / growth if growth else 1.0
        stress, most = force / section, (force + p["load.stiffness"] * grown * stroke) / section
        shift = most / p["wire.stress_influence_austenite"]
        clash = "light" if p["load.kind"] == "force" and most < NITI_STRETCHES else ""
        clash = "few cycles" if most > NITI_WORKING_STRESS else clash
        clash = "slips" if most > NITI_STRENGTH else clash
        numbers = {"force": force, "stress": stress, "stress_at_full_stroke": most, "shift": shift}
        found.append(_judged(p, "force", clash, numbers, strength=NITI_STRENGTH / 1e6,
                             working=NITI_WORKING_STRESS / 1e6, rest=stress / 1e6,
                             full=most / 1e6, stroke=stroke * 1e3, newton=GRAVITY * force,
                             enough=NITI_STRETCHES / 1e6))
    return found
