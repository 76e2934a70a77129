"""What is put right in a record, left out of it and doubted before a model is fitted to it."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length
from sma_bench.records import check
from sma_bench.records.check import FEWEST, check_response, kind_of, said
from sma_bench.records.record import Record, Signal, as_calibrated

_MOVED = 1.0  # s: a camera's picture may take as long on its way, with a right stamp
_TRANSFORMS, _BELIEVED = 3e-3, 0.1  # strain beyond expansion; of the scatter, a stated deviation
# Share of readings this near, of the range, to one of two values; jumps; samples of the briefer.
_SHARE, _NEAR, _TURNS, _BRIEF = 0.98, 0.05, 20, 2.5
_SUSPECT = {"value", "drift", "common", "follows", "apart"}  # of the numbers of a finding
# Of readings published alike; times where one more is no chance; rows that a reading waits for its.
_STEADY, _TWO_CLOCKS, _ONE_ROW = 0.95, 5, 1.1
_NONE: IntArray = np.zeros(0, dtype=np.int64)
# A gap: s, usual steps; readings beside it; how far a ramp may miss a step, levels be apart.
_GAP, _GAP_STEPS, _FEW, _RAMP, _LEVEL = 2.0, 10.0, 8, 0.2, 0.03


@dataclass(frozen=True)
class Prepared:
    """Records as a model can be held to them."""

    records: list[Record]  # put right
    remarks: list[str]  # what that was, line by line
    doubted: set[str]  # quantities under suspicion
    follows: list[Finding]  # of readings that do not follow the drive


def prepare(records: Sequence[Record], parameters: Parameters,
            quantities: Collection[str]) -> Prepared:
    """Records mended and as their sensors are calibrated; `quantities` are to be compared."""
    kind, pairs = load_kind(parameters), [mended(record, parameters) for record in records]
    whole = [as_calibrated(record, parameters) for record, _ in pairs]
    known = [(record, finding) for record, found in pairs for finding in found]
    known += [(r, f) for r in whole for f in r.findings if "repeated" in f.numbers]
    doubts = [(r, f) for r in whole for f in under_suspicion(r)
              if _compared(f.subject) in ("voltage", "range", *quantities)]  # fmt: skip
    follows = [(r, f) for r in whole for f in check_response(r)
               if f.subject != "elongation" or kind != "displacement"]  # fmt: skip
    kept, less = [], list[tuple[Record, Finding]]()
    for record in whole:
        sound, found = comparable(record, [f for r, f in follows if r is record])
        sound, unseen = without_unseen_drive(sound)
        less += [(record, finding) for finding in (*found, *unseen)]
        # The weight is the model's; a load cell holds it as it is.
        kept.append(_kept(sound, ["force"] if kind == "force" else []))
    remarked = (*known, *doubts, *follows, *less)
    remarks = [f"{record.path.name}: {f.subject}: {f.text}" for record, f in remarked]
    doubted = {_compared(finding.subject) for _, finding in doubts}
    about = [replace(f, subject=f"{record.path}, {f.subject}") for record, f in follows]
    return Prepared(kept, remarks, doubted, about)


def _kept(record: Record, without: Collection[str]) -> Record:
    return replace(record, signals={n: s for n, s in record.signals.items() if n not in without})


def _compared(name: str) -> str:
    kind = kind_of(name)
    return "deflection" if kind == "elongation" else kind


def comparable(record: Record, findings: Iterable[Finding]) -> tuple[Record, list[Finding]]:
    """The record without temperatures of another wire, by the `findings` on it, and readings at the
    end of a sensor's range; what was left out."""
    kept, left_out = dict(record.signals), []
    others = {f.subject for f in findings if "follows" in f.numbers}
    ended = (*check.DROPS_OUT, "elongation", "force", "current")
    for name, signal in record.signals.items():
        values, which = signal.values, np.arange(len(signal) if name in others else 0)
        if kind_of(name) in ended and len(values) and np.ptp(values) > 0.0:
            for extreme in (float(values.max()), float(values.min())):
                which = np.union1d(which, check.clipped_samples(record, signal, extreme))
        if len(which):
            kept[name] = _without(signal, which.astype(np.intp))
            left_out.append(said("not_compared", name, count=len(which)))
    return _kept(replace(record, signals=kept), others), left_out


def without_unseen_drive(record: Record) -> tuple[Record, list[Finding]]:
    """The record's longest stretch without a gap of all its signals over which a voltage went
    elsewhere, neither held nor on a ramp."""
    times = np.unique(np.concatenate([[], *(s.time for s in record.signals.values())]))
    steps = np.diff(times)
    if not len(steps):
        return record, []
    least = max(_GAP, _GAP_STEPS * float(np.quantile(steps, 0.95)))
    edges, found = [times[0]], list[Finding]()
    for k in np.flatnonzero(steps > least).tolist():
        names = [n for n in record.signals if n.endswith(".voltage")]
        changed = [n for n in names if _went_elsewhere(record[n], times[k], steps[k])]
        if changed:
            edges += [times[k], times[k + 1]]
            facts = {"gap": float(steps[k]), "at": float(times[k] - times[0])}
            found.append(said("unseen", ", ".join(changed), **facts))
    if not found:
        return record, []
    begins, ends = np.array(edges[::2]), np.array([*edges[1::2], times[-1]])
    longest = int(np.argmax(ends - begins))
    low, high = float(begins[longest]), float(ends[longest])
    kept = {name: _without(s, np.flatnonzero((s.time < low) | (s.time > high)))
            for name, s in record.signals.items()}
    facts = {"begin": low - float(times[0]), "end": high - float(times[0])}
    return replace(record, signals=kept), [*found, said("one_stretch", "record", **facts)]


