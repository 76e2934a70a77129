"""Starts a node: `python -m sma_bench.nodes.start NODE [--ros-args ...]`, or several nodes in one
process: `... bench NODE [-p NAME:=VALUE] [NODE ...] [--ros-args ...]`.

Heavy imports come later; until they are done a signal just ends the process: nothing is driven."""

import contextlib
import faulthandler
import gc
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import import_module
from itertools import pairwise
from typing import Any

from sma_bench.lifeline import end_with_starter, ending_signals

NODES = {  # by the executable's name: module and class
    "simulator": "simulator.Simulator", "serial_bridge": "serial_bridge.SerialBridge",
    "ir_camera": "cameras.IrCamera", "synthetic_camera": "cameras.SyntheticCameraNode",
    "experiment": "experiment.ExperimentNode", "recorder": "recorder.Recorder",
    "identification": "job_nodes.IdentificationNode", "diagnosis": "job_nodes.DiagnosisNode",
    "investigation": "job_nodes.InvestigationNode", "twin": "twin.TwinNode",
    "temperature_controller": "experiment.TemperatureControllerNode",
    "deflection_controller": "experiment.DeflectionControllerNode"}
# The executable of several nodes. The node of the hardware always has its own process.
CONTAINER, _APART = "bench", frozenset({"serial_bridge"})
# These drive, and log their limits and the source of each at their start.
_DRIVERS = ("serial_bridge", "experiment", "temperature_controller", "deflection_controller")
_LIMITS = ("maximum_voltage", "maximum_current", "maximum_temperature", "command_timeout")
_SIGNAL_LATENCY = 0.1  # s: Python handles signals only between two waits of the executor
# s for 0 V and a recorder's index; then for each further step. Fast DDS once looped for ever while
# a node was destroyed, with Python's lock held: only the kernel can end that.
_CLOSING, _LEAVING = 30.0, 2.5


