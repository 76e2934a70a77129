"""The record of one experiment: named signals with units, each on its own clock."""

from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_LONGEST_LIST = 400  # characters of names in one line
_LARGEST = 1e9  # in SI units; the squares of larger ones leave the range of numbers


@dataclass(frozen=True, repr=False)
class Signal:
    """One measured or commanded quantity.

    Attributes:
        name: contract name, for instance `wire.voltage`.
        unit: SI unit of `values`.
        time: (n,) s since the start of the record, strictly increasing when read from a bag.
        values: (n,) or (n, k); a bag's missing values (NaN) are left out, not kept.
        received: (n,) s, when the recorder got the message, on the same zero; None if unknown.
        topic: where it came from, empty for a computed signal.
        std: (n,) standard deviation that each reading's own message states; None if none does.
    """

    name: str
    unit: str
    time: FloatArray
    values: FloatArray
    received: FloatArray | None = None
    topic: str = ""
    std: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.time.ndim != 1 or len(self.values) != len(self.time):
            raise InputError(
                f"signal {self.name}: values of shape {self.values.shape} on times of shape "
                f"{self.time.shape}, expected one value for each time"
            )

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        span = f", {self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self) else ""
        return f"<Signal {self.name} [{self.unit}]: {len(self)} samples{span}>"

    @property
    def period(self) -> float:
        """Median time between samples in s; NaN for fewer than two samples."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else float("nan")


@dataclass(frozen=True)
class Topic:
    """What a bag says about one topic; `signals` names what was made of it."""

    type: str
    count: int
    signals: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Record(Drawn):
    """Everything read from one bag, or simulated in its place.

    Attributes:
        path: where it was read from.
        start_ns: nanoseconds since the epoch of t = 0, the first stamp.
        signals: by name; what was not measured is absent.
        markers: (time in s, text) of the protocol steps, in order of time.
        topics: every topic of the bag by name, decoded or not.
        findings: what the reader noticed: losses, disorder, values left out.
    """

    path: Path
    start_ns: int
    signals: dict[str, Signal]
    markers: tuple[tuple[float, str], ...] = ()
    topics: dict[str, Topic] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        ends = [s.time[-1] for s in self.signals.values() if len(s)]
        names = ", ".join(sorted(self.signals)) or "no signals"
        return f"<Record {self.path}: {max(ends, default=0.0):.4g} s; {names[:_LONGEST_LIST]}>"

    def __getitem__(self, name: str) -> Signal:
        """The signal called `name`.

        Raises:
            InputError: the record has no such signal.
        """
        try:
            return self.signals[name]
        except KeyError:
            held = ", ".join(sorted(self.signals)) or "no signals"
            raise InputError(f"{self.path}: no signal {name!r}, the record has {held}") from None

    def get(self, name: str) -> Signal | None:
        """The signal called `name`, or None."""
        return self.signals.get(name)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the wires with a voltage, current or temperature, in alphabetical order."""
        split = (name.rpartition(".") for name in self.signals)
        found = {head for head, _, tail in split if tail in ("voltage", "current", "temperature")}
        return tuple(sorted(found - {"ambient"}))

    @property
    def duration(self) -> float:
        """Time of the last sample in s; 0 for a record without signals."""
        return max((float(s.time[-1]) for s in self.signals.values() if len(s)), default=0.0)


def fingerprint(record: Record) -> bytes:
    """Hash of what was recorded, whatever the file, storage or compression it lies in."""
    found = sha256()
    for name, signal in sorted(record.signals.items()):
        found.update(name.encode())
        found.update(np.ascontiguousarray(signal.time).tobytes())
        found.update(np.ascontiguousarray(signal.values).tobytes())
    return found.digest()


def samples(record: Record, name: str) -> tuple[FloatArray, FloatArray]:
    """Time (n,) s and values (n,) of a signal, without NaN, Inf and what no sensor can say.

    Raises:
        InputError: the signal is absent or holds no finite value.
    """
    signal = record.get(name)
    if signal is None:
        raise InputError(f"{record.path}: no signal {name}")
    values = np.asarray(signal.values, dtype=np.float64)
    good = (np.abs(values) < _LARGEST) & np.isfinite(signal.time)
    if not good.any():
        raise InputError(f"{record.path}: {name} holds no finite value ({len(values)} samples)")
    time, values = np.asarray(signal.time, dtype=np.float64)[good], values[good]
    order = np.argsort(time, kind="stable")
    return time[order], values[order]


def has_samples(record: Record, name: str) -> bool:
    """Whether a signal is there with at least one finite value."""
    signal = record.get(name)
    return signal is not None and bool((np.abs(signal.values) < _LARGEST).any())


def first_order_lag(course: FloatArray, left: float, start: float = 0.0) -> FloatArray:
    """(n,) of an even course (n,): `left` of what it was a sample before, the rest of what comes
    in; `start` is what it was before the first."""
    from scipy.linalg import solve_banded

    coming = (1.0 - left) * course
    coming[0] += left * start
    bands = np.vstack([np.ones_like(course), np.full_like(course, -left)])
    return np.asarray(solve_banded((1, 0), bands, coming))
