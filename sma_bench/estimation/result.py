"""The result of a fit: every number with its errors and their causes, zeros and delays.

Records determine some numbers only as a product (`Unknown.partner`). Its factors are separated by
their priors alone; both are given here, with the error that this leaves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from sma_bench.arrays import Array
from sma_bench.estimation.nuisances import DELAY, OFFSET, Nuisance
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import Unknown, range_of
from sma_bench.records.contract import CELSIUS_ZERO

OF_EXCESS = ("sensor.temperature.emissivity", "sensor.temperature.spot_share")
_SENSED = ("current", "voltage", "temperature", "deflection")
SCALES = dict.fromkeys(OF_EXCESS, "temperature") | {f"sensor.{q}.gain": q for q in _SENSED}
ZEROS = {f"sensor.{q}.offset": q for q in _SENSED}
_UP = 1e-3  # relative, of all voltages, for a finite difference
_SAME = 3.0  # nats below the best: a start that is nearer ended at the same place
_NEAR = 0.5  # standard deviations: so did one that is nearer in every unknown
_AT_END = 1e-3  # prior deviations from an end of the range


@dataclass(frozen=True)
class Number:
    """One estimated parameter, in its unit."""

    name: str
    value: float
    std: float  # never above `prior_std`
    prior_mean: float  # mean of the prior
    prior_std: float
    moved: float  # prior deviations from `prior_mean`
    informed: float  # share of its information from the records: 1 - variance/prior variance
    at_end: bool  # of its range
    # Signed error that one standard deviation of each sensor's scale or zero adds.
    shares: Mapping[str, float] = field(default_factory=dict)


class Off(NamedTuple):
    """A sensor's zero or the delay of its timestamps, with its prior `item`, in the item's unit."""

    item: Nuisance
    path: str
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Result:
    """The best of several fits."""

    fit: Fit
    numbers: tuple[Number, ...]  # every parameter
    correlation: Array  # (k, k) of their errors
    products: tuple[Number, ...]  # of two factors each
    off: tuple[Off, ...]  # zeros and delays
    agreed: int  # how many of `starts` ended at this place
    starts: int

    @property
    def samples(self) -> int:
        """Number of samples behind it."""
        return int(sum(block.signal.count.sum() for block in self.fit.problem.blocks))


def result_of(fitted: Fit, tried: Sequence[Fit],
              scales: Mapping[str, Array] | None = None) -> Result:
    """Numbers of the final fit after those `tried` from several starts; `scales`: from
    `scale_errors`, if the errors are to include those of the sensors' scales."""
    # A product's deviation x is split by the priors: w x + w' n to this factor, w' x - w n to its
    # partner, with w' = sqrt(1 - w^2) and n of unit prior, which no record determines.
    unknowns = fitted.unknowns
    split = [k for k, item in enumerate(unknowns.items) if item.partner]
    items, rows = list[tuple[int, Unknown]](), []
    for k, item in enumerate(unknowns.items):
        row, other = np.zeros((2, len(unknowns.items) + len(split)))
        row[k] = share = item.own_std / item.std if item.partner else 1.0
        if not item.partner:
            items.append((k, item))
            rows.append(row)
            continue
        rest = float(np.sqrt(1.0 - share**2))
        place = len(unknowns.items) + split.index(k)
        row[place], other[k], other[place] = rest, rest, -share
        partner = (item.partner, float(unknowns.base[item.partner]), rest * item.std, other)
        for name, mean, std, own in ((item.name, item.mean, item.own_std, row), partner):
            if std > 0.0:
                std = std / item.mean * mean
                items.append((k, Unknown(name, mean, std, *range_of(name), item.log)))
                rows.append(own)
    apart = np.array(rows).reshape(len(rows), len(unknowns.items) + len(split))

    turn = unknowns.turn(fitted.x)
    of_numbers = turn @ fitted.covariance @ turn.T
    covariance = apart @ block_diag(of_numbers, np.eye(len(split))) @ apart.T
    sigma = np.sqrt(np.diag(covariance))
    moved = apart[:, : len(fitted.x)] @ unknowns.deviations(fitted.x)
    low, high = unknowns.bounds()
    at_end = (fitted.x - low < _AT_END) | (high - fitted.x < _AT_END)
    shifts = {name: apart[:, : len(x)] @ turn @ x for name, x in (scales or {}).items()}
    numbers = tuple(_number(item, float(moved[i]), float(sigma[i]), bool(at_end[k]),
                            {name: float(x[i]) for name, x in shifts.items()})
                    for i, (k, item) in enumerate(items))
    # Products, which the records determine better than their factors.
    deviations, products = np.sqrt(np.diag(fitted.covariance)).tolist(), []
    for k, item in ((k, unknowns.items[k]) for k in split):
        name, times = f"{item.name} x {item.partner}", float(unknowns.base[item.partner])
        whole = Unknown(name, item.mean * times, item.std * times, log=True)
        products.append(_number(whole, float(fitted.x[k]), deviations[k], False))
    errors = np.sqrt(np.diag(fitted.joint))[len(fitted.x) :]
    pairs = zip(fitted.problem.observations, fitted.problem.nuisances, strict=True)
    named = [(observation.path, item) for observation, own in pairs for item in own.items]
    off = tuple(
        Off(item, path, z * item.std, error * item.std)
        for (path, item), z, error in zip(named, fitted.z.tolist(), errors.tolist(), strict=True)
        if item.kind in (OFFSET, DELAY))
    # A start ended where the best one did if it is about as probable, or near in all unknowns.
    best = max(tried, key=lambda one: one.evidence)
    near = _NEAR * np.sqrt(np.diag(best.covariance))
    agreed = sum(one.evidence > best.evidence - _SAME or bool(np.all(np.abs(one.x - best.x) < near))
                 for one in tried)
    return Result(fitted, numbers, covariance / np.outer(sigma, sigma), tuple(products), off,
                  agreed, len(tried))


