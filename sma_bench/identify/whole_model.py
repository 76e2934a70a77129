"""E0, E9, E10 and E12: the whole model fitted to any set of a bench's records, as an experiment.
The diagnosis calls this fit recalibration and runs it from fewer starts."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation import laws as weighing
from sma_bench.estimation import solver
from sma_bench.estimation import unknowns as priors
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.laws import starts
from sma_bench.estimation.observation import MOVED, Observation, observe_all
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.result import Result, result_of, scale_errors
from sma_bench.estimation.solver import Fit
from sma_bench.findings import Finding, Severity
from sma_bench.identify.result import Correlation, Experiment, refusal, remark
from sma_bench.identify.signals import CAMERA_LAG, LAG, LEADS, RESISTANCE, about_length
from sma_bench.identify.staircases import lead_std
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import load_kind
from sma_bench.progress import Report, silent
from sma_bench.records.record import Record
from sma_bench.results import in_print

_NUISANCES = (*priors.SHAPES, *priors.UNMODELLED)
_UNINFORMED = 0.2  # share of information from the records: below, the prior decides
_FAR, _FAR_TOO = 3.5, 2.0  # prior deviations that contradict a prior; likewise if another one is
_LAGS, _RARE = 20, 1e-6  # of the test for white residuals: lags, probability
_OFF_SCALE = 0.02  # relative: two sensors' gains are known to about 2 %
_FLOOR = 1.3  # rms residual over the noise above which the model misses a signal
_BETTER = 3.0  # nats by which a lag of the thermometer must improve the fit
_UNITS = {"wire.heat_transfer_coefficient": ("heat_loss", "W/K", "h A_c"),
          "wire.specific_heat": ("heat_capacity", "J/K", "m c_p")}


def identify_moving_bench(records: Sequence[Record], parameters: Parameters,
                          report: Report = silent) -> Experiment:
    """Parameters of the wires and of what they pull against (alpha and beta of each side of the
    composite, else those of `load`): the baseline model (contract, section 4) on the measured
    voltages, fitted to every other signal. Records of one wire in a load frame may be among them.
    Raises InputError: no voltage of some channel, or no motion in any record."""
    observations = observe_all(records, parameters)
    if not any(set(MOVED) & set(one.quantities) for one in observations):
        raise refusal("no motion", where=", ".join(str(r.path) for r in records))
    title = "Whole model of a bench that moves"
    return fit_experiment("E10", title, observations, parameters, report)


def identify_load_frame(records: Sequence[Record], parameters: Parameters,
                        report: Report = silent) -> Experiment:
    """Thermal and constitutive parameters of one wire in a load frame, simulated under the loads
    that were held, or between the clamps, and fitted to elongation or force, temperature, current.
    Raises InputError: no load frame in any record, no voltage, or neither held loads nor clamps."""
    observations = observe_all(records, parameters)
    if not any(one.holds for one in observations):
        raise refusal("no load frame", where=", ".join(str(r.path) for r in records))
    title = "Constitutive parameters from the load frame"
    fitted = fit_experiment("E9", title, observations, parameters, report)
    return replace(fitted, findings=(*fitted.findings, about_length(parameters)))


def identify_driven_wires(records: Sequence[Record], parameters: Parameters,
                          report: Report = silent) -> Experiment:
    """R, h and c_p from any drive that excites them, where the records add to what was known.
    InputError: no voltage of some channel, or a drive that determines none of them."""
    observations = observe_all(records, parameters, ("current", "temperature"))
    title = "Joint fit to a drive made for another purpose"
    fitted = fit_experiment("E0", title, observations, parameters, report, most_starts=2)
    found = {n: e for n, e in fitted.estimates.items()
             if n in (*priors.HEAT, CAMERA_LAG) and e.informed >= _UNINFORMED}
    # If records determine only a product, and neither factor was given, the other one is a default.
    for name, (what, _, symbol) in _UNITS.items():
        partner, product = priors.PRODUCTS[name], fitted.details.get(what)
        if product and product.informed >= _UNINFORMED and partner not in parameters.given:
            own, factor = fitted.estimates[name], parameters[partner]
            value, words = product.value / factor, f"{partner} {factor:.4g} taken as exact"
            shares = {of: value / own.value * share for of, share in own.shares.items()}
            found[name] = replace(product, value=value, std=product.std / factor, unit=own.unit,
                                  method=f"{symbol}, {words}").with_shares(shares)
    if not found.keys() - {"environment.ambient_temperature"}:
        raise InputError(f"{fitted.source}: the drive does not determine R, h or c_p")
    remarks = (remark("one fit of all", names=", ".join(found)), *fitted.findings)
    return replace(fitted, estimates=found, findings=remarks)


def fit_experiment(name: str, title: str, observations: Sequence[Observation],
                   parameters: Parameters, report: Report = silent,
                   most_starts: int | None = None) -> Experiment:
    """Fit all parameters that the records can depend on."""
    quantities = tuple(dict.fromkeys(q for one in observations for q in one.quantities))
    held = any(one.holds for one in observations)
    moving = any(not one.holds for one in observations)
    laws: tuple[weighing.LawFit, ...] = ()
    if moving and load_kind(parameters) in priors.LOADS and "deflection" in quantities:
        laws = weighing.weigh_laws(observations, parameters, quantities, report)
        fitted, tried = _with_lag(laws[0].fit, list(laws[0].tried), parameters)
        if fitted is not laws[0].fit:  # without the lag, temperatures may decide for a wrong law
            lag = replace(fitted.unknowns.items[-1], mean=float(fitted.parameters[LAG]))
            laws = weighing.weigh_laws(observations, parameters, quantities, report, (lag,))
            fitted, tried = laws[0].fit, list(laws[0].tried)
        laws = (replace(laws[0], fit=fitted, tried=tuple(tried)), *laws[1:])
    else:
        unknowns = priors.unknowns_of_records(parameters, quantities, load_frame=held,
                                              own_load=moving, sides_apart=True, unmodelled=True)
        problem = Problem.of(observations, voltage_noise=True)
        tries = starts(unknowns)[:most_starts]
        fitted, tried = solver.recalibrate(problem, parameters, unknowns, tries, report,
                                           keep_noise=True)
        fitted, tried = _with_lag(fitted, tried, parameters)
    result = result_of(fitted, tried, scale_errors(fitted))
    numbers = tuple(replace(n, name=CAMERA_LAG) if n.name == LAG else n for n in result.numbers)
    result = replace(result, numbers=numbers)
    method, samples = f"simulation fitted to {', '.join(quantities)}", result.samples
    # Parameters of the shape of the kinetics are left out at their default, the cosine.
    which = [k for k, n in enumerate(numbers)
             if n.name not in _NUISANCES or n.value != BY_NAME[n.name].default]
    estimates = {}
    for n in (numbers[k] for k in which):
        little = ": mostly the prior, the records add little" if n.informed < _UNINFORMED else ""
        shares = dict(n.shares)
        if n.name == RESISTANCE:
            shares[LEADS] = -parameters["wire.count"] * lead_std(parameters)
        shares |= priors.shares_of_factor(n.name, n.value, parameters)
        # Prior errors include the sensors' scales: cap at them. Temperatures: as the fit has them.
        bound = n.name in (*priors.TEMPERATURES, priors.SPREAD)
        own = Estimate(fitted.parameters[n.name] if bound else n.value, n.std,
                       BY_NAME[n.name].unit, method + little, samples, informed=n.informed)
        estimates[n.name] = own.with_shares(shares).capped(n.prior_std)
    details = {}
    for number in result.products:
        what, unit, symbol = _UNITS[number.name.split(" x ")[0]]
        words, informed = f"{symbol}, the only form in the model", number.informed
        details[what] = Estimate(number.value, number.std, unit, words, samples, informed=informed)
    paths = list(dict.fromkeys(one.path for one in observations))
    heads = {path: f"{k}." if len(paths) > 1 else "" for k, path in enumerate(paths)}
    for off in result.off:
        informed = max(0.0, 1.0 - (off.std / off.item.std) ** 2)
        words = f"fitted with the model, {off.path}"
        details[f"{heads[off.path]}{off.item.kind}.{off.item.subject}"] = Estimate(
            off.value, off.std, off.item.unit, words, samples, informed=informed)
    curves: dict[str, Array] = {}
    for block in result.fit.problem.blocks:
        signal, model = block.signal, block.signal.value - result.fit.residual[block.rows]
        stem = heads[block.observation.path] + signal.name
        shown = {"time": signal.time, "measured": signal.value, "model": model}
        curves |= {f"{stem}.{kind}": values for kind, values in shown.items()}
    return Experiment(name, title, estimates, (*_of_laws(laws), *_findings(result)),
                      curves, "; ".join(one.path for one in observations), details,
                      Correlation(tuple(estimates), result.correlation[np.ix_(which, which)]), laws)


def _of_laws(laws: Sequence[weighing.LawFit]) -> Iterator[Finding]:
    """Findings: the best law, the second and how it differs; repeatability of the bench."""
    for first, second in pairwise(laws[:2]):
        apart = first.fit.predicted - second.fit.predicted
        shares = [float(np.std(apart[block.rows]) / np.ptp(block.signal.value))
                  for block in first.fit.problem.blocks]
        yield remark("law", law=first.law, probability=first.probability, other=second.law,
                     second=second.probability, apart=max(shares))
    if laws and np.isfinite(repeats := weighing.repeatability(laws[0].fit)):
        yield remark("repeats", repeats=repeats)


def _with_lag(fitted: Fit, tried: list[Fit], parameters: Parameters) -> tuple[Fit, list[Fit]]:
    """Refit with the thermometer's lag if temperatures misfit or one is given; the better fit."""
    mean, std = float(parameters[CAMERA_LAG]), parameters.std(CAMERA_LAG)
    missed = any(float(np.std(fitted.residual[block.rows])) > _FLOOR * block.signal.noise
                 for block in fitted.problem.blocks if block.signal.quantity == "temperature")
    if parameters[LAG] or std == 0.0 or not (missed or mean):
        return fitted, tried
    if CAMERA_LAG not in parameters.given_uncertainty:  # not measured on this thermometer
        std = max(std, float(BY_NAME[LAG].uncertainty or 0.0))
    own, before = fitted.unknowns, fitted.problem
    item = priors.Unknown(LAG, mean, std, *priors.range_of(LAG))
    unknowns = replace(own, items=(*own.items, item), baseline=own.baseline + 1)
    first = item.x_of(max(mean, std))
    starts = [np.append(one, first) for one in (own.start(), fitted.x)]
    problem = Problem.of(before.observations, before.voltage_noise)
    if before.weights:
        both, lagged = solver.fit_imperfect(problem, own.base, unknowns, starts)
        readings = solver.independent_readings(fitted)
        found = max(both, key=lambda one: solver.log_evidence(one, readings))
        gain = solver.log_evidence(found, readings) - solver.log_evidence(fitted, readings)
    else:
        found, lagged = solver.recalibrate(problem, parameters, unknowns, starts)
        gain = found.evidence - fitted.evidence
    return (found, lagged) if gain > _BETTER else (fitted, tried)


