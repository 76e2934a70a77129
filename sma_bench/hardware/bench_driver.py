"""Enabling, driving and stopping the device. No ROS, no thread of its own.

The state is `idle` until someone enables it, `enabled` until someone stops it or a rule of
safety.py is broken, then `stopped`, with the first reason, until a reset. The outputs are at 0 V
unless it is enabled and a command arrived within the command timeout."""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

from sma_bench.hardware import serial_messages as messages
from sma_bench.hardware.bench_sensors import SIDES, BenchReading, BenchSensors, SharedWatch
from sma_bench.hardware.safety import MOST_CURRENT_AT_REST, CommandGate, Guard, Limits
from sma_bench.hardware.serial_link import LateAnswer, LinkError, LinkStatus, SerialLink

REFRESH = 0.02  # s between commands to the device, whose own timeout is ten times that
_LEAST_TIMEOUT = 3.0 * REFRESH
# Limits for the device (command C), from those of the rig.
_WIRES_PER_BOARD = 2
_MARGIN = 1.2  # factor on voltages and currents
_HOT_MARGIN = 1.1  # factor on the voltage that holds a wire at its highest temperature
_LEAST_HOT_TIME, _LEAST_STEP = 0.05, 0.1  # s; A, from the mean to the peak current

T = TypeVar("T")

NEEDED = ("connection", "supply", "currents", "relay", "stop")  # checks that must pass to enable
_TRIES, _MOST_CLOCK_UNCERTAINTY = 3, 2e-3  # when an answer is late; s
_CLOSED_FOR = 0.12  # s; the relay closes within 30 ms, the mean of the current needs as long
_STOP_WITHIN = 0.6  # s of the device's clock, from the last frame before the stop
_FRAME_TIMEOUT, _POLL_PERIOD = 2.0, 0.005  # s of the host's clock


class CheckResult(NamedTuple):
    """One check of the self-test: its name, its result, and the number behind it."""

    check: str
    passed: bool
    text: str

    @property
    def forbids(self) -> bool:
        return self.check in NEEDED and not self.passed

    def __str__(self) -> str:
        return f"{self.check}: {'ok' if self.passed else 'FAILED'}, {self.text}"


