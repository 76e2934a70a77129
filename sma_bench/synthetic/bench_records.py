"""Records of a simulated bench: exact, or with the noise of the simulator node's instruments."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import Limits, Wire, broken, power_rules, temperature_rules
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench, Boundary, Simulation, simulate
from sma_bench.physics.bending import channel_section
from sma_bench.physics.boundary import moves_tip
from sma_bench.physics.effects import active_effects
from sma_bench.physics.material import direct_reading
from sma_bench.progress import Report, in_turn, silent
from sma_bench.protocols import TEMPERATURE, Protocol, Waiting, load_protocol
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import Record, Signal

# The sensors of a synthetic record: the simulator node's noise, resolution and rates.
_SETTINGS = {p.name: float(p.default) for p in SIMULATOR if isinstance(p.default, float)}
_STANDOFF = _SETTINGS["sensor.range_standoff"]
COMMAND_PERIOD, REST = 0.05, 3.0  # s; s at 0 V before and after a protocol
PRETENSION = 0.002  # strain at which the wire of E8 is clamped, so that it does not get slack
_ROUNDING = 1e-6  # of a period
_FINE_STEP, _PULL_STEP = 0.0025, 0.1  # s: with effects; of a held force
_CAMERA_NOISE, _CAMERA_STEP = 0.08, 0.1  # K, of the camera that controls E8
_OF_SAMPLES = ("time", "voltage", "temperature", "martensite_fraction", "stress", "contraction",
               "bending", "temperature_reading", "mount", "sag")


def simulate_finely(parameters: Parameters, time: ArrayLike, voltage: ArrayLike,
                    elongation: ArrayLike | None = None) -> Simulation:
    """`simulate` at the samples, with steps between them that are short enough for effects."""
    fine, volts, first = _refined(parameters, time, voltage)
    if elongation is not None and len(fine) > np.size(time) == np.size(elongation):
        elongation = np.interp(fine, np.asarray(time), np.asarray(elongation))
    run = simulate(parameters, fine, volts, elongation=elongation)
    return replace(run, **{name: getattr(run, name)[first] for name in _OF_SAMPLES})


def _refined(parameters: Parameters, time: ArrayLike,
             voltage: ArrayLike) -> tuple[Array, Array, IntArray]:
    seconds, volts = np.asarray(time, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    gaps = np.diff(seconds) if seconds.ndim == 1 else np.zeros(1)
    if not active_effects(parameters) or not np.all(gaps > 0.0):  # `simulate` refuses such times
        return seconds, volts, np.arange(seconds.size)
    parts = np.append(np.maximum(np.ceil(gaps / _FINE_STEP), 1.0), 1.0).astype(int)
    first = np.cumsum(parts) - parts
    within = np.arange(parts.sum()) - np.repeat(first, parts)
    fine = np.repeat(seconds, parts) + within * np.repeat(np.append(gaps, 0.0) / parts, parts)
    return fine, np.repeat(volts, parts, axis=0), first


def simulate_protocol(protocol: Protocol, parameters: Parameters, period: float) -> Simulation:
    """Simulate a protocol on its bench, sampled every `period` s. InputError: its steps hold forces
    but the load is no held force."""
    bench = protocol.bench(parameters)
    time, voltage = played(protocol, bench, period)
    if not protocol.pulls:
        return simulate_finely(bench, time, voltage)
    if (kind := load_kind(bench)) != "force":
        expected = f"expected load.kind force, not {kind}"
        raise InputError(f"{protocol.name}: its steps hold forces, {expected}")
    fine, volts, first = _refined(bench, time, voltage)
    starts = first[:: max(round(_PULL_STEP / (time[1] - time[0])), 1)]
    edges = np.unique(np.append(starts, len(fine) - 1))
    force = protocol.forces(time, bench["load.force"])
    held = np.interp(fine[edges], time, force) / channel_section(bench)
    frame = Boundary(friction=Boundary.of(bench).friction)
    pulled = Bench(bench, boundary=replace(frame, load=float(held[0])))
    parts = []
    for start, stop, stress in zip(edges[:-1], edges[1:], held[1:].tolist(), strict=True):
        pulled.pull_against(replace(frame, load=stress))
        parts.append(pulled.follow(fine[start : stop + 1], volts[start : stop + 1]))
    joined: dict[str, Any] = {"started": 0.0}
    for name in _OF_SAMPLES:
        rows = [getattr(part, name)[:-1] for part in parts]
        joined[name] = np.concatenate([*rows, getattr(parts[-1], name)[-1:]])[first]
    return replace(parts[-1], **joined)


def played(protocol: Protocol, parameters: Parameters, period: float) -> tuple[Array, Array]:
    """`protocol.sample`, with steps that wait for the simulated bench."""
    if not protocol.waits:
        return protocol.sample(period)
    bench, waiting = Bench(parameters), Waiting(protocol)
    parts = max(round(period / _FINE_STEP), 1) if active_effects(parameters) else 1
    rows: list[Array] = []
    passed_over = 0.0
    while True:
        now = len(rows) * period
        kelvin = bench.temperature_reading.tolist()
        for channel, value in zip(parameters["bench.channels"], kelvin, strict=True):
            waiting.heard("temperature", channel, value, now)
        waiting.heard("deflection", "", bench.deflection_reading, now)
        if now + passed_over < protocol.duration:
            passed_over += waiting.passed_over(now + passed_over, now)
        rows.append(protocol.level(now + passed_over))
        if not protocol.step_at(now + passed_over):
            return np.arange(len(rows), dtype=np.float64) * np.float64(period), np.array(rows)
        for _ in range(parts):
            bench.advance(rows[-1], period / parts)


def limits_passed(simulation: Simulation, parameters: Parameters) -> list[Finding]:
    """Warnings of where a real bench with these parameters would have gone to 0 V."""
    limits = Limits.from_parameters(parameters)
    volts = np.abs(direct_reading(simulation.parameters, simulation.voltage, simulation.current)[0])
    findings = []
    for k, channel in enumerate(simulation.parameters["bench.channels"]):
        kelvin, ampere = simulation.temperature[:, k], np.abs(simulation.current[:, k])
        wire = Wire(channel, ampere=float(ampere.max()), kelvin=float(kelvin.max()))
        driven = Wire(channel, volt=float(volts[:, k].max()))
        for values, limit, rules in (
            (kelvin, limits.maximum_temperature, temperature_rules(wire, limits)),
            (ampere, limits.maximum_current, power_rules(wire, limits)),
            (volts[:, k], limits.highest_reading, power_rules(driven, limits)),
        ):
            for line in broken(rules).values():
                first = simulation.time[np.argmax(values > limit)]
                text = f"{line}: a real bench goes to 0 V at {first:.1f} s"
                findings.append(Finding("warning", "limit", text))
    return findings


def signals_of(simulation: Simulation) -> list[Signal]:
    """Signals of the contract that a bench would measure, without noise."""
    time, signals = simulation.time, []
    volts, amperes = direct_reading(simulation.parameters, simulation.voltage, simulation.current)
    measured = (("voltage", "V", volts), ("current", "A", amperes),
                ("temperature", "K", simulation.temperature_reading))  # fmt: skip
    for k, channel in enumerate(simulation.parameters["bench.channels"]):
        signals += [Signal(f"{channel}.{n}", unit, time, of[:, k]) for n, unit, of in measured]
    if moves_tip(simulation.parameters):
        return [*signals, Signal("deflection", "m", time, simulation.deflection_reading)]
    own = simulation.boundary.lever != 0.0
    elongation = simulation.deflection_reading if own else simulation.elongation[:, 0]
    force = Signal("force", "N", time, simulation.force.sum(axis=1))
    return [*signals, Signal("elongation", "m", time, elongation), force]


def read_signals(signals: Sequence[Signal], seed: int, report: Report = silent) -> list[Signal]:
    """These signals as the simulator node's instruments would read them."""
    seeds = np.random.SeedSequence(seed)
    return [_read(seeds, s)[-1] for s in in_turn(signals, report, lambda s: f"reading {s.name}")]


