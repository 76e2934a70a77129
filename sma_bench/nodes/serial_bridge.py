"""The bench's Uno on ROS: readings out, volts in, under the rules of hardware/safety.py.

States: not connected, idle, enabled, stopped (with the reason). It connects again by itself, and
never enables by itself.
"""

import sys
import time
from collections import deque
from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.bench_sensors import SIDES, BenchReading, BenchSensors
from sma_bench.hardware.conversation import LinkError, Port, find_port, open_port
from sma_bench.hardware.device import Reading
from sma_bench.hardware.node_reports import Tally, driver_values, link_values, tally_values
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.hardware.serial_link import LinkOptions, SerialLink
from sma_bench.nodes.base import BRIDGE, BenchNode, be_punctual
from sma_bench.nodes.bench_topics import PowerTopics, RangeTopics, follow_recorder
from sma_bench.ros.node import COMMAND, COMMANDED, LATCHED, Commanders, layout_fault

_NANOSECONDS = 1e9
_TICK = 0.005
_REPORT = 1.0
_SWITCH = 1e-4
_AT_ONCE = 100_000
"""ns"""
_CLOCK_STEP = 1000
"""Hz: telemetry windows are whole milliseconds"""


class SerialBridge(BenchNode):
    """The link has its own thread; all else happens in the node's."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("serial_bridge")
        if self.get_parameter("use_sim_time").value:
            raise InputError("use_sim_time is set, but hardware runs in real time")
        self._rate = self.settings["telemetry_rate"]
        if _CLOCK_STEP % self._rate:
            raise InputError(
                f"telemetry_rate is {self._rate} Hz, expected a divisor of {_CLOCK_STEP}"
            )
        self._scheduling = be_punctual(BRIDGE)
        # The link's thread reads its clock when bytes arrive: it must not wait for this one.
        sys.setswitchinterval(_SWITCH)
        self._arrived: deque[Reading] = deque()
        self._events: deque[str] = deque()
        self._tally = Tally()
        self._last_state = ""
        # ns from the monotonic clock to ROS time; the system's clock may be set meanwhile.
        self._to_ros = 0
        if self.parameters["bench.drive"] == "current":
            raise InputError(
                "serial_bridge: bench.drive is current, but the Uno switches a voltage, "
                "expected voltage or duty"
            )
        self._channels = self.parameters["bench.channels"]
        self._sensors = BenchSensors(self.parameters["bench.channel_sides"], self.settings)
        self._link = SerialLink(
            self._open, LinkOptions(rate=self._rate), self._arrived.append, self._events.append
        )
        guard = Guard(
            self._channels, self.settings["feedback"], self.settings["feedback_timeout"]
        )
        limits = Limits.from_parameters(self.parameters)
        self._driver = BenchDriver(
            self._link, self._sensors, guard, self._channels, limits,
            self.settings["self_test_waived"],
        )  # fmt: skip
        self._make_topics()
        self._link.start()  # connects, again and again if need be

    def close(self) -> None:
        """Outputs off, port closed."""
        self._link.close()

    def _make_topics(self) -> None:
        self._power = PowerTopics(self, self._channels)
        sensors = self._sensors.range_sensors
        self._ranges = RangeTopics(self, sensors) if sensors else None
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self.create_subscription(
            Float64MultiArray, COMMAND, self._on_command, COMMANDED
        )
        self._commanders = Commanders(self)
        for channel in self._channels:
            self.create_subscription(
                Temperature, f"{channel}/temperature", partial(self._on_temperature, channel), 10
            )
        follow_recorder(self, lambda failure: self._driver.recorder(failure))
        requests = {
            "enable": self._enable, "stop": self._stop, "reset": self._reset,
            "self_test": self._self_test,
        }
        for name, act in requests.items():
            self.create_service(Trigger, f"~/{name}", partial(self._answer, act))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_TICK, self._tick, clock=steady)

    def _open(self) -> Port:
        return open_port(self.settings["port"] or find_port())

    # --- readings and commands ----------------------------------------------------------------

    def _tick(self) -> None:
        self._relate_clocks()
        while self._arrived:
            reading = self._arrived.popleft()
            self._publish(self._driver.take(reading, time.monotonic()))
        if reason := self._driver.tick(time.monotonic()):
            self.get_logger().error(f"0 V: {reason}")
        self._tell_state()
        while self._events:
            if (event := self._events.popleft()) != self._last_state:
                self.get_logger().info(event)

    def _relate_clocks(self) -> None:
        before = time.monotonic_ns()
        ros = self.get_clock().now().nanoseconds
        after = time.monotonic_ns()
        # Whoever was kept waiting between the two clocks would shift every stamp.
        if after - before < _AT_ONCE or not self._to_ros:
            self._to_ros = ros - (before + after) // 2

    def _publish(self, reading: BenchReading) -> None:
        stamp = round(_NANOSECONDS * reading.time) + self._to_ros
        self._power.publish(
            [(power.voltage, power.current) for power in reading.powers], stamp
        )
        if self._ranges is not None:
            distances = dict(zip(SIDES, reading.distances, strict=True))
            self._ranges.publish(distances, reading.deflection, stamp)
        self._tally.note(time.monotonic() - reading.time)

    def _on_command(self, message: Float64MultiArray) -> None:
        sender, obstacle = self._commanders.of(message)
        fault = layout_fault(message, self._channels) or (obstacle if any(message.data) else "")
        if fault:
            reason = self._driver.gate.refuse(fault)
        else:
            reason = self._driver.command(message.data, time.monotonic(), sender)
        if reason:
            self.get_logger().warning(f"rejected: {reason}", throttle_duration_sec=1.0)

    def _on_temperature(self, channel: str, message: Temperature) -> None:
        kelvin = message.temperature + CELSIUS_ZERO
        stamp = message.header.stamp.sec + message.header.stamp.nanosec / _NANOSECONDS
        self._tally.temperatures[channel] = kelvin
        self._driver.temperature(
            channel, kelvin, stamp - self._to_ros / _NANOSECONDS, time.monotonic()
        )

    # --- requests -----------------------------------------------------------------------------

    def _answer(
        self, act: Callable[[], str], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message, response.success = act(), True
        except LinkError as error:
            response.message, response.success = str(error), False
        self._tell_state()
        return response

    def _enable(self) -> str:
        self._driver.enable(time.monotonic())
        return self._driver.state

    def _stop(self) -> str:
        self._driver.stop("stopped on request")
        return self._driver.state

    def _reset(self) -> str:
        self._driver.reset()
        return self._driver.state

    def _self_test(self) -> str:
        findings = self._driver.self_test()
        text = "; ".join(map(str, findings))
        if not all(finding.passed for finding in findings):
            raise LinkError(text)
        return text

    # --- reports ------------------------------------------------------------------------------

    def _tell_state(self) -> None:
        state = self._driver.state
        if state != self._last_state:
            self._last_state = state
            self._state.publish(String(data=state))
            self.get_logger().info(state)

    def health(self) -> list[DiagnosticStatus]:
        """State, link and timing of the bench."""
        status, state = self._link.status, self._driver.state
        if self._driver.flowing:
            self.get_logger().fatal(state)
        values = {
            **driver_values(self._driver, time.monotonic()),
            **tally_values(self._tally, _REPORT),
            **link_values(status),
            "commanders": str(self.count_publishers(COMMAND)),
            "scheduling": self._scheduling,
        }
        self._tally = Tally(temperatures=self._tally.temperatures)
        return [self.status(
            "bench", self._level(state), state, values, values.get("firmware", "no device")
        )]  # fmt: skip

    def _level(self, state: str) -> bytes:
        if state not in ("idle", "enabled"):
            return DiagnosticStatus.ERROR
        return DiagnosticStatus.WARN if self._driver.gate.rejected else DiagnosticStatus.OK