def _number(item: Unknown, moved: float, sigma: float, at_end: bool,
            shifts: Mapping[str, float] = {}) -> Number:
    informed, slope = float(np.clip(1.0 - sigma**2, 0.0, 1.0)), item.slope(moved)
    # Moved by its logarithm, a number that has grown could get a larger error than its prior.
    std, shares = min(slope * sigma, item.std), {name: slope * by for name, by in shifts.items()}
    return Number(item.name, item.value(moved), std, item.mean, item.std, moved, informed, at_end,
                  shares)


def scale_errors(fitted: Fit) -> dict[str, Array]:
    """By sensor's scale or zero: (k,) prior deviations by which one standard deviation of it moves
    the unknowns, if all signals of its quantity share the error."""
    problem, parameters = fitted.problem, fitted.parameters

    def with_volts(factor: float, offset: float) -> Array:
        """(n,) change of measured less predicted with other voltages."""
        found = []
        for one in problem.observations:
            there, here = (one.readings(one.simulate(parameters, volts))
                           for volts in (factor * one.voltage + offset, one.voltage))
            found.append(here - there)
        return np.concatenate(found)

    rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
    gain = fitted.joint[: len(fitted.x)] @ rows.T
    found = {}
    for name, quantity in (SCALES | ZEROS).items():
        std = parameters.std(name)
        if std <= 0.0:
            continue
        # (n,) by which measured less predicted changes with one standard deviation.
        column = np.zeros(len(problem.measured))
        if quantity == "voltage" and name in ZEROS:
            column = with_volts(1.0, std)
        elif quantity == "voltage":
            column = with_volts(1.0 + _UP, 0.0) / _UP
            for block in problem.blocks:
                if block.signal.quantity == "current":  # predicted from its volts
                    column[block.rows] -= fitted.predicted[block.rows]
            column *= std / parameters[name]
        # A camera's gain acts on degrees Celsius, its spot and emissivity on the excess temperature
        zero = CELSIUS_ZERO if quantity == "temperature" else 0.0
        if name in OF_EXCESS:
            zero = parameters["environment.ambient_temperature"]
        for block in problem.blocks:
            if block.signal.quantity == quantity:
                values = block.signal.value - zero
                column[block.rows] = std if name in ZEROS else std / parameters[name] * values
        if column.any():
            found[name] = gain @ problem.whiten(column)
    return found