def start(name: str, argv: Sequence[str] | None = None) -> int:
    """Run a node, or all of a container, until SIGINT, SIGTERM, the end of one of them or of the
    ROS context. Returns 0 at a clean end, 2 after bad input or a failed import (logged in a line).
    Signals are handled here: rclpy's handler ends the context before a node's last message."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    asks_for_help = bool({"-h", "--help"} & set(arguments))
    if not asks_for_help:
        for number in ending_signals():
            signal.signal(number, lambda *_: os._exit(0))
        print(f"starting {name}", flush=True)  # importing takes a second or more
    from sma_bench.errors import InputError
    from sma_bench.installation import one_blas_thread

    one_blas_thread()
    if asks_for_help:
        print(node_help(name), end="")
        return 0
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from sma_bench.ros.node import end_of_ros, start_ros

    nodes = dict[str, Any]()
    # Lists (a signal handler may take no lock): what ended; not empty during creation; compiling.
    over, making, compiling = list[Any](), [True], list[bool]()

    def end(*_: Any) -> None:  # a second signal has no further effect
        is_first = not over
        over.append(None)
        if is_first and compiling and making:
            _end_within(_LEAVING)
            raise KeyboardInterrupt

    def waits() -> None:
        compiling.append(True)
        rclpy.logging.get_logger(name).info("waits for the compiler, once, some 20 s")
        if over and making:
            raise KeyboardInterrupt

    try:
        named, shared = {name: list[str]()}, arguments
        if name == CONTAINER:
            named, shared = contained(arguments)
        kinds, sources = dict[str, Any](), dict[str, dict[str, str]]()
        for name in named:
            kinds[name] = node_class(name)
        end_with_starter(signal.SIGINT)
        for number in ending_signals():
            signal.signal(number, end)
        for name, own in named.items():
            sources[name] = check_arguments(name, [*shared, *own])
        start_ros(shared)
        # Nodes that simulate compile once after an installation; others load no compiler.
        if compiled := sys.modules.get("sma_bench.compiled"):
            compiled.when_compiling(waits)
        for name, own in named.items():
            kinds[name].own_arguments = own
            node = nodes[name] = kinds[name]()
            if name in _DRIVERS:
                node.limits = ", ".join(f"{limit} {node.parameters[f'bench.{limit}']:g} "
                                        f"({sources[name].get(f'bench.{limit}', 'default')})"
                                        for limit in _LIMITS)
                node.get_logger().info(f"limits: {node.limits}")
        making.clear()
        with ThreadPoolExecutor(len(nodes)) as pool:
            runs = [pool.submit(_serve, node, over) for node in nodes.values()]
            while not over:
                time.sleep(_SIGNAL_LATENCY)
            _end_within(_CLOSING)
        for run in runs:
            run.result()
        for name in nodes:
            if nodes[name].failure is not None:
                raise nodes[name].failure
    except (InputError, ImportError) as error:
        logger = nodes[name].get_logger() if name in nodes else rclpy.logging.get_logger(name)
        logger.fatal(" ".join(str(error).split()))
        return 2
    except (ExternalShutdownException, KeyboardInterrupt):
        pass
    finally:
        _end_within(_LEAVING)
        for node in nodes.values() if making else ():  # creation of another node failed
            node.close()  # a recorder may have a bag open
        with end_of_ros():
            for node in nodes.values():
                _end_within(_LEAVING)  # for each of them
                node.destroy_node()
            _end_within(_LEAVING)
            gc.collect()  # a half-constructed node leaves the graph with its last reference
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        faulthandler.cancel_dump_traceback_later()
    return 0


def _serve(node: Any, over: list[Any]) -> None:
    """Serve a node until it or another one ends, then close it."""
    import rclpy

    executor = type(node).executor_type()
    executor.add_node(node)
    node.get_logger().info("ready")
    try:
        while rclpy.ok() and not over and node.failure is None:
            # Not spin(): with EventsExecutor it runs no callback, and would not notice a signal.
            executor.spin_once(timeout_sec=_SIGNAL_LATENCY)
    finally:
        over.append(node)
        if rclpy.ok():
            node.drain(lambda: executor.spin_once(timeout_sec=0.0))
            node.close()
        executor.shutdown(timeout_sec=1.0)


def contained(arguments: Sequence[str]) -> tuple[dict[str, list[str]], list[str]]:
    """The nodes of a container's command line, each with the arguments after its name, and those
    that all share, from --ros-args on. InputError: no node, one twice, or one not allowed."""
    from sma_bench.errors import InputError

    end = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    nodes: dict[str, list[str]] = {}
    for word in arguments[:end]:
        if nodes and (word.startswith("-") or ":=" in word):
            nodes[list(nodes)[-1]].append(word)
        elif word in nodes or word not in NODES.keys() - _APART:
            raise InputError(f"{word!r}, expected names of nodes, each once (see --help)")
        else:
            nodes[word] = ["--ros-args"]
    if not nodes:
        raise InputError("no node, expected the names of nodes (see --help)")
    return nodes, list(arguments[end:])


def _end_within(seconds: float) -> None:
    """Let the kernel end this process after `seconds`; prints before where it hangs."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    with contextlib.suppress(RuntimeError, ValueError, OSError):  # no terminal
        faulthandler.dump_traceback_later(0.8 * seconds)


def node_help(node: str) -> str:
    """The text of --help: usage and the node's own parameters."""
    from sma_bench.parameters.node_tables import NODE_TABLES

    if node == CONTAINER:
        return (f"usage: {node} NODE [-p NAME:=VALUE ...] [NODE ...] [--ros-args ...]\n\n"
                f"these nodes in one process: {', '.join(n for n in NODES if n not in _APART)}\n")
    lines = [f"usage: {node} [--ros-args -r __ns:=/bench --params-file P.yaml -p NAME:=VALUE ...]",
             "", "parameters of this node, besides the contract's (sma-bench parameters):"]
    for p in NODE_TABLES[node]:
        unit, default = f" [{p.unit}]" if p.unit else "", json.dumps(p.default)
        lines.append(f"  {p.name:28} {p.description}{unit} (default {default})")
    return "\n".join(lines) + "\n"


