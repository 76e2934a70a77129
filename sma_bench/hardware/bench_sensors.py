"""The device's sensors: calibrated readings, calibration from known loads, simulated sensors."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.hardware.safety import MOST_CURRENT_AT_REST
from sma_bench.hardware.serial_messages import CHANNELS, Telemetry

SIDES = ("front", "back")  # of the device's boards, and of its range sensors
_PER_SIDE = CHANNELS // len(SIDES)
_REST_WEIGHT = 0.05  # of a new reading in the running mean at rest
_LEAST_DUTY = 1e-3  # below it a converter's step of mean current is amplified more than 30 times
# Two wires on one current sensor: regression of steps in power on steps in squared voltage.
_STEP_BASE = 0.05  # s between the two readings of a step: short against a phase change
_LEAST_STEP, _LEAST_NOISE = 0.5, 0.02  # V^2; W
_LEAST_PAIRS, _OVERLAP = 20, 5  # pairs of readings needed; that overlap and count as one
_MEMORY = 0.995  # weight of all earlier pairs at each new one
_INDEPENDENT = 0.1  # share of a wire's steps that must be independent of its neighbour's
_RIDGE = 1e-6
_OPEN, _SURELY = 0.5, 0.7  # of the expected conductance; the latter with 3 standard deviations
_FEWEST = 3  # points of a calibration that have a scatter
_DIGITS = 12  # decimals of a fit that are more than rounding errors
_BLOCK = 4096  # noise values drawn at once


class Calibration(NamedTuple):
    """value = gain * reading + offset; for a triangulation sensor, which has a shift (m), distance
    = 1/(gain * reading + offset) - shift, infinite out of range (REP-117)."""

    gain: float = 1.0
    offset: float = 0.0
    shift: float | None = None

    def apply(self, reading: float) -> float:
        value = self.gain * reading + self.offset
        if self.shift is None:
            return value
        return 1.0 / value - self.shift if value > 0.0 else math.inf


class CalibratedSensor(NamedTuple):
    """A sensor's units (of readings, of known loads), its quantity, its value in telemetry."""

    unit: str
    known_unit: str
    quantity: str
    reading: Callable[[Telemetry], float]

    @property
    def is_range(self) -> bool:
        return self.known_unit == "m"


SENSORS = {"supply": CalibratedSensor("V", "V", "voltage", lambda t: t.supply),
           "front_current": CalibratedSensor("A", "A", "current", lambda t: t.current[0]),
           "back_current": CalibratedSensor("A", "A", "current", lambda t: t.current[1]),
           "front_range": CalibratedSensor("V", "m", "deflection", lambda t: t.range_voltage[0]),
           "back_range": CalibratedSensor("V", "m", "deflection", lambda t: t.range_voltage[1])}


class ChannelPower(NamedTuple):
    """Direct voltage (V) and current (A) of the same heat; NaN: not measured. At duty d, supply U
    and mean current I they are sqrt(d) U and I/sqrt(d): their ratio is the resistance."""

    voltage: float
    current: float


class BenchReading(NamedTuple):
    """One window of telemetry in calibrated units; pairs are front and back."""

    time: float  # s of the host's monotonic clock, the middle of the window
    powers: tuple[ChannelPower, ...]  # in the order of bench.channels
    distances: tuple[float, float]  # m, infinite out of a sensor's range
    deflection: float  # m, positive toward the front; NaN when no sensor sees the tip
    board_currents: tuple[float, float] = (0.0, 0.0)  # A, mean through all wires of a board
    board_volts: tuple[float, float] = (0.0, 0.0)  # V, mean over time, summed over a board's wires


