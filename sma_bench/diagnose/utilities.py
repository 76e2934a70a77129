"""Probabilities of all explanations of a gap: a conditional logit, learnt from cases whose truth is
known.

    p(c) = (1 - l) exp(u_c) / sum of exp(u) + l/C,    u_c = sum of w_f x_cf

Each of the C explanations, one or two effects, recalibration, no gap, something else, has linear
utilities in features x of its own kind; nats go in by their logarithm, for a model's own error
grows with the gap that it explains. Where physics demands it, weights have a sign. The lapse l is
the share of the cases in which the records say nothing (D. McFadden, Conditional logit analysis of
qualitative choice behavior, 1974; lapses: Wichmann and Hill, Percept. Psychophys. 63, 2001). The
weights, with their errors, are in weights.yaml; `./bench blind learn` writes them.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml
from scipy.special import softmax

from sma_bench.arrays import Array
from sma_bench.diagnose.facts import Facts, Weighed
from sma_bench.diagnose.result import JOIN, NO_GAP, RECALIBRATION, UNEXPLAINED

# Feature by kind of explanation, and the sign that its weight must have, 0 for either.
SIGNS: dict[str, dict[str, int]] = {
    "effect": {
        "one": 0, "gain": 1, "lead": 1, "size": 1, "own": 0, "unsteady": -1, "rivals": -1,
    },
    "pair": {"two": 0, "extra": 1, "partner_size": 1},
    "recalibration": {"surprise": -1},
    "no_gap": {"one": 0, "moved": -1, "as_stated": 1},
    "unexplained": {
        "one": 0, "beyond_share": 1, "ratio": 1, "outlier": 1, "input": 1, "best_gain": 0,
    },
}  # fmt: skip
NAMES = tuple(f"{kind}.{name}" for kind, features in SIGNS.items() for name in features)
_AT = {name: k for k, name in enumerate(NAMES)}
_WEIGHTS = Path(__file__).with_name("weights.yaml")
_LIBRARY = 18  # effects that were learnt from; of more each has a smaller share
_NEAR, _CLOSE = 5.0, 0.1  # nats, and share of the gain, within which others are rivals
_NOISY = 4.0  # standard deviations that the largest of many samples has by chance
# What the model misses of a bench is the same in all records, and an effect that takes some of it
# up gains by every one: beyond two, gains count as if half of the noise were of that kind.
_USUAL_RECORDS = 2


@dataclass(frozen=True)
class Learnt:
    """The table of weights: value and error of each feature."""

    source: str
    library: str
    ridge: float  # of the fit, and the lapse that it was made with
    fit_lapse: float
    lapse: float
    least: float  # probability from which explanations are credible: they hold the truth in 90 %
    weights: dict[str, tuple[float, float]]

    @property
    def values(self) -> Array:
        """(k,) in the order of NAMES."""
        return np.array([self.weights[name][0] for name in NAMES])


@cache
def learnt() -> Learnt:
    """The package's own table."""
    return msgspec.convert(yaml.safe_load(_WEIGHTS.read_text()), Learnt)


