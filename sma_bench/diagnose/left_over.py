"""Whether what a fit leaves is noise: noise does not know when the bench moves.

The whitened residual is split at the median speed of the simulated signal. If it scatters more
while the signal moves than while it rests, something that the model lacks acts there.
"""

from dataclasses import dataclass

import numpy as np

from sma_bench.estimation.solver import Fit

_SURE = 4.0  # standard deviations of the log ratio of two variances
_FEWEST = 30


@dataclass(frozen=True)
class Left:
    """What a fit leaves.

    Attributes:
        ratio: log of moving over resting variance, in its standard deviations, the largest of all
            signals; signal: which one.
        size: of the part that is not noise, over the white noise of a sample, which is the same
            for all fits; 0 where the ratio is not sure.
        outlier: largest whitened residual, in standard deviations: a single event shows there;
            event: the signal that it is in.
        drift: nats, how improbable the drift is that sensors had to be credited with.
        shows: all signals whose ratio is sure.
    """

    ratio: float
    signal: str
    size: float
    outlier: float
    drift: float
    shows: tuple[str, ...] = ()
    event: str = ""


def left_over(fitted: Fit) -> Left:
    """Compare what a fit leaves in motion and at rest."""
    problem = fitted.problem
    drift = -problem.log_prior()
    found = Left(-np.inf, "", 0.0, 0.0, drift)
    rates = [
        rate for o in problem.observations for rate in o.rates(o.simulate(fitted.parameters))
    ]
    for block, rate in zip(problem.blocks, rates, strict=True):
        signal, noise = block.signal, problem.noise[block.signal.name]
        white = noise.whiten(fitted.left[block.rows])
        speed = np.abs(rate)
        moving = speed > np.median(speed)
        if min(moving.sum(), (~moving).sum()) < _FEWEST:
            continue
        fast, slow = float(np.mean(white[moving] ** 2)), float(np.mean(white[~moving] ** 2))
        spread = np.sqrt(2.0 / moving.sum() + 2.0 / (~moving).sum())
        ratio = float(np.log(fast / slow) / spread)
        outlier, event = max(
            (found.outlier, found.event), (float(np.max(np.abs(white))), signal.name)
        )
        size, shows = found.size, found.shows
        if ratio > _SURE:
            # Drift that noise was credited with, as far as the scatter in motion exceeds rest.
            excess = np.sqrt(1.0 - slow / fast)
            drifting = excess * float(np.hypot(noise.drift, noise.white))
            sample = signal.noise * np.sqrt(float(np.median(signal.count)))
            size = max(size, drifting / sample)
            shows = tuple(dict.fromkeys((*shows, signal.name)))
        first = max((ratio, signal.name), (found.ratio, found.signal), key=lambda r: r[0])
        found = Left(*first, size, outlier, drift, shows, event)
    return found