def check_arguments(node: str, argv: Sequence[str]) -> dict[str, str]:
    """Check every parameter file and `-p name:=value` of a command line (without program name);
    returns the source of each name's value. InputError: unreadable file, none for this node,
    unknown name (with the nearest known), wrong type or out of range; one line with the file."""
    # ROS ignores unknown names: a typing error would leave a default, even of a safety limit.
    from sma_bench.border import load_yaml
    from sma_bench.errors import InputError, errors_in
    from sma_bench.parameters.node_tables import NODE_TABLES, OF_NODES, refuse_unknown
    from sma_bench.parameters.parameter import BY_NAME
    from sma_bench.parameters.parameters import UNCERTAINTY_PREFIX, Parameters
    from sma_bench.parameters.yaml_file import flatten, read_parameter_names

    inside, options, named, namespace = False, [], node, ""
    for option, value in pairwise([*argv, ""]):
        if option in ("--ros-args", "--"):
            inside = option == "--ros-args"
            continue
        if not inside:
            raise InputError(f"unknown argument {option!r}: ROS arguments go after --ros-args")
        options.append((option, value))
        # The node's section in a file has its (remapped) name and namespace.
        name, _, target = value.partition(":=")
        if option in ("-r", "--remap") and target and name in ("__node", "__name"):
            named = target
        elif option in ("-r", "--remap") and name == "__ns":
            namespace = f"/{target.strip('/')}" if target.strip("/") else ""
    # Later sources override earlier ones; all values are validated together.
    own = {parameter.name: parameter for parameter in NODE_TABLES[node]}
    contract, sources = dict[str, Any](), dict[str, str]()
    for option, value in options:
        where, (name, separator, text) = option, value.partition(":=")
        if option == "--params-file":
            where, values = value, read_parameter_names(value, f"{namespace}/{named}")
        elif option not in ("-p", "--param"):
            continue
        elif not separator:
            raise InputError(f"-p {value}: expected name:=value")
        else:
            with errors_in(f"-p {value:.80}"):
                values = flatten({name.split(":")[-1]: load_yaml(text)})
        # A file may be for several nodes, the command line is for this one.
        shared = option == "--params-file" or ":" in name
        refuse_unknown(values, where, OF_NODES if shared else own)
        for name, given in values.items():
            parameter = own.get(name) or BY_NAME.get(name)
            if parameter is None and name.removeprefix(UNCERTAINTY_PREFIX) not in BY_NAME:
                continue  # another node's, or ROS's own
            is_integer = isinstance(given, int) and not isinstance(given, bool)
            if is_integer and (parameter is None or parameter.kind == "double"):
                raise InputError(f"{where}: {name} is the integer {given}, ROS expects {given}.0")
            if name in own:
                own[name].validated(given, where)
            else:
                contract[name] = given
            sources[name] = where
        Parameters(contract, where=where)
    return sources


def node_class(name: str) -> Any:
    module, _, kind = NODES[name].partition(".")
    return getattr(import_module(f"sma_bench.nodes.{module}"), kind)


def __getattr__(name: str) -> Callable[[], None]:
    """`from sma_bench.nodes.start import simulator`, as the executables do."""
    if name.startswith("_"):
        raise AttributeError(name)
    return partial(_run, name)


def _run(name: str, argv: Sequence[str] | None = None) -> None:
    """Start, and exit at once: all is closed, and the interpreter's own end takes a second."""
    status = start(name, argv)
    _end_within(_LEAVING)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the reader may be gone
            stream.flush()
    os._exit(status)


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in (*NODES, CONTAINER):
        print(f"expected one of {', '.join(NODES)}, {CONTAINER}", file=sys.stderr)
        sys.exit(2)
    _run(sys.argv[1], sys.argv[2:])
