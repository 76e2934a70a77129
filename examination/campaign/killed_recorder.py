"""A recorder killed at random times: nothing older than a second is lost, and the bag is read."""

import json
import os
import random
import shutil
import signal
import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sensor_msgs.msg import Temperature
from std_msgs.msg import String

from examination.campaign.bench_nodes import RELIABLE, Talker, bench_nodes
from examination.campaign.outcome import Outcome
from sma_bench.errors import InputError
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.contract import CELSIUS_ZERO, TEMPERATURE
from sma_bench.records.messages import streams_of

ALLOWED = 1.0  # s
_PERIOD, _LATEST_KILL = 0.005, 3.0
# Of a serialised sensor_msgs/Temperature: where the stamp is, and the two numbers at its end.
_STAMP, _STAMP_AT, _NUMBER = struct.Struct("<iI"), 4, struct.Struct("<dd")
_TOPIC = "/campaign/wire/temperature"
_AT_ONCE = 10
_NODES_OF = 10  # each of these starts a process with ROS, and so takes seconds


def killed_recorder(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Kill `size` writers of a bag, and a tenth as many recorder nodes, while they record."""
    rng = random.Random(seed)
    writers: list[float] = []
    while len(writers) < size:
        writers += _kill_writers(rng, min(_AT_ONCE, size - len(writers)), folder)
    with bench_nodes(folder / "logs") as talker:
        nodes = [_kill_node(rng, talker, folder / "node") for _ in range(max(1, size // _NODES_OF))]
    return [
        Outcome(
            "killed", f"{what} killed with -9", len(lost),
            f"lost at most {max(lost):.2f} s, {np.median(lost):.2f} s in the median",
            f"{ALLOWED:g} s", max(lost) <= ALLOWED,
        )
        for what, lost in (("bag writer", writers), ("recorder node", nodes))
    ]  # fmt: skip


def _kill_writers(rng: random.Random, count: int, folder: Path) -> list[float]:
    """s lost by each of several writers that run beside one another."""
    bags = [folder / f"writer_{k}" for k in range(count)]
    begun = [bag.with_suffix(".begun") for bag in bags]
    children = []
    for bag, mark in zip(bags, begun, strict=True):
        if (child := os.fork()) == 0:
            try:
                _write_forever(bag, mark.touch)
            finally:
                os._exit(1)
        children.append(child)
    while not all(mark.exists() for mark in begun):
        time.sleep(0.01)
    started, killed = time.monotonic(), {}
    for at, k in sorted((rng.uniform(0.0, _LATEST_KILL), k) for k in range(count)):
        time.sleep(max(0.0, started + at - time.monotonic()))
        killed[k] = time.time()
        os.kill(children[k], signal.SIGKILL)
    for child in children:
        os.waitpid(child, 0)
    lost = [lost_seconds(bag, killed[k], begun[k].stat().st_mtime) for k, bag in enumerate(bags)]
    for bag, mark in zip(bags, begun, strict=True):
        shutil.rmtree(bag, ignore_errors=True)
        mark.unlink()
    return lost


def _write_forever(path: Path, begin: Callable[[], None]) -> None:
    bag = BagWriter(path)
    bag.add_topic(_TOPIC, TEMPERATURE)
    first = Signal("wire.temperature", "K", np.zeros(1), np.array([CELSIUS_ZERO]))
    (stream,) = streams_of({first.name: first}, "/campaign/", 0)
    template = bytearray(stream.blobs[0])
    begin()
    for number in range(10**9):
        now = time.time_ns()
        _STAMP.pack_into(template, _STAMP_AT, *divmod(now, 10**9))
        _NUMBER.pack_into(template, len(template) - _NUMBER.size, number, 0.0)
        bag.write(_TOPIC, now, bytes(template))
        time.sleep(_PERIOD)


def _kill_node(rng: random.Random, talker: Talker, bag: Path) -> float:
    """s lost by a recorder node."""
    shutil.rmtree(bag, ignore_errors=True)
    publisher = talker.node.create_publisher(Temperature, "wire/temperature", RELIABLE)
    states = talker.heard("recorder/state", String)
    talker.nodes.start("recorder", {"output": str(bag)})
    talker.until("the recorder subscribes", publisher.get_subscription_count)
    began, number = time.time(), iter(range(10**9))

    def publish() -> None:
        message = Temperature(temperature=float(next(number)))
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
        publisher.publish(message)

    def recorded() -> int:
        publish()
        return sum(json.loads(states[-1].data)["messages"].values()) if states else 0

    talker.until("something is recorded", recorded)
    talker.listen(rng.uniform(0.0, _LATEST_KILL), publish)
    killed = time.time()
    talker.kill("recorder")
    talker.node.destroy_publisher(publisher)
    return lost_seconds(bag, killed, began)


def lost_seconds(bag: Path, killed: float, began: float) -> float:
    """s from the last message in the bag to the kill (times in s since the epoch).

    A bag that cannot be read has lost all since it `began`; one that lacks a number in between,
    infinity.
    """
    try:
        record = read_record(bag)
        temperature = record["wire.temperature"]
    except InputError:
        return max(0.0, killed - began)
    if (np.diff(np.rint(temperature.values - CELSIUS_ZERO)) != 1).any():
        return np.inf
    return killed - (record.start_ns * 1e-9 + float(temperature.time[-1]))
