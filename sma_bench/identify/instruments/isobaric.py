"""E6: UPFR and isobaric tests: eps_L, the transition temperatures of eqs. (10), (11), C_A and C_M.

Heating and cooling under constant stress. The cosine of every branch gives the temperatures that a
simulation takes; tangents (practice of ASTM F2082 and E3097) cross inside its range and stand
beside it under their own names, as tables and the paper have them. One stress gives the
temperatures at that stress; several give their stress-free values and C_A, C_M.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import mean_of_repeats
from sma_bench.identify.instruments.stress_temperature import (
    SMALLEST_STRESS_RANGE,
    BranchCosine,
    Points,
    TransitionLines,
    diagram_curves,
    fit_cosine,
    fit_transition_lines,
    stress_range,
)
from sma_bench.identify.instruments.tangents import StrainTangents, strain_tangents
from sma_bench.identify.result import Experiment
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.records.isobaric import STRONGEST, Branch, IsobaricRecord

# --- Readings of isobaric tests, grouped by stress.

PHASES = {
    # direction: (start, finish, C) with their parameters
    "heating": (
        ("A_s", "wire.austenite_start_temperature"),
        ("A_f", "wire.austenite_finish_temperature"),
        ("C_A", "wire.stress_influence_austenite"),
    ),
    "cooling": (
        ("M_s", "wire.martensite_start_temperature"),
        ("M_f", "wire.martensite_finish_temperature"),
        ("C_M", "wire.stress_influence_martensite"),
    ),
}
_SAME_STRESS = 0.03
# What no test shows by itself: class 1 of IEC 60584 is 1.5 K, and a wire in a chamber or under a
# camera follows its thermometer by some seconds, which has the other sign on the way back.
THERMOMETER_STD, LAG_STD = 0.9, 0.7  # K
GAUGE = "sensor.deflection.gain"
Convention = Literal["cosine", "tangent"]


@dataclass(frozen=True)
class BranchReading:
    """The tangents and the cosine of one branch."""

    record: IsobaricRecord
    cycle: int
    branch: Branch
    tangents: StrainTangents
    cosine: BranchCosine

    def ends(self, convention: Convention) -> tuple[tuple[float, float], tuple[float, float]]:
        """Start and finish, (value, std) each in K."""
        drawn = self.cosine if convention == "cosine" else self.tangents
        return drawn.start, drawn.finish


@dataclass(frozen=True)
class Level:
    """All readings at one stress (Pa)."""

    stress: float
    readings: tuple[BranchReading, ...]

    def along(self, direction: str) -> tuple[BranchReading, ...]:
        """Those of one direction."""
        return tuple(r for r in self.readings if r.branch.direction == direction)


def mean_and_deviation(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of repeats and their deviation (as the paper gives them), not below the reading error.

    Args:
        values: (value, std of the single reading) of each repeat.
    """
    value = np.array([v for v, _ in values])
    reading = math.sqrt(float(np.mean([s**2 for _, s in values])) / len(values))
    deviation = float(np.std(value, ddof=1)) if len(value) > 1 else 0.0
    return float(value.mean()), max(deviation, reading)


# --- the experiment

NAME = "E6"
TITLE = "UPFR and isobaric tests (Fig. 8)"
RECOVERABLE_STRAIN = "wire.maximum_recoverable_strain"
_MODULI = ("wire.martensite_modulus", "wire.austenite_modulus")
_ELASTIC = "elastic part"
_EXPANSION = "wire.thermal_expansion_factor"


