"""Lowest BIC: the baseline's numbers and one effect refitted together, noise taken as white.

    BIC = n ln(S/n) + k ln n

with the sum S of n squared residuals over noise and k fitted numbers (Schwarz, Annals of
Statistics 6, 1978); the lab's parameters as they are (k = 0) and refitted alone compete.
Probabilities go as exp(-BIC/2). Neither the lab's uncertainties nor the colour of the noise enter.
"""

from collections.abc import Sequence

import numpy as np

from sma_bench.blind.answers import NO_GAP, RECALIBRATION
from sma_bench.blind.rivals.fitting import (
    Fit,
    baseline_knobs,
    effect_knobs,
    fit,
    slope_at,
    whitened,
)
from sma_bench.blind.rivals.observed import Observed
from sma_bench.blind.rivals.statement import shares_of
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

_ROUNDS_BASELINE, _ROUNDS_ALONE, _ROUNDS_EFFECT = 15, 3, 4


def choose(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the parameters of the winner's fit."""
    residual = whitened(observed, nominal)
    baseline = baseline_knobs(nominal)
    fits = {NO_GAP: Fit(nominal, float(residual @ residual), ())}
    fits[RECALIBRATION] = fit(observed, nominal, baseline, _ROUNDS_BASELINE)
    refitted = fits[RECALIBRATION].parameters
    near = slope_at(observed, refitted, baseline, whitened(observed, refitted))
    for name in EFFECTS:
        knobs = effect_knobs(name, nominal)
        # The refit may have led away from a large effect, which is then found alone first.
        alone = fit(observed, nominal, knobs, _ROUNDS_ALONE).parameters
        far = slope_at(observed, alone, baseline, whitened(observed, alone))
        trials = [
            fit(observed, start, knobs, _ROUNDS_EFFECT, slow)
            for start, slow in ((refitted, near), (alone, far))
        ]
        fits[name] = min(trials, key=lambda trial: trial.square)
    n = len(residual)
    bic = {
        name: n * np.log(found.square / n) + len(found.knobs) * np.log(n)
        for name, found in fits.items()
    }
    best = min(bic, key=lambda name: bic[name])
    return shares_of({name: -0.5 * value for name, value in bic.items()}), fits[best].parameters
