"""sma-bench demo --hardware: the nodes of a real bench, on the real firmware in an emulated Uno.

Only the silicon and the wire are emulated: volts go over a serial port to the firmware, which
switches its pins; a camera takes pictures of the wire. Real time.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from sma_bench.commands.demo_acts import TABLE_ONE
from sma_bench.commands.demo_stage import PATIENCE, Stage, recording_time
from sma_bench.commands.terminal import Course, print_table, progress
from sma_bench.emulation.build import missing_tools
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.table import BY_NAME

NAMESPACE = "/demo_hardware"
PROTOCOLS = ("quick_staircase", "quick_ramp")
WITHIN_SIGMAS = 3.0
"""of each number's stated error: three true ones are all within it but once in 120 times"""
LARGEST_RELATIVE_STD = 0.1
"""an error larger than this would not be worth stating"""

_CAMERA = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
_PICTURE_RATE = 15.0
_IDENTIFYING = 6.0  # s
_HEADER = ("", "unit", "truth", "identified", "std error", "off by", "deviation")


class HardwareStage(Stage):
    """Emulated Uno, camera, bridge, experiment."""

    simulated = False

    def start_hardware(self, bench_file: Path, port: Path, protocol: str) -> str:
        """Every node of the bench; enables the bridge. What its self test found.

        Raises:
            InputError: a node ended, or the self test failed.
        """
        self.compiles()
        files = (bench_file,)
        hidden = {"wire/temperature": "wire/true_temperature"}
        self._nodes.start("emulated_bench", {"port": str(port)}, files, hidden)
        self._nodes.start("synthetic_camera", {**_CAMERA, "rate": _PICTURE_RATE}, files)
        self._nodes.start("ir_camera", {**_CAMERA, "read_cold_wires": True}, files)
        self._nodes.start("serial_bridge", {"port": str(port)}, files)
        self.start_experiment(bench_file, protocol)
        self._client.follow("serial_bridge")
        found = self._insist("serial_bridge/self_test")
        self._insist("serial_bridge/enable")
        return found

    def record(self, protocol: str) -> Path:
        """As Stage; the InputError of a failure quotes what the bridge says."""
        try:
            return super().record(protocol)
        except InputError as error:
            state = self._client.state("serial_bridge")
            raise InputError(f"{error} (serial_bridge: {state})") from None

    def _insist(self, service: str) -> str:
        """A service's success; just begun, the bench may not have said everything yet."""
        return retried(lambda: self._client.trigger(service, PATIENCE), PATIENCE)


def retried(call: Callable[[], str], patience: float, pause: float = 0.5) -> str:
    """The first success of a call within `patience` s, or its last InputError."""
    end = time.monotonic() + patience
    while True:
        try:
            return call()
        except InputError:
            if time.monotonic() > end:
                raise
        time.sleep(pause)


def hardware_act(
    console: Console, out: Path, truth: Parameters, course: Course
) -> dict[str, Any]:
    """Identify an emulated bench that is made of `truth`.

    Returns:
        For the demo's JSON; `holds`, whether the numbers are right.

    Raises:
        InputError: the emulator cannot be built here, a node ended, or the experiment aborted.
    """
    if missing := missing_tools():
        raise InputError(f"demo --hardware: {missing}")
    truth_file = out / "truth.yaml"
    write_parameters(truth_file, truth, "What the emulated bench is made of.")
    plan = {protocol: recording_time(protocol, truth) for protocol in PROTOCOLS}
    plan["identify"] = _IDENTIFYING
    with (
        progress("demo", course) as report,
        HardwareStage(out, NAMESPACE, report, plan) as stage,
    ):
        # Not beside the results: a service writes into no folder with links out of it.
        found = stage.start_hardware(truth_file, out / "logs" / "uno", PROTOCOLS[0])
        stage.start_service("identification", {"output_directory": "."})
        bags = [str(stage.record(protocol)) for protocol in PROTOCOLS]
        answer = stage.ask("identification", "identify", {"record": bags})
    console.print(f"self test: {escape(found)}")
    estimates = answer["parameters"]
    _print_table(console, estimates, truth)
    for warning in answer["warnings"]:
        console.print(f"[yellow]note[/] {escape(warning)}")
    holds = numbers_hold(estimates, truth)
    console.print(
        f"within {WITHIN_SIGMAS:g} standard errors of the truth, errors under "
        f"{LARGEST_RELATIVE_STD:.0%}: {'yes' if holds else 'NO'}"
    )
    console.print(f"bags       {escape(str(out / 'bags'))}", soft_wrap=True)
    return {
        "holds": holds, "truth": {name: truth[name] for name in TABLE_ONE},
        "estimates": estimates,
        "deviation": {
            name: deviation(estimates[name], truth[name]) for name in TABLE_ONE if name in estimates
        },
    }


def numbers_hold(estimates: Mapping[str, Any], truth: Parameters) -> bool:
    """Whether R, h and c_p are all there, right within their stated errors, and these small."""
    return all(
        name in estimates
        and abs(deviation(estimates[name], truth[name])) <= WITHIN_SIGMAS
        and estimates[name]["std"] <= LARGEST_RELATIVE_STD * estimates[name]["value"]
        for name in TABLE_ONE
    )


def deviation(estimate: Mapping[str, Any], true: float) -> float:
    """Estimate less truth, in stated standard errors."""
    return float((estimate["value"] - true) / estimate["std"])


def _print_table(console: Console, estimates: Mapping[str, Any], truth: Parameters) -> None:
    rows = []
    for name, symbol in TABLE_ONE.items():
        true, found = truth[name], estimates.get(name)
        cells = ("not found", "", "", "")
        if found is not None:
            off = f"{found['value'] / true - 1.0:+.2%}"
            std, z = f"{found['std']:.2g}", f"{deviation(found, true):+.2f}"
            cells = (f"{found['value']:.5g}", std, off, z)
        rows.append((symbol, BY_NAME[name].unit, f"{true:.5g}", *cells))
    title = "Table I, over a serial port"
    print_table(console, _HEADER, rows, range(2, len(_HEADER)), title=title)
