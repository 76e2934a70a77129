"""E3, specific heat: ramps below A_s (eq. 5, Figs. 4 and 5), the heat equation alone fitted."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.nuisances import DELAY, OFFSET
from sma_bench.estimation.observation import Observation, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.result import Number, Off, Result, result_of
from sma_bench.estimation.solver import fit, recalibrate
from sma_bench.estimation.unknowns import Unknown, Unknowns
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import ChannelDrive
from sma_bench.identify.thermal.heat_transfer import scale_of_gain
from sma_bench.identify.thermal.ramps import (
    FEWEST_SAMPLES,
    Window,
    choose_windows,
    cut_windows,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.records import Record
from sma_bench.records.record import Signal, first_order_lag, samples

PARAMETER = "wire.specific_heat"
COEFFICIENT = "wire.heat_transfer_coefficient"
RESISTANCE = "wire.resistance"
AMBIENT = "environment.ambient_temperature"
AUSTENITE_START = "wire.austenite_start_temperature"
LAG = "effect.temperature_lag.time_constant"
_SMALLEST_RISE = 10.0
_AMBIENT_STD = 2.0  # K; of the camera's zero in each record, too
CAMERA_LAG = "sensor.temperature.lag"
_LEAST = 1e-6  # s
_ANY = 1.0  # of the logarithm of what nobody knows
_STARTS = (0.0, -1.0, 1.0)
_NEAR = 3.0  # prior deviations
_MOVES = 4
_HISTORY = 10.0  # s before the first window


@dataclass(frozen=True)
class HeatLoss:
    """What E1 and E2, or the parameters, know of R (as it heats: with the leads in it) and h.

    `gain` 1/(R h A_c) in K/V^2 comes from E2 and is independent of R; without it h stands alone.
    `known` is False where h is nobody's measurement, then the ramps themselves must tell it.
    """

    resistance: Estimate
    coefficient: Estimate
    gain: Estimate | None = None
    known: bool = True


def identify_specific_heat(
    drives: Sequence[tuple[Record, ChannelDrive]], parameters: Parameters, heat_loss: HeatLoss
) -> Experiment:
    """Specific heat from voltage ramps, with the rest before and the cooling after each.

    The most probable c_p of eq. (2) on the voltage as read, freed of its noise: noise of the
    voltage heats a model but no wire, and a wire that is taken to be slower smooths it away. The
    paper's slope of dT/dt over f(T, V) is in `details` as "differentiator"; differentiated noise
    biases it. c_p is conditional on wire.mass: only m c_p enters the equation. Unknown beside it
    are ambient and the camera's zero, delay (of the size of a sample period) and lag; the standard
    error includes these, R and h, coloured noise and that of the voltage.

    Args:
        drives: records with channels that hold ramps.
        parameters: wire.mass, wire.surface_area, environment.ambient_temperature and A_s.
        heat_loss: R and h.

    Raises:
        InputError: no ramp, no temperature, or no rise of it below A_s.
    """
    limit = float(parameters[AUSTENITE_START])
    cuts = [cut_windows(record, drive, limit) for record, drive in drives]
    chosen, findings = choose_windows(cuts, limit, PARAMETER)
    sources = [
        f"{record.path}: {drive.channel}, {len(cut)} ramps"
        for (record, drive), cut in zip(drives, cuts, strict=True)
    ]
    windows = [window for of_drive in chosen for window in of_drive]
    where = "; ".join(sources)
    if not windows:
        raise InputError(
            f"{where}: fewer than {FEWEST_SAMPLES} temperatures around any ramp below A_s = "
            f"{limit:.1f} K, expected a ramp that stays below it"
        )
    rise = max(float(np.ptp(median_filter(w.temperature, 5, mode="nearest"))) for w in windows)
    noise = float(np.median([np.std(np.diff(w.temperature)) for w in windows])) / math.sqrt(2.0)
    if rise < _SMALLEST_RISE * noise:
        raise InputError(
            f"{where}: the temperature rises by {rise:.2g} K at a noise of {noise:.2g} K, "
            f"expected {_SMALLEST_RISE:g} times as much or more"
        )

    # One observation a drive: the readings within its windows.
    used = [(*drive, own) for drive, own in zip(drives, chosen, strict=True) if own]
    lean = [_lean(*one) for one in used]
    rigs = [_one_wire(parameters, drive.channel) for _, drive, _ in used]
    shortest = max(shared_bin([r], p, 0.0) for r, p in zip(lean, rigs, strict=True))
    observations = []
    for record, rig in zip(lean, rigs, strict=True):
        observation = observe(record, rig, shortest, ("temperature",))
        (signal,) = observation.signals
        # Stamps may be off by the longer sample period; every record has a room of its own.
        delay = max(one.period for one in record.signals.values())
        sensor = replace(signal.sensor, zero_std=_AMBIENT_STD, clock_std=delay)
        observations.append(replace(observation, signals=(replace(signal, sensor=sensor),)))
    result, blind = _fitted(observations, windows, parameters, heat_loss)
    estimate, remarks = _estimate(result, blind, windows, parameters, heat_loss)
    models = []
    for place, (_, _, of_drive) in enumerate(used):
        observation = result.fit.problem.observations[place]
        simulation = observation.simulate(result.fit.parameters)
        zero = _off(result, OFFSET)[place].value
        course = observation.course(observation.signals[0], simulation)
        models += [
            np.asarray(zero + np.interp(window.temperature_time, observation.grid, course))
            for window in of_drive
        ]
    paper, rates = slope_of_rates(
        windows, [float(model.min()) for model in models], heat_loss.resistance.value,
        heat_loss.coefficient.value * parameters["wire.surface_area"], parameters["wire.mass"],
    )
    n = sum(len(w.temperature) for w in windows)
    late = min(_off(result, DELAY), key=lambda off: off.std)  # of the record that tells it best
    lag = _number(result, LAG)
    details = {
        "differentiator": paper,
        "time_constant": _time_constant(result, parameters, n),
        "delay": Estimate(late.value, late.std, "s", "stamps of temperature - voltage", n),
        "lag": Estimate(lag.value, lag.std, "s", "lag of the temperature", n,
                        informed=lag.informed),
    }  # fmt: skip
    estimates = {PARAMETER: estimate}
    if lag.value > _SIGNIFICANT * lag.std:
        estimates[CAMERA_LAG] = details["lag"]
    if not heat_loss.known:
        # c_p and h belong together: a file with this c_p and another h has the wrong tau.
        h = _number(result, COEFFICIENT)
        estimates[COEFFICIENT] = Estimate(
            h.value, h.std, "W/(m2 K)", "output-error fit of eq. (2) to the ramps", n
        ).with_shares(_scales(h.value, heat_loss, parameters))
    # Measured and fitted temperature, one window after the other, NaN in between.
    volts = [np.interp(w.temperature_time, w.voltage_time, w.voltage) for w in windows]
    columns = {
        "time": [w.temperature_time for w in windows],
        "temperature": [w.temperature for w in windows], "model": models, "voltage": volts,
    }
    curves = {
        name: np.concatenate([piece for part in parts for piece in (part, [np.nan])])
        for name, parts in columns.items()
    }
    return Experiment(
        "E3", "Specific heat", estimates, (*findings, *remarks), curves | rates, where, details
    )


# --- The fit: what is observed, what is unknown.

def observe_channel(
    record: Record, channel: str, parameters: Parameters, quantities: Collection[str]
) -> Observation:
    """One wire of a record by itself, all of its readings.

    Raises:
        InputError: no voltage of it, or none of these quantities.
    """
    own = {name: s for name, s in record.signals.items() if name.startswith(f"{channel}.")}
    alone, rig = replace(record, signals=own), _one_wire(parameters, channel)
    return observe(alone, rig, shared_bin([alone], rig), quantities)


def _one_wire(parameters: Parameters, channel: str) -> Parameters:
    return parameters.replace({
        "bench.channels": (channel,), "bench.channel_sides": ("front",), "load.kind": "clamped",
    })  # fmt: skip


def _lean(record: Record, drive: ChannelDrive, windows: Sequence[Window]) -> Record:
    """The drive from some time before the first window to the end of the last, and the readings
    inside them."""
    names = {kind: f"{drive.channel}.{kind}" for kind in ("voltage", "temperature")}
    time, volts = samples(record, names["voltage"])
    begin, end = windows[0].voltage_time[0] - _HISTORY, windows[-1].voltage_time[-1]
    inside = (time >= begin) & (time <= end)
    read = np.concatenate([w.temperature_time for w in windows])
    kelvin = np.concatenate([w.temperature for w in windows])
    signals = {
        names["voltage"]: Signal(names["voltage"], "V", time[inside], volts[inside]),
        names["temperature"]: Signal(names["temperature"], "K", read, kelvin),
    }
    return Record(record.path, record.start_ns, signals)


def _fitted(
    observations: Sequence[Observation], windows: Sequence[Window], parameters: Parameters,
    heat_loss: HeatLoss,
) -> tuple[Result, Result | None]:
    """By the ramps alone, with the noise that this leaves; and with what is known of h beside."""
    cold = float(np.median([np.percentile(w.temperature, 5) for w in windows]))
    camera = _lag(parameters)[1]
    free = _unknowns(parameters, heat_loss, cold, camera, known=False)
    place = free.names.index(PARAMETER)
    starts = [np.where(np.arange(len(free.items)) == place, x, 0.0) for x in _STARTS]
    problem = Problem.of(observations, voltage_noise=True)
    blind, tried = recalibrate(problem, free.parameters(starts[0]), free, starts)
    lag = float(free.values(blind.x)[free.names.index(LAG)])
    if lag > _lag(parameters)[0] + _SIGNIFICANT * camera:
        # A camera as slow as that is not one of those that were thought of.
        found = dict(zip(free.names, free.values(blind.x).tolist(), strict=True))
        # Of two time constants in a row no reading says which is the wire's: that whose c_p is
        # nearer to what is known of it.
        loss = found[COEFFICIENT] * parameters["wire.surface_area"] / parameters["wire.mass"]
        swapped = {**found, PARAMETER: found[LAG] * loss, LAG: found[PARAMETER] / loss}
        expected = float(parameters[PARAMETER])
        values = min(found, swapped, key=lambda v: abs(math.log(v[PARAMETER] / expected)))
        camera = values[LAG]
        free = _unknowns(parameters, heat_loss, cold, camera, known=False)
        blind = fit(blind.problem, free, free.x_of(values.values()))
    for _ in range(_MOVES):
        blind = fit(blind.problem.moved(blind.parameters, blind.z), free, blind.x, rounds=2)
    if not heat_loss.known:
        return result_of(blind, tried), None
    unknowns = _unknowns(parameters, heat_loss, cold, camera, known=True)
    first = np.clip(unknowns.x_of(free.values(blind.x)), -_NEAR, _NEAR)
    known = fit(blind.problem, unknowns, first, keep_noise=True)
    return result_of(known, [known]), result_of(blind, tried)


def _lag(parameters: Parameters) -> tuple[float, float]:
    """What is believed of the camera's, s."""
    mean = float(parameters[LAG] or parameters[CAMERA_LAG])
    return mean, max(parameters.std(CAMERA_LAG), _LEAST)


