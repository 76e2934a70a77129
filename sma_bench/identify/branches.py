"""Start and finish of the transformation in one branch of strain over temperature: crossings of
tangents before, along and after its steepest part (practice of ASTM F2082 and E3097), and a cosine
of eqs. (10), (11) fitted between the outer two lines."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sma_bench.arrays import Array
from sma_bench.estimation.noise_model import inflation, scatter
from sma_bench.identify.fits import MODULI, Line, straight_line
from sma_bench.identify.result import refusal
from sma_bench.parameters import Parameters
from sma_bench.records.instruments import Branch

_COSINE_WIDTH = 0.5 * math.pi  # width of a cosine ramp over that of its steepest tangent
_FEWEST_BINS = 30
# Tangents are drawn with every combination: the first is the result, the spread is in its error.
_STRAIGHT = (0.015, 0.010, 0.025)  # distance of points from an outer line, over the strain's range
_STEEP = (0.4, 0.3, 0.6)  # share of the material that transforms along the steep line
_SMALLEST_STEP = 12.0  # least range of strain, in standard deviations of its scatter
_SHORTEST_LINE = 5  # points
_SHORT = 0.10  # of the branch: an outer line over less is not a straight end
_TOO_STEEP = 0.10  # of the largest slope: a steeper outer line is no straight end either
_LAG = 0.10  # of the branch: after a reversal, strain may go on in the old direction so far
_LAG_STRAIN = 0.05  # of the strain's range: it lags if it goes on by more than this
_NARROWEST = 0.2  # K, least width of a cosine
_MARGINS = (1.0, 0.5)  # widths beyond the cosine's ends: refits use the points up to there
Number = tuple[float, float]  # value and standard error


class Bins(NamedTuple):
    """Equal intervals of temperature, `which` (n,) by reading: dwells do not outweigh the rest."""

    which: NDArray[np.intp]

    @classmethod
    def of(cls, t: Array, most: int = 200, rising: bool = True) -> "Bins":
        """At most `most` bins of t (n,) K, numbered from the cold end (`rising`) or the hot one."""
        width = float(np.ptp(t)) / most
        index = np.floor((t - t.min() if rising else t.max() - t) / width).astype(int)
        return cls(np.unique(index, return_inverse=True)[1])

    def mean(self, values: Array) -> Array:
        """(m,) of values (n,)."""
        return np.asarray(np.bincount(self.which, values) / np.bincount(self.which))


class StrainTangents(NamedTuple):
    """Result of the tangents of one branch; errors include scatter and other choices of lines."""

    start: Number  # K; on cooling it is the higher one
    finish: Number  # K
    step: Number  # strain between the outer lines, half-way between start and finish
    cold: Line
    hot: Line
    short: tuple[bool, bool]  # True where the cold, the hot end of the branch is not straight

    def polyline(self, branch: Branch) -> Array:
        """(4, 2) K and strain: the three tangents from the branch's cold end to its hot one."""
        low, high = sorted((self.start[0], self.finish[0]))
        ends = np.array([min(branch.temperature.min(), low), max(branch.temperature.max(), high)])
        t = np.array([ends[0], low, high, ends[1]])
        return np.column_stack([t, np.concatenate([self.cold(t[:2]), self.hot(t[2:])])])

    def cosine_ends(self) -> tuple[float, float]:
        """Start and finish in K of the cosine of eqs. (10), (11) with the same tangent."""
        middle = 0.5 * (self.start[0] + self.finish[0])
        half = 0.5 * _COSINE_WIDTH * (self.finish[0] - self.start[0])
        return middle - half, middle + half