def identify_isobaric(
    records: Sequence[IsobaricRecord], parameters: Parameters | None = None,
) -> Experiment:
    """Evaluate isobaric tests of one material.

    Args:
        records: one a stress or several; cycles and records at the same stress are repeats, of
            which mean and deviation are given.
        parameters: moduli for the elastic part of the strain, and C_A, C_M to refer a single
            stress to zero; the table's when None.

    Returns:
        Estimates of the stress-free ends of the cosines of eqs. (10), (11), C_A, C_M (several
        stresses) and eps_L (the largest); `details` per stress and cycle, the tangents' crossings
        as "A_s (tangent) ..."; `curves` of the branches with tangents and cosine
        (`<record>/<cycle>/<direction>/temperature`, `/strain`, `/tangents` (4, 2) and `/cosine`
        (n, 2) K and strain) and of the stress-temperature diagram (`diagram/A_s/stress`, ...).

    Raises:
        InputError: no records, or no branch with a transformation.
    """
    parameters = parameters or Parameters.defaults()
    if not records:
        raise InputError("isobaric test: no records")
    findings = [finding for record in records for finding in record.findings]

    # Tangents and cosine of every branch; one without a transformation becomes a finding.
    readings: list[BranchReading] = []
    for record in records:
        believable = record.strain_unit == "1" and record.stress <= STRONGEST
        stress = record.stress if believable else 0.0
        for cycle in record.cycles:
            for branch in cycle.branches:
                other = cycle.get("cooling" if branch.direction == "heating" else "heating")
                try:
                    tangents = strain_tangents(branch, other)
                except InputError as error:
                    text = f"{record.name}, cycle {cycle.number}: {error}"
                    findings.append(Finding("warning", "tangents", text))
                else:
                    cosine = fit_cosine(branch, tangents, parameters, stress)
                    readings.append(BranchReading(record, cycle.number, branch, tangents, cosine))
    if not readings:
        raise InputError(f"{records[0].path}: no branch shows a transformation")

    # Readings at the same stress together, in order of stress.
    groups: list[list[BranchReading]] = []
    for reading in sorted(readings, key=lambda r: r.record.stress):
        stress = reading.record.stress
        if groups and abs(stress - groups[-1][0].record.stress) <= max(_SAME_STRESS * stress, 1e6):
            groups[-1].append(reading)
        else:
            groups.append([reading])
    levels = [Level(float(np.mean([r.record.stress for r in g])), tuple(g)) for g in groups]

    points = _points(levels, "cosine")
    estimates, details = _temperatures(points, levels, parameters, findings)
    beside, _ = _temperatures(_points(levels, "tangent"), levels, parameters, [])
    method = "tangents, referred to zero stress: inside the range of eqs. (10), (11)"
    for phase in PHASES.values():
        details |= {
            f"{name} (tangent), stress free": replace(beside[parameter], method=method)
            for name, parameter in phase[:2] if parameter in beside
        }
    strains, strain_details = _strains(levels, parameters, findings)
    details |= _details(levels) | strain_details
    findings.extend(about_branches(records, readings))
    curves = {}
    for r in readings:
        key = f"{r.record.name}/{r.cycle}/{r.branch.direction}"
        curves[f"{key}/temperature"] = r.branch.temperature
        curves[f"{key}/strain"] = r.branch.strain
        curves[f"{key}/tangents"] = r.tangents.polyline(r.branch)
        curves[f"{key}/cosine"] = np.column_stack([r.cosine.temperature, r.cosine.strain])
    return Experiment(
        NAME, TITLE, with_scales(estimates | strains, parameters), tuple(findings),
        curves | diagram_curves(points), "; ".join(str(record.path) for record in records), details,
    )


def with_scales(
    estimates: dict[str, Estimate], parameters: Parameters
) -> dict[str, Estimate]:
    """The same with what thermometer, gauge length and section are off by."""
    shares: dict[str, dict[str, float]] = {}
    section = 2.0 * diameter_error(parameters)
    for sign, phase in zip((1.0, -1.0), PHASES.values(), strict=True):
        for _, name in phase[:2]:
            shares[name] = {"thermometer": THERMOMETER_STD, "lag": -sign * LAG_STD}
        if phase[2][1] in estimates:
            shares[phase[2][1]] = {"wire.diameter": -section * estimates[phase[2][1]].value}
    if RECOVERABLE_STRAIN in estimates:
        strain = estimates[RECOVERABLE_STRAIN].value
        shares[RECOVERABLE_STRAIN] = {GAUGE: parameters.std(GAUGE) * strain}
    return {n: e.with_shares({**e.shares, **shares.get(n, {})}) for n, e in estimates.items()}


