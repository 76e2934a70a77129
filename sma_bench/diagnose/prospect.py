"""The verdict to be expected after an experiment, by the decision's own rule, as noise may fall."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from sma_bench.diagnose.decision import NAMED, NO_GAP, RECALIBRATION, Weights, scale_of

VISIBLE = 2.0  # standard deviations
_LUCK = ndtri((np.arange(7) + 0.5) / 7.0)  # of noise, in standard deviations


class Telling(NamedTuple):
    """What an experiment would say against a rival of the truth: the `evidence` to be expected
    [nats], and the `distance` of the two in standard deviations, by which noise scatters it."""

    evidence: float
    distance: float


Tellings = Mapping[tuple[str, str], Telling]


class Prospect(NamedTuple):
    """Probabilities that the verdict after an experiment names the true cause, and that the true
    cause is `given`: the mean of what it would have."""

    named: float
    given: float


def prospect(
    weights: Weights, probability: Mapping[str, float], tellings: Tellings
) -> Prospect:
    """What an experiment would say, whichever cause is true.

    Args:
        weights: as they are now, the effects' gains before the experiment.
        probability: of every candidate now.
        tellings: by (truth, rival) of the causes that were simulated; another cause stays as
            probable beside the truth as it is.
    """
    simulated = list(dict.fromkeys(name for pair in tellings for name in pair))
    named = given = 0.0
    for truth in simulated:
        right = (truth,) if truth != RECALIBRATION else (RECALIBRATION, NO_GAP)
        own = sum(probability[name] for name in right)
        for luck in _LUCK:
            after = _after(weights, truth, simulated, tellings, luck)
            share = sum(after[name] for name in right)
            given += own * share / len(_LUCK)
            named += own * (share >= NAMED) / len(_LUCK)
    return Prospect(named, given)


def _after(
    weights: Weights, truth: str, simulated: Sequence[str], tellings: Tellings, luck: float
) -> dict[str, float]:
    """Probabilities after an experiment."""
    against = {
        rival: _expected(tellings, truth, rival, luck) for rival in simulated if rival != truth
    }
    over = against.get(RECALIBRATION, 0.0)
    now, own = weights.gains, weights.gains.get(truth, 0.0)
    gains = {c: now[c] + over - against.get(c, 0.0) for c in simulated if c in now}
    best = max([0.0, *gains.values()])
    stretch = scale_of(best) / scale_of(max([0.0, *now.values()]))
    # What was not simulated goes with the truth, as probable beside it as before.
    gains |= {
        c: own + over - (own - gain) * stretch for c, gain in now.items() if c not in gains
    }
    return replace(weights, gains=gains).probabilities()


def _expected(tellings: Tellings, truth: str, rival: str, luck: float) -> float:
    """Nats against a rival of the truth, as noise may fall.

    An effect that is not there is told by not being seen, which takes an experiment that would show
    it; without that its freedom alone speaks against it, and that settles nothing.
    """
    telling = tellings[truth, rival]
    nats = telling.evidence + luck * telling.distance
    visible = max(telling.distance, tellings[rival, truth].distance) >= VISIBLE
    return nats if visible else min(nats, 0.0)
