"""Checks and repairs of a record before a model is fitted to it."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length
from sma_bench.records import check
from sma_bench.records.check import FEWEST, check_response, finding_of, kind_of
from sma_bench.records.record import Record, Signal, as_calibrated

_MAX_DELAY = 1.0  # s, of a camera image from exposure to arrival; longer means a wrong clock
_LEAST_STROKE = 3e-3  # strain; a wire that only expands with heat moves less
_LEAST_STATED = 0.1  # of the scatter of the readings; a smaller stated deviation is not used
# Two-valued readings: this share of them lies this near (of the range) to one of two values, they
# change at least so often, and hold one of the values for fewer samples than this (median).
_SHARE, _NEAR, _TURNS, _BRIEF = 0.98, 0.05, 20, 2.5
_DOUBTFUL = {"value", "drift", "common", "follows", "apart"}  # numbers of findings that cast doubt
_REGULAR = 0.95  # share of the values that last a whole multiple of the usual number of rows
_TWO_CLOCKS = 5  # rows; values that usually last as long may last one row more or less
_ONE_ROW = 1.1  # rows, at most, between a reading and the row that shows it first
_NONE: IntArray = np.zeros(0, dtype=np.int64)
_GAP, _GAP_STEPS, _FEW = 2.0, 10.0, 8  # s; usual steps; readings next to a gap that show a ramp
_RAMP, _LEVEL = 0.2, 0.03  # tolerances of a voltage over a gap: of its step, of its range


@dataclass(frozen=True)
class Prepared:
    """Records to be compared with a model, and what was found and done."""

    records: list[Record]  # repaired and calibrated
    remarks: list[str]  # a line for each repair, omission and doubt
    doubted: set[str]  # quantities with doubtful readings
    response: list[Finding]  # on readings that do not follow the drive


def prepare(records: Sequence[Record], parameters: Parameters,
            quantities: Collection[str]) -> Prepared:
    """Records repaired and calibrated; `quantities`: those that will be compared."""
    kind, pairs = load_kind(parameters), [mended(record, parameters) for record in records]
    whole = [as_calibrated(record, parameters) for record, _ in pairs]
    known = [(record, finding) for record, found in pairs for finding in found]
    known += [(r, f) for r in whole for f in r.findings if "repeated" in f.numbers]
    doubts = [(r, f) for r in whole for f in doubtful_readings(r)
              if _quantity(f.subject) in ("voltage", "range", *quantities)]  # fmt: skip
    response = [(r, f) for r in whole for f in check_response(r)
                if f.subject != "elongation" or kind != "displacement"]  # fmt: skip
    kept, omitted = [], list[tuple[Record, Finding]]()
    for record in whole:
        sound, found = comparable(record, [f for r, f in response if r is record])
        sound, unseen = without_unseen_drive(sound)
        omitted += [(record, finding) for finding in (*found, *unseen)]
        # The force of a weight is a parameter, so that readings of a load cell are not compared.
        kept.append(_without_signals(sound, ["force"] if kind == "force" else []))
    remarked = (*known, *doubts, *response, *omitted)
    remarks = [f"{record.path.name}: {f.subject}: {f.text}" for record, f in remarked]
    doubted = {_quantity(finding.subject) for _, finding in doubts}
    about = [replace(f, subject=f"{record.path}, {f.subject}") for record, f in response]
    return Prepared(kept, remarks, doubted, about)


def _without_signals(record: Record, names: Collection[str]) -> Record:
    return replace(record, signals={n: s for n, s in record.signals.items() if n not in names})


def _quantity(name: str) -> str:
    kind = kind_of(name)
    return "deflection" if kind == "elongation" else kind


def comparable(record: Record, findings: Iterable[Finding]) -> tuple[Record, list[Finding]]:
    """The record without clipped readings and without temperatures that, by its `findings`, follow
    another wire; and a finding on each omission."""
    kept, left_out = dict(record.signals), []
    others = {f.subject for f in findings if "follows" in f.numbers}
    may_clip = (*check.DROPS_OUT, "elongation", "force", "current")
    for name, signal in record.signals.items():
        values, which = signal.values, np.arange(len(signal) if name in others else 0)
        if kind_of(name) in may_clip and len(values) and np.ptp(values) > 0.0:
            for extreme in (float(values.max()), float(values.min())):
                which = np.union1d(which, check.clipped_samples(record, signal, extreme))
        if len(which):
            kept[name] = _without(signal, which.astype(np.intp))
            left_out.append(finding_of("not_compared", name, count=len(which)))
    return _without_signals(replace(record, signals=kept), others), left_out


def without_unseen_drive(record: Record) -> tuple[Record, list[Finding]]:
    """The record's longest stretch without a gap (of all signals) over which a voltage changed,
    other than along a ramp; and findings."""
    times = np.unique(np.concatenate([[], *(s.time for s in record.signals.values())]))
    steps = np.diff(times)
    if not len(steps):
        return record, []
    least = max(_GAP, _GAP_STEPS * float(np.quantile(steps, 0.95)))
    edges, found = [times[0]], list[Finding]()
    for k in np.flatnonzero(steps > least).tolist():
        names = [n for n in record.signals if n.endswith(".voltage")]
        changed = [n for n in names if _jumped(record[n], times[k], steps[k])]
        if changed:
            edges += [times[k], times[k + 1]]
            facts = {"gap": float(steps[k]), "at": float(times[k] - times[0])}
            found.append(finding_of("unseen", ", ".join(changed), **facts))
    if not found:
        return record, []
    begins, ends = np.array(edges[::2]), np.array([*edges[1::2], times[-1]])
    longest = int(np.argmax(ends - begins))
    low, high = float(begins[longest]), float(ends[longest])
    kept = {name: _without(s, np.flatnonzero((s.time < low) | (s.time > high)))
            for name, s in record.signals.items()}
    facts = {"begin": low - float(times[0]), "end": high - float(times[0])}
    return replace(record, signals=kept), [*found, finding_of("one_stretch", "record", **facts)]


def _jumped(voltage: Signal, begin: float, gap: float) -> bool:
    """True if a voltage changed over a gap and neither its slope before nor after explains it."""
    time, values = voltage.time, voltage.values
    after = int(np.searchsorted(time, begin, side="right"))
    before, behind = slice(max(after - _FEW, 0), after), slice(after, after + _FEW)
    if after < 2 or after > len(time) - 2:
        return False
    step = values[after] - values[after - 1]
    ramps = [np.polyfit(time[part] - begin, values[part], 1)[0] for part in (before, behind)]
    scatter = float(np.median(np.abs(np.diff(values, 2))))
    allowed = max(_RAMP * abs(step), _LEVEL * float(np.ptp(values)), 6.0 * scatter)
    return abs(step) > allowed and all(abs(step - gap * ramp) > allowed for ramp in ramps)


def _published_again(signal: Signal) -> tuple[IntArray, Array | None]:
    """Indices of readings published again at a fixed rate (readings of few digits repeat, too, but
    irregularly), and if the sensor's clock is steady, the times of its readings."""
    values = signal.values
    if values.ndim != 1 or len(values) < FEWEST:
        return _NONE, None
    new = np.flatnonzero(np.diff(values) != 0.0) + 1
    times = np.diff(new)
    if len(times) < FEWEST or (usual := int(np.quantile(times, 0.1, method="lower"))) <= 1:
        return _NONE, None
    # With a steady clock, each reading appears within a row of its time; some may be equal.
    period = np.mean(times[times <= usual + 1])
    count = np.append(0.0, np.cumsum(np.rint(times / period)))
    slope, start = np.polyfit(count, signal.time[new], 1)
    late = signal.time[new] - start - slope * count
    if np.ptp(late) <= _ONE_ROW * np.quantile(np.diff(signal.time), 0.95):
        number = np.floor((signal.time - start - late.min()) / slope + 1e-6)
        again = np.flatnonzero(np.diff(number) == 0.0) + 1
        return again, start + late.min() + slope * np.delete(number, again)
    # Otherwise values last whole multiples of the usual number of rows; two clocks may add a row.
    off = np.abs(times - usual * np.rint(times / usual)) > (usual >= _TWO_CLOCKS)
    if np.mean(~off) <= _REGULAR:
        return _NONE, None
    # A long stretch of one value holds several readings: the first row of each equal part is one.
    begins = np.append(0, new)
    length = np.diff(np.append(begins, len(values)))
    stretch = np.repeat(np.arange(len(begins)), length)
    count, place = np.maximum(np.rint(length / usual), 1)[stretch], np.arange(len(values))
    part = (place - begins[stretch]) * count // length[stretch]
    return np.flatnonzero((np.diff(part) == 0.0) & (np.diff(stretch) == 0)) + 1, None


