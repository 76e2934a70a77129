"""Serialised messages of one topic to stamped columns of numbers, and what a record's drive was."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.border import Budget
from sma_bench.errors import InputError
from sma_bench.findings import Finding, Severity
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import as_recorded
from sma_bench.records import cdr, contract
from sma_bench.records.record import FloatArray, IntArray, Record, has_samples
from sma_bench.records.storage import ZSTD_MAGIC, RawTopic, decompress_messages

# A clock that shows less than a day since 1970 is a simulation's.
_DAY_NS = 86_400 * 10**9
_TEXT_BYTES = 400  # of a marker, from its message to what `describe` says of it
_LOOK_AT = 10  # messages, to see whether they are compressed one by one

JOINT_SIGNALS: dict[str, dict[str, str]] = {
    "tip": {"deflection": "position"},
    "wire": {"elongation": "position", "force": "effort"},
}
_NUMBERS = {
    contract.BATTERY_STATE: ("voltage", "current"),
    contract.TEMPERATURE: ("temperature", "variance"),
    contract.RANGE: ("range", "min_range", "max_range"),
}


@dataclass
class Samples:
    """Decoded messages of one topic, in the order of the bag until sorted.

    Attributes:
        stamp: (n,) ns, header.stamp; the receive time for header-less types.
        received: (n,) ns.
        columns: field -> (n,) or (n, k), NaN where not measured.
        texts: (n,) strings of a String topic.
        is_stamped: whether the stamps are not the receive times.
    """

    topic: str
    type: str
    stamp: IntArray
    received: IntArray
    columns: dict[str, FloatArray] = field(default_factory=dict)
    texts: NDArray[np.object_] | None = None
    findings: list[Finding] = field(default_factory=list)
    is_stamped: bool = True

    def keep(self, rows: NDArray[np.bool_] | IntArray) -> None:
        """Reduce to, or reorder by, the given rows."""
        self.stamp, self.received = self.stamp[rows], self.received[rows]
        self.columns = {name: values[rows] for name, values in self.columns.items()}
        if self.texts is not None:
            self.texts = self.texts[rows]

    def remark(self, severity: Severity, text: str, **numbers: float) -> None:
        """Add a finding about this topic."""
        self.findings.append(Finding(severity, self.topic, text, dict(numbers)))


def read_samples(raw: RawTopic, budget: Budget) -> Samples:
    """Decode all messages of one topic; those that cannot be are counted in a finding.

    Raises:
        OverBudget: they ask for more than such a topic may.
    """
    n, begin = len(raw.times), 0
    for length in raw.lengths[:_LOOK_AT]:
        if raw.data.startswith(ZSTD_MAGIC, begin):
            decompress_messages(raw, budget)
            break
        begin += length
    received = np.array(raw.times, dtype=np.int64)
    samples = Samples(raw.name, raw.type, received.copy(), received)
    samples.is_stamped = raw.type not in contract.HEADERLESS
    lengths = np.array(raw.lengths, dtype=np.int64)
    batches = list(cdr.decode(raw.data, lengths, raw.type, budget))
    _take_columns(samples, batches, budget)

    # What was decoded, has a possible stamp, and is whole where it is a command.
    valid = np.zeros(n, dtype=bool)
    for batch in batches:
        valid[batch.rows] = True
        if raw.type not in contract.HEADERLESS:
            seconds, nanoseconds = (
                batch.columns[f"stamp.{part}"][:, 0].astype(np.int64) for part in ("sec", "nanosec")
            )
            samples.stamp[batch.rows] = seconds * 10**9 + nanoseconds
            valid[batch.rows] = (nanoseconds < 10**9) & (seconds >= 0)
    _drop(samples, valid, "cannot be decoded and are left out")
    if raw.type not in contract.HEADERLESS:
        _mend_stamps(samples)
    for values in samples.columns.values() if raw.type in contract.HEADERLESS else ():
        unusable = np.count_nonzero(~np.isfinite(values), axis=1)
        _drop(samples, unusable == 0, "have the wrong length, NaN or Inf; left out")
    return samples


def _take_columns(samples: Samples, batches: list[cdr.Batch], budget: Budget) -> None:
    """The numbers or texts of a topic's messages, NaN or empty where one has none."""
    n = len(samples.stamp)

    def column(name: str, joint: str = "") -> FloatArray:
        budget.take(8 * n)
        values = np.full(n, np.nan)
        for batch in batches:
            names, found = batch.texts["name"] if joint else ("",), batch.columns[name]
            if joint in names and names.index(joint) < found.shape[1]:
                with np.errstate(invalid="ignore"):  # a NaN of another kind than Python's
                    values[batch.rows] = found[:, names.index(joint)]
        return values

    if samples.type == contract.STRING:
        budget.take(_TEXT_BYTES * n)
        samples.texts = np.full(n, "", dtype=object)
        for batch in batches:
            samples.texts[batch.rows] = batch.texts["data"][0]
    elif samples.type == contract.MULTI_ARRAY:
        # Rows of the most common length; the others stay NaN.
        rows: dict[int, int] = {}
        for batch in batches:
            width = batch.columns["data"].shape[1]
            rows[width] = rows.get(width, 0) + len(batch.rows)
        width = max(rows, key=lambda w: (w > 0, rows[w]), default=0)
        budget.take(8 * n * max(width, 1))
        values = np.full((n, max(width, 1)), np.nan)
        for batch in batches:
            if batch.columns["data"].shape[1] == width > 0:
                values[batch.rows] = batch.columns["data"]
        samples.columns["data"] = values
    elif samples.type == contract.JOINT_STATE:
        # Joints by name: their order may change from one message to the next.
        for joint, fields in JOINT_SIGNALS.items():
            if any(joint in batch.texts["name"] for batch in batches):
                for signal, source in fields.items():
                    samples.columns[signal] = column(source, joint)
    else:
        for name in _NUMBERS[samples.type]:
            samples.columns[name] = column(name)


