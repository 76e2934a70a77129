"""Whether what a fit leaves is noise: noise does not know when the bench moves.

Two looks at the whitened residual: whether it scatters more while the signal moves than while it
rests, and what a rival explains of it that names nothing: any smooth response to drive,
temperature, bending and time. What a physical effect leaves can be learnt from one stretch and
found again in another; a sensor's drift cannot. The response is linear in many features of the
simulation with independent Gaussian weights, whose size is the most likely one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise, starmap
from operator import itemgetter

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit
from sma_bench.physics.simulate import Simulation
from sma_bench.records.record import first_order_lag

_FEWEST = 30
_MEMORIES = (1.0, 5.0, 25.0, 100.0)  # s
_SIZES = np.geomspace(0.1, 1000.0, 9)
_ROUNDS = 3
_MOST_CELLS = 1_000_000  # of an even grid


@dataclass(frozen=True)
class Left:
    """What a fit leaves in motion and at rest."""

    ratio: float  # log of moving over resting variance, in standard deviations, the largest of all
    signal: str  # which one
    outlier: float  # largest whitened residual, in standard deviations: a single event shows there


def left_over(fitted: Fit) -> Left:
    """Compare what a fit leaves on either side of the median speed of each simulated signal."""
    problem, found, outlier = fitted.problem, [(-np.inf, "")], 0.0
    rates = [rate for o in problem.observations for rate in o.rates(o.simulate(fitted.parameters))]
    for block, rate in zip(problem.blocks, rates, strict=True):
        white = problem.noise[block.signal.name].whiten(fitted.left[block.rows])
        moving = np.abs(rate) > np.median(np.abs(rate))
        if min(moving.sum(), (~moving).sum()) < _FEWEST:
            continue
        fast, slow = float(np.mean(white[moving] ** 2)), float(np.mean(white[~moving] ** 2))
        spread = np.sqrt(2.0 / moving.sum() + 2.0 / (~moving).sum())
        found.append((float(np.log(fast / slow) / spread), block.signal.name))
        outlier = max(outlier, float(np.max(np.abs(white))))
    return Left(*max(reversed(found), key=itemgetter(0)), outlier)


Key = tuple[str, int]  # name and number of a signal's features, for another bench has other sides


@dataclass(frozen=True, eq=False)
class Flexible:
    """What a smooth response of free form explains of a fit's residual."""

    gain: float  # of evidence over the fit, both with the noise that they leave
    response: Array  # (n,) of the missing term
    weights: Array  # (p,) of the features
    columns: Mapping[Key, slice]  # which of the p are a signal's

    def on(self, obs: Observation, simulation: Simulation) -> Array:
        """(n,) of the missing term on another drive; none on a sensor never heard."""
        return _placed(_features(obs, simulation), self.columns) @ self.weights


def flexible_residual(fitted: Fit) -> Flexible:
    """Fit the free response to what a candidate leaves."""
    made = [_features(o, o.simulate(fitted.parameters)) for o in fitted.problem.observations]
    # Records share the features of a signal that they share.
    keys = list(dict.fromkeys(key for some in made for key, _ in some))
    ends = np.cumsum([0, *(count for _, count in keys)]).tolist()
    columns = dict(zip(keys, starmap(slice, pairwise(ends)), strict=True))
    return smooth_response(fitted, np.vstack([_placed(some, columns) for some in made]), columns)


def smooth_response(fitted: Fit, features: Array, columns: Mapping[Key, slice]) -> Flexible:
    """What features (n, p) of independent Gaussian weights explain of what a candidate leaves."""
    own = _likelihood(fitted.problem, fitted.left)
    # It begins with little drift in the noise: the noise of a poor fit has taken the residual in.
    noises = {name: replace(noise, drift=min(noise.drift, noise.white))
              for name, noise in fitted.problem.noise.items()}
    problem = replace(fitted.problem, noise=noises)
    best = Flexible(0.0, np.zeros_like(fitted.left), np.zeros(features.shape[1]), columns)
    for _ in range(_ROUNDS):
        # What the fitted unknowns can still take up is not the features' to explain.
        rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
        normal = rows.T @ rows + np.eye(rows.shape[1])
        phi, base = problem.whiten(features), problem.whiten(fitted.left)
        across = rows.T @ phi
        taken = np.linalg.solve(normal, np.column_stack([across, rows.T @ base]))
        values, vectors = np.linalg.eigh(phi.T @ phi - across.T @ taken[:, :-1])
        values = np.maximum(values, 0.0)
        turned = vectors.T @ (phi.T @ base - across.T @ taken[:, -1])
        # Gain in marginal likelihood, and the weights, with the likeliest size.
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
    return best


