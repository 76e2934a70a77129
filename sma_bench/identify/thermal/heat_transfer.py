"""E2, heat transfer coefficient: steady temperature over voltage (eq. 4, Fig. 3)."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, LinearFit, fit_linear
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import AVERAGE, CAMERA, SETTLE, Means, Staircase, means, same_level
from sma_bench.identify.thermal.resistance import VOLTAGE
from sma_bench.parameters import Parameters
from sma_bench.records import Record
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import has_samples, samples

PARAMETER = "wire.heat_transfer_coefficient"
GAIN = "thermal_gain"
AMBIENT = "environment.ambient_temperature"
ZERO = "sensor.voltage.offset"
_SIGNIFICANT = 3.0
_SIGNIFICANT_DRIFT = 4.0
_LARGE_DRIFT = 0.01
_SMALLEST_DRIFT = 0.1
_LARGE_BEND = 0.02
_ROOM = "ambient.temperature"
_DRIFT_STD, _DRIFT_TIME = 1.0, 600.0  # K to either side in so many s, and slower than that
_SMALL_DRIFT = 2e-3  # of the rise
_FEWEST_TO_DRIFT = 8
_ITERATIONS = 3


@dataclass(frozen=True)
class _Points:
    voltage: Means
    temperature: Means
    shared: Array
    drift: Array  # (p,) K, one standard deviation of what the room may have done

    @property
    def square(self) -> Array:
        """V^2 of each plateau; the samples' own scatter heats too, but by less than 1e-5."""
        return self.voltage.value**2

    def covariance(self, gain: float) -> Array:
        """(p, p) of T - gain V^2 in K^2: effective variance, converters' share at equal levels."""
        sensitivity = 2.0 * gain * self.voltage.value
        noise = self.temperature.noise**2 + (sensitivity * self.voltage.noise) ** 2
        hidden = np.outer(sensitivity, sensitivity) * self.voltage.hidden**2 * self.shared
        room = np.outer(self.drift, self.drift)
        return np.diag(noise + self.temperature.hidden**2) + hidden + room

    def fit(self, temperature: Array) -> LinearFit:
        """Straight line of temperature (p,) in K over V^2: (T_inf, 1/(R h A_c))."""
        design = np.column_stack([np.ones(len(self.square)), self.square])
        gain = float(np.polyfit(self.square, temperature, 1)[0])
        for _ in range(_ITERATIONS):
            fit = fit_linear(design, temperature, self.covariance(gain))
            gain = float(fit.beta[1])
        return fit


