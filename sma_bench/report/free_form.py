"""The response of free form, as far as the records can tell it from wrong parameters."""

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis

Array = NDArray[np.float64]


def free_form(result: Diagnosis) -> list[list[Array]]:
    """The response of free form beyond recalibration, per record and signal (b,).

    The part that moved parameters, sensors' zeros and clocks would take up again is taken off:
    with P the projection on their directions in whitened rows, (1 - P) of the response.
    """
    fitted = result.search.recalibrated
    problem, response = fitted.problem, result.search.flexible.response
    rows = np.hstack([problem.stack(fitted.derivatives), problem.nuisance_rows])
    normal = rows.T @ rows + np.eye(rows.shape[1])
    moved = np.asarray(np.linalg.solve(normal, rows.T @ problem.stack(response)), np.float64)
    unknowns = len(fitted.x)
    nuisance = problem.explained_by_nuisances(moved[unknowns:])
    return [
        [r - d @ moved[:unknowns] - n for r, d, n in zip(rs, ds, ns, strict=True)]
        for rs, ds, ns in zip(response, fitted.derivatives, nuisance, strict=True)
    ]
