"""Simulated bench, camera and twin as nodes: rate held, latency, share of a core; a whole bench as
processes and as one: start, memory."""

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, Temperature
from std_msgs.msg import Float64MultiArray

from examination.perf.measuring import COMPOSITE, Figure, processor_of
from examination.pieces import ros_node
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.lifeline import tied_to_this_process
from sma_bench.nodes import bench_plan
from sma_bench.parameters import read_parameters
from sma_bench.ros.node import seconds_of, stamp_of
from sma_bench.ros.processes import NodeProcesses, parameter_arguments, private_ros_environment

RIGS = {"one wire": COMPOSITE.with_name("wire_rig.yaml"), "four wires": COMPOSITE}
NAMESPACE = "/perf"
_STARTING, COMMAND_PERIOD = 120.0, 0.05  # s
RATES, CAMERA_RATE, TWIN_RATE = (100.0, 500.0, 1000.0), 80.0, 500.0  # Hz
PICTURE = (382, 288)


def nodes(tiny: bool = False) -> Iterator[Figure]:
    for rate in RATES[:1] if tiny else RATES:
        yield from _simulator(rate, 1.0 if tiny else 6.0)
    for name in () if tiny else RIGS:
        yield from _camera_nodes(name)


def twin(tiny: bool = False) -> Iterator[Figure]:
    for name in ["one wire"] if tiny else RIGS:
        yield from _twin_node(f"{name} at {TWIN_RATE:g} Hz", RIGS[name], 1.0 if tiny else 8.0)


class Running(NamedTuple):
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
    with (ros_node("perf", NAMESPACE) as node, TemporaryDirectory() as folder,
          NodeProcesses(NAMESPACE, Path(folder)) as processes):
        for name, settings in nodes.items():
            processes.start(name, settings, (rig,))
        yield Running(node, processes, {name: processes.pid(name) for name in nodes})


# What any two nodes of rclpy take: one publishes what it has heard.
BARE = """
import rclpy, sys
from sma_bench.lifeline import end_with_parent
end_with_parent()
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64MultiArray
rclpy.init(args=[])
node = rclpy.create_node("bare", namespace=sys.argv[1])
answers = node.create_publisher(BatteryState, "bare/power", 10)
def answer(message):
    answers.publish(BatteryState(voltage=message.data[0]))
node.create_subscription(Float64MultiArray, "bare/command", answer, 10)
rclpy.spin(node)
"""


class _Asked:
    """One that is sent a voltage and answers with readings; `latencies` in s."""

    def __init__(self, bench: Running, command: str, reading: str) -> None:
        self.latencies: list[float] = []
        self._volts, self._sent, self._waiting = 0.0, 0.0, False
        self._commands = bench.node.create_publisher(Float64MultiArray, command, 10)
        bench.node.create_subscription(BatteryState, reading, self.take, QoSProfile(depth=1000))

    def take(self, message: Any) -> None:
        if self._waiting and abs(message.voltage - self._volts) < 0.1:
            self.latencies.append(time.monotonic() - self._sent)
            self._waiting = False

    def ask(self) -> None:
        """Send another voltage, at most every COMMAND_PERIOD, once the last one was seen."""
        if time.monotonic() - self._sent > (1.0 if self._waiting else COMMAND_PERIOD):
            self._volts = 1.0 if self._volts > 1.5 else 2.0
            self._sent, self._waiting = time.monotonic(), True
            self._commands.publish(Float64MultiArray(data=[self._volts]))


def _simulator(rate: float, seconds: float) -> Iterator[Figure]:
    """Alternating voltages, and when readings arrive and show them; beside a bare pair of nodes."""
    late: list[float] = []
    rates = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), rate)
    with running({"simulator": rates}) as bench:
        pair = subprocess.Popen([sys.executable, "-c", BARE, NAMESPACE], env=tied_to_this_process())
        try:
            both = simulated, bare = (_Asked(bench, "voltage_command", "wire/power"),
                                      _Asked(bench, "bare/command", "bare/power"))
            bench.node.create_subscription(BatteryState, "wire/power",
                                           lambda m: late.append(time.time() - seconds_of(m)), 1000)

            def ask() -> None:
                for one in both:
                    one.ask()

            bench.spin(lambda: min(len(one.latencies) for one in both) > 4, ask)
            for found in (late, simulated.latencies, bare.latencies):
                found.clear()
            elapsed, shares = bench.shares(seconds, ask)
            held = len(late) / elapsed
            bench.spin(lambda: min(len(one.latencies) for one in both) > 4, ask)  # a busy machine
        finally:
            pair.kill()
            pair.wait()
    case = f"simulator at {rate:g} Hz"
    yield Figure(case, "power readings a second", held, "1/s", least=0.99 * rate)
    yield from _latency(case, "arrival after stamp", late)
    yield from _latency(case, "command to reading", simulated.latencies)
    yield from _latency(case, "bare pair of rclpy: command to reading", bare.latencies)
    yield Figure(case, "share of a core", shares["simulator"])