def _unknowns(
    parameters: Parameters, heat_loss: HeatLoss, ambient: float, lag_std: float, known: bool
) -> Unknowns:
    """Where E2 has measured the gain, the ramps share it whatever R is: R is held, its error
    added in the end."""
    loss, gain = heat_loss.coefficient, heat_loss.gain
    source = gain or loss
    of_h = source.statistical / source.value if known else _ANY
    if known and not gain:
        of_h = source.relative_std
    believed = {
        COEFFICIENT: (loss.value, of_h * loss.value),
        PARAMETER: (float(parameters[PARAMETER]), _ANY * parameters[PARAMETER]),
        AMBIENT: (ambient, _AMBIENT_STD),
        LAG: (_lag(parameters)[0], lag_std),
    }
    if gain is None:
        r = float(parameters[RESISTANCE])
        own = heat_loss.resistance
        # What the scales of these sensors do to R they do to h too, where these ramps tell it.
        of_r = own.relative_std if known else own.statistical / own.value
        believed[RESISTANCE] = (r, of_r * r)
    items = tuple(
        Unknown(
            name, mean, std, float(BY_NAME[name].low or 0.0), float(BY_NAME[name].high or np.inf),
            log=name not in (AMBIENT, LAG),
        )
        for name, (mean, std) in believed.items() if std > 0.0
    )  # fmt: skip
    base = parameters.replace({COEFFICIENT: loss.value})
    return Unknowns(base, items, len(items), len(items))


