"""Reads a bag into a record: its topics decoded, on one clock, in SI units."""

import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array, IntArray, Mask
from sma_bench.border import Budget, OverBudget
from sma_bench.records import contract
from sma_bench.records.record import Record, Signal, Topic
from sma_bench.records.storage import RawTopic, RawTopics, decompress_messages, read_storage

_DAY_NS = 86_400 * 10**9  # smaller stamps are of a simulation, which counts from 0
_TWO_CLOCKS_NS = 10**9  # a larger median of receive time minus stamp means two clocks
_MEDIAN_OF = 15  # messages: up to 7 wrong stamps in a row do not move the topics without stamps
# Stamps may span a day plus ten times the recorded time (the steps of at most 10 s, or twice the
# usual one). If they span more, a clock was set meanwhile: split at gaps, long ones first, and keep
# the largest part.
_PAUSES_OF_RECORDED, _RECORDED_NS, _GAPS_S = 10, 10 * 10**9, (86_400, 3600, 600, 60, 10)
_MARKER_BYTES, _MOST_MARKERS = 400, 100_000  # memory of a marker and its objects; markers
# By message type: (column, message field, joint) of each column.
_PLAIN = {contract.BATTERY_STATE: "voltage current", contract.TEMPERATURE: "temperature variance",
          contract.RANGE: "range min_range max_range"}
_COLUMNS = {kind: [(name, name, "") for name in names.split()] for kind, names in _PLAIN.items()}
Fields = tuple[tuple[str, Any], ...]
ColumnValues = Iterable[tuple[str, NDArray[Any]]]  # names and values of messages, (n,) or (n, k)
_COLUMNS[contract.JOINT_STATE] = [(signal, source, joint)
                                  for joint, fields in contract.JOINT_SIGNALS.items()
                                  for signal, source in fields.items()]


@dataclass
class Samples:
    """Decoded messages of one topic."""

    topic: str
    type: str
    stamp: IntArray  # (n,) ns, header.stamp; the receive time for header-less types
    received: IntArray  # (n,) ns
    is_stamped: bool  # False if `stamp` is the receive time
    # (n,) or (n, k) by name, NaN where not measured; strings for a String topic
    columns: dict[str, NDArray[np.generic]] = field(default_factory=dict)

    def take_stamps(self, batch: "Batch") -> Mask:
        """Take the stamps of a batch; which of its messages have a valid one."""
        seconds, nanoseconds = (batch.columns[n][:, 0].astype(np.int64) for n in STAMP)
        self.stamp[batch.rows] = seconds * 10**9 + nanoseconds
        return np.asarray((nanoseconds < 10**9) & (seconds >= 0))

    def keep(self, rows: Mask | IntArray, why: str = "", bag: RawTopics | None = None) -> None:
        """Keep some messages; a mask and `why` add a remark to the bag if some are dropped."""
        if bag and (dropped := int(np.count_nonzero(~rows))):
            text = f"{dropped} of {len(rows)} messages {why}"
            bag.remark(self.topic, text, messages=dropped)
        self.stamp, self.received = self.stamp[rows], self.received[rows]
        self.columns = {name: values[rows] for name, values in self.columns.items()}


