"""E1: resistance of one wire from a voltage staircase (eq. 3, Fig. 2).

    V = V_0 + R_channel I          R = count (R_channel - R_leads)

V_0 absorbs an offset of the current sensor. Gain errors of both sensors scale R and no line can
show them, so they are systematic errors of the result.
"""

import math
from dataclasses import replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, LinearFit, Mask, fit_linear
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import AVERAGE, SETTLE, Staircase, means, same_level
from sma_bench.parameters import Parameters
from sma_bench.records import Record
from sma_bench.records.record import samples

PARAMETER = "wire.resistance"
LEADS = "bench.lead_resistance"
CHANNEL = "channel"  # of `details`: the resistance of the whole channel, leads included
VOLTAGE, CURRENT = "sensor.voltage.gain", "sensor.current.gain"
SIGNIFICANT = 3.0  # standard errors from which a remark becomes a warning
SIGNIFICANT_BEND = 4.0  # standard errors; a quiet converter bends a line a little by itself
LARGE_DIFFERENCE, LARGE_BEND = 0.002, 0.005  # shares of R below which it does not matter


def identify_resistance(
    record: Record, staircase: Staircase, parameters: Parameters,
    settle: float = SETTLE, average: float = AVERAGE,
) -> Experiment:
    """Fit V over I through the plateaus of a staircase.

    Heating and cooling plateaus are joined where they agree within two standard errors; otherwise
    the heating slope counts, as in the paper, and half the difference is added to the error.

    Args:
        record: with `<channel>.voltage` [V] and `<channel>.current` [A].
        settle, average: s of each plateau that are skipped and averaged.

    Raises:
        InputError: no current, too few samples, or leads with more resistance than was measured.
    """
    channel = staircase.channel
    windows, remarks = staircase.windows(settle, average)
    v, i = (
        means(*samples(record, f"{channel}.{name}"), windows, f"{channel}.{name}")
        for name in ("voltage", "current")
    )
    volts, amps, n = v.value, i.value, len(windows)
    if np.ptp(amps) < 10.0 * np.median(i.noise):
        raise InputError(
            f"{record.path}: {channel}.current varies by {np.ptp(amps):.3g} A over "
            f"{np.ptp(volts):.3g} V, expected it to follow the voltage"
        )
    same = same_level(volts, staircase.tolerance)  # plateaus that share a converter error
    up = np.array([p.direction == "up" for p in staircase.plateaus])
    findings = list(remarks)

    def line(*columns: Array | Mask, slope: int = 1) -> LinearFit:
        """Generalised least squares of V; errors of I count through the slope."""
        ohm = float(np.ptp(volts) / np.ptp(amps))
        for _ in range(3):
            noise = np.diag(v.noise**2 + (ohm * i.noise) ** 2)
            converter = (v.hidden**2 + (ohm * i.hidden) ** 2) * same
            fit = fit_linear(np.column_stack(columns).astype(float), volts, noise + converter)
            ohm = float(fit.beta[slope])
        return fit

    # One line through all plateaus.
    both = line(np.ones(n), amps)
    intercept, ohm, std = float(both.beta[0]), float(both.beta[1]), float(both.std[1])
    method = "straight line of voltage over current with intercept, both directions"
    details = {
        "intercept": Estimate(intercept, float(both.std[0]), "V", "both directions", n),
        "both": Estimate(ohm, std, "ohm", "both directions", n),
    }

    # A line for each direction: does the resistance depend on the phase?
    half_span = 0.5 * np.ptp(volts)
    if all(side.sum() >= 3 and np.ptp(volts[side]) > half_span for side in (up, ~up)):
        each = line(up, ~up, up * amps, ~up * amps, slope=2)
        for k, (name, side) in enumerate((("heating", up), ("cooling", ~up)), start=2):
            slope, error = float(each.beta[k]), float(each.std[k])
            details[name] = Estimate(slope, error, "ohm", f"{name} plateaus", int(side.sum()))
        heating, cooling = details["heating"].value, details["cooling"].value
        difference, error = each.contrast(np.array([0.0, 0.0, 1.0, -1.0]))
        noticed = abs(difference) > max(SIGNIFICANT * error, LARGE_DIFFERENCE * heating)
        findings.append(Finding(
            "warning" if noticed else "info", PARAMETER,
            f"{heating:.4f} ohm heating, {cooling:.4f} ohm cooling: they differ by "
            f"{difference:+.4f} +- {error:.4f} ohm ({100.0 * difference / heating:+.2f} %)"
            + "; the resistance depends on the phase or on the temperature" * noticed,
            {"heating": heating, "cooling": cooling, "difference": difference,
             "difference_std": error},
        ))
        if abs(difference) > 2.0 * error:
            ohm, std = heating, math.hypot(float(each.std[2]), 0.5 * difference)
            method = "straight line of voltage over current with intercept, heating slope"
    else:
        only = "heating" if up.any() else "cooling"
        text = f"only {only} has plateaus enough for a line of its own"
        findings.append(Finding("info", PARAMETER, text))

    # Is it straight? b x^2 changes the slope by 4 b / half_range over the range of the current.
    half_range = 0.5 * np.ptp(amps)
    curved = line(np.ones(n), amps, ((amps - amps.mean()) / half_range) ** 2)
    bend, error = (4.0 / half_range * float(x[2]) for x in (curved.beta, curved.std))
    if abs(bend) > max(SIGNIFICANT_BEND * error, LARGE_BEND * ohm):
        std = math.hypot(std, bend / math.sqrt(12.0))  # of a slope uniform over its range
        findings.append(Finding(
            "warning", PARAMETER,
            f"voltage over current is not a straight line: its slope changes by {bend:+.4f} +- "
            f"{error:.4f} ohm ({100.0 * bend / ohm:+.1f} %); the resistance depends on the phase "
            "or on the temperature",
            {"slope_change": bend, "slope_change_std": error},
        ))
    offset, offset_std = -intercept / ohm, details["intercept"].std / ohm
    if abs(offset) > SIGNIFICANT * offset_std:
        findings.append(Finding(
            "info", "current",
            f"the current sensor reads {1e3 * offset:+.2f} +- {1e3 * offset_std:.2f} mA at zero "
            "current", {"offset": offset, "offset_std": offset_std},
        ))

    # From the channel to one of its wires, and the errors that no record shows.
    count, leads = parameters["wire.count"], parameters[LEADS]
    if ohm <= leads:
        raise InputError(
            f"{record.path}: {ohm:.4g} ohm measured, expected more than {LEADS}, {leads:g} ohm"
        )
    systematic = {
        VOLTAGE: count * ohm * parameters.std(VOLTAGE),
        CURRENT: -count * ohm * parameters.std(CURRENT),
    }
    if leads or count > 1:
        systematic[LEADS] = -count * lead_std(parameters)
        method += f", less {leads:g} ohm of leads" * bool(leads)
        method += f", {count} wires in parallel" * (count > 1)
    details[CHANNEL] = Estimate(ohm, std, "ohm", method, n)
    wire = Estimate(count * (ohm - leads), count * std, "ohm", method, n).with_shares(systematic)

    ends = np.array([volts.min(), volts.max()])
    curves = {
        "voltage": volts, "current": amps, "heating": up.astype(float),
        "line_voltage": ends, "line_current": (ends - intercept) / ohm,
    }
    return Experiment(
        "E1", "Resistance", {PARAMETER: wire}, tuple(findings), curves,
        staircase.source(record), details,
    )


def lead_std(parameters: Parameters) -> float:
    """Standard deviation of the leads' resistance [ohm]; 0 ohm that nobody stated is exact."""
    stated = parameters[LEADS] > 0.0 or LEADS in parameters.given
    return parameters.std(LEADS) if stated else 0.0


def heated(resistance: Estimate, parameters: Parameters, measured: bool) -> Estimate:
    """V^2 over the heat of one wire, V measured before the leads; `measured`: by E1, which took
    the same leads off, so that both share one error."""
    count, ohm = parameters["wire.count"], resistance.value
    leads, error = count * parameters[LEADS], count * lead_std(parameters)
    if leads == 0.0:
        return resistance
    ratio, slope = (ohm + leads) / ohm, 1.0 - (leads / ohm) ** 2
    shares = {name: slope * share for name, share in resistance.shares.items()}
    shares[LEADS] = error * (ratio**2 if measured else 2.0 * ratio)
    own = replace(
        resistance, value=ohm * ratio**2, std=slope * resistance.statistical, systematic=0.0
    )
    return own.with_shares(shares)
