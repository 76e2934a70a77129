"""Bags written by rosbags, message by message, as another program would write them."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from sma_bench.records.messages import TYPES, message

START = 1_700_000_000 * 10**9
NAN = float("nan")

Message = tuple[str, Any, int]


class Messages:
    """Messages of the contract's types."""

    ros = staticmethod(message)
    types = TYPES
    start = START

    @staticmethod
    def header(stamp_ns: int, frame: str = "wire") -> Any:
        stamp = message(
            "builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
        )
        return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    @staticmethod
    def serialise(given: Any) -> bytes:
        return bytes(TYPES.serialize_cdr(given, given.__msgtype__))

    @classmethod
    def _stamped(cls, kind: str, stamp_ns: int, **fields: Any) -> Any:
        return message(f"sensor_msgs/msg/{kind}", header=cls.header(stamp_ns), **fields)

    @classmethod
    def temperature(cls, stamp_ns: int, celsius: float, variance: float = 0.0) -> Any:
        return cls._stamped("Temperature", stamp_ns, temperature=celsius, variance=variance)

    @classmethod
    def power(cls, stamp_ns: int, voltage: float, current: float = NAN) -> Any:
        return cls._stamped("BatteryState", stamp_ns, voltage=voltage, current=current)

    @classmethod
    def joints(
        cls, stamp_ns: int, names: list[str], position: list[float], effort: Any = ()
    ) -> Any:
        arrays = {"position": np.array(position, float), "effort": np.array(effort, float)}
        return cls._stamped("JointState", stamp_ns, name=names, **arrays)

    @classmethod
    def range(cls, stamp_ns: int, distance: float, low: float = 0.05, high: float = 0.2) -> Any:
        return cls._stamped("Range", stamp_ns, min_range=low, max_range=high, range=distance)

    @staticmethod
    def command(values: Iterable[float]) -> Any:
        return message("std_msgs/msg/Float64MultiArray", data=np.array(list(values), dtype=float))

    @staticmethod
    def text(content: str) -> Any:
        return message("std_msgs/msg/String", data=content)


@pytest.fixture(scope="session")
def messages() -> type[Messages]:
    """Makes messages."""
    return Messages


def _write(
    path: Path,
    content: list[Message],
    storage: str = "mcap",
    compression: CompressionMode = CompressionMode.NONE,
    chunk: int | None = None,
    declare: Iterable[tuple[str, str]] = (),
) -> Path:
    """Write (topic, message, receive time ns) in the order given."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(compression, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for topic, msgtype in (*declare, *((t, m.__msgtype__) for t, m, _ in content)):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=TYPES)
        for count, (topic, given, received) in enumerate(content, start=1):
            writer.write(connections[topic], received, Messages.serialise(given))
            if chunk and count % chunk == 0:
                writer.storage.close_chunk()
    return path


@pytest.fixture(scope="session")
def write_bag() -> Callable[..., Path]:
    """Writes a bag with rosbags: write_bag(path, [(topic, message, received_ns), ...])."""
    return _write


@pytest.fixture(scope="session")
def ramp() -> list[Message]:
    """400 messages of a wire: 200 powers (k mV, k mA) and 200 temperatures (20 + k/10 degC)."""
    content = []
    for k in range(200):
        stamp = START + k * 10_000_000
        power = Messages.power(stamp, k * 1e-3, k * 1e-3)
        content.append(("/bench/wire/power", power, stamp + 1_000_000))
        reading = Messages.temperature(stamp, 20 + k / 10)
        content.append(("/bench/wire/temperature", reading, stamp + 3_000_000))
    return content
