"""Nodes under faults: foreign traffic, kills in every order, hours of a bench in virtual time. Each
campaign is a function of its size, a seed and a folder."""

import contextlib
import os
import random
import re
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
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_msgs.msg import Float64, Float64MultiArray, String

from examination.campaign import Outcome, counted
from examination.pieces import ros_node
from sma_bench.errors import InputError
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.records import read_record
from sma_bench.ros.bench_client import NodeCalls
from sma_bench.ros.node import LATCHED
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/campaign"
NODES = ("simulator", "experiment", "recorder")
PATIENCE = 120.0  # s. The machine may be busy: start times of nodes are not judged.
RELIABLE = QoSProfile(depth=2000)


class Talker(NodeCalls):
    """The campaign's own node, and the processes of the nodes under test."""

    def __init__(self, node: Node, nodes: NodeProcesses) -> None:
        super().__init__(node, self._look)
        self.node, self.nodes = node, nodes

    def _look(self) -> None:
        self.nodes.check()
        rclpy.spin_once(self.node, timeout_sec=0.01)

    def until(self, what: str, condition: Callable[[], Any]) -> Any:
        return self.wait(what, condition, PATIENCE)

    def listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.005)

    def heard(self, topic: str, kind: type, latched: bool = False) -> list[Any]:
        """The list of messages of a topic; it grows while this node spins."""
        messages: list[Any] = []
        qos = LATCHED if latched else RELIABLE
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def kill(self, name: str) -> None:
        """Kill a node by SIGKILL."""
        with contextlib.suppress(ProcessLookupError):  # it has ended already
            os.kill(self.nodes.pid(name), signal.SIGKILL)
        self.nodes.end(name)

    def until_done(self, what: str, work: Callable[[], Any]) -> None:
        """Repeat a call until it succeeds: a killed node stays in the ROS graph for 20 s, and until
        its successor has started, a request is lost."""
        done: list[Any] = []

        def is_done() -> list[Any]:
            with contextlib.suppress(InputError):
                done.append(work())
            return done

        self.until(what, is_done)

    def until_served(self, node: str) -> None:
        self.until_done(f"{node} answers", lambda: self.set_parameters(node, {}, 2.0))


@contextlib.contextmanager
def bench_nodes(logs: Path) -> Iterator[Talker]:
    """A ROS context isolated from every other bench, for a `with` block."""
    private_ros_environment()
    # Compile the physics first: then a node starts in a second or two, otherwise in a minute.
    settings = {parameter.name: parameter.default for parameter in NODE_TABLES["simulator"]}
    list(VirtualBench(Parameters.defaults(), settings).advance((1.0,), 10**8))
    logs.mkdir(parents=True, exist_ok=True)
    with ros_node("campaign", NAMESPACE) as node, NodeProcesses(NAMESPACE, logs) as nodes:
        yield Talker(node, nodes)


# --- Nodes killed and started again in every order: 0 V meanwhile, and the bench works afterwards.
# s: the contract's command timeout, the delay of a busy machine, and how much a killed recorder may
# lose.
_TIMEOUT, _SLACK, _TO_DISK = 0.5, 1.0, 1.5
_VOLTS = 1.0
_HOLD = f"name: hold\nsteps:\n- {{kind: hold, name: warm, level: {_VOLTS}, duration: 600.0}}\n"
# Every order of killing, combined with every order of restarting.
ORDERS = list(product(permutations(NODES), repeat=2))


