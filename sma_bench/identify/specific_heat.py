"""E3, specific heat: the heat equation alone, fitted to ramps below A_s (eq. 5, Figs. 4 and 5)."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.nuisances import DELAY, OFFSET
from sma_bench.estimation.observation import Observation, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.result import Result, result_of
from sma_bench.estimation.solver import fit, recalibrate
from sma_bench.estimation.unknowns import Unknown, Unknowns, range_of
from sma_bench.findings import Finding
from sma_bench.identify import signals
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.identify.signals import AMBIENT, CAMERA_LAG, COEFFICIENT, LAG, SPECIFIC_HEAT
from sma_bench.identify.staircases import scale_of_gain
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records import Record
from sma_bench.records.record import Signal, first_order_lag, samples

_BEFORE, _AFTER, _HISTORY = 3.0, 12.0, 10.0  # s before and after a ramp; before the first window
_FEWEST_SAMPLES = 30  # of a window
_CLEARLY = 3.0  # noise floors below A_s: hot ramps are cut there, as noise must not decide where
_SMALLEST_RISE = 10.0  # times the noise
_AMBIENT_STD = 2.0  # K; also of the camera's zero in each record
_LEAST = 1e-6  # instead of an error or share of 0
_ANY = 1.0  # standard deviation of the logarithm of an unknown number
_STARTS = (0.0, -1.0, 1.0)  # of c_p, in prior deviations
_NEAR = 3.0  # prior deviations within which the fit with the known h starts
_MOVES = 4  # times that nuisances are linearised again
_KNOWN_LAG = 0.1  # of the wire's time constant: largest error of a lag that the records determine
_SIGNIFICANT = 3.0  # standard errors
_SMALL_DELAY = 1e-3  # s
_SMALL = 0.01  # of c_p, of the steady rise or of the rise of a ramp: less is not worth a warning
_BAD_MISFIT, _FEWEST_IN_BIN = 6.0, 3  # standard errors of a bin's mean residual; its samples
_COLD = 0.02  # of the rise: in colder bins, residuals show their scatter
_FILTER_TIME, _MOST_CELLS = 0.1, 1_000_000  # s; samples of a window: of the paper's differentiator
Drives = Sequence[tuple[Record, signals.Drive]]


class Window(NamedTuple):
    """One ramp of a record, with some time before and after it; s, V, K."""

    voltage_time: Array
    voltage: Array
    temperature_time: Array
    temperature: Array
    cut_off: int  # samples above A_s and after them
    highest: float  # K, of the whole window


class HeatLoss(NamedTuple):
    """R and h, from E1 and E2 or from the parameters."""

    resistance: Estimate  # V^2/P: voltage before the leads, heat of a wire
    coefficient: Estimate  # h
    gain: Estimate | None = None  # 1/(R h A_c) in K/V^2, of E2, independent of R
    known: bool = True  # False if h is a default: then the ramps must determine it


def identify_specific_heat(drives: Drives, parameters: Parameters,
                           heat_loss: HeatLoss) -> Experiment:
    """Specific heat from voltage ramps, with the rest before and the cooling after each: the most
    probable c_p of eq. (2), given wire.mass, on the voltage corrected for its noise. Its error
    includes ambient, zero, delay and lag of the camera, R and h, and correlated noise. The paper's
    slope of dT/dt over f(T, V), biased by noise, is in `details` as "differentiator". Raises
    InputError: no temperature, or no rise of it below A_s."""
    chosen, where, findings = _windows(drives, float(parameters[TRANSITIONS["A_s"]]))
    windows = [window for of_drive in chosen for window in of_drive]
    rise = max(float(np.ptp(_median_of_five(w.temperature))) for w in windows)
    noise = float(np.median([np.std(np.diff(w.temperature)) for w in windows])) / math.sqrt(2.0)
    if rise < _SMALLEST_RISE * noise:
        raise refusal("no rise of ramps", where=where, rise=rise, noise=noise, times=_SMALLEST_RISE)
    # One observation per drive: the readings within its windows, the voltage from some time before.
    # Stamps may be off by the longest sample period; each record has an ambient of its own.
    used = [(*drive, own) for drive, own in zip(drives, chosen, strict=True) if own]
    reduced = []
    for record, drive, own in used:
        volts, kelvin = (f"{drive.channel}.{kind}" for kind in ("voltage", "temperature"))
        time, values = samples(record, volts)
        begin, end = own[0].voltage_time[0] - _HISTORY, own[-1].voltage_time[-1]
        inside = (time >= begin) & (time <= end)
        read = np.concatenate([w.temperature_time for w in own])
        degrees = np.concatenate([w.temperature for w in own])
        kept = {volts: Signal(volts, "V", time[inside], values[inside]),
                kelvin: Signal(kelvin, "K", read, degrees)}
        rig = signals.one_wire(parameters, drive.channel)
        reduced.append((Record(record.path, record.start_ns, kept), rig))
    shortest = max(shared_bin([record], rig, 0.0) for record, rig in reduced)
    # When a commanded step came between two readings is unknown: one delay for all of a ramp.
    steps = [record[f"{drive.channel}.voltage"].period / math.sqrt(12.0)
             if record.get("voltage_command") else 0.0 for record, drive, _ in used]
    observations = []
    for record, rig in reduced:
        observation = observe(record, rig, shortest, ("temperature",))
        (signal,) = observation.signals
        delay = max(one.period for one in record.signals.values())
        sensor = replace(signal.sensor, zero_std=_AMBIENT_STD, clock_std=delay)
        observations.append(replace(observation, signals=(replace(signal, sensor=sensor),)))
    cold = float(np.median([np.percentile(w.temperature, 5) for w in windows]))
    result, blind = _fitted(observations, cold, parameters, heat_loss)
    off = {kind: [o for o in result.off if o.item.kind == kind] for kind in (DELAY, OFFSET)}
    models: list[Array] = []
    fits = zip(used, result.fit.problem.observations, off[OFFSET], strict=True)
    for (_, _, of_drive), observation, zero in fits:
        simulation = observation.simulate(result.fit.parameters)
        predicted = observation.history(observation.signals[0], simulation)
        for w in of_drive:
            models.append(zero.value + np.interp(w.temperature_time, observation.grid, predicted))
    # The numbers. Random errors grow with the misfit; the checks add systematic ones.
    mass, area = parameters["wire.mass"], parameters["wire.surface_area"]
    n, numbers = sum(len(w.temperature) for w in windows), {own.name: own for own in result.numbers}
    cp, h, lag = (numbers[name] for name in (SPECIFIC_HEAT, COEFFICIENT, LAG))
    both = [list(numbers).index(name) for name in (SPECIFIC_HEAT, COEFFICIENT)]
    logs = np.array([cp.std / cp.value, h.std / h.value])
    logs = result.correlation[np.ix_(both, both)] * np.outer(logs, logs)
    tau = mass / area * cp.value / h.value
    of_tau = math.sqrt(logs[0, 0] + logs[1, 1] - 2.0 * logs[0, 1])
    remarks, factor, systematic = _checks(result, blind, tau, parameters, heat_loss, steps)
    resistance, loss, gain, known = heat_loss
    of_r = resistance.statistical / resistance.value if gain else 0.0
    relative = math.hypot(math.sqrt(logs[0, 0]) * factor, of_r, systematic)
    method = "output-error fit of eq. (2) to the ramps"
    # tau is known well, so c_p has the scale errors of the known h, or of h by these sensors.
    if known:
        scales = {name: share / loss.value for name, share in loss.shares.items()}
    else:
        scales = {name: -share / resistance.value for name, share in resistance.shares.items()}
        for name, share in scale_of_gain(parameters).items():
            scales[name] = scales.get(name, 0.0) - share
    of_cp, of_h = ({n: e.value * share for n, share in scales.items()} for e in (cp, h))
    words = f"{method}, m = {mass * 1e3:.4g} g taken as exact"
    estimate = Estimate(cp.value, cp.value * relative, "J/(kg K)", words, n)
    estimates = {SPECIFIC_HEAT: estimate.with_shares(of_cp)}
    coldest = [float(model.min()) for model in models]
    paper, rates = slope_of_rates(windows, coldest, resistance.value, loss.value * area, mass)
    # The delay of the record in which it is known best.
    late, step = min(zip(off[DELAY], steps, strict=True), key=lambda o: o[0].std)
    late_std, words = math.hypot(late.std, step), "stamps of temperature - voltage"
    slow = Estimate(lag.value, lag.std, "s", "lag of the temperature", n, informed=lag.informed)
    details = {"differentiator": paper,
               "time_constant": Estimate(tau, tau * of_tau, "s", "m c_p/(h A_c)", n),
               "delay": Estimate(late.value, late_std, "s", words, n), "lag": slow}
    if lag.value > _SIGNIFICANT * lag.std:
        estimates[CAMERA_LAG] = slow
    if not known:
        # c_p and h belong together: a file with this c_p and another h has the wrong tau.
        estimates[COEFFICIENT] = Estimate(h.value, h.std, "W/(m2 K)", method, n).with_shares(of_h)
    # Measured and fitted temperature, one window after the other, NaN in between.
    driven = [np.interp(w.temperature_time, w.voltage_time, w.voltage) for w in windows]
    columns = {"time": [w.temperature_time for w in windows],
               "temperature": [w.temperature for w in windows], "model": models, "voltage": driven}
    curves = {name: np.concatenate([piece for part in parts for piece in (part, [np.nan])])
              for name, parts in columns.items()}
    return Experiment("E3", "Specific heat", estimates, (*findings, *remarks), curves | rates,
                      where, details)


def _windows(drives: Drives, limit: float) -> tuple[list[list[Window]], str, list[Finding]]:
    """Ramps of each drive below `limit` [K], else their cold beginnings; source; remarks."""
    found: list[list[Window]] = []
    for record, drive in drives:
        voltage_time, voltage = samples(record, f"{drive.channel}.voltage")
        time, temperature = samples(record, f"{drive.channel}.temperature")
        clear, ramps = limit - _CLEARLY * noise_floor(temperature), drive.segments.ramps
        found.append([])
        for k, ramp in enumerate(ramps):
            start = max(ramp.start - _BEFORE, ramps[k - 1].stop if k else -math.inf)  # no overlap
            after = ramps[k + 1].start if k + 1 < len(ramps) else math.inf
            stop = min(ramp.stop + _AFTER, max(after - _BEFORE, ramp.stop))
            inside = (time >= start) & (time <= stop)
            t, y = time[inside], temperature[inside]
            if len(t) < _FEWEST_SAMPLES:
                continue
            # From A_s on, latent heat is in the curve until the wire is cold again: cut there.
            smooth = _median_of_five(y)
            kept = int(np.argmax(smooth > clear)) if (smooth > limit).any() else len(t)
            first = max(int(np.searchsorted(voltage_time, start)) - 1, 0)
            last = int(np.searchsorted(voltage_time, t[kept - 1] if kept else start)) + 2
            of_volts = voltage_time[first:last], voltage[first:last]
            found[-1].append(Window(*of_volts, t[:kept], y[:kept], len(t) - kept, smooth.max()))
    every = [w for own in found for w in own]
    hot = [w for w in every if w.cut_off]
    some_cold = len(hot) < len(every)
    chosen = [[w for w in own if not (some_cold and w.cut_off)
               and len(w.temperature) >= _FEWEST_SAMPLES] for own in found]
    each = zip(drives, found, strict=True)
    where = "; ".join(f"{r.path}: {drive.channel}, {len(own)} ramps" for (r, drive), own in each)
    if not any(chosen):
        raise refusal("no cold ramp", where=where, least=_FEWEST_SAMPLES, limit=limit)
    if not hot:
        return chosen, where, []
    return chosen, where, [remark(
        "some ramps too hot" if some_cold else "ramps too hot", limit=limit, ramps=len(hot),
        of=len(every), excluded=sum(w.cut_off for w in hot), highest=max(w.highest for w in hot))]


def _median_of_five(values: Array) -> Array:
    """Running median (n,) of values (n,), which removes single outliers."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="edge"), 5)
    return np.asarray(np.median(windows, axis=-1))