def _read(seeds: np.random.SeedSequence, signal: Signal, celsius: float = 0.0) -> list[Signal]:
    """A signal as noisy instruments read it; of a deflection, first the two distances that give it.
    `celsius`: K at which the thermometer reads 0."""
    quantity, true = signal.name.rpartition(".")[2], np.asarray(signal.values)

    def read(sensor: str, values: Array, zero: float = 0.0) -> Array:
        return Instrument(_SETTINGS, sensor, seeds.spawn(1)[0]).read_all(values - zero) + zero

    if quantity == "deflection":
        front, back = (read("range", _STANDOFF + sign * true) for sign in (-1.0, 1.0))
        readings = {"front.range": front, "back.range": back, signal.name: 0.5 * (back - front)}
        return [replace(signal, name=name, values=values) for name, values in readings.items()]
    if quantity != "elongation":
        true = read(quantity, true, celsius if quantity == "temperature" else 0.0)
    elif np.ptp(true) > 0.0:
        true = read("range", true)
    return [replace(signal, values=true)]


def protocol_record(name: str, parameters: Parameters, seed: int = 1) -> Record:
    """Run a protocol, by name or path, on the simulated rig of `parameters`. InputError: no such
    protocol, or one that this rig cannot run."""
    protocol = load_protocol(name, parameters)
    rig = "composite rig" if len(parameters["bench.channels"]) > 1 else "wire rig"
    title, duration = f"synthetic {name} on the simulated {rig}", protocol.duration + 2.0 * REST
    return _record(title, parameters, lambda t: protocol.levels(t - REST), duration, seed)


