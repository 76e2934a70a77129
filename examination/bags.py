"""Bags in the other storage of ROS 2: sqlite3, as recorders before Jazzy write it."""

import shutil
from pathlib import Path

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from sma_bench.records.bag_writer import TYPES


def in_sqlite3(bag: Path) -> Path:
    """Rewrite a bag's folder with its messages in sqlite3; its storage file."""
    other = bag.with_name(f"{bag.name}.sqlite3")
    writer = Writer(other / bag.name, version=9, storage_plugin=StoragePlugin.SQLITE3)
    other.mkdir()
    with Reader(bag) as reader, writer:
        connections = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=TYPES)
                       for c in reader.connections}
        for connection, time, data in reader.messages():
            writer.write(connections[connection.id], time, data)
    shutil.rmtree(bag)
    (other / bag.name).rename(bag)
    other.rmdir()
    return next(bag.glob("*.db3"))
