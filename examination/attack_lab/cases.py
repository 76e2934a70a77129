"""What may be wrong with a lab's records, one attack a row."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from examination.attack_lab.instruments import (
    A_F,
    A_S,
    C_A,
    C_M,
    E_A,
    E_M,
    EPS_L,
    LOADS,
    M_F,
    M_S,
    THETA,
    Alloy,
    Beam,
    bend,
    clamped,
    dsc,
    isobaric,
    tensile,
)
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


def bench_of(random, seed: int) -> Bench:
    return paper_bench(random) if seed % 2 == 0 else bare_bench(random)


def _wire(change: Callable[[Bench, Any], Bench] = lambda b, r: b,
          records: Callable[[Bench, Any], Sequence[Record]] | None = None):
    def make(random, seed: int) -> Case:
        told = bench_of(random, seed)
        bench = change(told, random)
        made = records(bench, random) if records else (bench.staircase(random), bench.ramps(random))
        return Case(made, told.parameters() if bench.known == told.known else bench.parameters(),
                    bench.truth())

    return make


def _sensors(**own):
    return _wire(lambda b, r: b.but(sensors=own))


def _read(name: str, of: Callable[[np.ndarray, np.ndarray], np.ndarray]):
    """The readings of one signal changed, in both records."""
    def change(record: Record) -> Record:
        s = record.signals[name]
        return replace(record, signals={**record.signals,
                                        name: replace(s, values=of(s.time, s.values.copy()))})

    return _wire(records=lambda b, r: [change(b.staircase(r)), change(b.ramps(r))])


def _stuck(time, values):
    at = len(values) // 2
    values[at : at + len(values) // 4] = values[at]
    return values


def _spikes(time, values):
    values[:: len(values) // 40] += 60.0
    return values


def _swap(record: Record, one: str, other: str) -> Record:
    a, b = record.signals[one], record.signals[other]
    return replace(record, signals={**record.signals, one: replace(b, name=one, unit=a.unit),
                                    other: replace(a, name=other, unit=b.unit)})


def _jump(record: Record, name: str, seconds: float, at: float = 0.5) -> Record:
    s = record.signals[name]
    time = s.time + seconds * (s.time > at * s.time[-1])
    return replace(record, signals={**record.signals, name: replace(s, time=time)})


def _spliced(first: Record, second: Record) -> Record:
    """The first half of one record and the second half of another."""
    signals = {}
    for name, a in first.signals.items():
        b, half = second.signals[name], 0.5 * float(a.time[-1])
        early, late = a.time <= half, b.time > half
        signals[name] = replace(a, time=np.concatenate([a.time[early], b.time[late]]),
                                values=np.concatenate([a.values[early], b.values[late]]))
    return replace(first, signals=signals)


def _other(b: Bench, r: float = 1.12, h: float = 0.8, c: float = 1.1):
    w = b.wire
    return replace(w, resistance=r * w.resistance, loss=h * w.loss,
                   specific_heat=c * w.specific_heat)


def _hot(b: Bench) -> Bench:
    """Ramps far above A_s."""
    return replace(b, ramp_top=2.2 * b.ramp_top)


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
    ("lead of 0.1 ohm", _wire(lambda b, r: b.but(wire={"lead": 0.1}))),
    ("room drifts 1.5 K", _wire(lambda b, r: b.but(wire={"room_drift": 1.5}))),
    ("room drifts 1.5 K, recorded", _wire(
        lambda b, r: b.but(wire={"room_drift": 1.5}, sensors={"thermometer": True}))),
    ("camera drifts 3 K", _sensors(drift=3.0)),
    ("air flow +20 % from one staircase to the next", _wire(records=lambda b, r: (
        b.staircase(r), b.staircase(r, replace(b.wire, loss=1.2 * b.wire.loss)), b.ramps(r)))),
    ("air flow +20 % half-way", _wire(lambda b, r: b.but(
        wire={"wind": (0.5 * b.dwell * (2 * b.levels - 1), 0.2)}))),
    ("air flow +20 % at the ramps", _wire(records=lambda b, r: (
        b.staircase(r), b.ramps(r, replace(b.wire, loss=1.2 * b.wire.loss))))),
    ("slow triangles", _wire(lambda b, r: replace(b, ramp_top=1.3 * b.ramp_top, rise=25.0))),
    ("camera lags 1 s", _sensors(camera_lag=1.0)),
    ("camera lags 0.1 s", _sensors(camera_lag=0.1)),
    ("camera late by 50 ms", _sensors(camera_late=0.05)),
    ("camera saturates", _wire(lambda b, r: b.but(
        sensors={"camera_top": b.wire.room + 0.6 * _rise(b)}))),
    ("voltmeter saturates", _wire(lambda b, r: b.but(sensors={"volt_top": 0.8 * b.top}))),
    ("current sensor saturates", _wire(lambda b, r: b.but(
        sensors={"ampere_top": 0.75 * b.top / b.wire.resistance}))),
    ("slow sampling: 2 Hz", _sensors(rate=2.0, camera_rate=2.0)),
    ("hum aliased to 0.3 Hz in the current", _read(
        "wire.current", lambda t, x: x + 0.1 * np.sin(2 * np.pi * 0.3 * t))),
    ("hum aliased to 0.05 Hz in the camera", _read(
        "wire.temperature", lambda t, x: x + 1.0 * np.sin(2 * np.pi * 0.05 * t))),
    ("camera stuck for a quarter", _read("wire.temperature", _stuck)),
    ("current sensor stuck for a quarter", _read("wire.current", _stuck)),
    ("voltmeter stuck for a quarter", _read("wire.voltage", _stuck)),
    ("camera spikes", _read("wire.temperature", _spikes)),
    ("voltage and current swapped", _wire(records=lambda b, r: [
        _swap(x, "wire.voltage", "wire.current") for x in (b.staircase(r), b.ramps(r))])),
    ("wrong mass: 8 % too large", _wire(lambda b, r: replace(
        b, known={**b.known, "wire.mass": 1.08 * b.wire.mass}))),
    ("wrong diameter: 5 % too large, and its area", _wire(lambda b, r: replace(b, known={
        **b.known, "wire.diameter": 1.05 * b.known.get("wire.diameter", 0.3e-3),
        "wire.surface_area": 1.05 * b.wire.area}))),
    ("another wire in the ramps", _wire(records=lambda b, r: (
        b.staircase(r), b.ramps(r, _other(b))))),
    ("two wires in one staircase", _wire(records=lambda b, r: (
        _spliced(b.staircase(r), b.staircase(r, _other(b))), b.ramps(r)))),
    ("clock of the camera jumps 0.5 s", _wire(records=lambda b, r: [
        _jump(x, "wire.temperature", 0.5) for x in (b.staircase(r), b.ramps(r))])),
    ("clock of the camera jumps 30 s", _wire(records=lambda b, r: [
        _jump(x, "wire.temperature", 30.0, 0.3) for x in (b.staircase(r), b.ramps(r))])),
    ("all clocks 2 % fast", _wire(records=lambda b, r: [
        replace(x, signals={n: replace(s, time=1.02 * s.time) for n, s in x.signals.items()})
        for x in (b.staircase(r), b.ramps(r))])),
    ("resistance rises 6 % with heat", _wire(lambda b, r: b.but(
        wire={"hot_resistance": 0.06, "change": (b.wire.room, b.wire.room + 1.5 * _rise(b))}))),
    ("loss rises 15 % with heat", _wire(lambda b, r: b.but(
        wire={"loss_growth": 0.15 / _rise(b)}))),
    ("a sheath that follows slowly", _wire(lambda b, r: b.but(wire={
        "sheath": (2.0 * b.wire.mass * b.wire.specific_heat, 0.5 * b.wire.loss * b.wire.area)}))),
    ("latent heat in the ramps", _wire(lambda b, r: _hot(b).but(
        wire={"latent": 12e3, "change": (332.0, 352.0)}))),
    ("staircase too short to settle", _wire(lambda b, r: replace(b, dwell=max(2.1, b.wire.tau)))),
    ("stored runs swapped", _wire(records=lambda b, r: _crossed(b.staircase(r), b.ramps(r)))),
)


def _rise(b: Bench) -> float:
    return b.top**2 / (b.wire.resistance * b.wire.loss * b.wire.area)


def _crossed(one: Record, other: Record) -> list[Record]:
    name = "wire.temperature"
    return [replace(a, signals={**a.signals, name: b.signals[name]})
            for a, b in ((one, other), (other, one))]


def clean_bag(random, seed: int) -> Case:
    return _wire()(random, seed)


# --- E5 to E8: an alloy in a calorimeter, a load frame, a tensile machine, between clamps.


def _dsc(changed: Callable[[Alloy], Alloy] = lambda a: a, **own):
    def make(random, seed: int) -> Case:
        alloy = changed(Alloy.drawn(random))
        return Case([dsc(alloy, random, **own)], _unknown_alloy(),
                    alloy.truth(A_S, A_F, M_S, M_F))

    return make


def _lab(alloy: Alloy) -> Parameters:
    """A load frame's lab has tested its moduli."""
    return _unknown_alloy().replace(
        {E_A: alloy.e_a, E_M: alloy.e_m, THETA: alloy.theta},
        {E_A: 0.04 * alloy.e_a, E_M: 0.04 * alloy.e_m, THETA: 0.2 * abs(alloy.theta)},
    )


