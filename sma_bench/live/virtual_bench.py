"""The bench in software: physics behind instruments, sampled at the hardware's rates, and how far
its time may go: not faster than asked, not ahead of an active driver. No ROS.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import Bench
from sma_bench.physics.boundary import moves_tip
from sma_bench.physics.heat import direct_reading

NANOSECONDS = 1_000_000_000
RATES = ("power", "temperature", "mechanics", "ambient")


class GroupReading(NamedTuple):
    """What one group of instruments read at `time` ns since the start.

    `values` per kind: power, (V, A) of every channel; temperature, degC of every channel; ambient,
    degC; mechanics, (elongation m, force N) of a wire, or (front m, back m) of the range sensors
    beside a tip.
    """

    kind: str
    time: int
    values: list[Any]


class VirtualBench:
    """Steps the physics from one sample instant to the next and reads the instruments there.

    Whenever the wires are switched on after a rest, the instruments draw new noise from the seed
    and the number of that pulse: the readings of a protocol do not depend on how long the bench
    waited before it.
    """

    def __init__(self, parameters: Parameters, settings: Mapping[str, Any]) -> None:
        """`settings` are the simulator node's own parameters."""
        self.channels: tuple[str, ...] = parameters["bench.channels"]
        self.composite = moves_tip(parameters)
        self.moves = load_kind(parameters) != "clamped"
        # The first step may compile the physics for seconds: not between two readings.
        Bench(parameters).advance(np.zeros(len(self.channels)), 1e-3)
        self._bench = Bench(parameters)
        self._standoff = settings["sensor.range_standoff"]
        self._rates = {kind: settings[f"rate.{kind}"] for kind in RATES}
        self._taken = dict.fromkeys(RATES, 0)
        self._due = dict.fromkeys(RATES, 0)
        self._time = 0
        self._settings = settings
        self._pulses = 0
        self._driven = False
        self._build_instruments()

    def advance(self, voltage: tuple[float, ...], until: int) -> Iterator[GroupReading]:
        """Readings in the order of time while `voltage` (one per channel) is held `until` ns."""
        volts = np.array(voltage)
        driven = any(voltage)
        if driven and not self._driven:
            self._pulses += 1
            self._build_instruments()
        self._driven = driven
        while (due := min(self._due.values())) < until:
            self._step(volts, due)
            for kind in RATES:
                if self._due[kind] == due:
                    yield GroupReading(kind, due, self._read(kind, voltage))
                    self._taken[kind] += 1
                    self._due[kind] = round(self._taken[kind] * NANOSECONDS / self._rates[kind])
        self._step(volts, until)

    def _step(self, volts: np.ndarray, until: int) -> None:
        if until > self._time:
            self._bench.advance(volts, (until - self._time) / NANOSECONDS)
            self._time = until

    def _build_instruments(self) -> None:
        sequence = np.random.SeedSequence([self._settings["seed"], self._pulses])
        wires = len(self.channels)
        # The last thermometer is the air's.
        counts = {
            "voltage": wires, "current": wires, "temperature": wires + 1, "range": 2, "force": 1,
        }
        self._instruments = {
            quantity: [
                Instrument.of(self._settings, quantity, seed) for seed in sequence.spawn(count)
            ]
            for quantity, count in counts.items()
        }

    def _of(self, quantity: str, true: list[float]) -> list[float]:
        """Readings of true values by the first instruments of a quantity."""
        instruments = self._instruments[quantity][: len(true)]
        return [one.read(value) for one, value in zip(instruments, true, strict=True)]

    def _read(self, kind: str, voltage: tuple[float, ...]) -> list[Any]:
        bench = self._bench
        if kind == "power":
            volts, amperes = direct_reading(bench.parameters, voltage, bench.current(voltage))
            read = self._of("voltage", volts.tolist()), self._of("current", amperes.tolist())
            return list(zip(*read, strict=True))
        if kind == "temperature":
            return self._of("temperature", (bench.temperature_reading - CELSIUS_ZERO).tolist())
        if kind == "ambient":
            air = self._instruments["temperature"][-1]
            return [air.read(bench.ambient_temperature - CELSIUS_ZERO)]
        if self.composite:
            # Bending to the front brings the tip nearer to the front sensor.
            deflection = bench.deflection_reading
            return self._of("range", [self._standoff - deflection, self._standoff + deflection])
        # Where the frame holds the clamps there is no elongation.
        elongation = self._of("range", [bench.deflection_reading]) if self.moves else [0.0]
        return elongation + self._of("force", [float(bench.force.sum())])


# Of the command timeout: how far simulated time may run ahead of a driver that is slower than
# declared.
_SLOW_DRIVER_LEAD = 0.5
# Wall seconds of delay that are caught up; longer ones (waiting for a driver) are not.
_DEBT = 0.01
# Wall seconds in which all that was sent before is surely heard.
_SETTLE = 0.1
REAL_TIME = 1.0


class Lockstep:
    """Couples simulated time to the commands, so that results do not depend on the machine's load.

    Simulated time runs in slices, as long as the period of the commands. While commands come, one
    slice is run for each. A driver that stays away for `patience` s of wall time is either slower
    than declared, and is waited for less often from then on, or gone, and its silence runs into
    the command timeout as it would on the real bench.
    At real time it is the other way round: time waits for nobody, and every delay is caught up.

    All times in s; `simulated` counts from the start of the simulation, `wall` is a steady clock.
    """

    def __init__(
        self, slice_length: float, speed: float, command_timeout: float, patience: float
    ) -> None:
        self._slice = slice_length
        self._pace = slice_length / speed
        self._real_time = speed <= REAL_TIME
        self._timeout = command_timeout
        self._patience = patience
        self._lead = slice_length
        self._commanded = -math.inf
        self._due: float | None = None
        self._waiting_since: float | None = None
        self._given_up = False

    def commanded(self, simulated: float, wall: float) -> None:
        """A command was accepted at `simulated` s.

        The first after a silence found time running freely: others are on their way, and had each
        its slice, the driver would stay so many slices behind, sometimes one less.
        """
        if simulated - self._commanded > self._timeout:
            self._lead = self._slice
            if not self._real_time:
                self._due = max(self._due or wall, wall + _SETTLE)
        self._commanded = simulated
        self._waiting_since = None
        self._given_up = False

    def may_advance(self, simulated: float, wall: float) -> bool:
        """True when the next slice, which starts at `simulated` s, may be run now."""
        due = wall if self._due is None else self._due
        if wall < due or self._must_wait(simulated, wall):
            return False
        self._due = (due if self._real_time else max(due, wall - _DEBT)) + self._pace
        return True

    def _must_wait(self, simulated: float, wall: float) -> bool:
        silence = simulated - self._commanded
        if self._real_time or self._given_up or silence > self._timeout:
            return False
        if silence + self._slice <= self._lead * (1.0 + 1e-6):
            return False
        if self._waiting_since is None:
            self._waiting_since = wall
        if wall - self._waiting_since <= self._patience:
            return True
        slow = max(self._slice, _SLOW_DRIVER_LEAD * self._timeout)
        self._given_up = self._lead >= slow
        self._lead = slow
        self._waiting_since = None
        return False
