"""What may be wrong with a lab's records, one attack a row."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from examination.attack_lab import instruments
from examination.attack_lab.instruments import LOADS, Alloy, Beam, named
from examination.attack_lab.rig import Bench, bare_bench, paper_bench
from sma_bench.parameters import Parameters
from sma_bench.records import Record


@dataclass(frozen=True)
class Case:
    """Records with what is true of them, and what their lab has stated."""

    records: Sequence[Any]
    parameters: Parameters
    truth: dict[str, float]
    experiments: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Attack:
    """`make` takes a generator and the seed."""

    experiment: str
    name: str
    make: Callable[[Any, int], Case]


# --- E1 to E3: a staircase and ramps of one wire, near Table I and bare in air by turns.


def clean_bag(
    random, seed: int, change: Callable[[Bench], Bench] = lambda b: b,
    records: Callable[[Bench, Any], Sequence[Record]] = lambda b, r: (b.staircase(r), b.ramps(r)),
) -> Case:  # fmt: skip
    """`change` what the bench is, or `records` how it is recorded."""
    told = paper_bench(random) if seed % 2 == 0 else bare_bench(random)
    bench = change(told)
    made = records(bench, random)
    return Case(made, told.parameters() if bench.known == told.known else bench.parameters(),
                bench.truth())


def _bench(change: Callable[[Bench], Bench]):
    return partial(clean_bag, change=change)


def _wire(**own):
    return _bench(lambda b: b.but(wire=own))


def _sensors(**own):
    return _bench(lambda b: b.but(sensors=own))


def _records(records: Callable[[Bench, Any], Sequence[Record]]):
    return partial(clean_bag, records=records)


def _each(change: Callable[[Record], Record]):
    return _records(lambda b, r: [change(b.staircase(r)), change(b.ramps(r))])


def _with(record: Record, **signals) -> Record:
    """Signals of `wire.` replaced."""
    return replace(record, signals=record.signals | {f"wire.{n}": s for n, s in signals.items()})


def _read(name: str, of: Callable[[np.ndarray, np.ndarray], np.ndarray]):
    """The readings of one signal changed, in both records."""
    def change(record: Record) -> Record:
        s = record.signals[f"wire.{name}"]
        return _with(record, **{name: replace(s, values=of(s.time, s.values.copy()))})

    return _each(change)


def _stuck(time, values):
    at = len(values) // 2
    values[at : at + len(values) // 4] = values[at]
    return values


def _spikes(time, values):
    values[:: len(values) // 40] += 60.0
    return values


def _swapped(record: Record) -> Record:
    a, b = record.signals["wire.voltage"], record.signals["wire.current"]
    return _with(record, voltage=replace(a, time=b.time, values=b.values),
                 current=replace(b, time=a.time, values=a.values))


def _jump(seconds: float, at: float = 0.5):
    def change(record: Record) -> Record:
        s = record.signals["wire.temperature"]
        time = s.time + seconds * (s.time > at * s.time[-1])
        return _with(record, temperature=replace(s, time=time))

    return _each(change)


def _fast(record: Record) -> Record:
    return replace(record, signals={n: replace(s, time=1.02 * s.time)
                                    for n, s in record.signals.items()})


def _spliced(first: Record, second: Record) -> Record:
    """The first half of one record and the second half of another."""
    signals = {}
    for name, a in first.signals.items():
        b, half = second.signals[name], 0.5 * float(a.time[-1])
        early, late = a.time <= half, b.time > half
        signals[name] = replace(a, time=np.concatenate([a.time[early], b.time[late]]),
                                values=np.concatenate([a.values[early], b.values[late]]))
    return replace(first, signals=signals)


def _crossed(one: Record, other: Record) -> list[Record]:
    return [_with(a, temperature=b.signals["wire.temperature"])
            for a, b in ((one, other), (other, one))]


def _other(b: Bench):
    w = b.wire
    return replace(w, resistance=1.12 * w.resistance, loss=0.8 * w.loss,
                   specific_heat=1.1 * w.specific_heat)


def _windy(b: Bench):
    return replace(b.wire, loss=1.2 * b.wire.loss)


def _rise(b: Bench) -> float:
    return b.top**2 / (b.wire.resistance * b.wire.loss * b.wire.area)


WIRES = (
    ("camera gain +5 %", _sensors(camera_gain=1.05)),
    ("camera gain -2 %", _sensors(camera_gain=0.98)),
    ("camera zero +2 K", _sensors(camera_zero=2.0)),
    ("emissivity off by 5 %", _sensors(emissivity=0.95)),
    ("emissivity off by -4 %", _sensors(emissivity=1.04)),
    ("spot half filled", _sensors(emissivity=0.52)),
    ("current gain 1.5 %", _sensors(ampere_gain=1.015)),
    ("current gain -3 %", _sensors(ampere_gain=0.97)),
    ("voltage gain 1 %", _sensors(volt_gain=1.01)),
    ("voltage zero +20 mV", _sensors(volt_offset=0.02)),
    ("current zero +80 mA", _sensors(ampere_offset=0.08)),
    ("lead of 0.1 ohm", _wire(lead=0.1)),
    ("room drifts 1.5 K", _wire(room_drift=1.5)),
    ("room drifts 1.5 K, recorded", _bench(
        lambda b: b.but(wire={"room_drift": 1.5}, sensors={"thermometer": True}))),
    ("camera drifts 3 K", _sensors(drift=3.0)),
    ("air flow +20 % from one staircase to the next", _records(
        lambda b, r: (b.staircase(r), b.staircase(r, _windy(b)), b.ramps(r)))),
    ("air flow +20 % half-way", _bench(lambda b: b.but(
        wire={"wind": (0.5 * b.dwell * (2 * b.levels - 1), 0.2)}))),
    ("air flow +20 % at the ramps", _records(
        lambda b, r: (b.staircase(r), b.ramps(r, _windy(b))))),
    ("slow triangles", _bench(lambda b: replace(b, ramp_top=1.3 * b.ramp_top, rise=25.0))),
    ("camera lags 1 s", _sensors(camera_lag=1.0)),
    ("camera lags 0.1 s", _sensors(camera_lag=0.1)),
    ("camera late by 50 ms", _sensors(camera_late=0.05)),
    ("camera saturates", _bench(lambda b: b.but(
        sensors={"camera_top": b.wire.room + 0.6 * _rise(b)}))),
    ("voltmeter saturates", _bench(lambda b: b.but(sensors={"volt_top": 0.8 * b.top}))),
    ("current sensor saturates", _bench(lambda b: b.but(
        sensors={"ampere_top": 0.75 * b.top / b.wire.resistance}))),
    ("slow sampling: 2 Hz", _sensors(rate=2.0, camera_rate=2.0)),
    ("hum aliased to 0.3 Hz in the current", _read(
        "current", lambda t, x: x + 0.1 * np.sin(2 * np.pi * 0.3 * t))),
    ("hum aliased to 0.05 Hz in the camera", _read(
        "temperature", lambda t, x: x + 1.0 * np.sin(2 * np.pi * 0.05 * t))),
    ("camera stuck for a quarter", _read("temperature", _stuck)),
    ("current sensor stuck for a quarter", _read("current", _stuck)),
    ("voltmeter stuck for a quarter", _read("voltage", _stuck)),
    ("camera spikes", _read("temperature", _spikes)),
    ("voltage and current swapped", _each(_swapped)),
    ("wrong mass: 8 % too large", _bench(lambda b: replace(
        b, known={**b.known, "wire.mass": 1.08 * b.wire.mass}))),
    ("wrong diameter: 5 % too large, and its area", _bench(lambda b: replace(b, known={
        **b.known, "wire.diameter": 1.05 * b.known.get("wire.diameter", 0.3e-3),
        "wire.surface_area": 1.05 * b.wire.area}))),
    ("another wire in the ramps", _records(lambda b, r: (
        b.staircase(r), b.ramps(r, _other(b))))),
    ("two wires in one staircase", _records(lambda b, r: (
        _spliced(b.staircase(r), b.staircase(r, _other(b))), b.ramps(r)))),
    ("clock of the camera jumps 0.5 s", _jump(0.5)),
    ("clock of the camera jumps 30 s", _jump(30.0, 0.3)),
    ("all clocks 2 % fast", _each(_fast)),
    ("resistance rises 6 % with heat", _bench(lambda b: b.but(
        wire={"hot_resistance": 0.06, "change": (b.wire.room, b.wire.room + 1.5 * _rise(b))}))),
    ("loss rises 15 % with heat", _bench(lambda b: b.but(
        wire={"loss_growth": 0.15 / _rise(b)}))),
    ("a sheath that follows slowly", _bench(lambda b: b.but(wire={
        "sheath": (2.0 * b.wire.mass * b.wire.specific_heat, 0.5 * b.wire.loss * b.wire.area)}))),
    ("latent heat in the ramps", _bench(lambda b: replace(b, ramp_top=2.2 * b.ramp_top).but(
        wire={"latent": 12e3, "change": (332.0, 352.0)}))),
    ("staircase too short to settle", _bench(lambda b: replace(b, dwell=max(2.1, b.wire.tau)))),
    ("stored runs swapped", _records(lambda b, r: _crossed(b.staircase(r), b.ramps(r)))),
)


# --- E5 to E8: an alloy in a calorimeter, a load frame, a tensile machine, between clamps.


OF_LOADS = ("a_s", "a_f", "m_s", "m_f", "c_a", "c_m", "eps_l")
PHASES = ("martensite", "austenite")


def _unknown_alloy() -> Parameters:
    """A lab that has bought a wire "of 70 degrees"."""
    return Parameters.of_paper().replace(
        named(a_s=340.0, a_f=355.0, m_s=330.0, m_f=315.0, eps_l=0.043),
        named(a_s=15.0, a_f=15.0, m_s=15.0, m_f=15.0, c_a=2e6, c_m=2e6, eps_l=0.01, e_a=15e9,
              e_m=8e9, theta=0.1e6),
    )


def _lab(alloy: Alloy) -> Parameters:
    """A load frame's lab has tested its moduli."""
    return _unknown_alloy().replace(
        alloy.truth("e_a", "e_m", "theta"),
        named(e_a=0.04 * alloy.e_a, e_m=0.04 * alloy.e_m, theta=0.2 * abs(alloy.theta)),
    )


