"""What a trial size of an effect promises, and how large an effect is beside what would do the
same."""

from types import SimpleNamespace

import numpy as np
import pytest

from sma_bench.diagnose.sizes import contribution
from sma_bench.diagnose.starts import Remainder
from sma_bench.parameters import Parameters

ROWS = 40
RANDOM = np.random.default_rng(4)


def ridge(residual, columns, where):
    """Least of |residual - columns d|^2 + |where + d|^2 over d."""
    rows = np.vstack([columns, np.eye(columns.shape[1])])
    wanted = np.concatenate([residual, -where])
    found = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    return float(np.sum((wanted - rows @ found) ** 2))


@pytest.mark.parametrize("size", [0.05, 0.7, 1.3, 20.0])
def test_a_trial_promises_what_refitting_everything_beside_it_gains(size):
    derivatives, nuisances = RANDOM.normal(size=(ROWS, 3)), RANDOM.normal(size=(ROWS, 2))
    at, change = np.array([0.4, -2.0, 1.1]), RANDOM.normal(size=ROWS)
    residual = size * change + 0.1 * RANDOM.normal(size=ROWS)
    problem = SimpleNamespace(
        whiten=np.array, white_nuisances=nuisances, measured=residual,
        coarse=SimpleNamespace(
            predict=lambda added: added * change,
            predict_many=lambda several: np.outer(change, several),
        ),
    )
    remainder = Remainder(
        SimpleNamespace(
            problem=problem, derivatives=derivatives, predicted=np.zeros(ROWS), x=at, parameters=0.0
        )
    )
    gain, share = remainder.gain(remainder.changes([1.0])[:, 0])
    columns, where = np.hstack([derivatives, nuisances]), np.append(at, [0.0, 0.0])
    without, beside = (ridge(residual - s * change, columns, where) for s in (0.0, share))
    assert gain == pytest.approx(0.5 * (without - beside), rel=1e-9)
    assert share == pytest.approx(np.clip(size, 0.3, 2.0), abs=0.1)


def test_an_h_that_grows_is_as_large_as_what_no_constant_h_would_do():
    by_h, own = RANDOM.normal(size=(2, ROWS))
    own -= by_h * (own @ by_h) / (by_h @ by_h)
    rise = "effect.temperature_dependent_convection.rise"
    bench = Parameters({rise: 0.01})
    problem = SimpleNamespace(
        whiten=np.array, predict=lambda p: p[rise] * (5.0 * by_h + own), of_signal=lambda name: ()
    )
    fitted = SimpleNamespace(
        problem=problem, parameters=bench, predicted=problem.predict(bench),
        derivatives=by_h[:, None],
        unknowns=SimpleNamespace(names=("wire.heat_transfer_coefficient",)),
    )
    assert contribution(fitted, ["temperature_dependent_convection"]) == pytest.approx(0.01 * own)