def mended(record: Record, parameters: Parameters | None = None) -> tuple[Record, list[Finding]]:
    """The repaired record and a finding on each repair: clocks moved onto the drive's; currents of
    the wrong sign inverted, with `parameters` motions, too; outliers and readings published again
    left out; stated deviations far below the scatter dropped."""
    is_imposed = parameters is not None and load_kind(parameters) == "displacement"
    imposed = "elongation" if is_imposed else ""
    moved, found = dict[str, Signal](), list[Finding]()
    for name, signal in record.signals.items():
        if name.endswith(".current") and (share := check.against_voltage(record, signal)):
            moved[name] = signal = replace(signal, values=-signal.values)
            found.append(finding_of("turned", name, share=share))
        is_input, unit = name == imposed or kind_of(name).startswith("voltage"), signal.unit
        again, stamps = _published_again(signal) if not is_input else (_NONE, None)
        if len(again):
            times = len(signal) / (len(signal) - len(again))
            signal = _without(signal, again)
            moved[name] = signal = signal if stamps is None else replace(signal, time=stamps)
            found.append(finding_of("again", name, times=times))
        if len(off := check.outliers(signal)):
            values = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            moved[name] = signal = _without(signal, off)
            found.append(finding_of("left_out", name, outliers=len(off), values=values, unit=unit))
        if signal.std is None or len(signal) < FEWEST:
            continue
        std = float(np.median(signal.std))
        scatter = float(np.median(np.abs(np.diff(signal.values, 2)))) / 0.6745 / np.sqrt(6.0)
        if 0.0 < std < _LEAST_STATED * scatter:
            moved[name] = replace(signal, std=None)
            found.append(finding_of("understated", name, stated=std, scatter=scatter, unit=unit))
    delays = check.delays_of(record)
    drive = next((n for n in delays if n.endswith(".voltage")), None)
    for name, (delay, growth) in delays.items() if drive else ():
        late = delay - delays[str(drive)][0]
        if not -check.CLOCK_TOLERANCE <= late <= _MAX_DELAY and abs(growth) < check.DRIFT_TOLERANCE:
            own = moved.get(name, record.signals[name])
            moved[name] = replace(own, time=own.time + late)
            found.append(finding_of("clock_moved", name, offset=late, drive=drive))
    record = replace(record, signals=record.signals | moved)
    if parameters is None:
        return record, found
    # A wire below A_s does expand with heat: a small motion keeps its sign.
    turned, reach = dict(record.signals), _LEAST_STROKE * wire_length(parameters)
    for against in check_response(record):
        name = against.subject
        if "together" not in against.numbers or name == imposed:
            continue
        moves = against.numbers["together"] * np.ptp(np.quantile(record[name].values, [0.01, 0.99]))
        if name != "elongation" or moves > reach:
            turned[name] = replace(turned[name], values=-turned[name].values)
            found.append(finding_of("turned_tip", name, together=against.numbers["together"]))
    return replace(record, signals=turned), found


