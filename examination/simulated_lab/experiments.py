"""The experiments of a simulated lab: protocol, bench, instruments, bag."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from examination.simulated_lab.drawn_bench import DrawnBench
from examination.simulated_lab.instruments import Course, Instruments
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length_from_mass
from sma_bench.physics import Boundary, Simulation, simulate
from sma_bench.physics.bending import wire_section
from sma_bench.protocols import Protocol, parse_protocol
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record

COMMAND_PERIOD = 0.05
STEP = 0.0025
LOADS = (10e6, 50e6, 100e6, 150e6, 200e6)
PRETENSION = 0.002
STANDOFF = 0.1
_HEATED = 25.0
_REST = 15.0
_LOADED_AT, _LOADING = 14.0, 1.0  # s, when the wire is cold and at rest


def record_everything(bench: DrawnBench, folder: Path, seed: int) -> list[Path]:
    """Run every experiment once and write its bag; the paths."""
    paths = []
    for number, (name, experiment) in enumerate(EXPERIMENTS.items()):
        path = folder / name
        write_record(path, experiment(bench.truth, 100 * seed + number))
        paths.append(path)
    return paths


def staircase(truth: Parameters, seed: int) -> list[Signal]:
    """E1, E2: voltage up and down in steps of 30 s."""
    wire = one_wire(truth)
    peak = voltage_for(truth, truth["wire.austenite_finish_temperature"] + 20.0)
    step = peak / 8.0
    steps = [
        {"kind": "staircase", "start": 0.0, "stop": peak, "increment": step, "dwell": 30.0},
        {"kind": "staircase", "start": peak - step, "stop": 0.0, "increment": step, "dwell": 30.0},
    ]
    return _electrical(wire, _protocol(wire, steps), seed, rate=20.0)


def ramp(truth: Parameters, seed: int) -> list[Signal]:
    """E3: four ramps that stay below A_s."""
    wire = one_wire(truth)
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 8.0)
    steps = [
        {"kind": "ramp", "start": 0.0, "stop": peak, "duration": 7.0},
        {"kind": "rest", "duration": 12.0},
    ]
    return _electrical(wire, _protocol(wire, steps, repeat=4), seed, rate=100.0)


def isobaric(truth: Parameters, seed: int) -> list[Signal]:
    """E6: the load frame holds five loads in turn, the wire is heated and cooled under each."""
    wire = one_wire(truth)
    hottest = truth["wire.austenite_finish_temperature"] + 20.0
    steps: list[dict[str, Any]] = []
    for load in LOADS:
        peak = voltage_for(truth, hottest + load / truth["wire.stress_influence_austenite"])
        steps += [
            {"kind": "rest", "duration": _REST},
            {"kind": "triangle", "peak": peak, "rise": _HEATED, "fall": _HEATED},
        ]
    steps.append({"kind": "rest", "duration": _REST})
    protocol = _protocol(wire, steps)
    time, voltage = _held(protocol)
    period = _REST + 2.0 * _HEATED
    changes = _LOADED_AT + period * np.arange(len(LOADS))
    stress = np.interp(
        time,
        np.column_stack([changes, changes + _LOADING]).ravel(),
        np.column_stack([(0.0, *LOADS[:-1]), LOADS]).ravel(),
    )
    parts = _under_loads(wire, time, voltage, stress)
    force = Course(time, stress * wire_section(wire))
    return _load_frame(wire, parts, time, voltage, seed, force=force)


def clamped(truth: Parameters, seed: int) -> list[Signal]:
    """E8: the wire clamped under tension, a staircase below A_s."""
    wire = one_wire(truth)
    peak = voltage_for(truth, truth["wire.austenite_start_temperature"] - 4.0)
    levels = [0.0, *(peak * math.sqrt(share) for share in (0.25, 0.5, 0.75, 1.0, 0.5, 0.0))]
    steps = [
        {"kind": "step", "level": level, "duration": 20.0} if level else
        {"kind": "rest", "duration": 20.0}
        for level in levels
    ]
    time, voltage = _held(_protocol(wire, steps))
    length = PRETENSION * wire_length_from_mass(wire)
    part = simulate(wire, time, voltage, boundary=Boundary.clamped(-PRETENSION))
    held = Course(time, np.full(len(time), length))
    return _load_frame(wire, [part], time, voltage, seed, elongation=held)


def composite_triangle(truth: Parameters, seed: int) -> list[Signal]:
    """E12: triangles, front and back by turns."""
    peak = _bending_voltage(truth)
    return _composite(truth, seed, [
        step
        for side in ("front", "back")
        for step in (
            {"kind": "triangle", "drive": side, "peak": peak, "rise": 15.0, "fall": 15.0},
            {"kind": "rest", "duration": 15.0},
        )
    ])


def composite_step(truth: Parameters, seed: int) -> list[Signal]:
    """E12: steps, front and back by turns, the second time not all the way."""
    peak = _bending_voltage(truth)
    return _composite(truth, seed, [
        step
        for share in (1.0, 0.88)
        for side in ("front", "back")
        for step in (
            {"kind": "step", "drive": side, "level": share * peak, "duration": 12.0},
            {"kind": "rest", "duration": 15.0},
        )
    ])


EXPERIMENTS: dict[str, Callable[[Parameters, int], list[Signal]]] = {
    "staircase": staircase,
    "ramp": ramp,
    "isobaric": isobaric,
    "clamped": clamped,
    "composite_triangle": composite_triangle,
    "composite_step": composite_step,
}


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
    stiff = max(
        truth["composite.stress_per_deflection_front"],
        truth["composite.stress_per_deflection_back"],
    )
    strain = truth["wire.maximum_recoverable_strain"]
    stress = 0.5 * stiff * truth["composite.deflection_per_strain"] * strain
    shift = stress / truth["wire.stress_influence_austenite"]
    return voltage_for(truth, truth["wire.austenite_finish_temperature"] + shift + 15.0)


def _protocol(parameters: Parameters, steps: list[dict[str, Any]], repeat: int = 1) -> Protocol:
    document = {"steps": [{"kind": "rest", "duration": 3.0}, *steps], "repeat": repeat}
    return parse_protocol(document, parameters)


def _held(protocol: Protocol) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) s every 2.5 ms and the voltage (n, w) that the last command left there."""
    time = np.arange(int(round((protocol.duration + 1.0) / STEP))) * STEP
    commanded = np.floor(time / COMMAND_PERIOD + 1e-6) * COMMAND_PERIOD
    return time, protocol.voltages(commanded)


