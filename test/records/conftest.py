"""Bags written by rosbags, as another program would write them."""

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from sma_bench.records.bag_writer import TYPES, message

START = 1_700_000_000 * 10**9


class Messages:
    """Makes messages of the contract's types; stamps in ns."""

    ros, types, start = staticmethod(message), TYPES, START

    @staticmethod
    def serialise(given):
        return bytes(TYPES.serialize_cdr(given, given.__msgtype__))

    @staticmethod
    def stamped(kind, stamp_ns, **fields):
        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        stamp = message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        header = message("std_msgs/msg/Header", stamp=stamp, frame_id="wire")
        return message(f"sensor_msgs/msg/{kind}", header=header, **fields)

    @classmethod
    def temperature(cls, stamp_ns, celsius, variance=0.0):
        return cls.stamped("Temperature", stamp_ns, temperature=celsius, variance=variance)

    @classmethod
    def power(cls, stamp_ns, voltage, current=float("nan")):
        return cls.stamped("BatteryState", stamp_ns, voltage=voltage, current=current)

    @staticmethod
    def text(content):
        return message("std_msgs/msg/String", data=content)


@pytest.fixture(scope="session")
def messages():
    return Messages


def _write(path, content, storage="mcap", chunk=None, declare=()):
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    kinds = dict(declare) | {topic: given.__msgtype__ for topic, given, _ in content}
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=TYPES)
                       for topic, kind in kinds.items()}
        for count, (topic, given, received) in enumerate(content, start=1):
            writer.write(connections[topic], received, Messages.serialise(given))
            if chunk and count % chunk == 0:
                writer.storage.close_chunk()
    return path


@pytest.fixture(scope="session")
def write_bag():
    """Writes a bag with rosbags: write_bag(path, [(topic, message, received_ns), ...])."""
    return _write


@pytest.fixture(scope="session")
def ramp():
    """400 messages of a wire: 200 powers (k mV, k mA) and 200 temperatures (20 + k/10 degC)."""
    content = []
    for k, stamp in enumerate(range(START, START + 200 * 10**7, 10**7)):
        power = Messages.power(stamp, k / 1e3, k / 1e3)
        reading = Messages.temperature(stamp, 20 + k / 10)
        content += [("/bench/wire/power", power, stamp + 1_000_000),
                    ("/bench/wire/temperature", reading, stamp + 3_000_000)]
    return content