def diameter_error(parameters: Parameters) -> float:
    """Relative, of the diameter by which a testing machine told stress: the stated one's, else what
    a careful lab knows it to."""
    name = "wire.diameter"
    if name in parameters.given:
        return parameters.std(name) / parameters[name]
    return (BY_NAME[name].uncertainty or 0.0) / parameters[name]


def _points(levels: Sequence[Level], convention: Convention) -> dict[str, Points]:
    """A_s, A_f, M_s, M_f against stress."""
    points = {}
    for direction, phase in PHASES.items():
        driven = [(level.stress, level.along(direction)) for level in levels]
        for end, (name, _) in enumerate(phase[:2]):
            repeats = [
                (stress, [r.ends(convention)[end] for r in along])
                for stress, along in driven if along
            ]
            # Cycles differ at one stress as at the other: all of them tell by how much.
            freedom = sum(len(c) - 1 for _, c in repeats)
            squares = sum(len(c) * float(np.var([v for v, _ in c])) for _, c in repeats)
            scatter = squares / freedom if freedom else None
            found = [(stress, *mean_of_repeats(c, scatter, freedom)) for stress, c in repeats]
            stress, value, own, common = np.array(found, dtype=np.float64).reshape(-1, 4).T
            points[name] = Points(stress, value, np.hypot(own, common), common)
    return points