def clamped_staircase_record(parameters: Parameters, seed: int = 1) -> Record:
    """E8: the wire clamped under tension, heated and cooled in steps by the PI controller."""
    from sma_bench.control import TemperatureController  # slow: imports the linear model

    name = "temperature_staircase"
    reference = load_protocol(name, parameters, TEMPERATURE)
    controller = TemperatureController(parameters, COMMAND_PERIOD, delay=COMMAND_PERIOD)
    bench, random = Bench(parameters), np.random.default_rng(seed)
    commanded = [np.zeros(len(parameters["bench.channels"]))]  # each acts a period late
    for k in range(round(reference.duration / COMMAND_PERIOD)):
        kelvin = np.array(bench.temperature)
        kelvin = kelvin + _CAMERA_NOISE * random.standard_normal(kelvin.shape)
        read = np.round(kelvin / _CAMERA_STEP) * _CAMERA_STEP
        commanded.append(controller.step(reference.level(COMMAND_PERIOD * k), read))
        bench.advance(commanded[k], COMMAND_PERIOD)

    def volts(t: Array) -> Array:
        index = np.round(t / COMMAND_PERIOD).astype(int)
        return np.array(commanded[:-1])[np.clip(index, 0, len(commanded) - 2)]

    title, clamps = f"synthetic {name} on the simulated clamped wire", Boundary.clamped(-PRETENSION)
    return _record(title, parameters, volts, reference.duration, seed + 1, clamps)


def _record(title: str, parameters: Parameters, voltage: Callable[[Array], Array], duration: float,
            seed: int, clamped: Boundary | None = None) -> Record:
    """Simulate at every command and reading, so that nothing is interpolated; add noise."""
    # Whole nanoseconds, as in ROS: equal times of clocks with different rates are exactly equal.
    rates = [_SETTINGS[f"rate.{kind}"] for kind in ("power", "temperature", "mechanics")]
    ticks: list[Any] = [np.arange(int(duration / COMMAND_PERIOD) + 1) * COMMAND_PERIOD]
    ticks += [np.arange(int(duration * rate)) / rate for rate in rates]
    ticks = [np.round(t * 1e9) / 1e9 for t in ticks]
    time, (_, power, camera, mechanics) = np.unique(np.concatenate(ticks)), ticks
    commanded = np.floor(time / COMMAND_PERIOD + _ROUNDING) * COMMAND_PERIOD
    signals = signals_of(simulate(parameters, time, voltage(commanded), boundary=clamped))
    if clamped:  # noise of the force is drawn first
        signals = [signals[-1], *signals[:-2]]
    elif load_kind(parameters) == "clamped":  # without a load frame
        signals = signals[:-2]
    clocks = {"voltage": power, "current": power, "temperature": camera}
    seeds, found = np.random.SeedSequence(seed), {}
    for signal in signals:
        at = clocks.get(signal.name.rpartition(".")[2], mechanics)
        true = np.asarray(signal.values)[np.searchsorted(time, at)]
        for read in _read(seeds, replace(signal, time=at, values=true), CELSIUS_ZERO):
            found[read.name] = read
    if clamped:
        found["force"] = found.pop("force")  # but shown last
    return Record(Path(title), 0, found)
