"""What may be off in a record beside the model's numbers: columns of unit prior, linear.

Zeros of sensors, delays of their clocks, moments of jumps between two samples, levels that a
converter holds between two of its steps, straight stretches of a noisy voltage, loads that were
held. A fit takes them along; those of a sensor are worth telling when they are found.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.observation import JUMP_STD, BinnedSignal, Observation
from sma_bench.estimation.threads import in_threads
from sma_bench.parameters import Parameters

OFFSET, DELAY, JUMP, LEVEL, LINE, LOAD = "offset", "delay", "jump", "level", "line", "load"
_LAST = 0.49  # of the time between two samples
UNITS = {"current": "A", "temperature": "K", "deflection": "m", "elongation": "m", "force": "N"}


@dataclass(frozen=True)
class Nuisance:
    """One of them: `std` of its prior in `unit`, of the signal or quantity `subject`."""

    kind: str
    subject: str = ""
    std: float = 1.0
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Those of one record: (n, q) `columns` on its rows, one signal after the other; linear about
    the values `about` (q,)."""

    items: tuple[Nuisance, ...]
    columns: Array
    about: Array | float = 0.0

    @classmethod
    def none(cls, observation: Observation) -> "Nuisances":
        """Nothing is off."""
        return cls((), np.zeros((sum(len(s.time) for s in observation.signals), 0)))


def offsets(signals: Sequence[BinnedSignal]) -> Nuisances:
    """Only the sensors' zeros."""
    rows = np.concatenate([np.full(len(s.time), k) for k, s in enumerate(signals)])
    own = [k for k, s in enumerate(signals) if s.sensor.zero_std > 0.0]
    items = tuple(
        Nuisance(OFFSET, signals[k].name, signals[k].sensor.zero_std, UNITS[signals[k].quantity])
        for k in own
    )
    columns = [signals[k].sensor.zero_std * (rows == k) for k in own]
    return Nuisances(items, np.column_stack([np.zeros((len(rows), 0)), *columns]))


def moved_to(observation: Observation, own: Nuisances, z: Array) -> tuple[Observation, Array]:
    """The record with its jumps and stamps where a fit has found them, which no straight line goes
    to from where they were; and these values, 0 for what is linear."""
    kept = np.array([item.kind in (JUMP, DELAY) for item in own.items], dtype=bool) * z
    of_jumps = [at for at, item in zip(kept, own.items, strict=True) if item.kind == JUMP]
    place = np.clip(JUMP_STD * np.array(of_jumps), -_LAST, _LAST)
    delays = {
        item.subject: float(at * item.std)
        for at, item in zip(kept, own.items, strict=True) if item.kind == DELAY
    }
    kept[[item.kind == JUMP for item in own.items]] = place / JUMP_STD
    return observation.moved(place, delays), kept


def nuisances_about(
    observation: Observation, parameters: Parameters, voltage_noise: bool = False
) -> Nuisances:
    """All of a record, linear about the model at these parameters; `voltage_noise`: with what the
    voltmeter's noise leaves open of every straight stretch."""
    simulation = observation.simulate(parameters)
    base = np.concatenate(observation.readings(simulation))

    def moved(drive: tuple[Any, ...] | None, loads: Array | None) -> Array:
        voltage = observation.drive.on_grid(observation.grid, *drive) if drive else None
        there = observation.simulate(parameters, voltage, loads)
        return np.concatenate(observation.readings(there)) - base

    zeros = offsets(observation.signals)
    rates = observation.rates(simulation)
    items, columns = [*zeros.items], [zeros.columns]
    for quantity in observation.quantities:
        late = np.concatenate([
            -s.sensor.clock_std * rate if s.quantity == quantity else np.zeros(len(rate))
            for s, rate in zip(observation.signals, rates, strict=True)
        ])  # fmt: skip
        if late.any():
            std = next(s.sensor.clock_std for s in observation.signals if s.quantity == quantity)
            items.append(Nuisance(DELAY, quantity, std, "s"))
            columns.append(late[:, np.newaxis])
    moves: list[tuple[str, tuple[tuple[Any, ...] | None, Array | None]]] = [
        *((JUMP, (drive, None)) for drive in observation.moved_jumps),
        *((LEVEL, (drive, None)) for drive in observation.moved_levels),
        *((LINE, (drive, None)) for drive in (observation.moved_lines if voltage_noise else ())),
        *((LOAD, (None, loads)) for loads in observation.load_errors),
    ]
    found = in_threads(moved, [arguments for _, arguments in moves])
    items += [Nuisance(kind) for kind, _ in moves]
    columns += [column[:, np.newaxis] for column in found]
    return Nuisances(tuple(items), np.hstack(columns))
