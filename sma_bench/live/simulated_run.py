"""A protocol on a bench in software, under every rule of a real run, as fast as it steps."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.live.recording import Beside
from sma_bench.live.run import ABORTED, DONE, OpenLoop, Run, Surroundings
from sma_bench.live.virtual_bench import NANOSECONDS, VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.protocols import Protocol
from sma_bench.records.record import Signal

_PERIOD_NS = 20_000_000  # of the commands
_TIMEOUT = 1.0  # s without readings


class SimulatedRun:
    """A bench that is what `hidden` says, watched by the limits of `believed`."""

    def __init__(self, hidden: Parameters, believed: Parameters, seed: int) -> None:
        settings = {p.name: p.default for p in SIMULATOR} | {"seed": seed}
        self._bench = VirtualBench(hidden, settings)
        self._limits = Limits.from_parameters(believed)
        self._guard = Guard(self._bench.channels, ("power", "temperature"), _TIMEOUT)
        self._volts = tuple(0.0 for _ in self._bench.channels)
        self._read: dict[tuple[str, str], list[tuple[float, float]]] = {}
        self._markers: list[tuple[float, str]] = []
        self._now = 0.0
        self._run = Run(self, OpenLoop(), self._guard, Beside(False), len(self._bench.channels))

    def follow(self, protocol: Protocol) -> tuple[list[Signal], list[tuple[float, str]]]:
        """Signals as a recorder keeps them, and markers.

        Raises:
            InputError: the run was aborted.
        """
        step = 0
        while self._run.state not in (DONE, ABORTED):
            step += 1
            self._take(step * _PERIOD_NS)
            if step == int(_TIMEOUT * NANOSECONDS / _PERIOD_NS) // 2:
                started, said = self._run.start(self._now, lambda: protocol)
                if not started:
                    raise InputError(f"{protocol.name}: {said}")
            self._run.tick(self._now, self._now)
        if self._run.state == ABORTED:
            raise InputError(f"{protocol.name}: {self._run.said}")
        return [
            Signal(name, unit, *np.array(samples).T) for (name, unit), samples in self._read.items()
        ], self._markers

    def _take(self, until: int) -> None:
        """Everything that is read until then (ns)."""
        for reading in self._bench.advance(self._volts, until):
            time = reading.time / NANOSECONDS
            for name, unit, value in self._named(reading.kind, reading.values, time):
                self._read.setdefault((name, unit), []).append((time, value))
        self._now = until / NANOSECONDS

    def _named(
        self, kind: str, values: list[Any], time: float
    ) -> list[tuple[str, str, float]]:
        channels = self._bench.channels
        if kind == "power":
            for channel, (volt, ampere) in zip(channels, values, strict=True):
                self._guard.power(channel, volt, ampere, time, time, self._limits)
            return [
                (f"{channel}.{quantity}", unit, value)
                for channel, both in zip(channels, values, strict=True)
                for quantity, unit, value in zip(
                    ("voltage", "current"), ("V", "A"), both, strict=True
                )
            ]
        if kind == "temperature":
            kelvin = [value + CELSIUS_ZERO for value in values]
            for channel, value in zip(channels, kelvin, strict=True):
                self._guard.temperature(channel, value, time, time, self._limits)
            return [(f"{c}.temperature", "K", v) for c, v in zip(channels, kelvin, strict=True)]
        if kind == "mechanics":
            one, other = values
            if self._bench.composite:
                return [("deflection", "m", 0.5 * (other - one))]
            return [("elongation", "m", one), ("force", "N", other)]
        return []

    # --- live.run.Outputs ---------------------------------------------------------------------

    def surroundings(self) -> Surroundings:
        """Nobody else."""
        return Surroundings()

    def send(self, voltage: list[float]) -> None:
        """A command."""
        self._volts = tuple(voltage)

    def mark(self, step: str) -> None:
        """A step begins."""
        self._markers.append((self._now, step))

    def enter(self, state: str) -> None:
        """The state has changed."""

    def show(self, progress: Mapping[str, Any]) -> None:
        """How far it is."""
