"""E1: resistance of one wire from a voltage staircase (eq. 3, Fig. 2).

    V = V_0 + R_channel I          R = count (R_channel - R_leads)

V_0 absorbs an offset of the current sensor. Gain errors of both sensors scale R and no line can
show them, so they are systematic errors of the result.
"""

import math
from dataclasses import replace

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import fit_slope
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.identify.signals import CURRENT, LEADS, RESISTANCE, VOLTAGE, Staircase
from sma_bench.parameters import Parameters
from sma_bench.records import Record

_SIGNIFICANT = 3.0  # standard errors from which a remark becomes a warning
_SIGNIFICANT_BEND = 4.0  # a quiet converter bends a line a little by itself
_LARGE_DIFFERENCE, _LARGE_BEND = 0.002, 0.005  # shares of R below which it does not matter


def identify_resistance(record: Record, staircase: Staircase, parameters: Parameters) -> Experiment:
    """Fit V over I through the plateaus of a staircase.

    Heating and cooling plateaus are joined where they agree within two standard errors; otherwise
    the heating slope counts, as in the paper, and half the difference is added to the error.

    `record`: with `<channel>.voltage` [V] and `<channel>.current` [A]. Raises InputError: no
    current, too few samples, or leads with more resistance than was measured.
    """
    staircase = staircase.read(record, "voltage", "current")
    v, i = (staircase.means(record, name) for name in ("voltage", "current"))
    volts, amps, n = v.value, i.value, len(v.value)
    findings: list[Finding] = []
    if np.ptp(amps) < 10.0 * np.median(i.noise):
        raise refusal(
            "current does not follow", path=record.path, channel=staircase.channel,
            amperes=np.ptp(amps), volts=np.ptp(volts),
        )
    same = staircase.same_level(volts)
    up = np.array([p.direction == "up" for p in staircase.plateaus])

    def covariance(ohm: float) -> Array:
        """(n, n) V^2 of V - ohm I; plateaus at one voltage share the converters' errors."""
        noise = np.diag(v.noise**2 + (ohm * i.noise) ** 2)
        return np.asarray(noise + (v.hidden**2 + (ohm * i.hidden) ** 2) * same)

    # One line through all plateaus.
    both = fit_slope([np.ones(n), amps], volts, covariance)
    intercept, ohm, std = float(both.beta[0]), float(both.beta[1]), float(both.std[1])
    method = "straight line of voltage over current with intercept, both directions"
    details = {
        "intercept": Estimate(intercept, float(both.std[0]), "V", "both directions", n),
        "both": Estimate(ohm, std, "ohm", "both directions", n),
    }

    # A line for each direction: does the resistance depend on the phase?
    half_span = 0.5 * np.ptp(volts)
    if all(side.sum() >= 3 and np.ptp(volts[side]) > half_span for side in (up, ~up)):
        each = fit_slope([up, ~up, up * amps, ~up * amps], volts, covariance, slope=2)
        for k, (name, side) in enumerate((("heating", up), ("cooling", ~up)), start=2):
            slope, error = float(each.beta[k]), float(each.std[k])
            details[name] = Estimate(slope, error, "ohm", f"{name} plateaus", int(side.sum()))
        heating, cooling = details["heating"].value, details["cooling"].value
        of_both = each.covariance[2:, 2:] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        difference = heating - cooling
        error = math.sqrt(float(np.sum(of_both)) * max(1.0, each.misfit))
        if abs(difference) > max(_SIGNIFICANT * error, _LARGE_DIFFERENCE * heating):
            findings.append(remark(
                "directions differ", heating=heating, cooling=cooling, difference=difference,
                difference_std=error, share=difference / heating,
            ))
        if abs(difference) > 2.0 * error:
            ohm, std = heating, math.hypot(float(each.std[2]), 0.5 * difference)
            method = "straight line of voltage over current with intercept, heating slope"

    # Is it straight? b x^2 changes the slope by 4 b / half_range over the range of the current.
    half_range = 0.5 * np.ptp(amps)
    square = ((amps - amps.mean()) / half_range) ** 2
    curved = fit_slope([np.ones(n), amps, square], volts, covariance)
    bend, error = (4.0 / half_range * float(x[2]) for x in (curved.beta, curved.std))
    if abs(bend) > max(_SIGNIFICANT_BEND * error, _LARGE_BEND * ohm):
        std = math.hypot(std, bend / math.sqrt(12.0))  # of a slope uniform over its range
        findings.append(
            remark("bent line", slope_change=bend, slope_change_std=error, share=bend / ohm)
        )
    offset, offset_std = -intercept / ohm, details["intercept"].std / ohm
    if abs(offset) > _SIGNIFICANT * offset_std:
        findings.append(remark("current offset", offset=offset, offset_std=offset_std))

    # From the channel to one of its wires, and the errors that no record shows.
    count, leads = parameters["wire.count"], parameters[LEADS]
    if ohm <= leads:
        raise refusal("all of it is leads", path=record.path, ohm=ohm, name=LEADS, leads=leads)
    systematic = {
        VOLTAGE: count * ohm * parameters.std(VOLTAGE),
        CURRENT: -count * ohm * parameters.std(CURRENT),
    }
    if leads or count > 1:
        systematic[LEADS] = -count * lead_std(parameters)
        method += f", less {leads:g} ohm of leads" * bool(leads)
        method += f", {count} wires in parallel" * (count > 1)
    details["channel"] = Estimate(ohm, std, "ohm", method, n)
    wire = Estimate(count * (ohm - leads), count * std, "ohm", method, n).with_shares(systematic)

    ends = np.array([volts.min(), volts.max()])
    curves = {
        "voltage": volts, "current": amps, "heating": up.astype(float),
        "line_voltage": ends, "line_current": (ends - intercept) / ohm,
    }
    return Experiment(
        "E1", "Resistance", {RESISTANCE: wire}, tuple(findings), curves,
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