# --- What it found.


def _number(result: Result, name: str) -> Number:
    return next(number for number in result.numbers if number.name == name)


def _logs(result: Result, *names: str) -> Array:
    """Covariance of the logarithms of some numbers."""
    every = [number.name for number in result.numbers]
    chosen = [every.index(name) for name in names]
    std = np.array([result.numbers[k].std / result.numbers[k].value for k in chosen])
    return np.asarray(result.correlation[np.ix_(chosen, chosen)] * np.outer(std, std))


def _off(result: Result, kind: str) -> list[Off]:
    return [off for off in result.off if off.kind == kind]


def _time_constant(result: Result, parameters: Parameters, n: int) -> Estimate:
    values = [_number(result, name).value for name in (PARAMETER, COEFFICIENT)]
    tau = parameters["wire.mass"] / parameters["wire.surface_area"] * values[0] / values[1]
    weights = np.array([1.0, -1.0])
    std = math.sqrt(float(weights @ _logs(result, PARAMETER, COEFFICIENT) @ weights))
    return Estimate(tau, tau * std, "s", "m c_p/(h A_c)", n)


def _estimate(
    result: Result, blind: Result | None, windows: Sequence[Window], parameters: Parameters,
    heat_loss: HeatLoss,
) -> tuple[Estimate, list[Finding]]:
    tau = _time_constant(result, parameters, 0).value
    checks = [
        check_delay(result, tau), check_lag(result, tau, parameters), check_misfit(result, tau)
    ]
    if blind is not None:
        other = 0.0 if heat_loss.gain else math.hypot(*scale_of_gain(parameters).values())
        checks.append(check_gain(result, blind, other))
    # Random errors grow with the misfit; what the checks doubt besides comes on top.
    relative = math.sqrt(float(_logs(result, PARAMETER)[0, 0]))
    relative *= max(check.factor for check in checks)
    of_r = heat_loss.resistance.statistical / heat_loss.resistance.value if heat_loss.gain else 0.0
    relative = math.hypot(relative, of_r, *(check.doubt for check in checks))
    findings = [check.finding for check in checks if check.finding is not None]
    value = _number(result, PARAMETER).value
    method = (
        "output-error fit of eq. (2) to the ramps, "
        f"m = {parameters['wire.mass'] * 1e3:.4g} g taken as exact"
    )
    n = sum(len(w.temperature) for w in windows)
    estimate = Estimate(value, value * relative, "J/(kg K)", method, n)
    return estimate.with_shares(_scales(value, heat_loss, parameters)), findings


