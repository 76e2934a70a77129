"""What a record offers to each experiment."""

from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.voltage import Segment, Segments, find_segments, protocol_spans
from sma_bench.findings import Finding
from sma_bench.identify.plateaus import FEWEST_LEVELS, windows
from sma_bench.records import Record
from sma_bench.records.record import has_samples, samples

SHORTEST_PLATEAU = 2.0


@dataclass(frozen=True)
class Staircase:
    """Plateaus at several voltages on one channel; `tolerance` in V tells levels apart."""

    channel: str
    plateaus: tuple[Segment, ...]
    tolerance: float
    protocol: str = ""

    def windows(self, settle: float, average: float) -> tuple[Array, tuple[Finding, ...]]:
        """Averaging windows (p, 2) in s and remarks on them."""
        return windows(self.plateaus, settle, average)

    def source(self, record: Record) -> str:
        """Where the points come from, for the result file."""
        span = f"{self.plateaus[0].start:.1f} to {self.plateaus[-1].stop:.1f} s"
        return f"{record.path}: {self.channel}, {span}" + (
            f", protocol {self.protocol}" if self.protocol else ""
        )


@dataclass(frozen=True)
class Drive:
    """What the voltage of one channel does over a record."""

    channel: str
    segments: Segments
    staircases: tuple[Staircase, ...]

    def describe(self) -> str:
        """A few words for messages."""
        s = self.segments
        counts = (len(s.plateaus), s.levels(), len(s.ramps))
        plateaus, voltages, ramps = (
            f"{n} {word}{'' if n == 1 else 's'}"
            for n, word in zip(counts, ("plateau", "voltage", "ramp"), strict=True)
        )
        return f"{self.channel}: {plateaus} at {voltages}, {ramps}"


def find_drives(record: Record) -> tuple[Drive, ...]:
    """Segments of every channel's voltage, split by protocol where markers name them.

    Raises:
        InputError: a voltage too short to be cut into segments.
    """
    drives = []
    for channel in record.channels:
        if not has_samples(record, f"{channel}.voltage"):
            continue
        try:
            segments = find_segments(*samples(record, f"{channel}.voltage"))
        except InputError as error:
            raise InputError(f"{record.path}: {channel}.{error}") from None
        drives.append(Drive(channel, segments, _staircases(record, channel, segments)))
    return tuple(drives)


def missing_findings(record: Record, channel: str) -> tuple[Finding, ...]:
    """A warning for each signal of a channel of which some samples were not measured."""
    findings = []
    for quantity in ("voltage", "current", "temperature"):
        signal = record.get(f"{channel}.{quantity}")
        if signal is None:
            continue
        bad = int(np.sum(~np.isfinite(signal.values)))
        if 0 < bad < len(signal.values):
            text = f"{record.path}: {bad} of {len(signal.values)} samples are NaN and left out"
            findings.append(Finding("warning", signal.name, text, {"count": float(bad)}))
    return tuple(findings)


def _staircases(record: Record, channel: str, segments: Segments) -> tuple[Staircase, ...]:
    found = []
    for protocol, start, stop in protocol_spans(record.markers, record.duration):
        part = segments.between(start, stop)
        plateaus = tuple(p for p in part.plateaus if p.duration >= SHORTEST_PLATEAU)
        if Segments(plateaus, (), part.tolerance).levels() >= FEWEST_LEVELS:
            found.append(Staircase(channel, plateaus, part.tolerance, protocol))
    return tuple(found)
