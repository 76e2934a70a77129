"""Faults in a lab's records, one attack per row; and a wire on a bench with sensors, by a heat
equation solved here, without `sma_bench.physics`."""

import math
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from examination.attack_lab import instruments
from examination.attack_lab.instruments import FAULTS, LOADS, ZERO, Alloy, named
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal


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
    wind: tuple[float, float] = (math.inf, 0.0)  # time, after which h is larger by this share
    latent: float = 0.0  # J/kg, absorbed within `change`
    hot_resistance: float = 0.0  # share of R, added within `change`
    change: tuple[float, float] = (335.0, 350.0)  # K

    @property
    def tau(self) -> float:
        return self.mass * self.specific_heat / (self.loss * self.area)

    def run(self, voltage: Callable[[np.ndarray], np.ndarray], duration: float):
        """Times, volts, amperes, temperature and room temperature in K, on a fine grid."""
        step = self.tau / 30.0
        time = np.arange(0.0, duration + step, step)
        volts, room = voltage(time), self.room + self.room_drift * (time / duration - 0.5)
        kelvin, amperes = np.empty_like(time), np.empty_like(time)
        hot, capacity = room[0], self.mass * self.specific_heat
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
            steady = (current * current * ohm + conductance * air) / conductance
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
    emissivity: float = 1.0  # factor of the temperature above the room
    camera_lag: float = 0.0
    camera_late: float = 0.0
    drift: float = 0.0  # K over the record


def read(wire: Wire, sensors: Sensors, voltage, duration: float, random) -> Record:
    """One record, in memory; 3 % of the samples are lost."""
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
        share = 1.0 - math.exp(-(time[1] - time[0]) / sensors.camera_lag)
        kelvin = instruments.relaxed(kelvin, share)
    t, air = np.interp(camera, time, kelvin), np.interp(camera, time, room)
    t = air + sensors.emissivity * (t - air) + sensors.drift * camera / duration
    t = ZERO + sensors.camera.of(t - ZERO, random)
    signals = [Signal("wire.voltage", "V", power, v), Signal("wire.current", "A", power, i),
               Signal("wire.temperature", "K", camera + sensors.camera_late, t)]  # fmt: skip
    return Record(Path("attacked"), 0, {s.name: s for s in signals})


@dataclass(frozen=True)
class Bench:
    """A wire and its sensors, how it is driven, and what its lab knows (`unsure`: how well)."""

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
        """Temperature rise in K at the top of the staircase."""
        return self.top**2 / (self.wire.resistance * self.wire.loss * self.wire.area)

    def but(self, wire: Mapping[str, Any] = {}, sensors: Mapping[str, Any] = {},  # noqa: B006
            known: Mapping[str, float] = {}, **own: Any) -> "Bench":  # noqa: B006
        """A copy with some numbers changed; a mapping changes some fields of a reading."""
        of = {name: replace(getattr(self.sensors, name), **x) if isinstance(x, dict) else x
              for name, x in sensors.items()}
        return replace(self, wire=replace(self.wire, **wire), sensors=replace(self.sensors, **of),
                       known={**self.known, **known}, **own)


def paper_bench(random) -> Bench:
    """A wire near Table I, of which the lab states only what it is made of."""
    near = 1.0 + 0.02 * random.standard_normal(3)
    wire = Wire(2.7 * near[0], 403.0 * near[1], 343.0 * near[2], room=random.uniform(293.0, 300.0))
    known = {"wire.mass": wire.mass, "wire.surface_area": wire.area}
    return Bench(wire, Sensors(), 6.0, 17, 8.0, 2.6, 7.0, 8.0, known)


def bare_bench(random) -> Bench:
    """A bare wire with realistic heat loss in still air, roughly known to its lab."""
    length, diameter = 0.2, 0.3e-3
    heat = random.uniform(2.4, 3.0), random.uniform(65.0, 85.0), random.uniform(430.0, 500.0)
    mass, area = 6450.0 * 0.25 * math.pi * diameter**2 * length, math.pi * diameter * length
    wire = Wire(*heat, mass, area, random.uniform(293.0, 300.0))
    known = {"wire.mass": wire.mass, "wire.surface_area": wire.area, "wire.diameter": diameter}
    known |= {"wire.length": length, "wire.resistance": 2.7, "wire.specific_heat": 465.0}
    unsure = {"wire.resistance": 0.3, "wire.heat_transfer_coefficient": 15.0}
    known["wire.heat_transfer_coefficient"], unsure["wire.specific_heat"] = 75.0, 60.0
    return Bench(wire, Sensors(25.0, 25.0), 1.6, 11, 30.0, 1.1, 10.0, 15.0, known, unsure)


PHASES, TEMPERATURES = ("martensite", "austenite"), ("a_s", "a_f", "m_s", "m_f")
OF_LOADS = (*TEMPERATURES, "c_a", "c_m", "eps_l")
Case = namedtuple("Case", "records parameters truth experiments", defaults=(None,))
Attack = namedtuple("Attack", "experiment name make")  # `make` takes a generator and the seed


