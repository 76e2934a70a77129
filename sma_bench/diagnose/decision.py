"""From fitted candidates to probabilities and a verdict: a conditional logit, learnt from cases
whose true cause is known.

    p(c) = (1 - l) exp(u_c) / sum of exp(u) + l/C,    u_c = sum of w_f x_cf

Each of the C explanations (one or two effects, recalibration, no gap, unexplained) has a utility u
that is linear in features x of its kind; gains (nats) enter as logarithms, because a model's own
error grows with the gap it explains. Some weights w have a sign that physics requires. The lapse l
is the share of cases whose records say nothing (D. McFadden, Conditional logit analysis of
qualitative choice behavior, 1974; lapses: Wichmann and Hill, Percept. Psychophys. 63, 2001).
`./bench blind learn` writes the weights, none of which was chosen by hand, to weights.yaml."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import yaml
from scipy.special import softmax

from sma_bench.arrays import Array
from sma_bench.diagnose.result import (
    JOIN,
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    Explanation,
    Verdict,
    inclusion,
)
from sma_bench.diagnose.search import Search
from sma_bench.diagnose.sizes import REMARK, DecisionInputs, effect_fits, own_gap
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import LAW_EFFECT, OTHER_LAWS
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.physics.effects import EFFECTS

BENIGN = (RECALIBRATION, NO_GAP)  # candidates without a cause
NAMED = 0.6  # probability from which a cause is named, or a verdict other than ambiguous given
WORTH_SAYING = 0.02  # probability from which a candidate gets remarks
LAW_SHOWS = 2.0  # gap by another law, over noise: every bench has a smaller one
LAW_SURE = 5.5  # nats of another law, reached by chance in one of 250 cases
# Features by kind of explanation, with the sign that their weights must have (0: either).
SIGNS: dict[str, dict[str, int]] = {
    "effect": {"one": 0, "gain": 1, "lead": 1, "size": 1, "own": 0, "unsteady": -1, "rivals": -1},
    "pair": {"two": 0, "extra": 1, "partner_size": 1},
    "recalibration": {"surprise": -1},
    "no_gap": {"one": 0, "moved": -1, "as_stated": 1},
    "unexplained": {"one": 0, "beyond_share": 1, "ratio": 1, "outlier": 1, "input": 1,
                    "best_gain": 0},
}
NAMES = tuple(f"{kind}.{name}" for kind, features in SIGNS.items() for name in features)
_AT = {name: k for k, name in enumerate(NAMES)}
_WEIGHTS = Path(__file__).with_name("weights.yaml")
_LIBRARY = 18  # effects in the learning cases; if there are more, each is less probable
_NEAR = 5.0  # nats by which an effect may gain less and still be a rival
_CLOSE = 0.1  # of the gain, in addition to these
_NOISY = 4.0  # standard deviations of the largest of many samples of noise
# The model's errors repeat in every record: beyond two, gains grow with the root of their number.
_USUAL_RECORDS = 2


@dataclass(frozen=True)
class Learnt:
    """The table of weights: value and error of each feature."""

    source: str
    library: str
    ridge: float  # penalty in the fit of the weights
    fit_lapse: float  # lapse in that fit
    lapse: float
    least: float  # least probability of credible explanations, which include the true one in 90 %
    weights: dict[str, tuple[float, float]]

    @property
    def values(self) -> Array:
        return np.array([self.weights[name][0] for name in NAMES])


@cache
def learnt() -> Learnt:
    return msgspec.convert(yaml.safe_load(_WEIGHTS.read_text()), Learnt)


class Utilities:
    """Features and utilities of explanations; effects first, then the three without one."""

    def __init__(self, found: DecisionInputs) -> None:
        self.found, facts = found, found.candidates
        self.effects = tuple(facts)
        self.names = (*facts, RECALIBRATION, NO_GAP, UNEXPLAINED)
        parts = [name.split(JOIN) for name in facts]
        self._single = np.array([len(one) == 1 for one in parts], dtype=bool)
        self._singles = np.flatnonzero(self._single)
        # (c, s): whether a single effect is part of a candidate.
        part = [[self.effects[k] in one for k in self._singles] for one in parts]
        self._part = np.array(part).reshape(len(facts), len(self._singles))
        self.gains = np.array([f.gain for f in facts.values()])
        # Log odds by the library's size: N candidates bring N chances of a false alarm.
        self.fixed = np.zeros(len(self.names))
        self.fixed[: len(facts)] = -np.log(max(len(self._singles), _LIBRARY) / _LIBRARY)
        # Features that do not depend on gains.
        rows: list[dict[str, Any]] = []
        for name, one in facts.items():
            unsteady = _log(one.unsteady, 1.0) if one.gain > 0.0 else 0.0
            rows.append({"effect.one": 1.0, "effect.size": _log(one.gap / 3.0, 0.01, 1.0),
                         "effect.own": _nats(one.own, 1.0), "effect.unsteady": unsteady})
            if JOIN in name:
                least = min(one.parts.values())
                rows[-1] |= {"pair.two": 1.0, "pair.partner_size": _log(least / 3.0, 0.01, 1.0)}
        rows += [{"recalibration.surprise": _nats(found.surprise, 16.0)},
                 {"no_gap.one": 1.0, "no_gap.moved": _log(found.moved, 0.1),
                  "no_gap.as_stated": _signed(found.as_stated)},
                 {"unexplained.one": 1.0, "unexplained.ratio": _nats(found.ratio),
                  "unexplained.outlier": _nats(found.outlier - _NOISY),
                  "unexplained.input": _nats(found.input)}]
        self._plain = np.array([[row.get(name, 0.0) for name in NAMES] for row in rows], float)

    def features(self, gains: Array | None = None) -> Array:
        """(m, n, k) of the n explanations, for m sets of gains (m, c) [nats] of the effects."""
        gains = self.gains[None] if gains is None else gains
        counted = np.sqrt(_USUAL_RECORDS / max(self.found.records, _USUAL_RECORDS))
        gains = np.where(gains > 0.0, gains * counted, gains)
        x = np.repeat(self._plain[None], len(gains), axis=0)
        if not self.effects:
            return x
        effect = x[:, : len(self.effects)]
        single = gains[:, None, self._singles]
        others = np.where(self._part, -np.inf, single)  # (m, c, s)
        curve = max(self.found.curve * counted, 0.0)  # a rival of all
        lead = gains - np.maximum(others.max(axis=2), curve)
        near = gains - _NEAR - _CLOSE * np.maximum(gains, 0.0)
        better = np.where(self._part, single, -np.inf).max(axis=2)
        effect[:, :, _AT["effect.gain"]] = _nats(gains)
        effect[:, :, _AT["effect.lead"]] = _signed(lead)
        rivals = (others > near[:, :, None]).sum(axis=2) + (curve > np.maximum(near, 0.0))
        effect[:, :, _AT["effect.rivals"]] = np.log1p(rivals)
        effect[:, :, _AT["pair.extra"]] = np.where(self._single, 0.0, _signed(gains - better))
        # `unexplained` is judged by the best candidate.
        best, beyond, last = np.maximum(gains.max(axis=1), curve), self.found.beyond, x[:, -1]
        last[:, _AT["unexplained.best_gain"]] = _nats(best)
        last[:, _AT["unexplained.beyond_share"]] = beyond / (max(beyond, 0.0) + best + 4.0)
        return x

    def probabilities(self, gains: Array | None = None) -> Array:
        """(n,) of the explanations; (m, n) for m sets of gains (m, c)."""
        table = learnt()
        shares = softmax(self.features(gains) @ table.values + self.fixed, axis=1)
        shares = (1.0 - table.lapse) * shares + table.lapse / len(self.names)
        return np.asarray(shares[0] if gains is None else shares)

    def nats(self) -> dict[str, dict[str, float]]:
        """Of every explanation the terms that sum to its log odds, by feature."""
        short = [*(name.partition(".")[2] for name in NAMES), "library"]
        sums = np.column_stack([self.features()[0] * learnt().values, self.fixed])
        return {name: {feature: nats for feature, nats in zip(short, row, strict=True) if nats}
                for name, row in zip(self.names, sums.tolist(), strict=True)}


def _nats(value: Array | float, scale: float = 4.0) -> Array:
    """log(1 + value/scale): linear well below `scale`; 0 for negative values."""
    return np.asarray(np.log1p(np.maximum(value, 0.0) / scale))


def _signed(value: Array | float) -> Array:
    return np.asarray(np.sign(value) * _nats(np.abs(value)))


def _log(value: float, least: float, most: float = np.inf) -> float:
    return float(np.log(min(max(value, least), most)))


@dataclass(frozen=True, eq=False)
class Candidate(Explanation):
    """An explanation with the fit of its model, None for unexplained."""

    fit: Fit | None = None


def decide(search: Search, utilities: Utilities) -> tuple[Candidate, ...]:
    """All candidates, the most probable first. If one effect of a pair contributes almost nothing,
    the other one gets the pair's probability, and the small effect as a remark."""
    found, facts = utilities.found, utilities.found.candidates
    fits = effect_fits(search) | {RECALIBRATION: search.recalibrated, NO_GAP: search.nominal}
    probabilities = dict(zip(utilities.names, utilities.probabilities().tolist(), strict=True))
    remarks = dict[str, dict[str, float]]()
    for pair, (main, small) in found.remarks().items():
        share, parts = probabilities.pop(pair), facts[pair].parts
        probabilities[main] += share
        if share >= WORTH_SAYING:
            remarks.setdefault(main, {})[small] = parts[small] / parts[main]
    nats, candidates = utilities.nats(), []
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
    """Candidates with another law of the phase named where it shows (every fit is free to use one):
    as the cause instead of recalibration, as a second effect, or as a remark on an effect."""
    found, emptied = [], list[Candidate]()
    for one in candidates:
        if one.fit is None or one.probability < WORTH_SAYING or one.name == NO_GAP:
            found.append(one)
            continue
        gap, gain, numbers = law_of(one.fit)
        share = gap / max(one.gap_over_noise, gap, 1e-3)
        shows = gap >= LAW_SHOWS and gain > LAW_SURE
        if shows and one.name == RECALIBRATION:
            emptied = [replace(one, probability=0.0)]
            one = replace(one, name=LAW_EFFECT, stage=EFFECTS[LAW_EFFECT].stage,
                          parameters=numbers, gap_over_noise=gap, log_evidence=gain)
        elif shows and len(one.effects) == 1 and share >= REMARK:
            name = JOIN.join(sorted((*one.effects, LAW_EFFECT)))
            one = replace(one, name=name, parameters={**one.parameters, **numbers})
        elif shows:
            one = replace(one, beside={**one.beside, LAW_EFFECT: share})
        found.append(one)
    return (*found, *emptied)


