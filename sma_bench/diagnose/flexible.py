"""The rival that names nothing: any smooth response to drive, temperature, bending and time.

A residual that a physical effect leaves depends on what the bench does, so it can be learnt from
one stretch and found again in another; a sensor's drift cannot. The response is linear in many
features of the simulation with independent Gaussian weights, whose size is the most likely one.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.sizes import largest_gap
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit
from sma_bench.physics.simulate import Simulation
from sma_bench.records.record import first_order_lag

Array = NDArray[np.float64]

# Of a signal's features: its name and their number, for another bench has other sides.
Key = tuple[str, int]

_MEMORIES = (1.0, 5.0, 25.0, 100.0)  # s
_SIZES = np.geomspace(0.1, 1000.0, 9)
_ROUNDS = 3
_MOST_CELLS = 1_000_000  # of an even grid


@dataclass(frozen=True, eq=False)
class Flexible:
    """What a flexible response explains of a fit's residual.

    Attributes:
        gain: of evidence over the fit, both with the noise that they leave.
        response: (n,) the missing term's course; weights: (p,) of the features.
        columns: which of the p are a signal's; gap: of the response, in noise.
    """

    gain: float
    response: Array
    weights: Array
    columns: Mapping[Key, slice]
    gap: float = 0.0

    def on(self, obs: Observation, simulation: Simulation) -> Array:
        """The course of the missing term on another drive; none on a sensor never heard."""
        return _placed(_features(obs, simulation), self.columns) @ self.weights


def flexible_residual(fitted: Fit) -> Flexible:
    """Fit the flexible rival to what a candidate leaves.

    It begins with little drift in the noise: the noise of a poor fit has taken the residual in.
    """
    made = [_features(o, o.simulate(fitted.parameters)) for o in fitted.problem.observations]
    # Records share the features of a signal that they share.
    columns: dict[Key, slice] = {}
    first = 0
    for key in ((key for some in made for key, _ in some)):
        if key not in columns:
            columns[key] = slice(first, first + key[1])
            first += key[1]
    features = np.vstack([_placed(some, columns) for some in made])
    own = _likelihood(fitted.problem, fitted.left)
    problem = replace(
        fitted.problem,
        noise={
            name: replace(noise, drift=min(noise.drift, noise.white))
            for name, noise in fitted.problem.noise.items()
        },
    )
    best = Flexible(0.0, np.zeros_like(fitted.left), np.zeros(features.shape[1]), columns)
    for _ in range(_ROUNDS):
        # Gain of the features in marginal likelihood, and their weights, with the
        # likeliest size.
        rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
        normal = rows.T @ rows + np.eye(rows.shape[1])
        phi, base = problem.whiten(features), problem.whiten(fitted.left)
        # What the fitted unknowns can still take up is not the features' to explain.
        across = rows.T @ phi
        taken = np.linalg.solve(normal, np.column_stack([across, rows.T @ base]))
        gram = phi.T @ phi - across.T @ taken[:, :-1]
        values, vectors = np.linalg.eigh(gram)
        values = np.maximum(values, 0.0)
        turned = vectors.T @ (phi.T @ base - across.T @ taken[:, -1])
        marginal, weights = 0.0, np.zeros(len(turned))
        for size in _SIZES:
            shrunk = turned / (values + 1.0 / size**2)
            gain = 0.5 * float(turned @ shrunk - np.sum(np.log1p(size**2 * values)))
            if gain > marginal:
                marginal, weights = gain, vectors @ shrunk
        gain = _likelihood(problem, fitted.left) + marginal - own
        response = features @ weights
        if gain > best.gain:
            best = Flexible(gain, response, weights, columns)
        problem = problem.with_noise(fitted.left - response)
    return replace(best, gap=largest_gap(fitted.problem, best.response))


def _likelihood(problem: Problem, residual: Array) -> float:
    """Log of the probability of a residual (n,) and of its noise."""
    white = problem.whiten(residual)
    return float(-0.5 * white @ white) - problem.log_scale() + problem.log_prior()


def _features(obs: Observation, simulation: Simulation) -> list[tuple[Key, Array]]:
    """(rows, own features) of each signal of a record, in units of its noise."""
    blocks = [
        np.column_stack(list(_of_signal(signal, obs, simulation))) * signal.noise
        for signal in obs.signals
    ]
    return [((s.name, b.shape[1]), b) for s, b in zip(obs.signals, blocks, strict=True)]


def _placed(blocks: list[tuple[Key, Array]], columns: Mapping[Key, slice]) -> Array:
    """(n, p) of a record's rows."""
    placed = np.zeros((sum(len(block) for _, block in blocks), sum(n for _, n in columns)))
    first = 0
    for key, block in blocks:
        if key in columns:
            placed[first : first + len(block), columns[key]] = block
        first += len(block)
    return placed


def _of_signal(signal: BinnedSignal, obs: Observation, simulation: Simulation) -> Iterator[Array]:
    clock = (obs.grid - obs.grid[0]) / 100.0
    courses = [clock, clock**2]
    if signal.quantity == "deflection":
        for side in dict.fromkeys(obs.sides):
            own = [k for k, name in enumerate(obs.sides) if name == side]
            number = list(dict.fromkeys(obs.sides)).index(side)
            stroke = _unit(simulation.contraction[:, number])
            mean = np.mean(simulation.temperature[:, own], axis=1)
            rise = _unit(mean - simulation.temperature.min())
            xi = np.mean(simulation.martensite_fraction[:, own], axis=1)
            turning = np.gradient(xi, obs.grid)
            courses += [
                *(_remembered(stroke, memory, obs.grid) for memory in _MEMORIES),
                stroke, stroke**2, np.maximum(stroke - 0.5, 0.0), np.maximum.accumulate(stroke),
                rise, rise**2, np.maximum(rise - 0.5, 0.0),
                xi * (1.0 - xi), turning, np.sign(turning),
            ]
    else:
        courses += _of_wire(signal.wire, obs, simulation)
    for course in courses:
        yield signal.average @ course
    if signal.quantity == "current":
        yield signal.average @ np.ones_like(clock)


def _of_wire(wire: int, obs: Observation, simulation: Simulation) -> list[Array]:
    power = _unit(obs.voltage[:, wire] ** 2)
    own = simulation.temperature[:, wire]
    opposite = [k for k, side in enumerate(obs.sides) if side != obs.sides[wire]]
    courses = [_remembered(power, memory, obs.grid) for memory in _MEMORIES]
    if opposite:
        across = _unit(np.mean(obs.voltage[:, opposite] ** 2, axis=1))
        courses += [_remembered(across, memory, obs.grid) for memory in _MEMORIES[1:]]
    rise = _unit(own - own.min())
    xi = simulation.martensite_fraction[:, wire]
    return [
        *courses, rise, rise**2, np.maximum(rise - 0.5, 0.0), 1.0 - xi,
        _unit(np.gradient(own, obs.grid)), np.gradient(xi, obs.grid),
    ]


def _remembered(course: Array, memory: float, grid: Array) -> Array:
    """First-order lag of a course (n,) on a grid (n,) s that need not be even."""
    cell = max(float(np.median(np.diff(grid))), float(np.ptp(grid)) / _MOST_CELLS)
    even = np.arange(grid[0], grid[-1] + cell, cell)
    slow = first_order_lag(np.interp(even, grid, course), float(np.exp(-cell / memory)))
    return np.interp(grid, even, slow)


def _unit(course: Array) -> Array:
    largest = float(np.max(np.abs(course)))
    return course / largest if largest > 0.0 else course
