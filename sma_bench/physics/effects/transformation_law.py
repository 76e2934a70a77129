"""A law of the phase other than the baseline's cosine.

    f = (1 - l - e) f_cosine + l f_logistic + e f_exponential

and likewise g. l: share of grains that follow the logistic law, gradual at both ends; e: share that
follows Tanaka's exponential, which starts sharply and fades out. Both have the mean and deviation
of the cosine. If l + e > 1, they are scaled to a sum of 1. Source: Ikuta et al. 1991; Tanaka 1986.
See `wire.transition_tail` for normal tails, `partial_transformation` for inner loops."""

import math

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.laws import exponential, logistic

# Deviation of the cosine over a range of 1; scale and shift of positions for both other laws.
_COSINE = math.sqrt(0.25 - 2.0 / math.pi**2)
_WIDER = math.pi / (math.sqrt(3.0) * logistic.STEEPNESS) / _COSINE
_LATER, _LONGER = 1.0 - 1.0 / exponential.RATE, 1.0 / (exponential.RATE * _COSINE)


@borrowing
def mixed(wires, i, position, share, slope):
    """Ramp of wire i and its slope where the cosine's are `share` and `slope`."""
    soft, sharp = wires[i, at.LOGISTIC_SHARE], wires[i, at.EXPONENTIAL_SHARE]
    if soft + sharp > 1.0:
        soft, sharp = soft / (soft + sharp), sharp / (soft + sharp)
    of_soft, soft_slope = logistic.ramp(0.5 + (position - 0.5) * _WIDER)
    of_sharp, sharp_slope = exponential.ramp(_LATER + (position - 0.5) * _LONGER)
    mix = share + soft * (of_soft - share) + sharp * (of_sharp - share)
    by_mix = slope + soft * (soft_slope * _WIDER - slope) + sharp * (sharp_slope * _LONGER - slope)
    return mix, by_mix
