"""Plateaus, ramps and edges, found from the voltage itself."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array
from sma_bench.identify.noise import resolution

SHORTEST_SEGMENT = 0.5
FEWEST_SAMPLES = 20
_TOLERANCE_STD = 8.0
_TOLERANCE_STEPS = 2.5
_SMALLEST_TOLERANCE = 1e-3
_MOST_PIECES = 20_000


@dataclass(frozen=True)
class Segment:
    """A stretch of the voltage that one straight line describes.

    `start`, `stop` in s, `voltage_start`, `voltage_stop` in V are the line's ends. A plateau's
    `direction` is that of the step which led to it (for the first one: of the step which left it).
    """

    kind: Literal["plateau", "ramp"]
    start: float
    stop: float
    voltage_start: float
    voltage_stop: float
    direction: Literal["up", "down"]

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.stop - self.start

    @property
    def level(self) -> float:
        """Mean voltage in V."""
        return 0.5 * (self.voltage_start + self.voltage_stop)

    @property
    def slope(self) -> float:
        """Rate in V/s."""
        return (self.voltage_stop - self.voltage_start) / self.duration


@dataclass(frozen=True)
class Segments:
    """All plateaus and ramps of a voltage in order, and the edges (s before, s after) of jumps.

    `tolerance` (V) is how far a sample may lie from its line.
    """

    items: tuple[Segment, ...]
    edges: tuple[tuple[float, float], ...]
    tolerance: float

    @property
    def plateaus(self) -> tuple[Segment, ...]:
        """Stretches of constant voltage."""
        return tuple(s for s in self.items if s.kind == "plateau")

    @property
    def ramps(self) -> tuple[Segment, ...]:
        """Stretches of steadily changing voltage."""
        return tuple(s for s in self.items if s.kind == "ramp")

    def between(self, start: float, stop: float) -> "Segments":
        """Segments and edges that begin within [start, stop) s, such as one protocol's."""
        return Segments(
            tuple(s for s in self.items if start <= s.start < stop),
            tuple(e for e in self.edges if start <= e[0] < stop),
            self.tolerance,
        )

    def levels(self) -> int:
        """Number of plateau voltages that differ from each other."""
        sorted_levels = np.sort([p.level for p in self.plateaus])
        if len(sorted_levels) == 0:
            return 0
        return 1 + int(np.sum(np.diff(sorted_levels) > self.tolerance))


def find_segments(time: Array, voltage: Array) -> Segments:
    """Cut a voltage into straight pieces (Douglas and Peucker, 1973) and sort them.

    Args:
        time: (n,) s, increasing; gaps and jitter do no harm.
        voltage: (n,) V, noisy or quantised.

    Raises:
        InputError: fewer than 20 samples, or values that are not finite.
    """
    if len(time) < FEWEST_SAMPLES:
        raise InputError(
            f"voltage has {len(time)} samples, expected {FEWEST_SAMPLES} or more to find segments"
        )
    if not (np.all(np.isfinite(voltage)) and np.all(np.isfinite(time))):
        raise InputError("voltage holds values that are not finite, expected V")
    # The median of three drops single wild samples and keeps edges and ramps.
    smooth = np.asarray(median_filter(voltage, 3, mode="constant"), dtype=np.float64)
    smooth[[0, -1]] = voltage[[0, -1]]
    tolerance = _tolerance(voltage)
    span = float(np.ptp(smooth))
    while True:
        pieces = _merge(time, smooth, _split(time, smooth, tolerance), tolerance)
        if tolerance > span / 8.0 or not _is_fragmented(time, pieces):
            break
        # A ramp commanded in small steps looks like many tiny plateaus: look more coarsely.
        tolerance *= 2.0
    return _sort(time, smooth, pieces, tolerance)


def protocol_spans(
    markers: Iterable[tuple[float, str]], duration: float
) -> tuple[tuple[str, float, float], ...]:
    """(protocol, start, stop) in s, one for each run of markers "protocol/step" of one protocol.

    Without markers the whole record is one span without a name.
    """
    spans: list[tuple[str, float, float]] = []
    for time, text in sorted(markers):
        name = text.split("/")[0].strip()
        if spans and spans[-1][0] == name:
            continue
        if spans:
            spans[-1] = (spans[-1][0], spans[-1][1], time)
        spans.append((name, time, duration))
    return tuple(spans) or (("", -np.inf, np.inf),)


