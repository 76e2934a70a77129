"""A process's ROS context, nodes whose QoS users can override, and who a voltage command is from.

rclpy does not say that, so a commander signs what it sends: the label of the message's only
dimension is the channels' names, `@`, the node's name and a number of its own; two nodes of one
name, started by mistake, are two commanders. What is not signed, from `ros2 topic pub` or a script,
is identified by the graph alone: it is taken while there is one such publisher.
"""

import copy
import time
import uuid
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

try:
    # A quarter of the CPU time of SingleThreadedExecutor; not in the first releases of Jazzy.
    from rclpy.experimental import EventsExecutor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as EventsExecutor

from sma_bench.border import shown
from sma_bench.errors import InputError
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.processes import choose_discovery

OneThreadExecutor = EventsExecutor
# Seconds of readings, for a recorder that is kept from running, and simulations faster than life.
MEASURED = QoSProfile(depth=2000)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

_OVERRIDABLE = QoSOverridingOptions((
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
))  # fmt: skip


class OverridableNode(Node):
    """Node whose publishers and subscriptions take their QoS from parameters, where given."""

    _ros_is_ready = False

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._ros_is_ready = True

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Publisher:
        """As rclpy's, and `qos_overrides./<topic>.publisher.` parameters change its QoS."""
        return self._endpoint(super().create_publisher, topic, qos_profile, options, msg_type)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None],
        qos_profile: QoSProfile | int, **options: Any,
    ) -> Subscription:
        """As rclpy's, and `qos_overrides./<topic>.subscription.` parameters change its QoS."""
        return self._endpoint(
            super().create_subscription, topic, qos_profile, options, msg_type, callback
        )

    def _endpoint(
        self, create: Callable[..., Any], topic: str, qos: QoSProfile | int,
        options: dict[str, Any], msg_type: Any, *callback: Any,
    ) -> Any:
        """rclpy makes a node's own topics before its parameters can be declared: these it keeps."""
        if self._ros_is_ready:
            options.setdefault("qos_overriding_options", _OVERRIDABLE)
        # rclpy writes what is overridden into the profile, which other topics share.
        profile = copy.copy(qos) if isinstance(qos, QoSProfile) else QoSProfile(depth=qos)
        try:
            return create(msg_type, topic, *callback, profile, **options)
        except (RuntimeError, AssertionError, ParameterException) as error:
            words = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"QoS of {topic}: {words}") from None


def start_ros(arguments: Sequence[str]) -> None:
    """Begin this process's ROS context; signals stay ours.

    Raises:
        InputError: ROS refuses an argument.
    """
    choose_discovery()
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except (rcl.RCLError, rcl.UnknownROSArgsError) as error:
        raise InputError(str(error)) from None


# --- who a voltage command is from

COMMAND = "voltage_command"
# Hears a best-effort publisher too; a command that is lost is followed by the next.
COMMANDED = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
# A late reading, or picture, is worth less than the next one.
NEWEST = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
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
            # Nodes with a publisher of commands that do not sign, one name a publisher.
            self._looked, self._unsigned = now, sorted(
                name for info in self._node.get_publishers_info_by_topic(self._topic)
                if info.node_name not in (*_SIGNING, _NOT_YET_KNOWN)
                and (name := f"{info.node_namespace.rstrip('/')}/{info.node_name}")
                not in self._signed
            )  # fmt: skip
        if len(self._unsigned) > 1:
            nodes = ", ".join(self._unsigned)
            return "", f"commands without a name, and several nodes may send them: {nodes}"
        return "", ""