def identify_heat_transfer(
    record: Record, staircase: Staircase, parameters: Parameters, resistance: Estimate,
    current_offset: float = 0.0, settle: float = SETTLE, average: float = AVERAGE,
) -> Experiment:
    """Heat transfer coefficient and ambient temperature from a voltage staircase.

    Fits T = T_inf + V^2/(R h A_c) with free T_inf, which may drift where nobody recorded the room;
    where somebody did, what the room does is taken off. The area is taken as exact: h scales with
    1/A_c, and only the product h A_c enters the heat equation. `details` holds the thermal gain
    1/(R h A_c) in K/V^2, which depends on neither R nor A_c.

    Args:
        record: holds `<channel>.voltage` in V and `<channel>.temperature` in K, perhaps
            `ambient.temperature`.
        staircase: the plateaus.
        parameters: wire.surface_area and, to compare with, environment.ambient_temperature.
        resistance: V^2 over the heat of a wire, with its error: R, where there are no leads.
        current_offset: A, what the current sensor reads at zero (from E1); used where no plateau
            at 0 V shows it.
        settle, average: s, what is skipped and what is averaged of each plateau.

    Raises:
        InputError: no temperature, or one that does not follow the voltage.
    """
    bounds, findings = staircase.windows(settle, average)
    channel = staircase.channel
    v = means(*samples(record, f"{channel}.voltage"), bounds, f"{channel}.voltage")
    t = means(*samples(record, f"{channel}.temperature"), bounds, f"{channel}.temperature")
    # What the room did from plateau to plateau, or one standard deviation of what it may have done.
    middle = bounds.mean(axis=1)
    if has_samples(record, _ROOM):
        room = np.interp(middle, *samples(record, _ROOM))
        room, drift = room - room.mean(), np.zeros(len(middle))
    else:
        duration = float(np.ptp(middle))
        size = _DRIFT_STD * min(1.0, duration / _DRIFT_TIME)
        room, drift = np.zeros(len(middle)), size * (middle - middle.mean()) / (0.5 * duration)
    t = replace(t, value=t.value - room)
    points = _Points(v, t, same_level(v.value, staircase.tolerance), drift)
    slope = float(np.polyfit(points.square, t.value, 1)[0])
    if slope * np.ptp(points.square) < 10.0 * float(np.median(t.noise)):
        raise InputError(
            f"{record.path}: {channel}.temperature rises by {np.ptp(t.value):.2g} K over "
            f"{np.ptp(v.value):.3g} V, expected it to follow the voltage"
        )
    fit = points.fit(t.value)
    gain, gain_std = float(fit.beta[1]), float(fit.std[1])
    ambient, ambient_std = float(fit.beta[0]), float(fit.std[0])
    remarks = list(findings)

    # How far the room went to either side of its mean, as the staircase shows it.
    went, size = 0.0, float(np.max(np.abs(points.drift)))
    if size and len(bounds) >= _FEWEST_TO_DRIFT:
        design = np.column_stack([np.ones(len(bounds)), points.square, points.drift / size])
        still = replace(points, drift=0.0 * points.drift).covariance(gain)
        drifting = fit_linear(design, t.value, still)
        went, error = float(drifting.beta[2]), float(drifting.std[2])
        rise = gain * float(np.ptp(points.square))
        if abs(went) < max(_SIGNIFICANT * error, _SMALL_DRIFT * rise):
            went = 0.0
        else:
            remarks.append(Finding(
                "info", AMBIENT,
                f"the wire's temperature without heating went by {2.0 * went:+.2f} +- "
                f"{2.0 * error:.2f} K over the staircase: the room drifts, and nobody recorded it; "
                "it is allowed for", {"drift": 2.0 * went, "std": 2.0 * error},
            ))

    # Plateaus whose temperature still changed while it was averaged.
    limit = max(_SMALLEST_DRIFT, _LARGE_DRIFT * float(np.ptp(t.value)))
    moving = (np.abs(t.drift) > _SIGNIFICANT_DRIFT * t.drift_std) & (np.abs(t.drift) > limit)
    if moving.any():
        moved = points.fit(t.value + np.where(moving, t.drift, 0.0))
        gain_std = math.hypot(gain_std, float(moved.beta[1]) - gain)
        ambient_std = math.hypot(ambient_std, float(moved.beta[0]) - ambient)
        worst = int(np.argmax(np.where(moving, np.abs(t.drift), 0.0)))
        remarks.append(Finding(
            "warning", PARAMETER,
            f"{int(moving.sum())} of {len(moving)} plateaus had not settled: the temperature moved "
            f"by {t.drift[worst]:+.2f} K while it was averaged at {v.value[worst]:.2f} V",
            {"plateaus": float(moving.sum()), "largest_drift": float(t.drift[worst])},
        ))

    change, finding = _bend(
        record, staircase, points, bounds, gain, resistance, parameters, current_offset
    )
    if finding is not None:
        gain_std = math.hypot(gain_std, gain * change / math.sqrt(12.0))
        remarks.append(finding)

    # Is the room as warm as it was said, or measured, to be?
    known: list[tuple[str, float, float]] = []
    if AMBIENT in parameters.given:
        known.append(("stated", parameters[AMBIENT], parameters.std(AMBIENT)))
    if has_samples(record, _ROOM):
        _, measured = samples(record, _ROOM)
        stated = record[_ROOM].std
        own_std = parameters.std(AMBIENT) if stated is None else float(np.median(stated))
        known.append(("measured", float(np.mean(measured)), max(float(np.std(measured)), own_std)))
    for how, value, std in known:
        far = abs(ambient - value) > _SIGNIFICANT * math.hypot(ambient_std, std)
        remarks.append(Finding(
            "warning" if far else "info", AMBIENT,
            f"the wire's own temperature without heating is {ambient:.2f} K, the {how} ambient "
            f"{value:.2f} K: {ambient - value:+.2f} K", {"difference": ambient - value},
        ))

    n = len(bounds)
    # Nobody calibrates a camera's zero better than to its own step.
    ambient_std = math.hypot(ambient_std, t.step / math.sqrt(12.0))
    off = replace(v, value=v.value + parameters.std(ZERO))
    share = float(replace(points, voltage=off).fit(t.value).beta[1]) - float(fit.beta[1])
    thermal_gain = Estimate(
        gain, gain_std, "K/V2", "steady temperature over squared voltage", n
    ).with_shares({ZERO: share})
    estimates = {
        PARAMETER: coefficient(thermal_gain, resistance, parameters),
        AMBIENT: Estimate(
            ambient, ambient_std, "K", "steady temperature at zero voltage", n
        ).with_shares({
            "sensor.temperature.offset": parameters.std("sensor.temperature.offset"),
            CAMERA[0]: parameters.std(CAMERA[0]) * (ambient - CELSIUS_ZERO),
            "drift of the room": abs(went),
        }),
    }
    line = np.linspace(0.0, float(v.value.max()), 100)
    curves = {
        "voltage": v.value,
        "temperature": t.value,
        "heating": np.array([p.direction == "up" for p in staircase.plateaus], dtype=np.float64),
        "line_voltage": line,
        "line_temperature": ambient + gain * line**2,
    }
    return Experiment(
        "E2", "Heat transfer coefficient", estimates, tuple(remarks), curves,
        staircase.source(record), {GAIN: thermal_gain},
    )