def _unknown_alloy() -> Parameters:
    """A lab that has bought a wire "of 70 degrees"."""
    return Parameters.of_paper().replace(
        {A_S: 340.0, A_F: 355.0, M_S: 330.0, M_F: 315.0, EPS_L: 0.043},
        {A_S: 15.0, A_F: 15.0, M_S: 15.0, M_F: 15.0, C_A: 2e6, C_M: 2e6, EPS_L: 0.01, E_A: 15e9,
         E_M: 8e9, THETA: 0.1e6},
    )


OF_LOADS = (A_S, A_F, M_S, M_F, C_A, C_M, EPS_L)


def _frame(loads: Sequence[float] = LOADS, one: dict | None = None, other: bool = False,
           experiments: tuple[str, ...] | None = None, **own):
    """`one`: what is wrong with the third load only; `other`: that is another alloy."""
    def make(random, seed: int) -> Case:
        alloy = Alloy.drawn(random)
        strange = replace(alloy, a_s=alloy.a_s + 8, a_f=alloy.a_f + 8, m_s=alloy.m_s + 8,
                          m_f=alloy.m_f + 8, eps_l=0.8 * alloy.eps_l)
        tests = [
            isobaric(strange if other and k == 2 else alloy, load, random,
                     **{**own, **(one if one and k == 2 else {})})
            for k, load in enumerate(loads)
        ]
        return Case(tests, _lab(alloy), alloy.truth(*OF_LOADS), experiments)

    return make