def read_record(path: str | Path, namespace: str | None = None) -> Record:
    """Read a rosbag2 folder (or .mcap or .db3 file, zstd-compressed or not) into named signals in
    SI units, from topics below `namespace`. Time is `header.stamp`, in s since the first stamp of
    the record; for topics without stamps, the receive time shifted onto that clock. `findings`
    lists what was lost or reordered. Raises InputError: nothing readable, two topics for one
    meaning, or a topic of the bench that has the wrong type."""
    path, inside = Path(path), contract.inside
    bag = read_storage(path, lambda n, t: inside(n, namespace) and contract.is_decoded(n, t))
    found = list(bag.topics.values())
    counts = {(t.name, t.type): t.count for t in found if inside(t.name, namespace)}
    chosen, remarks = contract.choose_topics(str(path), counts)
    bag.findings += remarks
    decoded: dict[str, Samples] = {}
    for meaning, name in chosen.items():
        for raw in (raw for raw in found if raw.name == name and raw.wanted):
            try:
                decoded[meaning] = _decode(raw, bag)
            except OverBudget as error:
                bag.remark(name, f"{error}; this topic is left out")
    put_on_one_clock(list(decoded.values()), bag)
    decoded = {meaning: samples for meaning, samples in decoded.items() if len(samples.stamp)}
    stamped = [s for s in decoded.values() if s.type not in contract.HEADERLESS]
    start = min((int(s.stamp[0]) for s in stamped or decoded.values()), default=0)
    signals, made = dict[str, Signal](), dict[str, list[str]]()
    markers: tuple[tuple[float, str], ...] = ()
    for meaning, samples in decoded.items():
        if samples.type == contract.STRING:
            times, texts = ((samples.stamp - start) / 1e9).tolist(), samples.columns["data"]
            markers = tuple(zip(times, texts.tolist(), strict=True))[:_MOST_MARKERS]
            if len(texts) > len(markers):
                bag.remark(samples.topic, f"{len(texts)} markers, only {_MOST_MARKERS} are kept")
            continue
        for signal in _signals(meaning, samples, start, bag):
            signals[signal.name] = signal
            made.setdefault(samples.topic, []).append(signal.name)
    # Of two topics with one name but two types, the decoded one is listed.
    listed: dict[str, Topic] = {}
    for raw in sorted(found, key=lambda raw: raw.name):
        if raw.wanted and not raw.count:
            bag.remark(raw.name, "declared, but has no messages", "info")
        if raw.name not in listed or raw.wanted:
            listed[raw.name] = Topic(raw.type, raw.count, tuple(made.get(raw.name, ())))
    if not signals and not markers:
        names = ", ".join(listed) or "no topics"
        bag.remark("record", f"no signal of the bench contract; the bag has {names}; sma-bench "
                   "import makes a record of topics of another bench", "error")
    return Record(path, start, signals, markers, listed, tuple(bag.findings))


def _decode(raw: RawTopic, bag: RawTopics) -> Samples:
    """The messages of a topic of the contract."""
    twice, n = Counter[str](), raw.count

    def columns_of(batch: Batch) -> ColumnValues:
        found, joints = batch.columns, batch.texts.get("name", ("",))
        if raw.type == contract.STRING:
            yield "data", np.full(len(batch.rows), batch.texts["data"][0], dtype=object)
        elif raw.type == contract.MULTI_ARRAY and found["data"].size:
            yield "data", found["data"]
        twice.update({joint: len(batch.rows) for joint in joints if joints.count(joint) > 1})
        for name, source, joint in _COLUMNS.get(raw.type, ()):
            if joint in joints:  # their order may differ between messages
                place = joints.index(joint)
                wide = np.pad(found[source], ((0, 0), (0, place + 1)), constant_values=np.nan)
                yield name, wide[:, place]

    samples = samples_of(raw, bag, FIELDS[raw.type], columns_of)
    for joint in contract.JOINT_SIGNALS:
        if count := twice[joint]:
            text = f"{count} of {n} messages name joint {joint} twice; the first one is used"
            bag.remark(raw.name, text, messages=count)
    if raw.type == contract.MULTI_ARRAY:
        values = samples.columns.setdefault("data", np.full((len(samples.stamp), 1), np.nan))
        unusable = np.count_nonzero(~np.isfinite(values), axis=1)
        samples.keep(unusable == 0, "have the wrong length, NaN or Inf; left out", bag)
    return samples


def samples_of(raw: RawTopic, bag: RawTopics, fields: Fields,
               columns_of: Callable[["Batch"], ColumnValues]) -> Samples:
    """The messages of a topic, decoded into columns. Raises OverBudget."""
    decompress_messages(raw, bag.budget)
    received, lengths = (np.array(v, dtype=np.int64) for v in (raw.times, raw.lengths))
    n, is_stamped = len(received), STAMP[0] in dict(fields)
    samples = Samples(raw.name, raw.type, received.copy(), received, is_stamped)
    columns, valid = samples.columns, np.zeros(n, dtype=bool)
    # The most common length but 0 of an array decides the width of its column.
    batches = decode(raw.data, lengths, fields, bag.budget, raw.is_packed)
    for batch in sorted(batches, key=lambda b: len(b.rows), reverse=True):
        valid[batch.rows] = samples.take_stamps(batch) if is_stamped else True
        for name, values in columns_of(batch):
            if name not in columns:
                is_text = values.dtype == object
                bag.budget.take(n * (_MARKER_BYTES if is_text else 8 * values[0].size))
                columns[name] = np.full((n, *values.shape[1:]), "" if is_text else np.nan,
                                        dtype=object if is_text else None)
            if values.shape[1:] == columns[name].shape[1:]:
                with np.errstate(invalid="ignore"):  # signalling NaNs
                    columns[name][batch.rows] = values
    samples.keep(valid, "cannot be decoded and are left out", bag)
    return samples