def coefficient(gain: Estimate, resistance: Estimate, parameters: Parameters) -> Estimate:
    """h = 1/(gain R A_c) from a thermal gain in K/V^2; the errors of gain and R are independent
    but for the scales of their sensors."""
    area = parameters["wire.surface_area"]
    value = 1.0 / (gain.value * resistance.value * area)
    std = math.hypot(gain.statistical / gain.value, resistance.statistical / resistance.value)
    shares = {name: -share / resistance.value for name, share in resistance.shares.items()}
    shares |= {name: -share / gain.value for name, share in gain.shares.items()}
    for name, share in scale_of_gain(parameters).items():
        shares[name] = shares.get(name, 0.0) - share
    return Estimate(
        value, value * std, "W/(m2 K)",
        f"{gain.method}, A_c = {area * 1e6:.2f} mm2 taken as exact", gain.n,
    ).with_shares({name: value * share for name, share in shares.items()})


def scale_of_gain(parameters: Parameters) -> dict[str, float]:
    """Systematic errors of a rise in temperature over a squared voltage, relative."""
    spread = {name: parameters.std(name) / parameters[name] for name in (*CAMERA, VOLTAGE)}
    # The excess over the room goes with what the camera makes of it, the heat with V^2.
    return {
        name: (-2.0 if name == VOLTAGE else 1.0) * share for name, share in spread.items()
    }


def _bend(
    record: Record, staircase: Staircase, points: _Points, bounds: Array, gain: float,
    resistance: Estimate, parameters: Parameters, current_offset: float,
) -> tuple[float, Finding | None]:
    """Relative change of the slope of T across the range, over V^2, or over R times a wire's power
    where there is a current, so that R may vary; and its remark."""
    name, volts = f"{staircase.channel}.current", points.voltage.value
    heating, covariance, what = points.square, points.covariance(gain), "squared voltage"
    if has_samples(record, name):
        current = means(*samples(record, name), bounds, name)
        undriven = np.abs(volts) < staircase.tolerance
        if undriven.any():
            # Better than the line's intercept, which is off where the line is not straight.
            current_offset = float(np.mean(current.value[undriven]))
            common = float(np.mean(current.noise[undriven])) / math.sqrt(float(undriven.sum()))
        else:
            common = float(np.median(current.noise))
        amperes = current.value - current_offset
        leads = parameters["bench.lead_resistance"]
        per_wire = resistance.value / parameters["wire.count"]
        scale = per_wire * (volts - 2.0 * leads * amperes)
        heating, what = per_wire * (volts - leads * amperes) * amperes, "electrical power"
        own = np.diag((scale * current.noise) ** 2) + np.outer(scale, scale) * common**2
        covariance = covariance + gain**2 * own
    x = heating / float(np.max(heating))
    design = np.column_stack([np.ones(len(x)), x, x * (x - 1.0)])
    bent = fit_linear(design, points.temperature.value, covariance)
    change, error = (2.0 * float(b[2]) / float(bent.beta[1]) for b in (bent.beta, bent.std))
    if abs(change) < max(_SIGNIFICANT * error, _LARGE_BEND):
        return 0.0, None
    # h at a plateau is the inverse slope of the chord from ambient: 1 - change/2 at its coldest.
    growth = -0.5 * change
    text = (
        f"steady temperature over {what} is not a straight line: the coefficient "
        f"{'rises' if growth > 0.0 else 'falls'} by {100.0 * abs(growth):.1f} +- "
        f"{50.0 * error:.1f} % from the coldest to the hottest plateau"
    )
    numbers = {"growth": growth, "growth_std": 0.5 * error}
    return abs(change), Finding("warning", PARAMETER, text, numbers)