def _under_loads(
    wire: Parameters, time: np.ndarray, voltage: np.ndarray, stress: np.ndarray
) -> list[Simulation]:
    """Simulations in a row, one for each stretch of constant stress [Pa]."""
    edges = np.flatnonzero(np.diff(stress)) + 1
    parts: list[Simulation] = []
    for start, stop in zip([0, *edges], [*edges, len(time)], strict=True):
        first = max(start - 1, 0)
        parts.append(
            simulate(
                wire, time[first:stop], voltage[first:stop],
                initial=parts[-1].final if parts else None,
                boundary=Boundary.held_stress(float(stress[start])),
            )
        )
    return parts


def _joined(parts: Iterable[Simulation], name: str) -> np.ndarray:
    arrays = [getattr(part, name)[:, 0] for part in parts]
    return np.concatenate([arrays[0], *(array[1:] for array in arrays[1:])])


def _electrical(wire: Parameters, protocol: Protocol, seed: int, rate: float) -> list[Signal]:
    time, voltage = _held(protocol)
    instruments = Instruments(seed, float(time[-1]))
    temperature = simulate(wire, time, voltage).temperature
    return _channels(instruments, wire, time, voltage, temperature, rate)


def _channels(
    instruments: Instruments, parameters: Parameters, time: np.ndarray, voltage: np.ndarray,
    temperature: np.ndarray, rate: float,
) -> list[Signal]:
    """Commands, power and temperature of every channel."""
    sent = np.flatnonzero(np.diff(np.floor(time / COMMAND_PERIOD + 1e-6), prepend=-1.0))
    signals = [Signal("voltage_command", "V", time[sent], voltage[sent])]
    for i, channel in enumerate(parameters["bench.channels"]):
        clock = instruments.clock(rate)
        volts = Course(time, voltage[:, i], held=True)
        amperes = Course(time, voltage[:, i] / parameters["wire.resistance"], held=True)
        kelvin = Course(time, temperature[:, i])
        signals += [
            instruments.read(f"{channel}.voltage", "voltage", volts, clock),
            instruments.read(f"{channel}.current", "current", amperes, clock),
            instruments.read(
                f"{channel}.temperature", "temperature", kelvin, instruments.clock(0.8 * rate)
            ),
        ]
    return signals


def _load_frame(
    wire: Parameters, parts: list[Simulation], time: np.ndarray, voltage: np.ndarray, seed: int,
    *, force: Course | None = None, elongation: Course | None = None,
) -> list[Signal]:
    instruments = Instruments(seed, float(time[-1]))
    temperature = _joined(parts, "temperature")[:, np.newaxis]
    signals = _channels(instruments, wire, time, voltage, temperature, rate=50.0)
    clock = instruments.clock(50.0)
    length = wire_length_from_mass(wire)
    force = force or Course(time, _joined(parts, "force"))
    elongation = elongation or Course(time, -length * _joined(parts, "contraction"))
    return [
        *signals,
        instruments.read("force", "force", force, clock),
        instruments.read("elongation", "elongation", elongation, clock),
    ]


def _composite(truth: Parameters, seed: int, steps: list[dict[str, Any]]) -> list[Signal]:
    time, voltage = _held(_protocol(truth, steps))
    instruments = Instruments(seed, float(time[-1]))
    course = simulate(truth, time, voltage)
    signals = _channels(instruments, truth, time, voltage, course.temperature, rate=50.0)
    clock = instruments.clock(50.0)
    for side, sign in (("front", -1.0), ("back", 1.0)):
        distance = Course(time, STANDOFF + sign * course.deflection)
        signals.append(instruments.read(f"{side}.range", "range", distance, clock))
    return signals
