"""Through the bridge: a minute at 500 Hz for losses, checksums and CPU, then 100 Hz for stamps.

The real firmware on an emulated Uno in one process, the real serial_bridge in another, its topic
`wire/power` here. The Uno's clock runs with the wall's; what the computer delays is caught up and
printed as lag, which no bridge can see: on a busy computer the stamps follow it. Stamps are judged
at 100 Hz, where which window one means is clear to 5 ms; they should be right to 1 ms.

    ./bench check bridge [--seconds 60]
"""

import argparse
import contextlib
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import BatteryState

from sma_bench.emulation.build import missing_tools
from sma_bench.emulation.emulated_bench import emulated_bench
from sma_bench.nodes.base import MEASURED
from sma_bench.nodes.processes import NodeProcesses, private_ros_environment
from sma_bench.parameters import Parameters

NAMESPACE = "/check_bridge"
FAST, SLOW = 500, 100
LONGEST_FOR_STAMPS = 20.0
LOSSES = ("lost_frames", "crc_errors", "missing_readings")
SETTLED = 5.0
LARGEST_ERROR = 1e-3
PATIENCE = 30.0
# s from power-up until the Uno's clock runs.
START_UP = 0.5e-3
_STAMP = struct.Struct("<iI")
_CDR_HEADER = 4
_PRIORITY = -5
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Heard:
    """What came from the bridge: ROS stamps in ns, newest diagnostics."""

    stamps: list[int] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)

    def power(self, raw: bytes) -> None:
        """One reading, not decoded beyond its stamp."""
        seconds, nanoseconds = _STAMP.unpack_from(raw, _CDR_HEADER)
        self.stamps.append(seconds * 10**9 + nanoseconds)

    def diagnostics(self, message: DiagnosticArray) -> None:
        """The bridge's counts."""
        self.values = {item.key: item.value for item in message.status[0].values}


def main(argv: Sequence[str] | None = None) -> int:
    """0 when nothing was lost and the stamps are right."""
    options = _options(argv)
    if options.be_the_uno:
        return be_the_uno()
    if missing := missing_tools():
        print(missing, file=sys.stderr)
        return 2
    private_ros_environment()
    with contextlib.suppress(OSError):  # not everybody may ask for it
        os.nice(_PRIORITY)
    rclpy.init(args=[])
    try:
        with tempfile.TemporaryDirectory() as logs:
            fast = _measure(Path(logs), FAST, options.seconds)
            slow = _measure(Path(logs), SLOW, min(options.seconds, LONGEST_FOR_STAMPS))
    finally:
        rclpy.try_shutdown()
    whole = all(run[name] == 0 for run in (fast, slow) for name in LOSSES)
    passed = whole and slow["largest_stamp_error"] < LARGEST_ERROR
    _show(fast, slow)
    print("passed" if passed else "FAILED")
    if options.json:
        result = {"fast": fast, "slow": slow, "passed": passed}
        Path(options.json).write_text(json.dumps(result, indent=2) + "\n")
    return 0 if passed else 1


def be_the_uno() -> int:
    """The emulated bench: writes its port and when it began, then its lag for every line read."""
    sys.setswitchinterval(1e-4)
    with emulated_bench(Parameters.defaults()) as bench:
        print(bench.path, bench.port.began, flush=True)
        for _ in sys.stdin:
            print(bench.port.largest_lag, flush=True)
            bench.port.largest_lag = 0.0
    return 0


class Uno:
    """That process, as a context."""

    def __enter__(self) -> "Uno":
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--be-the-uno"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        self.path, began = self._line().split()
        self.began = float(began)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait()

    def largest_lag(self) -> float:
        """s, since the last time this was asked."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._line())

    def _line(self) -> str:
        return self._process.stdout.readline()


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="a minute at 500 Hz through the bridge")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--be-the-uno", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(argv)


def _measure(logs: Path, rate: int, seconds: float) -> dict[str, Any]:
    """A bridge at `rate` Hz on a fresh Uno, `seconds` long after it has settled."""
    heard = Heard()
    node = rclpy.create_node("check", namespace=NAMESPACE)
    node.create_subscription(BatteryState, "wire/power", heard.power, MEASURED, raw=True)
    node.create_subscription(DiagnosticArray, "/diagnostics", heard.diagnostics, 10)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)

    def listen(seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.01)

    with Uno() as uno, NodeProcesses(NAMESPACE, logs) as nodes:
        nodes.start("serial_bridge", {"port": uno.path, "telemetry_rate": rate})
        patience = time.monotonic() + PATIENCE
        while not heard.stamps and time.monotonic() < patience:
            nodes.check()
            listen(0.1)
        listen(SETTLED)
        heard.stamps.clear()
        uno.largest_lag()
        began = _cpu_seconds(nodes.pid("serial_bridge"))
        listen(seconds)
        cpu = _cpu_seconds(nodes.pid("serial_bridge")) - began
        result = {
            "rate": rate, "seconds": seconds, **_losses(heard, rate),
            **_stamps(heard, rate, uno.began), "largest_lag": uno.largest_lag(),
            "round_trip_ms": float(heard.values.get("round_trip_ms", "nan")),
            "cpu": cpu / seconds,
        }
    node.destroy_node()
    return result


def _losses(heard: Heard, rate: int) -> dict[str, int]:
    """Frames that the device or the cable lost, and readings that the topic did."""
    expected = round((heard.stamps[-1] - heard.stamps[0]) / 1e9 * rate) + 1
    return {
        "readings": len(heard.stamps),
        "lost_frames": int(heard.values.get("lost_frames", -1)),
        "crc_errors": int(heard.values.get("crc_errors", -1)),
        "missing_readings": expected - len(heard.stamps),
    }


def _stamps(heard: Heard, rate: int, began: float) -> dict[str, float]:
    """Stamps less the middles of the nearest windows on the Uno's clock, in s."""
    device = (np.array(heard.stamps) - _to_ros()) / 1e9 - began - START_UP
    windows = device * rate - 0.5
    error = (windows - np.round(windows)) / rate
    return {
        "largest_stamp_error": float(np.abs(error).max()),
        "rms_stamp_error": float(np.sqrt(np.mean(error**2))),
    }


def _to_ros() -> int:
    """ns from the monotonic clock to ROS time: the quickest of a hundred looks at both."""
    looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(100)]
    before, ros, after = min(looks, key=lambda look: look[2] - look[0])
    return ros - (before + after) // 2


def _cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _show(fast: dict[str, Any], slow: dict[str, Any]) -> None:
    for run in (fast, slow):
        print(
            f"{run['rate']} Hz, {run['seconds']:g} s: {run['readings']} readings, lost frames "
            f"{run['lost_frames']}, bad checksums {run['crc_errors']}, missing on the topic "
            f"{run['missing_readings']}; CPU of the bridge {run['cpu']:.0%} of a core, round trip "
            f"{run['round_trip_ms']:.1f} ms, emulator late by up to "
            f"{1e3 * run['largest_lag']:.1f} ms"
        )
    print(
        f"stamps against the Uno's clock: rms {1e3 * slow['rms_stamp_error']:.2f} ms, largest "
        f"{1e3 * slow['largest_stamp_error']:.2f} ms, limit {1e3 * LARGEST_ERROR:g} ms"
    )


if __name__ == "__main__":
    sys.exit(main())
