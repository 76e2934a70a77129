"""The response of free form, as far as the records can tell it from wrong parameters."""

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis

Array = NDArray[np.float64]


def free_form(result: Diagnosis) -> Array:
    """The response of free form beyond recalibration, (n,) on the rows of the records.

    The part that moved parameters, sensors' zeros and clocks would take up again is taken off:
    with P the projection on their directions in whitened rows, (1 - P) of the response.
    """
    fitted = result.search.recalibrated
    problem, response = fitted.problem, result.search.flexible.response
    directions = np.hstack([fitted.derivatives, problem.nuisance_rows])
    rows = problem.whiten(directions)
    normal = rows.T @ rows + np.eye(rows.shape[1])
    moved = np.linalg.solve(normal, rows.T @ problem.whiten(response))
    return np.asarray(response - directions @ moved, dtype=np.float64)
