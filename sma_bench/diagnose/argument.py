"""Why the verdict is what it is, in sentences made from its numbers."""

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
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import Cell, locate
from sma_bench.estimation.solver import Fit
from sma_bench.parameters.table import BY_NAME
from sma_bench.results import (
    DIFFER_MOST,
    NEEDS_NONE,
    NEEDS_OFF,
    SOMETHING_ELSE,
    percent,
    with_error,
)

SURPRISING = 2.0  # prior deviations
_MOST_NAMED = 3
_SMOOTHER = ("wire.transition_spread", "wire.transition_tail")
_WORTH_SAYING = 0.02  # probability of `unexplained`
_PHASES = {
    "initial": "before the first drive", "drive": "while a wire is driven",
    "rest": "at rest after a drive",
}


def why(decision: Decision, search: Search, model: Fit) -> list[str]:
    """What speaks for the verdict, what against it, and what keeps `unexplained` alive.

    Args:
        model: of the first candidate that can be simulated.
    """
    said = [*_evidence(decision, search), *_difference(decision), _moved(model)]
    said.append(_left_over(search, model))
    return said + _unexplained(decision, search)


def cell_in_words(cell: Cell) -> str:
    """A place of the gap: signal, phase and side."""
    phase = _PHASES[cell.phase]
    if cell.signal == "deflection":
        return f"the deflection {phase}" + f", {cell.side} side driven last" * bool(cell.side)
    channel, _, quantity = cell.signal.rpartition(".")
    return f"the {quantity} of {channel}{f' ({cell.side} side)' * bool(cell.side)} {phase}"


def surprising(model: Fit) -> list[tuple[str, float, float]]:
    """Parameters of the bench beyond SURPRISING prior deviations, the farthest first: name,
    change in its unit, change in prior deviations."""
    unknowns = model.unknowns
    values, deviations = unknowns.values(model.x), unknowns.deviations(model.x)
    moved = [
        (item.name, value - item.mean, deviation)
        for item, value, deviation in zip(
            unknowns.items[: unknowns.bench], values.tolist(), deviations.tolist(), strict=False
        )
    ]
    return sorted((m for m in moved if abs(m[2]) > SURPRISING), key=lambda m: -abs(m[2]))


def _evidence(decision: Decision, search: Search) -> list[str]:
    first, *others = decision.candidates
    if not first.effects:
        if not search.ranked:
            return []
        gain = search.gain(search.ranked[0])
        return [
            f"The effect that would explain most is {search.ranked[0]}, with a log evidence of "
            f"{gain:+.1f} nats over recalibration."
        ]
    said = f"Its log evidence is {first.gain:+.1f} nats over moving the parameters alone."
    if others[0].effects:
        said += (
            f" Next is {others[0].name} with {others[0].gain:+.1f} nats (probability "
            f"{percent(others[0].probability)})."
        )
    return [said]


def _difference(decision: Decision) -> list[str]:
    """Where the two most probable models differ most."""
    models = [c for c in decision.candidates if c.fit is not None and c.name != NO_GAP]
    if len(models) < 2 or decision.verdict in (NO_GAP, UNEXPLAINED):
        return []
    first = models[0]
    # One that only adds to the first is no rival of it.
    own = set(first.effects)
    rival = next((c for c in models[1:] if not (own and own <= set(c.effects))), models[1])
    one, other = _fit(first), _fit(rival)
    cell = locate(one.problem, one.predicted - other.predicted)[0]
    return [
        f"{first.name} and {rival.name}, each at its best, {DIFFER_MOST} "
        f"{cell_in_words(cell)}: by {cell.gap:.2g} times the noise."
    ]


def _fit(candidate: Candidate) -> Fit:
    assert candidate.fit is not None
    return candidate.fit


def _moved(model: Fit) -> str:
    """Which parameters the model needs elsewhere than where they are believed, and whether its
    kinetics are smoother than the cosine's, which is neither that nor an effect."""
    moved = surprising(model)
    if not moved:
        return (
            f"{NEEDS_NONE} farther than two of its standard deviations from where it is "
            f"believed.{_kinetics(model)}"
        )
    named = "; ".join(
        f"{name} {change:+.3g} {BY_NAME[name].unit}".rstrip() + f" ({deviations:+.1f})"
        for name, change, deviations in moved[:_MOST_NAMED]
    )
    more = len(moved) - _MOST_NAMED
    rest = f"; and {more} more" if more > 0 else ""
    far = f"{NEEDS_OFF} what is believed (in standard deviations): {named}{rest}."
    return far + _kinetics(model)


def _kinetics(model: Fit) -> str:
    """"" where the cosine's do as well."""
    values, stds = model.unknowns.values(model.x), model.std
    smooth = [
        f"{name.partition('.')[2].replace('_', ' ')} {with_error(value, std)} {BY_NAME[name].unit}"
        for name, value, std in zip(model.unknowns.names, values, stds.tolist(), strict=True)
        if name in _SMOOTHER and value > SURPRISING * std
    ]
    if not smooth:
        return ""
    return f" Its kinetics are mildly smoother than the cosine's, no effect: {', '.join(smooth)}."


def _left_over(search: Search, model: Fit) -> str:
    if model.unknowns.effects:
        left, gain, what = search.left_by_best, search.beyond.gain, "the best model"
    else:
        left, gain, what = search.left, search.flexible.gain, RECALIBRATION
    signs = []
    if left.ratio > LEFT_RATIO:
        signs.append(
            f"{left.signal} scatters more while the bench moves than while it rests "
            f"({left.ratio:.1f} standard deviations)"
        )
    if left.outlier > LEFT_OUTLIER:
        signs.append(f"a single event stands out by {left.outlier:.1f} standard deviations")
    if gain > FLEXIBLE:
        signs.append(f"a smooth response of free form would gain {gain:.1f} nats")
    if not signs:
        return (
            f"What {what} leaves looks like noise: it does not know when the bench moves, no "
            "single event stands out, and a smooth response of free form (to drive, temperature, "
            f"bending and time) would gain {gain:.1f} nats only."
        )
    return f"What {what} leaves is not noise alone: {'; '.join(signs)}."


def _unexplained(decision: Decision, search: Search) -> list[str]:
    """The sign that weighs most for a cause outside the library."""
    found = next(c for c in decision.candidates if c.name == UNEXPLAINED)
    if found.probability < _WORTH_SAYING or decision.verdict == NO_GAP:
        return []
    signs = signs_of_unexplained(search)
    name = max(signs, key=lambda sign: signs[sign])
    share = f"{SOMETHING_ELSE} keeps {percent(found.probability)}"
    if signs[name] <= 0.0:
        return [f"{share}: no sign of it was found, which is no proof that there is nothing."]
    return [f"{share}: {name}."]
