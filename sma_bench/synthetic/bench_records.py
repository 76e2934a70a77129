"""Records of a simulated bench: exact, or as the simulator node's instruments read them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike, NDArray

from sma_bench.control import TemperatureController
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import Limits, current_fault, temperature_fault
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench, Boundary, Simulation, simulate
from sma_bench.physics.bending import channel_section
from sma_bench.physics.boundary import moves_tip
from sma_bench.physics.effects import active_effects
from sma_bench.physics.heat import direct_reading
from sma_bench.progress import Report, in_turn, silent
from sma_bench.protocols import Protocol, Waiting, load_protocol
from sma_bench.protocols.reading import TEMPERATURE, load_reference
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import Record, Signal

# --- Sensors of a synthetic record: the simulator node's noise, resolution and rates.

Array = NDArray[np.float64]

_SETTINGS = {
    parameter.name: float(parameter.default)
    for parameter in SIMULATOR
    if isinstance(parameter.default, float)
}
_NANOSECONDS = 1e9
STANDOFF = _SETTINGS["sensor.range_standoff"]


def clock(kind: str, duration: float) -> Array:
    """(n,) s: when the instruments of a kind (power, temperature, mechanics) read."""
    rate = _SETTINGS[f"rate.{kind}"]
    return whole_nanoseconds(np.arange(int(duration * rate)) / rate)


def whole_nanoseconds(time: npt.ArrayLike) -> Array:
    """Stamps as ROS has them, so that clocks of several rates meet exactly where they meet."""
    return np.asarray(np.round(np.multiply(time, _NANOSECONDS)) / _NANOSECONDS)


class Sensors:
    """All sensors of one record; every reading has noise of its own."""

    def __init__(self, seed: int) -> None:
        """The same seed gives the same noise."""
        self._seeds = np.random.SeedSequence(seed)

    def read(self, quantity: str, values: Array, zero: float = 0.0) -> Array:
        """What a sensor of `quantity` makes of true values (n,) in SI units, with steps that count
        from `zero`."""
        sensor = Instrument.of(_SETTINGS, quantity, self._seeds.spawn(1)[0])
        return sensor.read_all(values - zero) + zero


# --- A simulated bench, and its signals: exact, or as the simulator node's instruments read them.

# s. The paper's model is exact in any step; effects that act within one, latent heat above all,
# need short ones.
_FINE_STEP = 0.0025
_PULL_STEP = 0.1  # s, in which a frame's force stands still
_OF_SAMPLES = ("time", "voltage", "temperature", "martensite_fraction", "stress", "contraction",
               "bending", "temperature_reading")  # fmt: skip


def simulate_finely(parameters: Parameters, time: ArrayLike, voltage: ArrayLike) -> Simulation:
    """`simulate` at these samples, in steps between them that are short enough for effects.

    Args:
        parameters: of the bench; time: (n,) s; voltage: (n, w) V, held to the next sample.

    Raises:
        InputError: as `simulate`.
    """
    fine, volts, first = _refined(parameters, time, voltage)
    run = simulate(parameters, fine, volts)
    if len(first) == len(run.time):
        return run
    return replace(run, **{name: getattr(run, name)[first] for name in _OF_SAMPLES})


def _refined(
    parameters: Parameters, time: ArrayLike, voltage: ArrayLike
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Time and voltage in short enough steps, and where the given samples are among these."""
    seconds, volts = np.asarray(time, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    gaps = np.diff(seconds) if seconds.ndim == 1 else np.zeros(1)
    if not active_effects(parameters) or not np.all(gaps > 0.0):
        # What is wrong with them, the simulation says.
        return seconds, volts, np.arange(seconds.size)
    parts = np.append(np.maximum(np.ceil(gaps / _FINE_STEP), 1.0), 1.0).astype(int)
    first = np.cumsum(parts) - parts
    within = np.arange(parts.sum()) - np.repeat(first, parts)
    fine = np.repeat(seconds, parts) + within * np.repeat(np.append(gaps, 0.0) / parts, parts)
    return fine, np.repeat(volts, parts, axis=0), first


def simulate_protocol(
    protocol: Protocol, parameters: Parameters, period: float
) -> Simulation:
    """A protocol on the bench that runs it, sampled every `period` s; a frame pulls as its steps
    say.

    Raises:
        InputError: steps with forces on a bench whose load is no held force.
    """
    bench = protocol.bench(parameters)
    time, voltage = played(protocol, bench, period)
    if not protocol.pulls:
        return simulate_finely(bench, time, voltage)
    if load_kind(bench) != "force":
        raise InputError(
            f"{protocol.name}: its steps hold forces, expected load.kind force, "
            f"not {load_kind(bench)}"
        )
    return _pulled(bench, time, voltage, protocol.forces(time, bench["load.force"]))


def _pulled(parameters: Parameters, time: Array, voltage: Array, force: Array) -> Simulation:
    """Under a force (n,) N that changes; elongation counts from the wire without any."""
    section = channel_section(parameters)
    fine, volts, first = _refined(parameters, time, voltage)
    edges = np.unique(np.append(first[:: max(round(_PULL_STEP / (time[1] - time[0])), 1)],
                                len(fine) - 1))  # fmt: skip
    held = np.interp(fine[edges], time, force) / section
    bench = Bench(parameters, boundary=Boundary.held_stress(float(held[0])))
    parts = []
    for start, stop, stress in zip(edges[:-1], edges[1:], held[1:].tolist(), strict=True):
        bench.pull_against(Boundary.held_stress(stress))
        parts.append(bench.follow(fine[start : stop + 1], volts[start : stop + 1]))
    joined: dict[str, Any] = {
        name: np.concatenate([
            *(getattr(p, name)[:-1] for p in parts), getattr(parts[-1], name)[-1:]
        ])[first]
        for name in _OF_SAMPLES
    }
    return replace(parts[-1], **joined, started=0.0)


def played(
    protocol: Protocol, parameters: Parameters, period: float
) -> tuple[Array, Array]:
    """`protocol.sample`, each step as long as the simulated bench makes it."""
    if not protocol.waits:
        return protocol.sample(period)
    bench, waiting = Bench(parameters), Waiting(protocol)
    parts = max(round(period / _FINE_STEP), 1) if active_effects(parameters) else 1
    rows: list[Array] = []
    passed_over = 0.0
    while True:
        now = len(rows) * period
        for channel, kelvin in zip(
            parameters["bench.channels"], bench.temperature_reading.tolist(), strict=True
        ):
            waiting.heard("temperature", channel, kelvin, now)
        waiting.heard("deflection", "", bench.deflection_reading, now)
        if now + passed_over < protocol.duration:
            passed_over += waiting.passed_over(now + passed_over, now)
        rows.append(protocol.voltage(now + passed_over))
        if not protocol.step_at(now + passed_over):
            return np.arange(len(rows), dtype=np.float64) * np.float64(period), np.array(rows)
        for _ in range(parts):
            bench.advance(rows[-1], period / parts)


def limits_passed(simulation: Simulation) -> list[Finding]:
    """Where a real bench of these parameters would have gone to 0 V."""
    limits = Limits.from_parameters(simulation.parameters)
    findings = []
    for k, channel in enumerate(simulation.parameters["bench.channels"]):
        for values, limit, fault in (
            (simulation.temperature[:, k], limits.maximum_temperature, temperature_fault),
            (np.abs(simulation.current[:, k]), limits.maximum_current, current_fault),
        ):
            if line := fault(channel, float(values.max()), limits):
                first = simulation.time[np.argmax(values > limit)]
                text = f"{line}: a real bench goes to 0 V at {first:.1f} s"
                findings.append(Finding("warning", "limit", text))
    return findings


def signals_of(simulation: Simulation) -> list[Signal]:
    """Signals of the contract that a bench would have measured."""
    time, channels = simulation.time, simulation.parameters["bench.channels"]
    signals = []
    volts, amperes = direct_reading(simulation.parameters, simulation.voltage, simulation.current)
    for k, channel in enumerate(channels):
        signals += [
            Signal(f"{channel}.voltage", "V", time, volts[:, k]),
            Signal(f"{channel}.current", "A", time, amperes[:, k]),
            Signal(f"{channel}.temperature", "K", time, simulation.temperature_reading[:, k]),
        ]
    if moves_tip(simulation.parameters):
        return [*signals, Signal("deflection", "m", time, simulation.deflection_reading)]
    own = simulation.boundary.lever != 0.0
    elongation = simulation.deflection_reading if own else simulation.elongation[:, 0]
    return [
        *signals,
        Signal("elongation", "m", time, elongation),
        Signal("force", "N", time, simulation.force.sum(axis=1)),
    ]


def read_signals(
    signals: Sequence[Signal], seed: int, report: Report = silent
) -> list[Signal]:
    """The same signals as the simulator node's instruments would read them.

    A deflection is half the difference of two distances; an elongation that never changes is
    clamped.
    """
    read, found = Sensors(seed).read, []
    for signal in in_turn(signals, report, lambda s: f"reading {s.name}"):
        quantity, values = signal.name.rpartition(".")[2], np.asarray(signal.values)
        if quantity == "elongation":
            moves = np.ptp(values) > 0.0
            found.append(replace(signal, values=read("range", values)) if moves else signal)
        elif quantity == "deflection":
            front, back = read("range", STANDOFF - values), read("range", STANDOFF + values)
            found.append(replace(signal, values=0.5 * (back - front)))
        else:
            found.append(replace(signal, values=read(quantity, values)))
    return found


# --- Records of the two simulated rigs: protocol or controller, physics, sensors.

COMMAND_PERIOD = 0.05
REST = 3.0  # s at 0 V before and after
PRETENSION = 0.002  # strain under which the wire of E8 is clamped: it must not become slack
_ROUNDING = 1e-6


def protocol_record(name: str, parameters: Parameters, seed: int = 1) -> Record:
    """Run a protocol on the simulated rig of `parameters`, at rest before and after it.

    Args:
        name: of a protocol, or a path.
        parameters: what the simulated rig is made of.

    Raises:
        InputError: no such protocol, or one that this rig cannot run.
    """
    protocol = load_protocol(name, parameters)
    duration = protocol.duration + 2.0 * REST
    run = _run(parameters, lambda t: protocol.voltages(t - REST), duration)
    sensors = Sensors(seed)
    signals = _electrical(run, sensors, duration)
    if moves_tip(parameters):
        signals += _deflection(run, sensors, duration)
    elif load_kind(parameters) != "clamped":
        time = clock("mechanics", duration)
        elongation, force = _at(run, time, run.deflection_reading), _at(run, time, run.force[:, 0])
        signals += [
            Signal("elongation", "m", time, sensors.read("range", elongation)),
            Signal("force", "N", time, sensors.read("force", force)),
        ]
    rig = "composite rig" if len(parameters["bench.channels"]) > 1 else "wire rig"
    return _record(f"synthetic {name} on the simulated {rig}", signals)


def clamped_staircase_record(
    parameters: Parameters, reference: str = "temperature_staircase", seed: int = 1
) -> Record:
    """E8: the wire clamped under tension, its temperature led up and down by the PI controller.

    Raises:
        InputError: no such reference.
    """
    course = load_reference(reference, parameters, TEMPERATURE)
    controller = TemperatureController(parameters, COMMAND_PERIOD, delay=COMMAND_PERIOD)
    loop = Feedback(period=COMMAND_PERIOD, late=1, noise=0.08, resolution=0.1, seed=seed)
    closed = run_temperature(parameters, controller, course.level, course.duration, loop)

    def volts(t: Array) -> Array:
        index = np.clip(np.round(t / COMMAND_PERIOD).astype(int), 0, len(closed.time) - 1)
        return closed.voltage[index]

    run = _run(parameters, volts, course.duration, Boundary.clamped(-PRETENSION))
    sensors = Sensors(seed + 1)
    time = clock("mechanics", course.duration)
    force = Signal("force", "N", time, sensors.read("force", _at(run, time, run.force[:, 0])))
    signals = [*_electrical(run, sensors, course.duration), force]
    return _record(f"synthetic {reference} on the simulated clamped wire", signals)


def _run(
    parameters: Parameters,
    voltage: Callable[[Array], Array],
    duration: float,
    boundary: Boundary | None = None,
) -> Simulation:
    """Simulate at every command and every reading, so that nothing is interpolated."""
    commands = np.arange(int(duration / COMMAND_PERIOD) + 1) * COMMAND_PERIOD
    clocks = [clock(kind, duration) for kind in ("power", "temperature", "mechanics")]
    time = np.unique(np.concatenate([whole_nanoseconds(commands), *clocks]))
    commanded = np.floor(time / COMMAND_PERIOD + _ROUNDING) * COMMAND_PERIOD
    return simulate(parameters, time, voltage(commanded), boundary=boundary)


def _at(run: Simulation, time: Array, values: Array) -> Array:
    return np.asarray(values[np.searchsorted(run.time, time)])


def _electrical(run: Simulation, sensors: Sensors, duration: float) -> list[Signal]:
    power, camera = clock("power", duration), clock("temperature", duration)
    signals = []
    for k, channel in enumerate(run.parameters["bench.channels"]):
        for quantity, unit, time, values in (
            ("voltage", "V", power, run.voltage[:, k]),
            ("current", "A", power, run.current[:, k]),
            ("temperature", "K", camera, run.temperature[:, k]),
        ):
            # The camera's steps are those of the Celsius scale.
            zero = CELSIUS_ZERO if quantity == "temperature" else 0.0
            read = sensors.read(quantity, _at(run, time, values), zero)
            signals.append(Signal(f"{channel}.{quantity}", unit, time, read))
    return signals


def _deflection(run: Simulation, sensors: Sensors, duration: float) -> list[Signal]:
    """Both range sensors, and the tip's position that follows from them."""
    time = clock("mechanics", duration)
    true = _at(run, time, run.deflection)
    front, back = (sensors.read("range", STANDOFF + sign * true) for sign in (-1.0, 1.0))
    return [
        Signal("front.range", "m", time, front),
        Signal("back.range", "m", time, back),
        Signal("deflection", "m", time, 0.5 * (back - front)),
    ]


def _record(path: str, signals: list[Signal]) -> Record:
    return Record(Path(path), 0, {signal.name: signal for signal in signals})


# --- A controller and a simulated bench in one loop, with sensor noise; no ROS, no clock.

@dataclass(frozen=True, eq=False)
class Feedback:
    """How the loop is closed.

    Attributes:
        period: s between commands.
        late: periods from a reading to the command that answers it.
        noise: standard deviation of a reading, in its unit; seed: of the noise.
        resolution: step of a reading; 0 for none.
    """

    period: float = 0.05
    late: int = 0
    noise: float = 0.0
    resolution: float = 0.0
    seed: int = 1


@dataclass(frozen=True, eq=False)
class ClosedLoopRun:
    """A run: reference, actual and measured (n,) or (n, w), voltage (n, w) at time (n,) s."""

    time: Array
    reference: Array
    actual: Array
    measured: Array
    voltage: Array


def run_temperature(
    bench: Parameters,
    controller: TemperatureController,
    reference: Callable[[float], Array],
    duration: float,
    loop: Feedback,
) -> ClosedLoopRun:
    """Run a temperature controller on a bench whose parameters it may not know.

    Args:
        bench: what the bench really is; reference: (w,) K at a time in s.
    """
    return run_loop(
        bench,
        lambda plant: np.array(plant.temperature),
        reference,
        lambda wanted, read, _: controller.step(wanted, read, loop.period),
        duration,
        loop,
    )


def run_loop(
    bench: Parameters,
    observe: Callable[[Bench], Array],
    reference: Callable[[float], Array],
    control: Callable[[Array, Array, Array], Array],
    duration: float,
    loop: Feedback,
) -> ClosedLoopRun:
    """Run a controller on a simulated bench.

    Args:
        bench: what it really is; observe: what is controlled, of it.
        reference: at a time in s; control: voltages (w,) for the reference, a reading of what is
            observed, and the reference a period later.
    """
    plant, random = Bench(bench), np.random.default_rng(loop.seed)
    waiting = [np.zeros(len(bench["bench.channels"]))] * loop.late
    time: Array = loop.period * np.arange(round(duration / loop.period), dtype=np.float64)
    rows: list[tuple[Array, Array, Array, Array]] = []
    for t in time:
        actual = observe(plant)
        read = actual + loop.noise * random.standard_normal(actual.shape)
        if loop.resolution > 0.0:
            read = np.round(read / loop.resolution) * loop.resolution
        wanted = np.asarray(reference(float(t)), float)
        waiting.append(control(wanted, read, np.asarray(reference(float(t) + loop.period), float)))
        volts = waiting.pop(0)
        rows.append((wanted, actual, read, volts))
        plant.advance(volts, loop.period)
    return ClosedLoopRun(time, *(np.array(column) for column in zip(*rows, strict=True)))
