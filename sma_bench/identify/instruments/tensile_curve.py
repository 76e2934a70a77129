"""What one tensile curve shows: toe, elastic rises, plateau, unloading."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.identify.estimate import Array
from sma_bench.identify.pieces import Piece, fit_piece, straight_pieces
from sma_bench.records.tensile import TensileRecord

PLATEAU_SLOPE = 0.35
PLATEAU_STRAIN = 0.004
_GRID = 240
_STRAIGHT = 0.004
_TRIM = 0.1
_SAME_SLOPE = 0.8
_SHORTEST_RISE = 0.0008
_SHORTEST_AFTER = 0.003
_UNLOADED = (0.9, 0.5)


@dataclass(frozen=True)
class Rise:
    """An elastic part: modulus and its error in Pa, strains and stresses (Pa) of its ends, n."""

    modulus: float
    std: float
    strain: tuple[float, float]
    stress: tuple[float, float]
    n: int


@dataclass(frozen=True)
class TensileReading:
    """What one curve shows.

    Attributes:
        initial: the rise before the plateau.
        after: the rise after the plateau, if the test went so far.
        unloading: the first part of unloading, if there is any.
        plateau: (strain, strain, mean stress Pa), None without one.
        toe: strain at which the initial rise, extended, begins (slack before it).
        pieces: (m, 2) strain and stress of the pieces' ends.
    """

    initial: Rise
    after: Rise | None
    unloading: Rise | None
    plateau: tuple[float, float, float] | None
    toe: float
    pieces: Array


def read_curve(record: TensileRecord) -> TensileReading:
    """Find toe, elastic rises and plateau of one curve.

    Raises:
        InputError: no elastic part can be told.
    """
    top = int(np.argmax(record.stress))
    x, y = _even(record.strain[: top + 1], record.stress[: top + 1])
    if len(x) < 20:
        raise InputError(f"{record.path}: {len(x)} points while loading, expected 20 or more")
    noise = 1.4826 * float(np.median(np.abs(np.diff(y, 2)))) / math.sqrt(6.0)
    pieces = straight_pieces(x, y, max(_STRAIGHT * float(np.ptp(y)), 1.2 * noise))
    plateau = _plateau(x, y, pieces)
    before = [p for p in pieces if plateau is None or p.last < plateau[0]]
    initial = _steepest(x, y, before)
    if initial is None:
        raise InputError(f"{record.path}: no elastic rise before the plateau")
    behind = [p for p in pieces if plateau is not None and p.first > plateau[1]]
    after = _steepest(x, y, behind)
    if after is not None and x[after.last] - x[after.first] < _SHORTEST_AFTER:
        after = None
    level = None
    if plateau is not None:
        first, last = plateau
        level = (float(x[first]), float(x[last]), float(np.mean(y[first : last + 1])))
    return TensileReading(
        initial=_rise(record, top, x, initial),
        after=_rise(record, top, x, after) if after else None,
        unloading=_unloading(record, top),
        plateau=level,
        toe=initial.at - initial.value / initial.slope,
        pieces=np.array([
            [x[k], p.value + p.slope * (x[k] - p.at)] for p in pieces for k in (p.first, p.last)
        ]),
    )


def _even(strain: Array, stress: Array) -> tuple[Array, Array]:
    """Means over narrow intervals of strain."""
    width = float(np.ptp(strain)) / _GRID
    if width <= 0.0:
        return strain[:0], stress[:0]
    index = np.floor((strain - strain.min()) / width).astype(int)
    _, index, count = np.unique(index, return_inverse=True, return_counts=True)
    return np.bincount(index, strain) / count, np.bincount(index, stress) / count


def _plateau(x: Array, y: Array, pieces: Sequence[Piece]) -> tuple[int, int] | None:
    """First and last point of the longest run of flat pieces after the first steep one."""
    steep = max(p.slope for p in [p for p in pieces if _is_long(x, p)] or pieces)
    runs: list[tuple[int, int]] = []
    seen = False
    for p in pieces:
        if p.slope > 0.5 * steep:
            seen = True
        if not seen or p.slope > PLATEAU_SLOPE * steep:
            continue
        if runs and runs[-1][1] + 1 == p.first:
            runs[-1] = (runs[-1][0], p.last)
        else:
            runs.append((p.first, p.last))
    long = [run for run in runs if x[run[1]] - x[run[0]] > PLATEAU_STRAIN]
    return max(long, key=lambda run: float(x[run[1]] - x[run[0]])) if long else None


def _is_long(x: Array, piece: Piece) -> bool:
    return bool(x[piece.last] - x[piece.first] >= _SHORTEST_RISE)


def _steepest(x: Array, y: Array, pieces: Sequence[Piece]) -> Piece | None:
    """The steepest piece that is long enough, joined with neighbours of nearly its slope."""
    long = [p for p in pieces if _is_long(x, p)] or list(pieces)
    if not long:
        return None
    best = max(long, key=lambda p: p.slope)
    at = list(pieces).index(best)
    first, last = at, at
    while first > 0 and pieces[first - 1].slope > _SAME_SLOPE * best.slope:
        first -= 1
    while last + 1 < len(pieces) and pieces[last + 1].slope > _SAME_SLOPE * best.slope:
        last += 1
    return fit_piece(x, y, pieces[first].first, pieces[last].last)


def _rise(record: TensileRecord, top: int, x: Array, piece: Piece) -> Rise:
    low, high = float(x[piece.first]), float(x[piece.last])
    trim = _TRIM * (high - low)
    strain, stress = record.strain[: top + 1], record.stress[: top + 1]
    chosen = (strain >= low + trim) & (strain <= high - trim)
    if np.sum(chosen) < 5:
        chosen = (strain >= low) & (strain <= high)
    return _modulus(strain[chosen], stress[chosen])


def _modulus(strain: Array, stress: Array) -> Rise:
    """Slope, its error from coloured scatter, and from the curvature that halves would show."""
    middle = 0.5 * (strain.min() + strain.max())
    centred = strain - strain.mean()
    power = float(centred @ centred)
    slope = float(centred @ stress) / power
    left = stress - stress.mean() - slope * centred
    n = len(strain)
    variance = float(left @ left) / max(n - 2, 1) * inflation(autocorrelation([left])) / power
    halves = [strain <= middle, strain > middle]
    bend = 0.0
    if min(int(np.sum(h)) for h in halves) >= 8:
        slopes = [float(np.polyfit(strain[h], stress[h], 1)[0]) for h in halves]
        # Halves of noise alone differ by 4 sqrt(2) standard errors of the whole.
        bend = max(abs(slopes[1] - slopes[0]) - 8.0 * math.sqrt(variance), 0.0) / 4.0
    return Rise(
        slope, math.hypot(math.sqrt(variance), bend),
        (float(strain.min()), float(strain.max())), (float(stress.min()), float(stress.max())), n,
    )


def _unloading(record: TensileRecord, top: int) -> Rise | None:
    """Slope from 90 to 50 % of the largest stress on the way down."""
    stress, strain = record.stress[top:], record.strain[top:]
    high, low = (share * float(record.stress[top]) for share in _UNLOADED)
    if len(stress) < 10 or stress.min() > low:
        return None
    last = int(np.argmax(stress <= low))
    chosen = np.flatnonzero(stress[: last + 1] <= high)
    if len(chosen) < 5 or np.ptp(strain[chosen]) == 0.0:
        return None
    return _modulus(strain[chosen], stress[chosen])
