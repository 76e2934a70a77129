"""Does the model fit at all? The records predicted with the identified parameters.

Of every signal the root mean square of measured less predicted stands against the noise of the
sensor from sample to sample: `ok` within it, `imperfect` above it but at most 5 % of the signal's
range (every real bench is), `misfit` beyond.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.nuisances import UNITS
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import fit
from sma_bench.estimation.unknowns import Unknowns
from sma_bench.identify.result import FitVerdict, SignalFit
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

WITHIN_NOISE = 1.1  # rms over the noise of a sample, which is itself known to some 5 %
USABLE = 0.05  # of the signal's range
_ORDER: tuple[FitVerdict, ...] = ("ok", "imperfect", "misfit")


def judged(rms: float, noise: float, reach: float, unit: str) -> SignalFit:
    """The verdict on a signal whose measured range is `reach`."""
    verdict: FitVerdict = "ok"
    if rms > WITHIN_NOISE * noise:
        missed = float(np.sqrt(rms**2 - noise**2))
        verdict = "imperfect" if missed <= USABLE * reach else "misfit"
    return SignalFit(verdict, rms, noise, unit)


def worst(fits: Iterable[tuple[str, SignalFit]]) -> dict[str, SignalFit]:
    """Of every signal the worst of several records."""
    found: dict[str, SignalFit] = {}
    for name, one in fits:
        if name not in found or _badness(one) > _badness(found[name]):
            found[name] = one
    return found


def _badness(one: SignalFit) -> tuple[int, float]:
    return _ORDER.index(one.verdict), one.rms / one.noise if one.noise else 0.0


def fits_of_observations(
    observations: Sequence[Observation], parameters: Parameters
) -> list[tuple[str, SignalFit]]:
    """Of every signal of every record, by its quantity; what is off in a record beside the model,
    zeros, delays and moments of jumps, is taken off first.

    Args:
        observations: the records; parameters: as identified.
    """
    known = Unknowns(parameters, (), 0, 0)
    still = np.zeros(0)
    first = fit(Problem.of(observations).with_nuisances(parameters), known, still, rounds=1)
    # Once more, with the noise that the model leaves: zeros of a first guess bend to a misfit.
    fitted = fit(first.problem, known, still, rounds=1, keep_noise=True)
    found = []
    for block in fitted.problem.blocks:
        signal, left = block.signal, fitted.left[block.rows]
        # A bin's mean hides most of its samples' white noise: it is added again.
        count = float(np.median(signal.count))
        hidden = signal.noise**2 * (count - 1.0)
        rms = float(np.sqrt(np.average(left**2, weights=signal.count) + hidden))
        noise, reach = signal.noise * float(np.sqrt(count)), float(np.ptp(signal.value))
        found.append((signal.quantity, judged(rms, noise, reach, UNITS[signal.quantity])))
    return found


def fits_of_curves(curves: Mapping[str, Array]) -> list[tuple[str, SignalFit]]:
    """Of the strain of isobaric loops, beside which an experiment has laid its model."""
    found = []
    for name, strain in curves.items():
        stem, _, kind = name.rpartition("/")
        if kind != "strain" or len(strain) < 3:
            continue
        if f"{stem}/model" in curves:
            model = curves[f"{stem}/model"]
        elif f"{stem}/cosine" in curves:
            kelvin, modelled = curves[f"{stem}/cosine"].T
            order = np.argsort(kelvin)
            model = np.interp(curves[f"{stem}/temperature"], kelvin[order], modelled[order])
        else:
            continue
        rms = float(np.sqrt(np.mean((strain - model) ** 2)))
        found.append(("strain", judged(rms, noise_floor(strain), float(np.ptp(strain)), "1")))
    return found
