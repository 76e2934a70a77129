"""From fitted candidates to probabilities and a verdict.

What speaks for and against a candidate is weighed as learnt from cases whose truth is known
(utilities.py): no number of this file was chosen by hand on cases. What is at work is named from a
probability of 0.6, the contract's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from sma_bench.diagnose.facts import REMARK, effect_fits, own_gap
from sma_bench.diagnose.result import JOIN, NO_GAP, RECALIBRATION, Explanation, Verdict, inclusion
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.utilities import Utilities
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import LAW_EFFECT, OTHER_LAWS
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.physics.effects import EFFECTS

BENIGN = (RECALIBRATION, NO_GAP)  # names of candidates without a cause
NAMED = 0.6  # probability from which what is at work is named
WORTH_SAYING = 0.02  # probability
# Of the noise: less of another law is what every bench has. And the nats by which its two shares
# are sure, which is a chance of one in 250.
LAW_SHOWS, LAW_SURE = 2.0, 5.5


@dataclass(frozen=True, eq=False)
class Candidate(Explanation):
    """An explanation with the fit of its model, None for unexplained."""

    fit: Fit | None = None


def decide(search: Search, weighed: Utilities) -> tuple[Candidate, ...]:
    """All candidates, the most probable first. Of a pair whose worse half does next to nothing the
    better one is the cause: what the pair has, that one has, and the worse half is its remark."""
    found, facts = weighed.found, weighed.found.candidates
    fits: dict[str, Fit] = effect_fits(search)
    fits |= {RECALIBRATION: search.recalibrated, NO_GAP: search.nominal}
    probabilities = dict(zip(weighed.names, weighed.probabilities().tolist(), strict=True))
    remarks = dict[str, dict[str, float]]()
    for pair, (main, small) in found.remarks().items():
        share, parts = probabilities.pop(pair), facts[pair].parts
        probabilities[main] += share
        if share >= WORTH_SAYING:
            remarks.setdefault(main, {})[small] = parts[small] / parts[main]
    nats, candidates = weighed.nats(), []
    for name, probability in probabilities.items():
        stages, numbers, gap, gain = [], {}, found.moved, 0.0
        if name in facts:
            fitted, gap, gain = fits[name], facts[name].gap, facts[name].gain
            stages = [EFFECTS[effect].stage for effect in fitted.unknowns.effects]
            numbers = dict(list(estimates(fitted).items())[fitted.unknowns.baseline :])
        candidates.append(Candidate(name, probability, JOIN.join(dict.fromkeys(stages)), numbers,
                                    gap, gain, remarks.get(name, {}), nats[name], fits.get(name)))
    return tuple(sorted(candidates, key=lambda c: (-c.probability, c.name)))


def with_law(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The same, another law of the phase named where it shows: it is free in every candidate, as
    real kinetics are never quite a cosine. Alone it is a cause in recalibration's place, with an
    effect a second one, or a remark."""
    found, emptied = [], list[Candidate]()
    for one in candidates:
        if one.fit is None or one.probability < WORTH_SAYING or one.name == NO_GAP:
            found.append(one)
            continue
        gap, gain, numbers = law_of(one.fit)
        share = gap / max(one.gap_over_noise, gap, 1e-3)
        shows = gap >= LAW_SHOWS and gain > LAW_SURE
        if shows and one.name == RECALIBRATION:
            stage, emptied = EFFECTS[LAW_EFFECT].stage, [replace(one, probability=0.0)]
            one = replace(one, name=LAW_EFFECT, stage=stage, parameters=numbers,
                          gap_over_noise=gap, log_evidence=gain)  # fmt: skip
        elif shows and len(one.effects) == 1 and share >= REMARK:
            name = JOIN.join(sorted((*one.effects, LAW_EFFECT)))
            one = replace(one, name=name, parameters={**one.parameters, **numbers})
        elif shows:
            one = replace(one, beside={**one.beside, LAW_EFFECT: share})
        found.append(one)
    return (*found, *emptied)


def law_of(fitted: Fit) -> tuple[float, float, dict[str, Estimate]]:
    """What another law does in a fit, in noise; nats that a straight line promises it; shares."""
    items = fitted.unknowns.items  # a law that is believed in is no cause
    places = [k for k, item in enumerate(items) if item.name in OTHER_LAWS and item.mean == 0.0]
    if not places or not np.any(fitted.unknowns.values(fitted.x)[places]):
        return 0.0, 0.0, {}
    x, covariance = fitted.x[places], fitted.covariance[np.ix_(places, places)]
    numbers = {n: e for n, e in estimates(fitted).items() if n in OTHER_LAWS}
    return own_gap(fitted, (LAW_EFFECT,)), 0.5 * float(x @ np.linalg.solve(covariance, x)), numbers


def estimates(fitted: Fit) -> dict[str, Estimate]:
    """All numbers of a fit with their errors."""
    values, stds = fitted.unknowns.values(fitted.x).tolist(), fitted.errors.tolist()
    return {name: Estimate(value, std, BY_NAME[name].unit)
            for name, value, std in zip(fitted.unknowns.names, values, stds, strict=True)}


def named(candidates: Sequence[Candidate], weighed: Utilities) -> tuple[str, ...]:
    """Effects that are at work, whatever else is: what gains most by itself first."""
    found, facts = inclusion(candidates), weighed.found.candidates
    return tuple(sorted((name for name, p in found.items() if p >= NAMED),
                        key=lambda name: -facts[name].gain if name in facts else 0.0))


def verdict_of(candidates: Sequence[Candidate]) -> Verdict:
    """What is said of candidates, the most probable first."""
    if max(inclusion(candidates).values(), default=0.0) >= NAMED:
        return "effect"
    first = candidates[0].name
    likely = sum(c.probability for c in candidates if c.name in BENIGN)
    if (likely if first in BENIGN else candidates[0].probability) < NAMED:
        return "ambiguous"
    return cast(Verdict, first)
