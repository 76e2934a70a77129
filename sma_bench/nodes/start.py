"""What the executables start: `python -m sma_bench.nodes.start NODE [--ros-args ...]`.

Imports nothing of weight: a signal that comes while the node's modules are read ends the process
at once and in silence, as nothing is driven yet.
"""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

from sma_bench.lifeline import ending_signals

NODES = {  # by the executable's name: module and class
    "simulator": "simulator.Simulator",
    "serial_bridge": "serial_bridge.SerialBridge",
    "ir_camera": "cameras.IrCamera",
    "synthetic_camera": "cameras.SyntheticCameraNode",
    "experiment": "experiment.ExperimentNode",
    "recorder": "recorder.Recorder",
    "identification": "job_nodes.IdentificationNode",
    "diagnosis": "job_nodes.DiagnosisNode",
    "investigation": "investigation.InvestigationNode",
    "twin": "twin.TwinNode",
    "temperature_controller": "controllers.TemperatureControllerNode",
    "deflection_controller": "controllers.DeflectionControllerNode",
}


def start(name: str, argv: Sequence[str] | None = None) -> int:
    """Run a node until its end; the exit status."""
    for number in ending_signals():
        signal.signal(number, lambda *_: os._exit(0))
    given = sys.argv[1:] if argv is None else argv
    if not {"-h", "--help"} & set(given):
        print(f"starting {name}", flush=True)  # its libraries take a second, or many
    status: int = run(name, argv)
    for number in ending_signals():  # once more is no use, and would only make noise
        signal.signal(number, signal.SIG_IGN)
    return status


def run(name: str, argv: Sequence[str] | None = None) -> int:
    """As `start`, in a process that keeps its own signals until the node is there."""
    kind = node_class(name)
    status: int = import_module("sma_bench.nodes.base").run_node(name, kind, argv)
    return status


def node_class(name: str) -> Any:
    """The class of a node, its module imported."""
    module, _, kind = NODES[name].partition(".")
    return getattr(import_module(f"sma_bench.nodes.{module}"), kind)


def __getattr__(name: str) -> Callable[[], None]:
    """`from sma_bench.nodes.start import simulator`, as the executables do."""
    if name.startswith("_"):
        raise AttributeError(name)
    return partial(_run, name)


def _run(name: str, argv: Sequence[str] | None = None) -> None:
    """Everything is closed by then: the interpreter takes a second to take itself to pieces."""
    status = start(name, argv)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody may be left to read it
            stream.flush()
    os._exit(status)


if __name__ == "__main__":
    _run(sys.argv[1], sys.argv[2:])
