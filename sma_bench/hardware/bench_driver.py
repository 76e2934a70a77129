"""Whether, and with what, the device may drive the bench. No ROS, no thread of its own.

`idle` until someone enables it, `enabled` until someone stops it or a rule of safety.py breaks,
`stopped`, with the first reason kept, until someone resets it. Outputs other than 0 V exist only
while it is enabled and fresh commands come.
"""

import math
from collections.abc import Sequence

from sma_bench.hardware.bench_sensors import BenchReading, BenchSensors
from sma_bench.hardware.conversation import LinkError
from sma_bench.hardware.expectation import SharedWatch
from sma_bench.hardware.link_status import LinkStatus, Reading
from sma_bench.hardware.safety import CommandGate, Guard, Interlock, Limits
from sma_bench.hardware.self_test import Finding, Link, self_test
from sma_bench.hardware.serial_messages import TIMEOUT_CAUSE, State

REFRESH = 0.02
"""s between commands to the device, whose own timeout is ten times that"""

_LEAST_TIMEOUTS = 3.0


class BenchDriver:
    """See the module. All times (`now`) are s of one monotonic clock."""

    def __init__(
        self,
        link: Link,
        sensors: BenchSensors,
        guard: Guard,
        channels: Sequence[str],
        limits: Limits,
    ) -> None:
        self._link = link
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
        """`idle`, `enabled`, `stopped: why` or `not connected: why`."""
        if self._interlock.tripped:
            return f"stopped: {self._interlock.reason}"
        if self.enabled:
            return "enabled"
        status = self._link.status
        fault = _device_fault(status)
        # What a former host left: the device remembers why it stopped.
        return f"stopped: {fault}" if fault and status.connected else fault or "idle"

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
        if self.enabled:
            raise LinkError("enabled already")
        obstacle = self._obstacle(now)
        if obstacle:
            raise LinkError(obstacle)
        self.gate.clear()
        self._link.arm()
        self.enabled = True

    def stop(self, reason: str) -> None:
        """Outputs off, at once and until a reset."""
        self.enabled = False
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
        self._link.reset()
        self._interlock.reset()
        self._guard.recorder("")
        self._watch_shared_sensors()

    def self_test(self) -> list[Finding]:
        """Check what can be checked without driving; ends disabled, at 0 V.

        Raises:
            LinkError: enabled.
        """
        if self.enabled:
            raise LinkError("enabled: stop first")
        return self_test(self._link, self.newest, self.supply, self._sensors.range_sensors)

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
            self._link.drive(self._sensors.millivolts(outputs, self._supply_reading))
        except LinkError as error:
            reason = self._fault(now) or str(error)
            self.stop(reason)
            return reason
        return ""

    def _fault(self, now: float) -> str:
        status = self._link.status
        return _device_fault(status) or _another_host(status) or self._guard.fault(now)

    def _obstacle(self, now: float) -> str:
        if self._interlock.tripped:
            return f"{self.state}; reset first"
        status = self._link.status
        fault = _device_fault(status)
        if fault:
            return fault + ("; reset first" if status.connected else "")
        highest = self._limits.maximum_voltage
        if status.device and highest > status.device.maximum_voltage:
            return (
                f"bench.maximum_voltage is {highest:g} V, the device allows "
                f"{status.device.maximum_voltage:g} V"
            )
        if status.device and status.device.command_timeout < _LEAST_TIMEOUTS * REFRESH:
            return f"the device's timeout is {status.device.command_timeout:g} s: too short"
        return self._guard.fault(now)


def _device_fault(status: LinkStatus) -> str:
    if not status.connected:
        return _not_connected(status)
    if status.state == State.STOPPED:
        why = f" ({status.silence})" if status.cause == TIMEOUT_CAUSE and status.silence else ""
        return f"{status.cause_text}, found by the device{why}"
    return ""


def _another_host(status: LinkStatus) -> str:
    if not status.unasked:
        return ""
    return f"another host speaks to the device: it answered {status.unasked!r}, not asked from here"


def _not_connected(status: LinkStatus) -> str:
    return f"not connected: {status.problem or 'no handshake yet'}"