def strain_tangents(branch: Branch, companion: Branch | None = None) -> StrainTangents:
    """Start, finish and transformation strain of one branch. `companion`: the other one of
    the cycle; where this one was reversed before it became straight, its outer line takes the
    companion's slope. InputError: too few points, or no transformation beyond the scatter."""
    binned = [(Bins.of(one.temperature), one) for one in (branch, companion) if one]
    means = [(bins.mean(one.temperature), bins.mean(one.strain)) for bins, one in binned]
    (t, strain), *others = means
    way, span = branch.direction, float(np.ptp(strain))
    if len(t) < _FEWEST_BINS:
        raise refusal("few temperatures", way=way, count=len(t), least=_FEWEST_BINS)
    noise = scatter(strain)
    if span < _SMALLEST_STEP * noise:
        raise refusal("no transformation", way=way, span=span, noise=noise)
    # Draw the lines in all ways: the first is the result, their spread enters its error.
    drawn = []
    for straight in _STRAIGHT:
        outer = _outer_lines(t, strain, others, straight)
        tries = (_draw(t, strain, outer[0][0], outer[1][0], share) for share in _STEEP)
        drawn += [(outer, found) for found in tries if found is not None]
    if not drawn:
        raise refusal("no straight stretches", way=way, low=t[0], high=t[-1])
    ((cold, hot), short), (values, variances) = zip(*drawn[0][0], strict=True), drawn[0][1]
    error = np.hypot(np.std([found[0] for _, found in drawn], axis=0), np.sqrt(variances))
    *ends, step = zip(values.tolist(), error.tolist(), strict=True)
    ends = [(v, math.hypot(std, _gap_at(t, v) / math.sqrt(12.0))) for v, std in ends]
    start, finish = ends if way == "heating" else ends[::-1]
    return StrainTangents(start, finish, step, cold, hot, short)


def _gap_at(t: Array, where: float) -> float:
    """Spacing of the points around `where` beyond twice the usual spacing, at least 0."""
    steps = np.diff(t)
    here = steps[(t[:-1] <= where) & (t[1:] >= where)]
    return max(float(np.max(here, initial=0.0)) - 2.0 * float(np.median(steps)), 0.0)


def _outer_lines(t: Array, strain: Array, others: list[tuple[Array, Array]],
                 straight: float) -> list[tuple[Line, bool]]:
    """Cold and hot line, each with whether it is short; `others`: the companion's (t, strain)."""
    found = []
    for sign in (1, -1):
        # The hot line is the cold one of the branch read backwards, its temperature negated.
        x, y = sign * t[::sign], strain[::sign]
        line, is_short = _outer_line(x, y, straight)
        for other, other_strain in others if is_short else ():
            companion, _ = _outer_line(sign * other[::sign], other_strain[::sign], straight)
            if abs(companion.slope) < abs(line.slope):  # its slope, through the end of this branch
                x, y = x[:_SHORTEST_LINE], y[:_SHORTEST_LINE]
                line = replace(companion, at=float(x.mean()), value=float(y.mean()),
                               value_variance=float(y.var()) / _SHORTEST_LINE)
        found.append((replace(line, at=sign * line.at, slope=sign * line.slope), is_short))
    return found


