"""A simulated bench: physics and sensors, sampled at the hardware's rates; its time in step with
the commands; and a run on it under all rules of a real one, as fast as possible. No ROS."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from sma_bench.errors import InputError, errors_in
from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.live.recording import Readiness
from sma_bench.live.run import ABORTED, DONE, OpenLoop, Run, Surroundings
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench
from sma_bench.physics.boundary import moves_tip
from sma_bench.physics.material import direct_reading
from sma_bench.protocols import Protocol
from sma_bench.records.record import Signal

NANOSECONDS, REAL_TIME = 1_000_000_000, 1.0
STANDS = "this load imposes no motion: the elongation is held at 0"
RATES = ("power", "temperature", "mechanics", "ambient")
_SLOW_DRIVER_LEAD = 0.5  # of the command timeout: lead of simulated time over a slow driver
_DEBT = 0.01  # wall s of delay that are caught up; longer ones (waiting for a driver) are not
_SETTLE = 0.1  # wall s until all commands sent before have arrived
_PERIOD_NS, _TIMEOUT = 20_000_000, 1.0  # ns of a simulated run's commands; s without readings


class GroupReading(NamedTuple):
    """Readings of one group of instruments."""

    kind: str
    time: int  # ns since the start
    # power: (V, A) of every channel; temperature: degC of every channel; ambient: degC; mechanics:
    # (elongation m, force N) of a wire, or (front m, back m) of the range sensors beside a tip
    values: list[Any]


class VirtualBench:
    """Steps the physics from one sample instant to the next and reads the instruments there. When
    heating begins they draw new noise, by seed and pulse, so that waiting times do not matter."""

    def __init__(self, parameters: Parameters, settings: Mapping[str, Any]) -> None:
        self.channels: tuple[str, ...] = parameters["bench.channels"]
        self.composite, self.moves = moves_tip(parameters), load_kind(parameters) != "clamped"
        # The first step may compile the physics for seconds: do it before the first reading.
        Bench(parameters).advance(np.zeros(len(self.channels)), 1e-3)
        self._bench, self._settings = Bench(parameters), settings
        self._standoff = settings["sensor.range_standoff"]
        self._taken, self._due = dict.fromkeys(RATES, 0), dict.fromkeys(RATES, 0)
        self._time, self._pulses, self._driven = 0, 0, False
        self._build_instruments()

    def advance(self, voltage: tuple[float, ...], until: int) -> Iterator[GroupReading]:
        """Readings in time order, with `voltage` (one per channel) held until `until` ns."""
        volts, driven = np.array(voltage), any(voltage)
        if driven and not self._driven:
            self._pulses += 1
            self._build_instruments()
        self._driven = driven
        while (due := min(self._due.values())) < until:
            self._step(volts, due)
            for kind in (kind for kind in RATES if self._due[kind] == due):
                yield GroupReading(kind, due, self._read(kind, voltage))
                self._taken[kind] += 1
                rate = self._settings[f"rate.{kind}"]
                self._due[kind] = round(self._taken[kind] * NANOSECONDS / rate)
        self._step(volts, until)

    def _step(self, volts: np.ndarray, until: int) -> None:
        if until > self._time:
            self._bench.advance(volts, (until - self._time) / NANOSECONDS)
            self._time = until

    def _build_instruments(self) -> None:
        sequence = np.random.SeedSequence([self._settings["seed"], self._pulses])
        wires = len(self.channels)
        counts = {"voltage": wires, "current": wires, "temperature": wires + 1,  # the last: the air
                  "range": 2, "force": 1}
        self._instruments = {of: [Instrument(self._settings, of, s) for s in sequence.spawn(count)]
                             for of, count in counts.items()}

    def _read(self, kind: str, voltage: tuple[float, ...]) -> list[Any]:
        """Readings of a group's true values."""
        bench = self._bench

        def read(quantity: str, true: list[float]) -> list[float]:
            instruments = self._instruments[quantity][: len(true)]
            return [one.read(value) for one, value in zip(instruments, true, strict=True)]

        if kind == "power":
            volts, amperes = direct_reading(bench.parameters, voltage, bench.current_at(voltage))
            both = read("voltage", volts.tolist()), read("current", amperes.tolist())
            return list(zip(*both, strict=True))
        if kind == "temperature":
            return read("temperature", (bench.temperature_reading - CELSIUS_ZERO).tolist())
        if kind == "ambient":
            air = bench.ambient_temperature - CELSIUS_ZERO
            return [self._instruments["temperature"][-1].read(air)]
        position = bench.deflection_reading
        if self.composite:
            # Bending towards the front shortens the front sensor's distance.
            return read("range", [self._standoff - position, self._standoff + position])
        # If the frame holds the clamps there is no elongation.
        elongation = read("range", [position]) if self.moves else [0.0]
        return elongation + read("force", [float(bench.force.sum())])