def _scales(value: float, heat_loss: HeatLoss, parameters: Parameters) -> dict[str, float]:
    """Systematic errors of c_p, or of h by ramps alone: time is told well, so m c_p goes with
    h A_c as these sensors make it. With an h of others they have no part in it."""
    if heat_loss.known:
        loss = heat_loss.coefficient
        return {name: value * share / loss.value for name, share in loss.shares.items()}
    resistance = heat_loss.resistance
    shares = {name: -share / resistance.value for name, share in resistance.shares.items()}
    for name, share in scale_of_gain(parameters).items():
        shares[name] = shares.get(name, 0.0) - share
    return {name: value * share for name, share in shares.items()}


# --- What may be wrong with a fit of the heat equation, and by how much c_p is then in doubt.

SUBJECT = "wire.specific_heat"
_SIGNIFICANT = 3.0
_SMALL_DELAY = 1e-3
_SMALL = 0.01  # of c_p, of the steady rise or of the rise of a ramp: what is not worth a warning
_BAD_MISFIT = 6.0
_FEWEST_IN_BIN = 3
_COLD = 0.02  # of the rise
_TOLD = 0.1  # of the wire's time constant, error of a lag that the ramps by themselves tell


@dataclass(frozen=True)
class Check:
    """`factor` times the random error and, added in squares, the relative `doubt` of c_p."""

    finding: Finding | None = None
    factor: float = 1.0
    doubt: float = 0.0