def _fitted(observations: Sequence[Observation], cold: float, parameters: Parameters,
            heat_loss: HeatLoss) -> tuple[Result, Result | None]:
    """Fits with the known h, if any, and with h free. `cold`: K, of the wire before ramps."""
    stated, camera = _lag(parameters)
    free = _unknowns(parameters, heat_loss, cold, camera, known=False)
    starts = [np.where(np.array(free.names) == SPECIFIC_HEAT, x, 0.0) for x in _STARTS]
    problem = Problem.of(observations, voltage_noise=True)
    blind, tried = recalibrate(problem, free.parameters(starts[0]), free, starts)
    found = dict(zip(free.names, free.values(blind.x).tolist(), strict=True))
    if found[LAG] > stated + _SIGNIFICANT * camera:
        # Of two time constants in series, the wire's is the one with c_p nearer to the given one.
        loss = found[COEFFICIENT] * parameters["wire.surface_area"] / parameters["wire.mass"]
        swapped = {**found, SPECIFIC_HEAT: found[LAG] * loss, LAG: found[SPECIFIC_HEAT] / loss}
        expected = float(parameters[SPECIFIC_HEAT])
        values = min(found, swapped, key=lambda v: abs(math.log(v[SPECIFIC_HEAT] / expected)))
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
    """Stated lag of the camera and its error, s."""
    mean = float(parameters[LAG] or parameters[CAMERA_LAG])
    return mean, max(parameters.std(CAMERA_LAG), _LEAST)


