"""Base class of all nodes: parameters from tables, services, diagnostics, a clean end."""

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Set
from functools import partial
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces import msg as rcl
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.border import claimed, printable, shown
from sma_bench.errors import InputError
from sma_bench.live.recording import BRIDGE as BRIDGE_STATE
from sma_bench.live.recording import RECORDER, RUN_STATES, STATE
from sma_bench.parameters import TABLE, Parameter, Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX
from sma_bench.parameters.yaml_file import stated_names
from sma_bench.ros import node as ros

# Real-time priorities, below the kernel's own threads; the node that drives the device is highest.
BRIDGE, DRIVER, CAMERA = 12, 11, 10
_LAST_MESSAGES = 1.0  # s for subscribers to receive them
_AT_ONCE = 100_000  # ns between two readings of a clock, if the process was not interrupted
Answer = str | tuple[bool, str]


class BenchNode(ros.OverridableNode):
    """Node with the contract's parameters (`parameters`) and its own (`settings`), declared from
    the tables and validated as a whole at every change, which is refused with a reason."""

    frozen = False  # True: no parameter may change while the node runs
    limits = ""  # of a node that drives, with their sources, as text
    with_uncertainty = False  # True: it uses the `uncertainty.` parameters
    executor_type: ClassVar[Callable[[], Executor]] = ros.OneThreadExecutor

    def __init__(self, name: str) -> None:
        super().__init__(name)
        if "twin" in self.get_namespace().split("/"):
            raise InputError(f"namespace {self.get_namespace()}: recorders and readers ignore "
                             "topics below twin/, expected another name")
        if self.get_name() != name and f"{name}{STATE}" in {RECORDER, BRIDGE_STATE, *RUN_STATES}:
            raise InputError(f"renamed to {self.get_name()}: other nodes look for {name} by its "
                             "name; another bench has another namespace (-r __ns:=/other)")
        self.failure: InputError | None = None
        self._to_ros = 0
        self.claims = [claimed(self.get_fully_qualified_name())]
        # A change of clock during a run would spoil all stamps.
        self.set_descriptor("use_sim_time", rcl.ParameterDescriptor(
            name="use_sim_time", type=rcl.ParameterType.PARAMETER_BOOL, read_only=True,
            description="Time is that of /clock."))
        self.simulated: bool = self.get_parameter("use_sim_time").value
        if self.simulated:
            backward = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1),
                                     on_clock_change=False)
            self._jumps = self.get_clock().create_jump_callback(
                backward, post_callback=lambda jump: self.on_time_went_back(
                    f"simulated time went back by {-jump.delta.nanoseconds / 1e9:.3f} s: another "
                    "publisher of /clock, or a new simulation"))
        # Parameters: the contract's, their uncertainties if the node uses them, its own.
        self._own = {p.name: p for p in NODE_TABLES[name]}
        self._contract = {p.name: p for p in TABLE}
        given = {name: p.value for name, p in self._parameter_overrides.items()}
        self._stated = stated_names(given).keys()
        for p in TABLE if self.with_uncertainty else ():
            if p.uncertainty is not None:
                std = p.stated_std(given.get(p.name)) if p.name in self._stated else p.default_std
                own, about = UNCERTAINTY_PREFIX + p.name, f"Standard deviation of {p.name}."
                self._contract[own] = Parameter(own, p.unit, std or 0.0, about, "table", 0.0, 1e15)
        for p in (*self._contract.values(), *self._own.values()):
            about = f"{p.description}{f' [{p.unit}]' if p.unit else ''} Source: {p.provenance}."
            descriptor = rcl.ParameterDescriptor(description=about,
                                                 read_only=self.frozen or p.read_only)
            if p.low is not None and p.high is not None:
                ends = {"from_value": p.low, "to_value": p.high}
                if p.kind == "int":
                    descriptor.integer_range = [rcl.IntegerRange(**ends)]
                else:
                    descriptor.floating_point_range = [rcl.FloatingPointRange(**ends)]
            value = list(p.default) if isinstance(p.default, tuple) else p.default
            try:
                self.declare_parameter(p.name, value, descriptor)
            except ParameterException as error:
                raise InputError(" ".join(str(error).split())) from None
        self._load()
        self.add_on_set_parameters_callback(self._check_change)
        self.add_post_set_parameters_callback(self._load)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", ros.READINGS)
        self.every(1.0, self.diagnose)

    def listen(self, kind: type, what: str, on_message: Callable[..., None], numbered: bool = False,
               qos: QoSProfile = ros.READINGS, newest: bool = False) -> None:
        """Subscribe to `<channel>/WHAT` of each channel: on_message(channel or number, message)."""
        for k, channel in enumerate(self.parameters["bench.channels"]):
            heard = partial(on_message, k if numbered else channel)
            self.create_subscription(kind, f"{channel}/{what}", heard, qos, newest=newest)

    def line(self, topic: str) -> Callable[[str], None]:
        """A function that publishes a text (std_msgs/String, latched)."""
        publisher = self.create_publisher(String, topic, ros.LATCHED)
        return lambda text: publisher.publish(String(data=text))

    def wait_for_listeners(self) -> None:
        """Wait until subscribers have the last messages, 1 s at most."""
        end = time.monotonic() + _LAST_MESSAGES
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))

    def taken(self, message: Any) -> float:
        """Acquisition time of a reading: s of simulated time, else of the monotonic clock."""
        offset = 0 if self.simulated else self.to_ros()
        return (ros.stamp_of(message) - offset) / ros.NANOSECONDS

    def to_ros(self) -> int:
        """ns from the monotonic clock to ROS time, which may be set while the node runs."""
        # An interruption between reading the two clocks would shift all stamps: skip such pairs.
        before = time.monotonic_ns()
        stamps = self.get_clock().now().nanoseconds
        after = time.monotonic_ns()
        if after - before < _AT_ONCE or not self._to_ros:
            self._to_ros = stamps - (before + after) // 2
        return self._to_ros

    def every(self, seconds: float, act: Callable[[], None]) -> None:
        """Call `act` every so many s of wall time."""
        self.create_timer(seconds, act, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def serve(self, group: CallbackGroup | None = None, **acts: Callable[[], Answer]) -> None:
        """Offer services `~/NAME` (std_srvs/Trigger). `acts` return the message of a success, or
        (success, message); an InputError is the message of a failure."""

        def answered(act: Callable[[], Answer], _: Any, response: Any) -> Trigger.Response:
            try:
                out = act()
            except InputError as error:
                out = False, " ".join(str(error).split())
            response.success, response.message = out if isinstance(out, tuple) else (True, out)
            return response

        for name, act in acts.items():
            self.create_service(Trigger, f"~/{name}", partial(answered, act), callback_group=group)

    def fail(self, error: InputError) -> None:
        """End the node after this callback, with this error and status 2; do not raise it."""
        self.failure = self.failure or error

    # --- for nodes to override

    def held(self) -> Set[str]:
        """Names of parameters that may not change now."""
        return frozenset()

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Refuse a change of the node's own parameters by raising InputError."""

    def on_time_went_back(self, reason: str) -> None:
        """Called when simulated time went back; `reason` is a line for the user."""

    def drain(self, spin: Callable[[], None]) -> None:
        """Before the end, process what has arrived; `spin` runs one waiting callback."""

    def close(self) -> None:
        """Put everything in a safe state; the context is still valid."""

    def health(self) -> list[DiagnosticStatus]:
        """The node's status for `/diagnostics`, once a second."""
        return [self.status("node", message="running")]

    def status(self, name: str, level: bytes = DiagnosticStatus.OK, message: str = "",
               values: Mapping[str, Any] | None = None, hardware: str = "") -> DiagnosticStatus:
        """One entry of `health`; `name`: the part of the node that it is about."""
        return DiagnosticStatus(
            level=level, name=f"{self.get_fully_qualified_name()}: {name}", message=message,
            hardware_id=hardware or self.get_name(),
            values=[KeyValue(key=key, value=str(v)) for key, v in (values or {}).items()])

    def warnings(self, **reasons: str) -> list[DiagnosticStatus]:
        """Entries of `health`, one for each reason that is not "", named by its keyword; the log
        has them once a minute."""
        found = {name: text for name, text in reasons.items() if text}
        if found:
            self.get_logger().warning("; ".join(found.values()), throttle_duration_sec=60.0)
        return [self.status(name, DiagnosticStatus.WARN, text) for name, text in found.items()]

    def diagnose(self) -> None:
        """Publish `health` now."""
        message = DiagnosticArray(status=self.health())
        if self.limits:
            message.status.append(self.status("limits", message=self.limits))
        message.header.stamp = self.stamp()
        self._diagnostics.publish(message)

    def stamp(self) -> Time:
        return self.get_clock().now().to_msg()

    def destroy_node(self) -> None:
        super().destroy_node()
        for claim in self.claims:
            claim.close()

    def set_parameters_atomically(self, parameter_list: Any) -> rcl.SetParametersResult:
        """As in rclpy, but loads files of `ros2 param dump`: an unchanged value is accepted even if
        read-only, and so are floats such as 8e-06, which that command writes as text."""
        changes = []
        for p in parameter_list:
            before = self.get_parameter_or(p.name).value
            if isinstance(before, float) and isinstance(p.value, str):
                with contextlib.suppress(ValueError):
                    p = RosParameter(p.name, value=float(p.value))
            if str(_plain(p.value)) != str(_plain(before)):
                changes.append(p)
        unchanged = rcl.SetParametersResult(successful=True)
        return super().set_parameters_atomically(changes) if changes else unchanged

    def _load(self, *_: Any) -> None:
        self.settings, self.parameters = self._validated({})

    def _validated(self, changed: Mapping[str, Any]) -> tuple[dict[str, Any], Parameters]:
        """Own and contract parameters with `changed` applied. InputError: not valid."""
        values = {name: changed.get(name, self.get_parameter_or(name).value)
                  for name in (*self._own, *self._contract)}
        values = {name: [] if v is None else v for name, v in values.items()}  # rclpy's empty list
        settings = {name: p.validated(values[name]) for name, p in self._own.items()}
        for name, value in settings.items():
            for text in value if isinstance(value, tuple) else (value,):
                if not str(text).isprintable():  # it would break a line of the log, or a path
                    raise InputError(f"{name}: '{printable(str(text))}', expected printable text")
        # Names left at their default stay unstated, as when read from a file.
        given = {name: values[name] for name, p in self._contract.items()
                 if name in self._stated or _plain(values[name]) != _plain(p.default)}
        return settings, Parameters(given)

    def _check_change(self, changes: list[RosParameter]) -> rcl.SetParametersResult:
        known = self._own.keys() | self._contract.keys()
        changed = {change.name: change.value for change in changes if change.name in known}
        try:
            for name in self.held() & changed.keys():
                if _plain(changed[name]) != _plain(self.get_parameter(name).value):
                    raise InputError(f"{name} cannot change while the node runs")
            settings, _ = self._validated(changed)
            if self._own.keys() & changed.keys():
                self.check_settings(settings)
        except InputError as error:
            return rcl.SetParametersResult(successful=False, reason=shown(str(error)))
        return rcl.SetParametersResult(successful=True)


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else value


def be_punctual(priority: int) -> str:
    """Raise this process's priority as far as its user may; returns how it is scheduled.
    Niceness alone does not help if the kernel groups processes by session (autogroup)."""
    with contextlib.suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))
        return f"real time, priority {priority}"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
        return "niceness -10"
    return "as any program: see docs/hardware.md, a computer in time"
