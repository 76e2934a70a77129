"""Who a voltage command is from: rclpy does not say, so a commander signs what it sends.

The label of the message's only dimension is the channels' names, `@`, the node's name and a number
of its own; two nodes of one name, started by mistake, are two commanders. What is not signed, from
`ros2 topic pub` or a script, is identified by the graph alone: it is taken while there is one such
publisher.
"""

import time
import uuid
from collections.abc import Sequence

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from sma_bench.border import shown
from sma_bench.parameters.node_tables import NODE_TABLES

COMMAND = "voltage_command"
# Hears a best-effort publisher too; a command that is lost is followed by the next.
COMMANDED = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_SIGNED = " @"
_LONGEST_NAME, _MOST_SENDERS = 300, 300
_LOOK_EVERY = 0.5
_NOT_YET_KNOWN = "_NODE_NAME_UNKNOWN_"  # as rmw calls a node of which it has only an endpoint
# Nodes of this package sign, whether or not they have sent anything yet.
_SIGNING = frozenset({*NODE_TABLES, "dashboard"})


def signature(node: Node) -> str:
    """What a node signs its commands with."""
    return f"{node.get_fully_qualified_name()}#{uuid.uuid4().hex[:8]}"


def voltage_command(
    channels: Sequence[str], volts: Sequence[float], signed: str = ""
) -> Float64MultiArray:
    """V of every channel; the label has the channels' names, or none, and who sends it."""
    size = len(volts)
    label = " ".join(channels) + (f"{_SIGNED}{signed}" if signed else "")
    dim = MultiArrayDimension(label=label, size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[dim]), data=volts)


def layout_fault(message: Float64MultiArray, channels: Sequence[str]) -> str:
    """Why a command's layout, where it has one, is not that of these channels, or ""."""
    layout, names = message.layout, " ".join(channels)
    if layout.data_offset or len(layout.dim) > 1:
        return "voltage_command has another layout, expected one dimension, no offset"
    for dim in layout.dim:
        names_given = dim.label.partition(_SIGNED)[0]
        if names_given not in ("", names):
            return f"voltage_command is for {shown(names_given, 80)!r}, expected {names!r}"
        if dim.size not in (0, len(channels)):
            return f"voltage_command has a dimension of {dim.size}, expected {len(channels)}"
    return ""


class Commanders:
    """The senders of the commands that a node receives."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._topic = node.resolve_topic_name(COMMAND)
        self._signed: set[str] = set()
        self._unsigned: list[str] = []
        self._looked = -_LOOK_EVERY

    def of(self, message: Float64MultiArray) -> tuple[str, str]:
        """The sender of a command; and why it must not drive, where it might be any of several."""
        signed = "".join(dim.label.partition(_SIGNED)[2] for dim in message.layout.dim[:1])
        if signed:
            sender = shown(signed, _LONGEST_NAME)
            if len(self._signed) < _MOST_SENDERS:
                self._signed.add(sender.partition("#")[0])
            return sender, ""
        if (now := time.monotonic()) >= self._looked + _LOOK_EVERY:
            self._looked, self._unsigned = now, self._look()
        if len(self._unsigned) > 1:
            nodes = ", ".join(self._unsigned)
            return "", f"commands without a name, and several nodes may send them: {nodes}"
        return "", ""

    def _look(self) -> list[str]:
        """Nodes with a publisher of commands that do not sign, one name a publisher."""
        return sorted(
            name
            for info in self._node.get_publishers_info_by_topic(self._topic)
            if info.node_name not in (*_SIGNING, _NOT_YET_KNOWN)
            and (name := f"{info.node_namespace.rstrip('/')}/{info.node_name}") not in self._signed
        )
