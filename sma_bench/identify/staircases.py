"""Staircases of voltage give the resistance (E1: eq. 3, Fig. 2) and, from steady temperatures, the
heat transfer coefficient (E2: eq. 4, Fig. 3); staircases of a clamped wire's temperature below A_s
give the thermal expansion factor (E8: eq. 8, Fig. 10).

    V = V_0 + R_channel I   R = count (R_channel - R_leads)   sigma - sigma_0 = Theta_T (T - T_0)

V_0 absorbs an offset of the current sensor; Theta_T is negative and its size is alpha E."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import scatter
from sma_bench.findings import Finding
from sma_bench.identify import signals
from sma_bench.identify.fits import SYMBOLS, fit_linear, fit_slope, straight_line
from sma_bench.identify.result import Experiment, refusal, remark, words
from sma_bench.identify.signals import AMBIENT, CAMERA, COEFFICIENT, LEADS, RESISTANCE, Drive
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import CONVECTION_FACTOR, NITI_EXPANSION
from sma_bench.physics.bending import channel_section
from sma_bench.records import Record
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import has_samples, samples

PARAMETER, _START, _DIAMETER = SYMBOLS["Theta_T"], SYMBOLS["A_s"], "wire.diameter"
GAIN, VOLTAGE, CURRENT = "thermal_gain", "sensor.voltage.gain", "sensor.current.gain"
ZERO, _ROOM = "sensor.voltage.offset", "ambient.temperature"
_SIGNIFICANT = 3.0  # standard errors from which a remark becomes a warning
_SIGNIFICANT_BEND = 4.0  # a quiet converter bends a line a little by itself
_LARGE_DIFFERENCE, _LARGE_BEND_OF_R = 0.002, 0.005  # shares of R below which it does not matter
_DRIFTS = 4.0  # standard errors: least drift of a plateau that has not settled
_LARGE_DRIFT, _SMALLEST_DRIFT = 0.01, 0.1  # of the rise; K: likewise, it must exceed all three
_LARGE_BEND_OF_H = 0.02  # of the slope
_DRIFT_STD, _DRIFT_TIME = 1.0, 600.0  # K, std of an unrecorded room's drift; s until it is reached
_SMALL_DRIFT, _FEWEST_TO_DRIFT = 2e-3, 8  # of the rise, least reported; plateaus to fit it
_SHORTEST_PLATEAU, _FEWEST_LEVELS = 5.0, 3  # of E8, as those below: s; temperatures
_STEADY, _WINDOW = 0.3, 2.0  # K of change within s that count as steady
_SAME_LEVEL = 1.0  # K: closer temperatures are one level
_TAIL = 0.6  # of a plateau: its last part, which is averaged
_SLACK = 5.0  # standard errors of the stress: below, a wire is slack
_BAD_MISFIT = 9.0  # chi square per degree of freedom


def identify_resistance(record: Record, staircase: Drive, parameters: Parameters) -> Experiment:
    """Fit V over I through the plateaus of a staircase. Where heating and cooling differ by two
    standard errors the heating slope counts, as in the paper, and half the difference is added to
    the error. InputError: current that does not follow, too few samples, or nothing but leads."""
    staircase = staircase.read(record, "voltage", "current")
    v, i = (staircase.means(record, name) for name in ("voltage", "current"))
    volts, amps, n, findings = v.value, i.value, len(v.value), list[Finding]()
    if np.ptp(amps) < 10.0 * np.median(i.noise):
        raise refusal("current does not follow", path=record.path, channel=staircase.channel,
                      amperes=np.ptp(amps), volts=np.ptp(volts))
    same = staircase.same_level(volts)
    up = np.array([p.direction == "up" for p in staircase.segments.plateaus])

    def covariance(ohm: float) -> Array:
        """Covariance (n, n) of V - ohm I in V^2; equal voltages share converters' errors."""
        noise = np.diag(v.noise**2 + (ohm * i.noise) ** 2)
        return np.asarray(noise + (v.hidden**2 + (ohm * i.hidden) ** 2) * same)

    both = fit_slope([np.ones(n), amps], volts, covariance)
    (intercept, ohm), (zero_std, std) = both.beta.tolist(), both.std.tolist()
    method = "straight line of voltage over current with intercept, both directions"
    details = {"intercept": Estimate(intercept, zero_std, "V", "both directions", n),
               "both": Estimate(ohm, std, "ohm", "both directions", n)}
    # Does the resistance depend on the phase?
    if all(side.sum() >= 3 and np.ptp(volts[side]) > 0.5 * np.ptp(volts) for side in (up, ~up)):
        each = fit_slope([up, ~up, up * amps, ~up * amps], volts, covariance, slope=2)
        for k, (name, side) in enumerate((("heating", up), ("cooling", ~up)), start=2):
            slope, error = float(each.beta[k]), float(each.std[k])
            details[name] = Estimate(slope, error, "ohm", f"{name} plateaus", int(side.sum()))
        heating, cooling = details["heating"].value, details["cooling"].value
        of_both = each.covariance[2:, 2:] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        difference = heating - cooling
        error = math.sqrt(float(np.sum(of_both)) * max(1.0, each.misfit))
        if abs(difference) > max(_SIGNIFICANT * error, _LARGE_DIFFERENCE * heating):
            findings.append(remark("directions differ", heating=heating, cooling=cooling,
                                   difference=difference, difference_std=error,
                                   share=difference / heating))
        if abs(difference) > 2.0 * error:
            ohm, std = heating, math.hypot(float(each.std[2]), 0.5 * difference)
            method = "straight line of voltage over current with intercept, heating slope"
    # Is it straight? b x^2 changes the slope by 4 b / half_range over the range of the current.
    half_range = 0.5 * np.ptp(amps)
    columns = [np.ones(n), amps, ((amps - amps.mean()) / half_range) ** 2]
    curved = fit_slope(columns, volts, covariance)
    bend, error = (4.0 / half_range * float(x[2]) for x in (curved.beta, curved.std))
    if abs(bend) > max(_SIGNIFICANT_BEND * error, _LARGE_BEND_OF_R * ohm):
        std = math.hypot(std, bend / math.sqrt(12.0))  # as if the slope were uniform over its range
        findings.append(remark("bent line", slope_change=bend, slope_change_std=error,
                               share=bend / ohm))
    offset, offset_std = -intercept / ohm, zero_std / ohm
    if abs(offset) > _SIGNIFICANT * offset_std:
        findings.append(remark("current offset", offset=offset, offset_std=offset_std))
    # From the channel to one of its wires; systematic errors, which no record shows.
    count, leads = parameters["wire.count"], parameters[LEADS]
    if ohm <= leads:
        raise refusal("no more than leads", path=record.path, ohm=ohm, name=LEADS, leads=leads)
    systematic = {VOLTAGE: count * ohm * parameters.std(VOLTAGE),
                  CURRENT: -count * ohm * parameters.std(CURRENT)}
    if leads or count > 1:
        systematic[LEADS] = -count * lead_std(parameters)
        method += f", less {leads:g} ohm of leads; wires in parallel: {count}"
    details["channel"] = Estimate(ohm, std, "ohm", method, n)
    wire = Estimate(count * (ohm - leads), count * std, "ohm", method, n).with_shares(systematic)
    ends = np.array([volts.min(), volts.max()])
    curves = {"voltage": volts, "current": amps, "heating": up.astype(float), "line_voltage": ends,
              "line_current": (ends - intercept) / ohm}
    return Experiment("E1", "Resistance", {RESISTANCE: wire}, tuple(findings), curves,
                      staircase.source(record), details)


