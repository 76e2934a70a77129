"""E1, resistance: a straight line of voltage over current through the plateaus (eq. 3, Fig. 2)."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, LinearFit, Mask, fit_linear
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import AVERAGE, SETTLE, Means, Staircase, means, same_level
from sma_bench.parameters import Parameters
from sma_bench.physics.heat import heated_resistance
from sma_bench.records import Record
from sma_bench.records.record import samples

PARAMETER = "wire.resistance"
LEADS = "bench.lead_resistance"
CHANNEL = "channel"
VOLTAGE, CURRENT = "sensor.voltage.gain", "sensor.current.gain"
_SIGNIFICANT = 3.0
# A quiet converter errs alike at neighbouring levels, which bends a line a little by itself.
_SIGNIFICANT_BEND = 4.0
_LARGE_DIFFERENCE = 0.002
_LARGE_BEND = 0.005
_ITERATIONS = 3
_DIRECTIONS = ("up", "down")
_NAMES = {"up": "heating", "down": "cooling"}


@dataclass(frozen=True)
class _Points:
    voltage: Means
    current: Means
    up: Mask
    shared: Array

    def covariance(self, resistance: float) -> Array:
        """(p, p) of V - R I: the effective variance, and the converter's share at equal levels."""
        noise = self.voltage.noise**2 + (resistance * self.current.noise) ** 2
        hidden = self.voltage.hidden**2 + (resistance * self.current.hidden) ** 2
        return np.diag(noise) + hidden * self.shared

    def fit(self, design: Array, slope: int) -> LinearFit:
        """Voltage over the columns of `design`; column `slope` holds the current."""
        resistance = float(np.ptp(self.voltage.value) / np.ptp(self.current.value))
        for _ in range(_ITERATIONS):
            fit = fit_linear(design, self.voltage.value, self.covariance(resistance))
            resistance = float(fit.beta[slope])
        return fit


def identify_resistance(
    record: Record,
    staircase: Staircase,
    parameters: Parameters,
    settle: float = SETTLE,
    average: float = AVERAGE,
) -> Experiment:
    """Resistance of one wire from a voltage staircase, each direction by itself.

    The slope is that of the whole channel: its wires in parallel, behind their leads. `details`
    holds it as it is; the leads of `bench.lead_resistance` are taken off the estimate.

    The line has an intercept, so an offset of the current sensor does no harm. Gain errors of the
    two sensors go straight into the resistance and no line can show them: the uncertainties of
    `sensor.voltage.gain` and `sensor.current.gain`. The estimate joins both directions where they
    agree within two standard errors. Where they do not, it is the heating slope, as in the paper,
    and half the difference joins its error.

    Args:
        record: holds `<channel>.voltage` in V and `<channel>.current` in A.
        staircase: the plateaus.
        parameters: wire.count and bench.lead_resistance.
        settle, average: s, what is skipped and what is averaged of each plateau.

    Raises:
        InputError: no current, too few samples on a plateau, or leads of more than was measured.
    """
    bounds, findings = staircase.windows(settle, average)
    channel = staircase.channel
    voltage_time, voltage = samples(record, f"{channel}.voltage")
    current_time, current = samples(record, f"{channel}.current")
    v = means(voltage_time, voltage, bounds, f"{channel}.voltage")
    i = means(current_time, current, bounds, f"{channel}.current")
    if np.ptp(i.value) < 10.0 * float(np.median(i.noise)):
        raise InputError(
            f"{record.path}: {channel}.current stays within {np.ptp(i.value):.3g} A over "
            f"{np.ptp(v.value):.3g} V, expected it to follow the voltage"
        )
    up = np.array([p.direction == "up" for p in staircase.plateaus])
    points = _Points(v, i, up, same_level(v.value, staircase.tolerance))
    estimate, details, remarks = _estimate(points, len(bounds))
    details[CHANNEL] = estimate
    curves = {
        "voltage": v.value,
        "current": i.value,
        "heating": up.astype(np.float64),
        "line_voltage": np.array([v.value.min(), v.value.max()]),
        "line_current": (np.array([v.value.min(), v.value.max()]) - details["intercept"].value)
        / estimate.value,
    }
    return Experiment(
        "E1", "Resistance", {PARAMETER: _of_one_wire(estimate, parameters, record)},
        (*findings, *remarks), curves, staircase.source(record), details,
    )


def lead_std(parameters: Parameters) -> float:
    """Standard deviation of the leads' resistance in ohm; no leads are known exactly."""
    known = parameters[LEADS] > 0.0 or LEADS in parameters.given
    return parameters.std(LEADS) if known else 0.0


def heated(resistance: Estimate, parameters: Parameters, measured: bool) -> Estimate:
    """V^2 over the heat of one wire, V before the leads (`physics.heat.heated_resistance`).

    Args:
        resistance: of one wire.
        measured: it came from E1, with the same leads taken off: one error for both.
    """
    wire, count = resistance.value, parameters["wire.count"]
    value = heated_resistance(parameters.replace({PARAMETER: wire}))
    if value == wire:
        return resistance
    leads, error = count * parameters[LEADS], count * lead_std(parameters)
    ratio = (wire + leads) / wire
    slope = 1.0 - (leads / wire) ** 2
    shares = {name: slope * share for name, share in resistance.shares.items()}
    shares[LEADS] = error * (ratio**2 if measured else 2.0 * ratio)
    own = slope * resistance.statistical
    return replace(resistance, value=value, std=own, systematic=0.0).with_shares(shares)


