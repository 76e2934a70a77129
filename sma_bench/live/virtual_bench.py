"""The bench in software: physics behind instruments, sampled at the hardware's rates. No ROS."""

from collections.abc import Callable, Iterator, Mapping
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


class Reading(NamedTuple):
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
        self._readers: dict[str, Callable[[tuple[float, ...]], list[Any]]] = {
            "power": self._read_power,
            "temperature": self._read_temperature,
            "mechanics": self._read_ranges if self.composite else self._read_load_frame,
            "ambient": self._read_ambient,
        }

    def advance(self, voltage: tuple[float, ...], until: int) -> Iterator[Reading]:
        """Readings in the order of time while `voltage` (one per channel) is held `until` ns."""
        volts = np.array(voltage)
        self._notice_pulse(any(voltage))
        while (due := min(self._due.values())) < until:
            self._step(volts, due)
            for kind in RATES:
                if self._due[kind] == due:
                    yield Reading(kind, due, self._readers[kind](voltage))
                    self._schedule(kind)
        self._step(volts, until)

    def _step(self, volts: np.ndarray, until: int) -> None:
        if until > self._time:
            self._bench.advance(volts, (until - self._time) / NANOSECONDS)
            self._time = until

    def _schedule(self, kind: str) -> None:
        self._taken[kind] += 1
        self._due[kind] = round(self._taken[kind] * NANOSECONDS / self._rates[kind])

    def _notice_pulse(self, driven: bool) -> None:
        if driven and not self._driven:
            self._pulses += 1
            self._build_instruments()
        self._driven = driven

    def _build_instruments(self) -> None:
        settings = self._settings
        sequence = np.random.SeedSequence([settings["seed"], self._pulses])
        seeds = iter(sequence.spawn(3 * len(self.channels) + 4))

        def instrument(quantity: str) -> Instrument:
            return Instrument(
                settings[f"sensor.{quantity}_noise"],
                settings.get(f"sensor.{quantity}_resolution", 0.0),
                next(seeds),
            )

        self._volt = [instrument("voltage") for _ in self.channels]
        self._ampere = [instrument("current") for _ in self.channels]
        self._celsius = [instrument("temperature") for _ in self.channels]
        self._air = instrument("temperature")
        self._range = [instrument("range"), instrument("range")]
        self._force = instrument("force")

    def _read_power(self, voltage: tuple[float, ...]) -> list[tuple[float, float]]:
        volts, amperes = direct_reading(
            self._bench.parameters, voltage, self._bench.current(voltage)
        )
        return [
            (volt.read(applied), ampere.read(current))
            for volt, ampere, applied, current in zip(
                self._volt, self._ampere, volts.tolist(), amperes.tolist(), strict=True
            )
        ]

    def _read_temperature(self, _: tuple[float, ...]) -> list[float]:
        kelvin = self._bench.temperature_reading.tolist()
        return [
            camera.read(true - CELSIUS_ZERO)
            for camera, true in zip(self._celsius, kelvin, strict=True)
        ]

    def _read_ambient(self, _: tuple[float, ...]) -> list[float]:
        return [self._air.read(self._bench.ambient_temperature - CELSIUS_ZERO)]

    def _read_ranges(self, _: tuple[float, ...]) -> list[float]:
        # Bending to the front brings the tip nearer to the front sensor.
        deflection = self._bench.deflection_reading
        front, back = self._range
        return [front.read(self._standoff - deflection), back.read(self._standoff + deflection)]

    def _read_load_frame(self, _: tuple[float, ...]) -> list[float]:
        elongation = 0.0  # where the frame holds the clamps
        if self.moves:
            elongation = self._range[0].read(self._bench.deflection_reading)
        return [elongation, self._force.read(float(self._bench.force.sum()))]