def _unknowns(parameters: Parameters, heat_loss: HeatLoss, ambient: float, lag_std: float,
              known: bool) -> Unknowns:
    """R is fixed where E2 has measured the gain; its error is added at the end."""
    (own, loss, gain, _), of_h = heat_loss, _ANY
    if known:
        of_h = gain.statistical / gain.value if gain else loss.relative_std
    priors = {COEFFICIENT: (loss.value, of_h * loss.value),
              SPECIFIC_HEAT: (float(parameters[SPECIFIC_HEAT]), _ANY * parameters[SPECIFIC_HEAT]),
              AMBIENT: (ambient, _AMBIENT_STD), LAG: (_lag(parameters)[0], lag_std)}
    if gain is None:
        # If the ramps determine h, it has the same scale errors as R: only random ones matter.
        of_r = own.relative_std if known else own.statistical / own.value
        ohm = parameters[signals.RESISTANCE]
        priors[signals.RESISTANCE] = (float(ohm), of_r * ohm)
    items = tuple(Unknown(name, mean, std, *range_of(name), log=name not in (AMBIENT, LAG))
                  for name, (mean, std) in priors.items() if std > 0.0)
    return Unknowns(parameters.replace({COEFFICIENT: loss.value}), items, len(items), len(items))


def _checks(result: Result, blind: Result | None, tau: float, parameters: Parameters,
            heat_loss: HeatLoss, steps: Sequence[float]) -> tuple[list[Finding], float, float]:
    """Checks of a fit: findings, a factor for the random error and a relative systematic error of
    c_p. `blind`: the fit with h free; `tau`: s, of the wire; `steps`: s, errors of delays."""
    findings, factor, systematics = list[Finding](), 1.0, [0.0]
    # An offset between the stamps? The sum of delay and lag (best record) is known best.
    fitted, delays = result.fit, [off for off in result.off if off.item.kind == DELAY]
    best = min(range(len(delays)), key=lambda k: delays[k].std)
    items = [item for own in fitted.problem.nuisances for item in own.items]
    place = [k for k, item in enumerate(items) if item.kind == DELAY][best]
    weights, k = np.zeros(len(fitted.joint)), fitted.unknowns.names.index(LAG)
    weights[len(fitted.x) + place], weights[k] = items[place].std, fitted.unknowns.items[k].std
    numbers = {number.name: number for number in result.numbers}
    lag, cp = numbers[LAG], numbers[SPECIFIC_HEAT]
    late = delays[best].value + lag.value
    std = math.hypot(math.sqrt(float(weights @ fitted.joint @ weights)), steps[best])
    assumed = min(off.item.std for off in delays)
    far = abs(late) > _SIGNIFICANT * math.hypot(assumed, _lag(fitted.parameters)[1])
    resolved = abs(late) >= max(_SIGNIFICANT * std, _SMALL_DELAY)
    cause, is_bad = "delay", far
    if std > 0.5 * assumed:
        cause, is_bad = "delay unresolved", std > _SMALL * tau
    more = "; taken at face value they would pass for thermal inertia" if resolved else ""
    findings.append(remark(cause, "warning" if is_bad else "info", delay=late, delay_std=std,
                           assumed=assumed, more=more))
    # A second time constant: the camera's, or the wire's own?
    stated, std = _lag(parameters)
    own_std = lag.std / math.sqrt(max(lag.informed, _LEAST))  # by the ramps alone
    if abs(lag.value - stated) >= max(_SIGNIFICANT * max(lag.std, std), _SMALL * tau):
        findings.append(remark("two time constants", tau=tau, lag=lag.value, lag_std=lag.std,
                               swapped=lag.value / tau * cp.value))
        # A lag is usually the smaller one; the closer the two, the likelier they are swapped.
        systematics.append(min(lag.value / tau, tau / lag.value) ** 2)
    elif own_std >= _KNOWN_LAG * tau:
        findings.append(remark("lag unresolved", stated=stated, std=std, lag_std=own_std,
                               time_constant=tau))
    # Largest mean residual over a time constant: in K, in standard errors, and over the rise.
    means: list[tuple[float, float, float]] = []
    for block in fitted.problem.blocks:
        signal, rows = block.signal, block.rows
        residual, model = fitted.residual[rows], fitted.predicted[rows]
        width, rise = max(tau, _FEWEST_IN_BIN * signal.period), float(np.ptp(model))
        which = np.floor((signal.time - signal.time[0]) / width).astype(np.intp)
        _, which, count = np.unique(which, return_inverse=True, return_counts=True)
        mean = np.bincount(which, residual) / count
        cold = np.bincount(which, model - model.min() < _COLD * rise) == count
        scatter = float(np.sqrt(np.mean(mean[cold] ** 2))) if cold.any() else 0.0
        error = np.maximum(scatter, signal.noise / np.sqrt(count))
        worst = int(np.argmax(np.where(count >= _FEWEST_IN_BIN, np.abs(mean) / error, 0.0)))
        largest = float(mean[worst])
        means.append((largest, abs(largest) / float(error[worst]), abs(largest) / rise))
    misfit, errors, share = max(means, key=lambda one: one[1])
    if errors >= _BAD_MISFIT and share >= _SMALL:
        factor = errors / _SIGNIFICANT
        findings.append(remark("heat equation misses", misfit=misfit, standard_errors=errors,
                               share=share))
    # Do the ramps alone agree with the steady rise by the known R and h?
    if blind is not None:
        alone = {number.name: number for number in blind.numbers}
        known, free = numbers[COEFFICIENT], alone[COEFFICIENT]
        scales = 0.0 if heat_loss.gain else math.hypot(*scale_of_gain(parameters).values())
        difference = math.log(known.prior_mean / free.value)
        std = math.hypot(free.std / free.value, known.prior_std / known.prior_mean, scales)
        if abs(difference) >= max(_SIGNIFICANT * std, _SMALL):
            other = alone[SPECIFIC_HEAT].value
            systematics.append(abs(math.log(other / cp.value)))
            findings.append(remark("another steady rise", gain_difference=difference,
                                   gain_difference_std=std, other=other, free=free.value))
    return findings, factor, math.hypot(*systematics)