def check_delay(result: Result, tau: float) -> Check:
    """Whether an offset between the stamps, a small lag of the camera's in it, was resolved.

    Args:
        result: the fit with its delay; tau: s.
    """
    # Delay and lag of the record that tells them best: their sum is known better than they.
    fitted, delays = result.fit, _off(result, DELAY)
    best = min(range(len(delays)), key=lambda k: delays[k].std)
    items = [item for own in fitted.problem.nuisances for item in own.items]
    place = [k for k, item in enumerate(items) if item.kind == DELAY][best]
    weights = np.zeros(len(fitted.joint))
    weights[len(fitted.x) + place] = items[place].std
    k = fitted.unknowns.names.index(LAG)
    weights[k] = fitted.unknowns.items[k].std
    late = delays[best].value + _number(result, LAG).value
    std = math.sqrt(float(weights @ fitted.joint @ weights))
    assumed = min(off.prior_std for off in delays)
    numbers = {"delay": late, "delay_std": std}
    if std > 0.5 * assumed:
        text = (
            "a time offset between voltage and temperature cannot be told from thermal inertia "
            f"here (no jump of the voltage among the samples used); +- {assumed * 1e3:.0f} ms are "
            "in the error"
        )
        large = std > _SMALL * tau
        return Check(Finding("warning" if large else "info", SUBJECT, text, numbers))
    text = (
        f"temperature stamps lie {late * 1e3:+.1f} +- {std * 1e3:.1f} ms behind "
        "those of the voltage"
    )
    if abs(late) >= max(_SIGNIFICANT * std, _SMALL_DELAY):
        text += "; taken at face value they would pass for thermal inertia"
    far = abs(late) > _SIGNIFICANT * math.hypot(assumed, _lag(result.fit.parameters)[1])
    return Check(Finding("warning" if far else "info", "temperature", text, numbers))


def check_lag(result: Result, tau: float, parameters: Parameters) -> Check:
    """Whether a second time constant was found: it may be the camera's, or the wire's own."""
    lag = _number(result, LAG)
    believed, std = _lag(parameters)
    if abs(lag.value - believed) < max(_SIGNIFICANT * max(lag.std, std), _SMALL * tau):
        # What the ramps alone tell of it, the prior taken off.
        alone = lag.std / math.sqrt(max(lag.informed, _LEAST))
        if alone < _TOLD * tau:
            return Check()
        text = (
            f"the ramps cannot tell a lag of the thermometer from c_p: {believed:.2g} +- {std:.2g} "
            f"s is assumed ({CAMERA_LAG}); more than that passes for thermal inertia (time "
            f"constant of the wire {tau:.3g} s)"
        )
        return Check(Finding("info", SUBJECT, text, {"lag_std": alone, "time_constant": tau}))
    swapped = lag.value / tau * _number(result, PARAMETER).value
    text = (
        f"the temperature follows with two time constants, {tau:.3g} s and {lag.value:.3g} +- "
        f"{lag.std:.1g} s: a camera that lags, whose lag would pass for thermal inertia, or a wire "
        "that does not follow eq. (2) with one. Taken for the wire's is the first, whose c_p is "
        f"nearer to what was known; were it the second, c_p would be {swapped:.4g} J/(kg K)"
    )
    # Where the two differ clearly, a lag is the smaller one; near each other they trade places.
    doubt = min(lag.value / tau, tau / lag.value) ** 2
    numbers = {"lag": lag.value, "lag_std": lag.std, "swapped": swapped}
    return Check(Finding("warning", SUBJECT, text, numbers), doubt=doubt)


def check_gain(result: Result, blind: Result, scales: float) -> Check:
    """Whether the ramps by themselves ask for the steady rise that E2 measured.

    Args:
        result: with what is known of h; blind: without; scales: relative error of those of
            these sensors, where others have measured h.
    """
    known, free = _number(result, COEFFICIENT), _number(blind, COEFFICIENT)
    difference = math.log(known.believed / free.value)
    error = math.hypot(free.std / free.value, known.prior_std / known.believed, scales)
    if abs(difference) < max(_SIGNIFICANT * error, _SMALL):
        return Check()
    cp, other = _number(result, PARAMETER), _number(blind, PARAMETER)
    text = (
        f"the ramps ask for a steady rise {100.0 * difference:+.1f} +- {100.0 * error:.1f} % off "
        "that of the known R and h: latent heat, a lagging sensor or another air flow; with h "
        f"free c_p is {other.value:.1f} J/(kg K) and h {free.value:.1f} W/(m2 K); the error of "
        "c_p covers both"
    )
    numbers = {"gain_difference": difference, "gain_difference_std": error}
    doubt = abs(math.log(other.value / cp.value))
    return Check(Finding("warning", SUBJECT, text, numbers), doubt=doubt)


