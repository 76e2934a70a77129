"""Records laid over each other: their clocks aligned by the drive, the differences in numbers."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.records.record import Record, samples

_STEP = 0.02  # s, of the voltages that are aligned; longer in long records
_MOST_STEPS = 100_000
_SAME_DRIVE = 0.9  # cosine of two drives that are the same
_ON_PAPER = {"m": ("mm", 1e3)}


@dataclass(frozen=True)
class Difference:
    """Of one signal of a record from that of the first: root mean square, the largest [unit], when
    [s of the first record's clock], and the rms over the range of the first."""

    signal: str
    unit: str
    record: str
    rms: float
    worst: float
    at: float
    share: float

    def cells(self) -> tuple[str, str, str, str, str, str]:
        """As text: signal, record, rms, largest with its time, and the share."""
        unit, factor = _ON_PAPER.get(self.unit, (self.unit, 1.0))
        rms, worst = f"{factor * self.rms:.3g} {unit}", f"{factor * self.worst:+.3g} {unit}"
        return (
            self.signal, self.record, rms, worst, f"{self.at:.2f} s", f"{100.0 * self.share:.2g} %"
        )


HEADER = ("signal", "record", "rms", "worst", "at", "rms over range")


@dataclass(frozen=True, eq=False, repr=False)
class Overlay(Drawn):
    """Records on the clock of the first one, by name; `shifts` [s] were added to their times,
    `remarks` say where that was not possible; differences from the first, the largest first."""

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
        return {
            "records": {name: str(record.path) for name, record in self.records.items()},
            "shifts": self.shifts, "differences": [asdict(d) for d in self.differences],
            "remarks": list(self.remarks),
        }


def overlay(records: dict[str, Record], aligned: Sequence[str] = ()) -> Overlay:
    """Lay records over the first one.

    Their clocks are shifted so that the voltages coincide; those named in `aligned` are on the
    first one's clock already, and those whose drive is another stay as they are.

    Raises InputError: fewer than two records, or no signal that two of them share.
    """
    if len(records) < 2:
        raise InputError(f"compare: {len(records)} record or model given, expected two or more")
    first, *others = records
    shifts, remarks = {first: 0.0}, []
    for name in others:
        shift = 0.0 if name in aligned else _shift(records[first], records[name])
        shifts[name] = shift or 0.0
        if shift is None:
            remarks.append(
                f"{name}: no drive in common with {first}; both clocks count from their start"
            )
    shifted = {
        name: replace(
            record,
            signals={n: replace(s, time=s.time + shifts[name]) for n, s in record.signals.items()},
            markers=tuple((time + shifts[name], text) for time, text in record.markers),
        )
        for name, record in records.items()
    }

    # Differences at the first record's samples, where the other has values at the same time.
    found = []
    for where in others:
        pair = shifted[first], shifted[where]
        for name in pair[1].signals:
            own = [record.get(name) for record in pair]
            if not all(s and s.values.ndim == 1 and np.isfinite(s.values).any() for s in own):
                continue
            time, values = samples(pair[0], name)
            their_time, their_values = samples(pair[1], name)
            inside = (time >= their_time[0]) & (time <= their_time[-1])
            if not inside.any():
                continue
            left = np.interp(time[inside], their_time, their_values) - values[inside]
            worst = int(np.argmax(np.abs(left)))
            rms, span = float(np.sqrt(np.mean(left**2))), float(np.ptp(values))
            share = rms / span if span > 0.0 else float(rms > 0.0)
            largest, at = float(left[worst]), float(time[inside][worst])
            unit = pair[0][name].unit
            found.append(Difference(name, unit, where, rms, largest, at, share))
    if not found:
        raise InputError(f"compare: {', '.join(records)} share no signal at any time")
    ranked = sorted(found, key=lambda d: d.share, reverse=True)
    return Overlay(shifted, shifts, tuple(ranked), tuple(remarks))


def _shift(first: Record, other: Record) -> float | None:
    """s to add to the other's times, by which its voltages lie on those of the first; None where
    they are not the same drive."""
    pair = (first, other)
    names = [f"{channel}.voltage" for channel in first.channels]
    names = [
        name for name in names
        if all(name in r.signals and np.nanmax(np.abs(r[name].values), initial=0.0) for r in pair)
    ]
    if not names:
        return None
    longest = max(first.duration, other.duration)
    step = max(_STEP, longest / _MOST_STEPS)
    grid = np.arange(0.0, longest + step, step)
    one, two = (
        np.stack([np.interp(grid, *samples(record, name), left=0.0, right=0.0) for name in names])
        for record in pair
    )
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
