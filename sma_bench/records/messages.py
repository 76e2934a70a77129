"""Signals to the serialised messages of the contract's topics."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from sma_bench.errors import InputError
from sma_bench.records import cdr, contract
from sma_bench.records.record import FloatArray, IntArray, Signal
from sma_bench.records.samples import JOINT_SIGNALS

TYPES = get_typestore(Stores.ROS2_JAZZY)

_MAX_STAMP_NS = 2**31 * 10**9


@dataclass
class Stream:
    """Messages of one topic, serialised, in order of time."""

    topic: str
    type: str
    received: IntArray
    blobs: list[bytes]


def streams_of(signals: dict[str, Signal], prefix: str, start: int) -> Iterator[Stream]:
    """Group the signals by topic."""
    groups: dict[str, dict[str, Signal]] = {}
    for name, signal in signals.items():
        topic, column = _place(name)
        groups.setdefault(topic, {})[column] = signal
    for topic, columns in groups.items():
        yield _BUILDERS[topic.rpartition("/")[2]](prefix + topic, columns, start)


_COLUMN_TOPICS = {
    "voltage": "power",
    "current": "power",
    "temperature": "temperature",
    "range": "range",
}
_JOINT_SIGNALS = {s for signals in JOINT_SIGNALS.values() for s in signals}


def _place(name: str) -> tuple[str, str]:
    """Topic and column of a signal's name."""
    channel, _, column = name.rpartition(".")
    if channel and column in _COLUMN_TOPICS:
        topic = f"{channel}/{_COLUMN_TOPICS[column]}"
        place = contract.place_of(topic)
        if place is not None and place.meaning == topic:
            return topic, column
    if name in _JOINT_SIGNALS:
        return "joint_states", name
    if name == "voltage_command":
        return name, "data"
    raise InputError(
        f"signal {name}: no topic of the contract carries it, expected <channel>.voltage, "
        f".current, .temperature, front.range, back.range, {', '.join(sorted(_JOINT_SIGNALS))}, "
        "voltage_command or ambient.temperature"
    )


def _stamps(signal: Signal, times: FloatArray, start: int) -> IntArray:
    """Nanoseconds since the epoch of times in s."""
    if len(times) and not np.isfinite(times).all():
        raise InputError(f"signal {signal.name}: a time is not finite, expected seconds")
    seconds = times + start * 1e-9
    if len(times) and not (seconds.min() >= -1e-6 and seconds.max() < _MAX_STAMP_NS * 1e-9):
        raise InputError(
            f"signal {signal.name}: times {times.min():g} to {times.max():g} s after epoch second "
            f"{start * 1e-9:g} cannot be stamped, expected between 1970 and 2038"
        )
    return np.maximum(np.rint(times * 1e9).astype(np.int64) + start, 0)


def _merge(
    columns: dict[str, Signal], start: int
) -> tuple[IntArray, IntArray, dict[str, FloatArray]]:
    """Signals of one topic on the union of their stamps, NaN where one has no value.

    Returns:
        Stamps and receive times in ns, both (n,), and the columns, (n,) each.
    """
    stamps = {name: _stamps(signal, signal.time, start) for name, signal in columns.items()}
    union = np.unique(np.concatenate([*stamps.values()]))
    received = union.copy()
    merged = {}
    for name, signal in columns.items():
        if signal.values.ndim != 1:
            raise InputError(
                f"signal {signal.name}: values of shape {signal.values.shape}, expected (n,)"
            )
        rows = np.searchsorted(union, stamps[name])
        merged[name] = np.full(len(union), np.nan)
        merged[name][rows] = signal.values
        if signal.received is not None:
            received[rows] = _stamps(signal, signal.received, start)
    return union, received, merged


def _ros(msgtype: str, **fields: Any) -> Any:
    return TYPES.types[msgtype](**fields)


