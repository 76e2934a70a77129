"""Records of the two simulated rigs: protocol or controller, physics, sensors."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.control import TemperatureController
from sma_bench.control.closed_loop import Loop, run_temperature
from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, Simulation, simulate
from sma_bench.protocols import load_protocol
from sma_bench.protocols.references import TEMPERATURE, load_reference
from sma_bench.records.record import Record, Signal
from sma_bench.synthetic.sensors import STANDOFF, Sensors, clock, whole_nanoseconds

Array = NDArray[np.float64]

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
    if len(parameters["bench.channels"]) > 1:
        signals += _deflection(run, sensors, duration)
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
    loop = Loop(period=COMMAND_PERIOD, late=1, noise=0.08, resolution=0.1, seed=seed)
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
            read = sensors.read(quantity, _at(run, time, values))
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
