"""Table I over a serial port: the nodes of a real bench on the real firmware, in real time.

Only the microcontroller and the wire are emulated: commanded voltages go over a serial port to the
firmware, which switches its pins; a camera takes pictures of the wire; recorder and identification
do the rest. Three minutes; exits with 1 unless R, h and c_p are right within three standard errors.

    ./bench check hardware [--out NEW_FOLDER]
"""

import json
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
from sma_bench.errors import InputError
from sma_bench.lifeline import tied_to_this_process
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.protocols import load_protocol

ROOT = Path(__file__).resolve().parents[2]
UNO = ROOT / "test" / "tools" / "uno"
TABLE_ONE = {"wire.resistance": "R", "wire.heat_transfer_coefficient": "h",
             "wire.specific_heat": "c_p"}  # fmt: skip
# All that the parameter file states: what a lab measures by a scale and a ruler.
WEIGHED = {n: Parameters.of_paper()[n] for n in ("wire.mass", "wire.surface_area", "wire.diameter")}
PROTOCOLS = ("quick_staircase", "quick_ramp")
# Three numbers are all within three standard errors, except once in 120 times; an error above a
# tenth would be useless.
SIGMAS, LARGEST_ERROR = 3.0, 0.1
NAMESPACE = "/check_hardware"
CAMERA = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
PATIENCE = 60.0


def right(estimates: Mapping[str, Any], truth: Parameters) -> bool:
    """True if R, h and c_p are identified, right within their standard errors, and these small."""
    return all((found := estimates.get(name)) is not None
               and abs(found["value"] - truth[name]) <= SIGMAS * found["std"]
               and found["statistical"] <= LARGEST_ERROR * found["value"]
               for name in TABLE_ONE)


def show(estimates: Mapping[str, Any], truth: Parameters) -> None:
    """Print a row per number: true value, estimate, error, deviation in % and standard errors."""
    rows = []
    for name, symbol in TABLE_ONE.items():
        cells = ["not found", "", "", ""]
        if found := estimates.get(name):
            off = found["value"] / truth[name] - 1.0
            z = (found["value"] - truth[name]) / found["std"]
            cells = [f"{found['value']:.5g}", f"{found['std']:.2g}", f"{off:+.2%}", f"{z:+.2f}"]
        rows.append((symbol, f"{truth[name]:.5g}", *cells))
    print_table(("", ">truth", ">identified", ">std error", ">off by", ">deviation"), rows)


def identified(folder: Path, truth: Parameters) -> dict[str, Any]:
    """Run the bench; the answer of the identification service. InputError: no Uno, or aborted."""
    from sma_bench.ros.bench_client import BenchClient
    from sma_bench.ros.processes import NodeProcesses, private_ros_environment

    if missing := missing_tools():
        raise InputError(f"check hardware: {missing}")
    rig, logs, port = folder / "truth.yaml", folder / "logs", folder / "logs" / "uno"
    logs.mkdir(parents=True)
    write_parameters(rig, truth, "What the emulated bench is made of.")
    private_ros_environment()
    uno = subprocess.Popen([sys.executable, str(UNO / "node.py"), "--port", str(port),
                            "--namespace", NAMESPACE, "--params", str(rig),
                            "--camera"], env=tied_to_this_process())
    try:
        with (NodeProcesses(NAMESPACE, logs) as nodes,
              BenchClient(NAMESPACE, meanwhile=nodes.check) as client):
            # The first start compiles firmware and physics.
            client.wait("emulated bench", lambda: port.exists() or uno.poll() is not None, 600.0)
            roots = dict.fromkeys(("record_root", "output_root"), str(folder.resolve()))
            for name, settings in {"synthetic_camera": {**CAMERA, "rate": 15.0},
                                   "ir_camera": {**CAMERA, "read_cold_wires": True},
                                   "serial_bridge": {"port": str(port)},
                                   "experiment": {"protocol": PROTOCOLS[0], "protocol_root": "/"},
                                   "identification": {"output_directory": ".", **roots}}.items():
                nodes.start(name, settings, (rig,))
            client.follow("serial_bridge")
            for service in ("serial_bridge/self_test", "serial_bridge/enable"):
                end = time.monotonic() + PATIENCE
                while True:  # right after the start, not all topics may have arrived yet
                    try:
                        print(client.trigger(service, PATIENCE))
                        break
                    except InputError:
                        if time.monotonic() > end:
                            raise
                        time.sleep(0.5)
            for name in PROTOCOLS:
                seconds = load_protocol(name, truth).duration
                print(f"{name}, {seconds:.0f} s", flush=True)
                file = ROOT / "config" / "protocols" / f"{name}.yaml"
                try:
                    client.run_recorded(file, name, seconds, folder / name)
                except InputError as error:
                    state = client.state("serial_bridge")
                    raise InputError(f"{error} (serial_bridge: {state})") from None
            records = {"record": [str((folder / name).resolve()) for name in PROTOCOLS]}
            client.set_parameters("identification", records, PATIENCE)
            answer: dict[str, Any] = json.loads(client.trigger("identification/identify", 600.0))
            return answer
    finally:
        uno.terminate()
        uno.wait()


def main(argv: Sequence[str] | None = None) -> int:
    """0 if the numbers are right, 1 if not, 2 if there is no emulated Uno."""
    options = options_of("hardware", __doc__, argv, out=(Path, "new folder for bags and logs"))
    truth = Parameters(WEIGHED)
    try:
        with tempfile.TemporaryDirectory() as folder:
            answer = identified(options.out or Path(folder) / "bench", truth)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    estimates, holds = answer["parameters"], right(answer["parameters"], truth)
    show(estimates, truth)
    for warning in answer["warnings"]:
        print("note", warning)
    print(f"within {SIGMAS:g} standard errors of the true values, statistical errors under "
          f"{LARGEST_ERROR:.0%}: {'yes' if holds else 'NO'}")  # fmt: skip
    return 0 if holds else 1