def law_of(fitted: Fit) -> tuple[float, float, dict[str, Estimate]]:
    """Gap by another law in a fit, over noise; its gain [nats], linearised; its shares."""
    items = fitted.unknowns.items  # a stated law is no cause
    places = [k for k, item in enumerate(items) if item.name in OTHER_LAWS and item.mean == 0.0]
    if not places or not np.any(fitted.unknowns.values(fitted.x)[places]):
        return 0.0, 0.0, {}
    x, covariance = fitted.x[places], fitted.covariance[np.ix_(places, places)]
    numbers = {n: e for n, e in estimates(fitted).items() if n in OTHER_LAWS}
    return own_gap(fitted, (LAW_EFFECT,)), 0.5 * float(x @ np.linalg.solve(covariance, x)), numbers


def estimates(fitted: Fit) -> dict[str, Estimate]:
    values, stds = fitted.unknowns.values(fitted.x).tolist(), fitted.errors.tolist()
    return {name: Estimate(value, std, BY_NAME[name].unit)
            for name, value, std in zip(fitted.unknowns.names, values, stds, strict=True)}


def named(candidates: Sequence[Candidate], utilities: Utilities) -> tuple[str, ...]:
    """Effects with a total probability of at least NAMED, the largest gain alone first."""
    found, facts = inclusion(candidates), utilities.found.candidates
    return tuple(sorted((name for name, p in found.items() if p >= NAMED),
                        key=lambda name: -facts[name].gain if name in facts else 0.0))


def verdict_of(candidates: Sequence[Candidate]) -> Verdict:
    """The verdict on candidates (the most probable first)."""
    if max(inclusion(candidates).values(), default=0.0) >= NAMED:
        return "effect"
    first = candidates[0].name
    likely = sum(c.probability for c in candidates if c.name in BENIGN)
    if (likely if first in BENIGN else candidates[0].probability) < NAMED:
        return "ambiguous"
    return cast(Verdict, first)
