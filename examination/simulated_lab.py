"""A simulated lab: benches drawn at random within believable ranges, what their lab knows of them
beforehand, and its experiments: protocol, bench, instruments, bag.

The instruments are the simulator node's, sampling with jitter and losing some samples.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import NITI_DENSITY, wire_length_from_mass
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.table import EXACT_SENSORS
from sma_bench.physics import Boundary, Simulation, simulate
from sma_bench.physics.bending import wire_section
from sma_bench.protocols import parse_protocol
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.records.contract import CELSIUS_ZERO

RIG = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}
# What a lab knows from data sheets: relative where a number of the contract is a product of many,
# else in its unit.
RELATIVE, ABSOLUTE = True, False
ERRORS = {
    "wire.resistance": (0.03, RELATIVE),
    "wire.heat_transfer_coefficient": (0.15, RELATIVE),
    "wire.specific_heat": (0.10, RELATIVE),
    "wire.austenite_start_temperature": (3.0, ABSOLUTE),
    "wire.austenite_finish_temperature": (3.0, ABSOLUTE),
    "wire.martensite_start_temperature": (3.0, ABSOLUTE),
    "wire.martensite_finish_temperature": (3.0, ABSOLUTE),
    "wire.martensite_modulus": (0.10, RELATIVE),
    "wire.austenite_modulus": (0.10, RELATIVE),
    "wire.maximum_recoverable_strain": (0.08, RELATIVE),
    "wire.thermal_expansion_factor": (0.05e6, ABSOLUTE),
    "wire.stress_influence_austenite": (0.15, RELATIVE),
    "wire.stress_influence_martensite": (0.15, RELATIVE),
    "environment.ambient_temperature": (0.5, ABSOLUTE),
    "composite.deflection_per_strain": (0.10, RELATIVE),
    "composite.stress_per_deflection_front": (0.15, RELATIVE),
    "composite.stress_per_deflection_back": (0.15, RELATIVE),
}
IDENTIFIED = tuple(ERRORS)
EXACT = ("wire.mass", "wire.surface_area", "wire.diameter")
_FARTHEST = 2.5  # stated errors
COMMAND_PERIOD = 0.05
STEP = 0.0025
LOADS = (10e6, 50e6, 100e6, 150e6, 200e6)
PRETENSION = 0.002
STANDOFF = 0.1
SIDES = ("front", "back")
JITTER, LOST = 0.2, 0.02  # of a period, of the samples
_HEATED = 25.0
_REST = 15.0
_LOADED_AT, _LOADING = 14.0, 1.0  # s, when the wire is cold and at rest
_SETTINGS = {parameter.name: parameter.default for parameter in SIMULATOR}
# The traverse of a load frame; the simulator node has none that moves.
_SETTINGS |= {"sensor.elongation_noise": 2e-6, "sensor.elongation_resolution": 1e-6}

Array = np.ndarray
Steps = Iterable[dict[str, Any]]


@dataclass(frozen=True)
class DrawnBench:
    """`truth` simulates the bench, `known` is the parameter file of its lab."""

    truth: Parameters
    known: Parameters


def draw_bench(random: np.random.Generator) -> DrawnBench:
    """One bench: its true parameters, and nominal ones that are off by their stated errors."""
    truth = Parameters(_numbers(random) | RIG)
    # The simulated instruments have noise and steps, but no scale of their own.
    std = {n: size * float(truth[n]) if of else size for n, (size, of) in ERRORS.items()}
    while True:
        nominal = {name: truth[name] + std[name] * _within(random) for name in IDENTIFIED}
        a_s, a_f, m_s, m_f = (nominal[name] for name in IDENTIFIED[3:7])
        if min(a_f - a_s, m_s - m_f) > 1.0:
            exact = dict.fromkeys(EXACT, 0.0) | EXACT_SENSORS
            return DrawnBench(truth, truth.replace(nominal, std | exact))


def _within(random: np.random.Generator) -> float:
    while True:
        deviation = float(random.standard_normal())
        if abs(deviation) < _FARTHEST:
            return deviation


def _numbers(random: np.random.Generator) -> dict[str, float]:
    diameter, length = random.uniform(0.2e-3, 0.3e-3), random.uniform(0.15, 0.25)
    section = math.pi * diameter**2 / 4.0
    soft = random.uniform(18e9, 35e9)
    drawn = {
        "wire.diameter": diameter,
        "wire.mass": NITI_DENSITY * section * length,
        "wire.surface_area": math.pi * diameter * length,
        "wire.resistance": random.uniform(75e-8, 100e-8) * length / section,
        "wire.heat_transfer_coefficient": random.uniform(90.0, 200.0),
        "wire.specific_heat": random.uniform(350.0, 550.0),
        "wire.martensite_modulus": soft,
        "wire.austenite_modulus": random.uniform(45e9, 80e9),
        "wire.maximum_recoverable_strain": random.uniform(0.03, 0.05),
        "wire.thermal_expansion_factor": -random.uniform(6e-6, 9e-6) * soft,
        "wire.stress_influence_austenite": random.uniform(5e6, 9e6),
        "wire.stress_influence_martensite": random.uniform(5e6, 9e6),
        "composite.deflection_per_strain": random.uniform(0.6, 1.3),
        "composite.stress_per_deflection_front": random.uniform(2e9, 6e9),
        "composite.stress_per_deflection_back": random.uniform(2e9, 6e9),
        "environment.ambient_temperature": random.uniform(291.0, 299.0),
    }
    # Every order of the ranges that is seen on NiTi, M_s above A_s as in the paper included.
    while True:
        a_s = random.uniform(322.0, 345.0)
        a_f = a_s + random.uniform(10.0, 25.0)
        m_s = a_s + random.uniform(-18.0, 6.0)
        m_f = m_s - random.uniform(10.0, 25.0)
        if m_f > drawn["environment.ambient_temperature"] + 10.0 and m_s < a_f - 2.0:
            return drawn | dict(zip(IDENTIFIED[3:7], (a_s, a_f, m_s, m_f), strict=True))


# --- Its experiments.


def record_everything(bench: DrawnBench, folder: Path, seed: int) -> list[Path]:
    """Run every experiment once and write its bag; the paths."""
    paths = [folder / name for name in EXPERIMENTS]
    for number, (path, experiment) in enumerate(zip(paths, EXPERIMENTS.values(), strict=True)):
        write_record(path, experiment(bench.truth, 100 * seed + number))
    return paths


def staircase(truth: Parameters, seed: int) -> list[Signal]:
    """E1, E2: voltage up and down in steps of 30 s."""
    peak = voltage_for(truth, truth["wire.austenite_finish_temperature"] + 20.0)
    step = peak / 8.0
    levels = {"kind": "staircase", "increment": step, "dwell": 30.0}
    steps = [levels | {"start": 0.0, "stop": peak}, levels | {"start": peak - step, "stop": 0.0}]
    wire = one_wire(truth)
    return measured([simulate(wire, *_held(wire, steps))], 20.0, seed)


def ramp(truth: Parameters, seed: int) -> list[Signal]:
    """E3: four ramps that stay below A_s."""
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 8.0)
    up = {"kind": "ramp", "start": 0.0, "stop": peak, "duration": 7.0}
    wire = one_wire(truth)
    return measured([simulate(wire, *_held(wire, [up, _rest(12.0)], repeat=4))], 100.0, seed)


def isobaric(truth: Parameters, seed: int) -> list[Signal]:
    """E6: the load frame holds five loads in turn, the wire is heated and cooled under each."""
    hottest, steps = truth["wire.austenite_finish_temperature"] + 20.0, []
    for load in LOADS:
        peak = voltage_for(truth, hottest + load / truth["wire.stress_influence_austenite"])
        triangle = {"kind": "triangle", "peak": peak, "rise": _HEATED, "fall": _HEATED}
        steps += [_rest(_REST), triangle]
    wire = one_wire(truth)
    time, voltage = _held(wire, [*steps, _rest(_REST)])
    changes = _LOADED_AT + (_REST + 2.0 * _HEATED) * np.arange(len(LOADS))
    at = np.column_stack([changes, changes + _LOADING]).ravel()
    stress = np.interp(time, at, np.column_stack([(0.0, *LOADS[:-1]), LOADS]).ravel())
    # Simulations in a row, one for each stretch of constant stress.
    parts: list[Simulation] = []
    for start, stop in pairwise([0, *(np.flatnonzero(np.diff(stress)) + 1), len(time)]):
        span = slice(max(start - 1, 0), stop)
        begin, held = parts[-1].final if parts else None, Boundary.held_stress(float(stress[start]))
        parts.append(simulate(wire, time[span], voltage[span], initial=begin, boundary=held))
    moved = -wire_length_from_mass(wire) * _joined(parts, "contraction")[:, 0]
    frame = {"force": ("N", stress * wire_section(wire)), "elongation": ("m", moved)}
    return measured(parts, 50.0, seed, frame)


def clamped(truth: Parameters, seed: int) -> list[Signal]:
    """E8: the wire clamped under tension, a staircase below A_s."""
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 4.0)
    levels = [0.0, *(peak * math.sqrt(share) for share in (0.25, 0.5, 0.75, 1.0, 0.5, 0.0))]
    steps = [
        {"kind": "step", "level": level, "duration": 20.0} if level else _rest(20.0)
        for level in levels
    ]
    wire = one_wire(truth)
    run = simulate(wire, *_held(wire, steps), boundary=Boundary.clamped(-PRETENSION))
    still = np.full(len(run.time), PRETENSION * wire_length_from_mass(wire))
    return measured(
        [run], 50.0, seed, {"force": ("N", run.force[:, 0]), "elongation": ("m", still)}
    )


def composite_triangle(truth: Parameters, seed: int) -> list[Signal]:
    """E12: triangles, front and back by turns."""
    way = {"kind": "triangle", "peak": _bending_voltage(truth), "rise": 15.0, "fall": 15.0}
    return _composite(truth, seed, [way | {"drive": side} for side in SIDES])


def composite_step(truth: Parameters, seed: int) -> list[Signal]:
    """E12: steps, front and back by turns, the second time not all the way."""
    step, peak = {"kind": "step", "duration": 12.0}, _bending_voltage(truth)
    both = [(share * peak, side) for share in (1.0, 0.88) for side in SIDES]
    return _composite(truth, seed, [step | {"level": v, "drive": side} for v, side in both])


_ALL = (staircase, ramp, isobaric, clamped, composite_triangle, composite_step)
EXPERIMENTS = {experiment.__name__: experiment for experiment in _ALL}


def one_wire(truth: Parameters) -> Parameters:
    """The same wire on the wire rig."""
    return truth.replace({"bench.channels": ("wire",), "bench.channel_sides": ("front",)})


def voltage_for(truth: Parameters, temperature: float) -> float:
    """Voltage [V] that ends at `temperature` [K]: a lab finds it by trying."""
    rise = temperature - truth["environment.ambient_temperature"]
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    return float(np.round(math.sqrt(rise * truth["wire.resistance"] * loss), 3))


def _bending_voltage(truth: Parameters) -> float:
    """Enough for the whole transformation against the stiffer side."""
    stiff = max(truth[f"composite.stress_per_deflection_{side}"] for side in SIDES)
    strain = truth["wire.maximum_recoverable_strain"]
    stress = 0.5 * stiff * truth["composite.deflection_per_strain"] * strain
    shift = stress / truth["wire.stress_influence_austenite"]
    return voltage_for(truth, truth["wire.austenite_finish_temperature"] + shift + 15.0)


def _composite(truth: Parameters, seed: int, steps: Steps) -> list[Signal]:
    run = simulate(truth, *_held(truth, [one for step in steps for one in (step, _rest(15.0))]))
    distances = {
        f"{side}.range": ("m", STANDOFF + sign * run.deflection)
        for side, sign in zip(SIDES, (-1.0, 1.0), strict=True)
    }
    return measured([run], 50.0, seed, distances)


def _rest(duration: float) -> dict[str, Any]:
    return {"kind": "rest", "duration": duration}


def _held(parameters: Parameters, steps: Steps, repeat: int = 1) -> tuple[Array, Array]:
    """Time (n,) s every 2.5 ms and the voltage (n, w) that the last command left there."""
    protocol = parse_protocol({"steps": [_rest(3.0), *steps], "repeat": repeat}, parameters)
    time = np.arange(int(round((protocol.duration + 1.0) / STEP))) * STEP
    return time, protocol.voltages(np.floor(time / COMMAND_PERIOD + 1e-6) * COMMAND_PERIOD)


def _joined(parts: list[Simulation], name: str) -> Array:
    """Each part begins with the last sample of the one before."""
    return np.concatenate([getattr(p, name)[bool(k) :] for k, p in enumerate(parts)])


class Clocks:
    """Instants of sampling."""

    def __init__(self, seed: int, duration: float) -> None:
        self._random, self._duration = np.random.default_rng(seed), duration

    def at(self, rate: float) -> Array:
        """(m,) s, at `rate` Hz, with jitter and losses."""
        ticks = np.arange(int(self._duration * rate) - 1) + 0.5
        ticks = ticks + self._random.uniform(-JITTER, JITTER, len(ticks))
        return ticks[self._random.uniform(size=len(ticks)) > LOST] / rate


def measured(
    parts: list[Simulation],
    rate: float,
    seed: int,
    others: dict[str, tuple[str, Array]] = {},  # noqa: B006
) -> list[Signal]:
    """Commands, power and temperature of every channel, and other true courses, all as read."""
    truth = parts[0].parameters
    time, voltage = _joined(parts, "time"), _joined(parts, "voltage")
    kelvin = _joined(parts, "temperature")
    sent = np.flatnonzero(np.diff(np.floor(time / COMMAND_PERIOD + 1e-6), prepend=-1.0))
    signals = [Signal("voltage_command", "V", time[sent], voltage[sent])]
    clocks = Clocks(seed, float(time[-1]))

    def read(name: str, unit: str, clock: Array, values: Array, zero: float = 0.0) -> None:
        own = np.random.SeedSequence([seed, len(signals) - 1])
        sensor = Instrument.of(_SETTINGS, name.rpartition(".")[2], own)
        signals.append(Signal(name, unit, clock, np.array(sensor.read_all(values - zero)) + zero))

    for i, channel in enumerate(truth["bench.channels"]):
        clock = clocks.at(rate)
        volts = voltage[np.clip(np.searchsorted(time, clock, side="right") - 1, 0, None), i]
        read(f"{channel}.voltage", "V", clock, volts)
        read(f"{channel}.current", "A", clock, volts / truth["wire.resistance"])
        clock = clocks.at(0.8 * rate)
        warm = np.interp(clock, time, kelvin[:, i])
        read(f"{channel}.temperature", "K", clock, warm, CELSIUS_ZERO)
    if others:
        clock = clocks.at(rate)
        for name, (unit, values) in others.items():
            read(name, unit, clock, np.interp(clock, time, values))
    return signals
