"""Reads a bag into a record."""

from pathlib import Path

import numpy as np

from sma_bench.border import OverBudget, reading_budget
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records import contract
from sma_bench.records.bag_files import find_bag_files, scan_files
from sma_bench.records.harvest import Harvest
from sma_bench.records.record import FloatArray, IntArray, Record, Signal, Topic
from sma_bench.records.samples import Samples, read_samples, sort_by_stamp

# Further apart than this, receive times and stamps come from two clocks, not from a slow network.
_TWO_CLOCKS_NS = 10**9
# A record may pause for a day, and for ten times as long as it was recorded. Beyond, a clock was
# set while it was: nothing says what lies between, and an even grid over it would fill any memory.
_PAUSE_NS, _PAUSES_OF_RECORDED = 86_400 * 10**9, 10
_RECORDED_NS = 10 * 10**9
_GAPS_S = (86_400, 3600, 600, 60, 10)
_MOST_MARKERS = 100_000


def read_record(path: str | Path, namespace: str | None = None) -> Record:
    """Read a rosbag2 folder, or one of its storage files, into named signals.

    Time is `header.stamp`, in s since the first stamp of the record; the receive time only for the
    header-less topics. Signals hold what was measured: NaN is left out, temperatures are in K.
    Messages are sorted by stamp, and of several with one stamp the first is kept. Whatever was
    lost, left out or put in order is in `Record.findings`.

    Args:
        path: folder with metadata.yaml, or an .mcap or .db3 file, zstd-compressed or not.
        namespace: look only at topics below this namespace.

    Raises:
        InputError: no bag, nothing readable in it, two topics for one meaning, or a topic of the
            bench with another type than the contract's.
    """
    path = Path(path)
    harvest = Harvest(lambda n, t: contract.inside(n, namespace) and contract.is_decoded(n, t))
    bag = find_bag_files(path, harvest)
    harvest.budget = reading_budget(sum(file.stat().st_size for file in bag.files))
    scan_files(bag.files, harvest)
    if not harvest.count:
        raise InputError(f"{path}: {_nothing(harvest)}")
    _compare_counts(harvest, bag.promised)
    counts = {
        (topic.name, topic.type): topic.count
        for topic in harvest.topics.values()
        if contract.inside(topic.name, namespace)
    }
    chosen, remarks = contract.choose_topics(str(path), counts)
    decoded = {}
    for meaning, name in chosen.items():
        raw = harvest.topics[name, _type_at(meaning)]
        if raw.wanted:
            try:
                decoded[meaning] = read_samples(raw, harvest.budget)
            except OverBudget as error:
                harvest.lost(name, f"{error}; this topic is left out")
    return _build(path, harvest, decoded, remarks)


def _type_at(meaning: str) -> str:
    place = contract.place_of(meaning)
    assert place is not None
    return place.type


def _nothing(harvest: Harvest) -> str:
    if harvest.findings:
        first = harvest.findings[0]
        return f"nothing can be read: {first.subject}: {first.text}"
    return "the bag holds no messages (did its recorder die?)"


def _compare_counts(harvest: Harvest, promised: dict[str, int]) -> None:
    """The metadata of a finished bag says how many messages there should be."""
    found: dict[str, int] = {}
    for topic in harvest.topics.values():
        found[topic.name] = found.get(topic.name, 0) + topic.count
    for name, count in promised.items():
        if found.get(name, 0) < count:
            missing = count - found.get(name, 0)
            text = f"{missing} of {count} messages ({missing / count:.1%}) announced by "
            text += "metadata.yaml cannot be read"
            harvest.lost(name, text, missing=missing, announced=count)


