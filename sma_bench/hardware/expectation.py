"""What a wire should do by the model, beside what it does: disagreements that last are faults.

A broken or shorted wire, a camera that looks elsewhere, a cooling fan that stopped: none of them
breaks a limit at first. No ROS, no clock of its own.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.parameters import Parameters

_CELSIUS_ZERO = 273.15
# A; offset and noise of a board's current sensor.
_CURRENT_FLOOR = 0.1
# V; below it the current sensor's noise says nothing about a resistance.
_LEAST_VOLTAGE = 1.0
# Of the voltage's tolerance: what is left of it at 0 V.
_LEAST_TOLERANCE = 0.2
# s; stamps of a camera come a few ms early or late.
_RATE_BASE = 0.05
# A reading may belong to any of the last commands.
_COMMANDS = 10
_LEAST_READINGS = 5
# s between two readings whose difference is what a step of the voltage did to the power; much
# less than a phase change takes.
_STEP_BASE = 0.05
_LEAST_STEP = 0.5  # V^2
_LEAST_PAIRS = 20
# Differences that overlap count once for each of this many.
_OVERLAP = 5
_FORGOTTEN = 0.995
# Of a wire's own excitation, what must not be its neighbour's too.
_INDEPENDENT = 0.1
_RIDGE = 1e-6
# Of the model's conductance: an open wire has less than the first, with three standard deviations
# less than the second.
_OPEN, _SURELY = 0.5, 0.7
_LEAST_NOISE = 0.02  # W
# A; an uncalibrated ACS712 may be 0.4 A off, a calibrated one is not.
_OFF_CURRENT = 0.3
# s; a window may hold what flowed before an output's last step.
_FLOWING_FOR = 0.15
_EXCEEDING_FOR = 0.06


@dataclass(frozen=True)
class WireModel:
    """Ohm's law and eq. (1) of one wire (ohm, W/K, J/K, K), and what may differ from them."""

    resistance: float
    heat_loss: float
    heat_capacity: float
    ambient: float
    maximum_temperature: float
    maximum_voltage: float
    voltage_tolerance: float
    """V, at the highest voltage"""
    resistance_tolerance: float
    """share of the expected current"""
    temperature_tolerance: float
    """K"""
    leads: float = 0.0
    """ohm, between where the voltage is measured and the wire"""
    supply: float = 0.0
    """V that a duty switches; 0: commanded volts are direct"""

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> "WireModel":
        """From the contract's parameters; the wires of a channel as one."""
        count = parameters["wire.count"]
        duty = parameters["bench.drive"] == "duty"
        return cls(
            resistance=parameters["wire.resistance"] / count,
            heat_loss=count
            * parameters["wire.heat_transfer_coefficient"]
            * parameters["wire.surface_area"],
            heat_capacity=count * parameters["wire.mass"] * parameters["wire.specific_heat"],
            ambient=parameters["environment.ambient_temperature"],
            maximum_temperature=parameters["bench.maximum_temperature"],
            maximum_voltage=parameters["bench.maximum_voltage"],
            voltage_tolerance=parameters["bench.voltage_tolerance"],
            resistance_tolerance=parameters["bench.resistance_tolerance"],
            temperature_tolerance=parameters["bench.temperature_tolerance"],
            leads=parameters["bench.lead_resistance"],
            supply=parameters["bench.supply_voltage"] if duty else 0.0,
        )

    def reading(self, commanded: float) -> float:
        """V that are read at a command: of a duty the direct voltage of the same heat."""
        return math.sqrt(max(commanded, 0.0) * self.supply) if self.supply else commanded

    @property
    def circuit(self) -> float:
        """V/I, ohm: the wire with its leads."""
        return self.resistance + self.leads

    @property
    def heated(self) -> float:
        """V^2 over the heat of the wire, ohm."""
        return self.circuit**2 / self.resistance

    @property
    def least_resistance(self) -> float:
        """ohm that the circuit may have, its wire cold, hot or worn."""
        return self.circuit * max(1.0 - self.resistance_tolerance, 0.05)

    def warmed(self, temperature: float, volt: float, elapsed: float) -> float:
        """Temperature (K) after `elapsed` s at `volt` V, from `temperature` K."""
        steady = self.ambient + volt**2 / self.heated / self.heat_loss
        decay = math.exp(-elapsed * self.heat_loss / self.heat_capacity)
        return steady + (temperature - steady) * decay

    def heating_voltage(self, volt: float, ampere: float) -> float:
        """V that heat the wire at least as what was measured; NaN is not measured.

        A current without a voltage heats too: a switch that does not open.
        """
        powers = [volt**2 / self.heated, (volt - self.leads * ampere) * ampere]
        if not volt >= _LEAST_VOLTAGE and abs(ampere) > _CURRENT_FLOOR:
            powers.append(ampere**2 * self.resistance)
        highest = max((power for power in powers if not math.isnan(power)), default=0.0)
        return math.sqrt(highest * self.heated)

    def allowed_deviation(self, volt: float) -> float:
        """V by which a commanded voltage and its reading may differ: less at small ones."""
        share = _LEAST_TOLERANCE + volt / self.reading(self.maximum_voltage)
        return self.voltage_tolerance * min(share, 1.0)


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


