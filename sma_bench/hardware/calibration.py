"""Sensors against known loads: gain and offset, with their errors. Pure functions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import Telemetry

_FEWEST = 3  # pairs that tell a scatter


@dataclass(frozen=True)
class Calibration:
    """value = gain * reading + offset."""

    gain: float = 1.0
    offset: float = 0.0

    def apply(self, reading: float) -> float:
        """The value behind a reading."""
        return self.gain * reading + self.offset

    def reading(self, value: float) -> float:
        """The reading that a value gives."""
        return (value - self.offset) / self.gain


@dataclass(frozen=True)
class CalibrationFit:
    """A calibration with one standard deviation each, and how far the points scatter."""

    calibration: Calibration
    gain_std: float
    offset_std: float
    residual_std: float
    n: int


@dataclass(frozen=True)
class RangeCalibration:
    """Triangulation: the voltage is proportional to 1/(distance + shift).

    distance (m) = 1/(gain * voltage + offset) - shift
    """

    gain: float
    offset: float
    shift: float = 0.0

    def distance(self, voltage: float) -> float:
        """Distance in m at a sensor's voltage; infinite beyond what it can see (REP-117)."""
        inverse = self.gain * voltage + self.offset
        return 1.0 / inverse - self.shift if inverse > 0.0 else math.inf