def _outer_line(t: Array, strain: Array, straight: float) -> tuple[Line, bool]:
    """Line along the straight beginning of a branch; whether it is too short or too steep."""
    # With few points, second differences show curvature, not scatter: hence the upper limit.
    span = float(np.ptp(strain))
    tolerance = max(straight * span, min(3.0 * scatter(strain), 2.0 * straight * span))
    # First point to use: skip what goes on in the old direction after a reversal.
    near = np.flatnonzero(t <= t[0] + _LAG * (t[-1] - t[0]))
    middle = 0.5 * (strain[0] + strain[-1])
    furthest = int(np.argmax(np.abs(strain[near] - middle)))
    lags = abs(strain[furthest] - strain[0]) > _LAG_STRAIN * span
    first = min(furthest, len(t) // 4) if lags else 0
    t, strain = t[first:], strain[first:]
    # Lines through the first `count` points, a row for each count.
    count, place = np.arange(_SHORTEST_LINE, len(t) - _SHORTEST_LINE)[:, None], np.arange(len(t))
    used = place < count
    x, y = (used * (v - (used @ v)[:, None] / count) for v in (t, strain))
    residual = y - x * np.sum(x * y, axis=1, keepdims=True) / np.sum(x**2, axis=1, keepdims=True)
    # A run of points on one side shows curvature long before the largest residual does.
    last = used & (place >= count - np.maximum(count // 5, 3))
    run, largest = abs(np.mean(residual, axis=1, where=last)), np.max(abs(residual), axis=1)
    longest = _SHORTEST_LINE
    for n, fits in enumerate((run < 0.5 * tolerance) & (largest < 2.0 * tolerance), longest):
        if fits:
            longest = n
        elif n > 3 * longest:
            break
    line = straight_line(t[:longest], strain[:longest])
    kelvins, strains = (sliding_window_view(values, _SHORTEST_LINE)[:-1] for values in (t, strain))
    centred = kelvins - kelvins.mean(axis=1, keepdims=True)
    slopes = np.sum(centred * strains, axis=1) / np.sum(centred**2, axis=1)
    is_steep = abs(line.slope) > _TOO_STEEP * float(np.max(np.abs(slopes)))
    return line, is_steep or float(np.ptp(t[:longest])) < _SHORT * float(np.ptp(t))


def _draw(t: Array, strain: Array, cold: Line, hot: Line,
          width: float) -> tuple[Array, Array] | None:
    """Cold and hot crossing [K] and strain step, (3,), and their variances, the steep line drawn
    where a share `width` of the material transforms fastest; None without such crossings."""
    gap = cold(t) - hot(t)
    share = np.divide(strain - hot(t), gap, out=np.full_like(gap, np.nan), where=gap != 0.0)
    best, steepest = None, 0.0
    for first in np.flatnonzero((share < 1.0) & (share > width)):
        done = np.flatnonzero(share[first:] <= share[first] - width)
        if not len(done):
            continue
        last = first + int(done[0])
        steepness = (share[first] - share[last]) / (t[last] - t[first])
        if steepness > steepest:
            best, steepest = slice(int(first), last + 1), float(steepness)
    if best is None or not float(np.var(strain[best])) > 0.0:  # or strains too small to be squared
        return None
    # On the steep part the error is in temperature: regress temperature on strain.
    x, y = t[best], strain[best]
    inverse = straight_line(y, x)
    if inverse.slope == 0.0:
        return None
    n, slope = len(x), 1.0 / inverse.slope
    value, of_slope = inverse.value_variance, inverse.slope_variance
    if n <= 3:  # too few points for a scatter: take a third of their distance
        variance = float(np.ptp(x) / 3.0) ** 2
        value, of_slope = variance / n, variance / float(n * np.var(y))
    steep = Line(float(x.mean()), float(y.mean()), slope, value * slope**2, of_slope * slope**4)
    low, high = steep.crossing(cold), steep.crossing(hot)
    if not t[0] - np.ptp(t) < low < high < t[-1] + np.ptp(t):
        return None
    variances = [(steep.variance(x) + side.variance(x)) / (slope - side.slope) ** 2
                 for x, side in ((low, cold), (high, hot))]
    middle = 0.5 * (low + high)
    step = float(cold(np.array(middle)) - hot(np.array(middle)))
    variances.append(cold.variance(middle) + hot.variance(middle))
    return np.array([low, high, step]), np.array(variances)


class BranchCosine(NamedTuple):
    """Cosine of eqs. (10), (11) fitted to one branch."""

    start: Number  # K, in the order of transformation
    finish: Number  # K
    step: Number  # strain between the outer lines in mid-range
    rms: float  # residual over the step
    temperature: Array  # (n,) K, for figures
    strain: Array  # (n,), fitted


def fit_cosine(branch: Branch, tangents: StrainTangents, parameters: Parameters,
               stress: float) -> BranchCosine:
    """Least-squares fit to one branch, from the tangents; at an end that is not straight, their
    slope is kept. Errors include correlated scatter, the choice of points, the moduli's errors and
    gaps in the log. `stress`: Pa; 0 where strain has no unit."""
    bins = Bins.of(branch.temperature)
    t, begin = bins.mean(branch.temperature), np.sort(tangents.cosine_ends())
    outer = zip((tangents.cold, tangents.hot), tangents.short, strict=True)
    given = [line.slope if short else None for line, short in outer]
    ends, variance, slopes, step, model, rest = _fit(branch, bins, begin, given, parameters, stress)
    # Refit to other choices of points, with the lines kept; and without the term of eq. (7).
    windows = [ends + m * float(np.ptp(ends)) * np.array([-1.0, 1.0]) for m in _MARGINS]
    others = [_fit(branch, bins, ends, slopes, parameters, stress, window) for window in windows]
    tried = [ends, *(own for own, *_ in others)]
    steps = [step[0], *(own_step[0] for _, _, _, own_step, *_ in others)]
    of_moduli = math.hypot(*(parameters.std(name) / parameters[name] for name in MODULI))
    plain = _fit(branch, bins, ends, given, parameters, 0.0)[0] if stress else ends
    gaps = np.array([_gap_at(t, float(end)) for end in ends]) / math.sqrt(12.0)
    std = np.sqrt(variance + np.var(tried, axis=0) + (of_moduli * (ends - plain)) ** 2 + gaps**2)
    low, high = zip(ends.tolist(), std.tolist(), strict=True)
    start, finish = (low, high) if branch.direction == "heating" else (high, low)
    rms = float(np.sqrt(np.mean(rest**2))) / max(abs(step[0]), 1e-12)
    whole = (step[0], math.hypot(step[1], float(np.std(steps))))
    return BranchCosine(start, finish, whole, rms, t, model)


def _fit(branch: Branch, bins: Bins,
         begin: Array, slopes: Sequence[float | None], parameters: Parameters, stress: float,
         window: Array | None = None) -> tuple[Array, Array, list[float], Number, Array, Array]:
    """Strain eps = xi cold(T) + (1 - xi) hot(T) + sigma [1/E(xi) - xi/E_M - (1 - xi)/E_A], whose
    bracket comes from eq. (7). `begin`: (2,) K, start of the search; `slopes`: of the outer lines,
    None where fitted; `window`: (2,) K, range of the points used. Returns the ends (2,) K and their
    variances, both slopes, the step, the model (n,) and its residual (n,)."""
    from scipy.optimize import least_squares  # half a second to load
    raw, (soft, stiff) = branch.temperature, (parameters[name] for name in MODULI)
    t, strain = bins.mean(raw), bins.mean(branch.strain)
    span, at, scale = float(np.ptp(t)), float(np.mean(begin)), float(np.ptp(strain))
    low, high = (-np.inf, np.inf) if window is None else window
    inside = (t >= low) & (t <= high)

    def parts(x: Array) -> tuple[Array, Array]:
        """(n,) known strain and (n, k) columns of the linear unknowns; `x`: lower end, width, K."""
        xi = 0.5 + 0.5 * np.cos(np.pi * np.clip((raw - x[0]) / x[1], 0.0, 1.0))
        straight = xi / soft + (1.0 - xi) / stiff
        known = stress * (1.0 / (stiff + xi * (soft - stiff)) - straight)
        free = []
        for share, slope in ((xi, slopes[0]), (1.0 - xi, slopes[1])):
            free.append(bins.mean(share))
            if slope is None:
                free.append(bins.mean(share * (raw - at) / span))
            else:
                known = known + share * (raw - at) * slope
        return bins.mean(known), np.column_stack(free)

    def eliminated(x: Array) -> tuple[Array, Array]:
        known, columns = parts(x)
        unexplained = strain - known
        weights = np.asarray(np.linalg.lstsq(columns[inside], unexplained[inside], rcond=None)[0])
        return unexplained - columns @ weights, weights

    first = np.array([begin[0], max(float(begin[1] - begin[0]), 2.0 * _NARROWEST)])
    bounds = ([t[0] - span, _NARROWEST], [t[-1] + span, 3.0 * span])
    x = least_squares(lambda x: eliminated(x)[0][inside] / scale, np.clip(first, *bounds),
                      bounds=bounds, x_scale=np.full(2, first[1]), xtol=1e-6, max_nfev=60).x
    residual, weights = eliminated(x)
    known, columns = parts(x)
    model, step = known + columns @ weights, 1e-4 * x[1]
    # Each point with its own scatter (larger where strain is steep), all with one autocorrelation.
    moved = [parts(x + step * unit) for unit in np.eye(2)]
    moves = [(own + free @ weights - model) / step for own, free in moved]
    design, used = np.column_stack([*moves, columns])[inside], residual[inside]
    (n, count), size = design.shape, np.sqrt(np.sum(design**2, axis=0))
    size = np.where(size > 0.0, size, 1.0)
    scaled = design / size
    bread = np.linalg.pinv(scaled.T @ scaled)
    correlated = inflation([used]) * n / max(n - count, 1)
    rows = scaled * used[:, None]
    covariance = bread @ (rows.T @ rows) @ bread * correlated / np.outer(size, size)
    # The step: distance of the lines in the middle, to which slopes that are kept contribute.
    to_ends = np.array([[1.0, 0.0], [1.0, 1.0]])
    ends = to_ends @ x
    middle, remaining = float(np.mean(ends)), weights.tolist()
    to_step, value, found = [0.0, 0.0], 0.0, []
    for sign, slope in zip((1.0, -1.0), slopes, strict=True):
        to_step += [sign, sign * (middle - at) / span][: 2 if slope is None else 1]
        value += sign * (slope or 0.0) * (middle - at)
        remaining.pop(0)
        found.append(remaining.pop(0) / span if slope is None else slope)
    of_step = np.array(to_step)
    number = (float(of_step[2:] @ weights) + value, math.sqrt(of_step @ covariance @ of_step))
    return ends, np.diag(to_ends @ covariance[:2, :2] @ to_ends.T), found, number, model, residual