def _both(calorimeter: dict, frame: dict):
    def make(random, seed: int) -> Case:
        alloy = Alloy.drawn(random)
        tests = [isobaric(alloy, load, random, **frame) for load in LOADS]
        return Case([dsc(alloy, random, **calorimeter), *tests], _lab(alloy),
                    alloy.truth(*OF_LOADS))

    return make


def _machine(cold: dict | None = None, hot: dict | None = None, **own):
    def make(random, seed: int) -> Case:
        alloy = Alloy.drawn(random)
        tests = [tensile(alloy, phase, k, random, **{**own, **(special or {})})
                 for phase, special in (("martensite", cold), ("austenite", hot)) for k in range(2)]
        return Case(tests, _unknown_alloy(), alloy.truth(E_M, E_A))

    return make


def _clamps(known: dict | None = None, **own):
    def make(random, seed: int) -> Case:
        alloy = Alloy.drawn(random)
        parameters = _lab(alloy).replace({
            "wire.length": 0.2, "wire.mass": 6450.0 * 0.2 * math.pi / 4.0 * 0.3e-3**2,
            "wire.surface_area": math.pi * 0.3e-3 * 0.2, **alloy.truth(A_S, A_F, M_S, M_F),
            **(known or {}),
        })
        return Case([clamped(alloy, random, **own)], parameters, alloy.truth(THETA))

    return make


