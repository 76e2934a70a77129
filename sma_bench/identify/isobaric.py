"""E6: UPFR and isobaric tests: eps_L, the transition temperatures of eqs. (10), (11), C_A and C_M.

A cosine fitted to every heating and cooling gives the temperatures that a simulation takes; those
of tangents, which lie inside its range, go to the details. Tests at several stresses give
stress-free temperatures and C_A, C_M (Clausius and Clapeyron)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.rig import find_rig
from sma_bench.findings import Finding
from sma_bench.identify import branches, fits
from sma_bench.identify.branches import BranchCosine, Number, StrainTangents
from sma_bench.identify.fits import GAUGE, MODULI, SYMBOLS, fit_linear, mean_of_repeats
from sma_bench.identify.result import Experiment, remark
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.parameters.parameters import wire_length
from sma_bench.physics.bending import channel_section
from sma_bench.records import instruments
from sma_bench.records.instruments import Branch, IsobaricRecord
from sma_bench.records.record import Record, samples

# Start, finish and stress influence by direction.
PHASES = {"heating": ("A_s", "A_f", "C_A"), "cooling": ("M_s", "M_f", "C_M")}
STRAIN, EXPANSION = SYMBOLS["eps_L"], SYMBOLS["Theta_T"]
# Systematic: a thermocouple (1.5 K in class 1 of IEC 60584); a lag, of opposite sign on cooling.
_THERMOMETER_STD, _LAG_STD = 0.9, 0.7  # K
SMALLEST_STRESS_RANGE = 5e6  # Pa
_SAME_STRESS = 0.03  # share by which stresses of repeats may differ
_ELASTIC = "elastic part"
_SIGNIFICANT = 3.0  # standard errors
_SMALLEST_STD = 0.3  # K, accuracy of a thermocouple: least error of a temperature
_RISES = 2.0  # standard errors: least slope against stress that gives a C
_FEWEST_CYCLES, _TREND, _SMALLEST_DRIFT = 4, 0.8, 3.0  # of a drift: cycles, correlation, K
_ROUGH = 0.02  # rms residual of a cosine over the strain step
_CLIPPED = 20  # equal readings at an extreme
_SHORTEST_TEST = 10.0  # s, of a load held by a frame
Convention = Literal["tangent", "cosine"]


class Reading(NamedTuple):
    """The tangents and the cosine of one branch."""

    record: IsobaricRecord
    cycle: int
    branch: Branch
    tangents: StrainTangents
    cosine: BranchCosine

    def ends(self, convention: Convention) -> tuple[Number, Number]:
        """Start and finish in K."""
        drawn = self.cosine if convention == "cosine" else self.tangents
        return drawn.start, drawn.finish


Level = tuple[float, dict[str, list[Reading]]]  # stress in Pa, and its readings by direction
Estimates = dict[str, Estimate]


def identify_isobaric(records: Sequence[IsobaricRecord], parameters: Parameters) -> Experiment:
    """Evaluate isobaric tests of one material; cycles and records at the same stress are repeats.
    `details` holds every stress and cycle; `curves` the branches (`<record>/<cycle>/<direction>/`
    `temperature`, `strain`, `tangents` (4, 2), `cosine` (n, 2), K and strain) and the diagram
    (`diagram/A_s/stress`, ...). `parameters`: moduli for the elastic strain; C_A, C_M to refer a
    single stress to zero. InputError: no branch shows a transformation."""
    findings = [finding for record in records for finding in record.findings]
    readings: list[Reading] = []
    for record in records:
        plausible = record.strain_unit == "1" and record.stress <= instruments.STRONGEST
        stress = record.stress if plausible else 0.0
        for cycle, branch in ((c, b) for c in record.cycles for b in c.branches):
            other = cycle.get("cooling" if branch.direction == "heating" else "heating")
            try:
                tangents = branches.strain_tangents(branch, other)
            except InputError as error:
                findings.append(remark("no tangents", record=record.name, cycle=cycle.number,
                                       error=error))
                continue
            cosine = branches.fit_cosine(branch, tangents, parameters, stress)
            readings.append(Reading(record, cycle.number, branch, tangents, cosine))
    if not readings:
        raise InputError(f"{records[0].path}: no branch shows a transformation")
    groups: list[list[Reading]] = []
    for reading in sorted(readings, key=lambda r: r.record.stress):
        stress = reading.record.stress
        if groups and abs(stress - groups[-1][0].record.stress) <= max(_SAME_STRESS * stress, 1e6):
            groups[-1].append(reading)
        else:
            groups.append([reading])
    levels = [(float(np.mean([r.record.stress for r in group])),
               {way: [r for r in group if r.branch.direction == way] for way in PHASES})
              for group in groups]
    estimates, details, diagram = _temperatures(levels, "cosine", parameters, findings)
    crossings = _temperatures(levels, "tangent", parameters, [])[0]
    method = "tangents, referred to zero stress: inside the range of eqs. (10), (11)"
    details |= {f"{symbol} (tangent), stress free": replace(crossings[name], method=method)
                for symbol, name in TRANSITIONS.items() if name in crossings}
    for stress, along in levels:
        for way, found in ((way, found) for way, found in along.items() if found):
            for end, name in enumerate(PHASES[way][:2]):
                for convention in get_args(Convention):
                    mean = fits.mean_and_deviation([r.ends(convention)[end] for r in found])
                    words = f"{convention}, {len(found)} readings: mean and deviation"
                    label = f"{name} ({convention}) at {stress / 1e6:.0f} MPa"
                    details[label] = Estimate(*mean, "K", words, _points(found))
                for r in found if len(found) > 1 else ():
                    label = f"{name}, {r.record.name}, cycle {r.cycle}, {way}"
                    details[label] = Estimate(*r.ends("tangent")[end], "K", "tangent", _points([r]))
    estimates |= _strains(levels, parameters, details, findings)
    findings.extend(_about_branches(records, readings))
    curves: dict[str, Array] = {}
    for r in readings:
        shown = {"temperature": r.branch.temperature, "strain": r.branch.strain,
                 "tangents": r.tangents.polyline(r.branch),
                 "model": np.interp(r.branch.temperature, r.cosine.temperature, r.cosine.strain),
                 "cosine": np.column_stack([r.cosine.temperature, r.cosine.strain])}
        stem = f"{r.record.name}/{r.cycle}/{r.branch.direction}"
        curves |= {f"{stem}/{kind}": curve for kind, curve in shown.items()}
    for name, points in diagram.items():
        named = zip(("stress", "temperature", "std"), points, strict=False)
        curves |= {f"diagram/{name}/{kind}": curve for kind, curve in named}
    return Experiment("E6", "UPFR and isobaric tests (Fig. 8)", with_scales(estimates, parameters),
                      tuple(findings), curves, "; ".join(str(r.path) for r in records), details)


def _points(readings: Sequence[Reading]) -> int:
    return sum(len(r.branch.strain) for r in readings)


def isobaric_tests(record: Record, parameters: Parameters) -> tuple[IsobaricRecord, ...]:
    """The loops of a load-frame bag as isobaric tests, one per held load; stress is the force over
    the section of all wires. InputError without a drive, temperature or elongation."""
    rig = find_rig(record, parameters)
    time, elongation = samples(record, "elongation")
    kelvin = np.interp(time, *samples(record, f"{rig.channels[0]}.temperature"))
    length, tests = wire_length(parameters), []
    for hold in rig.holds:
        inside = (time >= hold.start) & (time <= hold.stop)
        short = hold.clamped or hold.stop - hold.start < _SHORTEST_TEST
        if short or np.ptp(kelvin[inside]) < instruments.SMALLEST_RANGE:
            continue
        stress, strain = hold.value / channel_section(parameters), elongation[inside] / length
        name, held = f"{record.path.name} {stress / 1e6:.0f} MPa", np.full(len(strain), stress)
        cycles, remarks = instruments.find_cycles(kelvin[inside], strain, held, name)
        tests.append(IsobaricRecord(record.path, name, stress, "1", tuple(cycles), tuple(remarks)))
    return tuple(tests)


def with_scales(estimates: Mapping[str, Estimate], parameters: Parameters) -> dict[str, Estimate]:
    """The same with systematic errors of thermometer, gauge length and section."""
    shares: dict[str, dict[str, float]] = {}
    section = 2.0 * fits.diameter_error(parameters)
    for sign, (*ends, label) in zip((1.0, -1.0), PHASES.values(), strict=True):
        for symbol in ends:
            shares[SYMBOLS[symbol]] = {"thermometer": _THERMOMETER_STD, "lag": -sign * _LAG_STD}
        if SYMBOLS[label] in estimates:
            value = estimates[SYMBOLS[label]].value
            shares[SYMBOLS[label]] = {"wire.diameter": -section * value}
    if STRAIN in estimates:
        shares[STRAIN] = {GAUGE: parameters.std(GAUGE) * estimates[STRAIN].value}
    return {n: e.with_shares({**e.shares, **shares.get(n, {})}) for n, e in estimates.items()}


def _temperatures(levels: Sequence[Level], convention: Convention, parameters: Parameters,
                  findings: list[Finding]) -> tuple[Estimates, Estimates, dict[str, Array]]:
    """Stress-free temperatures, C_A and C_M; the slope of each temperature alone; A_s ... M_f over
    stress, (4, n): Pa, K, error in K, and its part that start and finish have in common."""
    estimates, details, points = dict[str, Estimate](), dict[str, Estimate](), dict[str, Array]()
    plausible = levels[-1][0] <= instruments.STRONGEST
    if not plausible:
        findings.append(remark("implausible stress", stress=levels[-1][0]))
    for direction, (start, finish, label) in PHASES.items():
        pair, influence = (start, finish), SYMBOLS[label]
        shown = [(stress, along[direction]) for stress, along in levels if along[direction]]
        for end, name in enumerate(pair):
            repeats = [(stress, [r.ends(convention)[end] for r in own]) for stress, own in shown]
            # The scatter between cycles is taken to be the same at all stresses.
            freedom = sum(len(c) - 1 for _, c in repeats)
            squares = sum(len(c) * float(np.var([v for v, _ in c])) for _, c in repeats)
            between = squares / freedom if freedom else None
            each = [(stress, *mean_of_repeats(c, between, freedom)) for stress, c in repeats]
            stress, value, own, common = np.array(each, dtype=np.float64).reshape(-1, 4).T
            points[name] = np.array([stress, value, np.hypot(own, common), common])
        if not plausible:
            continue
        if not shown:
            listed = f"{start}, {finish}, {label}"
            findings.append(remark("no branch", subject=listed, direction=direction))
            continue
        n, stress = sum(_points(own) for _, own in shown), points[start][0]
        if float(np.ptp(stress)) < SMALLEST_STRESS_RANGE:
            # One stress: referred to zero with the given C.
            c, c_std, held = parameters[influence], parameters.std(influence), float(stress.mean())
            unstated = "" if influence in parameters.given else " (not stated)"
            findings.append(remark("one stress", subject=label, stress=held,
                                   shift=held / c, c=c, c_std=c_std, unstated=unstated))
            method = f"cosine at {held / 1e6:.3g} MPa, referred to zero stress with {label}"
            for name in pair:
                _, kelvin, std, _ = points[name].mean(axis=1).tolist()
                number = Estimate(kelvin - held / c, std, "K", method, n)
                estimates[SYMBOLS[name]] = number.with_shares({influence: held * c_std / c**2})
            continue
        # Several: T = T_0 + sigma/C, one slope for both; their scatter is partly common.
        both = np.hstack([points[name] for name in pair])
        value, std, common = both[1], np.maximum(both[2], _SMALLEST_STD), both[3]
        scale = float(np.max(np.abs(stress)))
        zero, along_stress = np.repeat(np.eye(2), len(stress), axis=0), both[0] / scale
        together = (both[0][:, None] == both[0]) & (zero @ zero.T == 0.0)
        covariance = np.diag(std**2) + np.where(together, np.outer(common, common), 0.0)
        fit = fit_linear(np.column_stack([zero, along_stress]), value, covariance)
        slope, slope_std = float(fit.beta[2]) / scale, float(fit.std[2]) / scale
        method, alone = f"cosines at {len(stress)} stresses, line to zero stress", []
        for k, name in enumerate(pair):
            part = zero[:, k] > 0.0
            design = np.column_stack([np.ones(part.sum()), along_stress[part]])
            line = fit_linear(design, value[part], np.diag(std[part] ** 2))
            alone.append((float(line.beta[1]) / scale, float(line.std[1]) / scale))
            words = "line through this transition alone"
            details[f"d{name}/dsigma"] = Estimate(*alone[k], "K/Pa", words, n)
            at_zero = float(fit.beta[k]), float(fit.std[k])
            estimates[SYMBOLS[name]] = Estimate(*at_zero, "K", method, n)
        facts: dict[str, Any] = {"start": start, "finish": finish, "label": label}
        if slope > _RISES * slope_std:
            # C = 1/slope; its error is the mean of both sides of a 90 % interval.
            relative = slope_std / slope
            sides = 1.0 - (1.645 * min(relative, 1.0 / _RISES)) ** 2
            low, high = stress.min() / 1e6, stress.max() / 1e6
            words = f"common slope of {start} and {finish} over {low:.0f} to {high:.0f} MPa"
            c = 1.0 / slope, relative / (slope * sides)
            estimates[influence] = Estimate(*c, "Pa/K", words, n)
        else:
            findings.append(remark("no rise", subject=label, slope=slope, std=slope_std, **facts))
        if fit.misfit > _SIGNIFICANT:
            listed, worst = f"{label}, {start}, {finish}", float(np.max(np.abs(fit.residuals)))
            findings.append(remark("off the line", subject=listed, misfit=fit.misfit, worst=worst,
                                   **facts))
        (first, first_std), (last, last_std) = alone
        if abs(first - last) > _SIGNIFICANT * math.hypot(first_std, last_std):
            findings.append(remark("range widens", subject=label, first=first, last=last, **facts))
    return estimates, details, points


def _strains(levels: Sequence[Level], parameters: Parameters, details: dict[str, Estimate],
             findings: list[Finding]) -> dict[str, Estimate]:
    """eps_L of the contract; the recovered strain at each stress goes into `details`."""
    transformed: list[tuple[float, Estimate]] = []
    for held, along in levels:
        readings = along["heating"] or along["cooling"]
        is_relative = readings[0].record.strain_unit != "1"
        value, *errors = mean_of_repeats([r.cosine.step for r in readings])
        std, n = math.hypot(*errors), _points(readings)
        unit, words = "relative" if is_relative else "1", "distance of the outer lines half-way"
        details[f"recovered strain at {held / 1e6:.0f} MPa"] = Estimate(value, std, unit, words, n)
        if is_relative or held > instruments.STRONGEST:
            continue
        # Elastic and thermal strain of martensite beyond that of austenite.
        middle = float(np.mean([r.cosine.start[0] + r.cosine.finish[0] for r in readings])) / 2
        warmer = middle - parameters["environment.ambient_temperature"]
        stress = held - parameters[EXPANSION] * warmer
        soft, stiff = (stress / parameters[name] for name in MODULI)
        of_soft, of_stiff = (parameters.std(name) / parameters[name] for name in MODULI)
        expansion = parameters.std(EXPANSION) * warmer * (soft - stiff) / stress if stress else 0.0
        elastic_std = math.hypot(soft * of_soft, stiff * of_stiff, expansion)
        method = (f"recovered strain at {held / 1e6:.3g} MPa less "
                  "[sigma - Theta_T (T - T_inf)] (1/E_M - 1/E_A)")
        number = Estimate(value - (soft - stiff), std, "1", method, n)
        transformed.append((held, number.with_shares({_ELASTIC: elastic_std})))
        details[f"eps_L at {held / 1e6:.0f} MPa"] = transformed[-1][1]
    if not transformed:
        return {}
    # Does one eps_L describe all stresses? The moduli's error is common: its difference counts.
    (_, least), (high, most) = transformed[0], transformed[-1]
    moduli = most.shares[_ELASTIC] - least.shares[_ELASTIC]
    error = math.hypot(most.statistical, least.statistical, moduli)
    if most.value - least.value > _SIGNIFICANT * error:
        table = ", ".join(f"{e.value:.2%} at {s / 1e6:.0f} MPa" for s, e in transformed)
        numbers = {f"{s / 1e6:.0f} MPa": e.value for s, e in transformed}
        findings.append(remark("strain grows with stress", numbers=numbers, table=table))
    elastic = high * (1.0 / parameters[MODULI[0]] - 1.0 / parameters[MODULI[1]])
    if not set(MODULI) <= parameters.given and elastic > 0.02 * most.value:
        findings.append(remark("moduli of the table", elastic=elastic, stress=high))
    largest = max((number for _, number in transformed), key=lambda e: e.value)
    return {STRAIN: largest} if largest.value > 0.0 else {}


def _about_branches(records: Sequence[IsobaricRecord],
                    readings: Sequence[Reading]) -> Iterator[Finding]:
    """Clipped strain, branches reversed early or unlike a cosine, cycles that drift."""
    for record in records:
        strain = np.concatenate([b.strain for c in record.cycles for b in c.branches])
        runs = np.split(strain, np.flatnonzero(np.diff(strain)) + 1)
        for value, which in ((strain.max(), "highest"), (strain.min(), "lowest")):
            longest = max((len(run) for run in runs if run[0] == value), default=0)
            if longest >= _CLIPPED:
                yield remark("strain clipped", record=record.name, which=which, value=value,
                             count=longest)
    early, rough = dict[tuple[str, str, str], list[int]](), dict[str, list[Reading]]()
    for r in readings:
        colder_first = ("M_f", "M_s") if r.branch.direction == "cooling" else ("A_s", "A_f")
        for short, side, name in zip(r.tangents.short, ("cold", "hot"), colder_first, strict=True):
            if short:
                early.setdefault((r.record.name, name, side), []).append(r.cycle)
        if r.cosine.rms > _ROUGH:
            rough.setdefault(r.branch.direction, []).append(r)
    for (where, name, side), cycles in early.items():
        yield remark("reversed early", subject=name, record=where, side=side,
                     numbers={"cycles": float(len(cycles))}, cycles=", ".join(map(str, cycles)))
    for direction, found in rough.items():
        worst = max(found, key=lambda r: r.cosine.rms)
        yield remark("not a cosine", count=len(found), direction=direction, rms=worst.cosine.rms,
                     record=worst.record.name)
    # Temperatures that drift from cycle to cycle of one record.
    for record in {r.record.name: r.record for r in readings}.values():
        for direction, (*ends, _) in PHASES.items():
            mine = [r for r in readings if r.record is record and r.branch.direction == direction]
            cycle = np.array([float(r.cycle) for r in mine])
            for end, name in enumerate(ends if len(mine) >= _FEWEST_CYCLES else ()):
                kelvin = np.array([r.ends("tangent")[end][0] for r in mine])
                correlation = float(np.corrcoef(cycle, kelvin)[0, 1])
                if abs(correlation) >= _TREND and np.ptp(kelvin) >= _SMALLEST_DRIFT:
                    yield remark("cycles drift", subject=name, record=record.name,
                                 first=kelvin[0], first_cycle=mine[0].cycle, last=kelvin[-1],
                                 last_cycle=mine[-1].cycle)