def _likelihood(problem: Problem, residual: Array) -> float:
    """Log of the probability of a residual (n,) and of its noise."""
    white = problem.whiten(residual)
    return float(-0.5 * white @ white) - problem.log_scale() + problem.log_prior()


def _features(obs: Observation, simulation: Simulation) -> list[tuple[Key, Array]]:
    """(rows, own features) of each signal of a record, in units of its noise."""
    found, clock = [], (obs.grid - obs.grid[0]) / 100.0
    of_wire = cache(partial(_of_wire, obs, simulation))
    for signal in obs.signals:
        moves = signal.quantity in ("deflection", "force")
        own = _of_motion(obs, simulation) if moves else of_wire(signal.wire)
        constant = [np.ones_like(clock)] if signal.quantity == "current" else []
        histories = np.column_stack([clock, clock**2, *own, *constant])
        block = signal.average @ histories * signal.noise
        found.append(((signal.name, block.shape[1]), block))
    return found


def _of_motion(obs: Observation, simulation: Simulation) -> list[Array]:
    found: list[Array] = []
    for number, side in enumerate(dict.fromkeys(obs.sides)):
        own = [k for k, name in enumerate(obs.sides) if name == side]
        stroke = _unit(simulation.contraction[:, number])
        mean = np.mean(simulation.temperature[:, own], axis=1)
        rise = _unit(mean - simulation.temperature.min())
        xi = np.mean(simulation.martensite_fraction[:, own], axis=1)
        turning = np.gradient(xi, obs.grid)
        found += [*(_remembered(stroke, memory, obs.grid) for memory in _MEMORIES), stroke,
                  stroke**2, np.maximum(stroke - 0.5, 0.0), np.maximum.accumulate(stroke), rise,
                  rise**2, np.maximum(rise - 0.5, 0.0), xi * (1.0 - xi), turning, np.sign(turning)]
    return found


def _of_wire(obs: Observation, simulation: Simulation, wire: int) -> list[Array]:
    power = _unit(obs.voltage[:, wire] ** 2)
    own, xi = simulation.temperature[:, wire], simulation.martensite_fraction[:, wire]
    opposite = [k for k, side in enumerate(obs.sides) if side != obs.sides[wire]]
    found = [_remembered(power, memory, obs.grid) for memory in _MEMORIES]
    if opposite:
        across = _unit(np.mean(obs.voltage[:, opposite] ** 2, axis=1))
        found += [_remembered(across, memory, obs.grid) for memory in _MEMORIES[1:]]
    rise = _unit(own - own.min())
    return [*found, rise, rise**2, np.maximum(rise - 0.5, 0.0), 1.0 - xi,
            _unit(np.gradient(own, obs.grid)), np.gradient(xi, obs.grid)]


def _placed(blocks: list[tuple[Key, Array]], columns: Mapping[Key, slice]) -> Array:
    """(n, p) of a record's rows."""
    rows = []
    for key, block in blocks:
        rows.append(np.zeros((len(block), sum(n for _, n in columns))))
        if key in columns:
            rows[-1][:, columns[key]] = block
    return np.vstack(rows)


def _remembered(history: Array, memory: float, grid: Array) -> Array:
    """First-order lag of (n,) values on a grid (n,) s that need not be even."""
    cell = max(float(np.median(np.diff(grid))), float(np.ptp(grid)) / _MOST_CELLS)
    even = np.arange(grid[0], grid[-1] + cell, cell)
    slow = first_order_lag(np.interp(even, grid, history), float(np.exp(-cell / memory)))
    return np.interp(grid, even, slow)


def _unit(history: Array) -> Array:
    largest = float(np.max(np.abs(history)))
    return history / largest if largest > 0.0 else history
