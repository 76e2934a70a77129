"""Table I over a serial port: the nodes of a real bench on the real firmware, in real time.

Only the silicon and the wire are emulated: volts go over a serial port to the firmware, which
switches its pins; a camera takes pictures of the wire; recorder and identification do the rest.
Three minutes; ends with 1 unless R, h and c_p are right within three stated errors.

    ./bench check hardware [--out NEW_FOLDER]
"""

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "tools"))

from uno.emulated_uno import missing_tools

from examination.pieces import options_of, print_table
from sma_bench.commands.demo import QUICK, TABLE_ONE
from sma_bench.errors import InputError
from sma_bench.lifeline import tied_to_this_process
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.protocols import load_protocol

ROOT = Path(__file__).resolve().parents[2]
# What a lab knows of its wire without a volt, by a scale and a ruler: all that the file states.
WEIGHED = {n: Parameters.of_paper()[n] for n in ("wire.mass", "wire.surface_area", "wire.diameter")}
# Three true numbers are all within three errors but once in 120 times; an error above a tenth would
# not be worth stating.
SIGMAS, LARGEST_ERROR = 3.0, 0.1
NAMESPACE = "/check_hardware"
CAMERA = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
PATIENCE = 60.0


def judged(estimates: Mapping[str, Any], truth: Parameters) -> bool:
    """Print a row a number; whether R, h and c_p are all there, right within their stated errors,
    and these small."""
    rows, holds = [], True
    for name, symbol in TABLE_ONE.items():
        found = estimates.get(name, dict.fromkeys(("value", "std", "statistical"), math.nan))
        value, std = found["value"], found["std"]
        off = f"{value / truth[name] - 1.0:+.2%}"
        cells = f"{truth[name]:.5g}", f"{value:.5g}", f"{std:.2g}", off
        rows.append((symbol, *cells))
        holds &= abs(value - truth[name]) <= SIGMAS * std
        holds &= found["statistical"] <= LARGEST_ERROR * value
    print_table(("", ">truth", ">identified", ">std error", ">off by"), rows)
    return holds


def identified(folder: Path, truth: Parameters) -> dict[str, Any]:
    """The service's answer of such a bench; InputError without an Uno or where it aborts."""
    from sma_bench.ros.bench_client import BenchClient
    from sma_bench.ros.processes import NodeProcesses, private_ros_environment

    if missing := missing_tools():
        raise InputError(f"check hardware: {missing}")
    rig, logs, port = folder / "truth.yaml", folder / "logs", folder / "logs" / "uno"
    logs.mkdir(parents=True)
    write_parameters(rig, truth, "What the emulated bench is made of.")
    private_ros_environment()
    command = [sys.executable, ROOT / "test/tools/uno/node.py", "--port", port, "--namespace",
               NAMESPACE, "--params", rig, "--camera"]
    uno = subprocess.Popen([*map(str, command)], env=tied_to_this_process())
    try:
        with (NodeProcesses(NAMESPACE, logs) as nodes,
              BenchClient(NAMESPACE, meanwhile=nodes.check) as client):
            # The first start compiles firmware and physics.
            client.wait("emulated bench", lambda: port.exists() or uno.poll() is not None, 600.0)
            roots = dict.fromkeys(("record_root", "output_root"), str(folder.resolve()))
            for name, settings in {"synthetic_camera": {**CAMERA, "rate": 15.0},
                                   "ir_camera": {**CAMERA, "read_cold_wires": True},
                                   "serial_bridge": {"port": str(port)},
                                   "experiment": {"protocol": QUICK[0], "protocol_root": "/"},
                                   "identification": {"output_directory": ".", **roots}}.items():
                nodes.start(name, settings, (rig,))
            client.follow("serial_bridge")
            end = time.monotonic() + PATIENCE
            while True:  # just begun, the bench may not have said everything yet
                try:
                    print(client.trigger("serial_bridge/enable", PATIENCE))  # tests itself first
                    break
                except InputError:
                    if time.monotonic() > end:
                        raise
                    time.sleep(0.5)
            for name in QUICK:
                seconds = load_protocol(name, truth).duration
                print(f"{name}, {seconds:.0f} s", flush=True)
                file = ROOT / "config" / "protocols" / f"{name}.yaml"
                client.run_recorded(file, name, seconds, folder / name)
            records = {"record": [str((folder / name).resolve()) for name in QUICK]}
            client.set_parameters("identification", records, PATIENCE)
            answer: dict[str, Any] = json.loads(client.trigger("identification/identify", 600.0))
            return answer
    finally:
        uno.terminate()
        uno.wait()


def main(argv: Sequence[str] | None = None) -> int:
    """0 when the numbers hold, 1 when not, 2 where there is no emulated Uno."""
    options = options_of("hardware", __doc__, argv, out=(Path, "new folder for bags and logs"))
    truth = Parameters(WEIGHED)
    try:
        with tempfile.TemporaryDirectory() as folder:
            answer = identified(options.out or Path(folder) / "bench", truth)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    holds = judged(answer["parameters"], truth)
    for warning in answer["warnings"]:
        print("note", warning)
    print(f"within {SIGMAS:g} standard errors of the truth, statistical errors under "
          f"{LARGEST_ERROR:.0%}: {'yes' if holds else 'NO'}")
    return 0 if holds else 1
