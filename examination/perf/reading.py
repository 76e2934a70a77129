"""Reading a bag beside what one would pick instead, message by message."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader

from examination.bags import in_sqlite3
from examination.perf.measuring import Figure, interleaved, ratio
from examination.perf.records import staircase_bag
from sma_bench.records import read_record
from sma_bench.records.messages import TYPES

DURATION, EACH_SECOND = 600.0, 200  # s; messages of power and temperature


def reading(tiny: bool = False) -> Iterator[Figure]:
    """Ratios for both storages."""
    duration = 20.0 if tiny else DURATION
    messages = round(EACH_SECOND * duration)
    for storage in ("mcap", "sqlite3"):
        with TemporaryDirectory() as folder:
            bag = staircase_bag(Path(folder, storage), duration)
            calls = {"ours": partial(read_record, bag), "rosbags": partial(_rosbags, bag)}
            if storage == "sqlite3":
                in_sqlite3(bag)
            else:
                calls["mcap-ros2-support"] = partial(_mcap_ros2, next(bag.glob("*.mcap")))
            seconds = interleaved(calls, 2 if tiny else 5, budget=30.0)
        case, ours = f"{storage}, {messages:,} messages", seconds.pop("ours")
        yield Figure(case, "messages a second", messages / float(np.median(ours)), "1/s")
        for name, taken in seconds.items():
            yield Figure(case, f"{name}: times slower", ratio(taken, ours), "x", least=1.5)


def _rosbags(bag: Path) -> int:
    with Reader(bag) as reader:
        return sum(
            TYPES.deserialize_cdr(data, connection.msgtype) is not None
            for connection, _, data in reader.messages(reader.connections)
        )


def _mcap_ros2(path: Path) -> int:
    return sum(message.ros_msg is not None for message in read_ros2_messages(str(path)))
