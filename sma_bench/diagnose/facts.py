"""What speaks for a verdict and against it, as the plain facts of a result."""

from sma_bench.diagnose.decision import (
    FLEXIBLE,
    LEFT_OUTLIER,
    LEFT_RATIO,
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    Candidate,
    Decision,
    signs_of_unexplained,
)
from sma_bench.diagnose.result import Difference, Explanation, LeftOver, Moved
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import locate
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.solver import Fit
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS

SURPRISING = 2.0  # prior deviations
_SMOOTHER = ("wire.transition_spread", "wire.transition_tail")
_WORTH_SAYING = 0.02  # probability of `unexplained`


def explanation(candidate: Candidate) -> Explanation:
    """A candidate without its fit, with the numbers of its effects."""
    numbers = {}
    if candidate.fit is not None and candidate.effects:
        unknowns = candidate.fit.unknowns
        values, stds = unknowns.values(candidate.fit.x), candidate.fit.errors
        for k in range(unknowns.baseline, len(values)):
            name = unknowns.names[k]
            numbers[name] = Estimate(float(values[k]), float(stds[k]), BY_NAME[name].unit)
    stage = "+".join(dict.fromkeys(EFFECTS[name].stage for name in candidate.effects))
    return Explanation(
        candidate.name, candidate.probability, stage, numbers, candidate.gap, candidate.gain
    )


def moved_parameters(model: Fit) -> tuple[Moved, ...]:
    """Parameters of the bench beyond SURPRISING prior deviations, the farthest first."""
    unknowns = model.unknowns
    values, deviations = unknowns.values(model.x), unknowns.deviations(model.x)
    moved = [
        Moved(item.name, value - item.mean, BY_NAME[item.name].unit, deviation)
        for item, value, deviation in zip(
            unknowns.items[: unknowns.bench], values.tolist(), deviations.tolist(), strict=False
        )
    ]
    far = (one for one in moved if abs(one.deviations) > SURPRISING)
    return tuple(sorted(far, key=lambda one: -abs(one.deviations)))


def smoother_kinetics(model: Fit) -> dict[str, Estimate]:
    """By what the model's kinetics are smoother than the cosine's, which is no effect."""
    values, stds = model.unknowns.values(model.x).tolist(), model.std.tolist()
    return {
        name: Estimate(value, std, BY_NAME[name].unit)
        for name, value, std in zip(model.unknowns.names, values, stds, strict=True)
        if name in _SMOOTHER and value > SURPRISING * std
    }


def difference(decision: Decision) -> Difference | None:
    """Where the two most probable models differ most."""
    models = [(c, c.fit) for c in decision.candidates if c.fit is not None and c.name != NO_GAP]
    if len(models) < 2 or decision.verdict in (NO_GAP, UNEXPLAINED):
        return None
    (first, one), *others = models
    # One that only adds to the first is no rival of it.
    own = set(first.effects)
    rivals = [(c, fit) for c, fit in others if not (own and own <= set(c.effects))]
    rival, other = (rivals or others)[0]
    cell = locate(one.problem, one.predicted - other.predicted)[0]
    return Difference((first.name, rival.name), cell)


def left_behind(search: Search, model: Fit) -> LeftOver:
    """What the best model leaves, its signs that are no noise apart."""
    if model.unknowns.effects:
        left, gain, by = search.left_by_best, search.beyond.gain, "the best model"
    else:
        left, gain, by = search.left, search.flexible.gain, RECALIBRATION
    return LeftOver(
        by, gain, left.signal, left.ratio if left.ratio > LEFT_RATIO else 0.0,
        left.outlier if left.outlier > LEFT_OUTLIER else 0.0, gain > FLEXIBLE,
    )


def unexplained_sign(decision: Decision, search: Search) -> str:
    """The sign that weighs most for a cause outside the library; "" where it is out of question."""
    found = next(c for c in decision.candidates if c.name == UNEXPLAINED)
    if found.probability < _WORTH_SAYING or decision.verdict == NO_GAP:
        return ""
    signs = signs_of_unexplained(search)
    name = max(signs, key=lambda sign: signs[sign])
    return name if signs[name] > 0.0 else "no sign was found, which is no proof that there is none"