class BenchSensors:
    """Converts telemetry to readings, and volts to the device's millivolts."""

    def __init__(self, sides: Sequence[str], settings: Mapping[str, Any]) -> None:
        """`settings` are the bridge's `calibration.` and `range.` parameters. Raises InputError:
        more channels on a side than the device has there; an unknown range sensor."""
        free = {side: [k * _PER_SIDE + n for n in range(_PER_SIDE)] for k, side in enumerate(SIDES)}
        try:  # the device's channel of each bench channel: the next free output of its side
            self.channels = tuple(free[side].pop(0) for side in sides)
        except (KeyError, IndexError):
            raise InputError(f"bench.channel_sides: {', '.join(sides)}, the device has {_PER_SIDE} "
                             f"channels at the front and {_PER_SIDE} at the back") from None
        self._calibrations = {
            name: Calibration(*(settings[f"calibration.{name}.{number}"]
                                for number in Calibration._fields[: 3 if sensor.is_range else 2]))
            for name, sensor in SENSORS.items()}
        self.supply = self._calibrations["supply"]
        self._at_rest: tuple[float, ...] = (0.0,) * len(SIDES)
        self._standoffs = [settings[f"range.{side}_standoff"] for side in SIDES]
        for sensor in settings["range.sensors"]:
            if sensor not in SIDES:
                raise InputError(f"range.sensors: {sensor!r}, expected front or back")
        # The mounted ones; on a bench of one wire nothing bends.
        self.range_sensors: tuple[str, ...] = settings["range.sensors"] if len(sides) > 1 else ()
        # Groups of bench channels that share a current sensor.
        boards = [channel // _PER_SIDE for channel in self.channels]
        self.shared = tuple(tuple(k for k, board in enumerate(boards) if board == n)
                            for n in range(len(SIDES)) if boards.count(n) > 1)

    def _calibrated(self, quantity: str, telemetry: Telemetry) -> tuple[float, float]:
        front, back = (self._calibrations[name].apply(SENSORS[name].reading(telemetry))
                       for name in (f"front_{quantity}", f"back_{quantity}"))
        return front, back

    def board_currents(self, telemetry: Telemetry) -> tuple[float, float]:
        """A, mean through the front and the back board."""
        return self._calibrated("current", telemetry)

    def rest(self, telemetry: Telemetry) -> None:
        """Update the current sensors' zero from a window in which nothing is driven."""
        self._at_rest = tuple(
            rest + _REST_WEIGHT * (ampere - rest)
            for rest, ampere in zip(self._at_rest, self.board_currents(telemetry), strict=True))

    def reading(self, telemetry: Telemetry) -> BenchReading:
        """The reading of a window. A board's current is split over its wires by their duties."""
        duties = telemetry.duty
        supply, currents = self.supply.apply(telemetry.supply), self.board_currents(telemetry)
        zeroed = [ampere - rest if abs(rest) < MOST_CURRENT_AT_REST else ampere
                  for ampere, rest in zip(currents, self._at_rest, strict=True)]
        totals = sum(duties[:_PER_SIDE]), sum(duties[_PER_SIDE:])
        powers = []
        for channel in self.channels:
            duty, board, current = duties[channel], channel // _PER_SIDE, math.nan
            if duty == 0.0:  # the board's current counts as its neighbour's if that is driven
                current = 0.0 if totals[board] > 0.0 else zeroed[board]
            elif duty >= _LEAST_DUTY:
                current = zeroed[board] * duty / totals[board] / math.sqrt(duty)
            drop = self.supply.gain * telemetry.drop[board]  # of the supply during a board's pulse
            powers.append(ChannelPower(math.sqrt(duty) * (supply - drop), current))
        # Mean over the mounted sensors in range; bending to the front shortens its distance.
        near, far = self._calibrated("range", telemetry)
        towards = {"front": self._standoffs[0] - near, "back": far - self._standoffs[1]}
        seen = [towards[sensor] for sensor in self.range_sensors if math.isfinite(towards[sensor])]
        return BenchReading(telemetry.time, tuple(powers), (near, far),
                            sum(seen) / len(seen) if seen else math.nan,
                            currents, (supply * totals[0], supply * totals[1]))

    def millivolts(self, voltage: Sequence[float], supply_reading: float) -> list[int]:
        """Command (mV) for `voltage` V at the wires; other outputs stay off. It compensates that
        the device computes duties from its uncalibrated `supply_reading` (V)."""
        true = self.supply.apply(supply_reading)
        scale = supply_reading / true if supply_reading > 0.0 and true > 0.0 else 1.0
        volts = dict(zip(self.channels, voltage, strict=True))
        return [round(1e3 * volts.get(channel, 0.0) * scale) for channel in range(CHANNELS)]


class SharedWatch:
    """Finds an open wire of two that share a current sensor. Split by duty, their currents hide it;
    but the board's power is sum(V^2/R), so steps of the voltages show each wire's conductance."""

    def __init__(self, channels: Sequence[str]) -> None:
        self._channels = channels
        self._recent: deque[tuple[float, float, tuple[float, ...]]] = deque()
        self._before: tuple[float, ...] = ()
        # Sums of products of steps (V^2 of each wire, then the power), fading with age.
        self._sums = np.zeros((len(channels) + 1, len(channels) + 1))
        self._pairs, self._reason = 0.0, ""

    def power(self, volts: Sequence[float], amperes: Sequence[float], stamp: float,
              circuit: float) -> str:
        """Report of an open wire after readings at `stamp` s, or ""; `circuit`: ohm of each."""
        heat = tuple(volt**2 for volt in volts)
        before, self._before = self._before, heat
        if self._recent and stamp < self._recent[-1][0]:
            self._recent.clear()
        # Skip the window in which a step falls: its voltages are final, its currents a mean.
        near = len(heat) == len(before) and all(abs(now - then) < 0.01 * max(now, _LEAST_STEP)
                                                for now, then in zip(heat, before, strict=True))
        if heat != before and not near:
            return self._reason
        power = sum(v * i for v, i in zip(volts, amperes, strict=True) if not math.isnan(v * i))
        self._recent.append((stamp, power, heat))
        while stamp - self._recent[0][0] > _STEP_BASE:
            _, old_power, old_heat = self._recent.popleft()
            step = np.subtract((*heat, power), (*old_heat, old_power))
            if np.abs(step[:-1]).max() >= _LEAST_STEP:
                self._sums = _MEMORY * self._sums + np.outer(step, step)
                self._pairs = _MEMORY * self._pairs + 1.0
                self._reason = self._open(circuit)
        return self._reason

    def _open(self, circuit: float) -> str:
        """Least squares of the wires' conductances; reports one that is surely too low, or ""."""
        if self._pairs < _LEAST_PAIRS:
            return ""
        squares, products = self._sums[:-1, :-1], self._sums[:-1, -1]
        excited = np.diag(squares)
        # If all steps were alike no wire is identifiable; the ridge keeps the inverse finite.
        ridge = _RIDGE * float(excited.max())
        inverse = np.linalg.inv(squares + ridge * np.eye(len(excited)))
        conductance = inverse @ products
        residual = max(float(self._sums[-1, -1] - conductance @ products), 0.0)
        noise = max(residual / self._pairs, _LEAST_NOISE**2) * _OVERLAP
        for k, channel in enumerate(self._channels):
            share = conductance[k] * circuit
            std = math.sqrt(noise * inverse[k, k]) * circuit
            identifiable = 1.0 / inverse[k, k] - ridge > _INDEPENDENT * excited[k] > ridge
            if identifiable and share < _OPEN and share + 3.0 * std < _SURELY:
                return (f"open: {channel} takes {max(share, 0.0):.0%} of its current by the steps "
                        f"of its voltage (it shares a sensor with {self._channels[1 - k]})")
        return ""


# --- Calibration of a sensor: gain and offset from known loads, with their standard errors.
# Readings are the device's own (V, A), known loads reference values (V, A, m).


class SensorFit(NamedTuple):
    """The bridge's parameters of a sensor, and how well they fit the known loads."""

    parameters: dict[str, float]
    std: dict[str, float]  # standard errors from the scatter, NaN with two points
    rest: float  # rms residual, in the unit of the known loads
    uncertainty: dict[str, float]  # of readings, as `sensor.` parameters; empty with two points


def fit_sensor(name: str, readings: Sequence[float], known: Sequence[float],
               shift: float = 0.0) -> SensorFit:
    """Fit a sensor of SENSORS to readings (n,) of known loads (n,). `shift`: m, depth of a range
    sensor's lens behind its face. Raises InputError: the loads give no gain."""
    kind, std = SENSORS[name], dict[str, float]()
    x, y = np.asarray(readings, dtype=float), np.asarray(known, dtype=float)
    if x.shape != y.shape:
        raise InputError(
            f"calibration: {x.size} readings for {y.size} known loads, expected as many")
    if kind.is_range and not (y + shift > 0.0).all():
        raise InputError(f"calibration: distance {y.min():g} m with shift {shift:g} m, expected "
                         "positive")
    gain, offset, *stds, scatter = _line(x, 1.0 / (y + shift) if kind.is_range else y)
    calibration = Calibration(gain, offset, shift if kind.is_range else None)
    calibrated, found = np.array([calibration.apply(one) for one in x]), calibration._asdict()
    if kind.is_range:
        (gain, *_, scatter), digit = _line(calibrated, y), 0.0
    else:
        del found["shift"]
        std, digit = dict(zip(found, stds, strict=True)), _last_digit(readings)
    uncertainty = {}  # of a calibrated reading: the scatter, at least the rounding of the digits
    if len(x) >= _FEWEST and math.isfinite(scatter):
        digits = math.hypot(gain * digit, _last_digit(known)) / math.sqrt(12.0)
        if scatter := max(scatter, digits):
            spread = math.sqrt(float(((y - y.mean()) ** 2).sum()))
            uncertainty[f"sensor.{kind.quantity}.gain"] = scatter / spread
            if not kind.is_range:  # deflection is measured from the tip at rest, without offset
                offset_of = scatter * math.hypot(len(x) ** -0.5, y.mean() / spread)
                uncertainty[f"sensor.{kind.quantity}.offset"] = offset_of
    named, named_std = ({f"calibration.{name}.{key}": value for key, value in numbers.items()}
                        for numbers in (found, std))
    rest = round(math.sqrt(float(np.mean((calibrated - y) ** 2))), _DIGITS)
    return SensorFit(named, named_std, rest, uncertainty)


def _line(x: Array, y: Array) -> tuple[float, float, float, float, float]:
    """Least-squares gain and offset, their standard errors, the scatter (NaN with two points)."""
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("calibration: a reading or a load is not finite")
    if (different := np.unique(x).size) < 2:
        raise InputError(f"calibration: {different} different readings, expected at least 2")
    centre, spread = x.mean(), float(((x - x.mean()) ** 2).sum())
    gain = float(((x - centre) * y).sum() / spread)
    if gain == 0.0:
        raise InputError("calibration: the readings do not follow the known loads (gain 0)")
    offset, freedom = round(float(y.mean() - gain * centre), _DIGITS), len(x) - 2
    squares = float(((y - gain * x - offset) ** 2).sum())
    scatter = round(math.sqrt(squares / freedom), _DIGITS) if freedom else math.nan
    gain_std = scatter / math.sqrt(spread)
    return gain, offset, gain_std, scatter * math.sqrt(1 / len(x) + centre**2 / spread), scatter


def _last_digit(values: Sequence[float]) -> float:
    """Place value of the last decimal that any of the values has; 0 if all are integers."""
    places = [-int(Decimal(repr(float(value))).normalize().as_tuple().exponent) for value in values]
    return 10.0 ** -max(places) if max(places, default=0) > 0 else 0.0


class Instrument:
    """A simulated sensor (voltage, current, temperature, range, force): adds noise to a true value
    and rounds it to the resolution, by the simulator's parameters."""

    def __init__(self, settings: Mapping[str, Any], quantity: str,
                 seed: np.random.SeedSequence) -> None:
        self._noise = settings[f"sensor.{quantity}_noise"]
        self._resolution = settings.get(f"sensor.{quantity}_resolution", 0.0)
        self._random, self._drawn = np.random.default_rng(seed), np.empty(0)

    def read(self, value: float) -> float:
        return float(self.read_all(np.array([value]))[0])

    def read_all(self, values: Array) -> Array:
        """Readings of true values (n,), bit for bit as by repeated `read`."""
        if self._noise > 0.0:
            while len(self._drawn) < len(values):  # values are taken from the end
                block = self._noise * self._random.standard_normal(_BLOCK)
                self._drawn = np.concatenate([block, self._drawn])
            left = len(self._drawn) - len(values)
            values = values + self._drawn[left:][::-1]
            self._drawn = self._drawn[:left]
        if self._resolution > 0.0:
            values = np.rint(values / self._resolution) * self._resolution + 0.0  # no -0.0
        return values