def put_on_one_clock(decoded: list[Samples], bag: RawTopics) -> None:
    """Receive times instead of stamps that are not set, and topics without stamps on the clock of
    the others; sorted, without repeated stamps and those of another day."""
    for samples in decoded:
        unset = samples.is_stamped & (samples.stamp == 0) & (samples.received > _DAY_NS)
        if len(unset) and unset.all():
            text = "header.stamp is never set; the receive time is used instead"
            bag.remark(samples.topic, text, messages=len(unset))
            samples.stamp, samples.is_stamped = samples.received.copy(), False
        elif unset.any() and np.median(samples.stamp) > _DAY_NS:
            samples.keep(~unset, "have no header.stamp and are left out", bag)
    decoded = [samples for samples in decoded if len(samples.stamp)]
    stamped = [s for s in decoded if s.is_stamped]
    reference = max(stamped, key=lambda s: len(s.stamp), default=None)
    offset = float(np.median(reference.received - reference.stamp)) if reference else 0.0
    if reference and abs(offset) >= _TWO_CLOCKS_NS and len(stamped) < len(decoded):
        from scipy.ndimage import median_filter
        order = np.argsort(reference.received, kind="stable")
        received = reference.received[order]
        zero = int(received[0])
        delay = (received - reference.stamp[order]).astype(np.float64)
        delay = median_filter(delay, _MEDIAN_OF, mode="mirror")
        known = (received - zero).astype(np.float64)
        for samples in (s for s in decoded if not s.is_stamped):
            at = (samples.received - zero).astype(np.float64)
            samples.stamp = samples.received - np.interp(at, known, delay).astype(np.int64)
            off = f"receive times are {offset * 1e-9:.3f} s off the stamps of {reference.topic}"
            text = f"{off}; this topic has no stamps and was moved onto their clock"
            bag.remark(samples.topic, text, offset=offset * 1e-9)
    for samples in decoded:
        if backward := int(np.count_nonzero(np.diff(samples.stamp) < 0)):
            text = f"{backward} stamps are earlier than the one received before them; sorted"
            bag.remark(samples.topic, text, backward=backward)
            samples.keep(np.argsort(samples.stamp, kind="stable"))
        repeated = np.diff(samples.stamp) == 0
        if samples.type != contract.STRING and (count := int(np.count_nonzero(repeated))):
            text = f"{count} messages repeat the stamp of another; the first one received is kept"
            bag.remark(samples.topic, text, duplicates=count)
            samples.keep(np.concatenate(([True], ~repeated)))
    ends = [int(end) for s in decoded for end in (s.stamp[0], s.stamp[-1])]
    if not ends or max(ends) - min(ends) <= _DAY_NS:
        return  # saves sorting the stamps of all topics
    stamps = whole = np.sort(np.concatenate([s.stamp for s in decoded]))
    steps = np.diff(np.unique(stamps))
    recorded = max(_RECORDED_NS, 2 * int(np.quantile(steps, 0.5, method="lower")))
    for gap in _GAPS_S:
        steps = np.diff(stamps)
        if steps.sum() <= _DAY_NS + _PAUSES_OF_RECORDED * steps[steps <= recorded].sum():
            break
        stamps = max(np.split(stamps, np.flatnonzero(steps > gap * 10**9) + 1), key=len)
    if len(stamps) < len(whole):
        first, last = int(stamps[0]), int(stamps[-1])
        for samples in decoded:
            samples.keep((samples.stamp >= first) & (samples.stamp <= last))
        lost, far = len(whole) - len(stamps), max(first - int(whole[0]), int(whole[-1]) - last)
        away = f"up to {far * 1e-9:.3g} s away from the others"
        text = f"{lost} of {len(whole)} messages are stamped {away} (was a clock set "
        bag.remark("record", text + "during recording?) and are left out", messages=lost)


