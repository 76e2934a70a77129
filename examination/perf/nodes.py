"""The simulated bench and the camera as nodes: rate held, jitter, latency, share of a core."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, Temperature
from std_msgs.msg import Float64MultiArray

from examination.perf.measuring import Figure
from examination.perf.running import NAMESPACE, RIGS, running
from sma_bench.hardware import thermal_settings as thermal
from sma_bench.hardware.thermal_image import FrameFormat
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES

RATES = (100.0, 500.0, 1000.0)
CAMERA_RATE = 80.0
PICTURE = (382, 288)
FRAMES = 300
COMMAND_PERIOD = 0.05


def measure(tiny: bool = False) -> Iterator[Figure]:
    """The simulator at each rate, then the camera in this process and as nodes."""
    for rate in RATES[:1] if tiny else RATES:
        yield from _simulator(rate, 1.0 if tiny else 6.0)
    if not tiny:
        for name in RIGS:
            yield from _pictures(name)
            yield from _camera_nodes(name)


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


def _pictures(name: str) -> Iterator[Figure]:
    """Made and read in this process."""
    parameters = read_parameters(RIGS[name])
    wires = len(parameters["bench.channels"])
    of_reader, of_camera = (
        {p.name: p.default for p in NODE_TABLES[node]} for node in ("ir_camera", "synthetic_camera")
    )
    regions = tuple(thermal.regions_side_by_side(wires, *PICTURE))
    of_reader |= {"regions": regions, "stale_limit": 1e9}
    camera, shape = thermal.synthetic_camera(parameters, of_camera), FrameFormat(*PICTURE)
    gauges, judge = thermal.wire_gauges(parameters, of_reader), thermal.frame_judge(of_reader)
    pictures = [camera.picture([350.0] * wires).tobytes() for _ in range(20)]

    def read(k: int) -> None:
        frame = shape.decode("mono16", *PICTURE, 2 * PICTURE[0], False, pictures[k % 20])
        if judge.objection(frame, float(k), float(k)):
            raise RuntimeError("a good picture was held back")
        if any(gauge.read(frame, float(k)).reason for gauge in gauges):
            raise RuntimeError("a wire was not read")

    def pace(call: Callable[[int], object]) -> float:
        begin = time.process_time()
        for k in range(FRAMES):
            call(k)
        return FRAMES / (time.process_time() - begin)

    case, made = f"camera 382 x 288, {name}", pace(lambda k: camera.picture([350.0] * wires, k % 7))
    yield Figure(case, "pictures read a second", pace(read), "1/s", least=CAMERA_RATE)
    yield Figure(case, "synthetic pictures made a second", made, "1/s")


def _camera_nodes(name: str, seconds: float = 8.0) -> Iterator[Figure]:
    channels = read_parameters(RIGS[name])["bench.channels"]
    regions = thermal.regions_side_by_side(len(channels), *PICTURE)
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
