"""At which stage of the model something is missing: a smooth unknown input for each, in turn.

An input of 30 knots a record is let into one stage of the model, linearised about a fit: power into
every warm wire, a factor of the conductance, a shift of the transition temperatures or another
function of the temperature, a factor of the motion, an error of one kind of sensor, or a reading
that follows the drive at once, or bends. What the best of a stage gains over the fit, with the
likeliest size, says how well a term of that stage would explain what is left (stochastic grey-box
models point at the deficient equation likewise: N. R. Kristensen, H. Madsen, S. B. Jorgensen,
Automatica 40, 2004). It names no cause.
"""

import numpy as np
from scipy.linalg import block_diag

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.diagnose.left_over import Flexible, smooth_response
from sma_bench.diagnose.result import Missed
from sma_bench.estimation.observation import MOVED, Observation
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS

_KNOTS = 30
_LEVELS = 8  # of the temperature
_POWER = 0.02  # of the largest that a record has, for derivatives
_SHIFT = 1.0  # K
_MOST = 0.8  # of what the input does lies in the stretch that is said, a tenth before it


def process_noise(fitted: Fit) -> dict[str, Flexible]:
    """What the best input to each stage explains, the best stage first."""
    made = in_threads(_inputs, [(obs, fitted.parameters) for obs in fitted.problem.observations])
    rows = [sum(len(s.time) for s in obs.signals) for obs in fitted.problem.observations]

    def found(key: tuple[str, str]) -> Flexible:
        # Every record has an input of its own.
        parts = [own.get(key, np.zeros((n, 0))) for own, n in zip(made, rows, strict=True)]
        features = block_diag(*parts)
        features /= max(float(np.sqrt(np.mean(fitted.problem.whiten(features) ** 2))), 1e-12)
        return smooth_response(fitted, features, {(key[0], 0): slice(0, features.shape[1])})

    keys = list(dict.fromkeys(key for own in made for key in own))
    each: dict[str, Flexible] = {}
    for (stage, _), one in zip(keys, in_threads(found, [(key,) for key in keys]), strict=True):
        each[stage] = max(each.get(stage, one), one, key=lambda own: own.gain)
    return dict(sorted(each.items(), key=lambda item: -item[1].gain))


def missed(fitted: Fit, stage: str, best: Flexible) -> Missed | None:
    """What an input to a stage says; None where it gains nothing."""
    if best.gain <= 0.0:
        return None
    # The stretch of one record that holds most of what the input does there.
    power = fitted.problem.whiten(best.response) ** 2
    blocks = fitted.problem.blocks
    total = {o.path: sum(float(power[b.rows].sum()) for b in blocks if b.observation is o)
             for o in fitted.problem.observations}  # fmt: skip
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
    """(rows of the record, columns) of what every input of a stage does to the readings."""
    obs = obs.coarse
    base = obs.simulate(parameters)
    before = np.concatenate(obs.readings(base))
    times = np.concatenate([signal.time for signal in obs.signals])
    knots = np.linspace(obs.grid[0], obs.grid[-1], _KNOTS)
    hats, at_bins = _hats(obs.grid, knots), _hats(times, knots)

    def only(quantities: tuple[str, ...], columns: Array) -> Array:
        chosen = [np.full(len(s.time), s.quantity in quantities) for s in obs.signals]
        return np.where(np.concatenate(chosen)[:, None], columns, 0.0)

    def driven(squares: Array) -> Array:
        """What is read otherwise under these squares of the volts (n, w)."""
        return np.concatenate(obs.readings(obs.simulate(parameters, np.sqrt(squares)))) - before

    def averages(columns: Array) -> Array:
        return np.vstack([signal.average @ columns for signal in obs.signals])

    # Too much or too little heat: as far as a wire is warm, or as a conductance of its drive.
    ambient, squares = parameters["environment.ambient_temperature"], obs.voltage**2
    warm = np.maximum(base.temperature - ambient, 0.0)
    power = _POWER * float(squares.max()) * warm / max(float(warm.max()), 1e-9)
    heated, conducted = (
        np.column_stack([driven(squares + hat * more) for hat in hats.T[:, :, None]])
        for more in (power, _POWER * squares))
    # A transformation that comes early or late, or is another function of the temperature.
    shifted = parameters.replace({n: parameters[n] + _SHIFT for n in TRANSITIONS.values()})
    shift = np.concatenate(obs.readings(obs.simulate(shifted))) - before
    rungs = ambient + np.linspace(0.0, float(warm.max()), _LEVELS + 1)
    levels = np.hstack([_hats(own, rungs)[:, 1:] for own in base.temperature.T])
    # A reading that follows the drive at once, or bends.
    drive, bend = averages(obs.voltage.sum(axis=1)[:, None]), (before**2)[:, None]
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
        ("sensor", "bend"): only(MOVED, bend),
    }  # fmt: skip
    return {key: part for key, part in found.items() if np.any(part)}


def _hats(at: Array, knots: Array) -> Array:
    """(n, k) of what each knot weighs between its neighbours."""
    return np.column_stack([np.interp(at, knots, row) for row in np.eye(len(knots))])
