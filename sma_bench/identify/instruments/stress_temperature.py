"""Stress-temperature diagram: where the cosine of every branch begins and ends, and the lines of
these temperatures against stress (Clausius and Clapeyron)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.identify.estimate import Array, fit_linear
from sma_bench.identify.instruments.tangents import Bins, Line, StrainTangents, gap_at
from sma_bench.parameters import Parameters
from sma_bench.records.isobaric import Branch

# --- The cosine of eqs. (10), (11) that one branch follows.
#
# Between the line along martensite and the line along austenite strain follows the fraction:
# eps = xi cold(T) + (1 - xi) hot(T) + sigma [1/E(xi) - xi/E_M - (1 - xi)/E_A]. The bracket is the
# bow of eq. (7): compliance is no straight line in xi, which shifts the middle of the range in
# proportion to stress and would pass for 1 % of C_A.

_NARROWEST = 0.2  # K
# How far beyond the range points are used, in its widths: where the choice matters, the branch is
# no cosine between straight lines, and its ends are not better known than that.
_MARGINS = (1.0, 0.5)
_MODULI = ("wire.martensite_modulus", "wire.austenite_modulus")


@dataclass(frozen=True)
class BranchCosine:
    """The cosine of one branch.

    Attributes:
        start, finish: (value, std) in K, in the order of transformation.
        step: (value, std) of the strain by which the outer lines differ in mid-range.
        rms: of what the cosine leaves, over the step.
        temperature, strain: (n,) K and the fitted strain, for figures.
    """

    start: tuple[float, float]
    finish: tuple[float, float]
    step: tuple[float, float]
    rms: float
    temperature: Array
    strain: Array


@dataclass(frozen=True)
class _Binned:
    """A branch: `raw` (m,) K, `bins` of it, `t`, `strain` (n,) their means."""

    raw: Array
    bins: Bins
    t: Array
    strain: Array


@dataclass(frozen=True)
class _Fit:
    """Ends (2,) K with their covariance; lines along martensite and austenite."""

    ends: Array
    covariance: Array
    cold: Line
    hot: Line
    step: tuple[float, float]
    model: Array
    residual: Array


def fit_cosine(
    branch: Branch, tangents: StrainTangents, parameters: Parameters, stress: float
) -> BranchCosine:
    """Least squares of one branch; the tangents give the start of the search.

    Where the branch has no straight stretch of its own at one end, the slope there is that of the
    tangents (the other branch's). std holds scatter with its autocorrelation, the choice of the
    points, what the moduli's errors do to the bow, and gaps of the logging at the ends.

    Args:
        parameters: E_A, E_M.
        stress: Pa; 0 where strain has no unit.
    """
    t = branch.temperature
    bins = Bins.of(t)
    data = _Binned(t, bins, bins.mean(t), bins.mean(branch.strain))
    slopes = (
        tangents.cold.slope if tangents.cold_is_short else None,
        tangents.hot.slope if tangents.hot_is_short else None,
    )
    begin = np.sort([end[0] for end in tangents.cosine_ends()])
    whole = _fit(data, begin, slopes, parameters, stress, None)
    fixed = (whole.cold.slope, whole.hot.slope)
    variances = np.diag(whole.covariance)
    width = float(np.ptp(whole.ends))
    others = [
        _fit(data, whole.ends, fixed, parameters, stress, whole.ends + margin * width * _OUTWARD)
        for margin in _MARGINS
    ]
    spread = np.std([fit.ends for fit in (whole, *others)], axis=0)
    doubt = math.hypot(*(parameters.std(name) / parameters[name] for name in _MODULI))
    bowless = _fit(data, whole.ends, slopes, parameters, 0.0, None).ends if stress else whole.ends
    gaps = np.array([gap_at(data.t, float(end)) for end in whole.ends]) / math.sqrt(12.0)
    std = np.sqrt(variances + spread**2 + (doubt * (whole.ends - bowless)) ** 2 + gaps**2)
    low, high = ((float(v), float(s)) for v, s in zip(whole.ends, std, strict=True))
    start, finish = (low, high) if branch.direction == "heating" else (high, low)
    steps = [fit.step[0] for fit in (whole, *others)]
    step = (whole.step[0], math.hypot(whole.step[1], float(np.std(steps))))
    rms = float(np.sqrt(np.mean(whole.residual**2))) / max(abs(step[0]), 1e-12)
    return BranchCosine(start, finish, step, rms, data.t, whole.model)


_OUTWARD = np.array([-1.0, 1.0])


@dataclass(frozen=True)
class _Curve:
    """Strain of a branch as a function of its range and, linearly, of its outer lines.

    `slopes` are those of the lines along martensite and austenite that are given, None where
    free; `at` K, `span` K: origin and unit of temperature within the lines.
    """

    data: _Binned
    slopes: tuple[float | None, float | None]
    moduli: tuple[float, float]
    stress: float
    at: float
    span: float

    def parts(self, x: Array) -> tuple[Array, Array]:
        """(n,) known strain and (n, k) columns of the free parts; `x` lower end and width, K."""
        raw, (soft, stiff) = self.data.raw, self.moduli
        xi = 0.5 + 0.5 * np.cos(np.pi * np.clip((raw - x[0]) / x[1], 0.0, 1.0))
        straight = xi / soft + (1.0 - xi) / stiff
        known = self.stress * (1.0 / (stiff + xi * (soft - stiff)) - straight)
        free = []
        for share, slope in ((xi, self.slopes[0]), (1.0 - xi, self.slopes[1])):
            free.append(share)
            if slope is None:
                free.append(share * (raw - self.at) / self.span)
            else:
                known = known + share * (raw - self.at) * slope
        mean = self.data.bins.mean
        return mean(known), np.column_stack([mean(part) for part in free])

    def lines(self, weights: Array) -> tuple[Line, Line]:
        """The outer lines of the weights of the free parts."""
        left = list(weights)
        drawn = []
        for slope in self.slopes:
            value = float(left.pop(0))
            own = float(left.pop(0)) / self.span if slope is None else slope
            drawn.append(Line(self.at, value, own))
        return drawn[0], drawn[1]

    def step_weights(self, middle: float) -> Array:
        """(k,) of the free parts in the distance of the lines at `middle` K."""
        found: list[float] = []
        for sign, slope in zip((1.0, -1.0), self.slopes, strict=True):
            found.append(sign)
            if slope is None:
                found.append(sign * (middle - self.at) / self.span)
        return np.array(found)


def _fit(
    data: _Binned, begin: Array, slopes: tuple[float | None, float | None],
    parameters: Parameters, stress: float, window: Array | None,
) -> _Fit:
    from scipy.optimize import least_squares  # half a second to load

    inside = np.ones(len(data.t), dtype=bool)
    if window is not None:
        inside = (data.t >= window[0]) & (data.t <= window[1])
    span = float(np.ptp(data.t))
    moduli = (parameters[_MODULI[0]], parameters[_MODULI[1]])
    curve = _Curve(data, slopes, moduli, stress, float(np.mean(begin)), span)
    scale = float(np.ptp(data.strain))

    def eliminated(x: Array) -> tuple[Array, Array]:
        """(n,) residual at the best free parts, and these."""
        known, columns = curve.parts(x)
        left = data.strain - known
        weights = np.asarray(np.linalg.lstsq(columns[inside], left[inside], rcond=None)[0])
        return left - columns @ weights, weights

    first = np.array([begin[0], max(float(begin[1] - begin[0]), 2.0 * _NARROWEST)])
    bounds = ([data.t[0] - span, _NARROWEST], [data.t[-1] + span, 3.0 * span])
    found = least_squares(
        lambda x: eliminated(x)[0][inside] / scale, np.clip(first, *bounds), bounds=bounds,
        x_scale=np.full(2, first[1]), xtol=1e-6, max_nfev=60,
    )
    residual, weights = eliminated(found.x)
    known, columns = curve.parts(found.x)
    model = known + columns @ weights
    slopes_of_ends = []
    for k in range(2):
        moved = found.x.copy()
        moved[k] += 1e-4 * found.x[1]
        moved_known, moved_columns = curve.parts(moved)
        slopes_of_ends.append((moved_known + moved_columns @ weights - model) / (1e-4 * found.x[1]))
    design = np.column_stack([*slopes_of_ends, columns])[inside]
    covariance = _sandwich(design, residual[inside])
    cold, hot = curve.lines(weights)
    to_ends = np.array([[1.0, 0.0], [1.0, 1.0]])
    ends = to_ends @ found.x
    middle = float(np.mean(ends))
    step = np.concatenate([np.zeros(2), curve.step_weights(middle)])
    # Slopes that are given put the rest between the lines.
    given_cold, given_hot = (slope or 0.0 for slope in slopes)
    value = float(step[2:] @ weights) + (given_cold - given_hot) * (middle - curve.at)
    return _Fit(
        ends, to_ends @ covariance[:2, :2] @ to_ends.T, cold, hot,
        (value, math.sqrt(step @ covariance @ step)), model, residual,
    )


def _sandwich(design: Array, residual: Array) -> Array:
    """Each point with its own scatter (it is larger where strain is steep), all with one
    autocorrelation."""
    n, count = design.shape
    size = np.sqrt(np.sum(design**2, axis=0))
    size = np.where(size > 0.0, size, 1.0)
    scaled = design / size
    bread = np.linalg.pinv(scaled.T @ scaled)
    correlated = inflation(autocorrelation([residual])) * n / max(n - count, 1)
    rows = scaled * residual[:, None]
    covariance = bread @ (rows.T @ rows) @ bread * correlated
    return np.asarray(covariance / np.outer(size, size))


# --- Transition temperatures against stress.

SMALLEST_STRESS_RANGE = 5e6  # Pa
_SIGNIFICANT = 2.0
# A temperature cannot be told better than a thermocouple tells it.
SMALLEST_STD = 0.3  # K


@dataclass(frozen=True)
class Points:
    """One transition temperature at several stresses: `stress` (n,) Pa, `value`, `std` (n,) K, and
    `common`, the part of `std` by which cycles differ: it moves start and finish together."""

    stress: Array
    value: Array
    std: Array
    common: Array


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
        """C = 1/slope, Pa/K, of a significant one; the error is that of a 90 % interval's two sides
        in the mean, which an inverse has at unlike distances."""
        value, relative = 1.0 / self.slope[0], self.slope[1] / self.slope[0]
        sides = 1.0 - (1.645 * min(relative, 1.0 / _SIGNIFICANT)) ** 2
        return Estimate(value, value * relative / sides, "Pa/K", method, n)


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
    common = np.concatenate([p.common for p in transitions])
    together = (stress[:, None] == stress) & (which[:, None] != which)
    covariance = np.diag(std**2) + np.where(together, np.outer(common, common), 0.0)
    fit = fit_linear(design, value, covariance)
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
