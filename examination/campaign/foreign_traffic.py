"""Other types, broken bytes and leaping clocks on the bench's topics: every node goes on."""

import json
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_msgs.msg import Float64, Float64MultiArray, String

from examination.campaign.bench_nodes import RELIABLE, GaveUp, Talker, bench_nodes
from examination.campaign.outcome import Outcome
from sma_bench.errors import InputError
from sma_bench.hardware.thermal_settings import regions_side_by_side
from sma_bench.records import read_record

# A node, and the topics that it listens to with their own type.
LISTENERS: dict[str, dict[str, type]] = {
    "simulator": {"voltage_command": Float64MultiArray},
    "experiment": {"wire/power": BatteryState, "wire/temperature": Temperature},
    "temperature_controller": {
        "wire/power": BatteryState, "wire/temperature": Temperature,
        "temperature_controller/reference": Float64MultiArray,
    },
    "ir_camera": {"thermal_image": Image},
}  # fmt: skip
_PARAMETERS = {
    "ir_camera": {
        "image_width": 64, "image_height": 48, "regions": list(regions_side_by_side(1, 64, 48)),
    },
}
_FOREIGN = (String, Float64, Image, Temperature)
_AT_ONCE = 20
_LEAPS, _BACK = (0.5, 60.0, 3600.0, 86_400.0), 3600.0
_START = 1e5
_TICK = 0.01
_PER_LEAP = 50


def foreign_traffic(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` messages of other types and as many of broken bytes on every topic."""
    rng = random.Random(seed)
    outcomes = []
    with bench_nodes(folder / "logs") as talker:
        for node, topics in LISTENERS.items():
            talker.nodes.start(node, _PARAMETERS.get(node, {}))
            wrong = _shout(talker, node, topics, size, rng)
            talker.kill(node)
            found = wrong or "alive, parameters answered"
            what = f"foreign types and broken bytes at {node}"
            outcomes.append(
                Outcome("traffic", what, 2 * size * len(topics), found, "node goes on", not wrong)
            )
    return outcomes


def _shout(
    talker: Talker, node: str, topics: dict[str, type], size: int, rng: random.Random
) -> str:
    """What went wrong, or ""."""
    publishers = []
    try:
        for topic, kind in topics.items():
            own = talker.node.create_publisher(kind, topic, RELIABLE)
            publishers.append(own)
            talker.until(f"{node} listens to {topic}", own.get_subscription_count)
            foreign = rng.choice([other for other in _FOREIGN if other is not kind])
            other = talker.stranger.create_publisher(foreign, topic, RELIABLE)
            publishers.append(other)
            for number in range(size):
                other.publish(foreign())
                own.publish(_broken(rng))
                if number % _AT_ONCE == 0:
                    talker.listen(0.02)
        talker.listen(0.5)
        talker.nodes.check()
        talker.parameters_of(node)
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {error}"
    finally:
        for publisher in publishers:
            for own_node in (talker.node, talker.stranger):
                own_node.destroy_publisher(publisher)
    return ""


def _broken(rng: random.Random) -> bytes:
    """A header of CDR, or not even that, and bytes drawn at random."""
    head = rng.choice([b"\x00\x01\x00\x00", b"\x00\x01\x00\x00", b"\xff\x01", b""])
    return head + rng.randbytes(rng.choice([0, 1, 7, 40, 300]))


def leaping_clocks(size: int, seed: int, folder: Path) -> list[Outcome]:
    """A recorder on /clock while the clock leaps forward `size` times, and back at the end."""
    rng = random.Random(seed)
    with bench_nodes(folder / "logs") as talker:
        try:
            found, met = _leap(talker, size, rng, folder / "bag")
        except GaveUp as error:
            found, met = str(error), False
    limit = "every message read, ended by the leap back in one line"
    return [Outcome("clocks", "leaps of /clock at the recorder", size, found, limit, met)]


def _leap(talker: Talker, size: int, rng: random.Random, bag: Path) -> tuple[str, bool]:
    node = talker.node
    ticks = node.create_publisher(Clock, "/clock", 10)
    readings = node.create_publisher(Temperature, "wire/temperature", RELIABLE)
    commands = node.create_publisher(Float64MultiArray, "voltage_command", RELIABLE)
    states = talker.heard("recorder/state", String)
    talker.nodes.start("recorder", {"output": str(bag), "use_sim_time": True})
    for publisher in (ticks, readings, commands):
        talker.until("the recorder listens", publisher.get_subscription_count)
    now, sent = _START, 0

    def tick() -> None:
        message = Clock()
        seconds = int(now)
        message.clock.sec, message.clock.nanosec = seconds, int((now - seconds) * 1e9)
        ticks.publish(message)

    def recorded() -> int:
        counts = json.loads(states[-1].data)["messages"] if states else {}
        ends = ("wire/temperature", "voltage_command")
        return min((n for topic, n in counts.items() if topic.endswith(ends)), default=0)

    for _ in range(5):
        tick()
        talker.listen(0.1)
    for _ in range(size):
        for _ in range(_PER_LEAP):
            now += _TICK
            tick()
            reading = Temperature(temperature=float(sent))
            seconds = int(now)
            reading.header.stamp.sec = seconds
            reading.header.stamp.nanosec = int((now - seconds) * 1e9)
            readings.publish(reading)
            commands.publish(Float64MultiArray(data=[float(sent % 7)]))
            sent += 1
            talker.listen(0.002)
        now += rng.choice(_LEAPS) + rng.random()
    talker.until("all is recorded", lambda: recorded() >= sent)
    now = _START - _BACK
    said = _last_words(talker, tick)
    record = read_record(bag)
    kept = np.unique(np.rint(record["wire.temperature"].values - 273.15))
    commanded = len(record["voltage_command"])
    found = f"{len(kept)} of {sent} readings, {commanded} of {sent} commands; {said[-120:]}"
    met = len(kept) == sent == commanded and "time went back" in said and "\n" not in said
    return found, met


def _last_words(talker: Talker, send: Callable[[], None]) -> str:
    """What the recorder ends with when these are sent; GaveUp if it goes on."""
    for _ in range(100):
        send()
        talker.listen(0.1)
        try:
            talker.nodes.check()
        except InputError as error:
            return str(error)
    raise GaveUp("the recorder goes on under a clock that went back")
