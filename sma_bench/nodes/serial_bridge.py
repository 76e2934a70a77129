"""The bench's Uno on ROS: readings out, volts in, under the rules of hardware/safety.py.

States: not connected, idle, enabled, stopped (with the reason). It connects again by itself, and
never enables by itself.
"""

import sys
import time
from collections import deque
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray, String

from sma_bench.errors import InputError
from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.bench_sensors import SIDES, BenchSensors
from sma_bench.hardware.conversation import LinkError, find_port, open_port
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
            lambda: open_port(self.settings["port"] or find_port()),
            LinkOptions(rate=self._rate), self._arrived.append, self._events.append,
        )  # fmt: skip
        settings = self.settings
        guard = Guard(self._channels, settings["feedback"], settings["feedback_timeout"])
        limits = Limits.from_parameters(self.parameters)
        self._driver = BenchDriver(
            self._link, self._sensors, guard, self._channels, limits, settings["self_test_waived"]
        )
        self._power = PowerTopics(self, self._channels)
        sensors = self._sensors.range_sensors
        self._ranges = RangeTopics(self, sensors) if sensors else None
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self.create_subscription(Float64MultiArray, COMMAND, self._on_command, COMMANDED)
        self._commanders = Commanders(self)
        self.listen(Temperature, "temperature", self._on_temperature, 10)
        follow_recorder(self, self._driver.recorder)
        driver = self._driver
        self.serve(
            enable=lambda: self._ask(lambda: driver.enable(time.monotonic())),
            stop=lambda: self._ask(lambda: driver.stop("stopped on request")),
            reset=lambda: self._ask(driver.reset), self_test=lambda: self._ask(self._self_test),
        )  # fmt: skip
        self.every(_TICK, self._tick)
        self._link.start()  # connects, again and again if need be

    def close(self) -> None:
        self._link.close()

    # --- readings and commands ----------------------------------------------------------------

    def _tick(self) -> None:
        # Whoever was kept waiting between the two clocks would shift every stamp.
        before = time.monotonic_ns()
        ros = self.get_clock().now().nanoseconds
        after = time.monotonic_ns()
        if after - before < _AT_ONCE or not self._to_ros:
            self._to_ros = ros - (before + after) // 2
        while self._arrived:
            reading = self._driver.take(self._arrived.popleft(), time.monotonic())
            stamp = round(_NANOSECONDS * reading.time) + self._to_ros
            self._power.publish([(p.voltage, p.current) for p in reading.powers], stamp)
            if self._ranges is not None:
                distances = dict(zip(SIDES, reading.distances, strict=True))
                self._ranges.publish(distances, reading.deflection, stamp)
            self._tally.note(time.monotonic() - reading.time)
        if reason := self._driver.tick(time.monotonic()):
            self.get_logger().error(f"0 V: {reason}")
        self._tell_state()
        while self._events:
            if (event := self._events.popleft()) != self._last_state:
                self.get_logger().info(event)

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

    def _ask(self, act: Callable[[], str | None]) -> tuple[bool, str]:
        """Have the driver do something; its line, or the bench's state after it."""
        try:
            return True, act() or self._driver.state
        except LinkError as error:
            return False, str(error)
        finally:
            self._tell_state()

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
        level = DiagnosticStatus.WARN if self._driver.gate.rejected else DiagnosticStatus.OK
        if state not in ("idle", "enabled"):
            level = DiagnosticStatus.ERROR
        return [self.status("bench", level, state, values, values.get("firmware", "no device"))]
