"""How long a bag of 720,000 messages takes: this package beside one message at a time."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rosbags.rosbag2 import Reader

from sma_bench.records import Signal, read_record
from sma_bench.records.messages import TYPES
from sma_bench.records.write import write_record

MESSAGES = 720_000
_TOPICS = 4


def signals_of_a_bench(messages: int) -> list[Signal]:
    """Signals that make `messages` messages: power, temperature, joints and commands alike."""
    n = messages // _TOPICS
    clock = np.arange(n) * 1e-3
    noise = np.random.default_rng(0).normal(size=n)
    return [
        Signal("wire.voltage", "V", clock, 3 + noise),
        Signal("wire.current", "A", clock, 1 + noise),
        Signal("wire.temperature", "K", clock, 300 + noise),
        Signal("elongation", "m", clock, 1e-3 * noise),
        Signal("force", "N", clock, noise),
        Signal("voltage_command", "V", clock, np.column_stack([noise] * 4)),
    ]


def measure(messages: int = MESSAGES) -> dict[str, float]:
    """Seconds to write, read, and read with rosbags' deserialisation, for both storages."""
    signals = signals_of_a_bench(messages)
    seconds: dict[str, float] = {}
    with TemporaryDirectory() as folder:
        for storage in ("mcap", "sqlite3"):
            bag = Path(folder, storage)
            seconds[f"{storage} write"] = _time(
                lambda bag=bag, storage=storage: write_record(bag, signals, storage=storage)
            )
            seconds[f"{storage} read"] = _time(lambda bag=bag: read_record(bag))
            seconds[f"{storage} read, rosbags"] = _time(lambda bag=bag: _read_one_by_one(bag))
    _print(messages, seconds)
    return seconds


def _read_one_by_one(bag: Path) -> int:
    with Reader(bag) as reader:
        return sum(
            TYPES.deserialize_cdr(data, connection.msgtype) is not None
            for connection, _, data in reader.messages(reader.connections)
        )


def _time(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _print(messages: int, seconds: dict[str, float]) -> None:
    print(f"bag of {messages:,} messages        write s   read s   rosbags one by one s")
    for storage in ("mcap", "sqlite3"):
        write, read, slow = (
            seconds[f"{storage} {what}"] for what in ("write", "read", "read, rosbags")
        )
        print(f"  {storage:28} {write:9.2f} {read:8.2f} {slow:12.2f}")


if __name__ == "__main__":
    measure()
