"""Readings of a bench as the contract's messages.

Every message object is built once and only its stamp and numbers change: at a multiple of real
time, building messages would cost more than the physics.
"""

from collections.abc import Callable

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState, JointState, Range, Temperature

from sma_bench.nodes.base import MEASURED
from sma_bench.nodes.virtual_bench import NANOSECONDS, Reading

NAN = float("nan")
# Triangulation sensor of the composite rig: assumed to see 20 to 300 mm.
_NEAREST, _FARTHEST = 0.02, 0.3


class BenchTopics:
    """Publishers of one bench, relative names."""

    def __init__(self, node: Node, channels: tuple[str, ...], composite: bool) -> None:
        self._counts = {"power": 0, "temperature": 0, "mechanics": 0, "ambient": 0}
        self._power = [
            (node.create_publisher(BatteryState, f"{channel}/power", MEASURED), _power(channel))
            for channel in channels
        ]
        self._temperature = [
            (_temperature_publisher(node, channel), _temperature(channel)) for channel in channels
        ]
        self._ambient = [(_temperature_publisher(node, "ambient"), _temperature("ambient"))]
        self._joint = (
            node.create_publisher(JointState, "joint_states", MEASURED),
            JointState(name=["tip" if composite else "wire"]),
        )
        self._ranges = [
            (node.create_publisher(Range, f"{side}/range", MEASURED), _range(side))
            for side in (("front", "back") if composite else ())
        ]
        self._send: dict[str, Callable[[list, int], None]] = {
            "power": self._send_power,
            "temperature": lambda values, stamp: _send_temperatures(
                self._temperature, values, stamp
            ),
            "ambient": lambda values, stamp: _send_temperatures(self._ambient, values, stamp),
            "mechanics": self._send_ranges if composite else self._send_load_frame,
        }

    def publish(self, reading: Reading, epoch: int) -> None:
        """Send a reading; `epoch` ns is the ROS time of its time 0."""
        self._send[reading.kind](reading.values, epoch + reading.time)
        self._counts[reading.kind] += 1

    def counts(self) -> dict[str, int]:
        """Readings published so far, by kind."""
        return dict(self._counts)

    def _send_power(self, values: list, stamp: int) -> None:
        for (publisher, message), (volt, ampere) in zip(self._power, values, strict=True):
            message.voltage = float(volt)
            message.current = float(ampere)
            _send(publisher, message, stamp)

    def _send_load_frame(self, values: list, stamp: int) -> None:
        publisher, message = self._joint
        elongation, force = values
        message.position = [float(elongation)]
        message.effort = [float(force)]
        _send(publisher, message, stamp)

    def _send_ranges(self, values: list, stamp: int) -> None:
        for (publisher, message), distance in zip(self._ranges, values, strict=True):
            message.range = _rep_117(float(distance))
            _send(publisher, message, stamp)
        front, back = values
        publisher, message = self._joint
        message.position = [(back - front) / 2.0]
        _send(publisher, message, stamp)


def _send(publisher: Publisher, message: object, stamp: int) -> None:
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