def slope_of_rates(windows: Sequence[Window], ambient: Sequence[float], resistance: float,
                   heat_loss: float, mass: float) -> tuple[Estimate, dict[str, Array]]:
    """c_p in J/(kg K) from 1/slope of dT/dt over f(T, V) = (V^2/R - h A_c (T - T_inf))/m, and the
    driven samples: "force" f in W/kg and "rate" dT/dt in K/s, by a filter of 0.1 s. In SI units."""
    rates, forces = [], []
    for w, surrounding in zip(windows, ambient, strict=True):
        period = float(np.median(np.diff(w.temperature_time)))
        period = max(period, float(np.ptp(w.temperature_time)) / _MOST_CELLS)
        grid = np.arange(w.temperature_time[0], w.temperature_time[-1], period)
        temperature = np.interp(grid, w.temperature_time, w.temperature)
        voltage = np.interp(grid, w.voltage_time, w.voltage)
        force = (voltage**2 / resistance - heat_loss * (temperature - surrounding)) / mass
        decay = float(np.exp(-period / _FILTER_TIME))
        smooth = first_order_lag(temperature, decay, temperature[0])
        driven = (voltage > 0.05 * voltage.max()) & (grid > grid[0] + 5.0 * _FILTER_TIME)
        rates.append(((temperature - smooth) / _FILTER_TIME)[driven])
        forces.append(first_order_lag(force, decay, force[0])[driven])
    rate, force = np.concatenate(rates), np.concatenate(forces)
    slope = float(force @ rate) / float(force @ force) if len(rate) else 0.0
    if slope == 0.0:
        raise InputError("the ramps do not heat the wire for longer than the filter's time")
    effective = max(len(rate) * period / (2.0 * _FILTER_TIME), 2.0)  # independent samples
    scatter = float(np.std(rate - slope * force)) / float(np.sqrt(np.mean(force**2)))
    std = scatter / math.sqrt(effective) / slope**2
    method = "slope of filtered dT/dt over f(T, V) as in the paper; biased by noise"
    paper = Estimate(1.0 / slope, std, "J/(kg K)", method, len(rate))
    return paper, {"force": force, "rate": rate}
