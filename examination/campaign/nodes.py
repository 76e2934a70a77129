"""Nodes under faults: recorders killed, foreign traffic, kills in every order, hours of a bench in
virtual time. A campaign is called with its size, a seed and a folder."""

import contextlib
import itertools
import json
import os
import random
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from scipy import stats
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_msgs.msg import Float64, Float64MultiArray, Header, String

from examination.pieces import Outcome, ros_node
from sma_bench.errors import InputError
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.records import read_record
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.ros.bench_client import NodeCalls
from sma_bench.ros.node import LATCHED
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/campaign"
NODES = ("simulator", "experiment", "recorder")
PATIENCE = 120.0  # s. The machine may be busy: what is judged is never how soon a node is up.
RELIABLE = QoSProfile(depth=2000)


class Talker(NodeCalls):
    """The campaign's own node, another of another program, and the processes beside them. DDS lets
    no program have two types on a topic: that is for the `stranger`."""

    def __init__(self, node: Node, stranger: Node, nodes: NodeProcesses) -> None:
        super().__init__(node, self._look)
        self.node, self.stranger, self.nodes = node, stranger, nodes

    def _look(self) -> None:
        self.nodes.check()
        rclpy.spin_once(self.node, timeout_sec=0.01)

    def until(self, what: str, condition: Callable[[], Any]) -> Any:
        return self.wait(what, condition, PATIENCE)

    def listen(self, seconds: float, meanwhile: Callable[[], None] = lambda: None) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.005)

    def heard(self, topic: str, kind: type, latched: bool = False) -> list[Any]:
        """Messages of a topic, growing while this spins."""
        messages: list[Any] = []
        qos = LATCHED if latched else RELIABLE
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def kill(self, name: str) -> None:
        """End a node without a warning."""
        with contextlib.suppress(ProcessLookupError):  # it has ended by itself
            os.kill(self.nodes.pid(name), signal.SIGKILL)
        self.nodes.end(name)

    def until_done(self, what: str, work: Callable[[], Any]) -> None:
        """Try until a call of a node succeeds: one that was killed is in the graph for another
        20 s, and a request then goes to nobody where its successor is not there yet."""

        def is_done() -> bool:
            with contextlib.suppress(InputError):
                work()
                return True
            return False

        self.until(what, is_done)

    def until_served(self, node: str) -> None:
        self.until_done(f"{node} answers", lambda: self.set_parameters(node, {}, 2.0))


@contextlib.contextmanager
def bench_nodes(logs: Path) -> Iterator[Talker]:
    """A ROS context away from every other bench, for the time of a `with`."""
    private_ros_environment()
    # Physics compile once, here: a node that finds it done is up in a second or two, else a minute.
    settings = {parameter.name: parameter.default for parameter in NODE_TABLES["simulator"]}
    list(VirtualBench(Parameters.defaults(), settings).advance((1.0,), 10**8))
    logs.mkdir(parents=True, exist_ok=True)
    with (ros_node("campaign", NAMESPACE) as node,
          ros_node("stranger", NAMESPACE, context=rclpy.Context()) as stranger,
          NodeProcesses(NAMESPACE, logs) as nodes):
        yield Talker(node, stranger, nodes)


# --- Recorders killed at random times: nothing older than a second is lost, and the bag is read.
ALLOWED = 1.0  # s
_LATEST_KILL = 3.0  # s after the first message is recorded


