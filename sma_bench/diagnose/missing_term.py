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


def missing_term(found: Search) -> Array:
    """(n,) in the signals' units."""
    if found.flexible.gain > FLEXIBLE:
        return found.flexible.response
    problem = found.recalibrated.problem
    left = found.recalibrated.left
    slow = np.concatenate(
        [problem.noise[b.signal.name].drift_in(left[b.rows]) for b in problem.blocks]
    )
    return slow if slow.any() else left
