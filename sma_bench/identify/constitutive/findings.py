"""Remarks on the joint fit of the constitutive law."""

from collections.abc import Sequence

import numpy as np

from sma_bench.findings import Finding, Severity
from sma_bench.identify.constitutive.fit import STARTS, LawFit
from sma_bench.identify.estimate import Estimate
from sma_bench.parameters.audit import CONVECTION_FACTOR, NITI_EXPANSION

_STRONG = 0.9
_STIFFEST = 90e9
_IRRECOVERABLE = 0.02


def errors_by_stress(fit: LawFit) -> dict[float, float]:
    """Root mean square residual over the recovered strain, by stress in Pa."""
    stresses = sorted({f.loop.stress for f in fit.loops})
    return {
        stress: float(np.sqrt(np.mean([f.rms**2 for f in fit.loops if f.loop.stress == stress])))
        for stress in stresses
    }


def about_fits(fits: Sequence[LawFit], tolerance: float) -> list[Finding]:
    """The error of each law at each stress, and whether the contract's constant eps_L suffices."""
    findings = []
    for fit in fits:
        errors = errors_by_stress(fit)
        worst = max(errors.values())
        table = ", ".join(f"{e:.1%} at {s / 1e6:.0f} MPa" for s, e in errors.items())
        text = f"{fit.law} law: rms residual over the recovered strain {table}"
        if worst >= tolerance:
            text += f"; above {tolerance:.0%}"
            text += (
                ": a constant eps_L and constant C_A, C_M do not suffice for this material"
                if fit.law == "contract" and len(errors) > 1
                else ""
            )
        numbers = {f"{s / 1e6:.0f} MPa": e for s, e in errors.items()}
        severity: Severity = "warning" if worst >= tolerance else "info"
        findings.append(Finding(severity, "fit error", text, numbers))
    return findings


def about_numbers(fit: LawFit) -> list[Finding]:
    """Bounds, starts, correlations and irrecoverable strain of the fit that is given."""
    findings = []
    if fit.at_bound:
        text = f"{', '.join(fit.at_bound)} stopped at a bound of the search: not identified"
        findings.append(Finding("warning", "bounds", text))
    if fit.starts_agreeing < STARTS:
        text = f"{fit.starts_agreeing} of {STARTS} starts ended at the same minimum, the lowest"
        findings.append(Finding("info", "starts", text, {"agreeing": float(fit.starts_agreeing)}))
    slopes = {name: value for name, value in fit.fixed.items() if name != "T_ref"}
    if slopes:
        given = ", ".join(f"{name} = {value:.4g}" for name, value in slopes.items())
        text = f"{given} were taken as given: these tests do not tell them"
        findings.append(Finding("info", "fixed", text, slopes))
    pairs = {
        f"{fit.names[i]}, {fit.names[j]}": float(fit.correlation[i, j])
        for i in range(len(fit.names))
        for j in range(i)
    }
    strong = {pair: c for pair, c in pairs.items() if abs(c) > _STRONG}
    text = "no two unknowns correlate by more than 0.9"
    if strong:
        listed = "; ".join(f"{pair} {c:+.2f}" for pair, c in strong.items())
        text = f"the data hardly tell apart {listed}"
    findings.append(Finding("info", "correlation", text, pairs))
    left = {f.loop.label: f.irrecoverable / f.loop.recovered for f in fit.loops}
    large = {label: share for label, share in left.items() if abs(share) > _IRRECOVERABLE}
    if large:
        listed = ", ".join(f"{share:.0%} in {label}" for label, share in large.items())
        text = f"strain left after the loop, over the recovered one: {listed}"
        findings.append(Finding("info", "irrecoverable strain", text, large))
    return findings


def cycles_differ(name: str, joint: float, errors: Sequence[float]) -> Finding:
    """One set of numbers for all cycles against one a cycle."""
    text = (
        f"{name}: {joint:.1%} rms with one set of numbers for all cycles, "
        f"{min(errors):.1%} to {max(errors):.1%} with one a cycle: the material changes from "
        "cycle to cycle, which no law with constant parameters follows"
    )
    numbers = {"joint": joint, "best_cycle": min(errors), "worst_cycle": max(errors)}
    return Finding("warning", "cycles", text, numbers)


def no_influence(label: str, slope: float, std: float) -> Finding:
    """A slope that is not worth an inverse."""
    text = f"{label}: temperatures change by {slope:.3g} +- {std:.2g} K per 100 MPa, not told"
    return Finding("warning", label, text, {"slope": slope, "std": std})


def is_plausible_expansion(value: float, std: float) -> bool:
    """Whether Theta_T (Pa/K) may be thermal expansion: negative, and of the size of alpha E."""
    largest = CONVECTION_FACTOR * NITI_EXPANSION[1] * _STIFFEST
    return -largest - std < value < 2.0 * std and std < largest


def implausible_expansion(value: float, std: float) -> Finding:
    """A slope of the branches that is no thermal expansion, or none that can be told."""
    text = (
        f"the slope of the martensite branch would be Theta_T = {value / 1e6:.3g} +- "
        f"{std / 1e6:.2g} MPa/K, not told apart from zero or not thermal expansion (-0.15 to "
        "-0.6 MPa/K) but martensite that reorients or transforms on; no estimate is given"
    )
    return Finding("warning", "Theta_T", text, {"value": value, "std": std})


def out_of_range(name: str, estimate: Estimate) -> Finding:
    """A number that no parameter file may hold."""
    text = f"{name} = {estimate.value:.4g} {estimate.unit} is out of its range, not given"
    return Finding("warning", name, text, {"value": estimate.value})
