"""Nuisances of a record, fitted along with the parameters: linear columns of unit prior.

Zeros of sensors, delays of their clocks, moments of voltage jumps between two samples, levels
between steps of a converter, straight stretches of a noisy voltage, held loads, a run's state."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.estimation.observation import JUMP_STD, STATES, BinnedSignal, Observation, in_state
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME

OFFSET, DELAY, JUMP, LEVEL, LINE, LOAD = "offset", "delay", "jump", "level", "line", "load"
TICK, STATE = "tick", "state"
NONLINEAR = (JUMP, TICK, DELAY, STATE)  # linearised anew about where a fit finds them
# Prior deviations, of a finite difference. With a whole one a fit of two runs in different states
# crept, and ended up to a thousand nats before its optimum.
STEP = 1e-4
_FARTHEST = 0.49  # of the time between two samples, a jump from their middle
_SLOW = 0.3  # s between samples of a logger whose loop may always switch at the same part of it
# Moves of the voltage this far apart share a simulation, if one has decayed before the next begins:
_DECAYED = 60.0  # s
_TRACE, _LAST_PART = 1e-3, 0.25  # of its largest change, in the last part of _DECAYED
_FEWER = 0.7  # groups per move: with more, sharing is not worth it
_NEVER = 1e300  # s
UNITS = {"current": "A", "temperature": "K", "deflection": "m", "elongation": "m", "force": "N"}


@dataclass(frozen=True)
class Nuisance:
    """A nuisance of a signal, quantity or parameter `subject`; `std` of its prior in `unit`."""

    kind: str
    subject: str = ""
    std: float = 1.0
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Those of one record: `columns` (n, q) on its rows, linearised about z = `about` (q,)."""

    items: tuple[Nuisance, ...]
    columns: Array
    about: Array | float = 0.0

    def with_columns(self, kind: str, columns: Array) -> "Nuisances":
        """With more of a kind, whose effects on the rows are these columns (n, m)."""
        return Nuisances((*self.items, *[Nuisance(kind)] * columns.shape[1]),
                         np.hstack([self.columns, columns]),
                         np.pad(self.about + np.zeros(len(self.items)), (0, columns.shape[1])))


Column = tuple[Nuisance, Array]  # with its effect on a record's rows (n,)


def _zeros(signals: Sequence[BinnedSignal]) -> list[Column]:
    rows = np.repeat(np.arange(len(signals)), [len(s.time) for s in signals])
    return [(Nuisance(OFFSET, s.name, s.sensor.zero_std, UNITS[s.quantity]),
             s.sensor.zero_std * (rows == k))
            for k, s in enumerate(signals) if s.sensor.zero_std > 0.0]


def _gathered(found: Sequence[Column], rows: int) -> Nuisances:
    columns = [np.zeros((rows, 0)), *(column for _, column in found)]
    return Nuisances(tuple(item for item, _ in found), np.column_stack(columns))


def moved_to(observation: Observation, own: Nuisances, z: Array, kinds: Collection[str] = NONLINEAR,
             states: float = 0.0) -> tuple[Observation, Array]:
    """The record with its jumps, delays and state (`states` times the usual) as a fit found them at
    z (q,), only those of these `kinds`; and the z that it now has, 0 of the other kinds."""
    kept = np.array([item.kind in kinds for item in own.items], dtype=bool) * z
    places = {kind: [k for k, i in enumerate(own.items) if i.kind == kind] for kind in NONLINEAR}
    if STATE in kinds:
        away = {own.items[k].subject: float(kept[k]) * states for k in places[STATE] if states}
        observation = replace(observation, away=away)
    if JUMP not in kinds:
        return observation, kept
    jumps, together = places[JUMP], kept[places[TICK]].sum()
    place = np.clip(JUMP_STD * (kept[jumps] + together), -_FARTHEST, _FARTHEST)
    delays = {own.items[k].subject: float(kept[k] * own.items[k].std) for k in places[DELAY]}
    kept[jumps] = place / JUMP_STD - together
    volts = observation.drive.on_grid(observation.grid, place)
    return replace(observation, voltage=volts, place=place, delays=delays), kept