def lead_std(parameters: Parameters) -> float:
    """Standard deviation of the leads' resistance [ohm]; a default of 0 is exact."""
    stated = parameters[LEADS] > 0.0 or LEADS in parameters.given
    return parameters.std(LEADS) if stated else 0.0


def heated(resistance: Estimate, parameters: Parameters, measured: bool) -> Estimate:
    """V^2/P of a wire, V before the leads, P its heat; `measured`: by E1, less the same leads."""
    count, ohm = parameters["wire.count"], resistance.value
    leads, error = count * parameters[LEADS], count * lead_std(parameters)
    if leads == 0.0:
        return resistance
    ratio, slope = (ohm + leads) / ohm, 1.0 - (leads / ohm) ** 2
    shares = {name: slope * share for name, share in resistance.shares.items()}
    shares[LEADS] = error * (ratio**2 if measured else 2.0 * ratio)
    own = replace(resistance, value=ohm * ratio**2, std=slope * resistance.statistical,
                  systematic=0.0)
    return own.with_shares(shares)


def identify_heat_transfer(record: Record, staircase: Drive, parameters: Parameters,
                           resistance: Estimate) -> Experiment:
    """Heat transfer coefficient and ambient temperature from a voltage staircase: T = T_inf +
    V^2/(R h A_c) with free T_inf, which may drift where the room was not recorded; A_c is taken as
    exact. `details` holds the thermal gain 1/(R h A_c) in K/V^2. `resistance`: of V^2/P, from
    `heated`. InputError: temperature that does not follow the voltage, or free convection."""
    if parameters["wire.convection"] != "constant":
        raise refusal("free convection", path=record.path)
    also = ["current"] if has_samples(record, f"{staircase.channel}.current") else []
    staircase = staircase.read(record, "voltage", "temperature", *also)
    v, t = (staircase.means(record, kind) for kind in ("voltage", "temperature"))
    channel, n, remarks = staircase.channel, len(v.value), list[Finding]()
    volts, kelvin, square = v.value, t.value, v.value**2
    shared = staircase.same_level(volts)  # plateaus that share a converter error
    ones, rise_of_square = np.ones(n), float(np.ptp(square))
    # The room: subtract what was recorded, else allow for a drift of this standard deviation.
    middle = staircase.windows.mean(axis=1)
    duration, size = float(np.ptp(middle)), 0.0
    if has_samples(record, _ROOM):
        room = np.interp(middle, *samples(record, _ROOM))
        kelvin = kelvin - (room - room.mean())
    else:
        size = _DRIFT_STD * min(1.0, duration / _DRIFT_TIME)
    drift = (middle - middle.mean()) / (0.5 * duration)
    if straight_line(square, kelvin).slope * rise_of_square < 10.0 * float(np.median(t.noise)):
        raise refusal("temperature does not follow", path=record.path, channel=channel,
                      rise=np.ptp(kelvin), volts=np.ptp(volts))

    def covariance(gain: float, size: float = size) -> Array:
        """Covariance (n, n) of T - gain V^2 in K^2; equal voltages share converters' errors."""
        sensitivity = 2.0 * gain * volts
        noise = t.noise**2 + (sensitivity * v.noise) ** 2 + t.hidden**2
        hidden = np.outer(sensitivity, sensitivity) * v.hidden**2 * shared
        return np.diag(noise) + hidden + np.outer(size * drift, size * drift)

    fit = fit_slope([ones, square], kelvin, covariance)
    (ambient, gain), (ambient_std, gain_std) = fit.beta.tolist(), fit.std.tolist()
    drifted = 0.0  # K, to either side of the mean, if the staircase shows that the room drifts
    if size and n >= _FEWEST_TO_DRIFT:
        design = np.column_stack([ones, square, drift * size / np.max(np.abs(size * drift))])
        drifting = fit_linear(design, kelvin, covariance(gain, size=0.0))
        far, error = float(drifting.beta[2]), float(drifting.std[2])
        if abs(far) >= max(_SIGNIFICANT * error, _SMALL_DRIFT * gain * rise_of_square):
            drifted = far
            remarks.append(remark("room drifts", drift=2.0 * drifted, std=2.0 * error))
    # Plateaus whose temperature still changed while it was averaged; a straight line's rise over
    # its window has 12 times the variance of the mean.
    limit = max(_SMALLEST_DRIFT, _LARGE_DRIFT * float(np.ptp(kelvin)))
    moving = np.abs(t.drift) > np.maximum(_DRIFTS * np.sqrt(12.0) * t.noise, limit)
    if moving.any():
        settled = kelvin + np.where(moving, t.drift, 0.0)
        moved = fit_slope([ones, square], settled, covariance).beta - fit.beta
        ambient_std, gain_std = math.hypot(ambient_std, moved[0]), math.hypot(gain_std, moved[1])
        worst = int(np.argmax(np.where(moving, np.abs(t.drift), 0.0)))
        remarks.append(remark("plateaus not settled", plateaus=moving.sum(), of=n,
                              largest_drift=t.drift[worst], volts=volts[worst]))
    # Is T straight over V^2, or, with a current, over R times a wire's power, as R may vary?
    heating, errors, what = square, covariance(gain), "squared voltage"
    if has_samples(record, f"{channel}.current"):
        current = staircase.means(record, "current")
        # The current's zero: a plateau at 0 V is better than a line that may not be straight.
        if (undriven := np.abs(volts) < staircase.segments.tolerance).any():
            offset = float(np.mean(current.value[undriven]))
            common = float(np.mean(current.noise[undriven])) / math.sqrt(float(undriven.sum()))
        else:
            offset = float(straight_line(volts, current.value)(np.zeros(1))[0])
            common = float(np.median(current.noise))
        amperes, leads = current.value - offset, parameters["bench.lead_resistance"]
        per_wire = resistance.value / parameters["wire.count"]
        scale = per_wire * (volts - 2.0 * leads * amperes)
        heating, what = per_wire * (volts - leads * amperes) * amperes, "electrical power"
        own = np.diag((scale * current.noise) ** 2) + np.outer(scale, scale) * common**2
        errors = errors + gain**2 * own
    x = heating / float(np.max(heating))
    bent = fit_linear(np.column_stack([ones, x, x * (x - 1.0)]), kelvin, errors)
    bend, error = (2.0 * float(b[2]) / float(bent.beta[1]) for b in (bent.beta, bent.std))
    if abs(bend) >= max(_SIGNIFICANT * error, _LARGE_BEND_OF_H):
        gain_std = math.hypot(gain_std, gain * abs(bend) / math.sqrt(12.0))
        # h at a plateau is the inverse slope of the chord from ambient: 1 - bend/2 at its coldest.
        way = "rises" if bend < 0.0 else "falls"
        remarks.append(remark("coefficient varies", what=what, way=way, size=0.5 * abs(bend),
                              growth=-0.5 * bend, growth_std=0.5 * error))
    known, stated_std = [], parameters.std(AMBIENT)
    if AMBIENT in parameters.given:
        known.append(("stated", parameters[AMBIENT], stated_std))
    if has_samples(record, _ROOM):
        measured, stated = samples(record, _ROOM)[1], record[_ROOM].std
        std = max(float(np.std(measured)), stated_std if stated is None else np.median(stated))
        known.append(("measured", float(np.mean(measured)), std))
    for how, value, std in known:
        off = ambient - value
        if abs(off) > _SIGNIFICANT * math.hypot(ambient_std, std):
            remarks.append(remark("ambient", how=how, ambient=ambient, value=value, difference=off))
    # Systematic: zeros of voltage and camera, the camera's scale, the drift. A camera's zero is
    # calibrated to its step at best.
    shifted = (volts + parameters.std(ZERO)) ** 2
    off = float(fit_slope([ones, shifted], kelvin, covariance).beta[1] - gain)
    method = "steady temperature over squared voltage"
    thermal_gain = Estimate(gain, gain_std, "K/V2", method, n).with_shares({ZERO: off})
    ambient_std = math.hypot(ambient_std, t.step / math.sqrt(12.0))
    zero, of_scale = "sensor.temperature.offset", parameters.std(CAMERA[0])
    shares = {zero: parameters.std(zero), "drift of the room": abs(drifted),
              CAMERA[0]: of_scale * (ambient - CELSIUS_ZERO)}
    cold = Estimate(ambient, ambient_std, "K", "steady temperature at zero voltage", n)
    estimates = {COEFFICIENT: coefficient(thermal_gain, resistance, parameters),
                 AMBIENT: cold.with_shares(shares)}
    ends = np.linspace(0.0, float(volts.max()), 100)
    rising = [float(p.direction == "up") for p in staircase.segments.plateaus]
    curves = {"voltage": volts, "temperature": kelvin, "heating": np.array(rising),
              "line_voltage": ends, "line_temperature": ambient + gain * ends**2}
    return Experiment("E2", "Heat transfer coefficient", estimates, tuple(remarks), curves,
                      staircase.source(record), {GAIN: thermal_gain})