def _build(
    path: Path, harvest: Harvest, decoded: dict[str, Samples], remarks: list[Finding]
) -> Record:
    findings = [*harvest.findings, *remarks]
    decoded = _with_messages(decoded, findings)
    stamped = [s for s in decoded.values() if s.type not in contract.HEADERLESS]
    findings += _align_headerless(decoded, stamped)
    for samples in decoded.values():
        sort_by_stamp(samples)
    findings += _leave_out_other_times(decoded)
    decoded = _with_messages(decoded, findings)
    stamped = [s for s in decoded.values() if s.type not in contract.HEADERLESS]
    start = min((int(s.stamp[0]) for s in stamped or decoded.values()), default=0)
    signals: dict[str, Signal] = {}
    markers: tuple[tuple[float, str], ...] = ()
    made: dict[str, list[str]] = {}
    for meaning, samples in decoded.items():
        if samples.texts is not None:
            if len(samples.stamp) > _MOST_MARKERS:
                text = f"{len(samples.stamp)} markers, the first {_MOST_MARKERS} are kept"
                samples.remark("warning", text)
                samples.keep(np.arange(_MOST_MARKERS))
            times = _seconds(samples.stamp, start).tolist()
            markers = tuple(zip(times, samples.texts.tolist(), strict=True))
        for signal in _signals(meaning, samples, start):
            signals[signal.name] = signal
            made.setdefault(samples.topic, []).append(signal.name)
        findings += samples.findings
    findings += _absent(harvest, signals, markers)
    topics: dict[str, Topic] = {}
    for raw in sorted(harvest.topics.values(), key=lambda raw: raw.name):
        # One name with two types: the one that was decoded is shown.
        if raw.name not in topics or raw.wanted:
            topics[raw.name] = Topic(raw.type, raw.count, tuple(made.get(raw.name, ())))
    return Record(path, start, signals, markers, topics, tuple(findings))


def _with_messages(decoded: dict[str, Samples], findings: list[Finding]) -> dict[str, Samples]:
    """Topics that have some left; what was said of the others goes to the findings."""
    for samples in decoded.values():
        if not len(samples.stamp):
            findings += samples.findings
    return {meaning: samples for meaning, samples in decoded.items() if len(samples.stamp)}


def _absent(
    harvest: Harvest, signals: dict[str, Signal], markers: tuple[tuple[float, str], ...]
) -> list[Finding]:
    findings = [
        Finding("info", topic.name, "declared, but without a message; absent")
        for topic in harvest.topics.values()
        if topic.wanted and not topic.count
    ]
    if not signals and not markers:
        names = ", ".join(sorted(topic.name for topic in harvest.topics.values())) or "no topics"
        text = f"no signal of the bench contract; the bag has {names}"
        findings.append(Finding("error", "record", text))
    return findings


def _align_headerless(decoded: dict[str, Samples], stamped: list[Samples]) -> list[Finding]:
    """Bring receive times onto the stamps' clock where the two differ by more than a delay.

    A bench on simulated time, recorded with the wall's clock, has nothing else in common.
    """
    if not stamped:
        return []
    reference = max(stamped, key=lambda samples: len(samples.stamp))
    offset = float(np.median(reference.received - reference.stamp))
    if abs(offset) < _TWO_CLOCKS_NS:
        return []
    order = np.argsort(reference.received, kind="stable")
    received = reference.received[order]
    zero = int(received[0])
    ahead = (received - reference.stamp[order]).astype(np.float64)
    findings = []
    for samples in decoded.values():
        if samples.type in contract.HEADERLESS:
            at = (samples.received - zero).astype(np.float64)
            correction = np.interp(at, (received - zero).astype(np.float64), ahead)
            samples.stamp = samples.received - correction.astype(np.int64)
            text = (
                f"receive times are {offset * 1e-9:.3f} s off the stamps of {reference.topic}; "
                "this header-less topic was moved onto their clock"
            )
            findings.append(Finding("warning", samples.topic, text, {"offset": offset * 1e-9}))
    return findings


