"""E9: joint fit of the full constitutive law to strain, temperature and stress of all tests."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.constitutive.fit import (
    LawFit,
    LawNumber,
    about_fits,
    about_numbers,
    fit_law,
    has_several_stresses,
)
from sma_bench.identify.constitutive.law import REFERENCE_STRESS, Law, Loop, make_loops
from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.isobaric import with_scales
from sma_bench.identify.instruments.tangents import strain_tangents
from sma_bench.identify.result import Correlation, Experiment
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import CONVECTION_FACTOR, NITI_EXPANSION
from sma_bench.parameters.table import BY_NAME, TRANSITIONS
from sma_bench.progress import Report, part, silent
from sma_bench.records.isobaric import STRONGEST, Branch, IsobaricRecord

NAME = "E9"
TITLE = "Joint fit of the constitutive law (eqs. 6 to 11)"
TOLERANCE = 0.05
INFLUENCES = {
    # C: (parameter, slope of the contract's law, slopes of the extended law)
    "C_A": ("wire.stress_influence_austenite", ("slope_A",), ("slope_A_s", "slope_A_f")),
    "C_M": ("wire.stress_influence_martensite", ("slope_M",), ("slope_M_s", "slope_M_f")),
}
UNITS = {
    "A_s": "K", "A_f": "K", "M_s": "K", "M_f": "K", "eps_L": "1", "H_min": "1", "dH": "1",
    "k": "1/(100 MPa)", "alpha_A": "1e-6/K", "alpha_M": "1e-6/K", "Theta_T": "MPa/K",
    "fading": "1e-3/K", "bend_A": "K/(100 MPa)^2", "bend_M": "K/(100 MPa)^2",
}
# Of the time that everything takes; the rest is for cycles fitted one by one.
_SHARES: dict[Law, tuple[float, float]] = {"contract": (0.0, 0.2), "extended": (0.2, 0.8)}
_SLOPE_UNIT = "K/(100 MPa)"
_SIGNIFICANT = 2.0
_STIFFEST = 90e9  # Pa, of any NiTi
_STRAIN, _EXPANSION = "wire.maximum_recoverable_strain", "wire.thermal_expansion_factor"


def fit_constitutive(
    records: Sequence[IsobaricRecord], parameters: Parameters | None = None, *,
    law: Law | Literal["auto"] = "auto", report: Report = silent,
) -> Experiment:
    """Fit the law to isobaric tests of one material, all stresses and cycles at once.

    Args:
        records: isobaric tests.
        parameters: E_A and E_M with their uncertainties (isobaric tests cannot tell them from
            eps_L), and C_A, C_M in case all tests are at one stress; the table's when None.
        law: "contract" (constant eps_L), "extended" (see law.py), or "auto": the
            contract's where its rms is below 5 % of the recovered strain at every stress, else
            the extended one, with both errors in the findings.
        report: called with how far the fits are.

    Returns:
        Estimates of the contract's parameters; `details` with every fitted number and the fit
        error per stress, as rms over the strain recovered at that stress; `curves`
        `<record, cycle>/temperature`, `/strain`, `/model` and `correlation` (p, p) in the order
        of the details whose names begin with the law's.

    Raises:
        InputError: no records, or too few points.
    """
    parameters = parameters or Parameters.defaults()
    if not records:
        raise InputError("constitutive fit: no records")
    loops = make_loops(records)
    laws: tuple[Law, ...] = ("contract", "extended") if law == "auto" else (law,)
    fits: list[LawFit] = []
    for candidate in laws:
        unknowns, fixed = unknowns_of(loops, candidate, parameters)
        reporter = part(report, *_SHARES[candidate])
        fits.append(fit_law(loops, candidate, unknowns, fixed, parameters, reporter))
        if max(fits[-1].errors.values()) < TOLERANCE:
            break
    chosen = fits[-1]
    findings = [finding for record in records for finding in record.findings]
    findings.extend(about_fits(fits, TOLERANCE))
    findings.extend(about_numbers(chosen))
    cycles = _cycle_by_cycle(chosen, records, parameters, findings)
    details = {}
    for fit in fits:
        n = sum(len(f.residual) for f in fit.loops)
        for i, name in enumerate(fit.names):
            details[f"{fit.law}: {name}"] = Estimate(
                float(fit.values[i]), float(fit.std[i]), UNITS.get(name, _SLOPE_UNIT),
                "joint fit", n,
            )
        for stress, error in fit.errors.items():
            here = [f for f in fit.loops if f.loop.stress == stress]
            count = sum(len(f.residual) for f in here)
            details[f"{fit.law}: fit error at {stress / 1e6:.0f} MPa"] = Estimate(
                error, error / math.sqrt(2.0 * count), "1", "rms over recovered strain", count
            )
    details |= cycles
    estimates = _estimates(chosen, parameters, findings)
    # Of the errors of the estimates; that of an inverse slope has the other sign.
    names = list(estimates)
    weights = {parameter: {name: 1.0} for name, parameter in TRANSITIONS.items()}
    for label, (parameter, common, own) in INFLUENCES.items():
        slopes = common if chosen.law == "contract" else own
        weights[parameter] = {name: -1.0 / len(slopes) for name in slopes}
        weights[parameter][f"bend_{label[-1]}"] = -_largest_stress(chosen)
    weights[_STRAIN] = _strain_weights(chosen)
    weights[_EXPANSION] = {"Theta_T": 1.0, "alpha_M": -1.0}
    turn = np.array([[weights[n].get(name, 0.0) for name in chosen.names] for n in names])
    covariance = turn @ chosen.covariance @ turn.T if names else np.zeros((0, 0))
    sigma = np.sqrt(np.diag(covariance))
    curves = {"correlation": chosen.correlation}
    for f in chosen.loops:
        curves[f"{f.loop.label}/temperature"] = f.loop.temperature
        curves[f"{f.loop.label}/strain"] = f.loop.strain
        curves[f"{f.loop.label}/model"] = f.model
    return Experiment(
        name=NAME, title=TITLE, estimates=estimates, findings=tuple(findings), curves=curves,
        source="; ".join(str(record.path) for record in records), details=details,
        correlation=Correlation(tuple(names), covariance / np.outer(sigma, sigma)),
    )


def _estimates(
    fit: LawFit, parameters: Parameters, findings: list[Finding]
) -> dict[str, Estimate]:
    stress = max(f.loop.stress for f in fit.loops)
    if stress > STRONGEST:
        text = "the stress is not believable: the numbers are given in the details only"
        findings.append(Finding("warning", "constitutive law", text))
        return {}
    n = sum(len(f.residual) for f in fit.loops)
    method = f"joint fit of {len(fit.loops)} loops, {fit.law} law"
    found = {
        parameter: Estimate(fit[name], fit.error({name: 1.0}), "K", method, n)
        for name, parameter in TRANSITIONS.items() if name in fit.names
    }
    for label, (parameter, common, own) in INFLUENCES.items():
        slopes = common if fit.law == "contract" else own
        if not set(slopes) <= set(fit.names):
            if set(slopes) & set(fit.fixed):
                # One stress: the error of the given C enters the stress-free temperatures.
                held = float(np.mean([f.loop.stress for f in fit.loops]))
                shift_std = held * parameters.std(parameter) / parameters[parameter] ** 2
                for name in ("A_s", "A_f") if label == "C_A" else ("M_s", "M_f"):
                    e = found[TRANSITIONS[name]]
                    found[TRANSITIONS[name]] = replace(
                        e, std=math.hypot(e.std, shift_std),
                        method=f"{method}, referred to zero stress with the given {label}",
                    )
            continue
        weights = {name: 1.0 / len(slopes) for name in slopes}
        # The secant from zero to the largest stress: with a bend there is no one slope.
        weights[f"bend_{label[-1]}"] = stress / REFERENCE_STRESS
        slope = sum(w * fit.all().get(name, 0.0) for name, w in weights.items())
        std = fit.error(weights)
        if slope <= _SIGNIFICANT * std:
            text = (
                f"{label}: temperatures change by {slope:.3g} +- {std:.2g} K per 100 MPa, not told"
            )
            findings.append(Finding("warning", label, text, {"slope": slope, "std": std}))
            continue
        value = REFERENCE_STRESS / slope
        found[parameter] = Estimate(value, value * std / slope, "Pa/K", method, n)
    if not fit.loops[0].loop.is_relative:
        s = stress / REFERENCE_STRESS
        strain, where = fit.all().get("eps_L", 0.0), method
        if "eps_L" not in fit.names:
            strain = fit["H_min"] + fit["dH"] * (1.0 - math.exp(-fit["k"] * s))
            where = f"{method}, at the largest stress {s * REFERENCE_STRESS / 1e6:.0f} MPa"
        found[_STRAIN] = Estimate(strain, fit.error(_strain_weights(fit)), "1", where, n)
        found |= _expansion_estimate(fit, parameters, method, n, findings)

    # A parameter file holds no number that is out of its range.
    within = {}
    for name, e in found.items():
        low, high = BY_NAME[name].low, BY_NAME[name].high
        if (low is None or e.value >= low) and (high is None or e.value <= high):
            within[name] = e
        else:
            text = f"{name} = {e.value:.4g} {e.unit} is out of its range, not given"
            findings.append(Finding("warning", name, text, {"value": e.value}))
    return with_scales(within, parameters)


def _strain_weights(fit: LawFit) -> dict[str, float]:
    """Derivatives of the strain at the largest stress."""
    if "eps_L" in fit.names:
        return {"eps_L": 1.0}
    s = _largest_stress(fit)
    grown = 1.0 - math.exp(-fit["k"] * s)
    return {"H_min": 1.0, "dH": grown, "k": fit["dH"] * s * (1.0 - grown)}


def _largest_stress(fit: LawFit) -> float:
    """In units of the reference."""
    return max(f.loop.stress for f in fit.loops) / REFERENCE_STRESS


def _expansion_estimate(
    fit: LawFit, parameters: Parameters, method: str, n: int, findings: list[Finding]
) -> dict[str, Estimate]:
    """Theta_T; of the extended law -alpha_M E_M, as it is below A_s."""
    if fit.law == "contract":
        value, std = fit["Theta_T"] * 1e6, fit.error({"Theta_T": 1.0}) * 1e6
    else:
        modulus = parameters["wire.martensite_modulus"]
        value = -fit["alpha_M"] * 1e-6 * modulus
        own = fit.error({"alpha_M": 1.0}) * 1e-6 * modulus
        std = math.hypot(own, value * parameters.std("wire.martensite_modulus") / modulus)
        method = f"{method}, -alpha_M E_M"
    # Thermal expansion is negative, and of the size of alpha E.
    largest = CONVECTION_FACTOR * NITI_EXPANSION[1] * _STIFFEST
    is_told = fit.law == "contract" or abs(value) > _SIGNIFICANT * std
    if is_told and -largest - std < value < 2.0 * std and std < largest:
        return {_EXPANSION: Estimate(value, std, "Pa/K", method, n)}
    text = (
        f"the slope of the martensite branch would be Theta_T = {value / 1e6:.3g} +- "
        f"{std / 1e6:.2g} MPa/K, not told apart from zero or not thermal expansion (-0.15 to "
        "-0.6 MPa/K) but martensite that reorients or transforms on; no estimate is given"
    )
    findings.append(Finding("warning", "Theta_T", text, {"value": value, "std": std}))
    return {}


def _cycle_by_cycle(
    fit: LawFit, records: Sequence[IsobaricRecord], parameters: Parameters, findings: list[Finding],
) -> dict[str, Estimate]:
    """Where cycles of one record do not fit one set of numbers, each gets its own."""
    details: dict[str, Estimate] = {}
    for record in records:
        mine = [f for f in fit.loops if f.loop.label.startswith(f"{record.name}, cycle ")]
        joint = float(np.sqrt(np.mean([f.rms**2 for f in mine])))
        if len(mine) < 3 or joint < TOLERANCE:
            continue
        errors = []
        for f in mine:
            unknowns, fixed = unknowns_of([f.loop], "extended", parameters)
            own = fit_law([f.loop], "extended", unknowns, fixed, parameters)
            errors.append(own.loops[0].rms)
            n = len(f.residual)
            for name in (*TRANSITIONS, "eps_L"):
                details[f"{f.loop.label}: {name}"] = Estimate(
                    own[name], own.error({name: 1.0}), UNITS[name], "fit of this cycle alone", n
                )
            details[f"{f.loop.label}: fit error"] = Estimate(
                errors[-1], errors[-1] / math.sqrt(2.0 * n), "1", "rms over recovered strain", n
            )
        text = (
            f"{record.name}: {joint:.1%} rms with one set of numbers for all cycles, "
            f"{min(errors):.1%} to {max(errors):.1%} with one a cycle: the material changes from "
            "cycle to cycle, which no law with constant parameters follows"
        )
        numbers = {"joint": joint, "best_cycle": min(errors), "worst_cycle": max(errors)}
        findings.append(Finding("warning", "cycles", text, numbers))
    return details


# --- Where the joint fit starts, and between which bounds it searches.

_SLOPE_BOUNDS = (-5.0, 100.0)  # K per 100 MPa: C from 1 MPa/K on
_INFLUENCE = {"A": "wire.stress_influence_austenite", "M": "wire.stress_influence_martensite"}
_RELATIVE_EXPANSION = 3000.0  # 1e-6 of the strain's range per K


def unknowns_of(
    loops: Sequence[Loop], law: Law, parameters: Parameters
) -> tuple[list[LawNumber], dict[str, float]]:
    """Unknowns with starts from the tangents, and what is fixed because the data cannot tell it.

    Raises:
        InputError: no loop shows a transformation.
    """
    # (n, 2) stress in units of the reference and K for each end; `step` likewise in strain.
    drawn: dict[str, list[tuple[float, float]]] = {}
    for loop in loops:
        branches = [
            Branch(
                "heating" if path.rising else "cooling",
                path.level, path.strain, np.full(len(path.strain), loop.stress),
            )
            for path in loop.paths
        ]
        for i, branch in enumerate(branches):
            companion = branches[1 - i] if len(branches) == 2 else None
            try:
                tangents = strain_tangents(branch, companion)
            except InputError:
                continue
            s = loop.stress / REFERENCE_STRESS
            of_branch = "A_s A_f" if branch.direction == "heating" else "M_s M_f"
            for name, (value, _) in zip(of_branch.split(), tangents.cosine_ends(), strict=True):
                drawn.setdefault(name, []).append((s, value))
            drawn.setdefault("step", []).append((s, tangents.step[0]))
    if not drawn:
        raise InputError("constitutive fit: no loop shows a transformation")
    read = {name: np.array(points) for name, points in drawn.items()}

    several = has_several_stresses(loops)
    unknowns: list[LawNumber] = []
    fixed: dict[str, float] = {}
    slopes: Mapping[str, float] = {
        phase: REFERENCE_STRESS / parameters[name] for phase, name in _INFLUENCE.items()
    }
    if max(loop.stress for loop in loops) > STRONGEST:
        # A stress beyond belief must not shift anything: temperatures stay as measured.
        slopes = dict.fromkeys(slopes, 0.0)
    for phase, ends in (("A", ("A_s", "A_f")), ("M", ("M_f", "M_s"))):
        if ends[0] not in read:
            # A direction without a branch plays no part; any numbers will do.
            words = {"A": "austenite", "M": "martensite"}[phase]
            kinds = {"s": "start", "f": "finish"}
            found = {e: parameters[f"wire.{words}_{kinds[e[-1]]}_temperature"] for e in ends}
            names = [f"slope_{phase}"] if law == "contract" else [f"slope_{e}" for e in ends]
            fixed.update({**found, **dict.fromkeys(names, slopes[phase])})
            continue
        at_zero, slope = _line(read, ends, slopes[phase] if not several else None)
        for end, value in zip(ends, at_zero, strict=True):
            unknowns.append(LawNumber(end, value, value - 80.0, value + 80.0, 4.0))
        names = [f"slope_{phase}"] if law == "contract" else [f"slope_{e}" for e in ends]
        for name in names:
            if several:
                start = float(np.clip(slope, 1.0, 90.0))
                unknowns.append(LawNumber(name, start, *_SLOPE_BOUNDS, 2.0))
            else:
                fixed[name] = slope
    unknowns.extend(_strain_unknowns(loops, law, read["step"]))
    unknowns.extend(_expansion_unknowns(loops, law))
    if law == "extended":
        fixed["T_ref"] = float(np.mean(np.concatenate([loop.temperature for loop in loops])))
    if law == "extended" and _stresses(loops) >= 3:
        unknowns.append(LawNumber("fading", 0.5, -20.0, 20.0, 0.5))
        phases = [phase for phase, end in (("A", "A_s"), ("M", "M_s")) if end in read]
        unknowns.extend(LawNumber(f"bend_{phase}", 0.0, -30.0, 30.0, 0.5) for phase in phases)
    return unknowns, fixed


def _line(
    read: Mapping[str, Array], ends: tuple[str, str], slope: float | None
) -> tuple[list[float], float]:
    """Ends at zero stress and their common slope (fitted when not given)."""
    if slope is None:
        centred = [(p[:, 0] - p[:, 0].mean(), p[:, 1] - p[:, 1].mean()) for p in
                   (read[end] for end in ends)]
        power = sum(float(s @ s) for s, _ in centred)
        slope = sum(float(s @ t) for s, t in centred) / max(power, 1e-12)
    at_zero = [float(np.median(read[end][:, 1] - slope * read[end][:, 0])) for end in ends]
    if at_zero[1] - at_zero[0] < 1.0:
        at_zero[1] = at_zero[0] + 1.0
    return at_zero, slope


def _strain_unknowns(loops: Sequence[Loop], law: Law, step: Array) -> list[LawNumber]:
    largest = max(float(np.max(np.abs(step[:, 1]))), 1e-4)
    top = max(3.0 * largest, 3.0 * max(loop.recovered for loop in loops))
    if law == "contract" or _stresses(loops) < 3:
        return [LawNumber("eps_L", largest, 0.0, top, 0.1 * largest)]
    least = max(float(np.min(np.abs(step[:, 1]))), 1e-6)
    return [
        LawNumber("H_min", 0.5 * least, 0.0, top, 0.1 * largest),
        LawNumber("dH", largest, 0.0, top, 0.1 * largest),
        LawNumber("k", 1.0, 0.01, 30.0, 0.3),
    ]


def _stresses(loops: Sequence[Loop]) -> int:
    return len(np.unique(np.round([loop.stress / 2e6 for loop in loops])))


def _expansion_unknowns(loops: Sequence[Loop], law: Law) -> list[LawNumber]:
    if law == "contract":
        relative = LawNumber("Theta_T", 0.0, -1e4, 1e4, 10.0)
        return [relative if loops[0].is_relative else LawNumber("Theta_T", -0.2, -50.0, 50.0, 0.2)]
    start, limit, size = 8.0, 200.0, 5.0
    if loops[0].is_relative:
        start, limit, size = 0.0, _RELATIVE_EXPANSION * 10.0, _RELATIVE_EXPANSION
    return [LawNumber(name, start, -limit, limit, size) for name in ("alpha_A", "alpha_M")]
