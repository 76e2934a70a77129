"""Through the bridge, a minute at 500 Hz, then 100 Hz: losses, checksums, share of a core.

The real firmware on an emulated Uno in one process, the real serial_bridge in another, its topic
`wire/power` here. That its stamps are right to a millisecond, test/firmware shows in virtual time.

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

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "tools"))

from uno.emulated_bench import emulated_bench
from uno.emulated_uno import missing_tools

from examination.perf.measuring import processor_of
from examination.pieces import options_of, print_table
from sma_bench.parameters import Parameters
from sma_bench.ros.node import READINGS
from sma_bench.ros.processes import NodeProcesses, private_ros_environment

NAMESPACE = "/check_bridge"
BE_THE_UNO = "--be-the-uno"
FAST, SLOW = 500, 100  # Hz
LONGEST_AT_SLOW = 20.0  # s
LOSSES = ("lost_frames", "crc_errors", "missing")
SETTLED, PATIENCE = 5.0, 30.0  # s
FEWEST = 0.9  # of the readings that are due by the wall's clock
_PRIORITY = -5


def main(argv: Sequence[str] | None = None) -> int:
    """0 when nothing was lost."""
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
                measure(Path(logs), FAST, options.seconds),
                measure(Path(logs), SLOW, min(options.seconds, LONGEST_AT_SLOW)),
            ]
    finally:
        rclpy.try_shutdown()
    print_table([f">{name.replace('_', ' ')}" for name in runs[0]], [run.values() for run in runs])
    due = all(run["readings"] >= FEWEST * run["rate"] * run["seconds"] for run in runs)
    passed = due and all(run[name] == 0 for run in runs for name in LOSSES)
    print("passed" if passed else "FAILED")
    return 0 if passed else 1


def be_the_uno() -> int:
    """The emulated bench, which says its port and lasts until its input is closed."""
    sys.setswitchinterval(1e-4)
    with emulated_bench(Parameters.defaults()) as bench:
        print(bench.path, flush=True)
        sys.stdin.read()
    return 0


def measure(logs: Path, rate: int, seconds: float) -> dict[str, float]:
    """A bridge at `rate` Hz on a fresh Uno, `seconds` long after it has settled."""
    power: list[bytes] = []  # as they were sent: this has to keep up
    values: dict[str, str] = {}
    node = rclpy.create_node("check", namespace=NAMESPACE)
    node.create_subscription(BatteryState, "wire/power", power.append, READINGS, raw=True)
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
        before = processor_of(nodes.pid("serial_bridge"))
        listen(seconds)
        core = processor_of(nodes.pid("serial_bridge")) - before
    node.destroy_node()
    # Each reading has its place in a row of them: what is missing on the topic leaves a hole.
    stamps = [deserialize_message(raw, BatteryState).header.stamp for raw in power]
    nanoseconds = np.array([stamp.sec * 10**9 + stamp.nanosec for stamp in stamps])
    places = np.rint(rate * 1e-9 * (nanoseconds - nanoseconds[0])).astype(int)
    return {
        "rate": rate, "seconds": seconds, "readings": len(power),
        **{name: int(values.get(name, -1)) for name in LOSSES[:2]},
        "missing": int(places[-1]) + 1 - len(np.unique(places)),
        "share_of_a_core": round(core / seconds, 2),
        "round_trip_ms": float(values.get("round_trip_ms", "nan")),
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
