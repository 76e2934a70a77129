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


def power_message(channel: str, volt: float = 0.0, ampere: float = 0.0) -> BatteryState:
    """Of a wire: what a battery has besides is NaN."""
    message = BatteryState(location=channel, present=True, voltage=volt, current=ampere)
    message.header.frame_id = channel
    for field in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
        setattr(message, field, NAN)
    return message


def temperature_message(frame: str, value: float = 0.0) -> Temperature:
    """`value` degC; its variance is not known."""
    message = Temperature(temperature=value, variance=0.0)
    message.header.frame_id = frame
    return message


def send(publisher: Publisher, message: Any, stamp: int) -> None:
    """Publish with a stamp of `stamp` ns."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
    publisher.publish(message)


class PowerTopics:
    """`<channel>/power` of every channel."""

    def __init__(self, node: Node, channels: Sequence[str]) -> None:
        self._pairs = [
            (node.create_publisher(BatteryState, f"{c}/power", MEASURED), power_message(c))
            for c in channels
        ]

    def publish(self, powers: Sequence[tuple[float, float]], stamp: int) -> None:
        """Send (V, A) of every channel, acquired at `stamp` ns of ROS time."""
        for (publisher, message), (volt, ampere) in zip(self._pairs, powers, strict=True):
            message.voltage, message.current = float(volt), float(ampere)
            send(publisher, message, stamp)


class RangeTopics:
    """`front/range`, `back/range`, and the deflection they give as the joint `tip`."""

    def __init__(self, node: Node, sides: Sequence[str] = ("front", "back")) -> None:
        self._ranges = {}
        for side in sides:
            message = Range(radiation_type=Range.INFRARED, min_range=_NEAREST, max_range=_FARTHEST)
            message.header.frame_id = f"{side}_range"
            self._ranges[side] = node.create_publisher(Range, f"{side}/range", MEASURED), message
        self._joint = node.create_publisher(JointState, "joint_states", MEASURED)
        self._tip = JointState(name=["tip"])

    def publish(self, distances: Mapping[str, float], deflection: float, stamp: int) -> None:
        """Send distances (m) by side, REP-117, and a deflection (m) unless it is NaN."""
        for side, (publisher, message) in self._ranges.items():
            distance = float(distances[side])
            below, beyond = distance < _NEAREST, not distance <= _FARTHEST
            message.range = -math.inf if below else math.inf if beyond else distance
            send(publisher, message, stamp)
        if not math.isnan(deflection):
            self._tip.position = [float(deflection)]
            send(self._joint, self._tip, stamp)


class BenchTopics:
    """Publishers of one simulated bench, relative names."""

    def __init__(self, node: Node, channels: tuple[str, ...], composite: bool) -> None:
        self._counts = {"power": 0, "temperature": 0, "mechanics": 0, "ambient": 0}
        self._power = PowerTopics(node, channels)
        self._temperatures = {
            kind: [
                (node.create_publisher(Temperature, f"{place}/temperature", MEASURED),
                 temperature_message(place))
                for place in places
            ]
            for kind, places in (("temperature", channels), ("ambient", ("ambient",)))
        }  # fmt: skip
        self._ranges = RangeTopics(node) if composite else None
        self._frame = JointState(name=["wire"])
        if not composite:
            self._load_frame = node.create_publisher(JointState, "joint_states", MEASURED)

    def publish(self, reading: "GroupReading", epoch: int) -> None:
        """Send a reading; `epoch` ns is the ROS time of its time 0."""
        kind, values, stamp = reading.kind, reading.values, epoch + reading.time
        if kind == "power":
            self._power.publish(values, stamp)
        elif kind == "mechanics" and self._ranges is not None:
            front, back = values
            self._ranges.publish({"front": front, "back": back}, (back - front) / 2.0, stamp)
        elif kind == "mechanics":
            elongation, force = values
            self._frame.position, self._frame.effort = [float(elongation)], [float(force)]
            send(self._load_frame, self._frame, stamp)
        else:
            for (publisher, message), celsius in zip(self._temperatures[kind], values, strict=True):
                message.temperature = float(celsius)
                send(publisher, message, stamp)
        self._counts[kind] += 1

    def counts(self) -> dict[str, int]:
        """Readings published so far, by kind."""
        return dict(self._counts)


def follow_recorder(node: Node, note: Callable[[str], None]) -> None:
    """Call `note` with why the namespace's recorder failed, or with "" when it records."""
    node.create_subscription(
        String, RECORDER, lambda message: note(recorder_failure(message.data)), LATCHED
    )