def _mend_stamps(samples: Samples) -> None:
    """Deal with messages whose header was never stamped."""
    unset = (samples.stamp == 0) & (samples.received > _DAY_NS)
    count = int(np.count_nonzero(unset))
    if not count:
        return
    if count == len(unset):
        text = "header.stamp is never set; the receive time is used in its place"
        samples.remark("warning", text, messages=count)
        samples.stamp, samples.is_stamped = samples.received.copy(), False
    elif np.median(samples.stamp) > _DAY_NS:
        _drop(samples, ~unset, "have no header.stamp and are left out")


def _drop(samples: Samples, keep: NDArray[np.bool_], what: str) -> None:
    dropped = int(np.count_nonzero(~keep))
    if dropped:
        text = f"{dropped} of {len(keep)} messages {what}"
        samples.remark("warning", text, messages=dropped)
        samples.keep(keep)


def sort_by_stamp(samples: Samples) -> None:
    """Put the messages in order of their stamps, each stamp once, and say what was wrong."""
    backward = int(np.count_nonzero(np.diff(samples.stamp) < 0))
    if backward:
        text = f"{backward} stamps lie before the stamp received earlier; sorted"
        samples.remark("warning", text, backward=backward)
        samples.keep(np.argsort(samples.stamp, kind="stable"))
    repeated = np.diff(samples.stamp) == 0
    if samples.texts is None and repeated.any():
        count = int(np.count_nonzero(repeated))
        text = f"{count} messages repeat the stamp of another; the first one received is kept"
        samples.remark("warning", text, duplicates=count)
        samples.keep(np.concatenate(([True], ~repeated)))


def require_channels(record: Record, channels: Sequence[str], driven: Sequence[str]) -> None:
    """The bench of the parameters must be that of the record.

    Args:
        channels: of the parameters; driven: those of the record that have voltages.

    Raises:
        InputError: one is missing; the line says which rig either is of.
    """
    missing = [channel for channel in channels if channel not in driven]
    if not missing:
        return
    line = (
        f"{record.path}: no voltage of channel {missing[0]}: the parameters are of a bench of "
        f"{_wires(channels)}, the record of one of {_wires(driven)}"
    )
    fitting = {1: "wire", 4: "composite"}.get(len(driven))
    if fitting and len(driven) != len(channels):
        line += f"; expected parameters as those of config/{fitting}_rig.yaml"
    raise InputError(line)


def _wires(channels: Sequence[str]) -> str:
    names = ", ".join(channels) or "none"
    return f"{len(channels)} channel{'s' * (len(channels) != 1)} ({names})"


# --- The voltages that a bench applied, on one clock: what a simulation takes as its input.

def drive_of(
    record: Record, parameters: Parameters
) -> tuple[Parameters, FloatArray, FloatArray]:
    """The bench as a record shows it, time (n,) s and volts (n, w) that drive it: of a current
    source whose current alone was measured the command that stands for it.

    Raises:
        InputError: the record lacks what drives a channel.
    """
    record, ohms = with_commands(record, parameters)
    bench = parameters if ohms else as_recorded(parameters)
    return bench, *held_voltages(record, parameters["bench.channels"])


def with_commands(record: Record, parameters: Parameters) -> tuple[Record, float]:
    """The record as it is and 0, or with commands in place of a current source's currents where
    nobody measured voltages, and their volts for an ampere."""
    driven = [c for c in record.channels if has_samples(record, f"{c}.voltage")]
    if driven or parameters["bench.drive"] != "current":
        return record, 0.0
    signals, ohms = dict(record.signals), ohms_of_source(parameters)
    for name in [f"{c}.current" for c in record.channels if f"{c}.current" in signals]:
        own, volts = signals.pop(name), name.replace(".current", ".voltage")
        signals[volts] = replace(own, name=volts, unit="V", values=ohms * own.values)
    return replace(record, signals=signals), ohms


def ohms_of_source(parameters: Parameters) -> float:
    """Volts that stand for an ampere in commands to a current source."""
    return float(parameters["wire.resistance"]) / float(parameters["wire.count"])


def held_voltages(record: Record, channels: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Measured voltages of all channels, each held until its next sample.

    Args:
        record: with `<channel>.voltage` of every channel.
        channels: in the order of bench.channels.

    Returns:
        time (n,) s, the union of the channels' stamps, and voltage (n, w) V.

    Raises:
        InputError: the record lacks the voltage of a channel.
    """
    driven = [c for c in record.channels if f"{c}.voltage" in record.signals]
    require_channels(record, channels, driven)
    signals = [record[f"{channel}.voltage"] for channel in channels]
    time = np.unique(np.concatenate([signal.time for signal in signals]))
    held = [
        signal.values[np.maximum(np.searchsorted(signal.time, time, side="right") - 1, 0)]
        for signal in signals
    ]
    return time, np.stack(held, axis=1)
