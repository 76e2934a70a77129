"""The course of what recalibration leaves unexplained, to tell where it lies.

A smooth response of free form is it only where it is sure: one that gains next to nothing is next
to nothing, wherever it happens to be. Else it is all that is slower than the scatter of samples,
what a fit has to take for the drift of a sensor.
"""

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.decision import FLEXIBLE
from sma_bench.diagnose.search import Search

Array = NDArray[np.float64]


def missing_term(found: Search) -> list[list[Array]]:
    """(b,) per view and signal, in the signals' units."""
    if found.flexible.gain > FLEXIBLE:
        return found.flexible.response
    problem = found.recalibrated.problem
    slow = [
        [problem.noise[s.name].drift_in(left) for s, left in zip(view.signals, own, strict=True)]
        for view, own in zip(problem.views, found.recalibrated.left, strict=True)
    ]
    if any(part.any() for own in slow for part in own):
        return slow
    return found.recalibrated.left
