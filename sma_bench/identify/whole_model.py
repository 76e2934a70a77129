"""E0, E9, E10 and E12: the whole model fitted to any set of a bench's records, as an experiment.

It is the fit that the diagnosis calls recalibration, from more starts.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.load_frame import LOAD_FRAME
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import DELAY
from sma_bench.estimation.observation import (
    QUANTITIES,
    Observation,
    observe,
    pulls_a_load,
    shared_bin,
)
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.result import Number, Result, result_of, scale_errors
from sma_bench.estimation.solver import Fit, fit_with_misfit, recalibrate
from sma_bench.estimation.unknowns import (
    HEAT,
    LOADS,
    PRODUCTS,
    SHAPES,
    UNMODELLED,
    Unknown,
    Unknowns,
    shares_of_factor,
    unknowns_of_records,
)
from sma_bench.findings import Finding
from sma_bench.identify.result import Correlation, Experiment
from sma_bench.identify.thermal.resistance import LEADS, lead_std
from sma_bench.identify.thermal.resistance import PARAMETER as RESISTANCE
from sma_bench.identify.thermal.specific_heat import CAMERA_LAG, LAG
from sma_bench.identify.thermal.specific_heat import PARAMETER as SPECIFIC_HEAT
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.heat import time_constant
from sma_bench.progress import Report, silent
from sma_bench.records.record import Record, has_samples

NAME = "E10"
TITLE = "Whole model of a bench that moves"
DRIVEN, DRIVEN_TITLE = "E0", "Joint fit of a drive that was made for something else"
_THERMAL = ("current", "temperature")
_NUISANCES = (*SHAPES, *UNMODELLED)
_MOTIONS = ("deflection", "elongation")
_SPREADS = (0.3, 3.0)  # prior deviations: sharp kinetics can trap a fit that smooth ones let go
_DRAWN, _SEED = 2, 17  # further starts, drawn from the prior
_UNINFORMED = 0.2  # share of information
_TIED = 0.95
_FAR, _FAR_TOO = 3.5, 2.0  # prior deviations
_FOUND = 4.0  # standard deviations of a zero or a delay
_LAGS, _RARE = 20, 1e-6
_FLOOR = 1.3
_SHORT_LAG = 0.01  # s
_TOLD = 0.1  # of the wire's time constant, error of a lag that the records by themselves tell
_BETTER = 3.0  # nats, by which a lag must tell the records better
_UNITS = {"wire.heat_transfer_coefficient": ("heat_loss", "W/K", "h A_c"),
          "wire.specific_heat": ("heat_capacity", "J/K", "m c_p")}  # fmt: skip


def identify_moving_bench(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """What the wires pull against, and their own parameters.

    Of the composite the bending coefficients alpha, beta of each side; of a weight, a spring or
    antagonists the numbers of `load`.

    The baseline model (contract, section 4) is simulated on the measured voltages and held to
    every other signal that the records have: motion, force, currents, temperatures. Priors are the
    parameters' values and `uncertainty.`; what the records cannot tell stays there and is named
    in the findings. Records of a single wire in a load frame may join: the same alloy.

    Args:
        records: of the bench, at least one with a deflection (or ranges) or an elongation.
        parameters: the lab's values with their uncertainties, and bench.channels.
        report: called with how far the fit is.

    Raises:
        InputError: no voltage of some channel, or no motion in any record.
    """
    observations = observe_all(records, parameters)
    if not any(set(_MOTIONS) & set(one.quantities) for one in observations):
        where = ", ".join(str(record.path) for record in records) or "no records"
        raise InputError(
            f"{where}: no motion, expected joint_states tip or wire, or front/back range"
        )
    return fit_experiment(NAME, TITLE, observations, parameters, report)


def identify_driven_wires(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """R, h and c_p from whatever drive excites them: one step, a random sequence, a controller's.

    Only what the records tell better than was known is among the estimates.

    Args:
        records: with the voltages of all their channels, and currents or temperatures.
        parameters: the lab's values with their uncertainties; report: called with how far it is.

    Raises:
        InputError: no voltage of some channel, or a drive that tells nothing of the wire.
    """
    shortest = shared_bin(records, parameters)
    observations = [observe(record, parameters, shortest, _THERMAL) for record in records]
    fitted = fit_experiment(DRIVEN, DRIVEN_TITLE, observations, parameters, report, most_starts=2)
    told = {
        n: e for n, e in fitted.estimates.items() if n in HEAT and e.informed >= _UNINFORMED
    }
    if not told.keys() - {"environment.ambient_temperature"}:
        raise InputError(f"{fitted.source}: the drive excites nothing that R, h or c_p show in")
    text = (
        f"{', '.join(told)} by one fit of all that was read, whose errors rest on the model: a "
        "staircase with current (E1) and with temperature (E2) and a ramp (E3) tell them better"
    )
    remark = Finding("info", DRIVEN, text)
    return replace(fitted, estimates=told, findings=(remark, *fitted.findings))


def moves(record: Record, parameters: Parameters) -> bool:
    """Whether a record shows the composite bending, or wires moving their load."""
    signals = ["deflection", "front.range", "back.range"]
    if pulls_a_load(record, parameters):
        signals.append("elongation")
    return any(has_samples(record, name) for name in signals)


def observe_all(records: Sequence[Record], parameters: Parameters) -> list[Observation]:
    """Everything that the records measure, in bins that suit all of them."""
    if not records:
        return []
    shortest = shared_bin(records, parameters)
    quantities = (*QUANTITIES, *LOAD_FRAME)
    return [observe(record, parameters, shortest, quantities) for record in records]


def fit_experiment(
    name: str, title: str, observations: Sequence[Observation], parameters: Parameters,
    report: Report = silent, most_starts: int | None = None,
) -> Experiment:
    """Fit everything that the records can depend on, and report it."""
    result = fit_whole_model(observations, parameters, report, most_starts)
    quantities = list(dict.fromkeys(q for one in observations for q in one.quantities))
    method = f"simulation fitted to {', '.join(quantities)}"
    # A shape of the kinetics that is the cosine's is not worth a line.
    identifiable = [
        n for n in result.numbers
        if n.name not in _NUISANCES or n.value != BY_NAME[n.name].default
    ]
    which = [result.numbers.index(n) for n in identifiable]
    return Experiment(
        name, title,
        {n.name: _estimate(n, method, result.samples, parameters) for n in identifiable},
        findings(result), curves(result), "; ".join(one.path for one in observations),
        details(result),
        Correlation(tuple(n.name for n in identifiable), result.correlation[np.ix_(which, which)]),
    )


def fit_whole_model(
    observations: Sequence[Observation], parameters: Parameters, report: Report = silent,
    most_starts: int | None = None,
) -> Result:
    """The whole model fitted to prepared records, from several starts."""
    # Everything that the records can depend on.
    quantities = tuple(dict.fromkeys(q for one in observations for q in one.quantities))
    unknowns = unknowns_of_records(
        parameters, quantities, load_frame=any(one.holds for one in observations),
        own_load=any(not one.holds for one in observations), sides_apart=True, unmodelled=True,
    )
    tries = starts(unknowns)[:most_starts]
    problem = Problem.of(observations, voltage_noise=True)
    fitted, tried = recalibrate(problem, parameters, unknowns, tries, report, keep_noise=True)
    fitted, tried = _with_lag(fitted, tried, parameters)
    if load_kind(parameters) in LOADS:  # what ten strokes leave of a beam is not yet measured
        fitted = fit_with_misfit(fitted)
    result = result_of(fitted, tried, scale_errors(fitted))
    numbers = [replace(n, name=CAMERA_LAG) if n.name == LAG else n for n in result.numbers]
    return replace(result, numbers=tuple(numbers))


def _with_lag(
    fitted: Fit, tried: list[Fit], parameters: Parameters
) -> tuple[Fit, list[Fit]]:
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
    own = fitted.unknowns
    item = Unknown(LAG, mean, std, 0.0, float(BY_NAME[LAG].high or np.inf))
    unknowns = replace(own, items=(*own.items, item), baseline=own.baseline + 1)
    first = item.x_of(max(mean, std))
    starts = [np.append(one, first) for one in (own.start(), fitted.x)]
    found, lagged = recalibrate(Problem.of(
        fitted.problem.observations, fitted.problem.voltage_noise), parameters, unknowns, starts)
    return (found, lagged) if found.evidence > fitted.evidence + _BETTER else (fitted, tried)


def starts(unknowns: Unknowns) -> list[Array]:
    """What is believed, with sharp and with smooth kinetics, and some believable benches."""
    random = np.random.default_rng(_SEED)
    drawn = []
    for _ in range(_DRAWN):
        x = unknowns.start(abs(float(random.standard_normal())))
        x[: unknowns.bench] = random.standard_normal(unknowns.bench)
        drawn.append(x)
    return [*(unknowns.start(spread) for spread in _SPREADS), *drawn]


def _estimate(number: Number, method: str, n: int, parameters: Parameters) -> Estimate:
    informed = number.informed >= _UNINFORMED
    words = method if informed else f"{method}: mostly the prior, the records add little"
    shares = dict(number.shares)
    if number.name == RESISTANCE:
        shares[LEADS] = -parameters["wire.count"] * lead_std(parameters)
    shares |= shares_of_factor(number.name, number.value, parameters)
    # What nobody measured better is not known better: sensors' scales are in what was known, too.
    estimate = Estimate(
        number.value, number.std, BY_NAME[number.name].unit, words, n, informed=number.informed
    )
    return estimate.with_shares(shares).capped(number.prior_std)


def details(result: Result) -> dict[str, Estimate]:
    """Products that the data know better than their factors, zeros of sensors, delays."""
    n = result.samples
    found = {}
    for number in result.products:
        name, unit, symbol = _UNITS[number.name.split(" x ")[0]]
        words = f"{symbol}, the only form in the model"
        found[name] = Estimate(number.value, number.std, unit, words, n, informed=number.informed)
    paths = list(dict.fromkeys(off.path for off in result.off))
    for off in result.off:
        head = f"{paths.index(off.path)}." if len(paths) > 1 else ""
        informed = max(0.0, 1.0 - (off.std / off.prior_std) ** 2)
        words = f"fitted beside the model, {off.path}"
        found[f"{head}{off.kind}.{off.subject}"] = Estimate(
            off.value, off.std, off.unit, words, n, informed=informed
        )
    return found


def curves(result: Result) -> dict[str, Array]:
    """Time, measured and model of every signal, bin by bin."""
    found: dict[str, Array] = {}
    fitted = result.fit
    paths = list(dict.fromkeys(one.path for one in fitted.problem.observations))
    for block in fitted.problem.blocks:
        signal, path = block.signal, block.observation.path
        head = f"{paths.index(path)}.{signal.name}" if len(paths) > 1 else signal.name
        found[f"{head}.time"] = signal.time
        found[f"{head}.measured"] = signal.value
        found[f"{head}.model"] = signal.value - fitted.left[block.rows]
    return found


def findings(result: Result) -> tuple[Finding, ...]:
    """What cannot be told, contradicted priors, ends of ranges, starts, sensors, residuals."""
    remarks: list[Finding] = []
    told = [n for n in result.numbers if n.name not in _NUISANCES]
    if which := [n.name for n in told if n.informed < _UNINFORMED]:
        text = (
            f"the records hardly improve what was known of {', '.join(which)}: value and error "
            "are mostly the prior's"
        )
        remarks.append(Finding("info", "priors", text, {"parameters": float(len(which))}))
    for number in result.products:
        first = number.name.split(" x ")[0]
        text = (
            f"only the product {_UNITS[first][2]} with {PRODUCTS[first]} enters the model; the "
            "priors of the two split it"
        )
        remarks.append(Finding("info", first, text))
    for i, one in enumerate(result.numbers):
        for j, other in enumerate(result.numbers[:i]):
            rho = float(result.correlation[i, j])
            if abs(rho) > _TIED and min(one.informed, other.informed) >= _UNINFORMED:
                text = f"hardly told apart from {other.name}: correlation {rho:+.3f}"
                remarks.append(Finding("info", one.name, text, {"correlation": rho}))

    # Where one statement is contradicted, what drags it along drags others too.
    limit = _FAR_TOO if any(abs(n.moved) > _FAR for n in result.numbers) else _FAR
    for n in (n for n in result.numbers if abs(n.moved) > limit):
        away = (n.value - n.believed) / n.prior_std
        text = (
            f"the records say {n.value:.6g} +- {n.std:.2g} {BY_NAME[n.name].unit}, {away:+.1f} "
            f"standard deviations from the stated {n.believed:.6g} +- {n.prior_std:.2g}: the "
            "statement, its uncertainty or the model is wrong"
        )
        remarks.append(Finding("warning", n.name, text, {"deviations": away}))
    for n in (n for n in told if n.at_end):
        text = f"the fit stopped at an end of its range, {n.value:.6g}"
        remarks.append(Finding("warning", n.name, text))
    text = f"{result.agreed} of {result.starts} starts ended at the same place, the best"
    numbers = {"agreed": float(result.agreed), "starts": float(result.starts)}
    remarks.append(Finding("info" if result.agreed > 1 else "warning", "starts", text, numbers))

    for off in (off for off in result.off if abs(off.value) > _FOUND * off.std):
        if off.kind == DELAY:
            value, std = off.value * 1e3, off.std * 1e3
            text = f"stamps lie {value:+.1f} +- {std:.1f} ms behind those of the voltage"
        else:
            text = f"reads {off.value:+.3g} +- {off.std:.2g} {off.unit} at zero"
        kind = "delay" if off.kind == DELAY else "offset"
        numbers = {kind: off.value, f"{kind}_std": off.std}
        remarks.append(Finding("info", off.subject, f"{off.path}: {text}", numbers))
    return (*remarks, *_residuals(result), *_about_lag(result))


def _about_lag(result: Result) -> list[Finding]:
    """Whether the temperatures would show a lag of the thermometer, or take it for c_p."""
    fitted = result.fit
    rows = [b.rows for b in fitted.problem.blocks if b.signal.quantity == "temperature"]
    known = fitted.parameters
    if not rows or known[LAG] or known.std(CAMERA_LAG) == 0.0:
        return []
    lagged = fitted.problem.predict(known.replace({LAG: _SHORT_LAG}))
    white = fitted.problem.whiten((lagged - fitted.predicted) / _SHORT_LAG)
    others = np.hstack([fitted.problem.whiten(fitted.derivatives), fitted.problem.white_nuisances])
    taken_for = others.T @ white
    told = float(white @ white - taken_for @ fitted.joint @ taken_for)
    std, tau = 1.0 / np.sqrt(max(told, 1e-12)), time_constant(known)
    if std < _TOLD * tau:
        return []
    text = (
        f"the records cannot tell a lag of the thermometer from c_p: {known[CAMERA_LAG]:.2g} +- "
        f"{known.std(CAMERA_LAG):.2g} s is assumed; more than that passes for thermal inertia "
        f"(time constant of the wire {tau:.3g} s)"
    )
    return [Finding("info", SPECIFIC_HEAT, text, {"lag_std": float(std), "time_constant": tau})]


def _residuals(result: Result) -> list[Finding]:
    remarks = []
    fitted = result.fit
    noise = fitted.problem.with_noise(fitted.left).noise
    for block in fitted.problem.blocks:
        signal, left = block.signal, fitted.left[block.rows]
        ratio = float(np.std(left)) / signal.noise
        numbers = {"rms": float(np.std(left)), "noise_floor": signal.noise, "ratio": ratio}
        if ratio > _FLOOR:
            text = (
                f"{block.observation.path}: the model leaves {ratio:.2f} times the noise from "
                f"sample to sample ({np.std(left):.3g} against {signal.noise:.3g} in a bin): a "
                "sensor that drifts or an effect that the model lacks; errors count it as drift"
            )
            remarks.append(Finding("warning", signal.name, text, numbers))
        chance = _chance_of_white(noise[signal.name].whiten(left))
        if chance < _RARE:
            text = (
                f"{block.observation.path}: the whitened residual is still correlated "
                f"(probability {chance:.1g} if it were white): standard errors may be too small"
            )
            remarks.append(Finding("warning", signal.name, text, {"probability": chance}))
    if not remarks:
        text = "every residual is at its noise floor and, whitened, uncorrelated"
        remarks.append(Finding("info", "residuals", text))
    return remarks


def _chance_of_white(white: Array) -> float:
    """Probability that white noise is as correlated over 20 lags (Ljung and Box, 1978)."""
    n = len(white)
    centred = white - white.mean()
    power = float(centred @ centred)
    if n < 5 * _LAGS or power == 0.0:
        return 1.0
    rho = np.array([float(centred[:-k] @ centred[k:]) / power for k in range(1, _LAGS + 1)])
    q = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, _LAGS + 1))))
    return float(chdtrc(_LAGS, q))
