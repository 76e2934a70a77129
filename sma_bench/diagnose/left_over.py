"""Is the residual of a fit noise? Noise does not depend on what the bench does.

Three tests of the whitened residual: does it scatter more while the signal moves than at rest; how
much of it does a smooth response to drive, temperature, bending and time explain (linear in
features of the simulation, with Gaussian weights of the most likely size: an effect repeats under
the same conditions, drift does not); and at which stage does an unknown input explain most."""

from dataclasses import dataclass, replace
from functools import cache, partial
from operator import itemgetter

import numpy as np
from scipy.linalg import block_diag

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.diagnose.result import Missed
from sma_bench.estimation.observation import MOVED, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.physics.simulate import Simulation
from sma_bench.records.record import first_order_lag

_FEWEST = 30  # samples in motion, and at rest, for a comparison
_MEMORIES = (1.0, 5.0, 25.0, 100.0)  # s, time constants of features
_SIZES = np.geomspace(0.1, 1000.0, 9)  # standard deviations tried for the weights
_ROUNDS = 3  # of fitting response and noise model in turn
_MOST_CELLS = 1_000_000  # of an even grid
_CURVED = 0.1  # of a motion, standard deviation of a bent sensor's error at its end
_KNOTS = 30  # of an input, per record
_LEVELS = 8  # knots of the temperature
_POWER = 0.02  # of a record's largest power, added for derivatives
_SHIFT = 1.0  # K, of the transition temperatures, for derivatives
_MOST = 0.8  # share of an input's effect in the reported stretch; a tenth lies before it


@dataclass(frozen=True)
class ResidualTest:
    """Residual of a fit in motion and at rest."""

    ratio: float  # log of variance in motion over at rest, in standard deviations; largest of all
    signal: str  # the one with this ratio
    outlier: float  # largest whitened residual, in standard deviations: a single event shows there


def residual_test(fitted: Fit) -> ResidualTest:
    """Compare the residual above and below the median speed of each simulated signal."""
    problem, found, outlier = fitted.problem, [(-np.inf, "")], 0.0
    rates = [rate for o in problem.observations for rate in o.rates(o.simulate(fitted.parameters))]
    for block, rate in zip(problem.blocks, rates, strict=True):
        white = problem.noise[block.signal.name].whiten(fitted.residual[block.rows])
        moving = np.abs(rate) > np.median(np.abs(rate))
        if min(moving.sum(), (~moving).sum()) < _FEWEST:
            continue
        fast, slow = float(np.mean(white[moving] ** 2)), float(np.mean(white[~moving] ** 2))
        spread = np.sqrt(2.0 / moving.sum() + 2.0 / (~moving).sum())
        found.append((float(np.log(fast / slow) / spread), block.signal.name))
        outlier = max(outlier, float(np.max(np.abs(white))))
    return ResidualTest(*max(reversed(found), key=itemgetter(0)), outlier)


@dataclass(frozen=True, eq=False)
class SmoothResponse:
    """A smooth response of free form, fitted to the residual of a fit."""

    gain: float  # nats over the fit, each with the noise model of its own residual
    response: Array  # (n,) of the readings


def free_response(fitted: Fit) -> SmoothResponse:
    """Fit a response to the features of drive, temperature, bending and time."""
    made = [own for o in fitted.problem.observations
            for own in _features(o, o.simulate(fitted.parameters))]
    # Records with the same signal share the weights of its features.
    keys = dict.fromkeys(key for key, _ in made)
    rows = [np.hstack([block if one == key else np.zeros((len(block), one[1])) for one in keys])
            for key, block in made]
    return smooth_response(fitted, np.vstack(rows))


def smooth_response(fitted: Fit, features: Array) -> SmoothResponse:
    """Fit features (n, p) with independent Gaussian weights to the residual of a fit."""
    own = _likelihood(fitted.problem, fitted.residual)
    # Begin with little drift: the noise model of a poor fit has absorbed the residual.
    noises = {name: replace(noise, drift=min(noise.drift, noise.white))
              for name, noise in fitted.problem.noise.items()}
    problem = replace(fitted.problem, noise=noises)
    best = SmoothResponse(0.0, np.zeros_like(fitted.residual))
    for _ in range(_ROUNDS):
        # Project out what the fitted unknowns could still absorb.
        rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
        normal = rows.T @ rows + np.eye(rows.shape[1])
        phi, base = problem.whiten(features), problem.whiten(fitted.residual)
        across = rows.T @ phi
        taken = np.linalg.solve(normal, np.column_stack([across, rows.T @ base]))
        values, vectors = np.linalg.eigh(phi.T @ phi - across.T @ taken[:, :-1])
        values = np.maximum(values, 0.0)
        turned = vectors.T @ (phi.T @ base - across.T @ taken[:, -1])
        # Gain in marginal likelihood, and the weights, with the likeliest size.
        shrunk = [np.zeros(len(turned)), *(turned / (values + size**-2) for size in _SIZES)]
        gains = np.nan_to_num([0.5 * (turned @ x - np.sum(np.log1p(size**2 * values)))
                               for x, size in zip(shrunk, (0.0, *_SIZES), strict=True)])
        gain = _likelihood(problem, fitted.residual) + float(max(gains)) - own
        response = features @ (vectors @ shrunk[int(np.argmax(gains))])
        if gain > best.gain:
            best = SmoothResponse(gain, response)
        problem = problem.with_noise(fitted.residual - response)
    return best


