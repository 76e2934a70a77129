"""Whether, and with what, the device may drive the bench. No ROS, no thread of its own.

`idle` until someone enables it, `enabled` until someone stops it or a rule of safety.py breaks,
`stopped`, for the first reason, until a reset. 0 V unless it is enabled and commanded afresh."""

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
# What the device is to allow beyond the rig's limits: times these, s, A of the peak over the mean.
_PER_BOARD, _MARGIN, _HOTTER = 2, 1.2, 1.1
_LEAST_HOT_TIME, _LEAST_STEP = 0.05, 0.1

T = TypeVar("T")

# Checks of the self-test without which it is not enabled; tries, and s of the clock's error.
NEEDED = ("connection", "supply", "currents", "relay", "stop")
_TRIES, _MOST_CLOCK_UNCERTAINTY = 3, 2e-3
_CLOSED_FOR = 0.12  # s; the relay closes within 30 ms, the mean of the current needs as long
# s of the device's clock from the last frame before the stop; of ours, in which such frames come.
_STOP_WITHIN, _PATIENCE, _LOOK_EVERY = 0.6, 2.0, 0.005


class CheckResult(NamedTuple):
    """One check of the self-test: what, how it ended, and the number behind it."""

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
        """`waiver`: why nobody needs a self-test before enabling; "" to demand one."""
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
        # What a former host left: the device remembers why it stopped.
        return f"stopped: {fault}" if fault and status.connected else fault or "idle"

    @property
    def flowing(self) -> str:
        """The current that nothing here can switch off, "" for none."""
        status = self._link.status
        by_device = status.cause_text if status.state == messages.DeviceState.STILL_FLOWING else ""
        return (self._guard.flowing or by_device) if status.connected else ""

    @property
    def tested(self) -> str:
        """Whether a self-test allows to enable."""
        if self._waiver:
            return f"waived: {self._waiver}"
        return "passed" if self._tested == self._link.status.connections else "due"

    @property
    def supply(self) -> float:
        return self._sensors.supply.apply(self._supply_reading)

    def diagnostics(self, now: float) -> dict[str, Any]:
        """`applied`: V at the wires as the device says; none before the first reading."""
        gate, applied = self.gate, self.newest.powers if self.newest else ()
        return {"state": self.state, "self_test": self.tested, "supply_volts": f"{self.supply:.2f}",
                "outputs": " ".join(f"{volt:g}" for volt in gate.outputs(now)),
                "applied": " ".join(f"{power.voltage:.2f}" for power in applied),
                "commander": gate.commander, "accepted_commands": gate.accepted,
                "rejected_commands": gate.rejected, "command_timeouts": gate.timeouts,
                "last_rejection": gate.last_rejection}

    # Requests; LinkError says why one must not be, or the device's refusal.

    def command(self, voltage: Sequence[float], now: float, sender: str = "") -> str:
        """Take a sender's command (V, one a channel); the reason when it is rejected."""
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
                heats = f" and heats as {highest:.4g} V do" if highest != limit else ""
                raise LinkError(f"bench.maximum_voltage is {limit:g} V{heats}, the device allows "
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
            self._patiently(lambda: self._link.limit(numbers))
        self._patiently(self._link.arm)
        self.enabled = True

    def stop(self, reason: str) -> None:
        """Outputs off, at once and until a reset."""
        self.enabled, self._tested = False, -1
        self._link.stop()
        self.gate.clear()
        self._stopped = self._stopped or reason

    def reset(self) -> None:
        """Forget why it stopped; enabling is another request."""
        self._require_stopped()
        if self.flowing:
            raise LinkError(self.state)
        self._patiently(self._link.reset)
        self._stopped = ""
        self._guard.recorder("")
        self._watch_shared_sensors()

    def _require_stopped(self) -> None:
        if self.enabled:
            raise LinkError("enabled: stop first")

    def _watch_shared_sensors(self) -> None:
        self._shared = [(wires, SharedWatch([self._channels[k] for k in wires]))
                        for wires in self._sensors.shared]

    def self_test(self) -> list[CheckResult]:
        """Check what can be without driving; ends disabled, at 0 V. What is late is asked again."""
        self._require_stopped()
        self._tested = -1
        status, newest = self._link.status, self.newest
        device = status.device
        if status.left:  # which the test's own reset would acknowledge
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
        for name, test in (("relay", self._relay), ("stop", self._heard_stop)):
            try:
                rows.append((name, *self._patiently(test)))
            except LinkError as error:
                rows.append((name, False, str(error)))
        found = [CheckResult(*row) for row in rows]
        if not any(result.forbids for result in found):
            self._tested = self._link.status.connections
        return found

    def _patiently(self, ask: Callable[[], T], tries: int = _TRIES) -> T:
        """What the device answers. Where that is late it is put to rest, and asked again."""
        try:
            return ask()
        except LateAnswer:
            self._link.stop()
            self._pause(_CLOSED_FOR)
            with contextlib.suppress(LinkError):
                self._link.reset()
            if tries == 1:
                raise
        return self._patiently(ask, tries - 1)

    def _relay(self) -> tuple[bool, str]:
        """With the relay closed and nothing driven, a switch that is stuck or inverted conducts."""
        self._link.arm()
        status = self._after(_CLOSED_FOR)
        if status.stopped:
            return False, f"closed, nothing driven: {status.cause_text}"
        currents = self._sensors.board_currents(status.newest) if status.newest else (math.inf,)
        most = max(map(abs, currents))
        return most < MOST_CURRENT_AT_REST, f"closed, nothing driven: at most {most:.2f} A"

    def _heard_stop(self) -> tuple[bool, str]:
        """The emergency stop must be heard, and be forgotten on request only."""
        self._link.stop()
        status = self._after(_STOP_WITHIN)
        if not status.stopped:
            return False, f"the device does not stop within {_STOP_WITHIN:g} s"
        self._link.reset()
        return status.cause == messages.STOP_CAUSE, f"stopped by its {status.cause_text}"

    def _after(self, seconds: float) -> LinkStatus:
        """The device's state so many s of its own clock from here, or once it has stopped. Raises
        LateAnswer: its frames do not come, or it heard no command in time: nothing was tested."""
        before = self._link.status.newest
        for _ in range(round(_PATIENCE / _LOOK_EVERY)):
            status, passed = self._link.status, 0.0
            if status.stopped and status.cause == messages.TIMEOUT_CAUSE:
                raise LateAnswer(f"stopped by its {status.cause_text}")
            if before and status.newest:
                passed = 1e-6 * ((status.newest.time_us - before.time_us) % messages.TURN)
            if status.stopped or passed > seconds:
                return status
            self._pause(_LOOK_EVERY)
        raise LateAnswer("the device's readings are late")

    def take(self, telemetry: messages.Telemetry, now: float) -> BenchReading:
        """Note telemetry; what it says about the bench."""
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
        """Check everything, then keep the device supplied; the reason when it stops here."""
        if not self.enabled:
            self._guard.commanded((0.0,) * len(self._channels))
            reason = "" if self._stopped else self._guard.flowing
        elif not (reason := self._fault(now)) and now - self._driven >= REFRESH:
            outputs = self.gate.outputs(now)
            self._guard.commanded(outputs)
            self._driven = now
            try:
                # Of a duty the commanded mean; the device gets the direct volts of the same heat.
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
                   f"{status.unasked!r}, not asked from here") if status.unasked else ""
        return status.fault or another or self._guard.fault(now)


def device_limits(limits: Limits, device: messages.DeviceIdentity, supply: float) -> list[int]:
    """Numbers of the device's command C, what it is to allow this rig, below its own limits: of
    heat what holds a wire a tenth in volts above its highest temperature, lost as it cools."""
    least = max(device.least_resistance, limits.least_resistance)
    rise = max(limits.maximum_temperature - limits.ambient, 1.0)
    hot = _HOTTER * math.sqrt(rise * limits.heat_loss * limits.heated)
    mean = min(device.maximum_mean_current, _PER_BOARD * _MARGIN * limits.maximum_current)
    peak = min(device.maximum_peak_current, _PER_BOARD * _MARGIN * supply / least)
    values = (min(device.maximum_voltage, _MARGIN * limits.reading(limits.maximum_voltage)), mean,
              max(peak, mean + _LEAST_STEP), least, min(device.hot_voltage, hot),
              min(device.hot_time, max(limits.heat_capacity / limits.heat_loss, _LEAST_HOT_TIME)))
    return [round(1e3 * value) for value in values]
