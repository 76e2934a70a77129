"""Signals to the serialised messages of the contract's topics."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from sma_bench.errors import InputError
from sma_bench.records import cdr, contract
from sma_bench.records.record import FloatArray, IntArray, Signal
from sma_bench.records.samples import JOINT_SIGNALS

TYPES = get_typestore(Stores.ROS2_JAZZY)

_LATEST_STAMP = 2**31  # s after 1970
_NAN = float("nan")


@dataclass
class Stream:
    """Messages of one topic, serialised, in order of time."""

    topic: str
    type: str
    received: IntArray
    blobs: list[bytes]


def streams_of(signals: dict[str, Signal], prefix: str, start: int) -> Iterator[Stream]:
    """The messages that carry signals, topic by topic; `start` is ns since the epoch of t = 0.

    Raises:
        InputError: a signal that no topic carries, or times that cannot be stamped.
    """
    groups: dict[str, dict[str, Signal]] = {}
    for name, signal in signals.items():
        topic, column = _place(name)
        groups.setdefault(topic, {})[column] = signal
    for topic, columns in groups.items():
        place = contract.place_of(topic)
        assert place is not None
        yield _stream(prefix + topic, place.type, columns, start)


def marker_stream(texts: list[tuple[float, str]], prefix: str, start: int) -> Stream:
    """The messages of markers: time in s and text each."""
    times = np.array([time for time, _ in texts], dtype=float)
    received = _stamps(Signal("marker", "", times, times), times, start)
    blobs = [_serialised(contract.STRING, data=text) for _, text in texts]
    return Stream(f"{prefix}experiment/marker", contract.STRING, received, blobs)


_COLUMN_TOPICS = {
    "voltage": "power", "current": "power", "temperature": "temperature", "range": "range",
}  # fmt: skip
_JOINTS_OF = {s: joint for joint, signals in JOINT_SIGNALS.items() for s in signals}


def _place(name: str) -> tuple[str, str]:
    """Topic and column of a signal's name."""
    channel, _, column = name.rpartition(".")
    topic = f"{channel}/{_COLUMN_TOPICS.get(column, '')}"
    place = contract.place_of(topic) if channel else None
    if place is not None and place.meaning == topic:
        return topic, column
    if name in _JOINTS_OF:
        return "joint_states", name
    if name == "voltage_command":
        return name, "data"
    raise InputError(
        f"signal {name}: no topic of the contract carries it, expected <channel>.voltage, "
        f".current, .temperature, front.range, back.range, {', '.join(sorted(_JOINTS_OF))}, "
        "voltage_command or ambient.temperature"
    )


def _stream(topic: str, msgtype: str, columns: dict[str, Signal], start: int) -> Stream:
    """Signals of one topic as copies of a template with other numbers; NaN where only the other
    signals of the topic have a value."""
    if msgtype == contract.MULTI_ARRAY:
        signal = columns["data"]
        values = signal.values.reshape(len(signal), -1)
        template = _serialised(msgtype, data=np.zeros(values.shape[1]))
        blobs = cdr.encode(template, msgtype, {"data": values})
        return Stream(topic, msgtype, _stamps(signal, signal.time, start), blobs)

    # All columns on the union of their stamps.
    stamps = {name: _stamps(signal, signal.time, start) for name, signal in columns.items()}
    union = np.unique(np.concatenate([*stamps.values()]))
    received = union.copy()
    merged: dict[str, FloatArray] = {}
    for name, signal in columns.items():
        if signal.values.ndim != 1:
            raise InputError(
                f"signal {signal.name}: values of shape {signal.values.shape}, expected (n,)"
            )
        rows = np.searchsorted(union, stamps[name])
        merged[name] = np.full(len(union), _NAN)
        merged[name][rows] = signal.values
        if signal.received is not None:
            received[rows] = _stamps(signal, signal.received, start)

    # The fields that they go to, and what else such a message says.
    channel = topic.split("/")[-2]
    frame, rest = channel, {}
    absent = np.full(len(union), _NAN)
    if msgtype == contract.BATTERY_STATE:
        merged = {"voltage": absent, "current": absent, **merged}
        unknown = ("temperature", "charge", "capacity", "design_capacity", "percentage")
        rest = {"present": True, "location": channel, **dict.fromkeys(unknown, _NAN)}
    elif msgtype == contract.TEMPERATURE:
        merged = {"temperature": merged["temperature"] - contract.CELSIUS_ZERO}
    elif msgtype == contract.RANGE:
        frame = f"{channel}_range"
        rest = {"radiation_type": 1, "max_range": float("inf")}
    else:
        frame = "base"
        joints = [j for j in JOINT_SIGNALS if j in {_JOINTS_OF[name] for name in columns}]
        found = {(_JOINTS_OF[name], JOINT_SIGNALS[_JOINTS_OF[name]][name]): merged[name]
                 for name in columns}  # fmt: skip
        merged = {
            field: np.column_stack([found.get((joint, field), absent) for joint in joints])
            for field in ("position", "effort")
        }
        rest = {"name": joints, **dict.fromkeys(merged, np.zeros(len(joints)))}
    template = _serialised(
        msgtype, header=message("std_msgs/msg/Header", frame_id=frame), **rest
    )
    seconds, nanoseconds = np.divmod(union, 10**9)
    numbers: dict[str, Any] = {"stamp.sec": seconds, "stamp.nanosec": nanoseconds, **merged}
    return Stream(topic, msgtype, received, cdr.encode(template, msgtype, numbers))


def _stamps(signal: Signal, times: FloatArray, start: int) -> IntArray:
    """Nanoseconds since the epoch of times in s."""
    if not np.isfinite(times).all():
        raise InputError(f"signal {signal.name}: a time is not finite, expected seconds")
    seconds = times + start * 1e-9
    if len(times) and not (seconds.min() >= -1e-6 and seconds.max() < _LATEST_STAMP):
        raise InputError(
            f"signal {signal.name}: times {times.min():g} to {times.max():g} s after epoch second "
            f"{start * 1e-9:g} cannot be stamped, expected between 1970 and 2038"
        )
    return np.maximum(np.rint(times * 1e9).astype(np.int64) + start, 0)


_EMPTY = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


def message(msgtype: str, **fields: Any) -> Any:
    """A message of rosbags' classes of ROS 2 Jazzy; what is not given is zero or empty."""
    for name, (kind, detail) in TYPES.fielddefs[msgtype][1]:
        if name in fields:
            continue
        if kind == Nodetype.NAME:
            fields[name] = message(str(detail))
        elif kind == Nodetype.BASE:
            fields[name] = _EMPTY.get(str(detail[0]), 0)
        else:
            element = detail[0][1]
            numbers = isinstance(element, tuple) and element[0] != "string"
            fields[name] = np.zeros(0, dtype=element[0]) if numbers else []
    return TYPES.types[msgtype](**fields)


def _serialised(msgtype: str, **fields: Any) -> bytes:
    return bytes(TYPES.serialize_cdr(message(msgtype, **fields), msgtype))
