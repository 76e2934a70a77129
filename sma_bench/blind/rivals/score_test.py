"""Smallest p: the Lagrange multiplier test of every effect at the lab's parameters.

    LM = r'J (J'J)^-1 J'r   ~   chi2(k)

with the residuals r over noise that is taken as white, and J their change with the k numbers of
the effect where it is off (Rao's score test). Wrong parameters are not thought of.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaincc, gammaln

from sma_bench.blind.answers import NO_GAP
from sma_bench.blind.rivals.fitting import effect_knobs, fit, jacobian, whitened
from sma_bench.blind.rivals.observed import Observed
from sma_bench.blind.rivals.statement import shares_of
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

_LEVEL = 0.01
_RANK = 1e-8
_SMALLEST = 1e-280


def choose(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the lab's parameters with the winner fitted."""
    residual = whitened(observed, nominal)
    log_p: dict[str, float] = {}
    for name in EFFECTS:
        knobs = effect_knobs(name, nominal)
        slope = jacobian(observed, nominal, knobs, residual)
        step, _, rank, _ = np.linalg.lstsq(slope, -residual, rcond=_RANK)
        explained = float(np.sum((slope @ step) ** 2))
        log_p[name] = log_tail(explained, max(int(rank), 1))
    best = min(log_p, key=lambda name: log_p[name])
    if log_p[best] > np.log(_LEVEL / len(log_p)):
        return {NO_GAP: 1.0}, nominal
    weights = {name: -value for name, value in log_p.items()}
    return shares_of(weights), fit(observed, nominal, effect_knobs(best, nominal)).parameters


def log_tail(x: float, k: int) -> float:
    """ln P(chi2(k) > x), also where P itself is too small for a number.

    Far out Q(a, z) goes as z^(a - 1) exp(-z)/Gamma(a) (DLMF 8.11.2).
    """
    a, z = k / 2.0, x / 2.0
    tail = float(gammaincc(a, z))
    if tail > _SMALLEST:
        return float(np.log(tail))
    return float((a - 1.0) * np.log(z) - z - gammaln(a))
