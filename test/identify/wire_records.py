"""Records of a wire rig, made without the package's own heat model."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from sma_bench.records import Record, Signal

ADC_STEP, CURRENT_STEP, CAMERA_STEP = 10.0 / 1023.0, 0.026, 0.1  # V, A, K
SUPPLY_NOISE, CURRENT_NOISE, CAMERA_NOISE = 0.004, 0.015, 0.08


@dataclass(frozen=True)
class Wire:
    """True parameters of a synthetic wire."""

    resistance: float = 2.75
    coefficient: float = 410.0
    specific_heat: float = 350.0
    mass: float = 0.091e-3
    area: float = 395.84e-6
    ambient: float = 297.3
    bend: float = 0.0  # 1/K, relative rise of h with the temperature
    resistance_change: float = 0.0  # ohm, added at temperatures from around 340 K on

    @property
    def tau(self) -> float:
        return self.mass * self.specific_heat / (self.coefficient * self.area)

    def resistance_at(self, kelvin):
        share = 1.0 / (1.0 + np.exp(-(kelvin - 340.0) / 4.0))
        return self.resistance + self.resistance_change * share

    def steady(self, voltage):
        """Temperature [K] at which heating and loss balance."""
        rise = np.linspace(0.0, 400.0, 40001)
        loss = self.coefficient * (1.0 + self.bend * rise) * self.area * rise
        squares = loss * self.resistance_at(self.ambient + rise)
        return self.ambient + np.interp(voltage**2, squares, rise)


@dataclass(frozen=True)
class Sensors:
    """The sensors that read it."""

    power_rate: float = 20.0  # Hz
    temperature_rate: float = 20.0  # Hz
    offset: float = 0.0  # A, of the current
    delay: float = 0.0  # s, of the temperature's stamps
    scale_error: float = 0.0  # of the voltage, relative


def clock(rng, duration, rate):
    """Jittered timestamps in s, some of them lost."""
    stamps = np.arange(0.0, duration, 1.0 / rate)
    stamps = np.sort(stamps + rng.normal(0.0, 0.1 / rate, len(stamps)))
    return np.unique(stamps[(rng.random(len(stamps)) > 0.05) & (stamps >= 0.0)])


def record_of(wire, sensors, seed, voltage, duration, step, lag=0.0, cooling=None, markers=()):
    """Readings under a voltage (function of s): first-order response towards the steady temperature
    in steps of `step` s, a camera that lags by `lag` s. `cooling`: (s, ohm), from then on another
    resistance."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration + 1.0, step)

    def lagged(values, tau):
        keep = np.exp(-step / tau)
        return wire.ambient + lfilter([0.0, 1.0 - keep], [1.0, -keep], values - wire.ambient)

    true = lagged(wire.steady(voltage(time + 0.5 * step)), wire.tau)
    seen = lagged(true, lag) if lag else true

    t = clock(rng, duration, sensors.power_rate)
    v = (voltage(t) + rng.normal(0.0, SUPPLY_NOISE, len(t))) * (1.0 + sensors.scale_error)
    ohm = wire.resistance_at(np.interp(t, time, true))
    if cooling:
        ohm = np.where(t >= cooling[0], cooling[1], ohm)
    i = voltage(t) / ohm + sensors.offset + rng.normal(0.0, CURRENT_NOISE, len(t))
    s = clock(rng, duration, sensors.temperature_rate)
    kelvin = np.interp(s, time, seen) + rng.normal(0.0, CAMERA_NOISE, len(s))

    v = np.clip(np.round(v / ADC_STEP), 0, 1023) * ADC_STEP
    i = np.round(i / CURRENT_STEP) * CURRENT_STEP
    kelvin = np.round((kelvin - 273.15) / CAMERA_STEP) * CAMERA_STEP + 273.15
    signals = (Signal("wire.voltage", "V", t, v), Signal("wire.current", "A", t, i),
               Signal("wire.temperature", "K", s + sensors.delay, kelvin))  # fmt: skip
    return Record(Path("synthetic"), 0, {one.name: one for one in signals}, tuple(markers))


def only(record, *endings):
    """The record with only the signals that end in these."""
    kept = {n: s for n, s in record.signals.items() if n.endswith(endings)}
    return replace(record, signals=kept)


def changed(record, **changes):
    """The record with the values of some quantities of the wire changed by functions."""
    signals = dict(record.signals)
    for quantity, change in changes.items():
        own = signals[f"wire.{quantity}"]
        signals[own.name] = replace(own, values=change(own.values))
    return replace(record, signals=signals)


def staircase(wire=Wire(), sensors=Sensors(), seed=0, dwell=30.0, top=6.25, increment=0.25, **more):
    """Voltage up and down in steps."""
    up = np.arange(0.0, top + 1e-9, increment)
    levels = np.concatenate([up, up[-2::-1]])

    def voltage(t):
        return levels[np.clip((t / dwell).astype(int), 0, len(levels) - 1)]

    return record_of(wire, sensors, seed, voltage, dwell * len(levels), 5e-3, **more)


def ramp(wire=Wire(), sensors=Sensors(100.0, 80.0), seed=0, top=2.7, rest=12.0, repeat=4, **more):
    """0 V for `lead` s, a ramp of 7 s, 0 V, repeated."""
    lead = more.pop("lead", 4.0)

    def voltage(t):
        since = np.where(t < lead, -1.0, np.mod(t - lead, 7.0 + rest))
        return np.where((since >= 0.0) & (since < 7.0), top / 7.0 * since, 0.0)

    return record_of(wire, sensors, seed, voltage, lead + repeat * (7.0 + rest), 1e-3, **more)