class BenchDriver:
    """See the module. Times (`now`) are s of one monotonic clock; `newest` is the last reading."""

    def __init__(self, link: SerialLink, sensors: BenchSensors, guard: Guard,
                 channels: Sequence[str], limits: Limits, waiver: str = "",
                 pause: Callable[[float], None] = time.sleep) -> None:
        """`waiver`: why no self-test is needed before enabling; "" to demand one."""
        self._link, self._sensors, self._guard, self._pause = link, sensors, guard, pause
        self._channels, self._limits, self._waiver = channels, limits, waiver
        self._tested = -1  # number of the connection whose self-test passed
        self._stopped, self._supply_reading, self._driven = "", 0.0, -math.inf
        self._watch_shared_sensors()
        self.enabled, self.gate = False, CommandGate(len(channels), limits)
        self.newest: BenchReading | None = None

    @property
    def state(self) -> str:
        """`idle`, `enabled`, `stopped: why`, `not connected: why` or `still flowing: ...`."""
        if flowing := self.flowing:
            return f"still flowing: pull the plug ({flowing})"
        if self._stopped:
            return f"stopped: {self._stopped}"
        if self.enabled:
            return "enabled"
        status, fault = self._link.status, self._link.status.fault
        # The device remembers why it stopped, also under an earlier host.
        return f"stopped: {fault}" if fault and status.connected else fault or "idle"

    @property
    def flowing(self) -> str:
        """Report of a current that flows with all outputs off, or ""."""
        status = self._link.status
        by_device = status.cause_text if status.state == messages.DeviceState.STILL_FLOWING else ""
        return (self._guard.flowing or by_device) if status.connected else ""

    @property
    def tested(self) -> str:
        """State of the self-test: `passed`, `due`, or `waived: why`."""
        if self._waiver:
            return f"waived: {self._waiver}"
        return "passed" if self._tested == self._link.status.connections else "due"

    @property
    def supply(self) -> float:
        return self._sensors.supply.apply(self._supply_reading)

    def diagnostics(self, now: float) -> dict[str, Any]:
        """`applied`: V at the wires by the last reading; empty before the first."""
        applied = self.newest.powers if self.newest else ()
        return {"state": self.state, "self_test": self.tested, "supply_volts": f"{self.supply:.2f}",
                "applied": " ".join(f"{power.voltage:.2f}" for power in applied),
                **self.gate.diagnostics(now)}

    # Requests. LinkError: not allowed in this state, or refused by the device.

    def command(self, voltage: Sequence[float], now: float, sender: str = "") -> str:
        """Take a sender's command (V, one per channel); returns why it is rejected, or ""."""
        if not self.enabled and any(voltage):
            return self.gate.refuse(f"not enabled ({self.state})")
        if not (reason := self.gate.command(voltage, now, sender)):
            self._driven = -math.inf  # the next tick sends it
        return reason

    def enable(self, now: float) -> None:
        """Arm the device; the outputs stay at 0 V until the next command."""
        status = self._link.status
        if self.enabled:
            raise LinkError("enabled already")
        if self.flowing:
            raise LinkError(self.state)
        if self._stopped:
            raise LinkError(f"{self.state}; reset first")
        if status.fault:
            raise LinkError(status.fault + ("; reset first" if status.connected else ""))
        if device := status.device:
            limit = self._limits.maximum_voltage
            highest = self._limits.reading(limit)
            if highest > device.maximum_voltage:
                direct = f" (direct: {highest:.4g} V)" if highest != limit else ""
                raise LinkError(f"bench.maximum_voltage is {limit:g} V{direct}, the device allows "
                                f"{device.maximum_voltage:g} V")
            if device.command_timeout < _LEAST_TIMEOUT:
                raise LinkError(f"the device's timeout is {device.command_timeout:g} s: too short")
        if fault := self._guard.fault(now):
            raise LinkError(fault)
        if self.tested == "due" and (failed := [str(r) for r in self.self_test() if r.forbids]):
            raise LinkError(f"self-test: {'; '.join(failed)}")
        self.gate.clear()
        if device:
            numbers = device_limits(self._limits, device, self.supply)
            self._with_retries(lambda: self._link.limit(numbers))
        self._with_retries(self._link.arm)
        self.enabled = True

    def stop(self, reason: str) -> None:
        """Switch the outputs off at once, until a reset."""
        self.enabled, self._tested = False, -1
        self._link.stop()
        self.gate.clear()
        self._stopped = self._stopped or reason

    def reset(self) -> None:
        """Clear the reason of the stop; does not enable."""
        self._require_stopped()
        if self.flowing:
            raise LinkError(self.state)
        self._with_retries(self._link.reset)
        self._stopped = ""
        self._guard.reset()
        self._watch_shared_sensors()

    def _require_stopped(self) -> None:
        if self.enabled:
            raise LinkError("enabled: stop first")

    def _watch_shared_sensors(self) -> None:
        self._shared = [(wires, SharedWatch([self._channels[k] for k in wires]))
                        for wires in self._sensors.shared]

    def self_test(self) -> list[CheckResult]:
        """Checks that need no driven output, with retries; ends disabled, at 0 V."""
        self._require_stopped()
        self._tested = -1
        status, newest = self._link.status, self.newest
        device = status.device
        if status.left:  # the test's own reset would acknowledge it
            raise LinkError(f"{self.state}; reset first")
        if not status.connected or newest is None or device is None:
            return [CheckResult("connection", False, status.problem or "no reading yet")]
        uncertainty, (low, high) = status.clock_uncertainty, device.supply_range
        most = max(map(abs, newest.board_currents))
        rows = [("connection", True, f"{device.name} {device.build}, reset: {device.reset}"),
                ("link", status.lost + status.damaged + status.not_understood == 0,
                 f"{status.telemetry} frames, {status.lost} lost, {status.damaged} damaged"),
                ("clock", uncertainty < _MOST_CLOCK_UNCERTAINTY,
                 f"known to {1e3 * uncertainty:.2f} ms, drift {1e6 * status.drift:.0f} ppm"),
                ("supply", low <= self.supply <= high,
                 f"{self.supply:.2f} V, expected {low:g} to {high:g} V"),
                ("currents", most < MOST_CURRENT_AT_REST,
                 f"at most {most:.2f} A at rest, expected under {MOST_CURRENT_AT_REST:g} A")]
        rows += [(f"{side} range", math.isfinite(distance), f"{1e3 * distance:.1f} mm")
                 for side, distance in zip(SIDES, newest.distances, strict=True)
                 if side in self._sensors.range_sensors]
        for name, test in (("relay", self._test_relay), ("stop", self._test_stop)):
            try:
                rows.append((name, *self._with_retries(test)))
            except LinkError as error:
                rows.append((name, False, str(error)))
        found = [CheckResult(*row) for row in rows]
        if not any(result.forbids for result in found):
            self._tested = self._link.status.connections
        return found

    def _with_retries(self, ask: Callable[[], T], tries: int = _TRIES) -> T:
        """The device's answer; when it is late, the device is stopped, reset and asked again."""
        try:
            return ask()
        except LateAnswer:
            self._link.stop()
            self._pause(_CLOSED_FOR)
            with contextlib.suppress(LinkError):
                self._link.reset()
            if tries == 1:
                raise
        return self._with_retries(ask, tries - 1)

    def _test_relay(self) -> tuple[bool, str]:
        """Close the relay with all outputs off: a stuck or inverted switch would conduct."""
        self._link.arm()
        status = self._after(_CLOSED_FOR)
        if status.stopped:
            return False, f"closed, nothing driven: {status.cause_text}"
        currents = self._sensors.board_currents(status.newest) if status.newest else (math.inf,)
        most = max(map(abs, currents))
        return most < MOST_CURRENT_AT_REST, f"closed, nothing driven: at most {most:.2f} A"

    def _test_stop(self) -> tuple[bool, str]:
        """Send an emergency stop: the device must stop, and name it as the cause."""
        self._link.stop()
        status = self._after(_STOP_WITHIN)
        if not status.stopped:
            return False, f"the device does not stop within {_STOP_WITHIN:g} s"
        self._link.reset()
        return status.cause == messages.STOP_CAUSE, f"stopped by its {status.cause_text}"

    def _after(self, seconds: float) -> LinkStatus:
        """The device's state `seconds` later by its own clock, or as soon as it has stopped.
        LateAnswer: no frames, or the device timed out without a command: nothing was tested."""
        before = self._link.status.newest
        for _ in range(round(_FRAME_TIMEOUT / _POLL_PERIOD)):
            status, passed = self._link.status, 0.0
            if status.stopped and status.cause == messages.TIMEOUT_CAUSE:
                raise LateAnswer(f"stopped by its {status.cause_text}")
            if before and status.newest:
                passed = 1e-6 * ((status.newest.time_us - before.time_us) % messages.TURN)
            if status.stopped or passed > seconds:
                return status
            self._pause(_POLL_PERIOD)
        raise LateAnswer("the device's readings are late")

    def take(self, telemetry: messages.Telemetry, now: float) -> BenchReading:
        """Note telemetry for the safety rules; returns it as a reading of the bench."""
        self._supply_reading = telemetry.supply
        if not self.enabled and not any(telemetry.duty):
            self._sensors.rest(telemetry)
        taken = self.newest = self._sensors.reading(telemetry)
        for channel, power in zip(self._channels, taken.powers, strict=True):
            self._guard.power(channel, *power, taken.time, now, self._limits)
        for wires, watch in self._shared:
            volts, amperes = zip(*(taken.powers[k] for k in wires), strict=True)
            reason = watch.power(volts, amperes, taken.time, self._limits.circuit)
            self._guard.found(f"wires {wires}", reason)
        self._guard.boards(taken.board_currents, taken.board_volts, now, self._limits)
        return taken

    def tick(self, now: float) -> str:
        """Check the safety rules, then send the outputs; returns why it stopped here, or ""."""
        if not self.enabled:
            self._guard.commanded((0.0,) * len(self._channels))
            reason = "" if self._stopped else self._guard.flowing
        elif not (reason := self._fault(now)) and now - self._driven >= REFRESH:
            outputs = self.gate.outputs(now)
            self._guard.commanded(outputs)
            self._driven = now
            try:
                # A commanded duty is a mean voltage; the device expects the direct voltage.
                volts = [self._limits.reading(volt) for volt in outputs]
                self._link.drive(self._sensors.millivolts(volts, self._supply_reading))
            except LinkError as error:
                reason = self._fault(now) or str(error)
        if reason:
            self.stop(reason)
        return reason

    def _fault(self, now: float) -> str:
        status = self._link.status
        another = ("another host speaks to the device: it answered "
                   f"{status.unasked!r} to a question of that host") if status.unasked else ""
        return status.fault or another or self._guard.fault(now)


def device_limits(limits: Limits, device: messages.DeviceIdentity, supply: float) -> list[int]:
    """Numbers of the device's command C: the rig's limits with a margin, at most the device's own.
    Heat: 1.1 times the voltage that holds the highest temperature, over a wire's time constant."""
    least = max(device.least_resistance, limits.least_resistance)
    rise = max(limits.maximum_temperature - limits.ambient, 1.0)
    hot = _HOT_MARGIN * math.sqrt(rise * limits.heat_loss * limits.heated)
    mean = min(device.maximum_mean_current, _WIRES_PER_BOARD * _MARGIN * limits.maximum_current)
    peak = min(device.maximum_peak_current, _WIRES_PER_BOARD * _MARGIN * supply / least)
    values = (min(device.maximum_voltage, _MARGIN * limits.reading(limits.maximum_voltage)), mean,
              max(peak, mean + _LEAST_STEP), least, min(device.hot_voltage, hot),
              min(device.hot_time, max(limits.heat_capacity / limits.heat_loss, _LEAST_HOT_TIME)))
    return [round(1e3 * value) for value in values]