class Lockstep:
    """Couples simulated time to the commands, so that results do not depend on the machine's load:
    each command allows one slice of time, as long as their period. If a driver is silent for
    `patience` s of wall time it may be slower than declared, and simulated time may run further
    ahead of it from then on; or it is gone, and the command timeout acts as on the real bench.
    Times in s; `simulated` is from the start of the simulation, `wall` a steady clock."""

    def __init__(self, slice_length: float, speed: float, command_timeout: float,
                 patience: float) -> None:
        self._slice = self._lead = slice_length
        self._pace = slice_length / speed
        self._timeout, self._patience = command_timeout, patience
        self._commanded, self._given_up = -math.inf, False
        self._due: float | None = None
        self._waiting_since: float | None = None

    def commanded(self, simulated: float, wall: float) -> None:
        """A command was accepted at `simulated` s."""
        # During a silence time ran freely, and more commands may already be on their way. If each
        # allowed a slice, the driver would stay a varying number of slices behind: let them arrive.
        if simulated - self._commanded > self._timeout:
            self._lead = self._slice
            self._due = max(self._due or wall, wall + _SETTLE)
        self._commanded, self._waiting_since, self._given_up = simulated, None, False

    def may_advance(self, simulated: float, wall: float) -> bool:
        """True when the next slice, which starts at `simulated` s, may be run now."""
        due = wall if self._due is None else self._due
        if wall < due or self._must_wait(simulated, wall):
            return False
        self._due = max(due, wall - _DEBT) + self._pace
        return True

    def _must_wait(self, simulated: float, wall: float) -> bool:
        silence = simulated - self._commanded
        ahead = silence + self._slice <= self._lead * (1.0 + 1e-6)
        if self._given_up or silence > self._timeout or ahead:
            return False
        since = self._waiting_since = wall if self._waiting_since is None else self._waiting_since
        if wall - since <= self._patience:
            return True
        slow = max(self._slice, _SLOW_DRIVER_LEAD * self._timeout)
        self._given_up, self._lead, self._waiting_since = self._lead >= slow, slow, None
        return False


class SimulatedRun:
    """A run of a simulated bench with the parameters `hidden`, under the limits of `stated`."""

    def __init__(self, hidden: Parameters, stated: Parameters, seed: int) -> None:
        self._bench = VirtualBench(hidden, {p.name: p.default for p in SIMULATOR} | {"seed": seed})
        self._limits = Limits.from_parameters(stated)
        channels = self._bench.channels
        self._guard = Guard(channels, ("power", "temperature"), _TIMEOUT)
        self._volts, self._now = (0.0,) * len(channels), 0.0
        self._read: dict[tuple[str, str], list[tuple[float, float]]] = {}
        self._markers: list[tuple[float, str]] = []
        self._run = Run(self, OpenLoop(), self._guard, Readiness(), len(channels))

    def follow(self, protocol: Protocol) -> tuple[list[Signal], list[tuple[float, str]]]:
        """Signals as a recorder has them, and markers. InputError: the run was aborted."""
        step = 0
        while self._run.state not in (DONE, ABORTED):
            step += 1
            for reading in self._bench.advance(self._volts, step * _PERIOD_NS):
                self._take(reading)
            self._now = step * _PERIOD_NS / NANOSECONDS
            if step == int(_TIMEOUT * NANOSECONDS / _PERIOD_NS) // 2:
                with errors_in(protocol.name):
                    self._run.start(self._now, lambda: protocol)
            self._run.tick(self._now, self._now)
        if self._run.state == ABORTED:
            raise InputError(f"{protocol.name}: {self._run.state_text}")
        signals = [Signal(*name, *np.array(samples).T) for name, samples in self._read.items()]
        return signals, self._markers

    def _take(self, reading: GroupReading) -> None:
        """Pass a reading to the guard and to the signals."""
        time, values = reading.time / NANOSECONDS, {}
        if reading.kind == "power":
            for channel, (volt, ampere) in zip(self._bench.channels, reading.values, strict=True):
                self._guard.power(channel, volt, ampere, time, time, self._limits)
                values[f"{channel}.voltage", "V"] = volt
                values[f"{channel}.current", "A"] = ampere
        elif reading.kind == "temperature":
            for channel, celsius in zip(self._bench.channels, reading.values, strict=True):
                kelvin = values[f"{channel}.temperature", "K"] = celsius + CELSIUS_ZERO
                self._guard.temperature(channel, kelvin, time, time, self._limits)
        elif reading.kind == "mechanics":
            one, other = reading.values
            if self._bench.composite:
                values["deflection", "m"] = 0.5 * (other - one)
            else:
                values["elongation", "m"], values["force", "N"] = one, other
        for name, value in values.items():
            self._read.setdefault(name, []).append((time, value))

    def surroundings(self) -> Surroundings:
        return Surroundings()

    def send(self, voltage: list[float]) -> None:
        self._volts = tuple(voltage)

    def mark(self, step: str) -> None:
        self._markers.append((self._now, step))

    def enter(self, state: str) -> None: ...
    def show(self, progress: Mapping[str, Any]) -> None: ...
