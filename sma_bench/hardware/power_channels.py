"""Volts and amperes of each wire from what the device measures: one supply, two boards, duties.

The supply is the one without load, less what a pulse of the wire's own board takes from it.

A wire switched on for the share d of the time has the heat of the direct voltage sqrt(d) U, and
carries, in that sense, the current I/sqrt(d), where I is its mean current: V/I is the resistance
and V^2/R the power, as for direct voltage.
"""

import math
from dataclasses import dataclass, field

from sma_bench.hardware.calibration import Calibration
from sma_bench.hardware.serial_messages import CHANNELS, Telemetry

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
        # Not driven: nothing that a sensor common to both wires could tell apart.
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