class BoardWatch:
    """One board's current against what its outputs can put through its wires."""

    def __init__(self, side: str) -> None:
        self._side = side
        self._flows, self._exceeds = Lasting(_FLOWING_FOR), Lasting(_EXCEEDING_FOR)
        self.flowing = ""
        """what flows though every output is off, "" for nothing"""

    def current(self, ampere: float, volts: float, now: float, model: WireModel) -> str:
        """Disagreement of a mean current (A) with the mean of the wires' volts, or ""."""
        off = volts == 0.0
        flows = (
            f"{ampere:.2f} A through the {self._side} board with its outputs off"
            if off and abs(ampere) > _OFF_CURRENT
            else ""
        )
        most = _CURRENT_FLOOR + volts / model.least_resistance
        exceeds = (
            f"short circuit: the {self._side} board carries {ampere:.2f} A, its outputs explain "
            f"at most {most:.2f} A"
            if not off and ampere > most
            else ""
        )
        self.flowing = self._flows.note(flows, now)
        return self._exceeds.note(exceeds, now) or self.flowing


class WireWatch:
    """One wire's readings against its commands, its model and each other."""

    def __init__(self, channel: str, patience: float) -> None:
        self._channel = channel
        self._commands: deque[float] = deque(maxlen=_COMMANDS)
        self._follows, self._conducts, self._warms = (Lasting(patience) for _ in range(3))
        self._modelled = math.nan
        self._hottest = math.nan
        self._heating = 0.0
        self._powered = math.nan
        self._reference: tuple[float, float] | None = None

    def commanded(self, volt: float) -> None:
        """A command (V) was sent."""
        self._commands.append(volt)

    def power(
        self, volt: float, ampere: float, stamp: float, now: float, model: WireModel
    ) -> str:
        """Disagreement shown by a reading acquired at `stamp` s and heard at `now` s, or ""."""
        if math.isnan(volt) and math.isnan(ampere):
            return ""
        self._let_pass(volt, ampere, stamp, model)
        if math.isnan(volt):
            return ""
        return self._follows.note(self._not_followed(volt, model), now) or self._conducts.note(
            self._not_conducted(volt, ampere, model), now
        )

    def heat(self, model: WireModel) -> str:
        """Over-temperature by the model, from all power that was measured, or "".

        Before the first reading anything may have heated the wire: it counts as hot as allowed.
        """
        if not self._hottest > model.maximum_temperature:
            return ""
        return (
            f"over-temperature by the model: {self._channel} at "
            f"{self._hottest - _CELSIUS_ZERO:.1f} degC, limit "
            f"{model.maximum_temperature - _CELSIUS_ZERO:.1f} degC, and no temperature is measured"
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
        if not math.isfinite(kelvin):
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

    def _let_pass(self, volt: float, ampere: float, stamp: float, model: WireModel) -> None:
        elapsed = stamp - self._powered
        if not elapsed >= 0.0:  # the first reading, or a clock that went back
            self._modelled, self._hottest, elapsed = model.ambient, model.maximum_temperature, 0.0
        heating = model.heating_voltage(volt, ampere)
        expected = heating if math.isnan(volt) else volt
        self._modelled = model.warmed(self._modelled, expected, elapsed)
        # Nobody knows when, since the last reading, the voltage changed.
        self._hottest = model.warmed(self._hottest, max(heating, self._heating), elapsed)
        self._heating, self._powered = heating, stamp

    def _not_followed(self, volt: float, model: WireModel) -> str:
        if not self._commands:
            return ""
        expected = [model.reading(volt) for volt in self._commands]
        lowest, highest = min(expected), max(expected)
        low = lowest - model.allowed_deviation(lowest)
        high = highest + model.allowed_deviation(highest)
        if low <= volt <= high:
            return ""
        allowed = model.allowed_deviation(expected[-1])
        return (
            f"disagreement: {self._channel} gets {volt:.2f} V, commanded "
            f"{expected[-1]:.2f} V, tolerance {allowed:.2g} V"
        )

    def _not_conducted(self, volt: float, ampere: float, model: WireModel) -> str:
        expected = volt / model.circuit
        allowed = _CURRENT_FLOOR + model.resistance_tolerance * expected
        # A current that is not measured (NaN) disagrees with nothing.
        if volt < _LEAST_VOLTAGE or not abs(ampere - expected) > allowed:
            return ""
        return (
            f"disagreement: {self._channel} carries {ampere:.2f} A at {volt:.2f} V, the model says "
            f"{expected:.2f} A, tolerance {allowed:.2f} A"
        )


class SharedWatch:
    """Two wires behind one current sensor: does each take its part of a step?

    Alone, or with a third of the power, a broken wire shows in its own readings. Beside a stronger
    one it does not: they share the current like their duties. But the board's power is
    sum(V^2/R), and what a step of the voltages changes in it, before any wire's phase can follow,
    has each wire's conductance in it as soon as the two do not step alike.
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self._channels = channels
        self._recent: deque[tuple[float, float, tuple[float, ...]]] = deque()
        self._before: tuple[float, ...] = ()
        self._squares = np.zeros((len(channels), len(channels)))
        self._products = np.zeros(len(channels))
        self._power_squares = 0.0
        self._pairs = 0.0
        self._reason = ""

    def power(
        self, volts: Sequence[float], amperes: Sequence[float], stamp: float, model: WireModel
    ) -> str:
        """The wire that takes no current, by readings acquired at `stamp` s, or ""."""
        heat = tuple(volt**2 for volt in volts)
        before, self._before = self._before, heat
        if self._recent and stamp < self._recent[-1][0]:
            self._recent.clear()
        # In the window of a step, voltages are those of its end and currents a mean.
        if heat != before and not _near(heat, before):
            return self._reason
        power = sum(v * i for v, i in zip(volts, amperes, strict=True) if not math.isnan(v * i))
        self._recent.append((stamp, power, heat))
        while stamp - self._recent[0][0] > _STEP_BASE:
            _, old_power, old_heat = self._recent.popleft()
            step = np.subtract(heat, old_heat)
            if np.abs(step).max() >= _LEAST_STEP:
                change = power - old_power
                self._squares = _FORGOTTEN * self._squares + np.outer(step, step)
                self._products = _FORGOTTEN * self._products + step * change
                self._power_squares = _FORGOTTEN * self._power_squares + change**2
                self._pairs = _FORGOTTEN * self._pairs + 1.0
                self._reason = self._open(model)
        return self._reason

    def _open(self, model: WireModel) -> str:
        if self._pairs < _LEAST_PAIRS:
            return ""
        excited = np.diag(self._squares)
        # From steps that were all alike no wire is identifiable; this keeps it finite.
        ridge = _RIDGE * float(excited.max())
        inverse = np.linalg.inv(self._squares + ridge * np.eye(len(excited)))
        conductance = inverse @ self._products
        left = max(self._power_squares - float(conductance @ self._products), 0.0)
        noise = max(left / self._pairs, _LEAST_NOISE**2) * _OVERLAP
        for k, channel in enumerate(self._channels):
            share = conductance[k] * model.circuit
            std = math.sqrt(noise * inverse[k, k]) * model.circuit
            identifiable = 1.0 / inverse[k, k] - ridge > _INDEPENDENT * excited[k] > ridge
            if identifiable and share < _OPEN and share + 3.0 * std < _SURELY:
                return (
                    f"open: {channel} takes {max(share, 0.0):.0%} of its current where the "
                    f"voltages step, beside {self._channels[1 - k]}"
                )
        return ""


def _near(heat: Sequence[float], before: Sequence[float]) -> bool:
    return len(heat) == len(before) and all(
        abs(now - then) < 0.01 * max(now, _LEAST_STEP)
        for now, then in zip(heat, before, strict=True)
    )
