"""Between which limits a bench will read, as far as its parameter file tells: every number drawn
within its stated deviation, each by itself, and what runs of one bench differ by."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import ndtri

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.nuisances import STATES, in_state
from sma_bench.estimation.unknowns import TEMPERATURES, range_of, unknowns_of
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX
from sma_bench.progress import Report, silent
from sma_bench.records.record import Signal

_DRAWS, _SEED = 40, 43
_FLOOR = 0.005  # of what a signal spans, that no model predicts


def band_of(
    parameters: Parameters, simulated: Callable[[Parameters], Sequence[Signal]],
    probability: float, report: Report = silent,
) -> dict[str, tuple[Array, Array]]:
    """Lower and upper limit (n,) of every signal but the voltages, in its unit, that hold a share
    of the readings.

    Args:
        parameters: numbers with a stated `uncertainty.` are drawn, the others are as they are.
        simulated: signals of the run that is asked for, on a bench; probability: between 0 and 1.

    Raises:
        InputError: another probability, or no number has a stated uncertainty.
    """
    if not 0.0 < probability < 1.0:
        raise InputError(f"a band of {probability:g}, expected a share between 0 and 1")
    stated = [n for n, std in parameters.given_uncertainty.items() if std > 0.0]
    if not stated:
        raise InputError("a band needs numbers with an uncertainty., the parameters have none")
    names = [n for n in stated if not n.startswith((EFFECT_PREFIX, "sensor."))]
    if set(names) & set(TEMPERATURES):
        names = [*(n for n in names if n not in TEMPERATURES), *TEMPERATURES]
    shapes = {
        n: (parameters.std(n), *range_of(n)) for n in stated if n.startswith(EFFECT_PREFIX)
    }
    unknowns = unknowns_of(parameters, names, shapes=shapes)
    random, (low, high) = np.random.default_rng(_SEED), unknowns.bounds()
    exact, drawn = simulated(parameters), []
    for number in range(_DRAWS):
        report(number / _DRAWS, f"draw {number + 1} of {_DRAWS}")
        x = np.clip(random.standard_normal(len(low)), low, high)
        away = dict(zip(STATES, random.standard_normal(len(STATES)).tolist(), strict=True))
        drawn.append(simulated(in_state(unknowns.parameters(x), away)))
    found, reach = {}, float(ndtri(0.5 + probability / 2.0))
    for k, signal in enumerate(exact):
        if signal.name.endswith("voltage"):
            continue
        away_from = np.mean([(one[k].values - signal.values) ** 2 for one in drawn], axis=0)
        floor = _FLOOR * float(np.ptp(signal.values))
        off = reach * np.sqrt(away_from + floor**2)
        found[signal.name] = signal.values - off, signal.values + off
    return found