# --- E1 to E3: a staircase and ramps of one wire, alternately near Table I and bare in air.
Records = Sequence[Record]


def _both(bench: Bench, random) -> Records:
    return bench.staircase(random), bench.ramps(random)


def clean_bag(random, seed: int, change: Callable[[Bench], Bench] = lambda b: b,
              records: Callable[[Bench, Any], Records] = _both) -> Case:
    """`change` alters the bench, `records` the way it is recorded."""
    bench = change(paper_bench(random) if seed % 2 == 0 else bare_bench(random))
    wire = bench.wire
    truth = {"wire.resistance": wire.resistance, "wire.heat_transfer_coefficient": wire.loss,
             "wire.specific_heat": wire.specific_heat, "environment.ambient_temperature": wire.room}
    parameters = Parameters.of_paper().replace(dict(bench.known), dict(bench.unsure))
    return Case(records(bench, random), parameters, truth)


def _other(b: Bench) -> Wire:
    ohm, loss, heat = 1.12 * b.wire.resistance, 0.8 * b.wire.loss, 1.1 * b.wire.specific_heat
    return replace(b.wire, resistance=ohm, loss=loss, specific_heat=heat)


def _windy(b: Bench) -> Wire:
    return replace(b.wire, loss=1.2 * b.wire.loss)


# Attacks that change the bench, and attacks that change its records.
BENCHES: dict[str, Callable[[Bench], Bench]] = {
    "air flow +20 % half-way": lambda b: b.but({"wind": (b.dwell * (b.levels - 0.5), 0.2)}),
    "slow triangles": lambda b: b.but(ramp_top=1.3 * b.ramp_top, rise=25.0),
    "camera saturates": lambda b: b.but(
        sensors={"camera": {"top": b.wire.room + 0.6 * b.warming - ZERO}}),
    "voltmeter saturates": lambda b: b.but(sensors={"volts": {"top": 0.8 * b.top}}),
    "current sensor saturates": lambda b: b.but(
        sensors={"amperes": {"top": 0.75 * b.top / b.wire.resistance}}),
    "wrong mass: 8 % too large": lambda b: b.but(known={"wire.mass": 1.08 * b.wire.mass}),
    "wrong diameter: 5 % too large, and its area": lambda b: b.but(known={
        "wire.diameter": 1.05 * b.known.get("wire.diameter", 0.3e-3),
        "wire.surface_area": 1.05 * b.wire.area}),
    "resistance rises 6 % with heat": lambda b: b.but(
        {"hot_resistance": 0.06, "change": (b.wire.room, b.wire.room + 1.5 * b.warming)}),
    "loss rises 15 % with heat": lambda b: b.but({"loss_growth": 0.15 / b.warming}),
    "latent heat in the ramps": lambda b: b.but(
        {"latent": 12e3, "change": (332.0, 352.0)}, ramp_top=2.2 * b.ramp_top),
    "staircase too short to settle": lambda b: b.but(dwell=max(2.1, b.wire.tau))}
RECORDS: dict[str, Callable[[Bench, Any], Records]] = {
    "air flow +20 % from one staircase to the next": lambda b, r: (
        b.staircase(r), b.staircase(r, _windy(b)), b.ramps(r)),
    "air flow +20 % at the ramps": lambda b, r: (b.staircase(r), b.ramps(r, _windy(b))),
    "another wire in the ramps": lambda b, r: (b.staircase(r), b.ramps(r, _other(b)))}


# --- Attacks that change times and values of signals in both records.
def _hum(size: float, hertz: float):
    return lambda time, values: (time, values + size * np.sin(2 * np.pi * hertz * time))


