"""The simulated bench as a node: achieved rate, latency, share of a core."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64MultiArray

from examination.perf.measuring import CONFIG, Figure
from examination.pieces import ros_node
from sma_bench.lifeline import tied_to_this_process
from sma_bench.ros.node import seconds_of
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

RIG = CONFIG / "wire_rig.yaml"
NAMESPACE = "/perf"
PATIENCE, COMMAND_PERIOD = 120.0, 0.05  # s
RATES = (100.0, 500.0, 1000.0)  # Hz
# The minimum of any two rclpy nodes, for comparison: one publishes what it receives.
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
    """A node that answers a voltage with readings; `latencies` in s."""

    def __init__(self, node: Any, command: str, reading: str) -> None:
        self.latencies: list[float] = []
        self._volts, self._sent, self._waiting = 0.0, 0.0, False
        self._commands = node.create_publisher(Float64MultiArray, command, 10)
        node.create_subscription(BatteryState, reading, self.take, QoSProfile(depth=1000))

    def take(self, message: Any) -> None:
        if self._waiting and abs(message.voltage - self._volts) < 0.1:
            self.latencies.append(time.monotonic() - self._sent)
            self._waiting = False

    def ask(self) -> None:
        """Send the next voltage once the last was answered, at most every COMMAND_PERIOD."""
        if time.monotonic() - self._sent > (1.0 if self._waiting else COMMAND_PERIOD):
            self._volts = 1.0 if self._volts > 1.5 else 2.0
            self._sent, self._waiting = time.monotonic(), True
            self._commands.publish(Float64MultiArray(data=[self._volts]))


def nodes(tiny: bool = False) -> Iterator[Figure]:
    """Time from alternating voltages to readings that show them; also for a bare pair of nodes."""
    for rate in RATES[:1] if tiny else RATES:
        private_ros_environment()
        with (ros_node("perf", NAMESPACE) as node, TemporaryDirectory() as folder,
              NodeProcesses(NAMESPACE, Path(folder)) as processes):
            yield from _simulator(node, processes, rate, 1.0 if tiny else 6.0)


def _simulator(node: Any, processes: NodeProcesses, rate: float,
               seconds: float) -> Iterator[Figure]:
    late: list[float] = []
    rates = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), rate)
    processes.start("simulator", rates, (RIG,))
    simulated = _Asked(node, "voltage_command", "wire/power")
    bare = _Asked(node, "bare/command", "bare/power")
    node.create_subscription(BatteryState, "wire/power",
                             lambda message: late.append(time.time() - seconds_of(message)), 1000)

    def spin(until: Callable[[], bool]) -> None:
        """Send and receive until the condition holds. RuntimeError: timeout."""
        end = time.monotonic() + PATIENCE
        while not until():
            if time.monotonic() > end:
                raise RuntimeError(f"nothing heard within {PATIENCE:g} s")
            simulated.ask()
            bare.ask()
            rclpy.spin_once(node, timeout_sec=0.01)
            processes.check()

    def both_answer() -> bool:
        return min(len(simulated.latencies), len(bare.latencies)) > 4

    pair = subprocess.Popen([sys.executable, "-c", BARE, NAMESPACE], env=tied_to_this_process())
    try:
        spin(both_answer)
        for found in (late, simulated.latencies, bare.latencies):
            found.clear()
        pid, begin = processes.pid("simulator"), time.monotonic()
        before = _processor_of(pid)
        spin(lambda: time.monotonic() - begin > seconds)
        elapsed = time.monotonic() - begin
        held, used = len(late) / elapsed, _processor_of(pid) - before
        spin(both_answer)  # a busy machine
    finally:
        pair.kill()
        pair.wait()
    case = f"simulator at {rate:g} Hz"
    yield Figure(case, "power readings a second", held, "1/s", least=0.99 * rate)
    for what, times in (("arrival after stamp", late), ("command to reading", simulated.latencies),
                        ("bare pair of rclpy: command to reading", bare.latencies)):
        for share, value in zip((50, 99), 1e3 * np.percentile(times, (50, 99)), strict=True):
            yield Figure(case, f"{what}, {share} %", value, "ms")
    yield Figure(case, "share of a core", used / elapsed)


def _processor_of(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
