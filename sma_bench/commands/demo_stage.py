"""The stages of the demo: a simulated or an emulated bench on real nodes, bags, a service."""

import json
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from sma_bench.compiled import is_compiled
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics import core
from sma_bench.progress import COMPILING, Report, part, shares, silent
from sma_bench.protocols import load_protocol
from sma_bench.tasks.jobs import told_share

# Nothing may take longer than this without a sign of life, on however loaded a machine.
PATIENCE = 60.0
_BEGINNING = 10.0
_COMPILING = 600.0
STARTING = 4.0
"""s until a bench's nodes, or a recorder, are there"""

_READINGS = ("power", "temperature")
_COMMANDS = ("voltage_command", "experiment/marker")
_CAMERA = {"image_width": 128, "image_height": 96, "pixel_size": 0.4e-3}
_PICTURE_RATE = 15.0


class Stage:
    """Nodes of one namespace, as processes; leaving the context ends them all.

    In the folder: `bags`, one of each protocol, and `logs`, one of each node.
    """

    simulated = True
    """Whether time is the simulator's, on /clock."""

    def __init__(
        self, folder: Path, namespace: str, report: Report, plan: Mapping[str, float]
    ) -> None:
        """The folder is made; InputError where it cannot be.

        Args:
            report: called with how far the stage's work is.
            plan: seconds that each step takes, by protocol and service, in order.
        """
        self.bags, self._logs = folder / "bags", folder / "logs"
        # A service reads and writes nothing outside; the folder may lie anywhere.
        self._roots = dict.fromkeys(("record_root", "output_root"), str(folder.resolve()))
        self._namespace = namespace
        self._report, self._shares = report, shares(plan)
        self._asked = self._service = ""
        self._reported: Report = silent
        self._bench = Parameters.defaults()
        for directory in (self.bags, self._logs):
            make_folder(directory)

    def __enter__(self) -> Self:
        try:
            from sma_bench.ros.bench_client import BenchClient
            from sma_bench.ros.processes import NodeProcesses, private_ros_environment
        except ModuleNotFoundError as error:
            raise InputError(f"demo: {error.name} is not installed, the demo needs ROS 2") from None
        private_ros_environment()
        with ExitStack() as stack:
            self._nodes = stack.enter_context(NodeProcesses(self._namespace, self._logs))
            self._client = stack.enter_context(
                BenchClient(self._namespace, meanwhile=self._meanwhile)
            )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def start_bench(
        self, bench_file: Path, protocol: str, simulator: Mapping[str, Any]
    ) -> None:
        """A simulator that is what the file says, and the experiment node at its protocol.

        Args:
            simulator: parameters of the simulator node alone.
        """
        self._nodes.start("simulator", simulator, (bench_file,))
        if self.compiles():
            self._client.wait("simulator", lambda: is_compiled(core.run), _COMPILING)
        self.start_experiment(bench_file, protocol)

    def compiles(self) -> bool:
        """Whether the nodes have to compile the physics first, which is reported."""
        waits = not is_compiled(core.run)
        if waits:
            self._report(0.0, COMPILING)
        return waits

    def start_experiment(self, bench_file: Path, protocol: str) -> None:
        """The experiment node at its protocol."""
        self._bench = read_parameters(bench_file)
        self._nodes.start(
            "experiment", {"protocol": protocol, "use_sim_time": self.simulated}, (bench_file,)
        )
        self._client.follow("experiment")
        self._client.follow("recorder")

    def start_service(
        self, node: str, settings: Mapping[str, Any], files: tuple[Path, ...] = ()
    ) -> None:
        """A node to `ask` later; relative paths among its settings are the folder's."""
        self._nodes.start(node, {**self._roots, **settings}, files)

    def record(self, protocol: str) -> Path:
        """Run a protocol into a bag of its name.

        Raises:
            InputError: a node ended, or the experiment was aborted.
        """
        duration = load_protocol(protocol, self._bench).duration
        report = self._part(protocol)
        report(0.0, protocol)
        bag = self.bags / protocol
        self._nodes.start("recorder", {"output": str(bag), "use_sim_time": self.simulated})
        needed = self._topics()
        self._client.wait(
            "recorder", lambda: needed <= set(self._client.recorded(str(bag))), PATIENCE
        )
        self._client.set_parameters("experiment", {"protocol": protocol}, PATIENCE)
        # Just begun, the node may not have heard the simulator's clock yet.
        retried(lambda: self._client.trigger("experiment/start", PATIENCE), _BEGINNING)
        begin, kind = self._seconds(), "simulated s" if self.simulated else "s"

        def finished() -> bool:
            elapsed = self._seconds() - begin
            report(elapsed / duration, f"{protocol}, {elapsed:.0f} of {duration:.0f} {kind}")
            state = self._client.state("experiment")
            if state.startswith("aborted"):
                raise InputError(f"experiment {state}")
            return state == f"done: {protocol}"

        self._client.wait(protocol, finished, timeout=duration + PATIENCE)
        self._nodes.end("recorder")
        return bag.resolve()

    def end_bench(self) -> None:
        """End simulator and experiment: a service that works hard needs the processors."""
        for node in ("experiment", "simulator"):
            self._nodes.end(node)

    def ask(
        self, node: str, service: str, settings: Mapping[str, Any], patience: float = PATIENCE
    ) -> dict[str, Any]:
        """Set a node's parameters and call its service: its answer.

        Raises:
            InputError: it refused, failed, or took longer than `patience` s.
        """
        self._reported, self._service = self._part(service), service
        self._reported(0.0, service)
        self._client.follow(node)
        self._client.set_parameters(node, settings, PATIENCE)
        self._asked = node
        answer = self._client.trigger(f"{node}/{service}", timeout=patience)
        self._asked = ""
        found: dict[str, Any] = json.loads(answer)
        return found

    def _part(self, step: str) -> Report:
        return part(self._report, *self._shares[step])

    def _meanwhile(self) -> None:
        """While the client waits: do the nodes live, and how far is the service?"""
        self._nodes.check()
        if self._asked and (found := told_share(self._client.state(self._asked))):
            self._reported(found[0], f"{self._service}: {found[1]}")

    def _seconds(self) -> float:
        return self._client.simulated_seconds if self.simulated else time.monotonic()

    def _topics(self) -> set[str]:
        channels = self._bench["bench.channels"]
        return {*_COMMANDS, *(f"{channel}/{what}" for channel in channels for what in _READINGS)}


class HardwareStage(Stage):
    """Emulated Uno, camera, bridge, experiment: real time, the wire and the silicon emulated."""

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


def make_folder(folder: Path) -> None:
    """Make a new folder, and those above it.

    Raises:
        InputError: it exists already or cannot be made.
    """
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise InputError(f"{folder}: exists already, expected a new folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None


def recording_time(protocol: str, bench: Parameters, speed: float = 1.0) -> float:
    """Seconds that a record of a protocol takes."""
    return STARTING + load_protocol(protocol, bench).duration / speed
