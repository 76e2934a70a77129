"""Through the bridge, a minute at 500 Hz, then 100 Hz: losses, checksums, CPU, stamps.

The real firmware on an emulated Uno in one process, the real serial_bridge in another, its topic
`wire/power` here. The Uno's clock, which is the plant's, runs with the wall's; what the computer
delays is caught up and printed as the emulator's lag. Every reading is recognised by its own noise
among the frames that the Uno sent; its stamp should be the middle of that frame's window on the
plant's clock to 1 ms, from 5 s after the first reading on.

    ./bench check bridge [--seconds 60]
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "tools"))

from uno.emulated_bench import emulated_bench
from uno.emulated_uno import START_UP, missing_tools

from examination.perf.timing import processor_of
from sma_bench.hardware.serial_messages import Splitter, Telemetry, decode
from sma_bench.parameters import Parameters
from sma_bench.ros.node import MEASURED
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/check_bridge"
FAST, SLOW = 500, 100
LONGEST_FOR_STAMPS = 20.0
LOSSES = ("lost_frames", "crc_errors", "missing_readings")
SETTLED = 5.0
LARGEST_ERROR = 1e-3
PATIENCE = 30.0
# Readings in a row whose noise no other ones have.
_UNMISTAKABLE = 50
_PRIORITY = -5


@dataclass
class Heard:
    """What came from the bridge: readings as they were sent, newest diagnostics."""

    power: list[bytes] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)

    def readings(self) -> tuple[np.ndarray, np.ndarray]:
        """ROS stamps in ns, and the board's currents in mA at outputs that are off."""
        messages = [deserialize_message(raw, BatteryState) for raw in self.power]
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
        return np.array(stamps), np.rint([1e3 * m.current for m in messages]).astype(int)

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
    right = all(run["largest_stamp_error"] < LARGEST_ERROR for run in (fast, slow))
    passed = whole and right
    _show(fast, slow)
    print("passed" if passed else "FAILED")
    if options.json:
        result = {"fast": fast, "slow": slow, "passed": passed}
        Path(options.json).write_text(json.dumps(result, indent=2) + "\n")
    return 0 if passed else 1


def be_the_uno() -> int:
    """The emulated bench: writes its port; then, for every line read, its lag since the last one
    and when its program began, and all frames since then to the file of that line's name."""
    sys.setswitchinterval(1e-4)
    with emulated_bench(Parameters.defaults()) as bench:
        sent, started = bytearray(), [0.0]

        def read() -> bytes:
            data = bench.uno.read()
            if bench.uno.electrics.started != started[0]:  # opening the port resets it
                started[0] = bench.uno.electrics.started
                sent.clear()
            sent.extend(data)
            return data

        bench.port.device = SimpleNamespace(run=bench.uno.run, write=bench.uno.write, read=read)
        print(bench.path, flush=True)
        for line in sys.stdin:
            if line.strip():
                np.save(line.strip(), _frames(bytes(sent)))
            print(bench.port.largest_lag, bench.program_start, flush=True)
            bench.port.largest_lag = 0.0
    return 0


def _frames(sent: bytes) -> np.ndarray:
    """(frames, 2) device times in us and currents of the front board in mA."""
    found = []
    for binary in (False, True):
        splitter = Splitter()
        splitter.expect(binary)
        for body in splitter.feed(sent):
            with contextlib.suppress(ValueError):
                message = decode(body)
                if isinstance(message, Telemetry):
                    found.append((message.time_us, round(1e3 * message.current[0])))
    return np.array(sorted(found), dtype=np.int64)


class Uno:
    """That process, as a context."""

    def __enter__(self) -> "Uno":
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--be-the-uno"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        self.path = self._line().strip()
        self.program_start = 0.0
        """s of the monotonic clock, as of the last time that `largest_lag` was asked"""
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait()

    def largest_lag(self, frames: Path | str = "") -> float:
        """s, since the last time this was asked; what it sent goes to the file `frames` (.npy)."""
        self._process.stdin.write(f"{frames}\n")
        self._process.stdin.flush()
        lag, self.program_start = map(float, self._line().split())
        return lag

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
    node.create_subscription(BatteryState, "wire/power", heard.power.append, MEASURED, raw=True)
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
        while not heard.power and time.monotonic() < patience:
            nodes.check()
            listen(0.1)
        listen(SETTLED)
        heard.power.clear()
        uno.largest_lag()
        began = processor_of(nodes.pid("serial_bridge"))
        listen(seconds)
        cpu = processor_of(nodes.pid("serial_bridge")) - began
        sent = logs / f"sent_{rate}.npy"
        lag = uno.largest_lag(sent)
        stamps, currents = heard.readings()
        result = {
            "rate": rate, "seconds": seconds, **_losses(heard, stamps, rate),
            **_stamps(stamps, currents, np.load(sent), rate, uno.program_start), "largest_lag": lag,
            "clock_uncertainty_ms": float(heard.values.get("clock_uncertainty_ms", "nan")),
            "round_trip_ms": float(heard.values.get("round_trip_ms", "nan")),
            "cpu": cpu / seconds,
        }
    node.destroy_node()
    return result


def _losses(heard: Heard, stamps: np.ndarray, rate: int) -> dict[str, int]:
    """Frames that the device or the cable lost, and readings that the topic did."""
    expected = round((stamps[-1] - stamps[0]) / 1e9 * rate) + 1
    return {
        "readings": len(stamps),
        "lost_frames": int(heard.values.get("lost_frames", -1)),
        "crc_errors": int(heard.values.get("crc_errors", -1)),
        "missing_readings": expected - len(stamps),
    }


def _stamps(
    stamps: np.ndarray, currents: np.ndarray, sent: np.ndarray, rate: int, start: float
) -> dict[str, float]:
    """Stamps less the middles of the readings' own windows on the plant's clock, in s."""
    times, noise = sent.T
    windows = np.lib.stride_tricks.sliding_window_view(noise, _UNMISTAKABLE)
    (first,) = np.flatnonzero((windows == currents[:_UNMISTAKABLE]).all(axis=1))
    own = first + np.rint((stamps - stamps[0]) / 1e9 * rate).astype(int)
    if (noise[own] != currents).any():
        raise RuntimeError("readings on the topic that the Uno never sent in this order")
    truth = start + START_UP + 1e-6 * times[own] - 0.5 / rate
    error = (stamps - _to_ros()) / 1e9 - truth
    return {
        "largest_stamp_error": float(np.abs(error).max()),
        "rms_stamp_error": float(np.sqrt(np.mean(error**2))),
    }


def _to_ros() -> int:
    """ns from the monotonic clock to ROS time: the quickest of a hundred looks at both."""
    looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(100)]
    before, ros, after = min(looks, key=lambda look: look[2] - look[0])
    return ros - (before + after) // 2


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
            f"  stamps against the plant's clock: rms {1e3 * run['rms_stamp_error']:.2f} ms, "
            f"largest {1e3 * run['largest_stamp_error']:.2f} ms, limit "
            f"{1e3 * LARGEST_ERROR:g} ms; the bridge states {run['clock_uncertainty_ms']:.2f} ms"
        )


if __name__ == "__main__":
    sys.exit(main())