def check_misfit(result: Result, tau: float) -> Check:
    """Whether residuals stay on one side over a time constant (s) anywhere."""
    # Largest mean residual over a time constant: in K, over what such means scatter by where the
    # wire is cold, and over the rise.
    found: list[tuple[float, float, float]] = []
    for block in result.fit.problem.blocks:
        left, model = result.fit.left[block.rows], result.fit.predicted[block.rows]
        signal, rise = block.signal, float(np.ptp(model))
        width = max(tau, _FEWEST_IN_BIN * signal.period)
        which = np.floor((signal.time - signal.time[0]) / width).astype(np.intp)
        _, which, count = np.unique(which, return_inverse=True, return_counts=True)
        means = np.bincount(which, left) / count
        cold = np.bincount(which, model - model.min() < _COLD * rise) == count
        scatter = float(np.sqrt(np.mean(means[cold] ** 2))) if cold.any() else 0.0
        error = np.maximum(scatter, signal.noise / np.sqrt(count))
        worst = int(np.argmax(np.where(count >= _FEWEST_IN_BIN, np.abs(means) / error, 0.0)))
        largest = float(means[worst])
        found.append((largest, abs(largest) / float(error[worst]), abs(largest) / rise))
    mean, errors, share = max(found, key=lambda one: one[1])
    if errors < _BAD_MISFIT or share < _SMALL:
        return Check()
    text = (
        f"the heat equation misses the measured temperature by {mean:+.2f} K over a time constant "
        f"({errors:.0f} standard errors, {100.0 * share:.0f} % of the rise): the wire or its "
        "camera does not follow eq. (2) with one time constant; the error of c_p is widened in "
        "proportion"
    )
    numbers = {"misfit": mean, "standard_errors": errors}
    return Check(Finding("warning", SUBJECT, text, numbers), factor=errors / _SIGNIFICANT)


# --- The paper's own way to the specific heat: slope of dT/dt over f(T, V) (eq. 5, Fig. 5).

FILTER_TIME = 0.1
_MOST_CELLS = 1_000_000


def slope_of_rates(
    windows: Sequence[Window], ambient: Sequence[float], resistance: float, heat_loss: float,
    mass: float,
) -> tuple[Estimate, dict[str, Array]]:
    """c_p in J/(kg K) from 1/slope of dT/dt over f(T, V) = (V^2/R - h A_c (T - T_inf))/m.

    A differentiator of time constant FILTER_TIME gives dT/dt; f passes the same filter, so that
    both lag alike. The camera's noise is in both f and dT/dt and biases the slope.

    Args:
        windows: measured ramps; ambient: K, one a window.
        resistance: ohm; heat_loss: h A_c in W/K; mass: kg.

    Returns:
        The estimate, and the driven samples: "force" f in W/kg and "rate" dT/dt in K/s.
    """
    rates, forces = [], []
    for w, surrounding in zip(windows, ambient, strict=True):
        period = float(np.median(np.diff(w.temperature_time)))
        period = max(period, float(np.ptp(w.temperature_time)) / _MOST_CELLS)
        grid = np.arange(w.temperature_time[0], w.temperature_time[-1], period)
        temperature = np.interp(grid, w.temperature_time, w.temperature)
        voltage = np.interp(grid, w.voltage_time, w.voltage)
        force = (voltage**2 / resistance - heat_loss * (temperature - surrounding)) / mass
        kept = float(np.exp(-period / FILTER_TIME))
        smooth = first_order_lag(temperature, kept, temperature[0])
        driven = (voltage > 0.05 * voltage.max()) & (grid > grid[0] + 5.0 * FILTER_TIME)
        rates.append(((temperature - smooth) / FILTER_TIME)[driven])
        forces.append(first_order_lag(force, kept, force[0])[driven])
    rate, force = np.concatenate(rates), np.concatenate(forces)
    slope = float(force @ rate) / float(force @ force) if len(rate) else 0.0
    if slope == 0.0:
        raise InputError("the ramps do not heat the wire for longer than the filter's time")
    left = rate - slope * force
    # Filtered samples repeat each other over the filter's time.
    effective = max(len(rate) * period / (2.0 * FILTER_TIME), 2.0)
    std = float(np.std(left)) / math.sqrt(effective) / float(np.sqrt(np.mean(force**2)))
    estimate = Estimate(
        1.0 / slope, std / slope**2, "J/(kg K)",
        "slope of filtered dT/dt over f(T, V) as in the paper; biased by noise", len(rate),
    )
    return estimate, {"force": force, "rate": rate}