def coefficient(gain: Estimate, resistance: Estimate, parameters: Parameters) -> Estimate:
    """h = 1/(gain R A_c) from a thermal gain in K/V^2, independent of R but for sensor errors."""
    area = parameters["wire.surface_area"]
    value = 1.0 / (gain.value * resistance.value * area)
    std = math.hypot(gain.statistical / gain.value, resistance.statistical / resistance.value)
    shares = {name: -share / resistance.value for name, share in resistance.shares.items()}
    shares |= {name: -share / gain.value for name, share in gain.shares.items()}
    for name, share in scale_of_gain(parameters).items():
        shares[name] = shares.get(name, 0.0) - share
    method = f"{gain.method}, A_c = {area * 1e6:.2f} mm2 taken as exact"
    own = Estimate(value, value * std, "W/(m2 K)", method, gain.n)
    return own.with_shares({name: value * share for name, share in shares.items()})


def scale_of_gain(parameters: Parameters) -> dict[str, float]:
    """Relative systematic errors of a temperature rise over a squared voltage, by source."""
    # The measured rise scales with the camera's factors, the heat with V^2.
    powers = dict.fromkeys(CAMERA, 1.0) | {VOLTAGE: -2.0}
    return {n: power * (parameters.std(n) / parameters[n]) for n, power in powers.items()}


