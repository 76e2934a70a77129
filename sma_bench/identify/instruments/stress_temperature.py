"""Stress-temperature diagram: transition temperatures against stress (Clausius and Clapeyron)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.identify.estimate import Array, Estimate
from sma_bench.identify.straight_line import fit_linear

SMALLEST_STRESS_RANGE = 5e6  # Pa
_SIGNIFICANT = 2.0
# A temperature cannot be told better than a thermocouple tells it.
SMALLEST_STD = 0.3  # K


@dataclass(frozen=True)
class Points:
    """One transition temperature at several stresses: `stress` (n,) Pa, `value`, `std` (n,) K."""

    stress: Array
    value: Array
    std: Array


@dataclass(frozen=True)
class TransitionLines:
    """Lines of one slope through start and finish.

    Attributes:
        at_zero: stress-free temperatures in the order given, each (value, std) in K.
        slope: (value, std), K/Pa; its inverse is C_A or C_M.
        own_slopes: slope of each transition fitted by itself, (value, std) in K/Pa.
        misfit: chi square per degree of freedom; above 1 the points lie off straight lines by
            more than their errors, and the errors above are enlarged by its root.
        worst: largest distance of a point from its line, K.
    """

    at_zero: tuple[tuple[float, float], ...]
    slope: tuple[float, float]
    own_slopes: tuple[tuple[float, float], ...]
    misfit: float
    worst: float

    @property
    def is_significant(self) -> bool:
        """Whether temperature rises with stress beyond doubt."""
        return self.slope[0] > _SIGNIFICANT * self.slope[1]

    def influence(self, method: str, n: int) -> Estimate:
        """C = 1/slope, Pa/K."""
        value = 1.0 / self.slope[0]
        return Estimate(value, self.slope[1] * value**2, "Pa/K", method, n)


def stress_range(transitions: Sequence[Points]) -> float:
    """Span of stress over which every transition was measured, Pa; 0 without points."""
    return min((float(np.ptp(p.stress)) if len(p.stress) else 0.0) for p in transitions)


def fit_transition_lines(transitions: Sequence[Points]) -> TransitionLines:
    """T_k = T_k0 + sigma/C for all transitions k with one C, weighted by their errors.

    Args:
        transitions: start and finish of one direction, each at two stresses or more.
    """
    count = len(transitions)
    stress = np.concatenate([p.stress for p in transitions])
    value = np.concatenate([p.value for p in transitions])
    std = np.maximum(np.concatenate([p.std for p in transitions]), SMALLEST_STD)
    which = np.repeat(np.arange(count), [len(p.stress) for p in transitions])
    scale = float(np.max(np.abs(stress)))
    design = np.column_stack([which == k for k in range(count)] + [stress / scale]).astype(float)
    fit = fit_linear(design, value, np.diag(std**2))
    own = []
    for k in range(count):
        part = which == k
        line = fit_linear(
            np.column_stack([np.ones(part.sum()), stress[part] / scale]),
            value[part], np.diag(std[part] ** 2),
        )
        own.append((float(line.beta[1]) / scale, float(line.std[1]) / scale))
    return TransitionLines(
        at_zero=tuple(
            (float(b), float(s)) for b, s in zip(fit.beta[:count], fit.std[:count], strict=True)
        ),
        slope=(float(fit.beta[-1]) / scale, float(fit.std[-1]) / scale),
        own_slopes=tuple(own),
        misfit=fit.misfit,
        worst=float(np.max(np.abs(fit.residuals))),
    )


def diagram_curves(points: Mapping[str, Points]) -> dict[str, Array]:
    """Arrays of the stress-temperature diagram: stress, temperature and its error by transition."""
    curves = {}
    for name, p in points.items():
        curves[f"diagram/{name}/stress"] = p.stress
        curves[f"diagram/{name}/temperature"] = p.value
        curves[f"diagram/{name}/std"] = p.std
    return curves
