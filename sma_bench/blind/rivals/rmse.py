"""Largest drop: each effect alone, fitted on the record with the baseline as the lab believes it.

What an engineer does by hand: try one cause after the other, keep the one that fits best. The
noise counts for nothing, wrong parameters are not thought of, and the probabilities are shares of
the drops.
"""

from collections.abc import Sequence

import numpy as np

from sma_bench.blind.answers import NO_GAP
from sma_bench.blind.rivals.fitting import effect_knobs, fit, whitened
from sma_bench.blind.rivals.observed import Observed
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

# Root mean square residual over noise below which there is nothing to explain.
_QUIET = 1.2


def choose(
    observed: Sequence[Observed], nominal: Parameters
) -> tuple[dict[str, float], Parameters]:
    """Probabilities, and the lab's parameters with the winner in them."""
    residual = whitened(observed, nominal)
    before = float(np.sqrt(np.mean(residual**2)))
    if before < _QUIET:
        return {NO_GAP: 1.0}, nominal
    fits = {name: fit(observed, nominal, effect_knobs(name, nominal)) for name in EFFECTS}
    drops = {
        name: max(before - float(np.sqrt(found.square / len(residual))), 0.0)
        for name, found in fits.items()
    }
    total = sum(drops.values())
    if total == 0.0:
        return {NO_GAP: 1.0}, nominal
    best = max(drops, key=lambda name: drops[name])
    return {name: drop / total for name, drop in drops.items()}, fits[best].parameters