def _header(frame: str) -> Any:
    stamp = _ros("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    return _ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _serialise(msgtype: str, message: Any) -> bytes:
    return bytes(TYPES.serialize_cdr(message, msgtype))


def _stamped(
    topic: str,
    msgtype: str,
    template: Any,
    stamps: IntArray,
    received: IntArray,
    columns: dict[str, FloatArray],
) -> Stream:
    seconds, nanoseconds = np.divmod(stamps, 10**9)
    numbers: dict[str, Any] = {"stamp.sec": seconds, "stamp.nanosec": nanoseconds, **columns}
    blobs = cdr.encode(_serialise(msgtype, template), msgtype, numbers)
    return Stream(topic, msgtype, received, blobs)


def _power(topic: str, columns: dict[str, Signal], start: int) -> Stream:
    stamps, received, merged = _merge(columns, start)
    nan = np.full(len(stamps), np.nan)
    fields = {"voltage": nan, "current": nan, **merged}
    channel = topic.split("/")[-2]
    nothing = np.zeros(0, dtype=np.float32)
    template = _ros(
        contract.BATTERY_STATE,
        header=_header(channel),
        voltage=0.0,
        temperature=float("nan"),
        current=0.0,
        charge=float("nan"),
        capacity=float("nan"),
        design_capacity=float("nan"),
        percentage=float("nan"),
        power_supply_status=0,
        power_supply_health=0,
        power_supply_technology=0,
        present=True,
        cell_voltage=nothing,
        cell_temperature=nothing,
        location=channel,
        serial_number="",
    )
    return _stamped(topic, contract.BATTERY_STATE, template, stamps, received, fields)


def _temperature(topic: str, columns: dict[str, Signal], start: int) -> Stream:
    stamps, received, merged = _merge(columns, start)
    frame = _header(topic.split("/")[-2])
    template = _ros(contract.TEMPERATURE, header=frame, temperature=0.0, variance=0.0)
    celsius = {"temperature": merged["temperature"] - contract.CELSIUS_ZERO}
    return _stamped(topic, contract.TEMPERATURE, template, stamps, received, celsius)


def _range(topic: str, columns: dict[str, Signal], start: int) -> Stream:
    stamps, received, merged = _merge(columns, start)
    template = _ros(
        contract.RANGE,
        header=_header(topic.split("/")[-2] + "_range"),
        radiation_type=1,
        field_of_view=0.0,
        min_range=0.0,
        max_range=float("inf"),
        range=0.0,
        variance=0.0,
    )
    return _stamped(topic, contract.RANGE, template, stamps, received, merged)


def _joints(topic: str, columns: dict[str, Signal], start: int) -> Stream:
    stamps, received, merged = _merge(columns, start)
    nan = np.full(len(stamps), np.nan)
    joints = [j for j, signals in JOINT_SIGNALS.items() if any(s in columns for s in signals)]
    fields = {
        field: np.column_stack([_joint_column(joint, field, merged, nan) for joint in joints])
        for field in ("position", "effort")
    }
    template = _ros(
        contract.JOINT_STATE,
        header=_header("base"),
        name=joints,
        position=np.zeros(len(joints)),
        velocity=np.zeros(0),
        effort=np.zeros(len(joints)),
    )
    return _stamped(topic, contract.JOINT_STATE, template, stamps, received, fields)


def _joint_column(
    joint: str, field: str, merged: dict[str, FloatArray], absent: FloatArray
) -> FloatArray:
    names = [signal for signal, source in JOINT_SIGNALS[joint].items() if source == field]
    return next((merged[name] for name in names if name in merged), absent)


def _multi_array(width: int) -> Any:
    layout = _ros("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return _ros(contract.MULTI_ARRAY, layout=layout, data=np.zeros(width))


def _command(topic: str, columns: dict[str, Signal], start: int) -> Stream:
    signal = columns["data"]
    values = signal.values.reshape(len(signal), -1)
    template = _serialise(contract.MULTI_ARRAY, _multi_array(values.shape[1]))
    blobs = cdr.encode(template, contract.MULTI_ARRAY, {"data": values})
    return Stream(topic, contract.MULTI_ARRAY, _stamps(signal, signal.time, start), blobs)


_BUILDERS = {
    "power": _power,
    "temperature": _temperature,
    "range": _range,
    "joint_states": _joints,
    "voltage_command": _command,
}


def marker_stream(texts: list[tuple[float, str]], prefix: str, start: int) -> Stream:
    times = np.array([time for time, _ in texts], dtype=float)
    signal = Signal("marker", "", times, times)
    blobs = [_serialise(contract.STRING, _ros(contract.STRING, data=text)) for _, text in texts]
    received = _stamps(signal, times, start)
    return Stream(f"{prefix}experiment/marker", contract.STRING, received, blobs)