def identify_thermal_expansion(records: Sequence[Record], parameters: Parameters) -> Experiment:
    """Evaluate clamped staircases of temperature [K] and `force` [N], each of one wire. Raises
    InputError: a signal is absent, or fewer than three temperatures remain below A_s."""
    findings, points, used, total = list[Finding](), [], [], 0
    area, a_s, stated = channel_section(parameters), parameters[_START], _START in parameters.given
    a_s_std = parameters.std(_START) if stated else BY_NAME[_START].uncertainty or 0.0
    for index, record in enumerate(records):
        path, name = record.path, f"{record.channels[0]}.temperature"
        read, (time, newton) = samples(record, name), samples(record, "force")
        windows = steady_windows(*read)
        windows = windows[(windows[:, 0] >= time[0]) & (windows[:, 1] <= time[-1])]
        if not len(windows):
            raise refusal("never still", path=path, name=name, shortest=_SHORTEST_PLATEAU)
        warm = signals.means(*read, windows, name)
        f = signals.means(time, newton, windows, "force")
        here, error = f.value / area, np.hypot(f.noise, f.hidden) / area
        total += f.n
        warm_std, of_record = np.hypot(warm.noise, warm.hidden), np.full(len(here), float(index))
        points.append(np.column_stack([warm.value, warm_std, here, error, of_record]))
        # A_s, shifted by the stress below it: transformation would raise the stress itself.
        cold = here[warm.value < a_s]
        shift = max(float(cold.min()), 0.0) if len(cold) else 0.0
        limit = a_s + shift / parameters[SYMBOLS["C_A"]] - 2.0 * a_s_std
        if not stated:
            findings.append(remark("A_s not stated", start=a_s, limit=limit))
        below = warm.value < limit
        if not below.all():
            hot = warm.value[~below]
            findings.append(remark("plateaus too hot", path=path, count=len(hot), low=hot.min(),
                                   high=hot.max(), limit=limit))
        # A slack wire shows nothing; if all are below 0 N, the force has another zero or sign.
        tight = here > max(float(np.max(np.abs(here))) * 0.02, _SLACK * error.max())
        if tight.any() and not tight[below].all():
            findings.append(remark("slack wire", path=path, count=np.sum(~tight & below)))
            below = below & tight
        used.append(below)
    (t, t_std, stress, stress_std, group), chosen = np.vstack(points).T, np.concatenate(used)
    levels = 1 + int(np.sum(np.diff(np.sort(t[chosen])) > _SAME_LEVEL)) if chosen.any() else 0
    if levels < _FEWEST_LEVELS:
        raise refusal("few levels", path=records[0].path, levels=levels, least=_FEWEST_LEVELS)
    kinds, centre = np.unique(group[chosen]), float(t[chosen].mean())
    design = np.column_stack([group[:, None] == kinds, t - centre])
    own = stress_std[chosen] ** 2 + (1e-6 * float(np.ptp(stress[chosen])) + 1.0) ** 2
    fit = fit_slope(design[chosen].T, stress[chosen], slope=-1, covariance=lambda slope: np.diag(
        own + (slope * t_std[chosen]) ** 2))
    slope = float(fit.beta[-1])  # with systematic errors of section and camera scale
    shares = {name: -slope * parameters.std(name) / parameters[name] for name in CAMERA}
    shares[_DIAMETER] = -2.0 * slope * parameters.std(_DIAMETER) / parameters[_DIAMETER]
    method = f"line through {int(chosen.sum())} plateaus at {levels} temperatures below A_s"
    estimate = Estimate(slope, float(fit.std[-1]), "Pa/K", method, total).with_shares(shares)
    # Sign and size against -alpha E of a clamped wire below A_s.
    soft = NITI_EXPANSION[0] * parameters["wire.martensite_modulus"]
    stiff = NITI_EXPANSION[1] * parameters["wire.austenite_modulus"]
    std, size, factor = estimate.std, abs(slope), CONVECTION_FACTOR
    least, most, strongest = size - 2.0 * std, size + 2.0 * std, factor * stiff
    causes = {"expansion of the other sign": slope > 2.0 * std,
              "expansion of a camera": factor * soft < least <= strongest,
              "expansion too large": least > strongest, "expansion too small": most < soft / factor}
    facts = {"of_soft": size / soft, "of_stiff": size / stiff}
    faults = [words(cause, **facts) for cause, found in causes.items() if found]
    findings.append(remark("size of the expansion", "warning" if faults else "info",
                           value=slope, std=std, alpha_E_low=soft, alpha_E_high=stiff,
                           verdict="; ".join(faults) or "plausible"))
    if fit.misfit >= _BAD_MISFIT:
        findings.append(remark("plateaus off the line", misfit=fit.misfit,
                               times=math.sqrt(fit.misfit)))
    curves = {"temperature": t, "stress": stress, "used": chosen.astype(np.float64),
              "line": design @ fit.beta}
    return Experiment("E8", "Thermal expansion factor (eq. 8, Fig. 10)", {PARAMETER: estimate},
                      tuple(findings), curves, "; ".join(str(record.path) for record in records))


def steady_windows(time: Array, temperature: Array) -> Array:
    """(p, 2) s, last parts of the stretches of steady temperature (n,) K over time (n,) s."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else _WINDOW
    half = max(round(0.5 * _WINDOW / period), 2)
    if len(time) < 4 * half:
        return np.empty((0, 2))
    smooth = np.convolve(temperature, np.ones(half) / half, mode="valid")
    change = np.abs(smooth[half:] - smooth[:-half])
    centre = time[half : half + len(change)]
    # The limit is at least the noise of a difference of two means of `half` samples.
    steady = change < max(_STEADY, 5.0 * scatter(temperature) * math.sqrt(2.0 / half))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(int)))
    first, last = centre[edges[::2]], centre[edges[1::2] - 1]
    long = last - first >= _SHORTEST_PLATEAU
    return np.column_stack([last - _TAIL * (last - first), last])[long]