def _went_elsewhere(voltage: Signal, begin: float, gap: float) -> bool:
    """Whether a voltage goes on after a gap at a level to which no ramp led."""
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
    """Where readings are those before, published again at a fixed rate, not of few digits only, and
    when the others were made, where a steady clock of their own tells it."""
    values = signal.values
    if values.ndim != 1 or len(values) < FEWEST:
        return _NONE, None
    new = np.flatnonzero(np.diff(values) != 0.0) + 1
    times = np.diff(new)
    if len(times) < FEWEST or (usual := int(np.quantile(times, 0.1, method="lower"))) <= 1:
        return _NONE, None
    # Each is first seen within a row of when it was made; a sensor may read the same twice.
    period = np.mean(times[times <= usual + 1])
    count = np.append(0.0, np.cumsum(np.rint(times / period)))
    slope, start = np.polyfit(count, signal.time[new], 1)
    late = signal.time[new] - start - slope * count
    if np.ptp(late) <= _ONE_ROW * np.quantile(np.diff(signal.time), 0.95):
        number = np.floor((signal.time - start - late.min()) / slope + 1e-6)
        again = np.flatnonzero(np.diff(number) == 0.0) + 1
        return again, start + late.min() + slope * np.delete(number, again)
    # Whole multiples of the usual; of two clocks now and then one more.
    off = np.abs(times - usual * np.rint(times / usual)) > (usual >= _TWO_CLOCKS)
    if np.mean(~off) <= _STEADY:
        return _NONE, None
    # A stretch of one value is so many readings, the first of which come in even parts of it.
    begins = np.append(0, new)
    length = np.diff(np.append(begins, len(values)))
    stretch = np.repeat(np.arange(len(begins)), length)
    count, place = np.maximum(np.rint(length / usual), 1)[stretch], np.arange(len(values))
    part = (place - begins[stretch]) * count // length[stretch]
    return np.flatnonzero((np.diff(part) == 0.0) & (np.diff(stretch) == 0)) + 1, None


def mended(record: Record, parameters: Parameters | None = None) -> tuple[Record, list[Finding]]:
    """The record without what is known to be wrong of it, and what that was: clocks off the
    drive's, currents against their voltage, with `parameters` motions against the heat, readings
    far off or published again, and deviations far below a reading's scatter."""
    is_imposed = parameters is not None and load_kind(parameters) == "displacement"
    imposed = "elongation" if is_imposed else ""
    moved, found = dict[str, Signal](), list[Finding]()
    for name, signal in record.signals.items():
        if name.endswith(".current") and (share := check.against_voltage(record, signal)):
            moved[name] = signal = replace(signal, values=-signal.values)
            found.append(said("turned", name, share=share))
        held, unit = name == imposed or kind_of(name).startswith("voltage"), signal.unit
        again, stamps = _published_again(signal) if not held else (_NONE, None)
        if len(again):
            times = len(signal) / (len(signal) - len(again))
            signal = _without(signal, again)
            moved[name] = signal = signal if stamps is None else replace(signal, time=stamps)
            found.append(said("again", name, times=times))
        if len(off := check.outliers(signal)):
            values = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            moved[name] = signal = _without(signal, off)
            found.append(said("left_out", name, outliers=len(off), values=values, unit=unit))
        if signal.std is None or len(signal) < FEWEST:
            continue
        stated = float(np.median(signal.std))
        scatter = float(np.median(np.abs(np.diff(signal.values, 2)))) / 0.6745 / np.sqrt(6.0)
        if 0.0 < stated < _BELIEVED * scatter:
            moved[name] = replace(signal, std=None)
            found.append(said("understated", name, stated=stated, scatter=scatter, unit=unit))
    delays = check.delays_of(record)
    drive = next((n for n in delays if n.endswith(".voltage")), None)
    for name, (delay, growth) in delays.items() if drive else ():
        late = delay - delays[str(drive)][0]
        if not -check.CLOCK_TOLERANCE <= late <= _MOVED and abs(growth) < check.DRIFT_TOLERANCE:
            own = moved.get(name, record.signals[name])
            moved[name] = replace(own, time=own.time + late)
            found.append(said("clock_moved", name, offset=late, drive=drive))
    record = replace(record, signals=record.signals | moved)
    if parameters is None:
        return record, found
    # A wire that stays below A_s grows as everything does that is heated.
    turned, reach = dict(record.signals), _TRANSFORMS * wire_length(parameters)
    for against in check_response(record):
        name = against.subject
        if "together" not in against.numbers or name == imposed:
            continue
        moves = against.numbers["together"] * np.ptp(np.quantile(record[name].values, [0.01, 0.99]))
        if name != "elongation" or moves > reach:
            turned[name] = replace(turned[name], values=-turned[name].values)
            found.append(said("turned_tip", name, together=against.numbers["together"]))
    return replace(record, signals=turned), found


def _without(signal: Signal, which: IntArray) -> Signal:
    held = {field: getattr(signal, field) for field in ("time", "values", "received", "std")}
    left: dict[str, Any] = {f: np.delete(v, which) for f, v in held.items() if v is not None}
    return replace(signal, **left)


def under_suspicion(record: Record) -> Iterator[Finding]:
    """What speaks against readings, by signal: clipped, of two values, on a clock that is off."""
    by_topic = {s.topic: n for n, s in record.signals.items() if s.topic}
    for finding in check.check_record(record):
        if finding.severity != "info" and _SUSPECT & set(finding.numbers):
            name = by_topic.get(finding.subject, finding.subject)
            if name in record.signals:
                yield replace(finding, subject=name)
    # Readings that jump between two values; a drive switched on purpose holds its level for long.
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
            yield said("two_valued", name, turns=len(turns), levels=2.0)
