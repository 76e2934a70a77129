"""Remarks on isobaric tests."""

from collections.abc import Sequence

import numpy as np

from sma_bench.findings import Finding
from sma_bench.identify.estimate import Estimate
from sma_bench.identify.instruments.isobaric_levels import PHASES, Reading
from sma_bench.identify.instruments.stress_temperature import TransitionLines
from sma_bench.parameters import Parameters

_SIGNIFICANT = 3.0
_GAP = 0.4
_FEWEST_CYCLES = 4
_TREND = 0.8
_SMALLEST_DRIFT = 3.0  # K
_ENDS = (("cold", "M_f", "A_s"), ("hot", "M_s", "A_f"))


def about_tangents(readings: Sequence[Reading]) -> list[Finding]:
    """Branches turned round early, and temperature that jumps within the transformation."""
    findings = []
    early: dict[tuple[str, str, str], list[int]] = {}
    for r in readings:
        for side, on_cooling, on_heating in _ENDS:
            if getattr(r.tangents, f"{side}_is_short"):
                name = on_cooling if r.branch.direction == "cooling" else on_heating
                early.setdefault((r.record.name, name, side), []).append(r.cycle)
        width = abs(r.tangents.finish[0] - r.tangents.start[0])
        gap = r.tangents.widest_gap
        if gap > max(_GAP * width, 3.0):
            text = (
                f"{r.record.name}, cycle {r.cycle}: on {r.branch.direction} temperature jumps by "
                f"{gap:.1f} K within the {width:.1f} K of the transformation: too fast for the "
                "logging, or heat of transformation"
            )
            findings.append(Finding("warning", "temperature", text, {"gap": gap}))
    for (record, name, side), cycles in early.items():
        text = (
            f"{record}: no straight stretch at the {side} end in cycle "
            f"{', '.join(map(str, cycles))}, so the transformation may not be complete there; "
            f"{name} is drawn with the other branch's slope and is a bound"
        )
        findings.append(Finding("warning", name, text, {"cycles": float(len(cycles))}))
    return findings


def about_training(readings: Sequence[Reading]) -> list[Finding]:
    """Temperatures that drift from cycle to cycle of one record are no repeats."""
    findings = []
    for record in {r.record.name: r.record for r in readings}.values():
        for direction, phase in PHASES.items():
            mine = [r for r in readings if r.record is record and r.branch.direction == direction]
            if len(mine) < _FEWEST_CYCLES:
                continue
            for end, (name, _) in enumerate(phase[:2]):
                ends = np.array([r.ends("tangent")[end][0] for r in mine])
                cycle = np.array([float(r.cycle) for r in mine])
                correlation = float(np.corrcoef(cycle, ends)[0, 1])
                if abs(correlation) < _TREND or np.ptp(ends) < _SMALLEST_DRIFT:
                    continue
                text = (
                    f"{record.name}: {name} drifts from {ends[0]:.1f} K in cycle {mine[0].cycle} "
                    f"to {ends[-1]:.1f} K in cycle {mine[-1].cycle}: the material still trains, "
                    "so the deviation is that drift and not the error of repeats"
                )
                numbers = {"first": float(ends[0]), "last": float(ends[-1])}
                findings.append(Finding("warning", name, text, numbers))
    return findings


def about_lines(label: str, names: Sequence[str], lines: TransitionLines) -> list[Finding]:
    """Whether one straight line each, with one slope, describes the temperatures."""
    findings = []
    slope, std = lines.slope
    if not lines.is_significant:
        text = (
            f"{names[0]} and {names[1]} change by {slope * 1e6:.3g} +- {std * 1e6:.2g} K/MPa: no "
            f"rise with stress that is worth a {label}"
        )
        findings.append(Finding("warning", label, text, {"slope": slope, "std": std}))
    if lines.misfit > _SIGNIFICANT:
        text = (
            f"{' and '.join(names)} lie up to {lines.worst:.1f} K off their lines against stress "
            f"(misfit {lines.misfit:.1f}): a constant {label} is a rough description here"
        )
        findings.append(
            Finding("warning", label, text, {"misfit": lines.misfit, "worst": lines.worst})
        )
    (first, first_std), (last, last_std) = lines.own_slopes
    apart = abs(first - last)
    if apart > _SIGNIFICANT * (first_std**2 + last_std**2) ** 0.5:
        text = (
            f"{names[0]} changes by {first * 1e6:.3g}, {names[1]} by {last * 1e6:.3g} K/MPa: the "
            f"range widens with stress, which one {label} cannot say"
        )
        findings.append(Finding("info", label, text, {"start": first, "finish": last}))
    return findings


def about_strains(
    transformed: Sequence[tuple[float, Estimate]], parameters: Parameters
) -> list[Finding]:
    """Whether one eps_L describes all stresses, and whose moduli the elastic part rests on."""
    findings = []
    (_, least), (high, most) = transformed[0], transformed[-1]
    if most.value - least.value > _SIGNIFICANT * (most.std**2 + least.std**2) ** 0.5:
        table = ", ".join(f"{e.value:.2%} at {s / 1e6:.0f} MPa" for s, e in transformed)
        text = (
            f"the transformation strain grows with stress ({table}), as in material that is not "
            "trained: a constant eps_L does not suffice, see the joint fit's eps_L(sigma); the "
            "largest is given"
        )
        numbers = {f"{s / 1e6:.0f} MPa": e.value for s, e in transformed}
        findings.append(Finding("warning", "eps_L", text, numbers))
    names = ("wire.martensite_modulus", "wire.austenite_modulus")
    elastic = high * (1.0 / parameters[names[0]] - 1.0 / parameters[names[1]])
    if not set(names) <= parameters.given and elastic > 0.02 * most.value:
        text = (
            f"the elastic part {elastic:.2%} of the strain at {high / 1e6:.0f} MPa rests on the "
            "table's moduli, not on this material's: give E_M and E_A from tensile tests"
        )
        findings.append(Finding("warning", "eps_L", text, {"elastic": elastic}))
    return findings


def referred_to_zero(label: str, stress: float, shift: float, influence: float) -> Finding:
    """A single stress needs C to become stress free."""
    text = (
        f"tests at {stress / 1e6:.3g} MPa alone do not give {label}; temperatures are referred to "
        f"zero stress by -{shift:.2f} K with {label} = {influence / 1e6:.3g} MPa/K"
    )
    return Finding("info", label, text, {"stress": stress, "shift": shift})


def no_branch(direction: str) -> Finding:
    """A direction that was not measured."""
    names = "A_s, A_f, C_A" if direction == "heating" else "M_s, M_f, C_M"
    return Finding("info", names, f"no {direction} branch: {names} are not identified")


def not_stress_free(stress: float) -> Finding:
    """Stress beyond belief cannot shift temperatures."""
    text = (
        f"stress {stress / 1e6:.0f} MPa is not believable, so the temperatures are given as "
        "measured and not referred to zero stress"
    )
    return Finding("warning", "transition temperatures", text, {"stress": stress})
