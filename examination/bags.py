"""Bags in sqlite3 storage, as written by recorders before Jazzy."""

import shutil
from pathlib import Path

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from sma_bench.records.bag_writer import TYPES


def in_sqlite3(bag: Path) -> Path:
    """Rewrite a bag with its messages in sqlite3 storage; the path of its storage file."""
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