def _latency(case: str, what: str, seconds: list[float]) -> Iterator[Figure]:
    for share in (50, 99):
        value = 1e3 * float(np.percentile(seconds, share))
        yield Figure(case, f"{what}, {share} %", value, "ms")


# --- A whole bench, as its launch file plans it.
SIX = {"nodes": "identification,diagnosis", "twin": "true"}
MEMORY, START = 350.0, 1.5  # MB and s of a bench in one process


def bench(tiny: bool = False) -> Iterator[Figure]:
    """Six nodes as processes, and in one process."""
    for case, container in (("six processes", "false"), ("one process", "true")):
        private_ros_environment()
        with TemporaryDirectory() as name:
            given = {**SIX, "container": container, "output": str(Path(name, "bag"))}
            plan = bench_plan.plan_bench(bench_plan.COMPOSITE, given)
            yield from _whole_bench(case, plan, Path(name), *((1.0, 1) if tiny else (6.0, 5)))


def _whole_bench(case: str, plan: list[bench_plan.PlannedNode], folder: Path, seconds: float,
                 times: int) -> Iterator[Figure]:
    heard, starts = list[float](), list[tuple[float, float]]()
    processes: list[subprocess.Popen[bytes]] = []
    with ros_node("perf", NAMESPACE) as node:
        try:
            topic, qos = f"{NAMESPACE}/front_1/power", QoSProfile(depth=1000)
            node.create_subscription(BatteryState, topic, lambda _: heard.append(time.monotonic()),
                                     qos)
            for k in range(times):
                _stop(processes)
                shutil.rmtree(folder / "bag", ignore_errors=True)
                starts.append(_start(processes, plan, folder / f"{k}.log"))
            end = time.monotonic() + 1.0
            while time.monotonic() < end or not heard:  # until they know of each other
                rclpy.spin_once(node, timeout_sec=0.01)
            heard.clear()
            before, begin = sum(processor_of(p.pid) for p in processes), time.monotonic()
            while (elapsed := time.monotonic() - begin) < seconds:
                rclpy.spin_once(node, timeout_sec=0.01)
            used = sum(processor_of(process.pid) for process in processes) - before
            # MB: all that each has, and of shared pages its part.
            resident, own = (sum(_memory(process.pid, kind) for process in processes)
                             for kind in ("Rss", "Pss"))
        finally:
            _stop(processes)
    whole = case == "one process"
    start, spent = np.median(starts, axis=0).tolist()
    yield Figure(case, f"start, until all are ready, median of {times}", start, "s",
                 most=START if whole else np.inf)
    yield Figure(case, "processor until then", spent, "s")
    yield Figure(case, "memory, of each its own and shared pages", resident, "MB")
    yield Figure(case, "memory, shared pages once", own, "MB", most=MEMORY if whole else np.inf)
    yield Figure(case, "power readings a second", len(heard) / elapsed, "1/s", least=99.0)
    yield Figure(case, "share of a core at rest", used / elapsed)


def _start(processes: list[subprocess.Popen[bytes]], plan: list[bench_plan.PlannedNode],
           log: Path) -> tuple[float, float]:
    """Start the bench's processes; s until all six nodes are ready, and s of the processor."""
    begin = time.monotonic()
    for planned in plan:
        words = [sys.executable, "-m", "sma_bench.nodes.start", planned.executable]
        words += [*planned.arguments, "--ros-args", "-r", f"__ns:={NAMESPACE}"]
        words += ["--params-file", planned.file, *parameter_arguments(planned.parameters)]
        with log.open("ab") as out:
            processes.append(subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT,
                                              env=tied_to_this_process()))
    while log.read_text().count("]: ready") < 6:
        if time.monotonic() - begin > _STARTING or any(p.poll() is not None for p in processes):
            raise RuntimeError(f"the bench did not start: {log.read_text()[-400:]}")
        time.sleep(0.01)
    return time.monotonic() - begin, sum(processor_of(process.pid) for process in processes)


def _stop(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        process.send_signal(2)
    while processes:
        processes.pop().wait()


def _memory(pid: int, kind: str) -> float:
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) / 1e3 for line in lines if line.startswith(f"{kind}:"))


def _camera_nodes(name: str, seconds: float = 8.0) -> Iterator[Figure]:
    channels = read_parameters(RIGS[name])["bench.channels"]
    regions = regions_side_by_side(len(channels), *PICTURE)
    nodes = {"synthetic_camera": {"rate": CAMERA_RATE}, "ir_camera": {"regions": regions}}
    ages: list[float] = []
    with running(nodes, RIGS[name]) as bench:
        warmth = [bench.node.create_publisher(Temperature, f"{channel}/true_temperature", 10)
                  for channel in channels]

        def take(message: Any) -> None:
            ages.append(1e-9 * (bench.node.get_clock().now().nanoseconds - stamp_of(message)))

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