def restarted_nodes(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` of the 36 pairs of orders, spread evenly."""
    wrong, what = [], "kill -9 and start again, all orders of three nodes"
    for k in range(size):
        end, begin = ORDERS[(seed + k * len(ORDERS) // size) % len(ORDERS)]
        try:
            with bench_nodes(folder / f"{k}" / "logs") as talker:
                wrong.append(_restart(talker, end, begin, folder / f"{k}"))
        except Exception as error:  # any exception is a finding
            wrong.append(f"killed {end}, started {begin}: {type(error).__name__}: {error}")
    limit = "0 V while driven by nobody, works again, both bags read"
    return [counted(what, size, wrong, limit)]


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
        # Readings reach each node after a different time.
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
    talker.listen(0.5)  # messages that the killed node sent
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


# --- Other types and broken bytes on the bench's topics: every node must go on.
# A node, and its subscribed topics with their types.
LISTENERS: dict[str, dict[str, type]] = {
    "simulator": {"voltage_command": Float64MultiArray},
    "experiment": {"wire/power": BatteryState, "wire/temperature": Temperature},
    "temperature_controller": {"wire/power": BatteryState, "wire/temperature": Temperature,
                               "temperature_controller/reference": Float64MultiArray},
    "ir_camera": {"thermal_image": Image}}
_CAMERA = {"image_width": 64, "image_height": 48, "regions": list(regions_side_by_side(1, 64, 48))}
_FOREIGN = (String, Float64, Image, Temperature)
_HEADS, _LENGTHS = (b"\0\1\0\0", b"\0\1\0\0", b"\xff\1", b""), (0, 1, 7, 40, 300)
_AT_ONCE = 20  # messages before the next spin


def foreign_traffic(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` messages of other types, and as many with broken bytes, on every topic."""
    rng, outcomes = random.Random(seed), []
    # DDS allows a program only one type per topic: another context sends the other types.
    with (bench_nodes(folder / "logs") as talker,
          ros_node("stranger", NAMESPACE, context=rclpy.Context()) as stranger):
        for node, topics in LISTENERS.items():
            talker.nodes.start(node, _CAMERA if node == "ir_camera" else {})
            found, met = "alive, parameters answered", True
            try:
                for topic, kind in topics.items():
                    # Another type; and random bytes as the right type, with or without CDR header.
                    own = talker.node.create_publisher(kind, topic, RELIABLE)
                    foreign = rng.choice([other for other in _FOREIGN if other is not kind])
                    other = stranger.create_publisher(foreign, topic, RELIABLE)
                    talker.until(f"{node} listens to {topic}", own.get_subscription_count)
                    for number in range(size):
                        other.publish(foreign())
                        own.publish(rng.choice(_HEADS) + rng.randbytes(rng.choice(_LENGTHS)))
                        if number % _AT_ONCE == 0:
                            talker.listen(0.02)
                    talker.node.destroy_publisher(own)
                    stranger.destroy_publisher(other)
                talker.listen(0.5)
                talker.nodes.check()
                talker.until_served(node)
            except Exception as error:  # any exception is a finding
                found, met = f"{type(error).__name__}: {error}", False
            talker.kill(node)
            what, tried = f"foreign types and broken bytes at {node}", 2 * size * len(topics)
            outcomes.append(Outcome(what, tried, found, "node goes on", met))
    return outcomes


# --- Hours of a bench in virtual time: memory must not grow, measured in MB per hour of the bench.
# Simulator, experiment and recorder run in lockstep, faster than real time; the recorder writes
# everything. Growth that depends on wall time shows less here than in reality.
#
# MB/h: a day adds 0.2 GB and a week 1.3 GB, which fits beside the bench in a computer of 2 GB.
# The index of a bag, which must grow, takes 5 to 7 of it.
LIMIT = 8.0
_SPEED, _LOOK_EVERY = 1000.0, 0.5  # times real time; s
_SHORTEST = 60  # minutes: half of it to warm up, and half to measure the slope
_WARM_UP = 0.5  # h: middleware and allocator keep the memory of a peak
_TRIANGLES = """{name: soak, repeat: 5000, steps: [
  {kind: triangle, name: heat, peak: 6.0, rise: 20.0, fall: 20.0}, {kind: rest, duration: 20.0}]}
"""


def soak(size: int, _: int, folder: Path) -> list[Outcome]:
    """`size` minutes of the bench's time, an hour at least."""
    protocol = folder / "soak.yaml"
    protocol.write_text(_TRIANGLES)
    seconds, hours = 60.0 * max(size, _SHORTEST), []
    held: dict[str, list[float]] = {node: [] for node in NODES}
    clock: deque[float] = deque([0.0], maxlen=1)  # the latest; /clock is sent with every command
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
        begin = clock[-1]
        while (now := clock[-1]) - begin < seconds:
            talker.until("the bench's time goes on", lambda now=now: clock[-1] > now)
            talker.listen(_LOOK_EVERY)
            talker.nodes.check()
            hours.append((clock[-1] - begin) / 3600.0)
            for node in NODES:
                # Private memory only: the system can drop pages of files and read them again.
                status = Path(f"/proc/{talker.nodes.pid(node)}/status").read_text()
                kilobytes = re.findall(r"(?:RssAnon|RssShmem):\s*(\d+)", status)
                held[node].append(sum(map(int, kilobytes)) * 1.024e-3)
            del states[:-5]
    shutil.rmtree(folder / "bag", ignore_errors=True)
    outcomes, limit = [], f"{LIMIT:g} MB/h"
    for node, megabytes in held.items():
        slope = growth(np.array(hours), np.array(megabytes))
        found = f"{megabytes[-1]:.0f} MB after {hours[-1]:.2f} h, slope {slope:+.2f} MB/h"
        what = f"memory of {node}"
        outcomes.append(Outcome(what, len(hours), found, limit, slope < LIMIT))
    return outcomes


def growth(hours: np.ndarray, megabytes: np.ndarray) -> float:
    """MB per hour after the warm-up, from its first to its last third, as memory grows in steps."""
    warm = min(_WARM_UP, 0.5 * hours[-1])
    early = (hours >= warm) & (hours < warm + (hours[-1] - warm) / 3.0)
    late = hours > hours[-1] - (hours[-1] - warm) / 3.0
    risen = megabytes[late].mean() - megabytes[early].mean()
    return float(risen / (hours[late].mean() - hours[early].mean()))
