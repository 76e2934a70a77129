"""Simulated bench, camera and twin as nodes: rate held, jitter, latency, share of a core."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, Temperature
from std_msgs.msg import Float64MultiArray

from examination.perf.measuring import COMPOSITE, Figure, processor_of
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.parameters import read_parameters
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

RIGS = {"one wire": COMPOSITE.with_name("wire_rig.yaml"), "four wires": COMPOSITE}
NAMESPACE = "/perf"
_STARTING = 120.0  # s
RATES = (100.0, 500.0, 1000.0)
CAMERA_RATE = 80.0
PICTURE = (382, 288)
COMMAND_PERIOD = 0.05
TWIN_RATE = 500.0  # Hz


def nodes(tiny: bool = False) -> Iterator[Figure]:
    for rate in RATES[:1] if tiny else RATES:
        yield from _simulator(rate, 1.0 if tiny else 6.0)
    if not tiny:
        for name in RIGS:
            yield from _camera_nodes(name)


def twin(tiny: bool = False) -> Iterator[Figure]:
    for name in ["one wire"] if tiny else RIGS:
        yield from _twin_node(f"{name} at {TWIN_RATE:g} Hz", RIGS[name], 1.0 if tiny else 8.0)


@dataclass(frozen=True)
class Running:
    """Nodes that run, and `node`, which hears them while `spin` does its work."""

    node: Any
    processes: NodeProcesses
    pids: Mapping[str, int]

    def spin(self, until: Callable[[], Any], meanwhile: Callable[[], Any] = int) -> None:
        """Listen until the condition holds; RuntimeError if it does not within _STARTING s."""
        end = time.monotonic() + _STARTING
        while not until():
            if time.monotonic() > end:
                raise RuntimeError(f"nothing heard within {_STARTING:g} s")
            meanwhile()
            rclpy.spin_once(self.node, timeout_sec=0.01)
            self.processes.check()

    def shares(self, seconds: float, meanwhile: Callable[[], Any] = int) -> tuple[float, dict]:
        """Listen for a while: seconds it took, and the share of a core of every node."""
        before, begin = {k: processor_of(pid) for k, pid in self.pids.items()}, time.monotonic()
        self.spin(lambda: time.monotonic() - begin > seconds, meanwhile)
        elapsed = time.monotonic() - begin
        had = {k: processor_of(pid) - before[k] for k, pid in self.pids.items()}
        return elapsed, {k: used / elapsed for k, used in had.items()}


@contextmanager
def running(nodes: Mapping[str, dict], rig: Path = RIGS["one wire"]) -> Iterator[Running]:
    """Start nodes with these settings, away from every other bench."""
    private_ros_environment()
    rclpy.init(args=[])
    node = rclpy.create_node("perf", namespace=NAMESPACE)
    try:
        with TemporaryDirectory() as folder, NodeProcesses(NAMESPACE, Path(folder)) as processes:
            for name, settings in nodes.items():
                processes.start(name, settings, (rig,))
            yield Running(node, processes, {name: processes.pid(name) for name in nodes})
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _simulator(rate: float, seconds: float) -> Iterator[Figure]:
    """Alternating voltages, and when readings arrive and show them."""
    late: list[float] = []
    latencies: list[float] = []
    commanded, volts, waiting = 0.0, 0.0, False

    def take(message: Any) -> None:
        nonlocal waiting
        now = time.monotonic()
        late.append(now - message.header.stamp.sec - message.header.stamp.nanosec * 1e-9)
        if waiting and abs(message.voltage - volts) < 0.1:
            latencies.append(now - commanded)
            waiting = False

    def command() -> None:
        """Another voltage, at most every COMMAND_PERIOD, once the last one was seen."""
        nonlocal commanded, volts, waiting
        if time.monotonic() - commanded > (1.0 if waiting else COMMAND_PERIOD):
            volts = 1.0 if volts > 1.5 else 2.0
            commands.publish(Float64MultiArray(data=[volts]))
            commanded, waiting = time.monotonic(), True

    rates = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), rate)
    with running({"simulator": rates}) as bench:
        commands = bench.node.create_publisher(Float64MultiArray, "voltage_command", 10)
        bench.node.create_subscription(BatteryState, "wire/power", take, QoSProfile(depth=1000))
        bench.spin(lambda: len(latencies) > 4, command)
        late.clear()
        latencies.clear()
        elapsed, shares = bench.shares(seconds, command)
    case, held = f"simulator at {rate:g} Hz", len(late) / elapsed
    median, last = 1e3 * np.percentile(late, 50), 1e3 * np.percentile(late, 99)
    shown = 1e3 * np.percentile(latencies, (50, 99))
    yield Figure(case, "power readings a second", held, "1/s", least=0.99 * rate)
    yield Figure(case, "arrival after stamp, 99th percentile over median", last - median, "ms")
    yield Figure(case, "command to reading, median", shown[0], "ms")
    yield Figure(case, "command to reading, 99th percentile", shown[1], "ms")
    yield Figure(case, "share of a core", shares["simulator"])


def _camera_nodes(name: str, seconds: float = 8.0) -> Iterator[Figure]:
    channels = read_parameters(RIGS[name])["bench.channels"]
    regions = regions_side_by_side(len(channels), *PICTURE)
    nodes = {"synthetic_camera": {"rate": CAMERA_RATE}, "ir_camera": {"regions": regions}}
    ages: list[float] = []
    with running(nodes, RIGS[name]) as bench:
        topics = [f"{channel}/true_temperature" for channel in channels]
        warmth = [bench.node.create_publisher(Temperature, topic, 10) for topic in topics]

        def take(message: Any) -> None:
            stamp, now = message.header.stamp, bench.node.get_clock().now().nanoseconds * 1e-9
            ages.append(float(now - stamp.sec - stamp.nanosec * 1e-9))

        def heat() -> None:
            for publisher in warmth:
                publisher.publish(Temperature(temperature=77.0))

        topic = f"{NAMESPACE}/{channels[-1]}/temperature"
        bench.node.create_subscription(Temperature, topic, take, 1000)
        bench.spin(lambda: len(ages) > CAMERA_RATE, heat)
        ages.clear()
        elapsed, shares = bench.shares(seconds, heat)
    case, held, age = f"camera nodes at 80 Hz, {name}", len(ages) / elapsed, 1e3 * np.median(ages)
    yield Figure(case, "readings of the last wire a second", held, "1/s", least=0.99 * CAMERA_RATE)
    yield Figure(case, "age of a reading where it arrives, median", age, "ms")
    for node in nodes:
        yield Figure(case, f"{node}: share of a core", shares[node])


def _twin_node(case: str, rig: Path, seconds: float) -> Iterator[Figure]:
    heard: list[tuple[float, dict[str, str]]] = []

    def listen(message: Any) -> None:
        for status in message.status:
            if status.name == f"{NAMESPACE}/twin: gap":
                heard.append((time.monotonic(), {v.key: v.value for v in status.values}))

    nodes = {"twin": {}, "simulator": {"rate.power": TWIN_RATE, "rate.mechanics": TWIN_RATE}}
    with running(nodes, rig) as bench:
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
        bench.spin(lambda: heard and float(heard[-1][1]["model_time"]))
        heard.clear()
        bench.spin(lambda: heard)
        _, shares = bench.shares(seconds)
        bench.spin(lambda: len(heard) > 1)
        (first, start), (last, end) = heard[0], heard[-1]
    names = ("model_time", "restarts", "readings_late")
    model, restarts, late = (float(end[name]) - float(start[name]) for name in names)
    yield Figure(case, "model time a second", model / (last - first), "s/s", least=0.98)
    yield Figure(case, "twin began anew", restarts, "times", most=0.0)
    yield Figure(case, "readings too late", late, "readings", most=0.0)
    yield Figure(case, "twin node", shares["twin"], "cores", most=1.0)
    yield Figure(case, "simulator node", shares["simulator"], "cores")
