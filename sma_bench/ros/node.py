"""A process's ROS context, and nodes whose QoS users can override."""

import copy
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

try:
    # A quarter of the CPU time of SingleThreadedExecutor; not in the first releases of Jazzy.
    from rclpy.experimental import EventsExecutor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as EventsExecutor

from sma_bench.errors import InputError
from sma_bench.ros.discovery import choose_discovery

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
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., None],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """As rclpy's, and `qos_overrides./<topic>.subscription.` parameters change its QoS."""
        return self._endpoint(
            super().create_subscription, topic, qos_profile, options, msg_type, callback
        )

    def _endpoint(
        self,
        create: Callable[..., Any],
        topic: str,
        qos: QoSProfile | int,
        options: dict[str, Any],
        msg_type: Any,
        *callback: Any,
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
