"""The four transition temperatures as a fit moves them: together, so that they stay in order."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS
from sma_bench.parameters.parameters import BRANCH

TEMPERATURES = tuple(TRANSITIONS.values())  # A_s, A_f, M_s, M_f
_A_S = BY_NAME[TEMPERATURES[0]]
FIELD_TEMPERATURES = (339.0, 367.0, 337.0, 309.0)  # K, of typical wires
_FIELD_HALF_WIDTH = 0.3  # standard deviation of the logarithm of their half width
# Spreads of the centre c [K] and of the logarithms of h (most wires have 5 to 20 K), w_A and w_M.
_SPREADS = np.array([25.0, 1.2, 0.5, 0.5])
_COORDINATES = np.array([[0.25, 0.25, 0.25, 0.25], [0.25, 0.25, -0.25, -0.25],
                         [-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])
_TEMPERATURES = np.linalg.inv(_COORDINATES)
# Root of their correlations: both ranges of a wire are about equally wide.
_ALIKE = np.linalg.cholesky([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0],
                             [0.0, 0.0, 1.0, 0.85], [0.0, 0.0, 0.85, 1.0]])
LOWEST, HIGHEST = (float(end or 0.0) for end in (_A_S.low, _A_S.high))
NARROWEST = 0.2  # K, of a range: the core divides by its width
_FARTHEST = 5.0  # by which the logarithm of a width may fall
_WIDEST = (5.0, 2.0, 2.0)  # by which it may rise: half width, both ranges
_TINY = 1e-4  # prior deviations, of a finite difference


def _covariance(mean: Array, as_usual: bool) -> Array:
    """(4, 4) K2 of wires about a mean (4,) K; `as_usual`: with the hysteresis of typical ones."""
    coordinates = _COORDINATES @ mean
    scale = np.where(coordinates > 0.0, coordinates, 1.0) * _SPREADS
    scale[0] = _SPREADS[0]
    if as_usual:
        scale[1] = _FIELD_HALF_WIDTH * coordinates[1]
    root = _TEMPERATURES * scale @ _ALIKE
    return np.asarray(root @ root.T)


@dataclass(frozen=True, eq=False)
class Transitions:
    """The transition temperatures that are not exact, as functions of x (m,) of unit normal prior
    that keep their order wherever a fit goes.

        A_s, A_f = c + h -+ w_A/2        M_f, M_s = c - h -+ w_M/2

    with a centre c, the half width h = (A_s + A_f - M_s - M_f)/4 of the hysteresis and the widths
    w_A and w_M of the two ranges, moved by their logarithms. What is not stated is typical."""

    mean: Array  # (4,) K, of the prior
    moving: NDArray[np.intp]  # (m,) indices of those that are not exact
    turn: Array  # (m, m) K, root of the prior's covariance: deviations times a symmetric matrix

    @classmethod
    def of(cls, parameters: Parameters) -> Self:
        """The prior by a parameter set; a temperature whose uncertainty is 0 is exact."""
        mean = np.array([parameters[name] for name in TEMPERATURES])
        stated = np.array([name in parameters.given for name in TEMPERATURES])
        as_usual = tuple(mean.tolist()) == FIELD_TEMPERATURES
        if stated.any() and not stated.all():  # the others: likely ones next to these
            field = np.array(FIELD_TEMPERATURES)
            alike = _covariance(field, True)[:, stated]
            typical = field + alike @ np.linalg.solve(alike[stated], (mean - field)[stated])
            likely = np.where(stated, mean, typical)
            as_usual = bool(np.all((_COORDINATES @ likely)[1:] > NARROWEST))
            mean = likely if as_usual else mean
        covariance = _covariance(mean, as_usual)
        if stated.any():
            std = np.array([parameters.std(n) for n in np.array(TEMPERATURES)[stated]])
            own = np.diag(np.minimum(std, HIGHEST - LOWEST) ** 2)
            within = covariance[np.ix_(stated, stated)]
            follows = np.linalg.solve(within, covariance[stated]).T
            covariance += follows @ (own - within) @ follows.T
        moving = np.flatnonzero(~stated | (np.diag(covariance) > 1e-12))
        kept = covariance[np.ix_(moving, moving)]
        deviation = np.sqrt(np.diag(kept))
        values, vectors = np.linalg.eigh(kept / np.outer(deviation, deviation))
        half = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return cls(mean, moving, deviation[:, np.newaxis] * half)

    @property
    def std(self) -> Array:
        """(m,) K, of each by itself."""
        return np.asarray(np.sqrt(np.sum(self.turn**2, axis=1)))

    @property
    def stds(self) -> dict[str, float]:
        """By name, of those that are not exact."""
        return {TEMPERATURES[k]: s for k, s in zip(self.moving, self.std.tolist(), strict=True)}

    def values(self, x: Array) -> Array:
        """(4,) K, A_s below A_f and M_f below M_s."""
        straight = self.mean.copy()
        straight[self.moving] += self.turn @ x
        centre, *widths = (_COORDINATES @ straight).tolist()
        prior = (_COORDINATES[1:] @ self.mean).tolist()
        half, austenite, martensite = (
            width if known <= 0.0  # an impossible hysteresis is left as it is
            else known * math.exp(min(max(width / known - 1.0, -_FARTHEST), most))
            for width, known, most in zip(widths, prior, _WIDEST, strict=True))
        branches = [[centre + half, 0.5 * austenite], [centre - half, 0.5 * martensite]]
        exact = [k for k in range(4) if k not in self.moving]
        for number in exact:
            # An exact one shifts its range to it, and the other range if that has no exact one.
            branch, sign = number // 2, (-1.0, 1.0, 1.0, -1.0)[number]
            middle, reach = branches[branch]
            off = float(self.mean[number]) - middle - sign * reach
            for other in {branch, branch if exact[0] // 2 < branch else 1 - branch}:
                branches[other][0] += off
        found = []
        for middle, reach in branches:
            lower = min(max(middle - reach, LOWEST), HIGHEST - NARROWEST)
            found.append((lower, min(max(middle + reach, lower + NARROWEST), HIGHEST)))
        return np.array([*found[0], *found[1][::-1]])

    def slopes(self, x: Array) -> Array:
        """(m, m) d(moving ones)/dx, K."""
        steps = _TINY * np.eye(len(x))
        columns = [self.values(x + step) - self.values(x - step) for step in steps]
        return np.asarray(np.column_stack(columns)[self.moving] / (2.0 * _TINY))

    def of_grains(self, four: Array, spread: float, prior: float) -> Array:
        """(4,) K for a `spread` of the hystereses of grains. Ranges come from the spread of their
        centres and from that of their hystereses; those in `four` hold for the spread `prior`."""
        centre, half, *ranges = (_COORDINATES @ four).tolist()
        _, known, *usual = (_COORDINATES @ self.mean).tolist()
        before, added = BRANCH * prior * known, BRANCH * spread * half
        room = HIGHEST - LOWEST - 2.0 * half
        shares = [math.sqrt(max(1.0 - (before / as_usual) ** 2, 0.0)) for as_usual in usual]
        wide = [min(math.hypot(own * share, added), room)
                for own, share in zip(ranges, shares, strict=True)]
        found = _TEMPERATURES @ np.array([centre, half, *wide])
        found += max(LOWEST - found.min(), 0.0) - max(found.max() - HIGHEST, 0.0)
        return np.clip(found, LOWEST, HIGHEST)