def _signals(meaning: str, samples: Samples, start: int, bag: RawTopics) -> list[Signal]:
    """The signals of one topic; a column that is all NaN becomes no signal but a finding."""
    place, _, kind = meaning.rpartition("/")
    columns: dict[str, Array] = dict(samples.columns)  # type: ignore[arg-type]
    if kind == "joint_states" and not columns:
        bag.remark(samples.topic, "no joint is named tip or wire: no signal from this topic")
    if kind == "range":  # REP-117; all are kept, as the sensor reported them
        found, low, high = (columns[name] for name in ("range", "min_range", "max_range"))
        remarkable = {
            "-Inf (too close)": np.isneginf(found), "+Inf (no target)": np.isposinf(found),
            "outside min_range..max_range": np.isfinite(found) & ((found < low) | (found > high))}
        for what, rows in remarkable.items():
            if count := int(np.count_nonzero(rows)):
                bag.remark(samples.topic, f"{count} of {len(found)} distances are {what}; kept",
                           count=count)
    stated, signals = columns.pop("variance", np.zeros(0)), []
    for column, values in columns.items():
        name = {"joint_states": column, "voltage_command": kind}.get(kind, f"{place}.{column}")
        unit = contract.unit_of(name)
        if unit is None:  # the limits of a range
            continue
        missing = np.isnan(values if values.ndim == 1 else values[:, 0])
        count = int(np.count_nonzero(missing))
        if count == len(values):
            bag.remark(samples.topic, f"{name} is NaN throughout: it was not measured", "info")
            continue
        if count:
            text = f"{name} is NaN in {count} of {len(values)} messages; these are left out"
            bag.remark(samples.topic, text, "info", nan=count)
        keep = ~missing if count else slice(None)
        values = values[keep] + contract.CELSIUS_ZERO if unit == "K" else values[keep]
        time, received = (((ns - start) / 1e9)[keep] for ns in (samples.stamp, samples.received))
        known, std = stated > 0.0, None  # variance 0 means unknown: the median of the others
        if known.any():
            std = np.sqrt(np.where(known, stated, np.median(stated[known])))[keep]
        signals.append(Signal(name, unit, time, values, received, samples.topic, std))
    return signals


# --- Plain CDR in either byte order, decoded by topic: messages of equal length are the rows of a
# matrix of bytes. The first row is parsed; rows with the same counts and texts (guards) as it have
# the same layout, so that their numbers are columns of the matrix.

STAMP = "header.stamp.sec", "header.stamp.nanosec"
_HEADER: Fields = ((STAMP[0], "i4"), (STAMP[1], "u4"), ("header.frame_id", "string"))
# Fields in order, up to the last one used. "x[]" is a sequence; "text" is a string that is read,
# "string" one that is skipped; a tuple is the fields of each element of a sequence of messages.
_DIMENSION: Fields = ("label", "string"), ("size", "u4"), ("stride", "u4")
FIELDS: dict[str, Fields] = {
    contract.TEMPERATURE: (*_HEADER, ("temperature", "f8"), ("variance", "f8")),
    contract.BATTERY_STATE: (*_HEADER, ("voltage", "f4"), ("temperature", "f4"), ("current", "f4")),
    contract.RANGE: (*_HEADER, ("radiation_type", "u1"), ("field_of_view", "f4"),
                     ("min_range", "f4"), ("max_range", "f4"), ("range", "f4")),
    contract.JOINT_STATE: (*_HEADER, ("name", "text[]"), ("position", "f8[]"),
                           ("velocity", "f8[]"), ("effort", "f8[]")),
    contract.MULTI_ARRAY: (("layout.dim", _DIMENSION), ("layout.data_offset", "u4"),
                           ("data", "f8[]")),
    contract.STRING: (("data", "text"),)}
_ENCAPSULATION = 4
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_LAYOUTS_PER_LENGTH = 32
# More than any message of a bench has; texts and dimensions are parsed one by one, which is slow.
_MOST_TEXTS, _MOST_NUMBERS, _LONGEST_TEXT = 256, 1024, 4096  # elements, elements, bytes


class CdrError(Exception):
    """A message that does not follow its type's layout."""


class _Layout(NamedTuple):
    """Where the fields of a message are."""

    columns: dict[str, tuple[int, str, int]]  # offset, numpy type and elements, by field
    texts: dict[str, tuple[str, ...]]
    guards: list[tuple[int, bytes]]  # (offset, bytes) that messages of this layout have in common


class Batch(NamedTuple):
    """Messages decoded together: `columns[field]` is (len(rows), elements)."""

    rows: IntArray
    columns: dict[str, NDArray[np.generic]]
    texts: dict[str, tuple[str, ...]]


