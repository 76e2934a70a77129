"""Records of a wire rig from closed forms: nothing here uses the package's own heat response."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sma_bench.records import Record, Signal
from sma_bench.records.isobaric import IsobaricRecord, read_isobaric

ADC_STEP = 10.0 / 1023.0
CURRENT_STEP = 0.026
CURRENT_NOISE = 0.015
SUPPLY_NOISE = 0.004
CAMERA_NOISE = 0.08
CAMERA_STEP = 0.1


@dataclass(frozen=True)
class Wire:
    """Truth of a synthetic wire.

    `bend` 1/K makes h rise with temperature, `resistance_change` ohm comes on around `change_at` K.
    """

    resistance: float = 2.75
    coefficient: float = 410.0
    specific_heat: float = 350.0
    mass: float = 0.091e-3
    area: float = 395.84e-6
    ambient: float = 297.3
    bend: float = 0.0
    resistance_change: float = 0.0
    change_at: float = 340.0

    @property
    def tau(self) -> float:
        return self.mass * self.specific_heat / (self.coefficient * self.area)

    @property
    def gain(self) -> float:
        return 1.0 / (self.resistance * self.coefficient * self.area)

    def resistance_at(self, temperature):
        share = 1.0 / (1.0 + np.exp(-(temperature - self.change_at) / 4.0))
        return self.resistance + self.resistance_change * share

    def steady(self, voltage: float) -> float:
        """Steady temperature by bisection, since R and h may depend on it."""
        low, high = self.ambient, self.ambient + 1000.0
        for _ in range(80):
            middle = 0.5 * (low + high)
            rise = middle - self.ambient
            loss = self.coefficient * (1.0 + self.bend * rise) * self.area * rise
            if voltage**2 / self.resistance_at(middle) > loss:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)


@dataclass(frozen=True)
class Sensors:
    """Rates in Hz, offset of the current sensor in A, delay of temperature stamps in s."""

    power_rate: float = 20.0
    temperature_rate: float = 20.0
    offset: float = 0.0
    delay: float = 0.0
    scale_error: float = 0.0  # relative gain error of the voltage converter


NITI = Wire()
SLOW = Sensors()
FAST = Sensors(power_rate=100.0, temperature_rate=80.0)


def clock(rng, duration, rate):
    """Jittered stamps in s of which some are lost."""
    stamps = np.arange(0.0, duration, 1.0 / rate)
    stamps = np.sort(stamps + rng.normal(0.0, 0.1 / rate, len(stamps)))
    stamps = stamps[(rng.random(len(stamps)) > 0.05) & (stamps >= 0.0)]
    return np.unique(stamps)


def make_record(rng, duration, voltage_at, current_at, temperature_at, sensors, markers=()):
    t = clock(rng, duration, sensors.power_rate)
    v = voltage_at(t) + rng.normal(0.0, SUPPLY_NOISE, len(t))
    v = v * (1.0 + sensors.scale_error)
    i = current_at(t) + sensors.offset + rng.normal(0.0, CURRENT_NOISE, len(t))
    s = clock(rng, duration, sensors.temperature_rate)
    temperature = temperature_at(s) + rng.normal(0.0, CAMERA_NOISE, len(s))
    v = np.clip(np.round(v / ADC_STEP), 0, 1023) * ADC_STEP
    i = np.round(i / CURRENT_STEP) * CURRENT_STEP
    temperature = np.round((temperature - 273.15) / CAMERA_STEP) * CAMERA_STEP + 273.15
    signals = {
        "wire.voltage": Signal("wire.voltage", "V", t, v),
        "wire.current": Signal("wire.current", "A", t, i),
        "wire.temperature": Signal("wire.temperature", "K", s + sensors.delay, temperature),
    }
    return Record(Path("synthetic"), 0, signals, tuple(markers))


def staircase_record(
    wire=NITI, sensors=SLOW, seed=0, dwell=30.0, top=6.25, increment=0.25, markers=(),
    cooling_resistance=None,
):
    """Voltage up and down in steps; each temperature an exponential towards its steady value."""
    rng = np.random.default_rng(seed)
    up = np.arange(0.0, top + 1e-9, increment)
    levels = np.concatenate([up, up[-2::-1]])
    steady = np.array([wire.steady(v) for v in levels])
    begin = np.empty(len(levels))
    begin[0] = steady[0]
    for k in range(1, len(levels)):
        begin[k] = steady[k - 1] + (begin[k - 1] - steady[k - 1]) * np.exp(-dwell / wire.tau)

    def index(t):
        return np.clip((t / dwell).astype(int), 0, len(levels) - 1)

    def temperature(t):
        k = index(t)
        return steady[k] + (begin[k] - steady[k]) * np.exp(-(t - k * dwell) / wire.tau)

    def current(t):
        k = index(t)
        resistance = wire.resistance_at(temperature(t))
        if cooling_resistance is not None:
            resistance = np.where(k >= len(up), cooling_resistance, resistance)
        return levels[k] / resistance

    return make_record(
        rng, dwell * len(levels), lambda t: levels[index(t)], current, temperature, sensors,
        markers,
    )


def ramp_record(
    wire=NITI, sensors=FAST, seed=0, top=2.7, rise=7.0, rest=12.0, repeat=4,
    lead=4.0, markers=(), lag=0.0,
):
    """0 V, a ramp, 0 V, repeated; x = g s^2 (t^2 - 2 tau t + 2 tau^2 (1 - e^(-t/tau))) on it."""
    rng = np.random.default_rng(seed)
    period, tau, slope = rise + rest, wire.tau, top / rise

    def first_order(t, tau):
        inside = np.clip(t, 0.0, rise)
        ramp = wire.gain * slope**2 * (
            inside**2 - 2.0 * tau * inside + 2.0 * tau**2 * (1.0 - np.exp(-inside / tau))
        )
        return ramp * np.exp(-np.maximum(t - rise, 0.0) / tau)

    def rise_at(t):
        """The wire's own lag, and the camera's behind it (partial fractions)."""
        if not lag:
            return first_order(t, tau)
        return (tau * first_order(t, tau) - lag * first_order(t, lag)) / (tau - lag)

    def local(t):
        return np.where(t < lead, -1.0, np.mod(t - lead, period))

    def voltage(t):
        u = local(t)
        return np.where((u >= 0.0) & (u < rise), slope * u, 0.0)

    def temperature(t):
        return wire.ambient + rise_at(np.maximum(local(t), 0.0))

    return make_record(
        rng, lead + repeat * period, voltage, lambda t: voltage(t) / wire.resistance,
        temperature, sensors, markers,
    )


@pytest.fixture
def wire() -> type[Wire]:
    return Wire


@pytest.fixture
def sensors() -> type[Sensors]:
    return Sensors


@pytest.fixture
def staircase() -> Callable[..., Record]:
    return staircase_record


@pytest.fixture
def ramp() -> Callable[..., Record]:
    return ramp_record


@pytest.fixture
def alloy(measured_data: Path) -> Callable[[int], list[IsobaricRecord]]:
    """Measured loops of an alloy, by its number."""
    folder = measured_data / "sma_react" / "input"
    return lambda number: [
        read_isobaric(path) for path in sorted((folder / f"cal_sample_{number}").glob("*MPa.txt"))
    ]