INSTRUMENTS = (
    ("E5", "thermometer 1 K high", _dsc(zero=1.0)),
    ("E5", "sample lags 8 s", _dsc(lag=8.0)),
    ("E5", "20 K/min, a lag of 5 s", _dsc(rate=20.0, lag=5.0)),
    ("E5", "baseline bowed", _dsc(bow=250e-6)),
    ("E5", "baseline jumps in the peak", _dsc(step=60e-6)),
    ("E5", "signal saturates", _dsc(top=95e-6)),
    ("E5", "an R-phase step", _dsc(peaks=0.4)),
    ("E5", "endothermic down", _dsc(turned=True)),
    ("E5", "spikes", _dsc(spikes=12)),
    ("E5", "noise ten times", _dsc(noise=3e-6)),
    ("E5", "thermometer 1 % off", _dsc(scale=1.01)),
    ("E5", "the sample trains 3 K a cycle", _dsc(drift=3.0)),
    ("E6", "thermocouple 2 K high", _frame(zero=2.0)),
    ("E6", "thermocouple lags by 2 K", _frame(lag=2.0)),
    ("E6", "gauge length 2 % off", _frame(gauge=1.02)),
    ("E6", "section 4 % off", _frame(area=1.04)),
    ("E6", "creep", _frame(creep=1.5e-3)),
    ("E6", "a slip of the grips", _frame(slip=4e-3)),
    ("E6", "an R-phase step", _frame(tail=0.35)),
    ("E6", "an R-phase step of 8 %", _frame(tail=0.08)),
    ("E6", "strain stuck for a while", _frame(one={"stuck": True})),
    ("E6", "strain and stress swapped in one file", _frame(one={"swapped": True})),
    ("E6", "another wire at one load", _frame(other=True)),
    ("E6", "one load misnoted by 30 %", _frame(one={"area": 1.3})),
    ("E6", "friction of 8 MPa", _frame(friction=8e6)),
    ("E6", "turned round early", _frame(span=(285.0, 352.0))),
    ("E6", "training of 2 K a cycle", _frame(cycles=3, drift=2.0)),
    ("E6", "extensometer ends", _frame(top=0.035)),
    ("E5, E6", "calorimeter 6 K off", _both({"zero": 6.0}, {})),
    ("E7", "soft grips", _machine(compliance=2.5e-11)),
    ("E7", "gauge length 2 % off", _machine(gauge=1.02)),
    ("E7", "section 4 % off", _machine(area=1.04)),
    ("E7", "load cell saturates", _machine(force_top=300e6)),
    ("E7", "a slip in the rise", _machine(slip=2e-3)),
    ("E7", "long toe", _machine(toe=0.008)),
    ("E7", "phases swapped", _machine(cold={"said": "austenite"}, hot={"said": "martensite"})),
    ("E7", "yields in the last rise", _machine(cold={"yielding": 250e6})),
    ("E7", "stopped on the plateau", _machine(cold={"end": 0.035})),
    ("E7", "few points", _machine(points=60)),
    ("E8", "camera 4 % low", _clamps(camera=0.96)),
    ("E8", "spot half filled", _clamps(camera=0.5)),
    ("E8", "force's sign turned", _clamps(turned=True)),
    ("E8", "load cell 2 % off", _clamps(force_gain=1.02)),
    ("E8", "load cell drifts 0.3 N", _clamps(force_drift=0.3)),
    ("E8", "clamps give way", _clamps(clamps=8e-6)),
    ("E8", "slack", _clamps(preload=2e6)),
    ("E8", "A_s stated 25 K too high, transforms", _clamps({A_S: 365.0, A_F: 380.0}, above=312.0)),
    ("E8", "creep", _clamps(creep=0.02e6)),
    ("E8", "wrong diameter: 6 % too large", _clamps({"wire.diameter": 0.318e-3})),
    ("E8", "force stuck", _clamps(stuck=True)),
    ("E8", "force late by 5 s", _clamps(late=5.0)),
)


def clean_tables(random, seed: int) -> Case:
    """All instruments of one alloy."""
    alloy = Alloy.drawn(random)
    tests = [tensile(alloy, phase, k, random) for phase in ("martensite", "austenite")
             for k in range(2)]
    records = [dsc(alloy, random), *(isobaric(alloy, load, random) for load in LOADS), *tests,
               clamped(alloy, random)]
    return Case(records, _unknown_alloy(),
                alloy.truth(*OF_LOADS, E_M, E_A, THETA))


