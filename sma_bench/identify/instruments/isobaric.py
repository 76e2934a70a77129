"""E6: UPFR and isobaric tests: eps_L, transition temperatures by tangents, C_A and C_M.

Heating and cooling under constant stress; tangents by the practice of ASTM F2082 and E3097. One
stress gives the temperatures at that stress; several give their stress-free values and C_A, C_M.
"""

import math
from collections.abc import Sequence

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments import isobaric_findings as remarks
from sma_bench.identify.instruments.isobaric_levels import (
    PHASES,
    Convention,
    Level,
    Reading,
    group_levels,
    mean_and_deviation,
    read_tangents,
)
from sma_bench.identify.instruments.stress_temperature import (
    SMALLEST_STRESS_RANGE,
    Points,
    diagram_curves,
    fit_transition_lines,
    stress_range,
)
from sma_bench.parameters import Parameters
from sma_bench.records.isobaric import STRONGEST, IsobaricRecord

NAME = "E6"
TITLE = "UPFR and isobaric tests (Fig. 8)"
RECOVERABLE_STRAIN = "wire.maximum_recoverable_strain"


def identify_isobaric(
    records: Sequence[IsobaricRecord],
    parameters: Parameters | None = None,
    *,
    temperatures: Convention = "tangent",
) -> Experiment:
    """Evaluate isobaric tests of one material.

    Args:
        records: one a stress or several; cycles and records at the same stress are repeats, of
            which mean and deviation are given.
        parameters: moduli for the elastic part of the strain, and C_A, C_M to refer a single
            stress to zero; the table's when None.
        temperatures: what the estimates of A_s, A_f, M_s, M_f are: where the tangents cross
            ("tangent", the standards' and the paper's use), or the ends of the cosine of eqs. (10)
            and (11) with the same steepest slope ("cosine"), which lie further out.

    Returns:
        Estimates of the stress-free temperatures, C_A, C_M (several stresses) and eps_L (the
        largest); `details` per stress and cycle; `curves` of the branches with their tangents
        (`<record>/<cycle>/<direction>/temperature`, `/strain`, `/tangents` (4, 2) K and strain)
        and of the stress-temperature diagram (`diagram/A_s/stress`, ...).

    Raises:
        InputError: no records, or no branch with a transformation.
    """
    parameters = parameters or Parameters.defaults()
    if not records:
        raise InputError("isobaric test: no records")
    findings = [finding for record in records for finding in record.findings]
    readings = read_tangents(records, findings)
    levels = group_levels(readings)
    points = {
        name: _points(levels, direction, end, temperatures)
        for direction, phase in PHASES.items()
        for end, (name, _) in enumerate(phase[:2])
    }
    estimates, details = _temperatures(points, levels, parameters, temperatures, findings)
    strains, strain_details = _strains(levels, parameters, findings)
    details.update(_details(levels))
    findings.extend(remarks.about_tangents(readings))
    findings.extend(remarks.about_training(readings))
    return Experiment(
        name=NAME,
        title=TITLE,
        estimates={**estimates, **strains},
        details={**details, **strain_details},
        findings=tuple(findings),
        curves={**_curves(readings), **diagram_curves(points)},
        source="; ".join(str(record.path) for record in records),
    )


def _points(levels: Sequence[Level], direction: str, end: int, convention: Convention) -> Points:
    found = []
    for level in levels:
        repeats = [r.ends(convention)[end] for r in level.along(direction)]
        if repeats:
            found.append((level.stress, *mean_and_deviation(repeats)))
    stress, value, std = (np.array(column) for column in zip(*found, strict=True)) if found else (
        np.empty(0), np.empty(0), np.empty(0)
    )
    return Points(stress, value, std)