def _find_layout(blob: bytes, fields: Fields, is_packed: bool) -> _Layout:
    """Parse one message. Raises CdrError: the bytes do not follow the type."""
    order = "<" if is_packed else _BYTE_ORDERS.get(blob[:2])
    if order is None or len(blob) < _ENCAPSULATION:
        raise CdrError("not plain CDR")
    position = 0 if is_packed else _ENCAPSULATION
    layout = _Layout({}, {}, [] if is_packed else [(0, blob[:2])])

    def step(size: int, count: int = 1) -> int:
        """Skip `count` elements of `size` bytes; the offset of the first."""
        nonlocal position
        if count and not is_packed:  # an empty sequence has no padding behind its count
            position += -(position - _ENCAPSULATION) % size
        start, position = position, position + size * count
        if position > len(blob):
            raise CdrError("the message ends inside a field")
        return start

    def guarded_count(most: int) -> int:
        start = step(4)
        layout.guards.append((start, blob[start:position]))
        (count,) = struct.unpack_from(order + "I", blob, start)
        if count > most:
            raise CdrError(f"{count} elements, expected at most {most}")
        return int(count)

    def parse(fields: Fields, place: str) -> None:
        for name, kind in ((place + name, kind) for name, kind in fields):
            if isinstance(kind, tuple):
                for k in range(guarded_count(_MOST_TEXTS)):
                    parse(kind, f"{name}.{k}.")
                continue
            many, kind = kind.endswith("[]"), kind.removesuffix("[]")
            if kind in ("string", "text"):
                found = []
                for _ in range(guarded_count(_MOST_TEXTS) if many else 1):
                    start = step(1, guarded_count(_LONGEST_TEXT))
                    if kind == "text":
                        content = blob[start:position]
                        layout.guards.append((start, content))
                        found.append(content.rstrip(b"\0").decode(errors="replace"))
                layout.texts[name] = tuple(found)
            else:
                count = guarded_count(_MOST_NUMBERS) if many else 1
                layout.columns[name] = (step(int(kind[1]), count), order + kind, count)

    parse(fields, "")
    return layout


def decode(data: bytes | bytearray, lengths: IntArray, fields: Fields, budget: Budget,
           is_packed: bool = False) -> Iterator[Batch]:
    """Batches of messages, of lengths (n,) bytes, that can be decoded; `is_packed`: as ROS 1 packs
    them. Raises OverBudget."""
    ends = np.cumsum(lengths)
    for length in np.unique(lengths[lengths >= _ENCAPSULATION]).tolist():
        rows = np.flatnonzero(lengths == length)
        content: bytes | bytearray = data
        if len(rows) < len(lengths):
            content = b"".join([data[end - length : end] for end in ends[rows].tolist()])
        matrix = np.frombuffer(content, dtype=np.uint8).reshape(len(rows), length)
        remaining, layouts = np.arange(len(rows)), 0
        while len(remaining):
            budget.check()
            layouts += 1
            try:
                layout = _find_layout(matrix[remaining[0]].tobytes(), fields, is_packed)
            except CdrError:
                remaining = remaining[1:]
                continue
            # After many layouts one message at a time: comparing each with all would take n^2.
            some = remaining if layouts <= _LAYOUTS_PER_LENGTH else remaining[:1]
            alike = np.ones(len(some), dtype=bool)
            for offset, guard in layout.guards:
                found = matrix[some, offset : offset + len(guard)]
                alike &= (found == np.frombuffer(guard, np.uint8)).all(axis=1)
            columns: dict[str, NDArray[np.generic]] = {}
            for name, (offset, kind, count) in layout.columns.items():
                part = matrix[some[alike], offset : offset + count * int(kind[2])]
                columns[name] = np.ascontiguousarray(part).view(kind).reshape(len(part), count)
            yield Batch(rows[some[alike]], columns, layout.texts)
            remaining = remaining[1:] if len(some) == 1 else remaining[~alike]


def encode(template: bytes, msgtype: str, columns: dict[str, Array]) -> list[bytes]:
    """Copies of the message `template` with other numbers, (n,) or (n, elements) by field."""
    layout, n = _find_layout(template, FIELDS[msgtype], False), len(next(iter(columns.values())))
    matrix = np.tile(np.frombuffer(template, dtype=np.uint8), (n, 1))
    for name, values in columns.items():
        offset, kind, count = layout.columns[name]
        if np.size(values) != n * count:
            raise CdrError(f"{name}: {np.size(values)} elements, expected {n} times {count}")
        block = np.ascontiguousarray(np.reshape(values, (n, count)).astype(kind))
        matrix[:, offset : offset + count * int(kind[2])] = block.view(np.uint8).reshape(n, -1)
    length, joined = len(template), matrix.tobytes()
    return [joined[start : start + length] for start in range(0, n * length, length)]