def linearised(observation: Observation, parameters: Parameters, voltage_noise: bool = False,
                    states: float = 0.0) -> Nuisances:
    """All of a record, linearised at these parameters; `voltage_noise`: with errors of straight
    voltage stretches; `states`: with the state of its run, so many times the usual."""
    simulation = observation.simulate(parameters)
    base = observation.readings(simulation)

    def moved(drive: tuple[Any, ...] | None, loads: Array | None) -> Array:
        voltage = observation.drive.on_grid(observation.grid, *drive) if drive else None
        return observation.readings(observation.simulate(parameters, voltage, loads)) - base

    found, rates = _zeros(observation.signals), observation.rates(simulation)
    for quantity in observation.quantities:
        std = next(s.sensor.clock_std for s in observation.signals if s.quantity == quantity)
        if std > 0.0:
            late = [-std * rate if s.quantity == quantity else np.zeros_like(rate)
                    for s, rate in zip(observation.signals, rates, strict=True)]
            found.append((Nuisance(DELAY, quantity, std, "s"), np.concatenate(late)))
    # Each jump; levels hidden between two steps of the converter; straight stretches in noise.
    drive = observation.drive
    moves = [_Move(JUMP, early, late, place=JUMP_STD * (np.arange(len(drive.early)) == k))
             for k, (early, late) in enumerate(zip(drive.early, drive.late, strict=True))]
    known = [(LEVEL, errors) for errors in drive.level_errors()]
    known += [(LINE, errors) for errors in drive.line_errors()] if voltage_noise else []
    for kind, errors in known:
        pairs = zip(drive.channels, errors, strict=True)
        at = np.concatenate([polygon.time[error != 0.0] for polygon, error in pairs])
        moves.append(_Move(kind, at.min(), at.max(), errors=errors))
    responses = _responses(observation, moves, lambda drive: moved(drive, None))
    found += [(Nuisance(move.kind), own) for move, own in zip(moves, responses.T, strict=True)]
    jumps, apart = len(drive.early), drive.late - drive.early
    if jumps > 1 and np.median(apart) > _SLOW:
        found.append((Nuisance(TICK), responses[:, :jumps].sum(axis=1)))
    # One standard error of each held load in turn.
    loads = [(None, row) for row in np.diag([hold.std for hold in observation.holds]) if row.any()]
    found += [(Nuisance(LOAD), column) for column in in_threads(moved, loads)]
    found += _states_of_run(observation, parameters, states, base) if states else []
    return _gathered(found, len(base))


def of_planned(observation: Observation, parameters: Parameters, predicted: Array) -> Nuisances:
    """Those of a planned record with predicted readings (n,): zeros, and the state of its run."""
    run = _states_of_run(observation, parameters, 1.0, predicted)
    return _gathered([*_zeros(observation.signals), *run], len(predicted))


def _states_of_run(observation: Observation, parameters: Parameters, states: float,
                   base: Array) -> list[Column]:
    near = [in_state(parameters, {name: STEP * states}) for name in STATES]
    columns = (observation.predict(near) - base[:, np.newaxis]) / STEP
    sizes = [in_state(parameters, {name: states})[name] - parameters[name] for name in STATES]
    return [(Nuisance(STATE, name, size, BY_NAME[name].unit), own)
            for name, size, own in zip(STATES, sizes, columns.T, strict=True)]


class _Move(NamedTuple):
    """An error of the voltages from `begin` to `end` [s], added to the places of the jumps, (e,),
    or to the knots of the channels, (k,) V each."""

    kind: str
    begin: float
    end: float
    place: Array | float = 0.0
    errors: tuple[Array, ...] | None = None


def _responses(observation: Observation, moves: Sequence[_Move],
               change: Callable[[tuple[Any, ...]], Array]) -> Array:
    """(n, m): `change` (n,) of the readings by each of the moves (m,) of the voltages.

    Moves far apart share a simulation: the readings from the start of one to that of the next are
    its own. If one has not decayed by then, the moves of its group are simulated one by one."""
    bins = [len(s.time) for s in observation.signals]
    rows = np.repeat(np.arange(len(bins)), bins)
    late = max(map(abs, observation.delays.values()), default=0.0)
    ends = np.concatenate([s.time + s.period + late for s in observation.signals])
    columns = np.zeros((len(rows), len(moves)))

    def together(group: Sequence[int]) -> Array:
        place = observation.place + np.zeros(len(observation.drive.early))
        place = place + sum(moves[k].place for k in group)
        known = filter(None, (moves[k].errors for k in group))
        errors = [sum(own) for own in zip(*known, strict=True)]
        return change((place, errors or None))

    # Groups in which each move begins when the one before has decayed.
    groups, alone = list[list[int]](), list[int]()
    for k in sorted(range(len(moves)), key=lambda k: moves[k].begin):
        far = [g for g in groups if moves[k].begin - moves[g[-1]].end >= _DECAYED]
        if far:
            far[0].append(k)
        else:
            groups.append([k])
    if len(groups) >= _FEWER * len(moves):
        groups, alone = [], list(range(len(moves)))
    found = in_threads(together, [(group,) for group in groups])
    for group, response in zip(groups, found, strict=True):
        # Has each move decayed in every signal when the next one begins?
        begins = np.array([moves[k].begin for k in group])
        owner = np.searchsorted(begins, ends, side="right") - 1
        following = np.append(begins[1:], _NEVER)[owner]
        last = (owner >= 0) & (ends > following - _LAST_PART * _DECAYED)
        size, last_size = np.zeros((2, rows.max(initial=0) + 1))
        np.maximum.at(size, rows, np.abs(response))
        np.maximum.at(last_size, rows[last], np.abs(response[last]))
        if np.all(last_size <= _TRACE * size):
            seen = np.flatnonzero(owner >= 0)
            columns[seen, np.array(group)[owner[seen]]] = response[seen]
        else:
            alone += group
    for k, column in zip(alone, in_threads(together, [([k],) for k in alone]), strict=True):
        columns[:, k] = column
    return columns