def _likelihood(problem: Problem, residual: Array) -> float:
    """Log likelihood of a residual (n,), with the prior of its noise model."""
    white = problem.whiten(residual)
    return float(-0.5 * white @ white) - problem.log_scale() + problem.log_prior()


def _features(obs: Observation, simulation: Simulation) -> list[tuple[tuple[str, int], Array]]:
    """(rows, features) of each signal of a record, in units of its noise; by its name and number of
    features, which differs between benches with other sides."""
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


def _remembered(history: Array, memory: float, grid: Array) -> Array:
    """First-order lag of (n,) values on a grid (n,) s that may be uneven."""
    cell = max(float(np.median(np.diff(grid))), float(np.ptp(grid)) / _MOST_CELLS)
    even = np.arange(grid[0], grid[-1] + cell, cell)
    slow = first_order_lag(np.interp(even, grid, history), float(np.exp(-cell / memory)))
    return np.interp(grid, even, slow)


def _unit(history: Array) -> Array:
    largest = float(np.max(np.abs(history)))
    return history / largest if largest > 0.0 else history


# --- The stage of the model at which something is missing: a smooth unknown input to each in turn.
#
# An input with 30 knots per record is added to one stage of the model (`_inputs`), linearised about
# a fit: its gain tells how well a term of that stage would explain the residual (as in stochastic
# grey-box models: N. R. Kristensen, H. Madsen, S. B. Jorgensen, Automatica 40, 2004).


def process_noise(fitted: Fit) -> dict[str, SmoothResponse]:
    """The best input to each stage, the stage with the largest gain first."""
    made = in_threads(_inputs, [(obs, fitted.parameters) for obs in fitted.problem.observations])
    rows = [sum(len(s.time) for s in obs.signals) for obs in fitted.problem.observations]

    def found(key: tuple[str, str]) -> SmoothResponse:
        # Every record has an input of its own.
        parts = [own.get(key, np.zeros((n, 0))) for own, n in zip(made, rows, strict=True)]
        features = block_diag(*parts)
        features /= max(float(np.sqrt(np.mean(fitted.problem.whiten(features) ** 2))), 1e-12)
        return smooth_response(fitted, features)

    keys = list(dict.fromkeys(key for own in made for key in own))
    each: dict[str, SmoothResponse] = {}
    for (stage, _), one in zip(keys, in_threads(found, [(key,) for key in keys]), strict=True):
        each[stage] = max(each.get(stage, one), one, key=lambda own: own.gain)
    return dict(sorted(each.items(), key=lambda item: -item[1].gain))


def missed(fitted: Fit, stage: str, best: SmoothResponse) -> Missed | None:
    """Where an input to a stage acts; None if it gains nothing."""
    if best.gain <= 0.0:
        return None
    # The stretch of the most affected record with most of the input's effect.
    power = fitted.problem.whiten(best.response) ** 2
    blocks = fitted.problem.blocks
    total = {o.path: sum(float(power[b.rows].sum()) for b in blocks if b.observation is o)
             for o in fitted.problem.observations}
    obs = max(fitted.problem.observations, key=lambda o: total[o.path])
    own = [block for block in blocks if block.observation is obs]
    time = np.concatenate([block.signal.time for block in own])
    order = np.argsort(time)
    share = np.cumsum(np.concatenate([power[block.rows] for block in own])[order])
    ends = np.searchsorted(share, share[-1] * np.array([0.5 - _MOST / 2.0, 0.5 + _MOST / 2.0]))
    start, stop = time[order][np.minimum(ends, len(time) - 1)].tolist()
    phases, counts = np.unique(obs.phase_of(np.linspace(start, stop, 50)), return_counts=True)
    return Missed(stage, best.gain, obs.path, start, stop, str(phases[np.argmax(counts)]))


