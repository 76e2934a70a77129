"""What a bridge tells of itself once a second: rates, losses, temperatures, latency. No ROS."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.link_status import LinkStatus
from sma_bench.hardware.safety import CELSIUS_ZERO


@dataclass
class Tally:
    """Counts of one report's period."""

    readings: int = 0
    oldest: float = 0.0
    """s, greatest age of a reading when it was published"""
    temperatures: dict[str, float] = field(default_factory=dict)
    """K, newest of each channel"""

    def note(self, age: float) -> None:
        """A reading was published, `age` s after its acquisition."""
        self.readings += 1
        self.oldest = max(self.oldest, age)


def link_values(status: LinkStatus) -> dict[str, str]:
    """What the link counts, in units that its names tell."""
    values = {
        "connections": str(status.connections),
        "frames": str(status.telemetry),
        "lost_frames": str(status.lost),
        "crc_errors": str(status.damaged),
        "not_understood": str(status.not_understood),
        "refused_by_device": str(status.refused),
        "last_refusal": status.last_refusal,
        "round_trip_ms": f"{1e3 * status.round_trip:.2f}",
        "command_latency_ms": f"{1e3 * status.command_latency:.1f}",
        "clock_drift_ppm": f"{1e6 * status.drift:.0f}",
        "clock_uncertainty_ms": f"{1e3 * status.clock_uncertainty:.3f}",
    }
    if status.device is not None:
        values["firmware"] = f"{status.device.name} {status.device.build}"
        values["last_reset"] = status.device.reset
    return values | {f"device_{name}": str(n) for name, n in status.counters.items()}


def driver_values(driver: BenchDriver, now: float) -> dict[str, str]:
    """What became of the commands."""
    gate = driver.gate
    return {
        "state": driver.state,
        "self_test": driver.tested,
        "supply_volts": f"{driver.supply:.2f}",
        "outputs": " ".join(f"{volt:g}" for volt in gate.outputs(now)),
        "applied": " ".join(f"{volt:.2f}" for volt in driver.applied),
        "commander": gate.commander,
        "accepted_commands": str(gate.accepted),
        "rejected_commands": str(gate.rejected),
        "command_timeouts": str(gate.timeouts),
        "last_rejection": gate.last_rejection,
    }


def tally_values(tally: Tally, elapsed: float) -> dict[str, str]:
    """Rates over the last `elapsed` s, and temperatures."""
    values = {
        "power_rate": f"{tally.readings / elapsed:.1f}",
        "oldest_reading_ms": f"{1e3 * tally.oldest:.1f}",
    }
    return values | _celsius(tally.temperatures)


def _celsius(temperatures: Mapping[str, float]) -> dict[str, str]:
    return {
        f"{channel}_degC": f"{kelvin - CELSIUS_ZERO:.1f}"
        for channel, kelvin in temperatures.items()
    }
