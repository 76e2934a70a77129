"""E0, E9, E10 and E12: the whole model fitted to any set of a bench's records, as an experiment.

It is the fit that the diagnosis calls recalibration, from more starts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.laws import (
    LawFit,
    independent_readings,
    log_evidence,
    repeatability,
    starts,
    weigh_laws,
)
from sma_bench.estimation.observation import MOVED, Observation, observe_all
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.result import Result, result_of, scale_errors
from sma_bench.estimation.solver import Fit, fit_imperfect, recalibrate
from sma_bench.estimation.unknowns import (
    HEAT,
    LOADS,
    PRODUCTS,
    SHAPES,
    SPREAD,
    TEMPERATURES,
    UNMODELLED,
    Unknown,
    shares_of_factor,
    unknowns_of_records,
)
from sma_bench.findings import Finding
from sma_bench.identify.resistance import lead_std
from sma_bench.identify.result import Correlation, Experiment, refusal, remark
from sma_bench.identify.signals import CAMERA_LAG, LAG, LEADS, RESISTANCE, about_length
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import load_kind
from sma_bench.progress import Report, silent
from sma_bench.records.record import Record

_THERMAL = ("current", "temperature")
_NUISANCES = (*SHAPES, *UNMODELLED)
_UNINFORMED = 0.2  # share of information
_FAR, _FAR_TOO = 3.5, 2.0  # prior deviations
_LAGS, _RARE = 20, 1e-6
_FLOOR = 1.3
_BETTER = 3.0  # nats, by which a lag must tell the records better
_UNITS = {"wire.heat_transfer_coefficient": ("heat_loss", "W/K", "h A_c"),
          "wire.specific_heat": ("heat_capacity", "J/K", "m c_p")}


def identify_moving_bench(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """What the wires pull against (of the composite alpha and beta of each side, else the numbers
    of `load`), and their own parameters.

    The baseline model (contract, section 4) is simulated on the measured voltages and held to
    every other signal that the records have. Priors are the parameters' values and
    `uncertainty.`; what the records cannot tell stays there and is named in the findings. Records
    of a single wire in a load frame may join: the same alloy.

    Raises InputError: no voltage of some channel, or no motion in any record.
    """
    observations = observe_all(records, parameters)
    if not any(set(MOVED) & set(one.quantities) for one in observations):
        where = ", ".join(str(record.path) for record in records) or "no records"
        raise refusal("no motion", where=where)
    return fit_experiment(
        "E10", "Whole model of a bench that moves", observations, parameters, report
    )


def identify_load_frame(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """Thermal and constitutive parameters of one wire in a load frame, simulated under the loads
    that were held, or between the clamps, and held to elongation or force, temperature and current.
    Raises InputError: no load frame in any record, no voltage, or neither held loads nor clamps."""
    observations = observe_all(records, parameters)
    if not any(one.holds for one in observations):
        where = ", ".join(str(record.path) for record in records) or "no records"
        raise refusal("no load frame", where=where)
    fitted = fit_experiment(
        "E9", "Constitutive parameters from the load frame", observations, parameters, report
    )
    return replace(fitted, findings=(*fitted.findings, about_length(parameters)))


def identify_driven_wires(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """R, h and c_p from whatever drive excites them, as far as the records tell them better than
    was known. InputError without a voltage of some channel, or where the drive tells nothing."""
    observations = observe_all(records, parameters, _THERMAL)
    title = "Joint fit of a drive that was made for something else"
    fitted = fit_experiment("E0", title, observations, parameters, report, most_starts=2)
    found = {n: e for n, e in fitted.estimates.items()
            if n in (*HEAT, CAMERA_LAG) and e.informed >= _UNINFORMED}  # fmt: skip
    # A product of which nobody knows a factor is found with the default of the other one.
    for name, (what, _, symbol) in _UNITS.items():
        partner, product = PRODUCTS[name], fitted.details.get(what)
        if product and product.informed >= _UNINFORMED and partner not in parameters.given:
            own, factor = fitted.estimates[name], parameters[partner]
            value, words = product.value / factor, f"{partner} {factor:.4g} taken as exact"
            found[name] = Estimate(
                value, product.std / factor, own.unit, f"{symbol}, {words}", product.n,
                informed=product.informed,
            ).with_shares({of: value / own.value * share for of, share in own.shares.items()})
    if not found.keys() - {"environment.ambient_temperature"}:
        raise InputError(f"{fitted.source}: the drive excites nothing that R, h or c_p show in")
    remarks = (remark("one fit of all", names=", ".join(found)), *fitted.findings)
    return replace(fitted, estimates=found, findings=remarks)


def fit_experiment(
    name: str, title: str, observations: Sequence[Observation], parameters: Parameters,
    report: Report = silent, most_starts: int | None = None,
) -> Experiment:
    """Fit everything that the records can depend on, and report it."""
    quantities = tuple(dict.fromkeys(q for one in observations for q in one.quantities))
    moving = any(not one.holds for one in observations)
    laws: tuple[LawFit, ...] = ()
    if moving and load_kind(parameters) in LOADS and "deflection" in quantities:
        laws = weigh_laws(observations, parameters, quantities, report)
        fitted, tried = _with_lag(laws[0].fit, list(laws[0].tried), parameters)
        laws = (replace(laws[0], fit=fitted, tried=tuple(tried)), *laws[1:])
    else:
        unknowns = unknowns_of_records(
            parameters, quantities, load_frame=any(one.holds for one in observations),
            own_load=moving, sides_apart=True, unmodelled=True,
        )
        problem = Problem.of(observations, voltage_noise=True)
        tries = starts(unknowns)[:most_starts]
        fitted, tried = recalibrate(problem, parameters, unknowns, tries, report, keep_noise=True)
        fitted, tried = _with_lag(fitted, tried, parameters)
    result = result_of(fitted, tried, scale_errors(fitted))
    numbers = [replace(n, name=CAMERA_LAG) if n.name == LAG else n for n in result.numbers]
    result = replace(result, numbers=tuple(numbers))

    method, samples = f"simulation fitted to {', '.join(quantities)}", result.samples
    # A shape of the kinetics that is the cosine's is not worth a line.
    which = [
        k for k, n in enumerate(result.numbers)
        if n.name not in _NUISANCES or n.value != BY_NAME[n.name].default
    ]
    estimates = {}
    for n in (result.numbers[k] for k in which):
        told = n.informed >= _UNINFORMED
        words = method if told else f"{method}: mostly the prior, the records add little"
        shares = dict(n.shares)
        if n.name == RESISTANCE:
            shares[LEADS] = -parameters["wire.count"] * lead_std(parameters)
        shares |= shares_of_factor(n.name, n.value, parameters)
        # What nobody measured better is not known better: sensors' scales are in what was known.
        # Numbers that bound each other are as the fit had them together.
        value = fitted.parameters[n.name] if n.name in (*TEMPERATURES, SPREAD) else n.value
        estimates[n.name] = Estimate(
            value, n.std, BY_NAME[n.name].unit, words, samples, informed=n.informed
        ).with_shares(shares).capped(n.prior_std)

    # Products that the data know better than their factors, zeros of sensors, delays.
    details = {}
    for number in result.products:
        what, unit, symbol = _UNITS[number.name.split(" x ")[0]]
        words = f"{symbol}, the only form in the model"
        details[what] = Estimate(
            number.value, number.std, unit, words, samples, informed=number.informed
        )
    paths = list(dict.fromkeys(off.path for off in result.off))
    for off in result.off:
        head = f"{paths.index(off.path)}." if len(paths) > 1 else ""
        details[f"{head}{off.kind}.{off.subject}"] = Estimate(
            off.value, off.std, off.unit, f"fitted beside the model, {off.path}", samples,
            informed=max(0.0, 1.0 - (off.std / off.prior_std) ** 2),
        )
    # Time, measured and model of every signal, bin by bin.
    curves: dict[str, Array] = {}
    paths = list(dict.fromkeys(one.path for one in observations))
    for block in result.fit.problem.blocks:
        signal, path = block.signal, block.observation.path
        head = f"{paths.index(path)}.{signal.name}" if len(paths) > 1 else signal.name
        left = result.fit.left[block.rows]
        curves |= {
            f"{head}.time": signal.time, f"{head}.measured": signal.value,
            f"{head}.model": signal.value - left,
        }
    return Experiment(
        name, title, estimates, (*_of_laws(laws), *_findings(result)), curves,
        "; ".join(one.path for one in observations), details,
        Correlation(tuple(estimates), result.correlation[np.ix_(which, which)]), laws,
    )


def _of_laws(laws: Sequence[LawFit]) -> Iterator[Finding]:
    """Which law, the runner-up and what it predicts differently; how the bench repeats."""
    if not laws:
        return
    first, *others = laws
    if others:
        second, blocks = others[0], first.fit.problem.blocks
        apart = first.fit.predicted - second.fit.predicted
        shares = [float(np.std(apart[b.rows]) / np.ptp(b.signal.value)) for b in blocks]
        yield remark(
            "law", law=first.law, probability=first.probability, other=second.law,
            second=second.probability, apart=max(shares),
        )
    if np.isfinite(repeats := repeatability(first.fit)):
        yield remark("repeats", repeats=repeats)


def _with_lag(fitted: Fit, tried: list[Fit], parameters: Parameters) -> tuple[Fit, list[Fit]]:
    """The fit again with the thermometer's lag as an unknown, where temperatures are missed by more
    than their noise or a lag is stated, and this tells the records better."""
    mean, std = float(parameters[CAMERA_LAG]), parameters.std(CAMERA_LAG)
    missed = any(
        float(np.std(fitted.left[block.rows])) > _FLOOR * block.signal.noise
        for block in fitted.problem.blocks if block.signal.quantity == "temperature"
    )
    if parameters[LAG] or std == 0.0 or not (missed or mean):
        return fitted, tried
    if CAMERA_LAG not in parameters.given_uncertainty:  # nobody has measured this thermometer's
        std = max(std, float(BY_NAME[LAG].uncertainty or 0.0))
    own, before = fitted.unknowns, fitted.problem
    item = Unknown(LAG, mean, std, 0.0, float(BY_NAME[LAG].high or np.inf))
    unknowns = replace(own, items=(*own.items, item), baseline=own.baseline + 1)
    first = item.x_of(max(mean, std))
    starts = [np.append(one, first) for one in (own.start(), fitted.x)]
    problem = Problem.of(before.observations, before.voltage_noise)
    if before.weights:
        both, lagged = fit_imperfect(problem, own.base, unknowns, starts)
        readings = independent_readings(fitted)
        found = max(both, key=lambda one: log_evidence(one, readings))
        gain = log_evidence(found, readings) - log_evidence(fitted, readings)
    else:
        found, lagged = recalibrate(problem, parameters, unknowns, starts)
        gain = found.evidence - fitted.evidence
    return (found, lagged) if gain > _BETTER else (fitted, tried)


def _findings(result: Result) -> Iterator[Finding]:
    """What cannot be known, contradicted priors, ends of ranges, starts, residuals."""
    told = [n for n in result.numbers if n.name not in _NUISANCES]
    if which := [n.name for n in told if n.informed < _UNINFORMED]:
        yield remark("mostly the prior", names=", ".join(which), parameters=len(which))
    for number in result.products:
        first = number.name.split(" x ")[0]
        yield remark(
            "only the product", subject=first, product=_UNITS[first][2], factor=PRODUCTS[first]
        )
    # Where one statement is contradicted, what drags it along drags others too.
    limit = _FAR_TOO if any(abs(n.moved) > _FAR for n in result.numbers) else _FAR
    for n in (n for n in result.numbers if abs(n.moved) > limit):
        away = (n.value - n.believed) / n.prior_std
        unit = BY_NAME[n.name].unit
        yield remark("contradicted", subject=n.name, n=n, unit=unit, deviations=away)
    for n in (n for n in told if n.at_end):
        yield remark("end of a range", subject=n.name, value=n.value)
    alone = result.agreed <= 1
    yield remark(
        "starts", "warning" if alone else "info", agreed=result.agreed, starts=result.starts
    )
    # Residuals against their noise, and whether they are white.
    fitted = result.fit
    noise = fitted.problem.with_noise(fitted.left).noise
    for block in fitted.problem.blocks:
        signal, left = block.signal, fitted.left[block.rows]
        rms, path = float(np.std(left)), block.observation.path
        ratio, chance = rms / signal.noise, _chance_of_white(noise[signal.name].whiten(left))
        if ratio > _FLOOR:
            yield remark("above the noise", subject=signal.name, path=path, ratio=ratio, rms=rms,
                         noise_floor=signal.noise)
        if chance < _RARE:
            yield remark("still correlated", subject=signal.name, path=path, probability=chance)


def _chance_of_white(white: Array) -> float:
    """Probability that white noise is as correlated over 20 lags (Ljung and Box, 1978)."""
    n, centred = len(white), white - white.mean()
    power = float(centred @ centred)
    if n < 5 * _LAGS or power == 0.0:
        return 1.0
    lags = np.arange(1, _LAGS + 1)
    rho = np.array([float(centred[:-k] @ centred[k:]) / power for k in lags])
    return float(chdtrc(_LAGS, n * (n + 2) * float(np.sum(rho**2 / (n - lags)))))
