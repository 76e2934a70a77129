"""How many thermal pictures a second are read, and what the nodes take of a core at 80 Hz."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from examination.perf.figures import Figure, Outcome, at_least
from examination.perf.timing import processor_of
from sma_bench.hardware.thermal_image import FrameFormat
from sma_bench.hardware.thermal_settings import (
    frame_judge,
    regions_side_by_side,
    synthetic_camera,
    wire_gauges,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES

CONFIG = Path(__file__).resolve().parents[2] / "config"
RATE = 80.0
CHANNELS = ("front_1", "front_2", "back_1", "back_2")
COMPOSITE = {
    "bench.channels": CHANNELS,
    "bench.channel_sides": ("front", "front", "back", "back"),
}
_NODES = ("synthetic_camera", "ir_camera")
_NAMESPACE = "/perf"
_STARTING = 60.0


def measure(frames: int = 300, seconds: float = 8.0) -> list[Outcome]:
    """Pictures a second in one process; rate, age and share of a core of each node at 80 Hz."""
    outcomes: list[Outcome] = []
    wire = Parameters.defaults()
    for name, parameters in (("one wire", wire), ("four wires", wire.replace(COMPOSITE))):
        outcomes += _in_one_process(name, parameters, frames)
    outcomes += _in_processes("one wire", ("wire",), seconds)
    return outcomes + _in_processes("four wires", CHANNELS, seconds)


def _in_one_process(name: str, parameters: Parameters, frames: int) -> list[Outcome]:
    channels = parameters["bench.channels"]
    regions = tuple(regions_side_by_side(len(channels), 382, 288))
    settings = _settings("ir_camera") | {"regions": regions, "stale_limit": 1e9}
    camera = synthetic_camera(parameters, _settings("synthetic_camera"))
    gauges, judge = wire_gauges(parameters, settings), frame_judge(settings)
    kelvin = [350.0] * len(channels)
    pictures = [camera.picture(kelvin).tobytes() for _ in range(20)]
    shape = FrameFormat(382, 288)

    def read(k: int) -> None:
        frame = shape.decode("mono16", 382, 288, 764, False, pictures[k % 20])
        if judge.objection(frame, float(k), float(k)):
            raise AssertionError("a good picture was held back")
        if any(gauge.read(frame, float(k)).reason for gauge in gauges):
            raise AssertionError("a wire was not read")

    case = f"camera 382 x 288, {name}"
    made = _rate(lambda k: camera.picture(kelvin, k % 7), frames)
    return [
        Figure(case, "pictures read a second", _rate(read, frames), "1/s", at_least(RATE)),
        Figure(case, "synthetic pictures made a second", made, "1/s"),
    ]


def _in_processes(name: str, channels: tuple[str, ...], seconds: float) -> list[Outcome]:
    import rclpy
    from sensor_msgs.msg import Temperature

    from sma_bench.ros.processes import NodeProcesses, private_ros_environment

    private_ros_environment()
    rig = CONFIG / ("wire_rig.yaml" if len(channels) == 1 else "composite_rig.yaml")
    regions = regions_side_by_side(len(channels), 382, 288)
    rclpy.init(args=[])
    node = rclpy.create_node("perf", namespace=_NAMESPACE)
    received: list[float] = []
    told = [node.create_publisher(Temperature, f"{c}/true_temperature", 10) for c in channels]
    node.create_subscription(
        Temperature, f"{channels[-1]}/temperature",
        lambda message: received.append(_age(node, message)), 1000,
    )
    try:
        with TemporaryDirectory() as folder, NodeProcesses(_NAMESPACE, Path(folder)) as running:
            running.start("synthetic_camera", {"rate": RATE}, (rig,))
            running.start("ir_camera", {"regions": regions}, (rig,))

            def spin(until: Callable[[], bool]) -> None:
                while not until():
                    for publisher in told:
                        publisher.publish(Temperature(temperature=77.0))
                    rclpy.spin_once(node, timeout_sec=0.1)
                    running.check()

            limit = time.monotonic() + _STARTING
            spin(lambda: len(received) > RATE or time.monotonic() > limit)
            processes = {name: running.pid(name) for name in _NODES}
            begin, before = time.monotonic(), {k: processor_of(pid) for k, pid in processes.items()}
            received.clear()
            spin(lambda: time.monotonic() - begin > seconds)
            elapsed = time.monotonic() - begin
            used = {k: (processor_of(pid) - before[k]) / elapsed for k, pid in processes.items()}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    ages = sorted(received) or [float("nan")]
    case = f"camera nodes at 80 Hz, {name}"
    return [
        Figure(case, "readings of the last wire a second", len(received) / elapsed, "1/s",
               at_least(0.99 * RATE)),
        Figure(case, "age of a reading where it arrives, median", 1e3 * ages[len(ages) // 2], "ms"),
        *(Figure(case, f"{node}: share of a core", used[node], "") for node in _NODES),
    ]


def _age(node: Any, message: Any) -> float:
    stamp = message.header.stamp
    return float(node.get_clock().now().nanoseconds * 1e-9 - stamp.sec - stamp.nanosec * 1e-9)


def _settings(node: str) -> dict[str, Any]:
    return {parameter.name: parameter.default for parameter in NODE_TABLES[node]}


def _rate(call: Callable[[int], object], times: int) -> float:
    start = time.process_time()
    for k in range(times):
        call(k)
    return times / (time.process_time() - start)