def dsc(random, seed: int, **own) -> Case:
    alloy = Alloy.drawn(random)
    return Case([instruments.dsc(alloy, random, **own)], _unknown_alloy(),
                alloy.truth("a_s", "a_f", "m_s", "m_f"))


def frame(random, seed: int, one=None, other: bool = False, experiments=None, calorimeter=None,
          **own) -> Case:
    """`one`: what is wrong with the third load only; `other`: that is another alloy; with the
    `calorimeter` whose faults are given."""
    alloy = Alloy.drawn(random)
    strange = replace(alloy, a_s=alloy.a_s + 8, a_f=alloy.a_f + 8, m_s=alloy.m_s + 8,
                      m_f=alloy.m_f + 8, eps_l=0.8 * alloy.eps_l)
    tests: list[Any] = [
        instruments.isobaric(strange if other and k == 2 else alloy, load, random,
                             **{**own, **(one if one and k == 2 else {})})
        for k, load in enumerate(LOADS)
    ]
    if calorimeter:
        tests.insert(0, instruments.dsc(alloy, random, **calorimeter))
    return Case(tests, _lab(alloy), alloy.truth(*OF_LOADS), experiments)


def machine(random, seed: int, cold=None, hot=None, **own) -> Case:
    alloy = Alloy.drawn(random)
    tests = [instruments.tensile(alloy, phase, k, random, **{**own, **(special or {})})
             for phase, special in zip(PHASES, (cold, hot), strict=True) for k in range(2)]
    return Case(tests, _unknown_alloy(), alloy.truth("e_m", "e_a"))