def _inputs(obs: Observation, parameters: Parameters) -> dict[tuple[str, str], Array]:
    """(rows of the record, columns): effect on the readings of every input to every stage."""
    obs = obs.coarse
    base = obs.simulate(parameters)
    before = obs.readings(base)
    times = np.concatenate([signal.time for signal in obs.signals])
    knots = np.linspace(obs.grid[0], obs.grid[-1], _KNOTS)
    hats, at_bins = _hats(obs.grid, knots), _hats(times, knots)

    def only(quantities: tuple[str, ...], columns: Array) -> Array:
        chosen = [np.full(len(s.time), s.quantity in quantities) for s in obs.signals]
        return np.where(np.concatenate(chosen)[:, None], columns, 0.0)

    def driven(squares: Array) -> Array:
        """Change of the readings with these squared voltages (n, w)."""
        return obs.readings(obs.simulate(parameters, np.sqrt(squares))) - before

    def averages(columns: Array) -> Array:
        return np.vstack([signal.average @ columns for signal in obs.signals])

    # Additional heat in proportion to a wire's rise, or to its power (a conductance).
    ambient, squares = parameters["environment.ambient_temperature"], obs.voltage**2
    warm = np.maximum(base.temperature - ambient, 0.0)
    power = _POWER * float(squares.max()) * warm / max(float(warm.max()), 1e-9)
    heated, conducted = (
        np.column_stack([driven(squares + hat * more) for hat in hats.T[:, :, None]])
        for more in (power, _POWER * squares))
    # A transformation that comes early or late, or is another function of the temperature.
    shifted = parameters.replace({n: parameters[n] + _SHIFT for n in TRANSITIONS.values()})
    shift = obs.readings(obs.simulate(shifted)) - before
    rungs = ambient + np.linspace(0.0, float(warm.max()), _LEVELS + 1)
    levels = np.hstack([_hats(own, rungs)[:, 1:] for own in base.temperature.T])
    # A reading that depends on the drive directly, or is not linear.
    drive = averages(obs.voltage.sum(axis=1)[:, None])
    found = {
        ("thermal", "power"): heated,
        ("transformation", "shift"): shift[:, None] * at_bins,
        ("transformation", "levels"): only(MOVED, averages(levels)),
        ("mechanical", "factor"): only(MOVED, before[:, None] * at_bins),
        ("electrical", "conductance"):
            conducted + only(("current",), 0.5 * _POWER * before[:, None] * at_bins),
        ("sensor", "temperature"): only(("temperature",), (before - ambient)[:, None] * at_bins),
        ("sensor", "current"): only(("current",), before[:, None] * at_bins),
        ("sensor", "offset"): only(MOVED, at_bins),
        ("sensor", "drive"): only(MOVED, drive),
        ("sensor", "bend"): only(MOVED, _bent(before)),
    }
    return {key: part for key, part in found.items() if np.any(part)}


def sensor_curve(fitted: Fit) -> float:
    """Nats that the same model gains if the readings of motions lie on a bent curve: a sensor that
    is not linear is no effect of the library, but a rival of each."""
    given, bent = fitted.problem, fitted
    moves = [block for block in given.blocks if block.signal.quantity in MOVED]
    if not moves:
        return 0.0
    # Begin with little drift: the noise model of a poor fit has absorbed the residual.
    noise = {name: replace(one, drift=min(one.drift, one.white))
             for name, one in given.noise.items()}
    borders = np.cumsum([len(own.columns) for own in given.nuisances])[:-1]
    for _ in range(_ROUNDS):
        curve = np.zeros((len(bent.predicted), 2))
        for block in moves:
            size = _CURVED * float(np.ptp(block.signal.value))
            curve[block.rows] = size * _bent(bent.predicted[block.rows])
        more = tuple(own.with_columns("curve", part) for own, part in zip(
            given.nuisances, np.split(curve, borders), strict=True))
        problem = replace(given, nuisances=more, noise=noise, shared={})
        bent = fit(problem, fitted.unknowns, bent.x, rounds=2)
        noise = bent.problem.noise
    return bent.evidence - fitted.evidence


def _bent(values: Array) -> Array:
    """(n, 2) curves of a reading (n,): its square and its cube."""
    return _unit(values)[:, np.newaxis] ** np.array([2.0, 3.0])


def _hats(at: Array, knots: Array) -> Array:
    """(n, k) weights of the knots in linear interpolation."""
    return np.column_stack([np.interp(at, knots, row) for row in np.eye(len(knots))])