# --- E9: all loops of a load frame fitted together.


def _loops(**own):
    return _frame(experiments=("E9",), **own)


LOOPS = (
    ("thermocouple 2 K high", _loops(zero=2.0)),
    ("thermocouple lags by 2 K", _loops(lag=2.0)),
    ("section 4 % off", _loops(area=1.04)),
    ("gauge length 2 % off", _loops(gauge=1.02)),
    ("creep", _loops(creep=1.5e-3)),
    ("an R-phase step of 8 %", _loops(tail=0.08)),
    ("another wire at one load", _loops(other=True)),
    ("friction of 8 MPa", _loops(friction=8e6)),
)


# --- E10: whole-model fits, a minute each.


def _beam(**own):
    def make(random, seed: int) -> Case:
        beam = Beam(Alloy.drawn(random), random.uniform(0.8, 1.0), random.uniform(4e9, 5e9))
        alloy, told = beam.alloy, 1.0 + 0.02 * random.standard_normal(4)
        believed = Parameters.of_paper().replace({
            "bench.channels": ("front_1", "back_1"), "bench.channel_sides": ("front", "back"),
            "wire.resistance": beam.resistance * told[0], "wire.surface_area": 2e-4,
            "wire.heat_transfer_coefficient": beam.heat_loss / 2e-4 * told[1],
            "wire.specific_heat": beam.capacity / 0.091e-3 * told[2],
            "environment.ambient_temperature": beam.room,
            A_S: alloy.a_s + 0.5, A_F: alloy.a_f - 0.5, M_S: alloy.m_s, M_F: alloy.m_f + 0.5,
            C_A: alloy.c_a, C_M: alloy.c_m, E_A: alloy.e_a, E_M: alloy.e_m, EPS_L: alloy.eps_l,
            THETA: alloy.theta, "composite.deflection_per_strain": beam.alpha * told[3],
            "composite.stress_per_deflection_front": beam.beta * 1.03,
            "composite.stress_per_deflection_back": beam.beta * 0.97,
        }, {
            "wire.resistance": 0.06, "wire.heat_transfer_coefficient": 4.0,
            "wire.specific_heat": 12.0, A_S: 0.7, A_F: 0.7, M_S: 0.7, M_F: 0.7, C_A: 4e5, C_M: 4e5,
            E_A: 1.5e9, E_M: 0.6e9, EPS_L: 1e-3, THETA: 3e4,
            "composite.deflection_per_strain": 0.03,
            "composite.stress_per_deflection_front": 2e8,
            "composite.stress_per_deflection_back": 2e8, "wire.surface_area": 2e-6,
            "wire.mass": 4e-7,
        })
        truth = {
            "wire.resistance": beam.resistance,
            "wire.heat_transfer_coefficient": beam.heat_loss / 2e-4,
            "wire.specific_heat": beam.capacity / 0.091e-3,
            **alloy.truth(*OF_LOADS, E_M, E_A, THETA),
            "composite.deflection_per_strain": beam.alpha,
            "composite.stress_per_deflection_front": beam.beta,
            "composite.stress_per_deflection_back": beam.beta,
            "environment.ambient_temperature": beam.room,
        }
        return Case([bend(beam, random, **own)], believed, truth, ("E10",))

    return make


BEAMS = (
    ("current gain 1.5 %", _beam(gains={"current": 1.015})),
    ("camera 5 % high", _beam(gains={"temperature": 1.05})),
    ("range sensor 2 % high", _beam(gains={"deflection": 1.02})),
    ("temperatures of two channels swapped", _beam(swapped=True)),
    ("range sensor stuck", _beam(stuck="deflection")),
    ("range sensor clips", _beam(clip=0.012)),
    ("residual deflection of 1.5 mm", _beam(residual=1.5e-3)),
    ("range sensor late by 1 s", _beam(late=1.0)),
)

ATTACKS = (
    *(Attack("E1 to E3", name, make) for name, make in WIRES),
    *(Attack(*row) for row in INSTRUMENTS),
    *(Attack("E9", name, make) for name, make in LOOPS),
    *(Attack("E10", name, make) for name, make in BEAMS),
)
