"""What is known of a record before a model is fitted to it: what can be mended, and signals under
suspicion."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sma_bench.findings import Finding
from sma_bench.records.check import against_voltage, check_record, outliers, receive_delays
from sma_bench.records.record import FloatArray, IntArray, Record, Signal

# s. A camera's picture takes up to a second on its way, with a right stamp: no reason to move it.
_CLOCK_TOLERANCE, _DRIFT_TOLERANCE = 1.0, 0.05
_FEWEST, _NEAR, _SHARE = 50, 0.05, 0.98
_BELIEVED = 0.1  # of the scatter, least of a stated deviation
_TURNS, _BRIEF = 20, 2.5  # jumps; samples that the briefer of two levels is held
_SUSPECT = {"value", "drift", "turns"}  # of the numbers of a finding


def mended(record: Record) -> tuple[Record, list[Finding]]:
    """The record without what is known to be wrong of it, and what that was: clocks that lie a
    constant time, over a second, off the drive's are moved onto it, by when the recorder got the
    messages, currents that run against their voltage are turned, and single readings far off those
    beside them, and deviations far below a reading's own scatter, which no sensor can state, are
    left out."""
    moved: dict[str, Signal] = {}
    found: list[Finding] = []
    for name, signal in record.signals.items():
        if name.endswith(".current") and (share := against_voltage(record, signal)):
            moved[name] = signal = replace(signal, values=-signal.values)
            text = f"runs against its voltage in {share:.0%} of its readings: its sign is turned"
            found.append(Finding("warning", name, text, {"share": share}))
        if len(off := outliers(signal)):
            values = ", ".join(f"{signal.values[i]:.4g}" for i in off.tolist())
            moved[name] = signal = _without(signal, off)
            text = (
                f"{len(off)} single readings far off those beside them are left out: {values} "
                f"{signal.unit}"
            )
            found.append(Finding("warning", name, text, {"outliers": float(len(off))}))
        if signal.std is None or len(signal) < _FEWEST:
            continue
        stated = float(np.median(signal.std))
        scatter = float(np.median(np.abs(np.diff(signal.values, 2)))) / 0.6745 / np.sqrt(6.0)
        if 0.0 < stated < _BELIEVED * scatter:
            moved[name] = replace(signal, std=None)
            text = (
                f"states {stated:.2g} {signal.unit} for a standard deviation, its readings scatter "
                f"by {scatter:.2g}: the statement is not used"
            )
            found.append(Finding("warning", name, text, {"stated": stated, "scatter": scatter}))
    delays = receive_delays(record)
    drive = next((n for n in delays if n.endswith(".voltage")), None)
    for name, delay in delays.items() if drive else ():
        late = float(np.median(delay) - np.median(delays[str(drive)]))
        tenth = max(1, len(delay) // 10)
        growth = abs(float(np.median(delay[-tenth:]) - np.median(delay[:tenth])))
        if abs(late) > _CLOCK_TOLERANCE and growth < _DRIFT_TOLERANCE:
            own = moved.get(name, record.signals[name])
            moved[name] = replace(own, time=own.time + late)
            text = f"its clock is {late:+.3f} s off that of {drive}: moved onto it by receive time"
            found.append(Finding("warning", name, text, {"offset": late}))
    return replace(record, signals=record.signals | moved), found


def under_suspicion(record: Record) -> Iterator[Finding]:
    """Signals whose readings are not what they seem: clipped, of two values, on a clock that
    drifts or jumps. The subject is the signal's name."""
    by_topic = {s.topic: n for n, s in record.signals.items() if s.topic}
    for finding in check_record(record):
        if finding.severity != "info" and _SUSPECT & set(finding.numbers):
            name = by_topic.get(finding.subject, finding.subject)
            if name in record.signals:
                yield replace(finding, subject=name)
    for name, signal in record.signals.items():
        if name.endswith((".voltage", ".current")) and (turns := _two_valued(signal)):
            text = (
                f"takes two values only and changes between them {turns} times: sampled within "
                "the PWM of a switched supply?"
            )
            yield Finding("warning", name, text, {"levels": 2.0})


def _without(signal: Signal, rows: IntArray) -> Signal:
    def left(array: FloatArray | None) -> FloatArray | None:
        return None if array is None else np.delete(array, rows)

    return replace(
        signal, time=np.delete(signal.time, rows), values=np.delete(signal.values, rows),
        received=left(signal.received), std=left(signal.std),
    )


def _two_valued(signal: Signal) -> int:
    """How often readings jump between their two values; 0 where there are more, or few jumps: a
    drive that is switched on purpose holds its level for many samples."""
    values = signal.values
    span = float(np.ptp(values)) if len(values) >= _FEWEST else 0.0
    if not span > 0.0 or not np.isfinite(values).all():
        return 0
    up = values > values.min() + 0.5 * span
    near = np.abs(values - np.where(up, values.max(), values.min())) < _NEAR * span
    turns = np.flatnonzero(up[1:] != up[:-1])
    if near.mean() < _SHARE or len(turns) < _TURNS:
        return 0
    held = np.diff(turns)  # samples, of the two levels in turn
    return len(turns) if min(np.median(held[::2]), np.median(held[1::2])) < _BRIEF else 0
