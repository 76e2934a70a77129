"""The simulated bench and the camera as nodes: rate held, jitter, latency, share of a core."""

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from examination.perf.figures import Figure, Outcome, Skipped, at_least
from examination.perf.running import NAMESPACE, RIGS, percentile, running
from sma_bench.hardware.thermal_image import FrameFormat
from sma_bench.hardware.thermal_settings import (
    frame_judge,
    regions_side_by_side,
    synthetic_camera,
    wire_gauges,
)
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES

RATES = (100.0, 500.0, 1000.0)
CAMERA_RATE = 80.0
FRAMES = 300
_COMMAND_PERIOD = 0.05


def measure(tiny: bool = False) -> list[Outcome]:
    """The simulator at each rate, then the camera in this process and as nodes."""
    if find_spec("rclpy") is None:
        return [Skipped("nodes", "no ROS 2 (rclpy) here")]
    outcomes: list[Outcome] = []
    for rate in RATES[:1] if tiny else RATES:
        outcomes += _simulator(rate, 1.0 if tiny else 6.0)
    if not tiny:
        outcomes += [figure for rig in RIGS for figure in _pictures(rig)]
        outcomes += [figure for rig in RIGS for figure in _camera_nodes(rig)]
    return outcomes


def _simulator(rate: float, seconds: float) -> list[Outcome]:
    """Alternating voltages, and when readings arrive and show them."""
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import BatteryState
    from std_msgs.msg import Float64MultiArray

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
        """Another voltage, at most every _COMMAND_PERIOD, once the last one was seen."""
        nonlocal commanded, volts, waiting
        since = time.monotonic() - commanded
        if since > (1.0 if waiting else _COMMAND_PERIOD):
            volts = 1.0 if volts > 1.5 else 2.0
            commands.publish(Float64MultiArray(data=[volts]))
            commanded, waiting = time.monotonic(), True

    rates = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), rate)
    with running({"simulator": rates}) as bench:
        commands = bench.node.create_publisher(Float64MultiArray, "voltage_command", 10)
        qos = QoSProfile(depth=1000)
        bench.node.create_subscription(BatteryState, "wire/power", take, qos)
        bench.spin(lambda: len(latencies) > 4, command)
        late.clear()
        latencies.clear()
        elapsed, shares = bench.shares(seconds, command)
    case, jitter = f"simulator at {rate:g} Hz", percentile(late, 99) - percentile(late, 50)
    return [
        Figure(case, "power readings a second", len(late) / elapsed, "1/s", at_least(0.99 * rate)),
        Figure(case, "arrival after stamp, 99th percentile over median", 1e3 * jitter, "ms"),
        Figure(case, "command to reading, median", 1e3 * percentile(latencies, 50), "ms"),
        Figure(case, "command to reading, 99th percentile", 1e3 * percentile(latencies, 99), "ms"),
        Figure(case, "share of a core", shares["simulator"], ""),
    ]


def _pictures(name: str) -> list[Outcome]:
    """Made and read in this process."""
    parameters = read_parameters(RIGS[name])
    channels = parameters["bench.channels"]
    of_reader, of_camera = ({p.name: p.default for p in NODE_TABLES[node]}
                            for node in ("ir_camera", "synthetic_camera"))  # fmt: skip
    of_reader |= {"regions": tuple(regions_side_by_side(len(channels), 382, 288)),
                  "stale_limit": 1e9}  # fmt: skip
    camera, shape = synthetic_camera(parameters, of_camera), FrameFormat(382, 288)
    gauges, judge = wire_gauges(parameters, of_reader), frame_judge(of_reader)
    kelvin = [350.0] * len(channels)
    pictures = [camera.picture(kelvin).tobytes() for _ in range(20)]

    def read(k: int) -> None:
        frame = shape.decode("mono16", 382, 288, 764, False, pictures[k % 20])
        if judge.objection(frame, float(k), float(k)):
            raise RuntimeError("a good picture was held back")
        if any(gauge.read(frame, float(k)).reason for gauge in gauges):
            raise RuntimeError("a wire was not read")

    def pace(call: Callable[[int], object]) -> float:
        begin = time.process_time()
        for k in range(FRAMES):
            call(k)
        return FRAMES / (time.process_time() - begin)

    case, made = f"camera 382 x 288, {name}", pace(lambda k: camera.picture(kelvin, k % 7))
    return [
        Figure(case, "pictures read a second", pace(read), "1/s", at_least(CAMERA_RATE)),
        Figure(case, "synthetic pictures made a second", made, "1/s"),
    ]


def _camera_nodes(name: str, seconds: float = 8.0) -> list[Outcome]:
    from sensor_msgs.msg import Temperature

    channels = read_parameters(RIGS[name])["bench.channels"]
    regions = regions_side_by_side(len(channels), 382, 288)
    ages: list[float] = []
    nodes = {"synthetic_camera": {"rate": CAMERA_RATE}, "ir_camera": {"regions": regions}}
    with running(nodes, RIGS[name]) as bench:
        warmth = [bench.node.create_publisher(Temperature, f"{c}/true_temperature", 10)
                  for c in channels]  # fmt: skip

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
    case, age = f"camera nodes at 80 Hz, {name}", 1e3 * float(np.median(ages or [np.nan]))
    return [
        Figure(case, "readings of the last wire a second", len(ages) / elapsed, "1/s",
               at_least(0.99 * CAMERA_RATE)),
        Figure(case, "age of a reading where it arrives, median", age, "ms"),
        *(Figure(case, f"{node}: share of a core", shares[node], "") for node in nodes),
    ]  # fmt: skip
