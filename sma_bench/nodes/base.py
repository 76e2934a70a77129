"""What every node of the package shares: parameters from the tables, and a clean end."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial
from typing import Any, ClassVar

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.lifeline import end_with_starter, ending_signals
from sma_bench.nodes.arguments import check_arguments, node_help
from sma_bench.parameters import TABLE, Parameter, Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.yaml_file import split_names, stated_names
from sma_bench.ros.node import OneThreadExecutor, OverridableNode, start_ros
from sma_bench.ros.processes import claimed

# Real-time priorities: below any of the kernel's own threads, above all else that a desk's
# computer does. What keeps the device supplied goes first.
BRIDGE, DRIVER, CAMERA = 12, 11, 10
_NICE = -10

# Signals arrive at Python only between two waits of the executor.
_SIGNAL_LATENCY = 0.1

_DIAGNOSE_EVERY = 1.0

_RANGES = {
    "double": (FloatingPointRange, "floating_point_range"),
    "integer": (IntegerRange, "integer_range"),
}


class BenchNode(OverridableNode):
    """Node with the contract's parameters (`parameters`) and its own ones (`settings`).

    Both are validated as a whole whenever one changes; a change that cannot be is refused with
    the reason.
    """

    frozen = False
    """True where nothing may change while the node runs."""
    fixed: frozenset[str] = frozenset()
    """Names that may not change while the node runs, where others may."""
    with_uncertainty = False
    """True where the node has use for the `uncertainty.` parameters."""
    executor_type: ClassVar[Callable[[], Executor]] = OneThreadExecutor

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Another clock in the middle of a run would spoil every stamp.
        self.set_descriptor("use_sim_time", ParameterDescriptor(
            name="use_sim_time", type=ParameterType.PARAMETER_BOOL, read_only=True,
            description="Time is that of /clock.",
        ))  # fmt: skip
        self.failure: InputError | None = None
        self._claims = [claimed(self.get_fully_qualified_name())]
        if self.get_parameter("use_sim_time").value:
            backward = JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
            )
            self._jumps = self.get_clock().create_jump_callback(
                backward, post_callback=lambda jump: self.on_time_went_back(
                    f"simulated time went back by {-jump.delta.nanoseconds / 1e9:.3f} s: another "
                    "publisher of /clock, or a new simulation"
                ),
            )  # fmt: skip

        # Parameters: the contract's, their deviations where the node has use for them, its own.
        self._own = {parameter.name: parameter for parameter in NODE_TABLES[name]}
        overrides = {name: p.value for name, p in self._parameter_overrides.items()}
        self._stated = stated_names(overrides).keys()
        self._contract = {parameter.name: parameter for parameter in TABLE}
        for p in TABLE if self.with_uncertainty else ():
            if p.uncertainty is not None:
                std = p.uncertainty if p.name in self._stated else p.default_std
                about = f"Standard deviation of {p.name}."
                deviation = UNCERTAINTY_PREFIX + p.name
                self._contract[deviation] = Parameter(
                    deviation, p.unit, std or 0.0, about, "table", 0.0, 1e15
                )
        for p in (*self._contract.values(), *self._own.values()):
            unit = f" [{p.unit}]" if p.unit else ""
            descriptor = ParameterDescriptor(
                description=f"{p.description}{unit} Source: {p.provenance}.",
                read_only=self.frozen or p.read_only,
            )
            if p.low is not None and p.high is not None:
                kind, field = _RANGES[p.kind]
                setattr(descriptor, field, [kind(from_value=p.low, to_value=p.high)])
            value = list(p.default) if isinstance(p.default, tuple) else p.default
            try:
                self.declare_parameter(p.name, value, descriptor)
            except ParameterException as error:
                raise InputError(" ".join(str(error).split())) from None
        self._load()
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._load)

        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.every(_DIAGNOSE_EVERY, self.diagnose)

    def listen(
        self, kind: type, what: str, on_message: Callable[..., None], qos: QoSProfile | int,
        numbered: bool = False,
    ) -> None:
        """Subscribe to `<channel>/WHAT` of every channel: on_message(channel, message), with the
        channel's number for its name where `numbered`."""
        for k, channel in enumerate(self.parameters["bench.channels"]):
            heard = partial(on_message, k if numbered else channel)
            self.create_subscription(kind, f"{channel}/{what}", heard, qos)

    def every(self, seconds: float, act: Callable[[], None]) -> None:
        """Call `act` once in so many s of the wall's clock."""
        self.create_timer(seconds, act, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def serve(self, **acts: Callable[[], str | tuple[bool, str]]) -> None:
        """Make services `~/NAME` (std_srvs/Trigger) of acts, which return the line of a success, or
        whether they succeeded and the line; an InputError is the line of a failure."""
        for name, act in acts.items():
            self.create_service(Trigger, f"~/{name}", partial(_answer, act))

    def fail(self, error: InputError) -> None:
        """End the node after this callback, with the error's line and status 2.

        Raising would do so too, but executors print a traceback on the way.
        """
        self.failure = self.failure or error

    def held(self) -> Set[str]:
        """Names that may not change now."""
        return self.fixed

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Refuse a change of the node's own parameters by raising InputError."""

    def claim(self, what: str) -> None:
        """Be the only one of this machine and ROS domain that has it; InputError if another is."""
        self._claims.append(claimed(what))

    def destroy_node(self) -> None:
        """Give back what was claimed."""
        super().destroy_node()
        for claim in self._claims:
            claim.close()

    def on_time_went_back(self, reason: str) -> None:
        """Simulated time did what time never does; `reason` is a line for people."""

    def drain(self, spin: Callable[[], None]) -> None:
        """Take what has arrived already before the end; `spin` runs one waiting callback."""

    def close(self) -> None:
        """Put everything in a safe state; the context is still valid."""

    def health(self) -> list[DiagnosticStatus]:
        """What the node says of itself on `/diagnostics`, once a second."""
        return [self.status("node", message="running")]

    def status(
        self, name: str, level: bytes = DiagnosticStatus.OK, message: str = "",
        values: Mapping[str, Any] | None = None, hardware: str = "",
    ) -> DiagnosticStatus:
        """One line of `health`; `name` is that of the part it speaks of."""
        return DiagnosticStatus(
            level=level, name=f"{self.get_fully_qualified_name()}: {name}", message=message,
            hardware_id=hardware or self.get_name(),
            values=[KeyValue(key=key, value=str(v)) for key, v in (values or {}).items()],
        )

    def diagnose(self) -> None:
        """Publish `health` now, beside once a second."""
        message = DiagnosticArray(status=self.health())
        message.header.stamp = self.stamp()
        self._diagnostics.publish(message)

    def stamp(self) -> Time:
        """Now, by the bench's clock."""
        return self.get_clock().now().to_msg()

    def _load(self, *_: Any) -> None:
        self.settings, self.parameters = self._validated({})

    def _validated(self, changed: dict[str, Any]) -> tuple[dict[str, Any], Parameters]:
        """Own and contract parameters with `changed` applied; InputError when they cannot be."""
        values = {
            name: changed[name] if name in changed else self.get_parameter(name).value
            for name in (*self._own, *self._contract)
        }
        settings = {name: p.validated(values[name]) for name, p in self._own.items()}
        # Names left at their default stay unstated, as when read from a file.
        given = {
            name: values[name] for name, p in self._contract.items()
            if name in self._stated or _plain(values[name]) != _plain(p.default)
        }
        return settings, Parameters(*split_names(given))

    def _check_change(self, changes: list[RosParameter]) -> SetParametersResult:
        changed = {
            change.name: change.value
            for change in changes
            if change.name in self._own or change.name in self._contract
        }
        for name in self.held() & changed.keys():
            if _plain(changed[name]) != _plain(self.get_parameter(name).value):
                reason = f"{name} cannot change while the node runs"
                return SetParametersResult(successful=False, reason=reason)
        try:
            settings, _ = self._validated(changed)
            if any(name in self._own for name in changed):
                self.check_settings(settings)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def run_node(name: str, kind: type[Any], argv: Sequence[str] | None = None) -> int:
    """Run a node until SIGINT, SIGTERM or the end of its ROS context.

    The signals are handled here and not by rclpy, whose handler invalidates the context before a
    node can send its last message.

    Returns:
        0 at a clean end, 2 after bad input, of which one line goes to standard error.
    """
    end_with_starter(signal.SIGINT)
    arguments = list(sys.argv[1:] if argv is None else argv)
    if "-h" in arguments or "--help" in arguments:
        print(node_help(name), end="")
        return 0
    asked = threading.Event()  # asked twice it is no more
    before = {number: signal.signal(number, lambda *_: asked.set()) for number in ending_signals()}
    node: BenchNode | None = None
    try:
        check_arguments(name, arguments)
        start_ros(arguments)
        # A node that simulates waits once after an installation; others have no compiler loaded.
        if compiled := sys.modules.get("sma_bench.compiled"):
            say = get_logger(name).info
            compiled.when_compiling(lambda: say("waits for the compiler, once, some 20 s"))
        node = kind()
        executor = kind.executor_type()
        executor.add_node(node)
        try:
            while rclpy.ok() and not asked.is_set() and node.failure is None:
                # Not spin(): EventsExecutor's runs no callback, and no wait may outlast a signal.
                executor.spin_once(timeout_sec=_SIGNAL_LATENCY)
        finally:
            if rclpy.ok():
                node.drain(lambda: executor.spin_once(timeout_sec=0.0))
                node.close()
            executor.shutdown(timeout_sec=1.0)
        if node.failure is not None:
            raise node.failure
    except InputError as error:
        with contextlib.suppress(OSError):  # nobody may be left to read it
            print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except (ExternalShutdownException, KeyboardInterrupt):  # the latter of what it waited for
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def be_punctual(priority: int) -> str:
    """Have this process scheduled before others, as far as its user may; how it is scheduled.

    A bench whose host is late stops itself. Niceness alone is no help on a desktop: where the
    kernel groups processes by session (autogroup), it counts within a terminal only.
    """
    with contextlib.suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))
        return f"real time, priority {priority}"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
        return f"niceness {_NICE}"
    return "as any program: see docs/hardware.md, a computer in time"


def _answer(
    act: Callable[[], str | tuple[bool, str]], _: Trigger.Request, response: Trigger.Response
) -> Trigger.Response:
    try:
        answer = act()
        response.success, response.message = answer if isinstance(answer, tuple) else (True, answer)
    except InputError as error:
        response.success, response.message = False, str(error)
    return response


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else value