def _temperatures(
    points: dict[str, Points],
    levels: Sequence[Level],
    parameters: Parameters,
    convention: Convention,
    findings: list[Finding],
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    if levels[-1].stress > STRONGEST:
        findings.append(remarks.not_stress_free(levels[-1].stress))
        return estimates, details
    for direction, phase in PHASES.items():
        ends = [points[name] for name, _ in phase[:2]]
        n = sum(len(r.branch.strain) for level in levels for r in level.along(direction))
        if not n:
            findings.append(remarks.no_branch(direction))
        elif stress_range(ends) >= SMALLEST_STRESS_RANGE:
            found, more = _several_stresses(phase, ends, n, convention, findings)
            estimates.update(found)
            details.update(more)
        else:
            estimates.update(_one_stress(phase, ends, n, parameters, convention, findings))
    return estimates, details


def _several_stresses(
    phase: Sequence[tuple[str, str]],
    ends: Sequence[Points],
    n: int,
    convention: Convention,
    findings: list[Finding],
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    lines = fit_transition_lines(ends)
    method = f"{convention}s at {len(ends[0].stress)} stresses, line to zero stress"
    found = {
        parameter: Estimate(*at_zero, "K", method, n)
        for (_, parameter), at_zero in zip(phase[:2], lines.at_zero, strict=True)
    }
    details = {
        f"d{name}/dsigma": Estimate(*slope, "K/Pa", "line through this transition alone", n)
        for (name, _), slope in zip(phase[:2], lines.own_slopes, strict=True)
    }
    label, parameter = phase[2]
    findings.extend(remarks.about_lines(label, [name for name, _ in phase[:2]], lines))
    if lines.is_significant:
        found[parameter] = lines.influence(
            f"common slope of {phase[0][0]} and {phase[1][0]} over "
            f"{ends[0].stress.min() / 1e6:.0f} to {ends[0].stress.max() / 1e6:.0f} MPa",
            n,
        )
    return found, details


def _one_stress(
    phase: Sequence[tuple[str, str]],
    ends: Sequence[Points],
    n: int,
    parameters: Parameters,
    convention: Convention,
    findings: list[Finding],
) -> dict[str, Estimate]:
    label, parameter = phase[2]
    influence, doubt = parameters[parameter], parameters.std(parameter)
    stress = float(ends[0].stress.mean())
    shift, shift_std = stress / influence, stress * doubt / influence**2
    findings.append(remarks.referred_to_zero(label, stress, shift, influence))
    return {
        name: Estimate(
            float(p.value.mean()) - shift, math.hypot(float(p.std.mean()), shift_std), "K",
            f"{convention} at {stress / 1e6:.3g} MPa, referred to zero stress with {label}", n,
        )
        for (_, name), p in zip(phase[:2], ends, strict=True)
    }


def _strains(
    levels: Sequence[Level], parameters: Parameters, findings: list[Finding]
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """eps_L of the contract and the recovered strain at each stress."""
    details: dict[str, Estimate] = {}
    transformed: list[tuple[float, Estimate]] = []
    for level in levels:
        readings = level.along("heating") or level.along("cooling")
        is_relative = readings[0].record.strain_unit != "1"
        value, std = mean_and_deviation([r.tangents.step for r in readings])
        n = sum(len(r.branch.strain) for r in readings)
        unit = "relative" if is_relative else "1"
        details[f"recovered strain at {level.stress / 1e6:.0f} MPa"] = Estimate(
            value, std, unit, "distance of the outer tangents half-way", n
        )
        if is_relative or level.stress > STRONGEST:
            continue
        elastic, elastic_std = _elastic_step(level.stress, parameters)
        estimate = Estimate(
            value - elastic, math.hypot(std, elastic_std), "1",
            f"recovered strain at {level.stress / 1e6:.3g} MPa less sigma (1/E_M - 1/E_A)", n,
        )
        transformed.append((level.stress, estimate))
        details[f"eps_L at {level.stress / 1e6:.0f} MPa"] = estimate
    if not transformed:
        return {}, details
    findings.extend(remarks.about_strains(transformed, parameters))
    largest = max((estimate for _, estimate in transformed), key=lambda e: e.value)
    return ({RECOVERABLE_STRAIN: largest} if largest.value > 0.0 else {}), details


def _elastic_step(stress: float, parameters: Parameters) -> tuple[float, float]:
    """Strain by which martensite is softer than austenite at this stress, and its error."""
    names = ("wire.martensite_modulus", "wire.austenite_modulus")
    soft, stiff = (stress / parameters[name] for name in names)
    doubts = [parameters.std(name) / parameters[name] for name in names]
    return soft - stiff, math.hypot(soft * doubts[0], stiff * doubts[1])


def _details(levels: Sequence[Level]) -> dict[str, Estimate]:
    """Every transition temperature at its stress, by both conventions, and by cycle."""
    details = {}
    for level in levels:
        for direction, phase in PHASES.items():
            readings = level.along(direction)
            n = sum(len(r.branch.strain) for r in readings)
            for end, (name, _) in enumerate(phase[:2]):
                for convention in ("tangent", "cosine"):
                    values = [r.ends(convention)[end] for r in readings]
                    if not values:
                        continue
                    what = f"{convention}, {len(values)} readings: mean and deviation"
                    key = f"{name} ({convention}) at {level.stress / 1e6:.0f} MPa"
                    details[key] = Estimate(*mean_and_deviation(values), "K", what, n)
                for r, value in _repeats(readings, end):
                    details[f"{name}, {_label(r)}"] = Estimate(
                        *value, "K", "tangent", len(r.branch.strain)
                    )
    return details


def _repeats(
    readings: Sequence[Reading], end: int
) -> list[tuple[Reading, tuple[float, float]]]:
    if len(readings) < 2:
        return []
    return [(r, r.ends("tangent")[end]) for r in readings]


def _label(reading: Reading) -> str:
    return f"{reading.record.name}, cycle {reading.cycle}, {reading.branch.direction}"


def _curves(readings: Sequence[Reading]) -> dict[str, Array]:
    curves = {}
    for r in readings:
        key = f"{r.record.name}/{r.cycle}/{r.branch.direction}"
        curves[f"{key}/temperature"] = r.branch.temperature
        curves[f"{key}/strain"] = r.branch.strain
        curves[f"{key}/tangents"] = r.tangents.polyline(r.branch)
    return curves