def _tolerance(voltage: Array) -> float:
    second = np.diff(voltage, 2)
    # A channel that is switched off may read exactly 0, which says nothing of its noise.
    driven = second[voltage[1:-1] != 0.0]
    second = driven if len(driven) else second
    noise = 1.4826 * float(np.median(np.abs(second - np.median(second)))) / np.sqrt(6.0)
    return max(
        _TOLERANCE_STD * noise, _TOLERANCE_STEPS * resolution(voltage), _SMALLEST_TOLERANCE
    )


def _split(time: Array, voltage: Array, tolerance: float) -> list[tuple[int, int]]:
    """Index pairs (first, last) of chords that stay within the tolerance of all samples."""
    pieces: list[tuple[int, int]] = []
    stack = [(0, len(time) - 1)]
    while stack and len(pieces) < _MOST_PIECES:
        first, last = stack.pop()
        inner = slice(first + 1, last)
        share = (time[inner] - time[first]) / max(time[last] - time[first], 1e-12)
        chord = voltage[first] + share * (voltage[last] - voltage[first])
        away = np.abs(voltage[inner] - chord)
        if len(away) and away.max() > tolerance:
            middle = first + 1 + int(np.argmax(away))
            stack.extend([(middle, last), (first, middle)])
        else:
            pieces.append((first, last))
    return pieces


def _line(time: Array, voltage: Array, first: int, last: int) -> tuple[float, float, float]:
    """Ends of the least-squares line through samples first..last, and the largest distance."""
    t, v = time[first : last + 1], voltage[first : last + 1]
    centred = t - t.mean()
    slope = float(centred @ v) / max(float(centred @ centred), 1e-12)
    fitted = v.mean() + slope * centred
    return float(fitted[0]), float(fitted[-1]), float(np.max(np.abs(v - fitted)))


def _merge(
    time: Array, voltage: Array, pieces: Sequence[tuple[int, int]], tolerance: float
) -> list[tuple[int, int]]:
    """Join neighbours that one line describes as well: the chords end on noisy samples."""
    merged: list[tuple[int, int]] = []
    for piece in pieces:
        while merged:
            first, last = merged[-1][0], piece[1]
            is_edge = any(b - a == 1 for a, b in (merged[-1], piece))
            if _line(time, voltage, first, last)[2] > tolerance / (2.0 if is_edge else 1.0):
                break
            merged.pop()
            piece = (first, last)
        merged.append(piece)
    return merged


def _is_fragmented(time: Array, pieces: Sequence[tuple[int, int]]) -> bool:
    """Whether some stretch of voltage fell into nothing but crumbs."""
    crumbs = 0.0
    for first, last in pieces:
        length = float(time[last] - time[first])
        crumbs = crumbs + length if length < SHORTEST_SEGMENT else 0.0
        if crumbs > 2.0 * SHORTEST_SEGMENT:
            return True
    return False


def _sort(
    time: Array, voltage: Array, pieces: Sequence[tuple[int, int]], tolerance: float
) -> Segments:
    found: list[tuple[bool, float, float, float, float]] = []
    edges: list[tuple[float, float]] = []
    for first, last in pieces:
        if last - first == 1 and abs(voltage[last] - voltage[first]) > tolerance:
            edges.append((float(time[first]), float(time[last])))
        if time[last] - time[first] < SHORTEST_SEGMENT:
            continue
        begin, end, _ = _line(time, voltage, first, last)
        found.append(
            (abs(end - begin) <= tolerance, float(time[first]), float(time[last]), begin, end)
        )
    levels = [0.5 * (begin + end) for flat, _, _, begin, end in found if flat]
    items = []
    seen = 0
    for flat, start, stop, begin, end in found:
        rise = end - begin
        if flat:
            reference = levels[max(seen, 1) - 1 : max(seen, 1) + 1]
            rise = reference[-1] - reference[0] if len(reference) == 2 else 0.0
            seen += 1
        items.append(
            Segment(
                "plateau" if flat else "ramp", start, stop, begin, end,
                "up" if rise >= 0.0 else "down",
            )
        )
    return Segments(tuple(items), tuple(edges), tolerance)
