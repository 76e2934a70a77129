"""A process's ROS context, nodes with QoS overrides, the bench's topics, the senders of commands.

rclpy does not tell who sent a message, so nodes sign their commands: the label of the message's
only dimension is the channels' names, `@`, the node's name and a random number (two nodes of one
name, started by mistake, are two senders). Unsigned commands, from `ros2 topic pub` or a script,
are accepted while the graph has only one publisher of such commands."""

import contextlib
import copy
import importlib
import math
import socket
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, ClassVar

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState, JointState, Range, Temperature
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

try:
    # A quarter of the CPU time of SingleThreadedExecutor; not in the first releases of Jazzy.
    from rclpy.experimental import EventsExecutor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as EventsExecutor

from sma_bench.border import claimed, shown
from sma_bench.errors import InputError
from sma_bench.live.recording import BRIDGE, recorded_type
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.processes import choose_discovery

OneThreadExecutor = EventsExecutor
# Readings and commands: a queue of seconds, for a suspended recorder and for fast simulations.
READINGS = QoSProfile(depth=2000)
# States and results: a late subscriber gets the last one, too.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_READINGS_HEARD = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_NEWEST_DEPTH = 2  # queue of `newest` endpoints
_LEAVING = 0.2  # s in which a peer on a busy machine reads what it has received
_OVERRIDABLE = QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH,
                                     QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY))

COMMAND, CLOCK, NANOSECONDS, NAN = "voltage_command", "/clock", 1_000_000_000, math.nan
_NEAREST, _FARTHEST = 0.02, 0.3  # m, assumed of the composite rig's triangulation sensors


def start_ros(arguments: Sequence[str]) -> None:
    """Begin this process's ROS context without its signal handlers. InputError: bad argument."""
    choose_discovery()
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except (rcl.RCLError, rcl.UnknownROSArgsError) as error:
        raise InputError(str(error)) from None


@contextlib.contextmanager
def end_of_ros() -> Iterator[None]:
    """Destroy this process's nodes inside; then ROS shuts down without leaving ghosts in the graphs
    of peers. The DDS participant ends with the last node, and a peer whose rmw_fastrtps reads news
    of a node after that end adds the node again, for ever. So a hidden node without topics stays
    until peers have read that the others are gone."""
    last = None
    if rclpy.ok():
        handle = rclpy.get_default_context().handle
        with handle:
            last = rcl.Node("_leaving", "/", handle, None, False, False)
    try:
        yield
    finally:
        if last is not None:
            time.sleep(_LEAVING)
            last.destroy_when_not_in_use()
        rclpy.try_shutdown()


class OverridableNode(Node):
    """Node whose publishers and subscriptions take their QoS from the parameters
    `qos_overrides./<topic>.publisher.` or `.subscription.`, if given; otherwise as in rclpy."""

    # ROS arguments of this node alone, which override those of the process.
    own_arguments: ClassVar[list[str]] = []
    _ros_is_ready = False

    def __init__(self, name: str, **options: Any) -> None:
        try:
            super().__init__(name, cli_args=self.own_arguments, **options)
        except (rcl.RCLError, rcl.UnknownROSArgsError, NameValidationException) as error:
            raise InputError(" ".join(str(error).rstrip("^ ").split())) from None
        self._ros_is_ready = True

    def count_publishers(self, topic_name: str) -> int:
        """Also of a remapped topic, unlike rclpy's own."""
        return int(super().count_publishers(self.resolve_topic_name(topic_name)))

    def create_publisher(self, *what: Any, newest: bool = False, **options: Any) -> Publisher:
        """Arguments: message type, topic, QoS; `newest`: short queue, no old messages."""
        return self._endpoint(super().create_publisher, what, newest, options)

    def create_subscription(self, *what: Any, newest: bool = False, **options: Any) -> Subscription:
        """Arguments: message type, topic, callback, QoS; READINGS match best-effort publishers. One
        of BEST_AVAILABLE is made again when a publisher appears that offers less."""
        if what[-1] is READINGS:
            what = (*what[:-1], _READINGS_HEARD)

        def offered_less(event: Any) -> None:
            policy = QoSPolicyKind(event.last_policy_kind).name.lower()
            follows = getattr(made.qos_profile, policy).name == "BEST_AVAILABLE"  # no override
            self.get_logger().warning(f"{what[1]}: a publisher has another {policy}: "
                                      f"{'subscribed again' if follows else 'it is not heard'}")
            if follows:
                self.destroy_subscription(made)
                self.create_subscription(*what, newest=newest, **options)

        if getattr(what[-1], "reliability", None) == ReliabilityPolicy.BEST_AVAILABLE:
            options["event_callbacks"] = SubscriptionEventCallbacks(incompatible_qos=offered_less)
        made: Subscription = self._endpoint(super().create_subscription, what, newest, options)
        return made

    def _endpoint(self, create: Callable[..., Any], what: Any, newest: bool,
                  options: dict[str, Any]) -> Any:
        """Topics that rclpy creates itself come before parameters exist: no overrides for them."""
        if self._ros_is_ready:
            options.setdefault("qos_overriding_options", _OVERRIDABLE)
        # rclpy writes overrides into the profile, which other topics share: copy it.
        *first, qos = what
        profile = copy.copy(qos) if isinstance(qos, QoSProfile) else QoSProfile(depth=qos)
        if newest:
            profile.depth = _NEWEST_DEPTH
        try:
            return create(*first, profile, **options)
        except (NameValidationException, RuntimeError, AssertionError, ParameterException) as error:
            words = " ".join(str(error).rstrip("^ \n").split()) or type(error).__name__
            raise InputError(f"topic {what[1]:.80}: {words}") from None


