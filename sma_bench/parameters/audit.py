"""Do the numbers of a lab fit each other, and physics? The first suspect of any gap is here."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from sma_bench.findings import Finding
from sma_bench.parameters.parameters import Parameters, load_kind
from sma_bench.parameters.table import BY_NAME, TRANSITIONS

NITI_DENSITY = 6450.0  # kg/m3
NITI_RESISTIVITY = (70e-8, 110e-8)  # ohm m, martensite 76 to 80, austenite 82 to 100 microohm cm
NITI_EXPANSION = (6.6e-6, 11e-6)  # 1/K, martensite, austenite
GRAVITY = 9.81  # m/s2
STEFAN_BOLTZMANN = 5.670e-8  # W/(m2 K4)
WIRE_EMISSIVITY = (0.2, 0.9)  # bright to oxidised
# J/(kg K): calorimetry of NiTi outside its transformation gives 440 to 550; data sheets have 322
# (0.077 cal/(g K), Nitinol Devices & Components) and 837 (0.2 cal/(g K), Dynalloy).
NITI_SPECIFIC_HEAT = (400.0, 650.0)
NITI_WORKING_STRESS = 250e6  # Pa, data sheets advise 170 to 200 for many cycles
NITI_STRENGTH = 800e6  # Pa, where austenite of most wires slips
LENGTH_TOLERANCE = 0.10
CONVECTION_FACTOR = 1.5


def audit(parameters: Parameters, *, papers_own: bool = True) -> list[Finding]:
    """Check a lab's own numbers against each other and against correlations.

    Args:
        papers_own: whether findings on numbers that are all the paper's stand one by one; else
            they are one line.

    Returns:
        Findings: "warning" where numbers clash (the text says which and by how much), "info"
        where a check passed. PAPER_NOTES items 7 to 10 and 16 are the warnings on the paper's
        numbers.
    """
    found = [
        (finding, all(parameters[name] == BY_NAME[name].default for name in names))
        for check, names in CHECKS if (finding := check(parameters)) is not None
    ]
    findings = [finding for finding, papers in found if papers_own or not papers]
    clashes = [f.subject for f, papers in found if papers and f.severity != "info"]
    if not papers_own and any(papers for _, papers in found):
        text = (
            f"{sum(papers for _, papers in found)} checks rest on the paper's own numbers, "
            f"{len(clashes)} of them clash"
        )
        text += f" ({', '.join(clashes)}); sma-bench audit --paper lists them" if clashes else ""
        findings.append(
            Finding("info", "the paper's numbers", text, {"clashes": float(len(clashes))})
        )
    return [replace(finding, audit=True) for finding in findings]


def wire_length(parameters: Parameters) -> float:
    """Length [m] of the wires: given, or that of their mass."""
    return parameters["wire.length"] or wire_length_from_mass(parameters)


def wire_length_from_mass(parameters: Parameters) -> float:
    """Length [m] of NiTi wire (6450 kg/m3) of the given mass and diameter."""
    return parameters["wire.mass"] / (NITI_DENSITY * _cross_section(parameters))


def wire_length_from_area(parameters: Parameters) -> float:
    """Length [m] of a cylinder of the given lateral area and diameter."""
    return parameters["wire.surface_area"] / (math.pi * parameters["wire.diameter"])


def natural_convection(diameter: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of a horizontal cylinder in still air.

    Churchill and Chu (1975), air at film temperature and 1 atm.

    Args:
        diameter: of the cylinder [m].
        surface, ambient: temperatures [K], surface above ambient.
    """
    film = 0.5 * (surface + ambient)
    conductivity = 0.0241 * (film / 273.15) ** 0.81
    viscosity = 1.716e-5 * (film / 273.15) ** 1.5 * (273.15 + 110.4) / (film + 110.4)
    density = 101325.0 / (287.05 * film)
    heat_capacity = 1007.0
    prandtl = viscosity * heat_capacity / conductivity
    diffusivity = conductivity / (density * heat_capacity)
    rayleigh = (
        GRAVITY * (surface - ambient) * diameter**3 / (film * (viscosity / density) * diffusivity)
    )
    shape = (1.0 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    nusselt = (0.60 + 0.387 * rayleigh ** (1 / 6) / shape) ** 2
    return nusselt * conductivity / diameter


def radiation(emissivity: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of grey radiation to surroundings at `ambient` [K]."""
    return emissivity * STEFAN_BOLTZMANN * (surface**2 + ambient**2) * (surface + ambient)


def still_air_range(parameters: Parameters) -> tuple[float, float]:
    """Lowest and highest plausible h [W/(m2 K)] of the bare wire in still air.

    From 15 K above ambient to A_f, convection plus radiation of a bright or an oxidised wire.
    """
    ambient = parameters["environment.ambient_temperature"]
    diameter = parameters["wire.diameter"]
    warm = ambient + 15.0
    hot = max(parameters["wire.austenite_finish_temperature"], warm + 1.0)
    low = natural_convection(diameter, warm, ambient) + radiation(WIRE_EMISSIVITY[0], warm, ambient)
    high = natural_convection(diameter, hot, ambient) + radiation(WIRE_EMISSIVITY[1], hot, ambient)
    return low, high


def _cross_section(parameters: Parameters) -> float:
    return math.pi * parameters["wire.diameter"] ** 2 / 4.0


def _wire(parameters: Parameters) -> str:
    return f"{parameters['wire.diameter'] * 1e3:.2g} mm NiTi wire"


def _judged(
    subject: str, text: str, clash: str, numbers: dict[str, float], passed: str = ": plausible"
) -> Finding:
    if clash:
        return Finding("warning", subject, f"{text}{clash}", numbers)
    return Finding("info", subject, f"{text}{passed}", numbers)


def _lengths(parameters: Parameters) -> Finding:
    by_mass, by_area = wire_length_from_mass(parameters), wire_length_from_area(parameters)
    ratio, clash = by_area / by_mass, ""
    numbers = {"length_from_mass": by_mass, "length_from_area": by_area, "ratio": ratio}
    if abs(ratio - 1.0) > LENGTH_TOLERANCE:
        h = parameters["wire.heat_transfer_coefficient"] * ratio
        numbers["heat_transfer_coefficient_for_length_from_mass"] = h
        clash = (
            f": a factor {ratio:.2f} apart; only h times area is measured, so over {by_mass:.3f} m "
            f"h would be {h:.0f} W/(m2 K)"
        )
    text = (
        f"wire.mass {parameters['wire.mass'] * 1e3:.4g} g is {by_mass:.3f} m of "
        f"{_wire(parameters)}, wire.surface_area {parameters['wire.surface_area'] * 1e6:.5g} mm2 "
        f"is {by_area:.3f} m"
    )
    return _judged("wire length", text, clash, numbers, ": they agree")


def _resistivity(parameters: Parameters) -> Finding:
    resistance, (low, high) = parameters["wire.resistance"], NITI_RESISTIVITY
    lengths = {
        "mass": wire_length_from_mass(parameters), "area": wire_length_from_area(parameters),
    }
    numbers, verdicts, good = {}, [], True
    for name, length in lengths.items():
        implied = resistance * _cross_section(parameters) / length
        fits = low <= implied <= high
        numbers[f"resistivity_from_{name}_length"], good = implied, good and fits
        verdicts.append(
            f"{implied * 1e8:.0f} microohm cm over the {length:.3f} m of wire.{name}"
            f" ({'fits' if fits else 'does not fit'})"
        )
    text = (
        f"wire.resistance {resistance:.4g} ohm means {' and '.join(verdicts)}; "
        f"NiTi has {low * 1e8:.0f} to {high * 1e8:.0f}"
    )
    return Finding("info" if good else "warning", "resistivity", text, numbers)


def _heat_transfer(parameters: Parameters) -> Finding:
    h, (low, high) = parameters["wire.heat_transfer_coefficient"], still_air_range(parameters)
    numbers = {"heat_transfer_coefficient": h, "still_air_low": low, "still_air_high": high}
    text = (
        f"wire.heat_transfer_coefficient {h:.1f} W/(m2 K) against {low:.0f} to {high:.0f} of "
        f"natural convection (Churchill-Chu) and radiation for {_wire(parameters)} in still air"
    )
    clash = ""
    if h > high * CONVECTION_FACTOR:
        numbers["factor"] = h / high
        clash = f": {h / high:.1f} times the highest; what would explain it is weighed below"
    elif h < low / CONVECTION_FACTOR:
        numbers["factor"] = h / low
        clash = f": {h / low:.2f} times the lowest; check wire.surface_area and the insulation"
    return _judged("heat transfer", text, clash, numbers)


def _time_constant(parameters: Parameters) -> Finding:
    heat_capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    tau = heat_capacity / (
        parameters["wire.heat_transfer_coefficient"] * parameters["wire.surface_area"]
    )
    area = math.pi * parameters["wire.diameter"] * wire_length_from_mass(parameters)
    low, high = still_air_range(parameters)
    shortest, longest = heat_capacity / (high * area), heat_capacity / (low * area)
    numbers = {"time_constant": tau, "still_air_low": shortest, "still_air_high": longest}
    text = (
        f"m c_p/(h A_c) = {tau:.3g} s against {shortest:.2g} to {longest:.2g} s of "
        f"{_wire(parameters)} in still air"
    )
    clash, factor = "", shortest / tau if tau < shortest else tau / longest
    if not shortest / CONVECTION_FACTOR <= tau <= longest * CONVECTION_FACTOR:
        numbers["factor"] = factor
        clash = f": {factor:.1f} times too {'fast' if tau < shortest else 'slow'}"
    return _judged("time constant", text, clash, numbers)


def _transition_order(parameters: Parameters) -> Finding:
    kelvin = {symbol: parameters[name] for symbol, name in TRANSITIONS.items()}
    clashes = [
        f"{upper} lies {kelvin[upper] - kelvin[lower]:.2f} K above {lower}"
        for upper, lower in (("M_s", "A_s"), ("M_s", "A_f"), ("M_f", "A_s"))
        if kelvin[upper] >= kelvin[lower]
    ]
    text = ", ".join(f"{n} {kelvin[n]:.2f}" for n in ("A_s", "A_f", "M_s", "M_f")) + " K"
    clash = (
        f": {', '.join(clashes)}, against A_f > A_s > M_s > M_f; accepted, the kinetics stay "
        "continuous where the ranges overlap"
    )
    numbers = {"overlap": kelvin["M_s"] - kelvin["A_s"]}
    return _judged(
        "transition order", text, clash if clashes else "", numbers, ": A_f > A_s > M_s > M_f"
    )


def _thermal_expansion(parameters: Parameters) -> Finding:
    theta = parameters["wire.thermal_expansion_factor"]
    soft = NITI_EXPANSION[0] * parameters["wire.martensite_modulus"]
    stiff = NITI_EXPANSION[1] * parameters["wire.austenite_modulus"]
    numbers = {"thermal_expansion_factor": theta, "alpha_E_low": soft, "alpha_E_high": stiff}
    text = (
        f"wire.thermal_expansion_factor {theta / 1e6:.4g} MPa/K against -{soft / 1e6:.2f} to "
        f"-{stiff / 1e6:.2f} MPa/K of -alpha E for a clamped wire below A_s"
    )
    clashes, size = [], abs(theta)
    if theta > 0.0:
        clashes.append("of the other sign (a clamped wire that expands is pushed, not pulled)")
    if size > CONVECTION_FACTOR * stiff:
        numbers["factor"] = size / stiff
        clashes.append(f"{size / stiff:.0f} times the largest")
    elif size < soft / CONVECTION_FACTOR:
        numbers["factor"] = size / soft
        clashes.append(f"{size / soft:.2f} times the smallest")
    return _judged(
        "thermal expansion", text, f": {', '.join(clashes)}" if clashes else "", numbers
    )


def _specific_heat(parameters: Parameters) -> Finding:
    heat, (low, high) = parameters["wire.specific_heat"], NITI_SPECIFIC_HEAT
    numbers, clash = {"specific_heat": heat, "low": low, "high": high}, ""
    if not low <= heat <= high:
        numbers["factor"] = factor = heat / (low if heat < low else high)
        clash = (
            f": {factor:.2f} times the lowest; a temperature read high or a mass stated too large "
            "would make it so"
            if heat < low else
            f": {factor:.2f} times the highest; a temperature read low, a mass stated too small, a "
            "matrix or a holder heated along, or latent heat would make it so"
        )
    text = (
        f"wire.specific_heat {heat:.4g} J/(kg K) against {low:g} to {high:g} of NiTi outside its "
        "transformation"
    )
    return _judged("specific heat", text, clash, numbers)


def _current(parameters: Parameters) -> Finding | None:
    if parameters["bench.drive"] == "current":
        return None
    duty = parameters["bench.drive"] == "duty"
    name = "bench.supply_voltage" if duty else "bench.maximum_voltage"
    volts, limit = parameters[name], parameters["bench.maximum_current"]
    ohm = parameters["wire.resistance"] + parameters["bench.lead_resistance"]
    current = volts / ohm
    clash = (
        f", above bench.maximum_current {limit:g} A, which is reached at {limit * ohm:.2f} V: the "
        "outputs will be switched off there"
    )
    return _judged(
        "current", f"{name} {volts:g} V over {ohm:.4g} ohm is {current:.2f} A a wire",
        clash if current > limit else "",
        {"current": current, "limit": limit, "largest_voltage": limit * ohm},
        f", within bench.maximum_current {limit:g} A",
    )


def _force(parameters: Parameters) -> Finding | None:
    """Stress of the load that is held, and at full stroke of a spring."""
    if load_kind(parameters) not in ("force", "spring", "antagonist"):
        return None
    force = abs(parameters["load.force"]) + abs(parameters["load.preload"])
    section = _cross_section(parameters) * parameters["wire.count"]
    stroke = parameters["wire.maximum_recoverable_strain"] * wire_length(parameters)
    pull = force + parameters["load.stiffness"] * stroke
    stress, most = force / section, pull / section
    shift = most / parameters["wire.stress_influence_austenite"]
    numbers = {"force": force, "stress": stress, "stress_at_full_stroke": most, "shift": shift}
    text = (
        f"{force:.4g} N on {_wire(parameters)} is {stress / 1e6:.1f} MPa at rest and "
        f"{most / 1e6:.1f} MPa at the full stroke of {stroke * 1e3:.3g} mm, where A_f lies "
        f"{shift:.1f} K higher"
    )
    clash = ""
    if most > NITI_STRENGTH:
        clash = f": above {NITI_STRENGTH / 1e6:g} MPa the wire slips before it gets there"
    elif most > NITI_WORKING_STRESS:
        clash = f": above {NITI_WORKING_STRESS / 1e6:g} MPa it lasts few cycles"
    return _judged("force", text, clash, numbers)


def _explanations(parameters: Parameters) -> Finding | None:
    """What would explain a heat transfer coefficient that still air does not give: each error is
    undone in the numbers and all are checked again."""
    before = _heat_transfer(parameters)
    if before.severity == "info":
        return None
    h, heat = parameters["wire.heat_transfer_coefficient"], parameters["wire.specific_heat"]
    low, high = still_air_range(parameters)
    factor = h / high if h > high else h / low
    area = math.pi * parameters["wire.diameter"] * wire_length_from_mass(parameters)
    grown = parameters["wire.surface_area"] / area
    mass = wire_length_from_area(parameters) / wire_length_from_mass(parameters)
    # What is measured stays: h A_c by E2, c_p m by E3, both per kelvin that the sensor says.
    undone = {
        f"a temperature read {'low' if factor > 1.0 else 'high'} by a factor {factor:.1f}": {
            "wire.heat_transfer_coefficient": h / factor, "wire.specific_heat": heat / factor},
        "an area of the mass's length": {
            "wire.surface_area": area, "wire.heat_transfer_coefficient": h * grown},
        "a mass of the area's length": {
            "wire.mass": parameters["wire.mass"] * mass, "wire.specific_heat": heat / mass},
    }
    judged = {"heat transfer": _heat_transfer, "time constant": _time_constant,
              "specific heat": _specific_heat}
    clashing = [name for name, check in judged.items() if check(parameters).severity != "info"]
    texts, numbers = [], {"factor": factor}
    for what, changed in undone.items():
        values = {
            name: min(max(value, BY_NAME[name].low or 0.0), BY_NAME[name].high or math.inf)
            for name, value in changed.items()
        }
        then = [n for n, check in judged.items()
                if check(parameters.replace(values)).severity != "info"]
        mended = [name for name in clashing if name not in then]
        left = f"leaves {_listed(then)}" if then else "leaves nothing"
        c_p = values.get("wire.specific_heat", heat)
        texts.append(f"{what} mends {_listed(mended) or 'none of it'} and {left} (c_p {c_p:.0f})")
        numbers[f"left by {what.partition(' by ')[0]}"] = float(len(then))
    rest = [name for name in clashing if name not in ("heat transfer", "time constant")]
    texts.append(
        "moving air or a wire in contact explain heat transfer and time constant"
        + (f" and leave {_listed(rest)}" if rest else "")
    )
    return Finding("info", "heat transfer explained", "; ".join(texts), numbers)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else "".join(names)


_HEAT = (
    "wire.heat_transfer_coefficient", "wire.specific_heat", "wire.mass", "wire.surface_area",
    "wire.diameter",
)
# Each check with the parameters that it rests on.
CHECKS: tuple[tuple[Callable[[Parameters], Finding | None], tuple[str, ...]], ...] = (
    (_lengths, ("wire.mass", "wire.surface_area", "wire.diameter")),
    (_resistivity, ("wire.resistance", "wire.mass", "wire.surface_area", "wire.diameter")),
    (_heat_transfer, ("wire.heat_transfer_coefficient", "wire.diameter")),
    (_time_constant, _HEAT),
    (_explanations, _HEAT),
    (_specific_heat, ("wire.specific_heat",)),
    (_transition_order, tuple(TRANSITIONS.values())),
    (_thermal_expansion, ("wire.thermal_expansion_factor", "wire.martensite_modulus",
                          "wire.austenite_modulus")),
    (_current, ("bench.maximum_voltage", "bench.maximum_current", "bench.supply_voltage",
                "bench.lead_resistance", "wire.resistance")),
    (_force, ("load.force", "load.preload", "load.stiffness", "wire.diameter", "wire.count")),
)
