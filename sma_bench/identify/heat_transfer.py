"""E2, heat transfer coefficient: steady temperature over voltage (eq. 4, Fig. 3)."""

import math

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import fit_linear, fit_slope, straight_line
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.identify.signals import AMBIENT, CAMERA, COEFFICIENT, VOLTAGE, Staircase
from sma_bench.parameters import Parameters
from sma_bench.records import Record
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import has_samples, samples

GAIN = "thermal_gain"
ZERO = "sensor.voltage.offset"
_ROOM = "ambient.temperature"
_SIGNIFICANT = 3.0  # standard errors
# Of a plateau that had not settled: standard errors, share of the rise, K.
_DRIFTS, _LARGE_DRIFT, _SMALLEST_DRIFT = 4.0, 0.01, 0.1
_LARGE_BEND = 0.02  # of the slope
_DRIFT_STD, _DRIFT_TIME = 1.0, 600.0  # K to either side in so many s, and slower than that
_SMALL_DRIFT, _FEWEST_TO_DRIFT = 2e-3, 8  # of the rise; plateaus


def identify_heat_transfer(
    record: Record, staircase: Staircase, parameters: Parameters, resistance: Estimate
) -> Experiment:
    """Heat transfer coefficient and ambient temperature from a voltage staircase.

    Fits T = T_inf + V^2/(R h A_c) with free T_inf, which may drift where nobody recorded the room;
    where somebody did, what the room does is taken off. The area is taken as exact: h scales with
    1/A_c, and only the product h A_c enters the heat equation. `details` holds the thermal gain
    1/(R h A_c) in K/V^2, which depends on neither R nor A_c.

    `record`: with voltage and temperature of the channel, perhaps `ambient.temperature`;
    `resistance`: V^2 over the heat of a wire, with its error: R, where there are no leads. Raises
    InputError: no temperature, one that does not follow the voltage, or free convection.
    """
    if parameters["wire.convection"] != "constant":
        raise refusal("free convection", path=record.path)
    also = ["current"] if has_samples(record, f"{staircase.channel}.current") else []
    staircase = staircase.read(record, "voltage", "temperature", *also)
    v, t = (staircase.means(record, kind) for kind in ("voltage", "temperature"))
    channel, n = staircase.channel, len(v.value)
    remarks: list[Finding] = []
    volts, kelvin, square = v.value, t.value, v.value**2
    shared = staircase.same_level(volts)  # plateaus that share a converter error
    ones, rise_of_square = np.ones(n), float(np.ptp(square))

    # What the room did from plateau to plateau, or one standard deviation of what it may have done.
    middle = staircase.windows.mean(axis=1)
    centred, duration, size = middle - middle.mean(), float(np.ptp(middle)), 0.0
    if has_samples(record, _ROOM):
        room = np.interp(middle, *samples(record, _ROOM))
        kelvin = kelvin - (room - room.mean())
    else:
        size = _DRIFT_STD * min(1.0, duration / _DRIFT_TIME)
    drift = centred / (0.5 * duration)
    if straight_line(square, kelvin).slope * rise_of_square < 10.0 * float(np.median(t.noise)):
        raise refusal(
            "temperature does not follow", path=record.path, channel=channel,
            rise=np.ptp(kelvin), volts=np.ptp(volts),
        )

    def covariance(gain: float, size: float = size) -> Array:
        """(n, n) of T - gain V^2 in K^2: effective variance, converters' share at equal levels."""
        sensitivity = 2.0 * gain * volts
        noise = t.noise**2 + (sensitivity * v.noise) ** 2 + t.hidden**2
        hidden = np.outer(sensitivity, sensitivity) * v.hidden**2 * shared
        return np.diag(noise) + hidden + np.outer(size * drift, size * drift)

    # T over V^2: (T_inf, 1/(R h A_c)).
    fit = fit_slope([ones, square], kelvin, covariance)
    (ambient, gain), (ambient_std, gain_std) = fit.beta.tolist(), fit.std.tolist()

    # How far the room went to either side of its mean, as the staircase shows it.
    went = 0.0
    if size and n >= _FEWEST_TO_DRIFT:
        design = np.column_stack([ones, square, drift * size / np.max(np.abs(size * drift))])
        drifting = fit_linear(design, kelvin, covariance(gain, size=0.0))
        went, error = float(drifting.beta[2]), float(drifting.std[2])
        if abs(went) < max(_SIGNIFICANT * error, _SMALL_DRIFT * gain * rise_of_square):
            went = 0.0
        else:
            remarks.append(remark("room drifts", drift=2.0 * went, std=2.0 * error))

    # Plateaus whose temperature still changed while it was averaged.
    limit = max(_SMALLEST_DRIFT, _LARGE_DRIFT * float(np.ptp(kelvin)))
    moving = (np.abs(t.drift) > _DRIFTS * t.drift_std) & (np.abs(t.drift) > limit)
    if moving.any():
        settled = kelvin + np.where(moving, t.drift, 0.0)
        moved = fit_slope([ones, square], settled, covariance).beta - fit.beta
        ambient_std, gain_std = math.hypot(ambient_std, moved[0]), math.hypot(gain_std, moved[1])
        worst = int(np.argmax(np.where(moving, np.abs(t.drift), 0.0)))
        remarks.append(remark(
            "plateaus not settled", plateaus=moving.sum(), of=n, largest_drift=t.drift[worst],
            volts=volts[worst],
        ))

    # Straight over V^2, or over R times a wire's power where there is a current, as R may vary?
    heating, errors, what = square, covariance(gain), "squared voltage"
    if has_samples(record, f"{channel}.current"):
        current = staircase.means(record, "current")
        # The sensor's zero: a plateau at 0 V tells it better than a line that may not be straight.
        undriven = np.abs(volts) < staircase.tolerance
        if undriven.any():
            offset = float(np.mean(current.value[undriven]))
            common = float(np.mean(current.noise[undriven])) / math.sqrt(float(undriven.sum()))
        else:
            of_volts = straight_line(volts, current.value)
            offset = of_volts.value - of_volts.slope * of_volts.at
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
    if abs(bend) >= max(_SIGNIFICANT * error, _LARGE_BEND):
        gain_std = math.hypot(gain_std, gain * abs(bend) / math.sqrt(12.0))
        # h at a plateau is the inverse slope of the chord from ambient: 1 - bend/2 at its coldest.
        way = "rises" if bend < 0.0 else "falls"
        remarks.append(remark(
            "coefficient varies", what=what, way=way, size=0.5 * abs(bend), growth=-0.5 * bend,
            growth_std=0.5 * error,
        ))

    # Is the room as warm as it was said, or measured, to be?
    known = []
    if AMBIENT in parameters.given:
        known.append(("stated", parameters[AMBIENT], parameters.std(AMBIENT)))
    if has_samples(record, _ROOM):
        measured, stated = samples(record, _ROOM)[1], record[_ROOM].std
        std = parameters.std(AMBIENT) if stated is None else float(np.median(stated))
        known.append(("measured", float(np.mean(measured)), max(float(np.std(measured)), std)))
    for how, value, std in known:
        if abs(ambient - value) > _SIGNIFICANT * math.hypot(ambient_std, std):
            remarks.append(remark(
                "ambient", how=how, ambient=ambient, value=value, difference=ambient - value
            ))

    # What no record shows: the converter's zero, the camera's, its scale, and the drift.
    shifted = (volts + parameters.std(ZERO)) ** 2
    off = fit_slope([ones, shifted], kelvin, covariance).beta[1] - gain
    words = "steady temperature over squared voltage"
    thermal_gain = Estimate(gain, gain_std, "K/V2", words, n).with_shares({ZERO: float(off)})
    # Nobody calibrates a camera's zero better than to its own step.
    ambient_std = math.hypot(ambient_std, t.step / math.sqrt(12.0))
    zero, (scale_name, *_) = "sensor.temperature.offset", CAMERA
    words = "steady temperature at zero voltage"
    cold = Estimate(ambient, ambient_std, "K", words, n).with_shares({
        zero: parameters.std(zero), "drift of the room": abs(went),
        scale_name: parameters.std(scale_name) * (ambient - CELSIUS_ZERO),
    })
    ends = np.linspace(0.0, float(volts.max()), 100)
    curves = {
        "voltage": volts, "temperature": kelvin,
        "heating": np.array([float(p.direction == "up") for p in staircase.plateaus]),
        "line_voltage": ends, "line_temperature": ambient + gain * ends**2,
    }
    return Experiment(
        "E2", "Heat transfer coefficient",
        {COEFFICIENT: coefficient(thermal_gain, resistance, parameters), AMBIENT: cold},
        tuple(remarks), curves, staircase.source(record), {GAIN: thermal_gain},
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
    return {name: (-2.0 if name == VOLTAGE else 1.0) * share for name, share in spread.items()}
