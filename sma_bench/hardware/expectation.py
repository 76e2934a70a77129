"""What a wire should do by the model, beside what it does: disagreements that last are faults.

A broken or shorted wire, a camera that looks elsewhere, a cooling fan that stopped: none of them
breaks a limit at first. No ROS, no clock of its own.
"""

import math
from collections import deque
from dataclasses import dataclass

from sma_bench.parameters import Parameters

_CELSIUS_ZERO = 273.15
# A; offset and noise of a board's current sensor.
_CURRENT_FLOOR = 0.1
# V; below it the current sensor's noise says nothing about a resistance.
_LEAST_VOLTAGE = 1.0
# s; stamps of a camera come a few ms early or late.
_RATE_BASE = 0.05
# A reading may belong to any of the last commands.
_COMMANDS = 10
_LEAST_READINGS = 5


@dataclass(frozen=True)
class WireModel:
    """Ohm's law and eq. (1) of one wire (ohm, W/K, J/K, K), and what may differ from them."""

    resistance: float
    heat_loss: float
    heat_capacity: float
    ambient: float
    voltage_tolerance: float
    """V"""
    resistance_tolerance: float
    """share of the expected current"""
    temperature_tolerance: float
    """K"""

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> "WireModel":
        """From the contract's parameters."""
        return cls(
            resistance=parameters["wire.resistance"],
            heat_loss=parameters["wire.heat_transfer_coefficient"]
            * parameters["wire.surface_area"],
            heat_capacity=parameters["wire.mass"] * parameters["wire.specific_heat"],
            ambient=parameters["environment.ambient_temperature"],
            voltage_tolerance=parameters["bench.voltage_tolerance"],
            resistance_tolerance=parameters["bench.resistance_tolerance"],
            temperature_tolerance=parameters["bench.temperature_tolerance"],
        )

    def heated(self, temperature: float, volt: float, elapsed: float) -> float:
        """Temperature (K) after `elapsed` s at `volt` V, from `temperature` K."""
        steady = self.ambient + volt**2 / self.resistance / self.heat_loss
        decay = math.exp(-elapsed * self.heat_loss / self.heat_capacity)
        return steady + (temperature - steady) * decay


class Lasting:
    """A deviation becomes a fault when every reading for `patience` s shows it."""

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._since: float | None = None
        self._readings = 0

    def note(self, deviation: str, now: float) -> str:
        """The deviation ("" for none) of a reading at `now` s, once it has lasted."""
        if not deviation:
            self._since, self._readings = None, 0
            return ""
        self._since = now if self._since is None else self._since
        self._readings += 1
        lasting = now - self._since >= self._patience and self._readings >= _LEAST_READINGS
        return deviation if lasting else ""


class WireWatch:
    """One wire's readings against its commands, its model and each other."""

    def __init__(self, channel: str, patience: float) -> None:
        self._channel = channel
        self._commands: deque[float] = deque(maxlen=_COMMANDS)
        self._follows, self._conducts, self._warms = (Lasting(patience) for _ in range(3))
        self._modelled = math.nan
        self._powered = math.nan
        self._reference: tuple[float, float] | None = None

    def commanded(self, volt: float) -> None:
        """A command (V) was sent."""
        self._commands.append(volt)

    def power(
        self, volt: float, ampere: float, stamp: float, now: float, model: WireModel
    ) -> str:
        """Disagreement shown by a reading acquired at `stamp` s and heard at `now` s, or ""."""
        if math.isnan(volt):
            return ""
        self._let_pass(volt, stamp, model)
        return self._follows.note(self._not_followed(volt, model), now) or self._conducts.note(
            self._not_conducted(volt, ampere, model), now
        )

    def temperature(self, kelvin: float, now: float, model: WireModel) -> str:
        """Disagreement of a temperature in K with the model, or ""."""
        modelled = self._modelled
        far = abs(kelvin - modelled) > model.temperature_tolerance  # never with NaN
        deviation = (
            f"disagreement: {self._channel} measured at {kelvin - _CELSIUS_ZERO:.0f} degC, the "
            f"model says {modelled - _CELSIUS_ZERO:.0f} degC, tolerance "
            f"{model.temperature_tolerance:g} K"
        )
        return self._warms.note(deviation if far else "", now)

    def rate(self, kelvin: float, stamp: float, limit: float) -> str:
        """A temperature that rises faster than `limit` K/s, or ""."""
        if math.isnan(kelvin):
            return ""
        before, at = self._reference or (kelvin, stamp)
        elapsed = stamp - at
        if self._reference is not None and 0.0 <= elapsed < _RATE_BASE:
            return ""
        self._reference = (kelvin, stamp)
        if elapsed <= 0.0 or (kelvin - before) / elapsed <= limit:
            return ""
        return (
            f"heating rate: {self._channel} rises by {(kelvin - before) / elapsed:.0f} K/s, limit "
            f"{limit:g} K/s"
        )

    def _let_pass(self, volt: float, stamp: float, model: WireModel) -> None:
        elapsed = stamp - self._powered
        if not elapsed >= 0.0:  # the first reading, or a clock that went back
            self._modelled, elapsed = model.ambient, 0.0
        self._modelled = model.heated(self._modelled, volt, elapsed)
        self._powered = stamp

    def _not_followed(self, volt: float, model: WireModel) -> str:
        if not self._commands:
            return ""
        low = min(self._commands) - model.voltage_tolerance
        high = max(self._commands) + model.voltage_tolerance
        if low <= volt <= high:
            return ""
        return (
            f"disagreement: {self._channel} gets {volt:.2f} V, commanded "
            f"{self._commands[-1]:.2f} V, tolerance {model.voltage_tolerance:g} V"
        )

    def _not_conducted(self, volt: float, ampere: float, model: WireModel) -> str:
        expected = volt / model.resistance
        allowed = _CURRENT_FLOOR + model.resistance_tolerance * expected
        # A current that is not measured (NaN) disagrees with nothing.
        if volt < _LEAST_VOLTAGE or not abs(ampere - expected) > allowed:
            return ""
        return (
            f"disagreement: {self._channel} carries {ampere:.2f} A at {volt:.2f} V, the model says "
            f"{expected:.2f} A, tolerance {allowed:.2f} A"
        )
