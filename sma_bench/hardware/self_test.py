"""What can be said about a bench without driving it: each check with its finding."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from sma_bench.hardware.bench_sensors import BenchReading, BenchSensors
from sma_bench.hardware.conversation import LinkError
from sma_bench.hardware.serial_link import SerialLink

_MOST_CURRENT_AT_REST = 0.15
_MOST_CLOCK_UNCERTAINTY = 2e-3
_STOP_WITHIN = 0.3
# s; the relay closes within 30 ms, the mean of the current needs as long.
_CLOSED_FOR = 0.12
NEEDED = frozenset(("connection", "supply", "currents", "relay", "stop"))
"""checks without which nobody enables"""


@dataclass(frozen=True)
class CheckResult:
    """One check: what, how it ended, and the number behind it."""

    check: str
    passed: bool
    text: str

    def __str__(self) -> str:
        return f"{self.check}: {'ok' if self.passed else 'FAILED'}, {self.text}"


def self_test(
    link: SerialLink,
    newest: BenchReading | None,
    supply: float,
    sensors: BenchSensors,
    pause: Callable[[float], None] = time.sleep,
) -> list[CheckResult]:
    """Every check, in under a second; ends with the device stopped and reset, outputs at 0 V.

    Args:
        newest: last reading, None before the first.
        supply: supply in V, calibrated.
    """
    status = link.status
    if not status.connected or newest is None:
        text = status.problem or "no reading yet"
        return [CheckResult("connection", False, text)]
    device, found = status.device, []
    if device is not None:
        text = f"{device.name} {device.build}, reset: {device.reset}"
        found.append(CheckResult("connection", True, text))
    bad = status.lost + status.damaged + status.not_understood
    text = f"{status.telemetry} frames, {status.lost} lost, {status.damaged} damaged"
    found.append(CheckResult("link", bad == 0, text))
    uncertainty = status.clock_uncertainty
    text = f"known to {1e3 * uncertainty:.2f} ms, drift {1e6 * status.drift:.0f} ppm"
    found.append(CheckResult("clock", uncertainty < _MOST_CLOCK_UNCERTAINTY, text))
    if device is not None:
        low, high = device.supply_range
        text = f"{supply:.2f} V, expected {low:g} to {high:g} V"
        found.append(CheckResult("supply", low <= supply <= high, text))
    most = max(abs(current) for current in newest.board_currents)
    text = f"at most {most:.2f} A at rest, expected under {_MOST_CURRENT_AT_REST:g} A"
    found.append(CheckResult("currents", most < _MOST_CURRENT_AT_REST, text))
    for side, distance in zip(("front", "back"), newest.distances, strict=True):
        if side in sensors.range_sensors:
            text = f"{1e3 * distance:.1f} mm"
            found.append(CheckResult(f"{side} range", math.isfinite(distance), text))
    return [*found, _relay_finding(link, sensors, pause), _stop_finding(link, pause)]


def _relay_finding(
    link: SerialLink, sensors: BenchSensors, pause: Callable[[float], None]
) -> CheckResult:
    """With the relay closed and nothing driven, a switch that is stuck or inverted conducts."""
    try:
        link.arm()
    except LinkError as error:
        return CheckResult("relay", False, str(error))
    pause(_CLOSED_FOR)
    status = link.status
    if status.stopped:
        return CheckResult("relay", False, f"closed, nothing driven: {status.cause_text}")
    currents = sensors.board_currents(status.newest) if status.newest else (0.0,)
    most = max(abs(current) for current in currents)
    text = f"closed, nothing driven: at most {most:.2f} A"
    return CheckResult("relay", most < _MOST_CURRENT_AT_REST, text)


def _stop_finding(link: SerialLink, pause: Callable[[float], None]) -> CheckResult:
    """The emergency stop must be heard, and be forgotten on request only."""
    link.stop()
    waited = 0.0
    while not link.status.stopped and waited < _STOP_WITHIN:
        pause(0.005)
        waited += 0.005
    if not link.status.stopped:
        return CheckResult("stop", False, f"the device does not stop within {_STOP_WITHIN:g} s")
    try:
        link.reset()
    except LinkError as error:
        return CheckResult("stop", False, f"no reset after the stop: {error}")
    return CheckResult("stop", True, f"stopped within {waited:.3f} s")