def killed_recorder(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Kill `size` recorder nodes while they record."""
    rng, lost, bag = random.Random(seed), [], folder / "bag"
    with bench_nodes(folder / "logs") as talker:
        for _ in range(size):
            shutil.rmtree(bag, ignore_errors=True)
            publisher = talker.node.create_publisher(Temperature, "wire/temperature", RELIABLE)
            states = talker.heard("recorder/state", String)
            talker.nodes.start("recorder", {"output": str(bag)})
            talker.until("the recorder subscribes", publisher.get_subscription_count)
            began, number = time.time(), itertools.count()

            def publish(publisher: Any = publisher, number: Iterator[int] = number) -> None:
                seconds, nanoseconds = divmod(time.time_ns(), 10**9)
                header = Header(stamp=Time(sec=seconds, nanosec=nanoseconds))
                publisher.publish(Temperature(header=header, temperature=float(next(number))))

            def recorded(states: list[Any] = states, publish: Callable = publish) -> int:
                publish()
                return sum(json.loads(states[-1].data)["messages"].values()) if states else 0

            talker.until("something is recorded", recorded)
            talker.listen(rng.uniform(0.0, _LATEST_KILL), publish)
            killed = time.time()
            talker.kill("recorder")
            talker.node.destroy_publisher(publisher)
            lost.append(lost_seconds(bag, killed, began))
    found = f"lost at most {max(lost):.2f} s, {np.median(lost):.2f} s in the median"
    return [Outcome("killed", "recorder node killed with -9", size, found, f"{ALLOWED:g} s",
                    max(lost) <= ALLOWED)]


def lost_seconds(bag: Path, killed: float, began: float) -> float:
    """s from the last message in the bag to the kill (times in s since the epoch). A bag that
    cannot be read has lost all since it `began`; one that lacks a number in between, infinity."""
    try:
        record = read_record(bag)
        temperature = record["wire.temperature"]
    except InputError:
        return max(0.0, killed - began)
    if (np.diff(np.rint(temperature.values - CELSIUS_ZERO)) != 1).any():
        return np.inf
    return killed - (record.start_ns * 1e-9 + float(temperature.time[-1]))


# --- Nodes killed and started again in every order: 0 V meanwhile, and the bench works afterwards.
# s: the contract's command timeout, what a busy machine needs to notice, and what a killed recorder
# may lose.
_TIMEOUT, _SLACK, _TO_DISK = 0.5, 1.0, 1.5
_VOLTS = 1.0
_HOLD = f"name: hold\nsteps:\n- {{kind: hold, name: warm, level: {_VOLTS}, duration: 600.0}}\n"
# Every order of killing with every order of starting again.
ORDERS = list(product(permutations(NODES), repeat=2))


def restarted_nodes(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` of the 36 pairs of orders, spread evenly."""
    wrong, what = [], "kill -9 and start again, all orders of three nodes"
    for k in range(size):
        end, begin = ORDERS[(seed + k * len(ORDERS) // size) % len(ORDERS)]
        try:
            with bench_nodes(folder / f"{k}" / "logs") as talker:
                wrong.append(_restart(talker, end, begin, folder / f"{k}"))
        except Exception as error:  # that is what is looked for
            wrong.append(f"killed {end}, started {begin}: {type(error).__name__}: {error}")
    limit = "0 V while driven by nobody, works again, both bags read"
    return [Outcome.of("restarts", what, size, wrong, limit)]


def _restart(talker: Talker, end: tuple[str, ...], begin: tuple[str, ...], folder: Path) -> str:
    """What went wrong, or ""."""
    protocol = folder / "hold.yaml"
    protocol.write_text(_HOLD)
    bags = iter([folder / "before", folder / "after"])
    powers = talker.heard("wire/power", BatteryState)
    recorders = talker.heard("recorder/state", String, latched=True)

    def start(name: str) -> None:
        own = {"experiment": {"protocol": str(protocol)}}.get(name, {})
        talker.nodes.start(name, {"output": str(next(bags))} if name == "recorder" else own)

    def drive() -> None:
        powers.clear()
        talker.until("readings", lambda: powers)
        talker.until("recorded", lambda: recorders and "wire/power" in recorders[-1].data)
        talker.until_served("experiment")
        # Readings reach each node in its own time.
        talker.until_done("a start", lambda: talker.trigger("experiment/start", PATIENCE))
        talker.until("driven", lambda: powers[-1].voltage > 0.5 * _VOLTS)
        talker.listen(_TO_DISK)

    for name in NODES:
        start(name)
    drive()
    for name in end:
        talker.kill(name)
        if name == "experiment" and "simulator" in end[end.index(name) + 1 :]:
            killed = time.monotonic()
            talker.until("0 V", lambda: powers[-1].voltage < 0.1 * _VOLTS)
            if (took := time.monotonic() - killed) > _TIMEOUT + _SLACK:
                return f"outputs on for {took:.2f} s after the experiment was killed"
    recorders.clear()
    for name in begin:
        start(name)
    talker.listen(0.5)  # what the killed one sent
    powers.clear()
    talker.until("readings again", lambda: len(powers) > 5)
    if max(power.voltage for power in powers) > 0.1 * _VOLTS:
        return "driven without a start"
    drive()
    for name in NODES[::-1]:
        talker.nodes.end(name)
    for bag in ("before", "after"):
        if read_record(folder / bag)["wire.voltage"].values.max() < 0.5 * _VOLTS:
            return f"the drive is not in the bag {bag}"
    return ""


# --- Other types and broken bytes on the bench's topics: every node goes on.
# A node, and the topics that it listens to with their own type.
LISTENERS: dict[str, dict[str, type]] = {
    "simulator": {"voltage_command": Float64MultiArray},
    "experiment": {"wire/power": BatteryState, "wire/temperature": Temperature},
    "temperature_controller": {"wire/power": BatteryState, "wire/temperature": Temperature,
                               "temperature_controller/reference": Float64MultiArray},
    "ir_camera": {"thermal_image": Image}}
_CAMERA = {"image_width": 64, "image_height": 48, "regions": list(regions_side_by_side(1, 64, 48))}
_FOREIGN = (String, Float64, Image, Temperature)
_HEADS, _LENGTHS = (b"\0\1\0\0", b"\0\1\0\0", b"\xff\1", b""), (0, 1, 7, 40, 300)
_AT_ONCE = 20  # messages


def foreign_traffic(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` messages of other types and as many of broken bytes on every topic."""
    rng, outcomes = random.Random(seed), []
    with bench_nodes(folder / "logs") as talker:
        for node, topics in LISTENERS.items():
            talker.nodes.start(node, _CAMERA if node == "ir_camera" else {})
            found, met = "alive, parameters answered", True
            try:
                for topic, kind in topics.items():
                    # Of another type, and of the right one a CDR header, or not that, and bytes.
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
                talker.until_served(node)
            except Exception as error:  # that is what is looked for
                found, met = f"{type(error).__name__}: {error}", False
            talker.kill(node)
            what, tried = f"foreign types and broken bytes at {node}", 2 * size * len(topics)
            outcomes.append(Outcome("traffic", what, tried, found, "node goes on", met))
    return outcomes


# --- Hours of a bench in virtual time: memory stays flat, as a slope in MB an hour of the bench.
#
# Simulator, experiment and recorder in step with one another and faster than life, the recorder
# writing all that is published. What grows with the computer's time and not with the bench's shows
# less here than in life: of that there is the index of the recorder's chunks, 0.7 to 0.9 kB for
# each of two chunks a second.
#
# MB/h: a day adds 0.2 GB and a week 1.3 GB, which a small computer of 2 GB bears beside the bench.
# The index of a bag, which has to grow, takes 5 to 7 of it.
LIMIT = 8.0
_SPEED, _LOOK_EVERY = 1000.0, 0.5  # times life; s
_SHORTEST = 60  # minutes: half of it to warm up, and as much to see a slope
# h. Memory follows the most that ever waited between two nodes: middleware and allocator keep what
# a busy moment took. Such moments come again, but rarely a worse one.
_WARM_UP = 0.5
_PARTS, _FEWEST_PARTS = 10, 5
_TRIANGLES = """\
name: soak
description: triangles for ever
repeat: 5000
steps:
  - {kind: triangle, name: heat, peak: 6.0, rise: 20.0, fall: 20.0}
  - {kind: rest, duration: 20.0}
"""


def soak(size: int, _: int, folder: Path) -> list[Outcome]:
    """`size` minutes of the bench's time, an hour at least."""
    protocol = folder / "soak.yaml"
    protocol.write_text(_TRIANGLES)
    seconds, hours = 60.0 * max(size, _SHORTEST), []
    held: dict[str, list[float]] = {node: [] for node in NODES}
    clock: deque[float] = deque([0.0], maxlen=1)  # the newest; /clock ticks with every command
    settings = ({"speed": _SPEED}, {"protocol": str(protocol), "use_sim_time": True},
                {"output": str(folder / "bag"), "use_sim_time": True})  # fmt: skip
    with bench_nodes(folder / "logs") as talker:
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        talker.node.create_subscription(
            Clock, "/clock", lambda t: clock.append(t.clock.sec + t.clock.nanosec / 1e9), qos)
        states = talker.heard("experiment/state", String, latched=True)
        for node, own in zip(NODES, settings, strict=True):
            talker.nodes.start(node, own)
        talker.until("the simulator's clock, an idle experiment", lambda: clock[-1] and states)
        talker.trigger("experiment/start", PATIENCE)
        begin = moved = clock[-1]
        due = still = time.monotonic()
        while (now := clock[-1]) - begin < seconds:
            talker.listen(0.05)
            talker.nodes.check()
            if now > moved:
                moved, still = now, time.monotonic()
            if time.monotonic() - still > PATIENCE:
                raise InputError(f"the bench's time stands still after {now - begin:.0f} s")
            if time.monotonic() >= due:
                due += _LOOK_EVERY
                hours.append((now - begin) / 3600.0)
                for node in NODES:
                    # What it cannot give back: pages of files are dropped and read again at will.
                    lines = Path(f"/proc/{talker.nodes.pid(node)}/status").read_text().splitlines()
                    has = dict(line.split(":", 1) for line in lines)
                    kilobytes = (int(has[n].split()[0]) for n in ("RssAnon", "RssShmem"))
                    held[node].append(sum(kilobytes) * 1.024e-3)
            del states[:-5]
    shutil.rmtree(folder / "bag", ignore_errors=True)
    judged = {node: judge(np.array(hours), np.array(held[node])) for node in NODES}
    return [Outcome("soak", f"memory of {node}", len(hours), found, f"{LIMIT:g} MB/h", met)
            for node, (found, met) in judged.items()]


def judge(hours: np.ndarray, megabytes: np.ndarray) -> tuple[str, bool]:
    """What was found, and whether it shows that MB an hour after the warm-up are below the limit,
    with half of their interval of 95 %. The line goes through the means of parts of equal time:
    memory is a staircase, in which a look says what the one before it said, and the looks are not
    evenly spread over the bench's time."""
    edges = np.linspace(min(_WARM_UP, 0.5 * hours[-1]), hours[-1], _PARTS + 1)
    part = np.minimum(np.searchsorted(edges, hours, side="right") - 1, _PARTS - 1)
    parts = [part == k for k in range(_PARTS) if k in part]
    slope, doubt = np.nan, np.nan
    if len(parts) >= _FEWEST_PARTS:
        means = [(hours[p].mean(), megabytes[p].mean()) for p in parts]
        fit = stats.linregress(*np.transpose(means))
        slope, doubt = fit.slope, stats.t.ppf(0.975, len(parts) - 2) * fit.stderr
    slow = f"slope {slope:+.2f} +- {doubt:.2f} MB/h"
    return f"{megabytes[-1]:.0f} MB after {hours[-1]:.2f} h, {slow}", bool(slope + doubt < LIMIT)
