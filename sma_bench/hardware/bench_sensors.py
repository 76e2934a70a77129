"""Readings of the device's sensors as volts, amperes and metres of the bench."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError
from sma_bench.hardware.calibration import Calibration, RangeCalibration
from sma_bench.hardware.device import Reading
from sma_bench.hardware.serial_messages import CHANNELS, Telemetry

# --- Volts and amperes of each wire from what the device measures: one supply, two boards,
# duties.
#
# The supply is the one without load, less what a pulse of the wire's own board takes from it.
#
# A wire switched on for the share d of the time has the heat of the direct voltage sqrt(d) U, and
# carries, in that sense, the current I/sqrt(d), where I is its mean current: V/I is the resistance
# and V^2/R the power, as for direct voltage.


BOARDS = 2
_PER_BOARD = CHANNELS // BOARDS
# Below it a converter's step of mean current is amplified more than 30 times.
_LEAST_DUTY = 1e-3


@dataclass(frozen=True)
class ChannelPower:
    """Equivalent direct voltage (V) and current (A) of one wire; NaN is not measured."""

    voltage: float
    current: float


@dataclass(frozen=True)
class PowerCalibration:
    """Of the supply's divider and of both boards' current sensors."""

    supply: Calibration = field(default_factory=Calibration)
    current: tuple[Calibration, Calibration] = (Calibration(), Calibration())


def channel_powers(
    telemetry: Telemetry, calibration: PowerCalibration
) -> tuple[ChannelPower, ...]:
    """One ChannelPower a channel.

    Two driven wires of a board share its current like their duties: equal resistances.
    """
    gain = calibration.supply.gain
    supply = calibration.supply.apply(telemetry.supply)
    means = [
        sensor.apply(current)
        for sensor, current in zip(calibration.current, telemetry.current, strict=True)
    ]
    return tuple(
        ChannelPower(
            math.sqrt(duty) * (supply - gain * telemetry.drop[channel // _PER_BOARD]),
            _current(telemetry.duty, channel, means),
        )
        for channel, duty in enumerate(telemetry.duty)
    )


def _current(duties: tuple[float, ...], channel: int, means: list[float]) -> float:
    board = channel // _PER_BOARD
    duty = duties[channel]
    total = sum(duties[board * _PER_BOARD : (board + 1) * _PER_BOARD])
    if duty == 0.0:
        # Not driven: nothing that a sensor common to both wires could distinguish.
        return 0.0 if total > 0.0 else means[board]
    if duty < _LEAST_DUTY:
        return math.nan
    return means[board] * duty / total / math.sqrt(duty)


def commanded_millivolts(voltage: float, supply_reading: float, supply: Calibration) -> int:
    """What to command for `voltage` V at a wire while the device reads `supply_reading` V.

    The device drives in proportion to its own reading of the supply; the calibration knows better.
    """
    true = supply.apply(supply_reading)
    scale = supply_reading / true if supply_reading > 0.0 and true > 0.0 else 1.0
    return round(1e3 * voltage * scale)


# --- What instruments make of a true value: noise, then quantisation.


_BLOCK = 4096


class Instrument:
    """One sensor chain; a node reads every sample by itself, so the noise is drawn in blocks."""

    def __init__(self, noise: float, resolution: float, seed: np.random.SeedSequence) -> None:
        """Gaussian `noise` (standard deviation) and `resolution` (step; 0 for none), in the unit
        of what is read."""
        self._noise = noise
        self._resolution = resolution
        self._random = np.random.default_rng(seed)
        self._drawn: list[float] = []

    @classmethod
    def of(
        cls, settings: Mapping[str, Any], quantity: str, seed: np.random.SeedSequence
    ) -> "Instrument":
        """The sensor of a quantity (voltage, current, temperature, range, force), as the simulator
        node's parameters have it."""
        resolution = settings.get(f"sensor.{quantity}_resolution", 0.0)
        return cls(settings[f"sensor.{quantity}_noise"], resolution, seed)

    def read(self, value: float) -> float:
        """The reading of a true `value`."""
        if self._noise > 0.0:
            self._drawn = self._drawn or self._block()
            value += self._drawn.pop()
        if self._resolution > 0.0:
            value = round(value / self._resolution) * self._resolution
        return value

    def read_all(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The readings of true values (n,), bit by bit as of one `read` after the other."""
        if self._noise > 0.0:
            while len(self._drawn) < len(values):
                self._drawn = self._block() + self._drawn
            first = len(self._drawn) - len(values)
            values = values + np.array(self._drawn[first:])[::-1]
            del self._drawn[first:]
        if self._resolution > 0.0:
            values = np.rint(values / self._resolution) * self._resolution + 0.0  # no -0.0
        return values

    def _block(self) -> list[float]:
        drawn: list[float] = (self._noise * self._random.standard_normal(_BLOCK)).tolist()
        return drawn


# --- What the device measures as readings of the bench: which wire and which sensor hang where.

SIDES = ("front", "back")
_PER_SIDE = CHANNELS // len(SIDES)


@dataclass(frozen=True)
class BenchReading:
    """One window of telemetry in the bench's own terms.

    `time` is the host's monotonic clock in s, the middle of the window. `powers` are in the order
    of bench.channels, `distances` (m) in that of SIDES: infinite beyond a sensor's sight.
    `deflection` (m, positive toward the front) is NaN when no sensor sees the tip.
    """

    time: float
    powers: tuple[ChannelPower, ...]
    distances: tuple[float, float]
    deflection: float
    board_currents: tuple[float, float] = (0.0, 0.0)
    """A, mean through all wires of the front, the back board"""
    board_volts: tuple[float, float] = (0.0, 0.0)
    """V, mean over time and summed over the wires of a board: current times resistance"""


def device_channels(sides: Sequence[str]) -> tuple[int, ...]:
    """The device's channel of every bench channel: the sides' outputs in the order of the names.

    Raises:
        InputError: more channels on a side than the device has there.
    """
    used = dict.fromkeys(SIDES, 0)
    found = []
    for side in sides:
        if side not in used or used[side] == _PER_SIDE:
            raise InputError(
                f"bench.channel_sides: {', '.join(sides)}, the device has {_PER_SIDE} channels "
                f"at the front and {_PER_SIDE} at the back"
            )
        found.append(SIDES.index(side) * _PER_SIDE + used[side])
        used[side] += 1
    return tuple(found)


class BenchSensors:
    """Telemetry in, readings out; volts in, the device's millivolts out."""

    def __init__(self, sides: Sequence[str], settings: Mapping[str, Any]) -> None:
        """`settings` are the bridge's `calibration.` and `range.` parameters.

        Raises:
            InputError: as `device_channels`; an unknown range sensor.
        """
        self._channels = device_channels(sides)
        front, back = (_line(f"{side}_current", settings) for side in SIDES)
        self._power = PowerCalibration(_line("supply", settings), (front, back))
        self._range = tuple(
            RangeCalibration(
                *(settings[f"calibration.{side}_range.{n}"] for n in ("gain", "offset", "shift"))
            )
            for side in SIDES
        )
        self._standoff = tuple(settings[f"range.{side}_standoff"] for side in SIDES)
        for sensor in settings["range.sensors"]:
            if sensor not in SIDES:
                raise InputError(f"range.sensors: {sensor!r}, expected front or back")
        # One clamped wire bends nothing.
        composite = len(sides) > 1
        self.range_sensors: tuple[str, ...] = settings["range.sensors"] if composite else ()

    @property
    def shared(self) -> tuple[tuple[int, ...], ...]:
        """Bench channels whose currents one sensor measures together."""
        boards = [
            tuple(k for k, channel in enumerate(self._channels) if channel // _PER_SIDE == board)
            for board in range(len(SIDES))
        ]
        return tuple(board for board in boards if len(board) > 1)

    def reading(self, reading: Reading) -> BenchReading:
        """The bench behind one window of telemetry."""
        telemetry = reading.telemetry
        powers = channel_powers(telemetry, self._power)
        supply, duty = self.supply(telemetry.supply), telemetry.duty
        front, back = (
            sensor.distance(volt)
            for sensor, volt in zip(self._range, telemetry.range_voltage, strict=True)
        )
        return BenchReading(
            reading.time,
            tuple(powers[channel] for channel in self._channels),
            (front, back),
            self._deflection(front, back),
            self.board_currents(telemetry),
            (supply * sum(duty[:_PER_SIDE]), supply * sum(duty[_PER_SIDE:])),
        )

    def board_currents(self, telemetry: Telemetry) -> tuple[float, float]:
        """A, mean through each board, calibrated."""
        front, back = (
            sensor.apply(current)
            for sensor, current in zip(self._power.current, telemetry.current, strict=True)
        )
        return front, back

    def supply(self, measured: float) -> float:
        """The supply's voltage (V) behind the device's reading of it."""
        return self._power.supply.apply(measured)

    def millivolts(self, voltage: Sequence[float], supply_reading: float) -> list[int]:
        """What to command for `voltage` V at the bench's wires; other outputs stay off."""
        command = [0] * CHANNELS
        for channel, volt in zip(self._channels, voltage, strict=True):
            command[channel] = commanded_millivolts(volt, supply_reading, self._power.supply)
        return command

    def _deflection(self, front: float, back: float) -> float:
        """Mean over the mounted sensors that see the tip; bending to the front nears the front."""
        towards_front = {
            "front": self._standoff[0] - front,
            "back": back - self._standoff[1],
        }
        seen = [towards_front[sensor] for sensor in self.range_sensors]
        seen = [deflection for deflection in seen if math.isfinite(deflection)]
        return sum(seen) / len(seen) if seen else math.nan


def _line(sensor: str, settings: Mapping[str, Any]) -> Calibration:
    gain, offset = (settings[f"calibration.{sensor}.{name}"] for name in ("gain", "offset"))
    return Calibration(gain, offset)
