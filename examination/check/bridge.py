"""Through the bridge, a minute at 500 Hz, then 100 Hz: losses, checksums, CPU, stamps.

The real firmware on an emulated Uno in one process, the real serial_bridge in another, its topic
`wire/power` here. The Uno's clock, which is the plant's, runs with the wall's; what the computer
delays is caught up and printed as the emulator's lag. Every reading is recognised by its own noise
among the frames that the Uno sent; its stamp should be the middle of that frame's window on the
plant's clock to 1 ms, from 5 s after the first reading on.

    ./bench check bridge [--seconds 60]
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
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

from examination.perf.measuring import processor_of
from examination.pieces import options_of
from sma_bench.hardware.serial_messages import Splitter, Telemetry, decode
from sma_bench.parameters import Parameters
from sma_bench.ros.node import MEASURED
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/check_bridge"
BE_THE_UNO = "--be-the-uno"
FAST, SLOW = 500, 100
LONGEST_FOR_STAMPS = 20.0
LOSSES = ("lost_frames", "crc_errors", "missing_readings")
SETTLED = 5.0
LARGEST_ERROR = 1.0  # ms
REPORT = """\
{rate} Hz, {seconds:g} s: {readings} readings, lost frames {lost_frames}, bad checksums \
{crc_errors}, missing on the topic {missing_readings}; CPU of the bridge {cpu:.0%} of a core, \
round trip {round_trip_ms:.1f} ms, emulator late by up to {lag:.1f} ms
  stamps against the plant's clock: rms {rms:.2f} ms, largest {largest:.2f} ms, limit {limit:g} \
ms; the bridge states {clock_uncertainty_ms:.2f} ms"""
PATIENCE = 30.0
IN_FLIGHT = 0.3  # s from the Uno's frame to the topic, at most
_UNMISTAKABLE = 50  # readings in a row whose noise no other ones have
_PRIORITY = -5


def main(argv: Sequence[str] | None = None) -> int:
    """0 when nothing was lost and the stamps are right."""
    if BE_THE_UNO in sys.argv:
        return be_the_uno()
    options = options_of("bridge", __doc__, argv, seconds=(60.0, "at 500 Hz"))
    if missing := missing_tools():
        print(missing, file=sys.stderr)
        return 2
    private_ros_environment()
    with contextlib.suppress(OSError):  # not everybody may ask for it
        os.nice(_PRIORITY)
    rclpy.init(args=[])
    try:
        with tempfile.TemporaryDirectory() as logs:
            runs = [
                _measure(Path(logs), FAST, options.seconds),
                _measure(Path(logs), SLOW, min(options.seconds, LONGEST_FOR_STAMPS)),
            ]
    finally:
        rclpy.try_shutdown()
    passed = True
    for run in runs:
        passed &= all(run[name] == 0 for name in LOSSES) and run["largest"] < LARGEST_ERROR
        print(REPORT.format(limit=LARGEST_ERROR, **run))
    print("passed" if passed else "FAILED")
    return 0 if passed else 1


def be_the_uno() -> int:
    """The emulated bench: writes its port; then, for every line read, its lag since the last one
    and when its program began, and all frames since then to the file of that line's name: (frames,
    2) device times in us and currents of the front board in mA."""
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
            found = []
            for binary in (False, True) if line.strip() else ():
                splitter = Splitter()
                splitter.expect(binary)
                for body in splitter.feed(bytes(sent)):
                    with contextlib.suppress(ValueError):
                        message = decode(body)
                        if isinstance(message, Telemetry):
                            found.append((message.time_us, round(1e3 * message.current[0])))
            if line.strip():
                np.save(line.strip(), np.array(sorted(found), dtype=np.int64))
            print(bench.port.largest_lag, bench.program_start, flush=True)
            bench.port.largest_lag = 0.0
    return 0


def _measure(logs: Path, rate: int, seconds: float) -> dict[str, Any]:
    """A bridge at `rate` Hz on a fresh Uno, `seconds` long after it has settled."""
    power: list[bytes] = []  # as they were sent
    values: dict[str, str] = {}
    node = rclpy.create_node("check", namespace=NAMESPACE)
    node.create_subscription(BatteryState, "wire/power", power.append, MEASURED, raw=True)
    node.create_subscription(
        DiagnosticArray, "/diagnostics",
        lambda message: values.update((v.key, v.value) for v in message.status[0].values), 10,
    )  # fmt: skip
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)

    def listen(seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.01)

    def lag_and_start(frames: Path | str = "") -> tuple[float, float]:
        """s, since the last time this was asked; what the Uno sent goes to the file `frames`."""
        uno.stdin.write(f"{frames}\n")
        uno.stdin.flush()
        lag, start = map(float, uno.stdout.readline().split())
        return lag, start

    command, pipe = [sys.executable, __file__, BE_THE_UNO], subprocess.PIPE
    with (
        subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as uno,
        NodeProcesses(NAMESPACE, logs) as nodes,
    ):
        port = uno.stdout.readline().strip()
        nodes.start("serial_bridge", {"port": port, "telemetry_rate": rate})
        patience = time.monotonic() + PATIENCE
        while not power and time.monotonic() < patience:
            nodes.check()
            listen(0.1)
        listen(SETTLED)
        power.clear()
        lag_and_start(logs / f"before_{rate}.npy")
        began = processor_of(nodes.pid("serial_bridge"))
        listen(seconds)
        ended = time.monotonic()
        cpu = processor_of(nodes.pid("serial_bridge")) - began
        lag, start = lag_and_start(logs / f"sent_{rate}.npy")
    node.destroy_node()

    # Frames that the device or the cable lost, and readings that the topic did.
    messages = [deserialize_message(raw, BatteryState) for raw in power]
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])
    after = np.rint((stamps - stamps[0]) / 1e9 * rate).astype(int)

    # Stamps less the middles of the readings' own windows on the plant's clock. The board's
    # currents in mA, at outputs that are off, are noise by which a reading is recognised.
    currents = np.rint([1e3 * m.current for m in messages]).astype(int)
    times, noise = np.load(logs / f"sent_{rate}.npy").T
    windows = np.lib.stride_tricks.sliding_window_view(noise, _UNMISTAKABLE)
    (first,) = np.flatnonzero((windows == currents[:_UNMISTAKABLE]).all(axis=1))
    if (noise[first + after] != currents).any():
        raise RuntimeError("readings on the topic that the Uno never sent in this order")
    # Sent while this listened, but for what may be on its way at either end.
    before = len(np.load(logs / f"before_{rate}.npy"))
    late = max(0, first - before - round(IN_FLIGHT * rate))
    due = np.searchsorted(start + START_UP + 1e-6 * times, ended - IN_FLIGHT) - first
    missing = late + max(int(after[-1]) + 1, int(due)) - len(stamps)
    truth = start + START_UP + 1e-6 * times[first + after] - 0.5 / rate
    # From the monotonic clock to ROS time: the quickest of a hundred looks at both.
    looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(100)]
    before, ros, behind = min(looks, key=lambda look: look[2] - look[0])
    error = (stamps - (ros - (before + behind) // 2)) / 1e9 - truth
    return {
        "rate": rate, "seconds": seconds, "readings": len(stamps),
        **{name: int(values.get(name, -1)) for name in LOSSES[:2]},
        "missing_readings": missing,
        "largest": 1e3 * np.abs(error).max(), "rms": 1e3 * np.sqrt(np.mean(error**2)),
        "lag": 1e3 * lag,
        **{key: float(values.get(key, "nan")) for key in ("clock_uncertainty_ms", "round_trip_ms")},
        "cpu": cpu / seconds,
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