def clamps(random, seed: int, known=None, **own) -> Case:
    alloy = Alloy.drawn(random)
    parameters = _lab(alloy).replace({
        "wire.length": 0.2, "wire.mass": 6450.0 * 0.2 * math.pi / 4.0 * 0.3e-3**2,
        "wire.surface_area": math.pi * 0.3e-3 * 0.2, **alloy.truth("a_s", "a_f", "m_s", "m_f"),
        **(known or {}),
    })
    return Case([instruments.clamped(alloy, random, **own)], parameters, alloy.truth("theta"))


def clean_tables(random, seed: int) -> Case:
    """All instruments of one alloy."""
    alloy = Alloy.drawn(random)
    tests = [instruments.tensile(alloy, phase, k, random) for phase in PHASES for k in range(2)]
    records = [instruments.dsc(alloy, random),
               *(instruments.isobaric(alloy, load, random) for load in LOADS), *tests,
               instruments.clamped(alloy, random)]
    return Case(records, _unknown_alloy(), alloy.truth(*OF_LOADS, "e_m", "e_a", "theta"))


def beam(random, seed: int, **own) -> Case:
    """E10: whole-model fits, a minute each."""
    one = Beam(Alloy.drawn(random), random.uniform(0.8, 1.0), random.uniform(4e9, 5e9))
    alloy, told = one.alloy, 1.0 + 0.02 * random.standard_normal(4)
    truth = {
        "wire.resistance": one.resistance, "wire.heat_transfer_coefficient": one.heat_loss / 2e-4,
        "wire.specific_heat": one.capacity / 0.091e-3,
        **alloy.truth(*OF_LOADS, "e_m", "e_a", "theta"),
        "composite.deflection_per_strain": one.alpha,
        "composite.stress_per_deflection_front": one.beta,
        "composite.stress_per_deflection_back": one.beta,
        "environment.ambient_temperature": one.room,
    }  # fmt: skip
    factors = {
        "wire.resistance": told[0], "wire.heat_transfer_coefficient": told[1],
        "wire.specific_heat": told[2], "composite.deflection_per_strain": told[3],
        "composite.stress_per_deflection_front": 1.03, "composite.stress_per_deflection_back": 0.97,
    }  # fmt: skip
    believed = Parameters.of_paper().replace({
        "bench.channels": ("front_1", "back_1"), "bench.channel_sides": ("front", "back"),
        "wire.surface_area": 2e-4, **truth, **{n: truth[n] * f for n, f in factors.items()},
        **named(a_s=alloy.a_s + 0.5, a_f=alloy.a_f - 0.5, m_f=alloy.m_f + 0.5),
    }, {
        "wire.resistance": 0.06, "wire.heat_transfer_coefficient": 4.0, "wire.specific_heat": 12.0,
        "composite.deflection_per_strain": 0.03, "composite.stress_per_deflection_front": 2e8,
        "composite.stress_per_deflection_back": 2e8, "wire.surface_area": 2e-6, "wire.mass": 4e-7,
        **named(a_s=0.7, a_f=0.7, m_s=0.7, m_f=0.7, c_a=4e5, c_m=4e5, e_a=1.5e9, e_m=0.6e9,
                eps_l=1e-3, theta=3e4),
    })  # fmt: skip
    return Case([instruments.bend(one, random, **own)], believed, truth, ("E10",))


