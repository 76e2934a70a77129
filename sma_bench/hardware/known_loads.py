"""Calibrating one of the device's sensors: which there are, and what a fit becomes on the bridge.

Readings are the device's own (V, A), known loads true ones (V, A, m).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.hardware.calibration import fit_calibration, fit_range_calibration
from sma_bench.hardware.serial_messages import Telemetry


@dataclass(frozen=True)
class CalibratedSensor:
    """One sensor: units of its reading and of what is known, and where telemetry has it."""

    unit: str
    known_unit: str
    reading: Callable[[Telemetry], float]

    @property
    def is_range(self) -> bool:
        """Whether it measures a distance."""
        return self.known_unit == "m"


SENSORS = {
    "supply": CalibratedSensor("V", "V", lambda t: t.supply),
    "front_current": CalibratedSensor("A", "A", lambda t: t.current[0]),
    "back_current": CalibratedSensor("A", "A", lambda t: t.current[1]),
    "front_range": CalibratedSensor("V", "m", lambda t: t.range_voltage[0]),
    "back_range": CalibratedSensor("V", "m", lambda t: t.range_voltage[1]),
}


@dataclass(frozen=True)
class SensorFit:
    """The bridge's parameters of a sensor, and how well the known loads lie on them.

    `std` has the standard errors that the scatter gives (NaN with two points), `rest` the rms of
    what is left, in the unit of the known loads.
    """

    parameters: dict[str, float]
    std: dict[str, float]
    rest: float


def fit_sensor(
    name: str, readings: Sequence[float], known: Sequence[float], shift: float
) -> SensorFit:
    """Fit a sensor of SENSORS to readings of known loads.

    Args:
        shift: m, depth of the lens behind the face of a range sensor; others have none.

    Raises:
        InputError: as `fit_calibration` and `fit_range_calibration`.
    """
    prefix = f"calibration.{name}."
    if not SENSORS[name].is_range:
        fit = fit_calibration(readings, known)
        line = fit.calibration
        left = [line.apply(x) - y for x, y in zip(readings, known, strict=True)]
        return SensorFit(
            {prefix + "gain": line.gain, prefix + "offset": line.offset},
            {prefix + "gain": fit.gain_std, prefix + "offset": fit.offset_std},
            _rms(left),
        )
    sensor = fit_range_calibration(readings, known, shift)
    left = [sensor.distance(x) - y for x, y in zip(readings, known, strict=True)]
    values = {"gain": sensor.gain, "offset": sensor.offset, "shift": shift}
    return SensorFit({prefix + key: value for key, value in values.items()}, {}, _rms(left))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values))))
