"""Bags written by rosbags, message by message, as another program would write them."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
START = 1_700_000_000 * 10**9
NAN = float("nan")

Message = tuple[str, Any, int]


def ros(msgtype: str, **fields: Any) -> Any:
    """A message of rosbags' own classes."""
    return TYPES.types[msgtype](**fields)


def header(stamp_ns: int, frame: str = "wire") -> Any:
    """std_msgs/Header."""
    stamp = ros("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


class Messages:
    """Messages of the contract's types."""

    ros = staticmethod(ros)
    header = staticmethod(header)
    types = TYPES
    start = START

    @staticmethod
    def serialise(message: Any) -> bytes:
        return bytes(TYPES.serialize_cdr(message, message.__msgtype__))

    @staticmethod
    def temperature(
        stamp_ns: int, celsius: float, frame: str = "wire", variance: float = 0.0
    ) -> Any:
        return ros(
            "sensor_msgs/msg/Temperature",
            header=header(stamp_ns, frame),
            temperature=celsius,
            variance=variance,
        )

    @staticmethod
    def power(stamp_ns: int, voltage: float, current: float = NAN) -> Any:
        nothing = np.zeros(0, dtype=np.float32)
        numbers = ("temperature", "charge", "capacity", "design_capacity", "percentage")
        return ros(
            "sensor_msgs/msg/BatteryState",
            header=header(stamp_ns),
            voltage=voltage,
            current=current,
            **dict.fromkeys(numbers, NAN),
            power_supply_status=0,
            power_supply_health=0,
            power_supply_technology=0,
            present=True,
            cell_voltage=nothing,
            cell_temperature=nothing,
            location="wire",
            serial_number="",
        )

    @staticmethod
    def joints(stamp_ns: int, names: list[str], position: list[float], effort: Any = ()) -> Any:
        return ros(
            "sensor_msgs/msg/JointState",
            header=header(stamp_ns),
            name=names,
            position=np.array(position, dtype=float),
            velocity=np.zeros(0),
            effort=np.array(effort, dtype=float),
        )

    @staticmethod
    def range(stamp_ns: int, distance: float, low: float = 0.05, high: float = 0.2) -> Any:
        return ros(
            "sensor_msgs/msg/Range",
            header=header(stamp_ns),
            radiation_type=1,
            field_of_view=0.1,
            min_range=low,
            max_range=high,
            range=distance,
            variance=0.0,
        )

    @staticmethod
    def command(values: Iterable[float]) -> Any:
        layout = ros("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        data = np.array(list(values), dtype=float)
        return ros("std_msgs/msg/Float64MultiArray", layout=layout, data=data)

    @staticmethod
    def text(content: str) -> Any:
        return ros("std_msgs/msg/String", data=content)


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
        for topic, msgtype in declare:
            connections[topic] = writer.add_connection(topic, msgtype, typestore=TYPES)
        for count, (topic, message, received) in enumerate(content, start=1):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=TYPES
                )
            writer.write(connections[topic], received, Messages.serialise(message))
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