def _attack(experiment: str, name: str, make: Callable[..., Case], **own) -> Attack:
    return Attack(experiment, name, partial(make, **own))


# All loops of a load frame fitted together.
loops = partial(frame, experiments=("E9",))
ATTACKS = (
    *(Attack("E1 to E3", name, make) for name, make in WIRES),
    _attack("E5", "thermometer 1 K high", dsc, zero=1.0),
    _attack("E5", "sample lags 8 s", dsc, lag=8.0),
    _attack("E5", "20 K/min, a lag of 5 s", dsc, rate=20.0, lag=5.0),
    _attack("E5", "baseline bowed", dsc, bow=250e-6),
    _attack("E5", "baseline jumps in the peak", dsc, step=60e-6),
    _attack("E5", "signal saturates", dsc, top=95e-6),
    _attack("E5", "an R-phase step", dsc, peaks=0.4),
    _attack("E5", "endothermic down", dsc, turned=True),
    _attack("E5", "spikes", dsc, spikes=12),
    _attack("E5", "noise ten times", dsc, noise=3e-6),
    _attack("E5", "thermometer 1 % off", dsc, scale=1.01),
    _attack("E5", "the sample trains 3 K a cycle", dsc, drift=3.0),
    _attack("E6", "thermocouple 2 K high", frame, zero=2.0),
    _attack("E6", "thermocouple lags by 2 K", frame, lag=2.0),
    _attack("E6", "gauge length 2 % off", frame, gauge=1.02),
    _attack("E6", "section 4 % off", frame, area=1.04),
    _attack("E6", "creep", frame, creep=1.5e-3),
    _attack("E6", "a slip of the grips", frame, slip=4e-3),
    _attack("E6", "an R-phase step", frame, tail=0.35),
    _attack("E6", "an R-phase step of 8 %", frame, tail=0.08),
    _attack("E6", "strain stuck for a while", frame, one={"stuck": True}),
    _attack("E6", "strain and stress swapped in one file", frame, one={"swapped": True}),
    _attack("E6", "another wire at one load", frame, other=True),
    _attack("E6", "one load misnoted by 30 %", frame, one={"area": 1.3}),
    _attack("E6", "friction of 8 MPa", frame, friction=8e6),
    _attack("E6", "turned round early", frame, span=(285.0, 352.0)),
    _attack("E6", "training of 2 K a cycle", frame, cycles=3, drift=2.0),
    _attack("E6", "extensometer ends", frame, top=0.035),
    _attack("E5, E6", "calorimeter 6 K off", frame, calorimeter={"zero": 6.0}),
    _attack("E7", "soft grips", machine, compliance=2.5e-11),
    _attack("E7", "gauge length 2 % off", machine, gauge=1.02),
    _attack("E7", "section 4 % off", machine, area=1.04),
    _attack("E7", "load cell saturates", machine, force_top=300e6),
    _attack("E7", "a slip in the rise", machine, slip=2e-3),
    _attack("E7", "long toe", machine, toe=0.008),
    _attack("E7", "phases swapped", machine, cold={"said": "austenite"},
            hot={"said": "martensite"}),
    _attack("E7", "yields in the last rise", machine, cold={"yielding": 250e6}),
    _attack("E7", "stopped on the plateau", machine, cold={"end": 0.035}),
    _attack("E7", "few points", machine, points=60),
    _attack("E8", "camera 4 % low", clamps, camera=0.96),
    _attack("E8", "spot half filled", clamps, camera=0.5),
    _attack("E8", "force's sign turned", clamps, turned=True),
    _attack("E8", "load cell 2 % off", clamps, force_gain=1.02),
    _attack("E8", "load cell drifts 0.3 N", clamps, force_drift=0.3),
    _attack("E8", "clamps give way", clamps, clamps=8e-6),
    _attack("E8", "slack", clamps, preload=2e6),
    _attack("E8", "A_s stated 25 K too high, transforms", clamps,
            known=named(a_s=365.0, a_f=380.0), above=312.0),
    _attack("E8", "creep", clamps, creep=0.02e6),
    _attack("E8", "wrong diameter: 6 % too large", clamps, known={"wire.diameter": 0.318e-3}),
    _attack("E8", "force stuck", clamps, stuck=True),
    _attack("E8", "force late by 5 s", clamps, late=5.0),
    _attack("E9", "thermocouple 2 K high", loops, zero=2.0),
    _attack("E9", "thermocouple lags by 2 K", loops, lag=2.0),
    _attack("E9", "section 4 % off", loops, area=1.04),
    _attack("E9", "gauge length 2 % off", loops, gauge=1.02),
    _attack("E9", "creep", loops, creep=1.5e-3),
    _attack("E9", "an R-phase step of 8 %", loops, tail=0.08),
    _attack("E9", "another wire at one load", loops, other=True),
    _attack("E9", "friction of 8 MPa", loops, friction=8e6),
    _attack("E10", "current gain 1.5 %", beam, gains={"current": 1.015}),
    _attack("E10", "camera 5 % high", beam, gains={"temperature": 1.05}),
    _attack("E10", "range sensor 2 % high", beam, gains={"deflection": 1.02}),
    _attack("E10", "temperatures of two channels swapped", beam, swapped=True),
    _attack("E10", "range sensor stuck", beam, stuck="deflection"),
    _attack("E10", "range sensor clips", beam, clip=0.012),
    _attack("E10", "residual deflection of 1.5 mm", beam, residual=1.5e-3),
    _attack("E10", "range sensor late by 1 s", beam, late=1.0),
)
