"""The bench's Uno on ROS: publishes readings and sends voltages, under hardware/safety.py's rules.

States: not connected, idle, enabled, stopped: why. It connects by itself, but never enables."""

import math
import sys
import time
from collections import deque
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray, String

from sma_bench.errors import InputError
from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.bench_sensors import SIDES, BenchReading, BenchSensors
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits, checked_feedback
from sma_bench.hardware.serial_link import LinkError, SerialLink, find_port, open_port
from sma_bench.hardware.serial_messages import Telemetry
from sma_bench.live.recording import RECORDER, recorder_failure
from sma_bench.nodes.base import BRIDGE, BenchNode, be_punctual
from sma_bench.parameters.parameter import SOURCES
from sma_bench.ros import node as ros

_TICK = 0.005  # s
_SWITCH = 1e-4  # s: short, so that the link's thread can read its clock as soon as bytes arrive
_CLOCK_STEP = 1000  # Hz: telemetry windows are whole milliseconds


class SerialBridge(BenchNode):
    """The link has its own thread; all else runs in the node's."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("serial_bridge")
        settings, rate = self.settings, self.settings["telemetry_rate"]
        if self.simulated:
            raise InputError("use_sim_time is set, but hardware runs in real time")
        if _CLOCK_STEP % rate:
            raise InputError(f"telemetry_rate is {rate} Hz, expected a divisor of {_CLOCK_STEP}")
        if (drive := self.parameters["bench.drive"]) in SOURCES:
            raise InputError(f"bench.drive is {drive}, expected voltage or duty, as the Uno drives")
        self._scheduling, self._last_state = be_punctual(BRIDGE), ""
        sys.setswitchinterval(_SWITCH)
        self._arrived, self._events = deque[Telemetry](), deque[str]()
        # Since the last report: readings, highest age of one (s); newest temperatures (K).
        self._readings, self._oldest = 0, 0.0
        self._kelvin: dict[str, float] = {}
        self._channels = self.parameters["bench.channels"]
        sensors = BenchSensors(self.parameters["bench.channel_sides"], settings)
        self._link = SerialLink(lambda: open_port(settings["port"] or find_port()),
                                rate, self._arrived.append, self._events.append)
        self._guard = Guard(self._channels, checked_feedback(settings["feedback"]),
                            settings["feedback_timeout"])
        self._limits = Limits.from_parameters(self.parameters)
        self._driver = driver = BenchDriver(self._link, sensors, self._guard, self._channels,
                                            self._limits, settings["self_test_waived"])
        self._sides = tuple(sensors.range_sensors)
        self._topics = ros.BenchTopics(self, self._channels, ranges=self._sides,
                                       joint="tip" if self._sides else "")
        self._enter = self.line("~/state")
        self._commanders = ros.Commanders(self)
        self.create_subscription(Float64MultiArray, ros.COMMAND, self.on_command, ros.READINGS)
        self.listen(Temperature, "temperature", self.on_temperature, newest=True)
        self.create_subscription(String, RECORDER, lambda message: self._guard.recorder(
            recorder_failure(message.data)), ros.LATCHED)
        self.serve(enable=lambda: self._ask(self._enable),
                   stop=lambda: self._ask(lambda: driver.stop("stopped on request")),
                   reset=lambda: self._ask(driver.reset),
                   self_test=lambda: self._ask(self._self_test))
        self.every(_TICK, self._tick)
        self._link.start()

    def close(self) -> None:
        self._link.close()

    def _tick(self) -> None:
        while self._arrived:
            self._publish(self._driver.take(self._arrived.popleft(), time.monotonic()))
            self._check()  # the next reading may hide this one's fault
        self._check()
        self._publish_state()
        while self._events:
            if (event := self._events.popleft()) != self._last_state:
                self.get_logger().info(event)

    def _publish(self, reading: BenchReading) -> None:
        stamp = round(ros.NANOSECONDS * reading.time) + self.to_ros()
        for channel, power in zip(self._channels, reading.powers, strict=True):
            self._topics.power(channel, *power, stamp)
        for side in self._sides:
            self._topics.range(side, reading.distances[SIDES.index(side)], stamp)
        if self._sides and not math.isnan(reading.deflection):
            self._topics.joint(stamp, reading.deflection)
        self._readings += 1
        self._oldest = max(self._oldest, time.monotonic() - reading.time)

    def _check(self) -> None:
        if reason := self._driver.tick(time.monotonic()):
            self.get_logger().error(f"0 V: {reason}")

    def on_command(self, message: Float64MultiArray) -> None:
        driver, now = self._driver, time.monotonic()
        sender, fault = self._commanders.judge(message, self._channels)
        reason = driver.gate.refuse(fault) if fault else driver.command(message.data, now, sender)
        if reason:
            self.get_logger().warning(f"rejected: {reason}", throttle_duration_sec=1.0)

    def on_temperature(self, channel: str, message: Temperature) -> None:
        kelvin = message.temperature + CELSIUS_ZERO
        taken, self._kelvin[channel] = self.taken(message), kelvin
        self._guard.temperature(channel, kelvin, taken, time.monotonic(), self._limits)
        self._check()

    def _ask(self, act: Callable[[], str | None]) -> tuple[bool, str]:
        """Let the driver act; returns success and its message, or the bench's state after it."""
        try:
            return True, act() or self._driver.state
        except (LinkError, InputError) as error:
            return False, str(error)
        finally:
            self._publish_state()

    def _enable(self) -> None:
        if not self._driver.enabled:
            self.claims.append(ros.claim_readings(self, self._channels[0]))
        self._driver.enable(time.monotonic())

    def _self_test(self) -> str:
        findings = self._driver.self_test()
        text = "; ".join(map(str, findings))
        if not all(finding.passed for finding in findings):
            raise LinkError(text)
        return text

    def _publish_state(self) -> None:
        while not self._driver.enabled and len(self.claims) > 1:  # keep that of the node's name
            self.claims.pop().close()
        if (state := self._driver.state) != self._last_state:
            self._last_state = state
            self._enter(state)
            self.get_logger().info(state)

    def health(self) -> list[DiagnosticStatus]:
        state = self._driver.state
        if self._driver.flowing:
            self.get_logger().fatal(state)
        values = {
            **self._driver.diagnostics(time.monotonic()), **self._link.status.diagnostics,
            "power_rate": f"{self._readings:.1f}", "oldest_reading_ms": f"{1e3 * self._oldest:.1f}",
            **{f"{c}_degC": f"{kelvin - CELSIUS_ZERO:.1f}" for c, kelvin in self._kelvin.items()},
            "commanders": str(self.count_publishers(ros.COMMAND)), "scheduling": self._scheduling}
        self._readings, self._oldest = 0, 0.0
        level = DiagnosticStatus.WARN if self._driver.gate.rejected else DiagnosticStatus.OK
        if state not in ("idle", "enabled"):
            level = DiagnosticStatus.ERROR
        device = values.get("firmware", "no device")
        return [self.status("bench", level, state, values, device),
                *self.warnings(clocks=self._guard.doubt())]
