"""Readings of a bench as the contract's messages.

Every message object is built once and only its stamp and numbers change: at a multiple of real
time, building messages would cost more than the physics.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState, JointState, Range, Temperature
from std_msgs.msg import String

from sma_bench.live.recording import RECORDER, recorder_failure
from sma_bench.ros.node import LATCHED, MEASURED

if TYPE_CHECKING:  # brings the model and its compiler, which a bridge does without
    from sma_bench.live.virtual_bench import GroupReading

NANOSECONDS = 1_000_000_000

NAN = float("nan")
# Triangulation sensor of the composite rig: assumed to see 20 to 300 mm.
_NEAREST, _FARTHEST = 0.02, 0.3


class PowerTopics:
    """`<channel>/power` of every channel."""

    def __init__(self, node: Node, channels: Sequence[str]) -> None:
        self._pairs = [
            (node.create_publisher(BatteryState, f"{channel}/power", MEASURED), _power(channel))
            for channel in channels
        ]

    def publish(self, powers: Sequence[tuple[float, float]], stamp: int) -> None:
        """Send (V, A) of every channel, acquired at `stamp` ns of ROS time."""
        for (publisher, message), (volt, ampere) in zip(self._pairs, powers, strict=True):
            message.voltage = float(volt)
            message.current = float(ampere)
            _send(publisher, message, stamp)


class RangeTopics:
    """`front/range`, `back/range`, and the deflection they give as the joint `tip`."""

    def __init__(self, node: Node, sides: Sequence[str] = ("front", "back")) -> None:
        self._ranges = {
            side: (node.create_publisher(Range, f"{side}/range", MEASURED), _range(side))
            for side in sides
        }
        self._joint = node.create_publisher(JointState, "joint_states", MEASURED)
        self._tip = JointState(name=["tip"])

    def publish(self, distances: Mapping[str, float], deflection: float, stamp: int) -> None:
        """Send distances (m) by side, and a deflection (m) unless it is NaN."""
        for side, (publisher, message) in self._ranges.items():
            message.range = _rep_117(float(distances[side]))
            _send(publisher, message, stamp)
        if not math.isnan(deflection):
            self._tip.position = [float(deflection)]
            _send(self._joint, self._tip, stamp)


class BenchTopics:
    """Publishers of one simulated bench, relative names."""

    def __init__(self, node: Node, channels: tuple[str, ...], composite: bool) -> None:
        self._counts = {"power": 0, "temperature": 0, "mechanics": 0, "ambient": 0}
        power = PowerTopics(node, channels)
        self._temperature = [
            (_temperature_publisher(node, channel), _temperature(channel)) for channel in channels
        ]
        self._ambient = [(_temperature_publisher(node, "ambient"), _temperature("ambient"))]
        self._send: dict[str, Callable[[list, int], None]] = {
            "power": power.publish,
            "temperature": lambda values, stamp: _send_temperatures(
                self._temperature, values, stamp
            ),
            "ambient": lambda values, stamp: _send_temperatures(self._ambient, values, stamp),
            "mechanics": _range_sender(node) if composite else _load_frame_sender(node),
        }

    def publish(self, reading: "GroupReading", epoch: int) -> None:
        """Send a reading; `epoch` ns is the ROS time of its time 0."""
        self._send[reading.kind](reading.values, epoch + reading.time)
        self._counts[reading.kind] += 1

    def counts(self) -> dict[str, int]:
        """Readings published so far, by kind."""
        return dict(self._counts)


def _range_sender(node: Node) -> Callable[[list, int], None]:
    topics = RangeTopics(node)

    def send(values: list, stamp: int) -> None:
        front, back = values
        topics.publish({"front": front, "back": back}, (back - front) / 2.0, stamp)

    return send


def _load_frame_sender(node: Node) -> Callable[[list, int], None]:
    publisher = node.create_publisher(JointState, "joint_states", MEASURED)
    message = JointState(name=["wire"])

    def send(values: list, stamp: int) -> None:
        elongation, force = values
        message.position = [float(elongation)]
        message.effort = [float(force)]
        _send(publisher, message, stamp)

    return send


def _send(publisher: Publisher, message: Any, stamp: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    publisher.publish(message)


def _send_temperatures(pairs: list, values: list, stamp: int) -> None:
    for (publisher, message), celsius in zip(pairs, values, strict=True):
        message.temperature = float(celsius)
        _send(publisher, message, stamp)


def _rep_117(distance: float) -> float:
    if distance < _NEAREST:
        return -float("inf")
    return distance if distance <= _FARTHEST else float("inf")


def _temperature_publisher(node: Node, place: str) -> Publisher:
    return node.create_publisher(Temperature, f"{place}/temperature", MEASURED)


def _power(channel: str) -> BatteryState:
    message = BatteryState(location=channel, present=True)
    message.header.frame_id = channel
    for field in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
        setattr(message, field, NAN)
    return message


def _temperature(frame: str) -> Temperature:
    message = Temperature(variance=0.0)
    message.header.frame_id = frame
    return message


def _range(side: str) -> Range:
    message = Range(radiation_type=Range.INFRARED, min_range=_NEAREST, max_range=_FARTHEST)
    message.header.frame_id = f"{side}_range"
    return message


def follow_recorder(node: Node, note: Callable[[str], None]) -> None:
    """Call `note` with why the namespace's recorder failed, or with "" when it records."""
    node.create_subscription(
        String, RECORDER, lambda message: note(recorder_failure(message.data)), LATCHED
    )
