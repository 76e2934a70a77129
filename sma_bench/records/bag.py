"""Reads a bag into a record."""

from pathlib import Path

import numpy as np

from sma_bench.border import OverBudget, reading_budget
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records import contract
from sma_bench.records.bag_files import find_bag_files, read_files
from sma_bench.records.record import FloatArray, IntArray, Record, Signal, Topic
from sma_bench.records.samples import Samples, read_samples, sort_by_stamp
from sma_bench.records.storage import RawTopics

# Further apart than this, receive times and stamps come from two clocks, not from a slow network.
_TWO_CLOCKS_NS = 10**9
_FEW_STAMPS = 15  # messages in a row, of which fewer than half wrong stamps move no other topic
# A record may pause for a day, and for ten times as long as it was recorded. Beyond, a clock was
# set while it was: nothing says what lies between, and an even grid over it would fill any memory.
_PAUSE_NS, _PAUSES_OF_RECORDED = 86_400 * 10**9, 10
_RECORDED_NS = 10 * 10**9
_GAPS_S = (86_400, 3600, 600, 60, 10)
_MOST_MARKERS = 100_000


def read_record(path: str | Path, namespace: str | None = None) -> Record:
    """Read a rosbag2 folder, or one of its storage files, into named signals.

    Time is `header.stamp`, in s since the first stamp of the record; the receive time only for
    topics without stamps, brought onto the clock of those that have them. Signals hold what was
    measured: NaN is left out, temperatures are in K. Messages are sorted by stamp, and of several
    with one stamp the first is kept. Whatever was lost, left out or put in order is in
    `Record.findings`.

    Args:
        path: folder with metadata.yaml, or an .mcap or .db3 file, zstd-compressed or not.
        namespace: look only at topics below this namespace.

    Raises:
        InputError: no bag, nothing readable in it, two topics for one meaning, or a topic of the
            bench with another type than the contract's.
    """
    path = Path(path)
    topics = RawTopics(lambda n, t: contract.inside(n, namespace) and contract.is_decoded(n, t))
    files, promised = find_bag_files(path, topics)
    topics.budget = reading_budget(sum(file.stat().st_size for file in files))
    read_files(files, topics)
    found = list(topics.topics.values())
    if not any(topic.count for topic in found):
        why = "the bag holds no messages (did its recorder die?)"
        for finding in topics.findings[:1]:
            why = f"nothing can be read: {finding.subject}: {finding.text}"
        raise InputError(f"{path}: {why}")

    # The metadata of a finished bag says how many messages there should be.
    for name, count in promised.items():
        missing = count - sum(topic.count for topic in found if topic.name == name)
        if missing > 0:
            text = f"{missing} of {count} messages ({missing / count:.1%}) announced by "
            text += "metadata.yaml cannot be read"
            topics.lost(name, text, missing=missing, announced=count)

    # Topics that carry a meaning of the contract become columns, each on its own stamps.
    counts = {(t.name, t.type): t.count for t in found if contract.inside(t.name, namespace)}
    chosen, remarks = contract.choose_topics(str(path), counts)
    decoded: dict[str, Samples] = {}
    for meaning, name in chosen.items():
        for raw in (raw for raw in found if raw.name == name and raw.wanted):
            try:
                decoded[meaning] = read_samples(raw, topics.budget)
            except OverBudget as error:
                topics.lost(name, f"{error}; this topic is left out")
    findings = [*topics.findings, *remarks]

    # All stamps on one clock, in order.
    decoded = _with_messages(decoded, findings)
    findings += _align_receive_times(decoded)
    for samples in decoded.values():
        sort_by_stamp(samples)
    findings += _leave_out_other_times(decoded)
    decoded = _with_messages(decoded, findings)
    stamped = [s for s in decoded.values() if s.type not in contract.HEADERLESS]
    start = min((int(s.stamp[0]) for s in stamped or decoded.values()), default=0)

    # Columns become signals in SI units.
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

    # What is absent is said; of one name with two types the one that was decoded is shown.
    for raw in found:
        if raw.wanted and not raw.count:
            text = "declared, but without a message; absent"
            findings.append(Finding("info", raw.name, text))
    if not signals and not markers:
        names = ", ".join(sorted(raw.name for raw in found)) or "no topics"
        text = f"no signal of the bench contract; the bag has {names}"
        findings.append(Finding("error", "record", text))
    listed: dict[str, Topic] = {}
    for raw in sorted(found, key=lambda raw: raw.name):
        if raw.name not in listed or raw.wanted:
            listed[raw.name] = Topic(raw.type, raw.count, tuple(made.get(raw.name, ())))
    return Record(path, start, signals, markers, listed, tuple(findings))


def _with_messages(decoded: dict[str, Samples], findings: list[Finding]) -> dict[str, Samples]:
    """Topics that have some left; what was said of the others goes to the findings."""
    for samples in decoded.values():
        if not len(samples.stamp):
            findings += samples.findings
    return {meaning: samples for meaning, samples in decoded.items() if len(samples.stamp)}


def _align_receive_times(decoded: dict[str, Samples]) -> list[Finding]:
    """Bring receive times onto the stamps' clock where the two differ by more than a delay.

    A bench on simulated time, recorded with the wall's clock, has nothing else in common.
    """
    stamped = [s for s in decoded.values() if s.is_stamped]
    if not stamped:
        return []
    reference = max(stamped, key=lambda samples: len(samples.stamp))
    offset = float(np.median(reference.received - reference.stamp))
    if abs(offset) < _TWO_CLOCKS_NS:
        return []
    from scipy.ndimage import median_filter

    order = np.argsort(reference.received, kind="stable")
    received = reference.received[order]
    zero = int(received[0])
    ahead = (received - reference.stamp[order]).astype(np.float64)
    ahead = median_filter(ahead, _FEW_STAMPS, mode="mirror")
    findings = []
    for samples in decoded.values():
        if not samples.is_stamped:
            at = (samples.received - zero).astype(np.float64)
            correction = np.interp(at, (received - zero).astype(np.float64), ahead)
            samples.stamp = samples.received - correction.astype(np.int64)
            text = (
                f"receive times are {offset * 1e-9:.3f} s off the stamps of {reference.topic}; "
                "this topic without stamps was moved onto their clock"
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
    apart = {"before": first - int(whole[0]), "after": int(whole[-1]) - last}
    far = " and ".join(f"up to {ns * 1e-9:.3g} s {way}" for way, ns in apart.items() if ns > 0)
    text = (
        f"{left_out} of {len(whole)} messages are stamped {far} the others (was a clock set "
        "meanwhile?) and are left out"
    )
    return [Finding("warning", "record", text, {"messages": float(left_out)})]


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
