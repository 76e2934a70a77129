"""Other types, broken bytes and leaping clocks on the bench's topics: every node goes on."""

import json
import random
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_msgs.msg import Float64, Float64MultiArray, Header, String

from examination.campaign.bench_nodes import RELIABLE, GaveUp, Talker, bench_nodes
from examination.campaign.outcome import Outcome
from sma_bench.errors import InputError
from sma_bench.hardware.thermal_settings import regions_side_by_side
from sma_bench.records import read_record
from sma_bench.records.contract import CELSIUS_ZERO

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
}  # fmt: skip
_FOREIGN = (String, Float64, Image, Temperature)
_HEADS, _LENGTHS = (b"\0\1\0\0", b"\0\1\0\0", b"\xff\1", b""), (0, 1, 7, 40, 300)
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
            try:
                for topic, kind in topics.items():
                    # Of another type, and of the right one a CDR header, or not even that, and
                    # bytes.
                    own = talker.node.create_publisher(kind, topic, RELIABLE)
                    foreign = rng.choice([other for other in _FOREIGN if other is not kind])
                    other = talker.stranger.create_publisher(foreign, topic, RELIABLE)
                    talker.until(f"{node} listens to {topic}", own.get_subscription_count)
                    for number in range(size):
                        other.publish(foreign())
                        own.publish(rng.choice(_HEADS) + rng.randbytes(rng.choice(_LENGTHS)))
                        if number % _AT_ONCE == 0:
                            talker.listen(0.02)
                    talker.node.destroy_publisher(own)
                    talker.stranger.destroy_publisher(other)
                talker.listen(0.5)
                talker.nodes.check()
                talker.parameters_of(node)
                wrong = ""
            except Exception as error:  # that is what is looked for
                wrong = f"{type(error).__name__}: {error}"
            talker.kill(node)
            what = f"foreign types and broken bytes at {node}"
            tried, found = 2 * size * len(topics), wrong or "alive, parameters answered"
            outcomes.append(Outcome("traffic", what, tried, found, "node goes on", not wrong))
    return outcomes


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

    def stamp() -> Time:
        return Time(sec=int(now), nanosec=int((now - int(now)) * 1e9))

    def tick() -> None:
        ticks.publish(Clock(clock=stamp()))

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
            readings.publish(Temperature(header=Header(stamp=stamp()), temperature=float(sent)))
            commands.publish(Float64MultiArray(data=[float(sent % 7)]))
            sent += 1
            talker.listen(0.002)
        now += rng.choice(_LEAPS) + rng.random()
    talker.until("all is recorded", lambda: recorded() >= sent)

    # The leap back ends it.
    now, said = _START - _BACK, ""
    for _ in range(100):
        tick()
        talker.listen(0.1)
        try:
            talker.nodes.check()
        except InputError as error:
            said = str(error)
            break
    record = read_record(bag)
    kept = np.unique(np.rint(record["wire.temperature"].values - CELSIUS_ZERO))
    commanded = len(record["voltage_command"])
    found = f"{len(kept)} of {sent} readings, {commanded} of {sent} commands; {said[-120:]}"
    met = len(kept) == sent == commanded and "time went back" in said and "\n" not in said
    return found, met
