"""A conditional logit of all explanations of a gap.

    p(c) = (1 - l) exp(u_c) / sum of exp(u) + l/C,    u_c = sum of w_f x_cf

Each of the C explanations, one or two effects, recalibration, no gap, something else, has linear
utilities in features x of its own kind; nats go in by their logarithm, for a model's own error
grows with the gap that it explains. Where physics demands it, weights have a sign. The lapse l is
the share of the cases in which the records tell nothing (D. McFadden, Conditional logit analysis of
qualitative choice behavior, 1974; lapses: Wichmann and Hill, Percept. Psychophys. 63, 2001).
"""

from collections.abc import Mapping

import numpy as np

from examination.blind.facts import Facts, Weighed
from sma_bench.diagnose.decision import JOIN, NO_GAP, RECALIBRATION, UNEXPLAINED

# Feature by kind of explanation, and the sign that its weight must have, 0 for either.
SIGNS: dict[str, dict[str, int]] = {
    "effect": {
        "one": 0, "gain": 1, "lead": 1, "ahead": 1, "size": 1, "own": 0, "unsteady": -1,
        "rivals": -1, "left": -1,
    },
    "pair": {"two": 0, "extra": 1, "partner": 1, "partner_size": 1},
    "recalibration": {"surprise": -1, "deviation": 0, "flexible": -1, "moved": 1},
    "no_gap": {"one": 0, "moved": -1, "as_stated": 1, "surprise": -1},
    "unexplained": {
        "one": 0, "beyond": 1, "beyond_share": 1, "ratio": 1, "left": 1, "left_share": 1,
        "outlier": 1, "drift": 1, "best_gain": 0, "best_unsteady": 1,
    },
}  # fmt: skip
NAMES = tuple(f"{kind}.{name}" for kind, features in SIGNS.items() for name in features)
_LIBRARY, FIXED = 18, "fixed"  # effects that were learnt from; of N each has a share of 1/N
_NEAR, _CLOSE = 5.0, 0.1  # nats, and share of the gain, within which others are rivals
_NOISY = 4.0  # standard deviations that the largest of many samples has by chance


def features(found: Weighed) -> dict[str, dict[str, float]]:
    """Of every explanation, by the names of NAMES."""
    singles = {name: facts for name, facts in found.candidates.items() if JOIN not in name}
    chances = float(np.log(len(singles) / _LIBRARY)) if singles else 0.0
    rows = {}
    for name, facts in found.candidates.items():
        row = _of_effect(name, facts, found, singles)
        rows[name] = {f"effect.{feature}": value for feature, value in row.items()}
        rows[name][FIXED] = -chances
        if JOIN in name:
            better = max(singles[part].gain for part in name.split(JOIN))
            of_pair = {
                "two": 1.0, "extra": _signed(facts.gain - better),
                "partner": _log(facts.partner / max(facts.gap, 1e-3), 0.01),
                "partner_size": _small(facts.partner),
            }  # fmt: skip
            rows[name] |= {f"pair.{feature}": value for feature, value in of_pair.items()}
    surprise = _nats(found.surprise, 16.0)
    of_kinds = {
        RECALIBRATION: {
            "surprise": surprise, "deviation": _nats(found.deviation, 1.0),
            "flexible": _nats(found.flexible), "moved": _small(found.moved),
        },
        NO_GAP: {
            "one": 1.0, "moved": _log(found.moved, 0.1), "as_stated": _signed(found.as_stated),
            "surprise": surprise,
        },
    }  # fmt: skip

    # What no candidate explains is judged by the best of them.
    best = max(found.candidates.values(), key=lambda f: f.gain, default=None)
    gain, by = max(best.gain if best else 0.0, 0.0), found.left_by_best
    of_kinds[UNEXPLAINED] = {
        "one": 1.0, "beyond": _nats(found.beyond), "ratio": _nats(by["ratio"]),
        "beyond_share": found.beyond / (max(found.beyond, 0.0) + gain + 4.0),
        "left": _nats(by["size"], 0.4),
        "left_share": by["size"] / max(found.left["size"], by["size"], 0.1),
        "outlier": _nats(by["outlier"] - _NOISY), "drift": _nats(by["drift"]),
        "best_gain": _nats(gain), "best_unsteady": _wild(best) if best and gain > 0.0 else 0.0,
    }  # fmt: skip
    for kind, row in of_kinds.items():
        rows[kind] = {f"{kind}.{feature}": value for feature, value in row.items()}
    return rows


def _of_effect(
    name: str, facts: Facts, found: Weighed, singles: Mapping[str, Facts]
) -> dict[str, float]:
    others = [f.gain for n, f in singles.items() if n not in name.split(JOIN)]
    lead = facts.gain - max([0.0, *others])
    near = facts.gain - _NEAR - _CLOSE * max(facts.gain, 0.0)
    return {
        "one": 1.0, "gain": _nats(facts.gain), "lead": _signed(lead),
        "ahead": float(np.clip(lead / max(facts.gain, 4.0), -1.0, 1.0)),
        "size": _small(facts.gap), "own": _nats(facts.own, 1.0),
        "unsteady": _wild(facts),
        "rivals": float(np.log1p(sum(gain > near for gain in others))),
        "left": _nats((facts.left or found.left)["size"], 0.4),
    }  # fmt: skip


def _nats(value: float, scale: float = 4.0) -> float:
    """Logarithm of what counts beyond `scale`, in proportion below; 0 for less than nothing."""
    return float(np.log1p(max(value, 0.0) / scale))


def _signed(value: float) -> float:
    return float(np.sign(value)) * _nats(abs(value))


def _log(value: float, least: float) -> float:
    return float(np.log(max(value, least)))


def _small(gap: float) -> float:
    """0 for what is three times the noise or more, and down with its logarithm below."""
    return min(_log(gap / 3.0, 0.01), 0.0)


def _wild(facts: Facts) -> float:
    return max(_log(facts.unsteady, 1.0), 0.0)
