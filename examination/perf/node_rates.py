"""The simulated bench as a node: rate held, jitter, command to reading, share of a core."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from examination.perf.camera_frames import measure as camera_frames
from examination.perf.figures import Figure, Outcome, Skipped, at_least
from examination.perf.timing import processor_of

RATES = (100.0, 500.0, 1000.0)
_NAMESPACE = "/perf"
_STARTING = 90.0
_COMMAND_PERIOD = 0.05


def measure(tiny: bool = False) -> list[Outcome]:
    """The simulator at each rate, then the camera's nodes."""
    try:
        import rclpy
    except ImportError:
        return [Skipped("nodes", "no ROS 2 (rclpy) here")]
    from sma_bench.ros.processes import private_ros_environment

    private_ros_environment()
    outcomes: list[Outcome] = []
    for rate in RATES[:1] if tiny else RATES:
        rclpy.init(args=[])
        try:
            outcomes += _simulator(rate, 1.0 if tiny else 6.0)
        finally:
            rclpy.try_shutdown()
    return outcomes + ([] if tiny else camera_frames())


class _Listener:
    """Commands alternating voltages and notes when readings arrive and which voltage they show."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import BatteryState
        from std_msgs.msg import Float64MultiArray

        self.node = rclpy.create_node("perf", namespace=_NAMESPACE)
        self._message = Float64MultiArray
        self._commands = self.node.create_publisher(Float64MultiArray, "voltage_command", 10)
        self.node.create_subscription(
            BatteryState, "wire/power", self._reading, QoSProfile(depth=1000)
        )
        self.arrivals: list[float] = []
        self.stamps: list[float] = []
        self.latencies: list[float] = []
        self._told = self._volts = 0.0
        self._waiting = False

    def command(self) -> None:
        """Another voltage, at most every _COMMAND_PERIOD, once the last one was seen."""
        now = time.monotonic()
        if now - self._told < _COMMAND_PERIOD or (self._waiting and now - self._told < 1.0):
            return
        self._volts = 1.0 if self._volts > 1.5 else 2.0
        self._commands.publish(self._message(data=[self._volts]))
        self._told, self._waiting = time.monotonic(), True

    def _reading(self, message: Any) -> None:
        now = time.monotonic()
        self.arrivals.append(now)
        self.stamps.append(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)
        if self._waiting and abs(message.voltage - self._volts) < 0.1:
            self.latencies.append(now - self._told)
            self._waiting = False


def _simulator(rate: float, seconds: float) -> list[Outcome]:
    import rclpy

    from sma_bench.ros.processes import NodeProcesses

    listener = _Listener()
    case = f"simulator at {rate:g} Hz"
    try:
        with TemporaryDirectory() as folder, NodeProcesses(_NAMESPACE, Path(folder)) as running:
            settings = {"rate.power": rate, "rate.temperature": rate, "rate.mechanics": rate}
            running.start("simulator", settings)

            def spin(until: float, enough: int = 10**9) -> None:
                while time.monotonic() < until and len(listener.latencies) < enough:
                    listener.command()
                    rclpy.spin_once(listener.node, timeout_sec=0.01)
                    running.check()

            spin(time.monotonic() + _STARTING, enough=5)
            if not listener.latencies:
                return [Skipped(case, f"no reading within {_STARTING:g} s")]
            pid = running.pid("simulator")
            begin, before = time.monotonic(), processor_of(pid)
            for values in (listener.arrivals, listener.stamps, listener.latencies):
                values.clear()
            spin(begin + seconds)
            elapsed = time.monotonic() - begin
            share = (processor_of(pid) - before) / elapsed
    finally:
        listener.node.destroy_node()
    arrivals, stamps = np.array(listener.arrivals), np.array(listener.stamps)
    late = arrivals - stamps
    held = len(arrivals) / elapsed
    return [
        Figure(case, "power readings a second", held, "1/s", at_least(0.99 * rate)),
        Figure(case, "arrival after stamp, 99th percentile over median",
               1e3 * float(np.percentile(late, 99) - np.median(late)), "ms"),
        Figure(case, "command to reading, median", 1e3 * _at(listener.latencies, 50), "ms"),
        Figure(case, "command to reading, 99th percentile",
               1e3 * _at(listener.latencies, 99), "ms"),
        Figure(case, "share of a core", share, ""),
    ]


def _at(values: list[float], percent: float) -> float:
    return float(np.percentile(values, percent)) if values else float("nan")