class BenchTopics:
    """Publishers of `<channel>/power`, `<place>/temperature`, `<side>/range` and `joint_states` (of
    one joint), as requested, with the prefix `below`; stamps are ns of ROS time. Messages are built
    once: in fast simulations building them would cost more than the physics."""

    def __init__(self, node: Node, power: Sequence[str] = (), temperature: Sequence[str] = (),
                 ranges: Sequence[str] = (), joint: str = "", below: str = "") -> None:
        self._topics: dict[str, tuple[Any, Any]] = {}

        def publish(topic: str, message: Any, frame: str) -> None:
            message.header.frame_id = frame
            publisher = node.create_publisher(type(message), below + topic, READINGS)
            self._topics[topic] = publisher, message

        for channel in power:
            message = BatteryState(location=channel, present=True)
            for field in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
                setattr(message, field, NAN)  # a wire has none of these
            publish(f"{channel}/power", message, channel)
        for place in temperature:
            publish(f"{place}/temperature", Temperature(), place)
        for side in ranges:
            kind = {"radiation_type": Range.INFRARED, "min_range": _NEAREST, "max_range": _FARTHEST}
            publish(f"{side}/range", Range(**kind), f"{side}_range")
        if joint:
            publish("joint_states", JointState(name=[joint]), "")

    def power(self, channel: str, volt: float, ampere: float, stamp: int) -> None:
        """Send V and A of a wire."""
        self._send(f"{channel}/power", stamp, voltage=float(volt), current=float(ampere))

    def temperature(self, place: str, celsius: float, stamp: int, variance: float = 0.0) -> None:
        """Send degC, and the variance (K^2; 0: unknown)."""
        found = {"temperature": float(celsius), "variance": float(variance)}
        self._send(f"{place}/temperature", stamp, **found)

    def range(self, side: str, distance: float, stamp: int) -> None:
        """Send m; infinite out of range (REP-117)."""
        below, beyond = distance < _NEAREST, not distance <= _FARTHEST
        found = -math.inf if below else math.inf if beyond else float(distance)
        self._send(f"{side}/range", stamp, range=found)

    def joint(self, stamp: int, position: float, effort: float | None = None) -> None:
        """Send m, and N if the joint has a force."""
        efforts = [] if effort is None else [float(effort)]
        self._send("joint_states", stamp, position=[float(position)], effort=efforts)

    def _send(self, topic: str, stamp: int, **values: Any) -> None:
        publisher, message = self._topics[topic]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        for field, value in values.items():
            setattr(message, field, value)
        publisher.publish(message)


def message_class(kind: str) -> Any:
    """The class of a message or service type, such as `std_msgs/msg/String`."""
    package, room, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{room}"), name)