def _temperatures(
    points: dict[str, Points], levels: Sequence[Level], parameters: Parameters,
    findings: list[Finding],
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Stress-free temperatures, C_A and C_M, and the slope of each temperature by itself."""
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    if levels[-1].stress > STRONGEST:
        text = (
            f"stress {levels[-1].stress / 1e6:.0f} MPa is not believable: temperatures are given "
            "as measured, not referred to zero stress"
        )
        findings.append(Finding("warning", "transition temperatures", text))
        return estimates, details
    for direction, phase in PHASES.items():
        names, (label, influence) = [name for name, _ in phase[:2]], phase[2]
        ends = [points[name] for name in names]
        n = sum(len(r.branch.strain) for level in levels for r in level.along(direction))
        if not n:
            listed = ", ".join((*names, label))
            text = f"no {direction} branch: {listed} are not identified"
            findings.append(Finding("info", listed, text))
        elif stress_range(ends) >= SMALLEST_STRESS_RANGE:
            lines = fit_transition_lines(ends)
            method = f"cosines at {len(ends[0].stress)} stresses, line to zero stress"
            for (name, parameter), at_zero, slope in zip(
                phase[:2], lines.at_zero, lines.own_slopes, strict=True
            ):
                estimates[parameter] = Estimate(*at_zero, "K", method, n)
                what = "line through this transition alone"
                details[f"d{name}/dsigma"] = Estimate(*slope, "K/Pa", what, n)
            findings.extend(about_lines(label, names, lines))
            if lines.is_significant:
                low, high = ends[0].stress.min() / 1e6, ends[0].stress.max() / 1e6
                method = f"common slope of {' and '.join(names)} over {low:.0f} to {high:.0f} MPa"
                estimates[influence] = lines.influence(method, n)
        else:
            c, doubt = parameters[influence], parameters.std(influence)
            stress = float(ends[0].stress.mean())
            shift, shift_std = stress / c, stress * doubt / c**2
            text = (
                f"tests at {stress / 1e6:.3g} MPa alone do not give {label}; temperatures are "
                f"referred to zero stress by -{shift:.2f} K with {label} = {c / 1e6:.3g} +- "
                f"{doubt / 1e6:.2g} MPa/K"
                + (", which nobody stated" if influence not in parameters.given else "")
            )
            findings.append(Finding("info", label, text, {"stress": stress, "shift": shift}))
            method = f"cosine at {stress / 1e6:.3g} MPa, referred to zero stress with {label}"
            for (_, parameter), p in zip(phase[:2], ends, strict=True):
                value, std = float(p.value.mean()) - shift, float(p.std.mean())
                estimate = Estimate(value, std, "K", method, n)
                estimates[parameter] = estimate.with_shares({influence: shift_std})
    return estimates, details


def _strains(
    levels: Sequence[Level], parameters: Parameters, findings: list[Finding]
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """eps_L of the contract and the recovered strain at each stress."""
    details: dict[str, Estimate] = {}
    transformed: list[tuple[float, Estimate]] = []
    for level in levels:
        readings = level.along("heating") or level.along("cooling")
        is_relative = readings[0].record.strain_unit != "1"
        value, *errors = mean_of_repeats([r.cosine.step for r in readings])
        std = math.hypot(*errors)
        n = sum(len(r.branch.strain) for r in readings)
        unit = "relative" if is_relative else "1"
        details[f"recovered strain at {level.stress / 1e6:.0f} MPa"] = Estimate(
            value, std, unit, "distance of the outer lines half-way", n
        )
        if is_relative or level.stress > STRONGEST:
            continue
        # Strain by which martensite gives more than austenite at this stress and temperature.
        middle = float(np.mean([r.cosine.start[0] + r.cosine.finish[0] for r in readings])) / 2
        warmer = middle - parameters["environment.ambient_temperature"]
        stress = level.stress - parameters[_EXPANSION] * warmer
        soft, stiff = (stress / parameters[name] for name in _MODULI)
        of_soft, of_stiff = (parameters.std(name) / parameters[name] for name in _MODULI)
        expansion = parameters.std(_EXPANSION) * warmer * (soft - stiff) / stress if stress else 0.0
        elastic_std = math.hypot(soft * of_soft, stiff * of_stiff, expansion)
        estimate = Estimate(
            value - (soft - stiff), std, "1",
            f"recovered strain at {level.stress / 1e6:.3g} MPa less "
            "[sigma - Theta_T (T - T_inf)] (1/E_M - 1/E_A)", n,
        ).with_shares({_ELASTIC: elastic_std})
        transformed.append((level.stress, estimate))
        details[f"eps_L at {level.stress / 1e6:.0f} MPa"] = estimate
    if not transformed:
        return {}, details
    findings.extend(about_strains(transformed, parameters))
    largest = max((estimate for _, estimate in transformed), key=lambda e: e.value)
    return ({RECOVERABLE_STRAIN: largest} if largest.value > 0.0 else {}), details


def _details(levels: Sequence[Level]) -> dict[str, Estimate]:
    """Every transition temperature at its stress, by both conventions, and by cycle."""
    details = {}
    for level in levels:
        for direction, phase in PHASES.items():
            readings = level.along(direction)
            if not readings:
                continue
            n = sum(len(r.branch.strain) for r in readings)
            for end, (name, _) in enumerate(phase[:2]):
                for convention in ("tangent", "cosine"):
                    what = f"{convention}, {len(readings)} readings: mean and deviation"
                    mean = mean_and_deviation([r.ends(convention)[end] for r in readings])
                    key = f"{name} ({convention}) at {level.stress / 1e6:.0f} MPa"
                    details[key] = Estimate(*mean, "K", what, n)
                for r in readings if len(readings) > 1 else ():
                    details[f"{name}, {r.record.name}, cycle {r.cycle}, {direction}"] = Estimate(
                        *r.ends("tangent")[end], "K", "tangent", len(r.branch.strain)
                    )
    return details


# --- Remarks on isobaric tests.

_SIGNIFICANT = 3.0
_GAP = 0.4
_FEWEST_CYCLES = 4
_TREND = 0.8
_SMALLEST_DRIFT = 3.0  # K
_ROUGH = 0.02
_CLIPPED = 20
_ENDS = (("cold", "M_f", "A_s"), ("hot", "M_s", "A_f"))


def about_branches(
    records: Sequence[IsobaricRecord], readings: Sequence[BranchReading]
) -> list[Finding]:
    """Strain that is clipped, branches turned round early or logged with gaps, no cosines, and
    cycles that are no repeats."""
    findings = []
    # Strain that stays at its extreme to the last digit: the extensometer has no more travel.
    for record in records:
        strain = np.concatenate([b.strain for c in record.cycles for b in c.branches])
        for extreme, word in ((strain.max(), "highest"), (strain.min(), "lowest")):
            longest = max(
                (len(run) for run in np.split(strain, np.flatnonzero(np.diff(strain)) + 1)
                 if run[0] == extreme), default=0,
            )
            if longest >= _CLIPPED:
                text = (
                    f"{record.name}: the strain stays at its {word}, {extreme:.5g}, for {longest} "
                    "readings: the extensometer ends, and what is beyond is not seen"
                )
                findings.append(Finding("warning", "strain", text, {"value": float(extreme)}))

    early: dict[tuple[str, str, str], list[int]] = {}
    rough: dict[str, list[BranchReading]] = {}
    for r in readings:
        for side, on_cooling, on_heating in _ENDS:
            if getattr(r.tangents, f"{side}_is_short"):
                name = on_cooling if r.branch.direction == "cooling" else on_heating
                early.setdefault((r.record.name, name, side), []).append(r.cycle)
        if r.cosine.rms > _ROUGH:
            rough.setdefault(r.branch.direction, []).append(r)
        width, gap = abs(r.tangents.finish[0] - r.tangents.start[0]), r.tangents.widest_gap
        if gap > max(_GAP * width, 3.0):
            text = (
                f"{r.record.name}, cycle {r.cycle}: on {r.branch.direction} temperature jumps by "
                f"{gap:.1f} K within the {width:.1f} K of the transformation: too fast for the "
                "logging, or heat of transformation"
            )
            findings.append(Finding("warning", "temperature", text, {"gap": gap}))
    for (where, name, side), cycles in early.items():
        text = (
            f"{where}: no straight stretch at the {side} end in cycle "
            f"{', '.join(map(str, cycles))}, so the transformation may not be complete there; "
            f"{name} is drawn with the other branch's slope and is a bound"
        )
        findings.append(Finding("warning", name, text, {"cycles": float(len(cycles))}))
    for direction, found in rough.items():
        worst = max(found, key=lambda r: r.cosine.rms)
        text = (
            f"{len(found)} {direction} branches are no cosine of eqs. (10), (11): it leaves up to "
            f"{worst.cosine.rms:.1%} of the strain ({worst.record.name}); given are the ends of "
            "the nearest one, their errors hold how far the choice of points moves them"
        )
        findings.append(Finding("warning", "cosine", text, {"rms": worst.cosine.rms}))

    # Temperatures that drift from cycle to cycle of one record are no repeats.
    for record in {r.record.name: r.record for r in readings}.values():
        for direction, phase in PHASES.items():
            mine = [r for r in readings if r.record is record and r.branch.direction == direction]
            if len(mine) < _FEWEST_CYCLES:
                continue
            cycle = np.array([float(r.cycle) for r in mine])
            for end, (name, _) in enumerate(phase[:2]):
                ends = np.array([r.ends("tangent")[end][0] for r in mine])
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
            Finding(
                "warning", f"{label}, {', '.join(names)}", text,
                {"misfit": lines.misfit, "worst": lines.worst},
            )
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
    # The same moduli stand behind both.
    moduli = most.shares[_ELASTIC] - least.shares[_ELASTIC]
    error = math.hypot(most.statistical, least.statistical, moduli)
    if most.value - least.value > _SIGNIFICANT * error:
        table = ", ".join(f"{e.value:.2%} at {s / 1e6:.0f} MPa" for s, e in transformed)
        text = (
            f"the transformation strain grows with stress ({table}), as in material that is not "
            "trained: a constant eps_L does not suffice, see the joint fit's eps_L(sigma); the "
            "largest is given"
        )
        numbers = {f"{s / 1e6:.0f} MPa": e.value for s, e in transformed}
        findings.append(Finding("warning", "eps_L", text, numbers))
    elastic = high * (1.0 / parameters[_MODULI[0]] - 1.0 / parameters[_MODULI[1]])
    if not set(_MODULI) <= parameters.given and elastic > 0.02 * most.value:
        text = (
            f"the elastic part {elastic:.2%} of the strain at {high / 1e6:.0f} MPa rests on the "
            "table's moduli, not on this material's: give E_M and E_A from tensile tests"
        )
        findings.append(Finding("warning", "eps_L", text, {"elastic": elastic}))
    return findings
