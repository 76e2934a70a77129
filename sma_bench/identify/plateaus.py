"""Settle, then average: one point a plateau, with what its mean is worth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import (
    autocorrelation,
    inflation,
    quantisation_variance,
    resolution,
)
from sma_bench.estimation.voltage import Segment
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array

SETTLE = 15.0
AVERAGE = 15.0
FEWEST_LEVELS = 4
_FEWEST_SAMPLES = 8
# Detection finds a plateau's ends to a sample or two: only a real shortage is worth a remark.
_SHORTAGE = 0.95
_PRIOR_WEIGHT = 10.0


@dataclass(frozen=True)
class Means:
    """Means of one signal over p plateaus, in its unit.

    `value` (p,); `noise` (p,) standard error of each from the scatter of its samples, coloured
    noise counted; `hidden` standard deviation of the converter error that averaging does not
    remove, `step` the converter's step (0 if none is seen); `drift` (p,) change over the window by
    a straight line, `drift_std` its error; `n` (p,) samples.
    """

    value: Array
    noise: Array
    hidden: float
    step: float
    drift: Array
    drift_std: Array
    n: Array


def windows(
    plateaus: Sequence[Segment], settle: float = SETTLE, average: float = AVERAGE
) -> tuple[Array, tuple[Finding, ...]]:
    """Averaging window (start, stop) in s of every plateau, (p, 2), as in section II.B.

    A plateau too short for both times keeps their proportion.
    """
    if settle < 0.0 or average <= 0.0:
        raise InputError(f"settle {settle:g} s and average {average:g} s, expected >= 0 and > 0")
    wanted = settle + average
    scale = np.array([min(1.0, p.duration / wanted) for p in plateaus])
    start = np.array([p.start for p in plateaus])
    bounds = np.column_stack([start + scale * settle, start + scale * wanted])
    short = int(np.sum(scale < _SHORTAGE))
    if not short:
        return bounds, ()
    text = (
        f"{short} of {len(plateaus)} plateaus are shorter than {settle:g} s + {average:g} s; "
        f"their windows shrink in proportion, the shortest to {scale.min() * settle:.2g} s + "
        f"{scale.min() * average:.2g} s"
    )
    return bounds, (
        Finding("info", "plateaus", text, {"shortest_scale": float(scale.min())}),
    )


def means(time: Array, values: Array, bounds: Array, what: str) -> Means:
    """Mean of a signal in each window.

    Args:
        time: (n,) s, increasing; values: (n,); bounds: (p, 2) s.
        what: name of the signal, for messages.

    Raises:
        InputError: a window without enough samples.
    """
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    first = np.searchsorted(time, bounds[:, 0], side="left")
    beyond = np.searchsorted(time, bounds[:, 1], side="right")
    windows_of_samples = []
    for (start, stop), i, j in zip(bounds, first, beyond, strict=True):
        if j - i < _FEWEST_SAMPLES:
            raise InputError(
                f"{what}: {j - i} samples between {start:.1f} s and {stop:.1f} s, "
                f"expected {_FEWEST_SAMPLES} or more to average"
            )
        windows_of_samples.append((time[i:j], values[i:j]))
    n = np.array([len(v) for _, v in windows_of_samples], dtype=np.float64)
    fits = [_trend(t, v) for t, v in windows_of_samples]
    residuals = [residual for _, _, residual in fits]
    colour = inflation(autocorrelation(residuals))
    variance = np.array([np.sum(r**2) / (len(r) - 2) for r in residuals])
    pooled = float(np.sum(variance * n) / np.sum(n))
    # Short windows know their own scatter badly and lean on the others'.
    steady = (n * variance + _PRIOR_WEIGHT * pooled) / (n + _PRIOR_WEIGHT)
    noise = np.sqrt(steady * colour / n)
    step = resolution(values)
    hidden = quantisation_variance(float(np.sqrt(pooled)), step)
    return Means(
        value=np.array([v.mean() for _, v in windows_of_samples]),
        noise=noise,
        hidden=float(np.sqrt(hidden)),
        step=step,
        drift=np.array([drift for drift, _, _ in fits]),
        # A straight line's rise over its window has variance 12 times that of the mean.
        drift_std=np.sqrt(12.0) * noise,
        n=n,
    )


def same_level(voltage: Array, tolerance: float) -> Array:
    """(p, p) ones where two plateaus share a voltage and so the converter's error, else zeros."""
    return (np.abs(voltage[:, None] - voltage[None, :]) < tolerance).astype(np.float64)


def _trend(time: Array, values: Array) -> tuple[float, float, Array]:
    centred = time - time.mean()
    slope = float(centred @ values) / float(centred @ centred)
    residual = values - values.mean() - slope * centred
    return slope * float(time[-1] - time[0]), slope, residual