def _findings(result: Result) -> Iterator[Finding]:
    """Findings: priors that decide or are contradicted, ends of ranges, starts, residuals."""
    shown = [n for n in result.numbers if n.name not in _NUISANCES]
    if which := [n.name for n in shown if n.informed < _UNINFORMED]:
        yield remark("mostly the prior", names=", ".join(which), parameters=len(which))
    for first in (number.name.split(" x ")[0] for number in result.products):
        product, factor = _UNITS[first][2], priors.PRODUCTS[first]
        yield remark("only the product", subject=first, product=product, factor=factor)
    # If one prior is contradicted, the same cause is likely to shift others.
    limit = _FAR_TOO if any(abs(n.moved) > _FAR for n in result.numbers) else _FAR
    for n in (n for n in result.numbers if abs(n.moved) > limit):
        away, unit = (n.value - n.prior_mean) / n.prior_std, BY_NAME[n.name].unit
        cause = "contradicted" if n.name in result.fit.unknowns.base.given else "unusual"
        yield remark(cause, subject=n.name, found=Estimate(n.value, n.std, unit), deviations=away,
                     prior=Estimate(n.prior_mean, n.prior_std, unit))
    for n in (n for n in shown if n.at_end):
        yield remark("end of a range", subject=n.name, value=n.value)
    severity: Severity = "info" if result.agreed > 1 else "warning"
    yield remark("starts", severity, agreed=result.agreed, starts=result.starts)
    fitted = result.fit
    for name in dict.fromkeys(n for one in fitted.problem.observations for n in one.left_out):
        yield remark("not compared", subject=name)
    noise = fitted.problem.with_noise(fitted.residual).noise
    for block in fitted.problem.blocks:
        signal, residual = block.signal, fitted.residual[block.rows]
        name, path, rms = signal.name, block.observation.path, float(np.std(residual))
        if (ratio := rms / signal.noise) > _FLOOR:
            yield remark("above the noise", subject=name, path=path, ratio=ratio, rms=rms,
                         noise_floor=signal.noise, shown=in_print(rms, name),
                         floor=in_print(signal.noise, name))
        if (chance := _chance_of_white(noise[name].whiten(residual))) < _RARE:
            yield remark("still correlated", subject=name, path=path, probability=chance)
        model = signal.value - residual
        ratio = 1.0 + float(model @ residual) / max(float(model @ model), 1e-12)
        if signal.quantity == "current" and abs(ratio - 1.0) > _OFF_SCALE:
            yield remark("current off scale", subject=RESISTANCE, path=path, ratio=ratio, name=name)


def _chance_of_white(white: Array) -> float:
    """Probability that white noise is as correlated over 20 lags (Ljung and Box, 1978)."""
    n, centred = len(white), white - white.mean()
    power = float(centred @ centred)
    if n < 5 * _LAGS or power == 0.0:
        return 1.0
    rho = [float(centred[:-k] @ centred[k:]) / power for k in range(1, _LAGS + 1)]
    squares = sum(r**2 / (n - k) for k, r in enumerate(rho, 1))
    return float(chdtrc(_LAGS, n * (n + 2) * squares))
