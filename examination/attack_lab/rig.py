"""A wire on a bench and its sensors, with faults: the heat equation stepped here, nothing of
`sma_bench.physics`."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from examination.attack_lab.instruments import ZERO, relaxed
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal

STEPS_PER_TAU = 30.0


@dataclass(frozen=True)
class Wire:
    resistance: float = 2.7
    loss: float = 403.0  # W/(m2 K)
    specific_heat: float = 343.0
    mass: float = 0.091e-3
    area: float = 395.84e-6
    room: float = 297.0
    room_drift: float = 0.0  # K over the record
    lead: float = 0.0  # ohm outside the voltmeter's taps on the wire
    loss_growth: float = 0.0  # of h, 1/K
    wind: tuple[float, float] = (math.inf, 0.0)  # from this time on h is larger by this share
    sheath: tuple[float, float] = (0.0, 1.0)  # J/K that follow through so many W/K
    latent: float = 0.0  # J/kg, taken up around `change`
    hot_resistance: float = 0.0  # of R, added around `change`
    change: tuple[float, float] = (335.0, 350.0)  # K

    @property
    def tau(self) -> float:
        return self.mass * self.specific_heat / (self.loss * self.area)

    def run(self, voltage: Callable[[np.ndarray], np.ndarray], duration: float):
        """Times, volts, amperes, kelvin, kelvin of the room, on a fine grid."""
        step = self.tau / STEPS_PER_TAU
        time = np.arange(0.0, duration + step, step)
        volts = voltage(time)
        room = self.room + self.room_drift * (time / duration - 0.5)
        kelvin, amperes = np.empty_like(time), np.empty_like(time)
        hot, around = room[0], room[0]
        capacity, mantle, link = self.mass * self.specific_heat, *self.sheath
        rise = self.change[1] - self.change[0]
        for k, (t, v, air) in enumerate(zip(*np.stack([time, volts, room]).tolist(), strict=True)):
            ohm, held = self.resistance, capacity
            if self.latent or self.hot_resistance:
                x = min(max((hot - self.change[0]) / rise, 0.0), 1.0)
                ohm *= 1.0 + self.hot_resistance * (0.5 - 0.5 * math.cos(math.pi * x))
                if 0.0 < x < 1.0:
                    slope = 0.5 * math.pi * math.sin(math.pi * x) / rise
                    held += self.mass * self.latent * slope
            current = v / (ohm + self.lead)
            h = self.loss * (1.0 + self.loss_growth * (hot - air))
            if t > self.wind[0]:
                h *= 1.0 + self.wind[1]
            kelvin[k], amperes[k] = hot, current
            conductance = h * self.area
            gained = current * current * ohm + conductance * air
            if mantle:
                gained += link * around
                conductance += link
                around += step / mantle * link * (hot - around)
            steady = gained / conductance
            hot = steady + (hot - steady) * math.exp(-step * conductance / held)
        return time, volts, amperes, kelvin, room


@dataclass(frozen=True)
class Reading:
    noise: float
    step: float
    gain: float = 1.0
    offset: float = 0.0
    top: float = math.inf

    def of(self, values, random):
        noisy = self.gain * values + self.offset + self.noise * random.standard_normal(len(values))
        return np.round(np.minimum(noisy, self.top) / self.step) * self.step


@dataclass(frozen=True)
class Sensors:
    rate: float = 50.0  # Hz, volts and amperes
    camera_rate: float = 50.0
    volts: Reading = Reading(0.004, 10.0 / 1023.0)
    amperes: Reading = Reading(0.015, 0.026)
    camera: Reading = Reading(0.08, 0.1)  # of degrees Celsius
    emissivity: float = 1.0  # of the excess over the room
    camera_lag: float = 0.0
    camera_late: float = 0.0
    drift: float = 0.0  # K over the record
    thermometer: bool = False


def read(wire: Wire, sensors: Sensors, voltage, duration: float, random) -> Record:
    """One bag, in memory: 3 % of the samples are lost."""
    time, volts, amperes, kelvin, room = wire.run(voltage, duration)
    clocks = []
    for rate in (sensors.rate, sensors.camera_rate):
        stamps = np.arange(0.5 / rate, duration, 1.0 / rate)
        stamps = stamps + random.uniform(-0.2, 0.2, len(stamps)) / rate
        clocks.append(stamps[random.random(len(stamps)) >= 0.03])
    power, camera = clocks
    after = np.clip(np.searchsorted(time, power, side="right") - 1, 0, None)
    v, i = sensors.volts.of(volts[after], random), sensors.amperes.of(amperes[after], random)
    if sensors.camera_lag:
        kelvin = relaxed(kelvin, 1.0 - math.exp(-(time[1] - time[0]) / sensors.camera_lag))
    t, air = np.interp(camera, time, kelvin), np.interp(camera, time, room)
    t = air + sensors.emissivity * (t - air) + sensors.drift * camera / duration
    t = ZERO + sensors.camera.of(t - ZERO, random)
    signals = [Signal("wire.voltage", "V", power, v), Signal("wire.current", "A", power, i),
               Signal("wire.temperature", "K", camera + sensors.camera_late, t)]  # fmt: skip
    if sensors.thermometer:
        stamps = np.arange(0.0, duration, 1.0)
        shown = np.interp(stamps, time, room) + 0.05 * random.standard_normal(len(stamps))
        signals.append(Signal("ambient.temperature", "K", stamps, shown))
    return Record(Path("attacked"), 0, {s.name: s for s in signals})


@dataclass(frozen=True)
class Bench:
    wire: Wire
    sensors: Sensors
    top: float  # V, of the staircase
    levels: int
    dwell: float  # s
    ramp_top: float
    rise: float
    rest: float
    known: Mapping[str, float] = field(default_factory=dict)
    unsure: Mapping[str, float] = field(default_factory=dict)

    def staircase(self, random, wire: Wire | None = None) -> Record:
        up = np.linspace(0.0, self.top, self.levels)
        steps = np.concatenate([up, up[-2::-1]])

        def voltage(time):
            return steps[np.clip((time / self.dwell).astype(int), 0, len(steps) - 1)]

        return read(wire or self.wire, self.sensors, voltage, self.dwell * len(steps), random)

    def ramps(self, random, wire: Wire | None = None) -> Record:
        period = self.rise + self.rest

        def voltage(time):
            local = np.mod(time - 4.0, period)
            inside = (time >= 4.0) & (local < self.rise)
            return np.where(inside, self.ramp_top * local / self.rise, 0.0)

        return read(wire or self.wire, self.sensors, voltage, 4.0 + 3 * period, random)

    @property
    def warming(self) -> float:
        """K, at the top of the staircase."""
        return self.top**2 / (self.wire.resistance * self.wire.loss * self.wire.area)

    def parameters(self) -> Parameters:
        return Parameters.of_paper().replace(dict(self.known), dict(self.unsure))

    def truth(self) -> dict[str, float]:
        return {"wire.resistance": self.wire.resistance,
                "wire.heat_transfer_coefficient": self.wire.loss,
                "wire.specific_heat": self.wire.specific_heat,
                "environment.ambient_temperature": self.wire.room}  # fmt: skip

    def but(self, wire: Mapping[str, Any], sensors: Mapping[str, Any], **own: Any) -> "Bench":
        """The same with some numbers changed; a mapping changes some of a reading."""
        of = {
            name: replace(getattr(self.sensors, name), **value)
            if isinstance(value, dict)
            else value
            for name, value in sensors.items()
        }
        wires = replace(self.wire, **wire)
        return replace(self, wire=wires, sensors=replace(self.sensors, **of), **own)


def paper_bench(random) -> Bench:
    """A wire near Table I, whose lab has stated nothing of it but what it is made of."""
    near = 1.0 + 0.02 * random.standard_normal(3)
    wire = Wire(2.7 * near[0], 403.0 * near[1], 343.0 * near[2], room=random.uniform(293.0, 300.0))
    known = {"wire.mass": wire.mass, "wire.surface_area": wire.area}
    return Bench(wire, Sensors(), 6.0, 17, 8.0, 2.6, 7.0, 8.0, known)


def bare_bench(random) -> Bench:
    """A bare wire in still air as physics has it, whose lab knows it roughly."""
    length, diameter = 0.2, 0.3e-3
    heat = random.uniform(2.4, 3.0), random.uniform(65.0, 85.0), random.uniform(430.0, 500.0)
    mass, area = 6450.0 * 0.25 * math.pi * diameter**2 * length, math.pi * diameter * length
    wire = Wire(*heat, mass, area, random.uniform(293.0, 300.0))
    known = {"wire.mass": wire.mass, "wire.surface_area": wire.area, "wire.diameter": diameter}
    known |= {"wire.length": length, "wire.resistance": 2.7, "wire.specific_heat": 465.0}
    unsure = {"wire.resistance": 0.3, "wire.heat_transfer_coefficient": 15.0}
    known["wire.heat_transfer_coefficient"], unsure["wire.specific_heat"] = 75.0, 60.0
    return Bench(wire, Sensors(25.0, 25.0), 1.6, 11, 30.0, 1.1, 10.0, 15.0, known, unsure)
