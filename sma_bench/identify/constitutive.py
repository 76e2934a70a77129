"""E9 on isobaric tests: one constitutive law fitted to all loops of a material at once.

    eps = eps_ref + sigma/E(xi) - Theta_T (T - T_inf)/E(xi) - eps_L (1 - xi)

are eqs. (6) to (11) under constant stress, cosines shifted by sigma/C_A and sigma/C_M: the law
"contract". The law "extended" changes what does not hold for untrained material:

- eps_L becomes H(sigma) = H_min + dH (1 - exp(-k sigma)) (Lagoudas, Shape memory alloys, 2008);
- A_s ... M_f each have a slope, and each direction a bend, T = T_0 + slope sigma + bend sigma^2;
- thermal expansion is alpha_A + xi (alpha_M - alpha_A), instead of one Theta_T over E(xi);
- martensite's strain decreases with temperature, H (1 - fading (T - T_ref));
- irrecoverable strain grows with the fraction transformed (Lagoudas and Entchev, 2004).

eps_ref, free in every loop, and irrecoverable strain enter linearly and are eliminated exactly."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import inflation
from sma_bench.findings import Finding
from sma_bench.identify.branches import Bins, strain_tangents
from sma_bench.identify.fits import MODULI, SYMBOLS
from sma_bench.identify.isobaric import SMALLEST_STRESS_RANGE, with_scales
from sma_bench.identify.result import Correlation, Experiment, remark
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.parameters.parameters import CONVECTION_FACTOR, NITI_EXPANSION
from sma_bench.progress import Report, part, silent
from sma_bench.records.instruments import STRONGEST, Branch, Cycle, IsobaricRecord

Law = Literal["contract", "extended"]
# Transition temperatures of a direction, the lower one first.
_ENDS = {"heating": ("A_s", "A_f"), "cooling": ("M_f", "M_s")}
_REFERENCE_STRESS = 100e6  # Pa, unit of stress within the fit
_TOLERANCE = 0.05  # rms residual over the recovered strain up to which a law is good enough
_STARTS, _SEED = 5, 7
_BINS = 150  # of a branch
_NARROWEST = 0.2  # K, least width of a transformation
_AT_BOUND = 1e-3  # of the range between the bounds
_SIGNIFICANT = 2.0  # standard errors
_STIFFEST = 90e9  # Pa, largest modulus of any NiTi
_UNITS = {**dict.fromkeys(TRANSITIONS, "K"), "eps_L": "1", "H_min": "1", "dH": "1",
          "k": "1/(100 MPa)", "alpha_A": "1e-6/K", "alpha_M": "1e-6/K", "Theta_T": "MPa/K",
          "fading": "1e-3/K", "bend_A": "K/(100 MPa)^2", "bend_M": "K/(100 MPa)^2"}
_TIMES: dict[Law, tuple[float, float]] = {"contract": (0.0, 0.2), "extended": (0.2, 1.0)}


class Loop(NamedTuple):
    """One cycle at one stress."""

    label: str
    stress: float  # Pa
    branches: tuple[tuple[Branch, Bins], ...]  # in order, each with its temperature bins
    temperature: Array  # (n,) K, means over the bins
    strain: Array  # (n,)
    ends: dict[str, float]  # A_s ... M_f in K, by the tangents
    steps: dict[str, float]  # of strain, by direction
    recovered: float  # strain by heating, the unit of residuals
    is_relative: bool


def loop_of(record: IsobaricRecord, cycle: Cycle) -> Loop:
    branches, ends, steps = [], dict[str, float](), dict[str, float]()
    for branch in cycle.branches:
        way, rising = branch.direction, branch.direction == "heating"
        branches.append((branch, Bins.of(branch.temperature, _BINS, rising)))
        with suppress(InputError):
            found = strain_tangents(branch, cycle.get("cooling" if rising else "heating"))
            ends.update(zip(_ENDS[way], sorted(found.cosine_ends()), strict=True))
            steps[way] = found.step[0]
    kelvin = np.concatenate([bins.mean(b.temperature) for b, bins in branches])
    strain = np.concatenate([bins.mean(b.strain) for b, bins in branches])
    recovered = steps.get("heating", steps.get("cooling", 0.0))
    return Loop(f"{record.name}, cycle {cycle.number}", record.stress, tuple(branches), kelvin,
                strain, ends, steps, recovered if recovered > 0.0 else float(np.ptp(strain)),
                record.strain_unit != "1")


class LawFit(NamedTuple):
    """The fitted law: unknowns (p,) in K, strain, 1e-6/K, MPa/K (Theta_T), per 100 MPa (slopes,
    k); `fixed`: numbers that the data do not determine; `residuals`: (n,) of each loop."""

    law: Law
    names: tuple[str, ...]
    values: Array
    covariance: Array
    at_bound: tuple[str, ...]
    fixed: dict[str, float]
    loops: tuple[Loop, ...]
    residuals: tuple[Array, ...]

    @property
    def errors(self) -> dict[float, float]:
        """Rms residual over the recovered strain of the loops at each stress [Pa]."""
        each: dict[float, list[float]] = {}
        for loop, own in zip(self.loops, self.residuals, strict=True):  # in order of stress
            each.setdefault(loop.stress, []).append(float(np.mean(own**2)) / loop.recovered**2)
        return {stress: float(np.sqrt(np.mean(squares))) for stress, squares in each.items()}


def fit_constitutive(records: Sequence[IsobaricRecord], parameters: Parameters,
                     report: Report = silent) -> Experiment:
    """Fit the law to all stresses and cycles of one material at once: the contract's where its rms
    is below 5 % of the recovered strain at every stress, else the extended one. `details`: every
    fitted number and the fit error per stress; `curves`: `<record, cycle>/temperature`, `/strain`,
    `/model`. `parameters`: E_A and E_M, which isobaric tests cannot tell from eps_L; C_A, C_M for
    tests at one stress. InputError: no records, or too few points."""
    if not records:
        raise InputError("constitutive fit: no records")
    every = (loop_of(record, cycle) for record in records for cycle in record.cycles)
    loops, fits = sorted(every, key=lambda loop: loop.stress), list[LawFit]()
    for law, shares in _TIMES.items():
        fits.append(_fit_law(loops, law, parameters, part(report, *shares)))
        if max(fits[-1].errors.values()) < _TOLERANCE:
            break
    chosen = fits[-1]
    findings = [*(f for record in records for f in record.findings), *_about_fits(fits)]
    details = {}
    for fit in fits:
        n, std = sum(map(len, fit.residuals)), np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
        for name, value, error in zip(fit.names, fit.values.tolist(), std.tolist(), strict=True):
            unit = _UNITS.get(name, "K/(100 MPa)")  # of a slope
            details[f"{fit.law}: {name}"] = Estimate(value, error, unit, "joint fit", n)
        for stress, error in fit.errors.items():
            n = sum(len(loop.strain) for loop in loops if loop.stress == stress)
            details[f"{fit.law}: fit error at {stress / 1e6:.0f} MPa"] = Estimate(
                error, error / math.sqrt(2.0 * n), "1", "rms over recovered strain", n)
    estimates, correlation = _estimates(chosen, parameters, findings)
    curves: dict[str, Array] = {}
    for loop, own in zip(loops, chosen.residuals, strict=True):
        shown = {"temperature": loop.temperature, "strain": loop.strain,
                 "model": loop.strain - own}
        curves |= {f"{loop.label}/{kind}": values for kind, values in shown.items()}
    return Experiment("E9", "Joint fit of the constitutive law (eqs. 6 to 11)", estimates,
                      tuple(findings), curves, "; ".join(str(record.path) for record in records),
                      details, correlation)


def _grown(p: Mapping[str, float], s: float) -> float:
    """Transformation strain at the stress s, in units of the reference."""
    if "k" not in p:
        return p["eps_L"]
    return p["H_min"] + p["dH"] * (1.0 - math.exp(-p["k"] * max(s, 0.0)))


def _slopes(law: Law, ends: Sequence[str]) -> list[str]:
    """Names of the slopes against stress of two transitions."""
    return [f"slope_{ends[0][0]}"] * 2 if law == "contract" else [f"slope_{end}" for end in ends]


def _strain(law: Law, p: Mapping[str, float], loop: Loop,
            elastic: tuple[float, float, float]) -> tuple[Array, Array]:
    """Strain (n,) without its linear unknowns, and their columns (n, 1 or 2): reference strain and,
    in the extended law, fraction transformed so far. `elastic`: E_A, E_M [Pa] and T_inf [K]."""
    (stiff, soft, ambient), s = elastic, loop.stress / _REFERENCE_STRESS
    grown, strains, columns, transformed = _grown(p, s), [], [], 0.0
    xi_reversed = 1.0 if loop.branches[0][0].direction == "heating" else 0.0
    for branch, bins in loop.branches:
        rising, t, ends = branch.direction == "heating", branch.temperature, _ENDS[branch.direction]
        bend = p.get(f"bend_{ends[0][0]}", 0.0) * s**2
        low, high = (p[e] + p[n] * s + bend for e, n in zip(ends, _slopes(law, ends), strict=True))
        width = max(high - low, _NARROWEST)
        remaining = 0.5 + 0.5 * np.cos(np.pi * np.clip((t - low) / width, 0.0, 1.0))
        if not rising:  # eq. (11) gives martensite; what remains on cooling is austenite
            remaining = 1.0 - remaining
        share = remaining / remaining[0] if remaining[0] > 1e-9 else remaining
        xi = xi_reversed * share if rising else 1.0 - (1.0 - xi_reversed) * share
        xi_reversed = float(xi[-1])
        modulus = stiff + xi * (soft - stiff)
        strain = -grown * (1.0 - xi)
        if not loop.is_relative:
            strain = strain + loop.stress / modulus
        if law == "contract":
            strain = strain - p["Theta_T"] * 1e6 * (t - ambient) / modulus
        else:
            expansion = p["alpha_A"] + xi * (p["alpha_M"] - p["alpha_A"])
            fading = p.get("fading", 0.0) * 1e-3 * (t - p["T_ref"])
            strain = strain + expansion * 1e-6 * (t - ambient) - grown * xi * fading
        strains.append(bins.mean(strain))
        progress = transformed + np.abs(xi - xi[0])
        transformed = float(progress[-1])
        columns.append(np.column_stack([np.ones(len(strains[-1])), bins.mean(progress)]))
    return np.concatenate(strains), np.concatenate(columns)[:, : 1 if law == "contract" else 2]


def _fit_law(loops: Sequence[Loop], law: Law, parameters: Parameters,
             report: Report = silent) -> LawFit:
    """Fit one law to all loops, residuals in units of the recovered strain. Errors include
    correlated scatter and the uncertainty of E_A and E_M."""
    from scipy.optimize import least_squares  # half a second to load
    unknowns, fixed = _unknowns(loops, law, parameters)
    total = sum(len(loop.strain) for loop in loops)
    if total <= 2 * len(unknowns):
        raise InputError(f"{total} points for {len(unknowns)} unknowns of the {law} law")
    names = tuple(unknowns)
    first, low, high, size = np.array(list(unknowns.values())).T
    soft, stiff = (parameters[name] for name in MODULI)
    ambient = parameters["environment.ambient_temperature"]

    def residual_of(x: Array, loop: Loop, moduli: tuple[float, float] = (stiff, soft)) -> Array:
        p = fixed | dict(zip(names, x.tolist(), strict=True))
        strain, columns = _strain(law, p, loop, (*moduli, ambient))
        columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
        rest = loop.strain - strain
        return np.asarray(rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0])

    def residuals(x: Array, moduli: tuple[float, float] = (stiff, soft)) -> Array:
        return np.concatenate([residual_of(x, loop, moduli) / loop.recovered for loop in loops])

    rng = np.random.default_rng(_SEED)
    margin, solutions = 1e-6 * (high - low), []
    for k in range(_STARTS):
        report(k / _STARTS, f"{law} law, start {k + 1} of {_STARTS}")
        start = first + size * rng.standard_normal(len(first)) if k else first
        solutions.append(least_squares(residuals, np.clip(start, low + margin, high - margin),
                                       bounds=(low, high), x_scale=size, max_nfev=300))
    x = min(solutions, key=lambda s: s.cost).x
    found = tuple(residual_of(x, loop) for loop in loops)
    # Sandwich covariance: each loop with its own scatter, all with one autocorrelation.
    sides = [(np.minimum(x + step, high), np.maximum(x - step, low))
             for step in np.diag(1e-3 * size)]
    jacobian = np.column_stack([(residuals(up) - residuals(down)) / (up - down)[i]
                                for i, (up, down) in enumerate(sides)])
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    pieces, freedom = list[Array](), total / (total - len(names) - 2 * len(loops))
    for loop, own in zip(loops, found, strict=True):
        ends = np.cumsum([int(bins.which.max()) + 1 for _, bins in loop.branches])[:-1]
        pieces.extend(np.split(own / loop.recovered, ends))
    correlated, meat = inflation(pieces), np.zeros_like(bread)
    begins = np.cumsum([len(own) for own in found])[:-1]
    for loop, own, rows in zip(loops, found, np.split(jacobian, begins), strict=True):
        meat += correlated * freedom * np.mean(own**2) / loop.recovered**2 * (rows.T @ rows)
    covariance = bread @ meat @ bread
    # Contribution of the uncertainty of E_A and E_M.
    for name, moved in zip(MODULI, ((stiff, 1.001 * soft), (1.001 * stiff, soft)), strict=True):
        step = 1e-3 * parameters[name]
        slope = -bread @ jacobian.T @ ((residuals(x, moved) - residuals(x)) / step)
        covariance += np.outer(slope, slope) * parameters.std(name) ** 2
    near = np.minimum(x - low, high - x) < _AT_BOUND * (high - low)
    at_bound = tuple(name for name, is_near in zip(names, near, strict=True) if is_near)
    return LawFit(law, names, x, covariance, at_bound, fixed, tuple(loops), found)


def _unknowns(loops: Sequence[Loop], law: Law, parameters: Parameters,
              ) -> tuple[dict[str, tuple[float, float, float, float]], dict[str, float]]:
    """Start (by the tangents), bounds and typical size of every unknown; and the fixed numbers."""
    steps = np.abs([step for loop in loops for step in loop.steps.values()])
    if not len(steps):
        raise InputError("constitutive fit: no loop shows a transformation")
    stress = np.array([loop.stress for loop in loops])
    several = float(np.ptp(stress)) >= SMALLEST_STRESS_RANGE
    bends = law == "extended" and len(np.unique(np.round(stress / 2e6))) >= 3
    unknowns, fixed = dict[str, tuple[float, float, float, float]](), dict[str, float]()
    for ends in _ENDS.values():
        slopes, influence = _slopes(law, ends), SYMBOLS[f"C_{ends[0][0]}"]
        # An implausible stress must not shift temperatures: they stay as measured.
        slope = _REFERENCE_STRESS / parameters[influence] if stress.max() <= STRONGEST else 0.0
        read = [(loop.stress / _REFERENCE_STRESS, *(loop.ends[end] for end in ends))
                for loop in loops if ends[0] in loop.ends]
        if not read:
            # Without a branch in this direction, these numbers have no effect.
            fixed |= {n: parameters[TRANSITIONS[n]] for n in ends} | dict.fromkeys(slopes, slope)
            continue
        s, *kelvin = np.array(read).T
        if several:  # their common slope
            away = s - s.mean()
            power = max(2.0 * float(away @ away), 1e-12)
            slope = sum(float(away @ k) for k in kelvin) / power
        low, high = (float(np.median(k - slope * s)) for k in kelvin)
        for name, value in zip(ends, (low, max(high, low + 1.0)), strict=True):
            unknowns[name] = (value, value - 80.0, value + 80.0, 4.0)
        if several:  # at most 100 K per 100 MPa: C of 1 MPa/K or more
            first = float(np.clip(slope, 1.0, 90.0))
            unknowns |= dict.fromkeys(slopes, (first, -5.0, 100.0, 2.0))
        else:
            fixed |= dict.fromkeys(slopes, slope)
    largest, least = max(float(steps.max()), 1e-4), max(float(steps.min()), 1e-6)
    top = 3.0 * max(largest, *(loop.recovered for loop in loops))
    whole = (largest, 0.0, top, 0.1 * largest)
    if bends:
        unknowns |= {"H_min": (0.5 * least, *whole[1:]), "dH": whole, "k": (1.0, 0.01, 30.0, 0.3)}
    else:
        unknowns["eps_L"] = whole
    is_relative = loops[0].is_relative  # 3000e-6 of the strain's range per K is a typical size
    if law == "contract":
        of_relative, own = (0.0, -1e4, 1e4, 10.0), (-0.2, -50.0, 50.0, 0.2)
        return {**unknowns, "Theta_T": of_relative if is_relative else own}, fixed
    expansion = (0.0, -30_000.0, 30_000.0, 3000.0) if is_relative else (8.0, -200.0, 200.0, 5.0)
    unknowns |= dict.fromkeys(("alpha_A", "alpha_M"), expansion)
    fixed["T_ref"] = float(np.mean(np.concatenate([loop.temperature for loop in loops])))
    if bends:
        unknowns["fading"] = (0.5, -20.0, 20.0, 0.5)
        for start in (start for start, _ in _ENDS.values() if start in unknowns):
            unknowns[f"bend_{start[0]}"] = (0.0, -30.0, 30.0, 0.5)
    return unknowns, fixed


def _estimates(fit: LawFit, parameters: Parameters,
               findings: list[Finding]) -> tuple[dict[str, Estimate], Correlation]:
    """The contract's parameters that the records determine, and the correlation of their errors."""
    largest = max(loop.stress for loop in fit.loops)
    if largest > STRONGEST:
        findings.append(remark("no constitutive law"))
        return {}, Correlation((), np.zeros((0, 0)))
    top, extended = largest / _REFERENCE_STRESS, fit.law == "extended"

    def contract(values: Array) -> dict[str, float]:
        p = fit.fixed | dict(zip(fit.names, values.tolist(), strict=True))
        found = {name: p[name] for name in TRANSITIONS}
        for ends in _ENDS.values():
            # Secant from zero to the largest stress, as a bend makes the slope vary.
            slope = sum(p[name] for name in _slopes(fit.law, ends)) / 2.0
            found[f"C_{ends[0][0]}"] = slope + p.get(f"bend_{ends[0][0]}", 0.0) * top
        theta = -1e-6 * p["alpha_M"] * parameters[MODULI[0]] if extended else 1e6 * p["Theta_T"]
        return found | {"eps_L": _grown(p, top), "Theta_T": theta}

    values, steps = contract(fit.values), 1e-6 * np.maximum(np.abs(fit.values), 1.0)
    sides = [[np.array([*contract(fit.values + sign * step).values()]) for sign in (1.0, -1.0)]
             for step in np.diag(steps)]
    turn = np.array([up - down for up, down in sides]).T / (2.0 * steps)
    covariance = turn @ fit.covariance @ turn.T
    error = dict(zip(values, np.sqrt(np.diag(covariance)).tolist(), strict=True))

    n, method = sum(map(len, fit.residuals)), f"joint fit of {len(fit.loops)} loops, {fit.law} law"
    found: dict[str, Estimate] = {}
    for ends in _ENDS.values():
        label, shift_std, where = f"C_{ends[0][0]}", 0.0, ""
        if one_stress := _slopes(fit.law, ends)[0] not in fit.names:
            # The error of the given C enters the stress-free temperatures.
            held, c = float(np.mean([loop.stress for loop in fit.loops])), SYMBOLS[label]
            shift_std = held * parameters.std(c) / parameters[c] ** 2
            where = f", referred to zero stress with the given {label}"
        for name in (name for name in ends if name in fit.names):
            std = math.hypot(error[name], shift_std)
            found[name] = Estimate(values[name], std, "K", method + where, n)
        slope, std = values[label], error[label]
        if not one_stress and slope > _SIGNIFICANT * std:
            value = _REFERENCE_STRESS / slope
            found[label] = Estimate(value, value * std / slope, "Pa/K", method, n)
        elif not one_stress:
            findings.append(remark("C unresolved", subject=label, slope=slope, std=std))
    if not fit.loops[0].is_relative:
        where = "" if "eps_L" in fit.names else f", at the largest stress {largest / 1e6:.0f} MPa"
        found["eps_L"] = Estimate(values["eps_L"], error["eps_L"], "1", method + where, n)
        # Theta_T is negative and of the size of alpha E.
        value, std = values["Theta_T"], error["Theta_T"]
        if extended:
            std = math.hypot(std, value * parameters.std(MODULI[0]) / parameters[MODULI[0]])
        most = CONVECTION_FACTOR * NITI_EXPANSION[1] * _STIFFEST
        is_resolved = not extended or abs(value) > _SIGNIFICANT * std
        if is_resolved and -most - std < value < 2.0 * std and std < most:
            words = f"{method}, -alpha_M E_M" if extended else method
            found["Theta_T"] = Estimate(value, std, "Pa/K", words, n)
        else:
            findings.append(remark("Theta_T unresolved", value=value, std=std))
    found = {symbol: found[symbol] for symbol in SYMBOLS if symbol in found}
    chosen = [list(values).index(symbol) for symbol in found]
    sign = np.array([-1.0 if symbol in ("C_A", "C_M") else 1.0 for symbol in found])
    sigma = sign * np.sqrt(np.diag(covariance)[chosen])
    matrix = covariance[np.ix_(chosen, chosen)] / np.outer(sigma, sigma)
    named = {SYMBOLS[symbol]: e for symbol, e in found.items()}
    return with_scales(named, parameters), Correlation(tuple(named), matrix)


def _about_fits(fits: Sequence[LawFit]) -> Iterator[Finding]:
    """Fit error of each law at each stress; unknowns at a bound and fixed numbers of the last."""
    for fit in fits:
        errors, fails = fit.errors, max(fit.errors.values()) >= _TOLERANCE
        more = f"; above {_TOLERANCE:.0%}" if fails else ""
        if fails and fit.law == "contract" and len(errors) > 1:
            more += (": a constant eps_L and constant C_A, C_M do not suffice for this material, "
                     "and a simulation with the identified parameters is as far off")
        law = "the paper's" if fit.law == "contract" else fit.law
        yield remark("fit error", "warning" if fails else "info", law=law, more=more,
                     numbers={f"{s / 1e6:.0f} MPa": e for s, e in errors.items()},
                     table=", ".join(f"{e:.1%} at {s / 1e6:.0f} MPa" for s, e in errors.items()))
    if fit.at_bound:
        yield remark("at a bound", names=", ".join(fit.at_bound))
    if given := {name: value for name, value in fit.fixed.items() if name != "T_ref"}:
        listed = ", ".join(f"{name} = {value:.4g}" for name, value in given.items())
        yield remark("taken as given", numbers=given, listed=listed)