def stamp_of(message: Any) -> int:
    """Acquisition time of a message with a header, ns."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def seconds_of(message: Any) -> float:
    """As `stamp_of`, in s."""
    return stamp_of(message) / NANOSECONDS


def clock_fault(node: Node) -> str:
    """Why the clock of this node is not that of its bench, or ""."""
    if node.get_parameter("use_sim_time").value:
        if not node.get_clock().now().nanoseconds:
            return "use_sim_time is set, but there is no /clock"
        real = node.count_publishers(BRIDGE)
        return "use_sim_time is set, but serial_bridge runs in real time" if real else ""
    # Another simulation's clock is not ours.
    ours = f"{node.get_namespace().rstrip('/')}/simulator" in publishers_of(node, CLOCK)
    return "simulator publishes /clock, but use_sim_time is not set here" if ours else ""


def publishers_of(node: Node, topic: str) -> list[str]:
    """Full names of a topic's publishers' nodes."""
    return sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                  for info in node.get_publishers_info_by_topic(topic))


def several_publishers(node: Node, topics: Iterable[str]) -> str:
    """Report of a topic with more than one publisher, or "": nothing shows whose readings are true.
    The graph lists a killed node for some 20 s."""
    for topic in topics:
        if len(names := publishers_of(node, topic)) > 1:
            return f"{topic} has {len(names)} publishers: {shown(', '.join(names), _LONGEST_NAME)}"
    return ""


def recorded_topics(node: Node) -> dict[str, str]:
    """Topics to record in the node's namespace that have a publisher; their types."""
    inside = node.get_namespace().rstrip("/") + "/"
    return {topic: kind for topic, types in node.get_topic_names_and_types()
            if (kind := recorded_type(topic, inside)) in types and node.count_publishers(topic)}


# The sender of a voltage command.
_SIGNED = " @"
_LONGEST_NAME, _MOST_SENDERS = 300, 300  # limits, as anybody may send and sign as anything
_LOOK_EVERY = 0.5  # s
NOT_YET_KNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node of which it knows only an endpoint
_SIGNING = frozenset({*NODE_TABLES, "dashboard"})  # nodes of this package sign


def signature(node: Node) -> str:
    """A node's signature for its commands: its name and a random number."""
    return f"{node.get_fully_qualified_name()}#{uuid.uuid4().hex[:8]}"


def voltage_command(channels: Sequence[str], volts: Sequence[float],
                    signed: str = "") -> Float64MultiArray:
    """Message with V of every channel; its label: the channels' names, or none, and the sender."""
    label = " ".join(channels) + (f"{_SIGNED}{signed}" if signed else "")
    dim = MultiArrayDimension(label=label, size=len(volts), stride=len(volts))
    return Float64MultiArray(layout=MultiArrayLayout(dim=[dim]), data=volts)


def layout_fault(message: Float64MultiArray, channels: Sequence[str]) -> str:
    """Why a command's layout, if it has one, does not match these channels, or ""."""
    layout, names = message.layout, " ".join(channels)
    if layout.data_offset or len(layout.dim) > 1:
        return "voltage_command has another layout, expected one dimension, no offset"
    for dim in layout.dim:
        given = dim.label.partition(_SIGNED)[0]
        if given not in ("", names):
            return f"voltage_command is for {shown(given, 80)!r}, expected {names!r}"
        if dim.size not in (0, len(channels)):
            return f"voltage_command has a dimension of {dim.size}, expected {len(channels)}"
    return ""


def claim_readings(node: Node, channel: str) -> socket.socket:
    """Claim the readings of a bench: those of a forgotten simulator would hide a fault of the
    hardware. InputError: another process has claimed them."""
    return claimed(f"a bench that publishes {node.resolve_topic_name(channel + '/power')}")


class Commanders:
    """The senders of the commands that a node receives."""

    def __init__(self, node: Node) -> None:
        self._node, self._topic = node, node.resolve_topic_name(COMMAND)
        self._signed, self._unsigned = set[str](), list[str]()
        self._looked = -_LOOK_EVERY

    def judge(self, message: Float64MultiArray, channels: Sequence[str]) -> tuple[str, str]:
        """The sender of a command ("": unsigned), and why it must be refused in any case, or ""."""
        fault = layout_fault(message, channels)
        if signed := "".join(dim.label.partition(_SIGNED)[2] for dim in message.layout.dim[:1]):
            sender = shown(signed, _LONGEST_NAME)
            if len(self._signed) < _MOST_SENDERS:
                self._signed.add(sender.partition("#")[0])
            return sender, fault
        if (now := time.monotonic()) >= self._looked + _LOOK_EVERY:
            # Nodes with a publisher of commands that do not sign; one name per publisher.
            self._looked = now
            self._unsigned = [name for name in publishers_of(self._node, self._topic)
                              if name not in self._signed and name.rpartition("/")[2]
                              not in (*_SIGNING, NOT_YET_KNOWN)]
        if not fault and len(self._unsigned) > 1 and any(message.data):
            senders = ", ".join(self._unsigned)
            fault = f"unsigned command, and several nodes may have sent it: {senders}"
        return "", fault