def _leave_out_other_times(decoded: dict[str, Samples]) -> list[Finding]:
    """Keep the stretch with most stamps where a clock was set in the middle of the record."""
    ends = [end for s in decoded.values() for end in (int(s.stamp.min()), int(s.stamp.max()))]
    if not ends or max(ends) - min(ends) <= _PAUSE_NS:
        return []  # without sorting the stamps of all topics into one another
    stamps = np.sort(np.concatenate([np.empty(0, np.int64), *(s.stamp for s in decoded.values())]))
    whole = stamps
    for gap in _GAPS_S:
        steps = np.diff(stamps)
        recorded = int(steps[steps <= _RECORDED_NS].sum())
        if steps.sum() <= _PAUSE_NS + _PAUSES_OF_RECORDED * recorded:
            break
        stretches = np.split(stamps, np.flatnonzero(steps > gap * 10**9) + 1)
        stamps = max(stretches, key=len)
    if len(stamps) == len(whole):
        return []
    first, last = int(stamps[0]), int(stamps[-1])
    for samples in decoded.values():
        samples.keep((samples.stamp >= first) & (samples.stamp <= last))
    left_out = len(whole) - len(stamps)
    text = (
        f"{left_out} of {len(whole)} messages are stamped {_apart(whole, first, last)} the others "
        "(was a clock set meanwhile?) and are left out"
    )
    return [Finding("warning", "record", text, {"messages": float(left_out)})]


def _apart(stamps: IntArray, first: int, last: int) -> str:
    before, after = (first - int(stamps[0])) * 1e-9, (int(stamps[-1]) - last) * 1e-9
    said = [f"up to {t:.3g} s {way}" for t, way in ((before, "before"), (after, "after")) if t > 0]
    return " and ".join(said)


def _seconds(nanoseconds: IntArray, start: int) -> FloatArray:
    return (nanoseconds - start).astype(np.float64) / 1e9


def _signals(meaning: str, samples: Samples, start: int) -> list[Signal]:
    """The signals of one topic; what was never measured is only remarked upon."""
    place, _, kind = meaning.rpartition("/")
    if kind == "joint_states":
        named = [(n, contract.JOINT_UNITS[n], values) for n, values in samples.columns.items()]
        if not named:
            samples.remark("warning", "no joint is called tip or wire; absent")
    elif kind == "voltage_command":
        named = [(kind, "V", samples.columns["data"])]
    else:
        named = [
            (f"{place}.{n}", contract.FIELD_UNITS[n], values)
            for n, values in samples.columns.items()
            if n in contract.FIELD_UNITS
        ]
    if kind == "temperature":
        named = [(n, unit, values + contract.CELSIUS_ZERO) for n, unit, values in named]
    if kind == "range":
        _remark_on_ranges(samples)
    taken = (_measured(name, unit, values, samples, start) for name, unit, values in named)
    return [signal for signal in taken if signal is not None]


def _measured(
    name: str, unit: str, values: FloatArray, samples: Samples, start: int
) -> Signal | None:
    missing = np.isnan(values if values.ndim == 1 else values[:, 0])
    count = int(np.count_nonzero(missing))
    if count == len(values):
        samples.remark("info", f"{name} is NaN throughout, that is not measured; absent")
        return None
    if count:
        text = f"{name} is NaN in {count} of {len(values)} messages; these are left out"
        samples.remark("info", text, nan=count)
    keep = ~missing if count else slice(None)
    time, received = _seconds(samples.stamp, start), _seconds(samples.received, start)
    stated = samples.columns.get("variance", np.zeros(0))
    std = np.sqrt(np.maximum(stated[keep], 0.0)) if np.nanmax(stated, initial=0.0) > 0.0 else None
    return Signal(name, unit, time[keep], values[keep], received[keep], samples.topic, std)


def _remark_on_ranges(samples: Samples) -> None:
    """REP-117: -Inf is too close, +Inf too far; both are kept, being what the sensor said."""
    values = samples.columns["range"]
    outside = {
        "-Inf (too close)": np.isneginf(values),
        "+Inf (no target)": np.isposinf(values),
        "outside min_range..max_range": np.isfinite(values)
        & ((values < samples.columns["min_range"]) | (values > samples.columns["max_range"])),
    }
    for what, rows in outside.items():
        count = int(np.count_nonzero(rows))
        if count:
            text = f"{count} of {len(values)} distances are {what}; kept"
            samples.remark("warning", text, count=count)