class Utilities:
    """Features of explanations, and their sums; effects first, then the three without one."""

    def __init__(self, found: Weighed) -> None:
        self.found, facts = found, found.candidates
        self.effects = tuple(facts)
        self.names = (*facts, RECALIBRATION, NO_GAP, UNEXPLAINED)
        parts = [name.split(JOIN) for name in facts]
        singles = [k for k, one in enumerate(parts) if len(one) == 1]
        self._singles, self._single = singles, np.array([len(one) == 1 for one in parts])
        # (c, s): whether a single effect is part of a candidate.
        part = [[self.effects[k] in one for k in singles] for one in parts]
        self._part = np.array(part).reshape(len(facts), len(singles))
        self.gains = np.array([f.gain for f in facts.values()])
        # Log odds by the library's size: N candidates bring N chances of a false alarm.
        self.fixed = np.zeros(len(self.names))
        self.fixed[: len(facts)] = -np.log(max(len(singles), _LIBRARY) / _LIBRARY)
        self._plain = np.zeros((len(self.names), len(NAMES)))
        rows = [*map(self._of_effect, facts, facts.values()), *self._of_none()]
        for row, own in zip(self._plain, rows, strict=True):
            for name, value in own.items():
                row[_AT[name]] = value

    def _of_effect(self, name: str, facts: Facts) -> dict[str, float]:
        """What does not depend on gains."""
        unsteady = max(_log(facts.unsteady, 1.0), 0.0) if facts.gain > 0.0 else 0.0
        row = {"effect.one": 1.0, "effect.size": _small(facts.gap),
               "effect.own": float(_nats(facts.own, 1.0)), "effect.unsteady": unsteady}
        if JOIN in name:
            row |= {"pair.two": 1.0, "pair.partner_size": _small(min(facts.parts.values()))}
        return row

    def _of_none(self) -> tuple[dict[str, Any], ...]:
        found = self.found
        return (
            {"recalibration.surprise": _nats(found.surprise, 16.0)},
            {"no_gap.one": 1.0, "no_gap.moved": _log(found.moved, 0.1),
             "no_gap.as_stated": _signed(found.as_stated)},
            {"unexplained.one": 1.0, "unexplained.ratio": _nats(found.ratio),
             "unexplained.outlier": _nats(found.outlier - _NOISY),
             "unexplained.input": _nats(found.input)},
        )  # fmt: skip

    def features(self, gains: Array | None = None) -> Array:
        """(m, n, k) of every explanation, where the effects gain so much (m, c) [nats]."""
        gains = self.gains[None] if gains is None else gains
        counted = np.sqrt(_USUAL_RECORDS / max(self.found.records, _USUAL_RECORDS))
        gains = np.where(gains > 0.0, gains * counted, gains)
        x = np.repeat(self._plain[None], len(gains), axis=0)
        if not self.effects:
            return x
        effect = x[:, : len(self.effects)]
        single = gains[:, None, self._singles]
        others = np.where(self._part, -np.inf, single)  # (m, c, s)
        lead = gains - np.maximum(others.max(axis=2), 0.0)
        near = gains - _NEAR - _CLOSE * np.maximum(gains, 0.0)
        better = np.where(self._part, single, -np.inf).max(axis=2)
        effect[:, :, _AT["effect.gain"]] = _nats(gains)
        effect[:, :, _AT["effect.lead"]] = _signed(lead)
        effect[:, :, _AT["effect.rivals"]] = np.log1p((others > near[:, :, None]).sum(axis=2))
        effect[:, :, _AT["pair.extra"]] = np.where(self._single, 0.0, _signed(gains - better))
        # What no candidate explains is judged by the best of them.
        best, beyond, last = np.maximum(gains.max(axis=1), 0.0), self.found.beyond, x[:, -1]
        last[:, _AT["unexplained.best_gain"]] = _nats(best)
        last[:, _AT["unexplained.beyond_share"]] = beyond / (max(beyond, 0.0) + best + 4.0)
        return x

    def probabilities(self, gains: Array | None = None) -> Array:
        """(n,) of the explanations; (m, n) where the effects gain so much (m, c)."""
        table = learnt()
        shares = softmax(self.features(gains) @ table.values + self.fixed, axis=1)
        shares = (1.0 - table.lapse) * shares + table.lapse / len(self.names)
        return np.asarray(shares[0] if gains is None else shares)

    def nats(self) -> dict[str, dict[str, float]]:
        """Of every explanation the sum that its log odds are, by feature."""
        sums = self.features()[0] * learnt().values
        rows = zip(self.names, sums, self.fixed.tolist(), strict=True)
        return {name: {NAMES[k].partition(".")[2]: float(row[k])
                       for k in np.flatnonzero(row)} | ({"library": fixed} if fixed else {})
                for name, row, fixed in rows}


def _nats(value: Array | float, scale: float = 4.0) -> Array:
    """Logarithm of what counts beyond `scale`, in proportion below; 0 for less than nothing."""
    return np.asarray(np.log1p(np.maximum(value, 0.0) / scale))


def _signed(value: Array | float) -> Array:
    return np.asarray(np.sign(value) * _nats(np.abs(value)))


def _log(value: float, least: float) -> float:
    return float(np.log(max(value, least)))


def _small(gap: float) -> float:
    """0 for what is three times the noise or more, and down with its logarithm below."""
    return min(_log(gap / 3.0, 0.01), 0.0)
