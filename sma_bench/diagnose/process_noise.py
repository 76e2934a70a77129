"""At which stage of the model something is missing: a smooth unknown input for each, in turn.

An input of 30 knots a record is let into one stage of the model, linearised about a fit: power into
every warm wire, a shift of the transition temperatures, a factor of the motion, a factor of the
conductance that the current shows, an error of the sensors. What it gains over the fit, with the
likeliest size, says how well a term of that stage would explain what is left (stochastic grey-box
models point at the deficient equation likewise: N. R. Kristensen, H. Madsen, S. B. Jorgensen,
Automatica 40, 2004). It names no cause.
"""

import numpy as np

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.diagnose.left_over import Flexible, smooth_response
from sma_bench.diagnose.result import Missed
from sma_bench.estimation.observation import MOVED, Observation
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS

_KNOTS = 30
_POWER = 0.02  # of the largest that a record has, for derivatives
_SHIFT = 1.0  # K
_MOST = 0.8  # of what the input does lies in the stretch that is said


def process_noise(fitted: Fit) -> dict[str, Flexible]:
    """What an input to each stage explains, the best stage first."""
    made = in_threads(_inputs, [(obs, fitted.parameters) for obs in fitted.problem.observations])
    stages = dict.fromkeys(stage for own in made for stage in own)

    def found(stage: str) -> Flexible:
        # Every record has an input of its own.
        parts = [own.get(stage) for own in made]
        rows = [sum(len(s.time) for s in obs.signals) for obs in fitted.problem.observations]
        features = np.zeros((sum(rows), _KNOTS * len(made)))
        for k, (part, n) in enumerate(zip(parts, rows, strict=True)):
            if part is not None:
                first = sum(rows[:k])
                features[first : first + n, k * _KNOTS : (k + 1) * _KNOTS] = part
        features /= max(float(np.sqrt(np.mean(fitted.problem.whiten(features) ** 2))), 1e-12)
        return smooth_response(fitted, features, {(stage, 0): slice(0, features.shape[1])})

    each = dict(zip(stages, in_threads(found, [(stage,) for stage in stages]), strict=True))
    return dict(sorted(each.items(), key=lambda item: -item[1].gain))


def missed(fitted: Fit, stage: str, best: Flexible) -> Missed | None:
    """What an input to a stage says; None where it gains nothing."""
    if best.gain <= 0.0:
        return None
    # The shortest stretch of one record that holds most of what the input does there.
    power = fitted.problem.whiten(best.response) ** 2
    blocks = fitted.problem.blocks
    total = {o.path: sum(float(power[b.rows].sum()) for b in blocks if b.observation is o)
             for o in fitted.problem.observations}  # fmt: skip
    obs = max(fitted.problem.observations, key=lambda o: total[o.path])
    own = [block for block in blocks if block.observation is obs]
    time = np.concatenate([block.signal.time for block in own])
    order = np.argsort(time)
    share = np.cumsum(np.concatenate([power[block.rows] for block in own])[order])
    time, share = time[order], share / max(float(share[-1]), 1e-12)
    ends = np.minimum(np.searchsorted(share, share + _MOST), len(time) - 1)
    lengths = np.where(share <= 1.0 - _MOST + 1e-9, time[ends] - time, np.inf)
    first = int(np.argmin(lengths))
    start, stop = float(time[first]), float(time[ends[first]])
    phases, counts = np.unique(obs.phase_of(np.linspace(start, stop, 50)), return_counts=True)
    return Missed(stage, best.gain, obs.path, start, stop, str(phases[np.argmax(counts)]))


def _inputs(obs: Observation, parameters: Parameters) -> dict[str, Array]:
    """(rows of the record, knots) of what an input of each stage does to the readings."""
    obs = obs.coarse
    base = obs.simulate(parameters)
    before = np.concatenate(obs.readings(base))
    knots = np.linspace(obs.grid[0], obs.grid[-1], _KNOTS)
    hats = np.column_stack([np.interp(obs.grid, knots, row) for row in np.eye(_KNOTS)])
    times = np.concatenate([signal.time for signal in obs.signals])
    at_bins = np.column_stack([np.interp(times, knots, row) for row in np.eye(_KNOTS)])

    def only(quantities: tuple[str, ...], values: Array) -> Array:
        chosen = [np.full(len(s.time), s.quantity in quantities) for s in obs.signals]
        return np.where(np.concatenate(chosen), values, 0.0)[:, None] * at_bins

    # Of heat a wire has too much or too little as far as it is warm.
    ambient = parameters["environment.ambient_temperature"]
    excess = np.maximum(base.temperature - ambient, 0.0)
    squares = obs.voltage**2
    power = _POWER * float(squares.max()) * excess / max(float(excess.max()), 1e-9)
    heated = [
        np.concatenate(obs.readings(obs.simulate(parameters, np.sqrt(squares + hat * power))))
        for hat in hats.T[:, :, None]
    ]
    shifted = parameters.replace({n: parameters[n] + _SHIFT for n in TRANSITIONS.values()})
    shift = np.concatenate(obs.readings(obs.simulate(shifted))) - before
    offset = np.concatenate([np.full(len(s.time), s.noise) for s in obs.signals])
    found = {
        "thermal": np.column_stack(heated) - before[:, None],
        "transformation": shift[:, None] * at_bins,
        "mechanical": only(MOVED, before),
        "electrical": only(("current",), before),
        "sensor": only(("temperature",), before - ambient) + only(MOVED, offset),
    }
    return {stage: part for stage, part in found.items() if np.any(part)}
