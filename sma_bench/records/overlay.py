"""Compares records: aligns their clocks by the drive and measures how their signals differ."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sma_bench.arrays import Array
from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.records.record import Record, samples

_STEP, _MOST_STEPS = 0.02, 100_000  # s, of the grid for alignment; longer in long records
_SAME_DRIVE = 0.9  # least normalised correlation of voltages of the same protocol


@dataclass(frozen=True)
class Difference:
    """Difference of a signal of one record from the same signal of the first record."""

    signal: str
    unit: str
    record: str
    rms: float  # in `unit`
    worst: float  # the largest, with its sign, in `unit`
    at: float  # s, when it is largest
    share: float  # rms over the range of the first record's signal

    def cells(self) -> tuple[str, ...]:
        unit, factor = ("mm", 1e3) if self.unit == "m" else (self.unit, 1.0)
        rms, worst, share = (round(n, 12) + 0.0 for n in (self.rms, self.worst, self.share))
        return (self.signal, self.record, f"{factor * rms:.3g} {unit}",
                f"{factor * worst:+.3g} {unit}", f"{self.at:.2f} s", f"{100.0 * share:.2g} %")


HEADER = ("signal", "record", "rms", "worst", "at", "rms over range")


@dataclass(frozen=True, eq=False, repr=False)
class Overlay(Drawn):
    """Records, shifted by `shifts` [s] onto the first one's clock; differences, largest first."""

    records: dict[str, Record]
    shifts: dict[str, float]
    differences: tuple[Difference, ...]
    remarks: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<Overlay of {len(self.records)} records: {len(self.differences)} differences>"

    def __str__(self) -> str:
        rows = [HEADER, *(d.cells() for d in self.differences)]
        wide = [max(len(row[k]) for row in rows) for k in range(len(HEADER))]
        lines = ["  ".join(f"{c:{w}}" for c, w in zip(r, wide, strict=True)).rstrip() for r in rows]
        return "\n".join([*lines, *self.remarks])

    def to_json(self) -> dict[str, Any]:
        paths = {name: str(record.path) for name, record in self.records.items()}
        found, remarks = [asdict(d) for d in self.differences], list(self.remarks)
        return {"records": paths, "shifts": self.shifts, "differences": found, "remarks": remarks}


def overlay(records: dict[str, Record], aligned: Sequence[str] = ()) -> Overlay:
    """Compare records with the first, aligned by their voltages if not `aligned` or driven
    otherwise. InputError: fewer than two records, or none shares a signal with the first."""
    if len(records) < 2:
        raise InputError(f"compare: {len(records)} record or model given, expected two or more")
    first, *others = records
    shifts, shifted, remarks = dict[str, float](), dict[str, Record](), []
    for name, record in records.items():
        shift = 0.0 if name in (first, *aligned) else _shift(records[first], record)
        shifts[name] = by = shift or 0.0
        signals = {n: replace(s, time=s.time + by) for n, s in record.signals.items()}
        markers = tuple((time + by, text) for time, text in record.markers)
        shifted[name] = replace(record, signals=signals, markers=markers)
        if shift is None:
            text = f"not driven as {first} is; not aligned, both clocks count from their start"
            remarks.append(f"{name}: {text}")
    found = []
    for where in others:
        pair = shifted[first], shifted[where]
        for name in pair[1].signals:
            own = [record.get(name) for record in pair]
            if not all(s and s.values.ndim == 1 and np.isfinite(s.values).any() for s in own):
                continue
            (time, values), (their_time, their_values) = (samples(r, name) for r in pair)
            inside = (time >= their_time[0]) & (time <= their_time[-1])
            if not inside.any():
                continue
            left = np.interp(time[inside], their_time, their_values) - values[inside]
            worst = int(np.argmax(np.abs(left)))
            rms, span = float(np.sqrt(np.mean(left**2))), float(np.ptp(values))
            share = rms / span if span > 0.0 else float(rms > 0.0)
            unit, largest, at = pair[0][name].unit, float(left[worst]), float(time[inside][worst])
            found.append(Difference(name, unit, where, rms, largest, at, share))
    if not found:
        raise InputError(f"compare: {', '.join(records)} have no signal in common at any time")
    ranked = sorted(found, key=lambda d: d.share, reverse=True)
    return Overlay(shifted, shifts, tuple(ranked), tuple(remarks))


def _shift(first: Record, other: Record) -> float | None:
    """Shift in s that aligns the other's voltages with those of the first; None if they differ."""
    def is_driven(record: Record, name: str) -> bool:
        held = record.get(name)
        return held is not None and bool(np.nanmax(np.abs(held.values), initial=0.0))

    def on_grid(record: Record) -> Array:
        return np.stack([np.interp(grid, *samples(record, n), left=0.0, right=0.0) for n in names])

    names = [f"{channel}.voltage" for channel in first.channels]
    names = [name for name in names if is_driven(first, name) and is_driven(other, name)]
    if not names:
        return None
    longest = max(first.duration, other.duration)
    step = max(_STEP, longest / _MOST_STEPS)
    grid = np.arange(0.0, longest + step, step)
    one, two = on_grid(first), on_grid(other)
    size = 2 * len(grid)
    spectrum = np.fft.rfft(one, size) * np.conj(np.fft.rfft(two, size))
    product = np.fft.irfft(spectrum, size).sum(axis=0)
    best = int(np.argmax(product))
    if product[best] < _SAME_DRIVE * np.linalg.norm(one) * np.linalg.norm(two):
        return None
    left, middle, right = product[best - 1], product[best], product[(best + 1) % size]
    bend = left - 2.0 * middle + right
    fine = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(step * (best - size * (best > size // 2) + fine))
