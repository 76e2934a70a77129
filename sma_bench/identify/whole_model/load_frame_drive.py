"""What a load frame does to the wire over a record: loads it holds, or clamps that stay."""

from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.colour import white_noise_level
from sma_bench.identify.estimate import Array
from sma_bench.identify.noise import autocorrelation, inflation
from sma_bench.identify.segments import find_segments
from sma_bench.identify.signals import has_samples, samples
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length_from_mass
from sma_bench.records.record import Record

_MOSTLY = 0.7
_SHORTEST_HOLD = 2.0
_RAMP_PIECE = 0.1
_STILL = 1.5


@dataclass(frozen=True)
class Hold:
    """A boundary that stays: grid indices first .. last (exclusive).

    `value` is the force [N] held, or the elongation [m] where `clamped`, `std` its error; `steady`
    is False for the short pieces by which a changing load is followed.
    """

    first: int
    last: int
    clamped: bool
    value: float
    std: float
    steady: bool = True


def wire_length(parameters: Parameters) -> float:
    """Length [m] between the clamps: the contract has no parameter for it, the mass tells it."""
    return wire_length_from_mass(parameters)


def has_load_frame(record: Record) -> bool:
    """Whether the record holds what a load frame measures."""
    return any(has_samples(record, name) for name in ("elongation", "force"))


def find_holds(record: Record, grid: Array) -> tuple[Hold, ...]:
    """Held loads, or the clamped length, over the simulation's grid (n,) s.

    A frame that holds its clamps shows one elongation; one that holds loads shows plateaus of
    force, between which the force is followed in short pieces.

    Raises:
        InputError: neither.
    """
    if not has_load_frame(record):
        return ()
    if is_clamped(record):
        held = has_samples(record, "elongation")
        value, std = _mean(samples(record, "elongation")[1]) if held else (0.0, 0.0)
        return (Hold(0, len(grid), True, value, std),)
    if not has_samples(record, "force"):
        raise InputError(f"{record.path}: elongation without force, expected the load held")
    return _loads(record, grid)


def is_clamped(record: Record) -> bool:
    """Whether the length is held: the elongation stands still, or nobody measured it."""
    """Whether the clamps stay where they are."""
    if not has_samples(record, "elongation"):
        return True
    elongation = samples(record, "elongation")[1]
    return float(np.std(elongation)) <= max(_STILL * white_noise_level(elongation), 1e-9)


def _loads(record: Record, grid: Array) -> tuple[Hold, ...]:
    time, force = samples(record, "force")
    segments = find_segments(time, force)
    plateaus = [p for p in segments.plateaus if p.duration >= _SHORTEST_HOLD]
    if sum(p.duration for p in plateaus) < _MOSTLY * (time[-1] - time[0]):
        raise InputError(
            f"{record.path}: the force is held for {sum(p.duration for p in plateaus):.0f} of "
            f"{time[-1] - time[0]:.0f} s and the elongation not at all, expected held loads or "
            "a clamped wire"
        )
    holds: list[Hold] = []
    here = 0
    for plateau in plateaus:
        first = max(int(np.searchsorted(grid, plateau.start)), here)
        last = int(np.searchsorted(grid, plateau.stop, side="right"))
        inside = (time >= plateau.start) & (time <= plateau.stop)
        holds += _followed(time, force, grid, here, first)
        holds.append(Hold(first, last, False, *_mean(force[inside])))
        here = last
    holds += _followed(time, force, grid, here, len(grid))
    return tuple(h for h in holds if h.last > h.first)


def _mean(values: Array) -> tuple[float, float]:
    """Mean and its standard error, coloured noise counted."""
    centred = values - values.mean()
    colour = inflation(autocorrelation([centred]))
    return float(values.mean()), float(np.std(centred) * np.sqrt(colour / len(values)))


def _followed(time: Array, force: Array, grid: Array, first: int, last: int) -> list[Hold]:
    """Pieces short enough for the force to be one number in each."""
    pieces = []
    while first < last:
        stop = min(int(np.searchsorted(grid, grid[first] + _RAMP_PIECE, side="right")), last)
        stop = max(stop, first + 1)
        middle = 0.5 * (grid[first] + grid[stop - 1])
        near = np.abs(time - middle) <= 0.5 * _RAMP_PIECE
        value = float(np.mean(force[near])) if near.any() else float(np.interp(middle, time, force))
        pieces.append(Hold(first, stop, False, value, 0.0, steady=False))
        first = stop
    return pieces
