"""Whether, and with what, the device may drive the bench. No ROS, no thread of its own.

`idle` until someone enables it, `enabled` until someone stops it or a rule of safety.py breaks,
`stopped`, with the first reason kept, until someone resets it. Outputs other than 0 V exist only
while it is enabled and fresh commands come.
"""

import math
import time
from collections.abc import Callable, Sequence

from sma_bench.hardware.bench_sensors import BenchReading, BenchSensors
from sma_bench.hardware.conversation import LinkError
from sma_bench.hardware.device import DeviceIdentity, LinkStatus, Reading
from sma_bench.hardware.expectation import SharedWatch
from sma_bench.hardware.safety import CommandGate, Guard, Interlock, Limits
from sma_bench.hardware.self_test import NEEDED, CheckResult, self_test
from sma_bench.hardware.serial_link import SerialLink
from sma_bench.hardware.serial_messages import TIMEOUT_CAUSE, DeviceState

REFRESH = 0.02
"""s between commands to the device, whose own timeout is ten times that"""

_LEAST_TIMEOUTS = 3.0
_PER_BOARD = 2
_MARGIN = 1.2
_HOTTER = 1.1
_LEAST_HOT_TIME = 0.05
# A, of the peak above the mean.
_LEAST_STEP = 0.1


class BenchDriver:
    """See the module. All times (`now`) are s of one monotonic clock."""

    def __init__(
        self,
        link: SerialLink,
        sensors: BenchSensors,
        guard: Guard,
        channels: Sequence[str],
        limits: Limits,
        waiver: str = "",
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """`waiver`: why nobody needs a self-test before enabling; "" to demand one."""
        self._link = link
        self._waiver = waiver
        self._pause = pause
        self._tested = -1
        self._sensors = sensors
        self._guard = guard
        self._channels = channels
        self._zero = (0.0,) * len(channels)
        self._limits = limits
        self._interlock = Interlock()
        self._supply_reading = 0.0
        self._driven = -math.inf
        self._watch_shared_sensors()
        self.enabled = False
        self.newest: BenchReading | None = None
        """last reading, None before the first"""
        self.gate = CommandGate(len(channels), limits)

    @property
    def state(self) -> str:
        """`idle`, `enabled`, `stopped: why`, `not connected: why` or `still flowing: ...`."""
        if flowing := self.flowing:
            return f"still flowing: pull the plug ({flowing})"
        if self._interlock.tripped:
            return f"stopped: {self._interlock.reason}"
        if self.enabled:
            return "enabled"
        status = self._link.status
        fault = _device_fault(status)
        # What a former host left: the device remembers why it stopped.
        return f"stopped: {fault}" if fault and status.connected else fault or "idle"

    @property
    def flowing(self) -> str:
        """The current that nothing here can switch off, "" for none."""
        status = self._link.status
        if not status.connected:
            return ""
        by_device = status.cause_text if status.state == DeviceState.STILL_FLOWING else ""
        return self._guard.flowing or by_device

    @property
    def tested(self) -> str:
        """Whether a self-test allows to enable."""
        if self._waiver:
            return f"waived: {self._waiver}"
        return "passed" if self._tested == self._link.status.connections else "due"

    @property
    def supply(self) -> float:
        """V, calibrated."""
        return self._sensors.supply(self._supply_reading)

    @property
    def applied(self) -> tuple[float, ...]:
        """V at the wires as the device says, one a channel; none before the first reading."""
        return tuple(power.voltage for power in self.newest.powers) if self.newest else ()

    # --- requests -----------------------------------------------------------------------------

    def command(self, voltage: Sequence[float], now: float, sender: str = "") -> str:
        """Take a sender's command (V, one a channel); the reason when it is rejected."""
        if not self.enabled and any(voltage):
            return self.gate.refuse(f"not enabled ({self.state})")
        reason = self.gate.command(voltage, now, sender)
        if not reason:
            self._driven = -math.inf  # the next tick sends it
        return reason

    def enable(self, now: float) -> None:
        """Arm the device; the outputs stay at 0 V until the next command.

        Raises:
            LinkError: why that must not be, or the device's refusal.
        """
        if obstacle := "enabled already" if self.enabled else self._obstacle(now):
            raise LinkError(obstacle)
        if self.tested == "due" and (failed := _failed(self.self_test())):
            raise LinkError(f"self-test: {'; '.join(map(str, failed))}")
        self.gate.clear()
        status = self._link.status
        if status.device:
            self._link.limit(device_limits(self._limits, status.device, self.supply))
        self._link.arm()
        self.enabled = True

    def stop(self, reason: str) -> None:
        """Outputs off, at once and until a reset."""
        self.enabled = False
        self._tested = -1
        self._link.stop()
        self.gate.clear()
        self._interlock.trip(reason)

    def reset(self) -> None:
        """Forget why it stopped; enabling is another request.

        Raises:
            LinkError: enabled, or the device does not answer.
        """
        if self.enabled:
            raise LinkError("enabled: stop first")
        if self.flowing:
            raise LinkError(self.state)
        self._link.reset()
        self._interlock.reset()
        self._guard.recorder("")
        self._watch_shared_sensors()

    def self_test(self) -> list[CheckResult]:
        """Check what can be checked without driving; ends disabled, at 0 V.

        Raises:
            LinkError: enabled.
        """
        if self.enabled:
            raise LinkError("enabled: stop first")
        self._tested = -1
        findings = self_test(self._link, self.newest, self.supply, self._sensors, self._pause)
        if not _failed(findings):
            self._tested = self._link.status.connections
        return findings

    # --- what happens -------------------------------------------------------------------------

    def take(self, reading: Reading, now: float) -> BenchReading:
        """Note telemetry; what it says about the bench."""
        self._supply_reading = reading.telemetry.supply
        taken = self.newest = self._sensors.reading(reading)
        for channel, power in zip(self._channels, taken.powers, strict=True):
            self._guard.power(
                channel, power.voltage, power.current, taken.time, now, self._limits
            )
        for wires, watch in self._shared:
            volts = [taken.powers[k].voltage for k in wires]
            amperes = [taken.powers[k].current for k in wires]
            reason = watch.power(volts, amperes, taken.time, self._limits.model)
            self._guard.found(f"wires {wires}", reason)
        self._guard.boards(taken.board_currents, taken.board_volts, now, self._limits)
        return taken

    def temperature(self, channel: str, kelvin: float, stamp: float, now: float) -> None:
        """Note a wire's temperature (K), acquired at `stamp` s of the readings' clock."""
        self._guard.temperature(channel, kelvin, stamp, now, self._limits)

    def recorder(self, failure: str) -> None:
        """Note why the recorder failed, "" when it records."""
        self._guard.recorder(failure)

    def tick(self, now: float) -> str:
        """Check everything, then keep the device supplied; the reason when it stops here."""
        if not self.enabled:
            self._guard.commanded(self._zero)
            if self._guard.flowing and not self._interlock.tripped:
                self.stop(self._guard.flowing)
                return self._guard.flowing
            return ""
        reason = self._fault(now)
        if reason:
            self.stop(reason)
        elif now - self._driven >= REFRESH:
            reason = self._drive(now)
        return reason

    def _watch_shared_sensors(self) -> None:
        self._shared = [
            (wires, SharedWatch([self._channels[k] for k in wires]))
            for wires in self._sensors.shared
        ]

    def _drive(self, now: float) -> str:
        outputs = self.gate.outputs(now)
        self._guard.commanded(outputs)
        self._driven = now
        try:
            # Of a duty the commanded mean; the device is told the direct volts of the same heat.
            volts = [self._limits.model.reading(volt) for volt in outputs]
            self._link.drive(self._sensors.millivolts(volts, self._supply_reading))
        except LinkError as error:
            reason = self._fault(now) or str(error)
            self.stop(reason)
            return reason
        return ""

    def _fault(self, now: float) -> str:
        status = self._link.status
        another = f"another host speaks to the device: it answered {status.unasked!r}"
        another = f"{another}, not asked from here" if status.unasked else ""
        return _device_fault(status) or another or self._guard.fault(now)

    def _obstacle(self, now: float) -> str:
        if self.flowing:
            return self.state
        if self._interlock.tripped:
            return f"{self.state}; reset first"
        status = self._link.status
        fault = _device_fault(status)
        if fault:
            return fault + ("; reset first" if status.connected else "")
        limit = self._limits.maximum_voltage
        highest = self._limits.model.reading(limit)
        if status.device and highest > status.device.maximum_voltage:
            heats = f" and heats as {highest:.4g} V do" if highest != limit else ""
            return (
                f"bench.maximum_voltage is {limit:g} V{heats}, the device allows "
                f"{status.device.maximum_voltage:g} V"
            )
        if status.device and status.device.command_timeout < _LEAST_TIMEOUTS * REFRESH:
            return f"the device's timeout is {status.device.command_timeout:g} s: too short"
        return self._guard.fault(now)


def device_limits(limits: Limits, device: DeviceIdentity, supply: float) -> list[int]:
    """What the device is to allow this rig: the numbers of its command C.

    Its own limits are ceilings. The heat that it allows is what holds a wire of the model a tenth
    in volts above its highest temperature, forgotten as fast as that wire cools.
    """
    model = limits.model
    least = max(device.least_resistance, model.least_resistance)
    rise = max(limits.maximum_temperature - model.ambient, 1.0)
    hot = _HOTTER * math.sqrt(rise * model.heat_loss * model.heated)
    mean = min(device.maximum_mean_current, _PER_BOARD * _MARGIN * limits.maximum_current)
    peak = min(device.maximum_peak_current, _PER_BOARD * _MARGIN * supply / least)
    peak = max(peak, mean + _LEAST_STEP)
    values = (
        min(device.maximum_voltage, _MARGIN * model.reading(limits.maximum_voltage)),
        mean,
        peak,
        least,
        min(device.hot_voltage, hot),
        min(device.hot_time, max(model.heat_capacity / model.heat_loss, _LEAST_HOT_TIME)),
    )
    return [round(1e3 * value) for value in values]


def _failed(findings: Sequence[CheckResult]) -> list[CheckResult]:
    return [finding for finding in findings if finding.check in NEEDED and not finding.passed]


def _device_fault(status: LinkStatus) -> str:
    if not status.connected:
        return f"not connected: {status.problem or 'no handshake yet'}"
    if status.stopped:
        why = f" ({status.silence})" if status.cause == TIMEOUT_CAUSE and status.silence else ""
        return f"{status.cause_text}, found by the device{why}"
    return ""