def fit_calibration(readings: ArrayLike, known: ArrayLike) -> CalibrationFit:
    """Least-squares line through readings (n,) of known loads (n,), in the loads' unit.

    The errors come from the scatter and are NaN with two points.

    Raises:
        InputError: fewer than two different readings, values that are not finite, a gain of zero.
    """
    x = np.atleast_1d(np.asarray(readings, dtype=float))
    y = np.atleast_1d(np.asarray(known, dtype=float))
    if x.shape != y.shape or x.ndim != 1:
        raise InputError(
            f"calibration: {x.size} readings for {y.size} known loads, expected as many"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("calibration: a reading or a load is not finite")
    if (different := np.unique(x).size) < 2:
        raise InputError(f"calibration: {different} different readings, expected at least 2")
    centre = x.mean()
    spread = float(((x - centre) ** 2).sum())
    gain = float(((x - centre) * y).sum() / spread)
    offset = float(y.mean() - gain * centre)
    if gain == 0.0:
        raise InputError("calibration: the readings do not follow the known loads (gain 0)")
    freedom = len(x) - 2
    residual = y - gain * x - offset
    scatter = math.sqrt(float((residual**2).sum()) / freedom) if freedom else math.nan
    return CalibrationFit(
        Calibration(gain, offset),
        gain_std=scatter / math.sqrt(spread),
        offset_std=scatter * math.sqrt(1.0 / len(x) + centre**2 / spread),
        residual_std=scatter,
        n=len(x),
    )


def fit_range_calibration(
    voltages: ArrayLike, distances: ArrayLike, shift: float = 0.0
) -> RangeCalibration:
    """Triangulation sensor from voltages (n,) at known distances (n,) in m.

    `shift` is the depth of the lens behind the sensor's face, in m.

    Raises:
        InputError: as `fit_calibration`; or a distance that is not in front of the lens.
    """
    metres = np.atleast_1d(np.asarray(distances, dtype=float))
    if not (metres + shift > 0.0).all():
        raise InputError(
            f"calibration: distance {metres.min():g} m with shift {shift:g} m, expected positive"
        )
    line = fit_calibration(voltages, 1.0 / (metres + shift)).calibration
    return RangeCalibration(line.gain, line.offset, shift)


# --- Calibrating one of the device's sensors: which there are, and what a fit becomes on the
# bridge.
#
# Readings are the device's own (V, A), known loads true ones (V, A, m).

@dataclass(frozen=True)
class CalibratedSensor:
    """One sensor: units of its reading and of what is known, what is measured with it, and where
    telemetry has it."""

    unit: str
    known_unit: str
    quantity: str
    reading: Callable[[Telemetry], float]

    @property
    def is_range(self) -> bool:
        """Whether it measures a distance."""
        return self.known_unit == "m"


SENSORS = {
    "supply": CalibratedSensor("V", "V", "voltage", lambda t: t.supply),
    "front_current": CalibratedSensor("A", "A", "current", lambda t: t.current[0]),
    "back_current": CalibratedSensor("A", "A", "current", lambda t: t.current[1]),
    "front_range": CalibratedSensor("V", "m", "deflection", lambda t: t.range_voltage[0]),
    "back_range": CalibratedSensor("V", "m", "deflection", lambda t: t.range_voltage[1]),
}


@dataclass(frozen=True)
class SensorFit:
    """The bridge's parameters of a sensor, and how well the known loads lie on them.

    `std` has the standard errors that the scatter gives (NaN with two points), `rest` the rms of
    what is left, in the unit of the known loads; `uncertainty` what it leaves open of the readings
    of this kind, by the parameters `sensor.` (none with two points).
    """

    parameters: dict[str, float]
    std: dict[str, float]
    rest: float
    uncertainty: dict[str, float]


def fit_sensor(
    name: str, readings: Sequence[float], known: Sequence[float], shift: float
) -> SensorFit:
    """Fit a sensor of SENSORS to readings of known loads.

    Args:
        shift: m, depth of the lens behind the face of a range sensor; others have none.

    Raises:
        InputError: as `fit_calibration` and `fit_range_calibration`.
    """
    kind, std = SENSORS[name], {}
    if kind.is_range:
        ranger = fit_range_calibration(readings, known, shift)
        found = {"gain": ranger.gain, "offset": ranger.offset, "shift": shift}
        calibrated = [ranger.distance(x) for x in readings]
        uncertainty = _left_open(kind.quantity, fit_calibration(calibrated, known), [], known)
        # The tip at rest is zero, whatever the distance.
        uncertainty.pop("sensor.deflection.offset", None)
    else:
        fit = fit_calibration(readings, known)
        found = {"gain": fit.calibration.gain, "offset": fit.calibration.offset}
        std = {"gain": fit.gain_std, "offset": fit.offset_std}
        calibrated = [fit.calibration.apply(x) for x in readings]
        uncertainty = _left_open(kind.quantity, fit, readings, known)
    named, named_std = (
        {f"calibration.{name}.{key}": value for key, value in numbers.items()}
        for numbers in (found, std)
    )
    rest = math.sqrt(float(np.mean(np.square(np.subtract(calibrated, known)))))
    return SensorFit(named, named_std, rest, uncertainty)


def _left_open(
    quantity: str, fit: CalibrationFit, readings: Sequence[float], known: Sequence[float]
) -> dict[str, float]:
    """Standard errors of gain and offset of a calibrated reading: by the scatter, and by the last
    digits of readings and known loads where these scatter less."""
    if fit.n < _FEWEST or not math.isfinite(fit.residual_std):
        return {}
    gain = fit.calibration.gain
    digits = math.hypot(gain * _last_digit(readings), _last_digit(known)) / math.sqrt(12.0)
    scatter = max(fit.residual_std, digits)
    if scatter == 0.0:
        return {}
    own = np.asarray(known, dtype=float)
    spread = math.sqrt(float(((own - own.mean()) ** 2).sum()))
    return {
        f"sensor.{quantity}.gain": scatter / spread,
        f"sensor.{quantity}.offset": scatter * math.hypot(fit.n**-0.5, own.mean() / spread),
    }


def _last_digit(values: Sequence[float]) -> float:
    """What the last decimal that any of them has is worth; 0 where all are whole."""
    places = [-int(Decimal(repr(float(value))).normalize().as_tuple().exponent) for value in values]
    return 10.0 ** -max(places) if max(places, default=0) > 0 else 0.0
