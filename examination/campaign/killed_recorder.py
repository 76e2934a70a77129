"""Recorders killed at random times: nothing older than a second is lost, and the bag is read."""

import json
import random
import shutil
import time
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import Temperature
from std_msgs.msg import Header, String

from examination.campaign.bench_nodes import RELIABLE, Talker, bench_nodes
from examination.campaign.outcome import Outcome
from sma_bench.errors import InputError
from sma_bench.records import read_record
from sma_bench.records.contract import CELSIUS_ZERO

ALLOWED = 1.0  # s
_LATEST_KILL = 3.0


def killed_recorder(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Kill `size` recorder nodes while they record."""
    rng = random.Random(seed)
    with bench_nodes(folder / "logs") as talker:
        lost = [_kill(rng, talker, folder / "bag") for _ in range(size)]
    found = f"lost at most {max(lost):.2f} s, {np.median(lost):.2f} s in the median"
    what, limit = "recorder node killed with -9", f"{ALLOWED:g} s"
    return [Outcome("killed", what, size, found, limit, max(lost) <= ALLOWED)]


def _kill(rng: random.Random, talker: Talker, bag: Path) -> float:
    """s lost by a recorder node."""
    shutil.rmtree(bag, ignore_errors=True)
    publisher = talker.node.create_publisher(Temperature, "wire/temperature", RELIABLE)
    states = talker.heard("recorder/state", String)
    talker.nodes.start("recorder", {"output": str(bag)})
    talker.until("the recorder subscribes", publisher.get_subscription_count)
    began, number = time.time(), iter(range(10**9))

    def publish() -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        header = Header(stamp=Time(sec=seconds, nanosec=nanoseconds))
        publisher.publish(Temperature(header=header, temperature=float(next(number))))

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