def _stuck(time, values):
    place, at = np.arange(len(values)), len(values) // 2
    held = (place >= at) & (place < at + len(values) // 4)
    return time, np.where(held, values[at], values)


def _spikes(time, values):
    return time, values + 60.0 * (np.arange(len(values)) % (len(values) // 40) == 0)


def _later(seconds: float, at: float):
    return lambda time, values: (time + seconds * (time > at * time[-1]), values)


def _fast(time, values):
    return 1.02 * time, values


SIGNALS: dict[str, dict[str, Callable]] = {
    "hum aliased to 0.3 Hz in the current": {"current": _hum(0.1, 0.3)},
    "hum aliased to 0.05 Hz in the camera": {"temperature": _hum(1.0, 0.05)},
    "camera stuck for a quarter": {"temperature": _stuck},
    "current sensor stuck for a quarter": {"current": _stuck},
    "voltmeter stuck for a quarter": {"voltage": _stuck},
    "camera spikes": {"temperature": _spikes},
    "clock of the camera jumps 0.5 s": {"temperature": _later(0.5, 0.5)},
    "clock of the camera jumps 30 s": {"temperature": _later(30.0, 0.3)},
    "all clocks 2 % fast": dict.fromkeys(("voltage", "current", "temperature"), _fast)}


def _changed(b: Bench, random, changes: Mapping[str, Callable]) -> Records:
    records = []
    for record in _both(b, random):
        signals = dict(record.signals)
        for name, change in changes.items():
            one = signals[f"wire.{name}"]
            time, values = change(one.time, one.values)
            signals[f"wire.{name}"] = replace(one, time=time, values=values)
        records.append(replace(record, signals=signals))
    return records


_SWAPPED = {"wire.voltage": "wire.current", "wire.current": "wire.voltage"}


def _exchanged(b: Bench, random) -> Records:
    """Voltage and current swapped."""
    return [replace(record, signals={
        name: replace(record.signals[_SWAPPED.get(name, name)], name=name, unit=one.unit)
        for name, one in record.signals.items()}) for record in _both(b, random)]


WIRES = {
    **{name: partial(clean_bag, change=lambda b, own=own: b.but(**own))
       for name, own in FAULTS["E1 to E3"].items()},
    **{name: partial(clean_bag, change=change) for name, change in BENCHES.items()},
    **{name: partial(clean_bag, records=records) for name, records in RECORDS.items()},
    **{name: partial(clean_bag, records=partial(_changed, changes=changes))
       for name, changes in SIGNALS.items()},
    "voltage and current swapped": partial(clean_bag, records=_exchanged)}


# --- E5 to E8: an alloy in a calorimeter, a load frame, a tensile machine, and clamps.
def _unknown_alloy() -> Parameters:
    """Stated parameters of a lab that knows only the nominal 70 degC of its wire."""
    errors = dict.fromkeys(TEMPERATURES, 15.0)
    errors |= {"c_a": 2e6, "c_m": 2e6, "eps_l": 0.01, "e_a": 15e9, "e_m": 8e9, "theta": 0.1e6}
    guess = named(a_s=340.0, a_f=355.0, m_s=330.0, m_f=315.0, eps_l=0.043)
    return Parameters.of_paper().replace(guess, named(**errors))


def _lab(alloy: Alloy) -> Parameters:
    """Stated parameters of a lab with a load frame, which has measured the moduli."""
    errors = named(e_a=0.04 * alloy.e_a, e_m=0.04 * alloy.e_m, theta=0.2 * abs(alloy.theta))
    return _unknown_alloy().replace(alloy.truth("e_a", "e_m", "theta"), errors)


def dsc(random, seed: int, **own) -> Case:
    alloy = Alloy.drawn(random)
    return Case([instruments.dsc(alloy, random, **own)], _unknown_alloy(),
                alloy.truth(*TEMPERATURES))


def frame(random, seed: int, one=None, other=False, experiments=None, calorimeter=None,
          **own) -> Case:
    """`one`: faults at the third load; `other`: that is another alloy; `calorimeter`: faults."""
    alloy = Alloy.drawn(random)
    warmer = {name: getattr(alloy, name) + 8 for name in TEMPERATURES}
    strange = alloy._replace(**warmer, eps_l=0.8 * alloy.eps_l)
    tests: list[Any] = []
    for k, load in enumerate(LOADS):
        faults = own | (one or {}) if k == 2 else own
        which = strange if other and k == 2 else alloy
        tests.append(instruments.isobaric(which, load, random, **faults))
    if calorimeter:
        tests.insert(0, instruments.dsc(alloy, random, **calorimeter))
    return Case(tests, _lab(alloy), alloy.truth(*OF_LOADS), experiments)


def machine(random, seed: int, cold=None, hot=None, **own) -> Case:
    alloy, special = Alloy.drawn(random), (own | (cold or {}), own | (hot or {}))
    tests = [instruments.tensile(alloy, phase, k, random, **faults)
             for phase, faults in zip(PHASES, special, strict=True) for k in range(2)]
    return Case(tests, _unknown_alloy(), alloy.truth("e_m", "e_a"))


def clamps(random, seed: int, known=None, **own) -> Case:
    alloy = Alloy.drawn(random)
    mass, area = 6450.0 * 0.2 * math.pi / 4.0 * 0.3e-3**2, math.pi * 0.3e-3 * 0.2
    sizes = {"wire.length": 0.2, "wire.mass": mass, "wire.surface_area": area}
    stated = sizes | alloy.truth(*TEMPERATURES) | (known or {})
    records = [instruments.clamped(alloy, random, **own)]
    return Case(records, _lab(alloy).replace(stated), alloy.truth("theta"))


def clean_tables(random, seed: int) -> Case:
    alloy = Alloy.drawn(random)
    tests = [instruments.tensile(alloy, phase, k, random) for phase in PHASES for k in range(2)]
    dsc_test = instruments.dsc(alloy, random)
    held = [instruments.isobaric(alloy, load, random) for load in LOADS]
    records = [dsc_test, *held, *tests, instruments.clamped(alloy, random)]
    return Case(records, _unknown_alloy(), alloy.truth(*OF_LOADS, "e_m", "e_a", "theta"))


_MAKERS = {"E5": dsc, "E6": frame, "E5, E6": frame, "E7": machine, "E8": clamps,
           "E9": partial(frame, experiments=("E9",))}
ATTACKS = (*(Attack("E1 to E3", name, make) for name, make in WIRES.items()),
           *(Attack(experiment, name, partial(make, **own))
             for experiment, make in _MAKERS.items() for name, own in FAULTS[experiment].items()))
