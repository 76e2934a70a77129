"""A conditional logit of all explanations of a gap.

    p(c) = exp(u_c) / sum of exp(u),    u_c = sum of w_f x_cf

Each explanation c, one or two effects, recalibration, no gap, something else, has linear utilities
in features x of its own kind; nats go in by their logarithm, for a model's own error grows with the
gap that it explains. Weights are the likeliest on cases of the examination, kept in utilities.yaml
with their errors; where physics demands it they have a sign (D. McFadden, Conditional logit
analysis of qualitative choice behavior, 1974).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from scipy.special import softmax

from sma_bench.diagnose.facts import JOIN, Facts, Weighed

RECALIBRATION, NO_GAP, UNEXPLAINED = "recalibration", "no_gap", "unexplained"
BENIGN = (RECALIBRATION, NO_GAP)  # names of candidates without a cause

# Feature by kind of explanation, and the sign that its weight must have, 0 for either.
SIGNS: dict[str, dict[str, int]] = {
    "effect": {
        "one": 0, "gain": 1, "lead": 1, "ahead": 1, "taken": 1, "worst": 1, "size": 1, "own": 0,
        "unsteady": -1, "surprise": -1, "rivals": -1, "ratio": -1, "left": -1, "drift": -1,
    },
    "pair": {
        "two": 0, "extra": 1, "extra_share": 1, "partner": 1, "partner_size": 1, "best_half": 0,
    },
    "recalibration": {
        "surprise": -1, "deviation": 0, "flexible": -1, "ratio": -1, "moved": 1, "outlier": -1,
    },
    "no_gap": {
        "one": 0, "moved": -1, "as_stated": 1, "surprise": -1, "flexible": -1, "ratio": -1,
        "outlier": -1,
    },
    "unexplained": {
        "one": 0, "beyond": 1, "flexible": 1, "ratio": 1, "left": 1, "outlier": 1, "drift": 1,
        "surprise": 1, "best_gain": 0, "best_left": 1, "best_unsteady": 1, "outlier_left": 1,
    },
}  # fmt: skip
NAMES = tuple(f"{kind}.{name}" for kind, features in SIGNS.items() for name in features)
_LIBRARY, FIXED = 18, "fixed"  # effects that were learnt from; of N each has a share of 1/N
_NEAR, _CLOSE = 5.0, 0.1  # nats, and share of the gain, within which others are rivals
_LEAST_LEFT = 0.02  # share of a gap: no form of an effect is exact to more
_NOISY = 4.0  # standard deviations that the largest of many samples has by chance


@dataclass(frozen=True)
class Table:
    """The weights by NAMES, their errors, and the conformal threshold: the mass
    at which the smallest set of explanations holds the truth in 90 % of left-out cases."""

    weights: Mapping[str, float]
    errors: Mapping[str, float]
    set_mass: float
    source: str


@cache
def table() -> Table:
    """What the package was taught."""
    document = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    return Table(
        {name: float(w) for name, (w, _) in document["weights"].items()},
        {name: float(e) for name, (_, e) in document["weights"].items()},
        float(document["set_mass"]), document["source"],
    )  # fmt: skip


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
                "extra_share": _share(facts.gain - better, facts.gain),
                "partner": _log(facts.partner / max(facts.gap, 1e-3), 0.01),
                "partner_size": _small(facts.partner), "best_half": _nats(better),
            }  # fmt: skip
            rows[name] |= {f"pair.{feature}": value for feature, value in of_pair.items()}
    outlier = _nats(found.left["outlier"] - _NOISY)
    of_recalibration = {
        "surprise": _nats(found.surprise, 16.0), "flexible": _nats(found.flexible),
        "ratio": _nats(found.left["ratio"]), "outlier": outlier,
    }  # fmt: skip
    rows[RECALIBRATION] = {f"recalibration.{n}": value for n, value in of_recalibration.items()}
    rows[RECALIBRATION] |= {
        "recalibration.deviation": _nats(found.deviation, 1.0),
        "recalibration.moved": _small(found.moved),
    }
    rows[NO_GAP] = {f"no_gap.{n}": value for n, value in of_recalibration.items()}
    rows[NO_GAP] |= {
        "no_gap.one": 1.0, "no_gap.moved": _log(found.moved, 0.1),
        "no_gap.as_stated": _signed(found.as_stated),
    }  # fmt: skip

    # What no candidate explains is judged by the best of them.
    best = max(found.candidates.values(), key=lambda f: f.gain, default=None)
    by = found.left_by_best
    of_else = {
        "one": 1.0, "beyond": _nats(found.beyond), "flexible": _nats(found.flexible),
        "ratio": _nats(by["ratio"]), "left": _nats(by["size"], 0.4),
        "outlier": outlier, "outlier_left": _nats(by["outlier"] - _NOISY),
        "drift": _nats(by["drift"]), "surprise": _nats(found.surprise, 16.0),
    }  # fmt: skip
    if best is not None and best.gain > 0.0:
        of_else |= {
            "surprise": _nats(best.surprise, 16.0), "best_gain": _nats(best.gain),
            "best_left": _log(1.0 - best.taken, _LEAST_LEFT), "best_unsteady": _wild(best),
        }
    rows[UNEXPLAINED] = {f"unexplained.{n}": value for n, value in of_else.items()}
    return rows


def probabilities(found: Weighed, weights: Mapping[str, float]) -> dict[str, float]:
    """Of every explanation."""
    rows = features(found)
    known = {**weights, FIXED: 1.0}
    utilities = [sum(known[n] * x for n, x in row.items()) for row in rows.values()]
    return dict(zip(rows, softmax(utilities).tolist(), strict=True))


def _of_effect(
    name: str, facts: Facts, found: Weighed, singles: Mapping[str, Facts]
) -> dict[str, float]:
    others = [f.gain for n, f in singles.items() if n not in name.split(JOIN)]
    lead = facts.gain - max([0.0, *others])
    near = facts.gain - _NEAR - _CLOSE * max(facts.gain, 0.0)
    left = facts.left or found.left
    return {
        "one": 1.0, "gain": _nats(facts.gain), "lead": _signed(lead),
        "ahead": _share(lead, facts.gain), "taken": -_log(1.0 - facts.taken, _LEAST_LEFT),
        "worst": max(min(facts.taken_by.values(), default=0.0), -1.0),
        "size": _small(facts.gap), "own": _nats(facts.own, 1.0),
        "unsteady": _wild(facts), "surprise": _nats(facts.surprise, 16.0),
        "rivals": float(np.log1p(sum(gain > near for gain in others))),
        "ratio": _nats(left["ratio"]), "left": _nats(left["size"], 0.4),
        "drift": _nats(left["drift"]),
    }  # fmt: skip


def _nats(value: float, scale: float = 4.0) -> float:
    """Logarithm of what counts beyond `scale`, in proportion below; 0 for less than nothing."""
    return float(np.log1p(max(value, 0.0) / scale))


def _signed(value: float) -> float:
    return float(np.sign(value)) * _nats(abs(value))


def _share(nats: float, of: float) -> float:
    """Of a gain, from -1 to 1."""
    return float(np.clip(nats / max(of, 4.0), -1.0, 1.0))


def _log(value: float, least: float) -> float:
    return float(np.log(max(value, least)))


def _small(gap: float) -> float:
    """0 for what is three times the noise or more, and down with its logarithm below."""
    return min(_log(gap / 3.0, 0.01), 0.0)


def _wild(facts: Facts) -> float:
    return max(_log(facts.unsteady, 1.0), 0.0)
