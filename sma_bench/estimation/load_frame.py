"""What a load frame does to a wire over a record: loads that it holds, or clamps that stay."""

from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import Array, autocorrelation, inflation, white_noise_level
from sma_bench.estimation.voltage import FEWEST_SAMPLES, VoltageSegment, find_segments
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import wire_length
from sma_bench.physics import Boundary
from sma_bench.physics.bending import channel_section
from sma_bench.records.record import Record, has_samples, samples

LOAD_FRAME = ("elongation", "force")
_MOSTLY = 0.7  # of a record, that is held
_PULL, _SHORTEST_PULL = 0.5, 5.0  # of the range of the force; s
_SHORTEST_HOLD, _RAMP_PIECE = 2.0, 0.25  # s; of a changing load the pieces
_NARROW = 1e-3  # s
_STILL = 1.5  # of its noise: an elongation that stands still scatters no more


@dataclass(frozen=True)
class Hold:
    """A boundary of a load frame, from `start` s to the next one: `value` is the force [N] held, or
    the elongation [m] where `clamped`, `std` its error; `steady` is False for the short pieces by
    which a changing load is followed."""

    start: float
    stop: float
    clamped: bool
    value: float
    std: float
    steady: bool = True

    def boundary(self, error: float, parameters: Parameters) -> Boundary:
        """What the wire pulls against, `error` (m or N) off."""
        if self.clamped:
            return Boundary.clamped(-(self.value + error) / wire_length(parameters))
        return Boundary.held_stress((self.value + error) / channel_section(parameters))


def has_load_frame(record: Record) -> bool:
    """Whether the record holds what a load frame measures."""
    return any(has_samples(record, name) for name in LOAD_FRAME)


def is_clamped(record: Record) -> bool:
    """Whether the length is held: the elongation stands still, or nobody measured it."""
    if not has_samples(record, "elongation"):
        return True
    elongation = samples(record, "elongation")[1]
    return float(np.std(elongation)) <= max(_STILL * white_noise_level(elongation), 1e-9)


def find_holds(record: Record, start: float, stop: float) -> tuple[Hold, ...]:
    """Held loads, or the clamped length, from `start` to `stop` s: a frame that holds its clamps
    shows one elongation; one that holds loads shows plateaus of force, between which the force is
    followed in short pieces. Raises InputError: neither."""
    if not has_load_frame(record):
        return ()
    if is_clamped(record):
        held = has_samples(record, "elongation")
        mean = _mean(samples(record, "elongation")[1]) if held else (0.0, 0.0)
        return (Hold(start, stop, True, *mean),)
    if not has_samples(record, "force"):
        raise InputError(f"{record.path}: elongation without force, expected the load held")
    time, force = samples(record, "force")
    plateaus, held_for = _plateaus(record)
    if held_for < _MOSTLY * (time[-1] - time[0]):
        raise InputError(
            f"{record.path}: the force is held for {held_for:.0f} of "
            f"{time[-1] - time[0]:.0f} s and the elongation not at all, expected held loads or "
            "a clamped wire")
    holds: list[Hold] = []
    here = start
    for plateau in plateaus:
        first, last = max(plateau.start, here), min(plateau.stop, stop)
        inside = (time >= plateau.start) & (time <= plateau.stop)
        holds += _followed(time, force, here, first)
        holds.append(Hold(first, last, False, *_mean(force[inside])))
        here = last
    return (*holds, *_followed(time, force, here, stop))


def _plateaus(record: Record) -> tuple[list[VoltageSegment], float]:
    """Where the force is held, and for how long in all (s)."""
    every = find_segments(*samples(record, "force")).plateaus
    found = [plateau for plateau in every if plateau.duration >= _SHORTEST_HOLD]
    return found, sum(plateau.duration for plateau in found)


def find_pulls(record: Record) -> tuple[tuple[float, float], ...]:
    """From when to when (s) a frame pulls evenly that mostly neither holds nor stands still."""
    if is_clamped(record) or not has_samples(record, "force"):
        return ()
    time, force = samples(record, "force")
    if len(time) < FEWEST_SAMPLES or _plateaus(record)[1] >= _MOSTLY * (time[-1] - time[0]):
        return ()
    least = _PULL * float(np.ptp(force))
    return tuple((ramp.start, ramp.stop) for ramp in find_segments(time, force).ramps
                 if ramp.voltage_stop - ramp.voltage_start > least
                 and ramp.duration >= _SHORTEST_PULL)


def _mean(values: Array) -> tuple[float, float]:
    """Mean and its standard error, coloured noise counted."""
    centred = values - values.mean()
    factor = inflation(autocorrelation([centred]))
    return float(values.mean()), float(np.std(centred) * np.sqrt(factor / len(values)))


def _followed(time: Array, force: Array, start: float, stop: float) -> list[Hold]:
    """Pieces short enough for the force to be one number in each; one where nobody measured it."""
    if stop - start < _NARROW:
        return []
    edges = np.linspace(start, stop, int(np.ceil((stop - start) / _RAMP_PIECE)) + 1)
    measured = np.diff(np.searchsorted(time, edges)) > 0
    edges = edges[np.append(True, measured) | np.append(measured, True)]
    pieces = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        middle = 0.5 * (first + last)
        near = np.abs(time - middle) <= 0.5 * _RAMP_PIECE
        value = float(np.mean(force[near])) if near.any() else float(np.interp(middle, time, force))
        pieces.append(Hold(first, last, False, value, 0.0, steady=False))
    return pieces