def _of_one_wire(channel: Estimate, parameters: Parameters, record: Record) -> Estimate:
    count, leads = parameters["wire.count"], parameters[LEADS]
    scales = {VOLTAGE: 1.0, CURRENT: -1.0}
    shares = {
        name: count * sign * parameters.std(name) * channel.value for name, sign in scales.items()
    }
    if count == 1 and leads == 0.0:
        return channel.with_shares(shares)
    if channel.value <= leads:
        raise InputError(
            f"{record.path}: {channel.value:.4g} ohm between the voltmeter's leads, expected more "
            f"than bench.lead_resistance, {leads:g} ohm"
        )
    shares[LEADS] = -count * lead_std(parameters)
    words = f"{channel.method}, less {leads:g} ohm of leads" if leads else channel.method
    return replace(
        channel,
        value=count * (channel.value - leads),
        std=count * channel.std,
        method=f"{words}, {count} wires in parallel" if count > 1 else words,
    ).with_shares(shares)


def _estimate(
    points: _Points, n: int
) -> tuple[Estimate, dict[str, Estimate], list[Finding]]:
    current = points.current.value
    joint = points.fit(np.column_stack([np.ones(n), current]), slope=1)
    resistance, std = float(joint.beta[1]), float(joint.std[1])
    method = "straight line of voltage over current with intercept, both directions"
    findings: list[Finding] = []
    details = _details(joint, n)
    if _both_directions(points):
        design = np.column_stack(
            [points.up, ~points.up, points.up * current, ~points.up * current]
        ).astype(np.float64)
        each = points.fit(design, slope=2)
        details |= _direction_details(each, points)
        difference, error = each.contrast(np.array([0.0, 0.0, 1.0, -1.0]))
        findings.append(_difference_finding(each, difference, error))
        if abs(difference) > 2.0 * error:
            resistance = float(each.beta[2])
            std = math.hypot(float(each.std[2]), difference / 2.0)
            method = "straight line of voltage over current with intercept, heating slope"
    else:
        name = _NAMES["up" if points.up.any() else "down"]
        text = f"only the {name} direction has plateaus enough for a line of its own"
        findings.append(Finding("info", PARAMETER, text))
    bend, bend_error = _bend(points, current, n)
    if abs(bend) > _SIGNIFICANT_BEND * bend_error and abs(bend) > _LARGE_BEND * resistance:
        findings.append(_bend_finding(bend, bend_error, resistance))
        # The slope is uniform over the range as far as one number can tell.
        std = math.hypot(std, bend / math.sqrt(12.0))
    offset = -details["intercept"].value / resistance
    offset_std = details["intercept"].std / resistance
    if abs(offset) > _SIGNIFICANT * offset_std:
        text = (
            f"the current sensor reads {offset * 1e3:+.2f} +- {offset_std * 1e3:.2f} mA "
            "at zero current"
        )
        findings.append(
            Finding("info", "current", text, {"offset": offset, "offset_std": offset_std})
        )
    return Estimate(resistance, std, "ohm", method, n), details, findings


def _details(joint: LinearFit, n: int) -> dict[str, Estimate]:
    method = "straight line through both directions"
    return {
        "intercept": Estimate(float(joint.beta[0]), float(joint.std[0]), "V", method, n),
        "both": Estimate(float(joint.beta[1]), float(joint.std[1]), "ohm", method, n),
    }


def _direction_details(each: LinearFit, points: _Points) -> dict[str, Estimate]:
    return {
        _NAMES[direction]: Estimate(
            float(each.beta[2 + k]), float(each.std[2 + k]), "ohm",
            f"straight line through the {_NAMES[direction]} plateaus",
            int(np.sum(points.up == (direction == "up"))),
        )
        for k, direction in enumerate(_DIRECTIONS)
    }


def _both_directions(points: _Points) -> bool:
    span = np.ptp(points.voltage.value)
    return all(
        np.sum(side) >= 3 and np.ptp(points.voltage.value[side]) > 0.5 * span
        for side in (points.up, ~points.up)
    )


def _difference_finding(each: LinearFit, difference: float, error: float) -> Finding:
    heating, cooling = float(each.beta[2]), float(each.beta[3])
    share = difference / heating
    noticed = abs(difference) > _SIGNIFICANT * error and abs(share) > _LARGE_DIFFERENCE
    text = (
        f"{heating:.4f} ohm heating, {cooling:.4f} ohm cooling: "
        f"differ by {difference:+.4f} +- {error:.4f} ohm ({100.0 * share:+.2f} %)"
    )
    if noticed:
        text += "; the resistance depends on the phase or on the temperature"
    numbers = {
        "heating": heating, "cooling": cooling, "difference": difference, "difference_std": error,
    }
    return Finding("warning" if noticed else "info", PARAMETER, text, numbers)


def _bend(points: _Points, current: Array, n: int) -> tuple[float, float]:
    """Change of the slope from the lowest to the highest current in ohm, and its error."""
    centre, half = current.mean(), 0.5 * np.ptp(current)
    x = (current - centre) / half
    fit = points.fit(np.column_stack([np.ones(n), current, x**2]), slope=1)
    # d/dI of b x^2 runs from -2 b/half to +2 b/half over the range.
    factor = 4.0 / half
    return factor * float(fit.beta[2]), factor * float(fit.std[2])


def _bend_finding(bend: float, error: float, resistance: float) -> Finding:
    text = (
        f"voltage over current is not a straight line: its slope changes by {bend:+.4f} +- "
        f"{error:.4f} ohm ({100.0 * bend / resistance:+.1f} %) from the lowest to the highest "
        "current; the resistance depends on the phase or on the temperature"
    )
    return Finding("warning", PARAMETER, text, {"slope_change": bend, "slope_change_std": error})
