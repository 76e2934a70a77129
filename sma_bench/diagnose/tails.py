"""Parameters that are farther off than anybody stated: priors with tails.

    p(x_i) = (1 - RARE) N(0, 1) + RARE N(0, WIDE^2)

in the deviations that were stated; with MEASURED instead of WIDE where these are what a test of the
paper leaves, as such errors are true but for a quarter. Under a Gaussian alone a wrong parameter
costs its square, and an effect that bends the readings likewise is cheaper. What widening one prior
gains follows, to first order, from a fit with all of them narrow; with the priors of those that
gain widened the model is fitted again.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.drives import measured
from sma_bench.estimation.solver import Fit, fit
from sma_bench.estimation.unknowns import Unknowns

Array = NDArray[np.float64]

WIDE, MEASURED, RARE = 4.0, 2.0, 0.05
_MOST = 4  # parameters that are off at once
_LEAST = 0.7  # nats of one parameter that are worth another fit
_FARTHEST = 10.0  # deviations to which a straight line is believed


def gain_of_tails(fitted: Fit) -> tuple[float, tuple[str, ...]]:
    """Log evidence that tails would add to a fit with narrow priors, and the parameters that use
    them, the one that gains most first."""
    count = fitted.unknowns.bench
    wide = _widths(fitted.unknowns)[:count]
    moved = 1.0 - wide**-2
    x, covariance = fitted.x.copy(), fitted.covariance.copy()
    total = 0.0
    off: list[int] = []
    for _ in range(min(_MOST, count)):
        left = np.maximum(1.0 - moved * np.diag(covariance)[:count], wide**-2)
        gains = 0.5 * moved * x[:count] ** 2 / left - 0.5 * np.log(left) - np.log(wide)
        gains[off] = -np.inf
        k = int(np.argmax(gains))
        gain = float(np.logaddexp(np.log1p(-RARE), np.log(RARE) + gains[k]))
        column = covariance[:, k] * moved[k] / left[k]
        there = x + x[k] * column
        if gain < _LEAST or np.max(np.abs(there[:count])) > _FARTHEST:
            break
        x, covariance = there, covariance + np.outer(column, covariance[:, k])
        total += gain
        off.append(k)
    return total, tuple(fitted.unknowns.names[k] for k in off)


def with_tails(fitted: Fit) -> tuple[Fit, tuple[str, ...]]:
    """The fit with those parameters free of narrow priors, in the deviations as stated, and their
    names; the same fit without any where that gains nothing."""
    _, off = gain_of_tails(fitted)
    if not off:
        return fitted, ()
    unknowns, far = widened(fitted.unknowns, off)
    again = fit(fitted.problem, unknowns, fitted.x / far, rounds=2)
    # The same place, x in the deviations of `unknowns`.
    both = np.concatenate([far, np.ones(len(again.z))])
    found = replace(
        again, unknowns=fitted.unknowns, x=again.x * far, joint=again.joint * np.outer(both, both),
        derivatives=again.derivatives / far,
    )
    found = replace(found, evidence=found.evidence + len(off) * float(np.log(RARE)))
    return (found, off) if found.evidence > fitted.evidence else (fitted, ())


def widened(unknowns: Unknowns, off: Collection[str]) -> tuple[Unknowns, Array]:
    """The same with wide priors of those that are `off`, and how much wider each is (k,)."""
    names = unknowns.names
    far = np.where([name in off for name in names], _widths(unknowns), 1.0)
    return unknowns.widened(far), far


def _widths(unknowns: Unknowns) -> Array:
    """(k,) deviations of each parameter's tail, as stated ones."""
    known = measured(unknowns.base)
    return np.array([MEASURED if name in known else WIDE for name in unknowns.names])