def _without(signal: Signal, which: IntArray) -> Signal:
    fields = {field: getattr(signal, field) for field in ("time", "values", "received", "std")}
    left: dict[str, Any] = {f: np.delete(v, which) for f, v in fields.items() if v is not None}
    return replace(signal, **left)


def doubtful_readings(record: Record) -> Iterator[Finding]:
    """Findings, by signal, that cast doubt on readings: clipped, two-valued or on a wrong clock."""
    by_topic = {s.topic: n for n, s in record.signals.items() if s.topic}
    for finding in check.check_record(record):
        if finding.severity != "info" and _DOUBTFUL & set(finding.numbers):
            name = by_topic.get(finding.subject, finding.subject)
            if name in record.signals:
                yield replace(finding, subject=name)
    # Readings that jump between two values; a drive switched on purpose holds each for longer.
    for name, signal in record.signals.items():
        values = signal.values
        if not name.endswith((".voltage", ".current")) or len(values) < FEWEST:
            continue
        span = float(np.ptp(values))
        if not span > 0.0 or not np.isfinite(values).all():
            continue
        up = values > values.min() + 0.5 * span
        near = np.abs(values - np.where(up, values.max(), values.min())) < _NEAR * span
        turns = np.flatnonzero(up[1:] != up[:-1])
        if near.mean() < _SHARE or len(turns) < _TURNS:
            continue
        held = np.diff(turns)  # samples, of the two levels in turn
        if min(np.median(held[::2]), np.median(held[1::2])) < _BRIEF:
            yield finding_of("two_valued", name, turns=len(turns), levels=2.0)
