"""The stages of the demo: a simulated bench on real nodes, bags, a service."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from sma_bench.compiled import is_compiled
from sma_bench.errors import InputError
from sma_bench.lifeline import end_with_parent, tied_to_this_process
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics import core, sensitivities, simulate
from sma_bench.progress import COMPILING, Report, part, shares, silent
from sma_bench.protocols import load_protocol
from sma_bench.tasks.jobs import told_share

# Nothing may take longer than this without a sign of life, on however loaded a machine.
PATIENCE = 60.0
_BEGINNING = 10.0
STARTING = 3.0
"""s until a bench's nodes, or a recorder, are there"""
REACHED = 30.0
"""times real time, which nodes on two cores do not exceed by much"""
COMPILED_AFTER = 45.0
"""s, once after an installation, until a processor has compiled `core.run` beside nodes"""
COMPILING_TAKES = 30.0
"""s of the processor for it"""
COMPILER_PATIENCE = 600.0

# One a command: nodes that talk cost more of the processor than all that is computed.
READING_RATES = dict.fromkeys(("rate.power", "rate.temperature", "rate.mechanics"), 20.0)
_READINGS = ("power", "temperature")
_COMMANDS = ("voltage_command", "experiment/marker")



class DemoStage:
    """Nodes of one namespace, as processes; leaving the context ends them all.

    In the folder: `bags`, one of each protocol, and `logs`, one of each node.
    """

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
        self._report, self._plan, self._shares = report, plan, shares(plan)
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
        self._nodes.start("simulator", {**READING_RATES, **simulator}, (bench_file,))
        self.start_experiment(bench_file, protocol)

    def start_experiment(self, bench_file: Path, protocol: str) -> None:
        """The experiment node at its protocol."""
        self._bench = read_parameters(bench_file)
        self._nodes.start(
            "experiment", {"protocol": protocol, "use_sim_time": True}, (bench_file,)
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
        own = self._part(protocol)
        own(0.0, protocol)
        report = part(own, STARTING / self._plan[protocol], 1.0)
        bag = self.bags / protocol
        self._nodes.start("recorder", {"output": str(bag), "use_sim_time": True})
        needed = self._topics()
        self._client.wait(
            "recorder", lambda: needed <= set(self._client.recorded(str(bag))), PATIENCE
        )
        self._client.set_parameters("experiment", {"protocol": protocol}, PATIENCE)
        # Just begun, the node may not have heard the simulator's clock yet.
        retried(lambda: self._client.trigger("experiment/start", PATIENCE), _BEGINNING)
        report(0.0, "")
        begin = self._seconds()

        def finished() -> bool:
            elapsed = self._seconds() - begin
            report(elapsed / duration, f"{protocol}, {elapsed:.0f} of {duration:.0f} simulated s")
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

    def wait_for_compiler(self, process: subprocess.Popen[bytes] | None) -> None:
        """Until the process of `compiling_beside` has what a service needs, how far it is by the
        processor's time that it has had."""
        if process is None:
            return
        report, begin = self._part(COMPILING), processor_seconds(process.pid)
        left = max(COMPILING_TAKES - begin, 1.0)

        def finished() -> bool:
            report((processor_seconds(process.pid) - begin) / left, COMPILING)
            return is_compiled(core.run) or process.poll() is not None

        self._client.wait("compiling", finished, timeout=COMPILER_PATIENCE)

    def ask(
        self, node: str, service: str, settings: Mapping[str, Any], patience: float = PATIENCE
    ) -> dict[str, Any]:
        """Set a node's parameters and call its service: its answer.

        Raises:
            InputError: it refused, failed, or took longer than `patience` s.
        """
        self._reported, self._service = self._part(service), service
        self._reported(0.0, service if is_compiled(core.run) else COMPILING)
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
        return self._client.simulated_seconds

    def _topics(self) -> set[str]:
        channels = self._bench["bench.channels"]
        return {*_COMMANDS, *(f"{channel}/{what}" for channel in channels for what in _READINGS)}


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


COMPILER = [sys.executable, "-P", "-m", __name__]


@contextmanager
def compiling_beside() -> Iterator[subprocess.Popen[bytes] | None]:
    """A process compiles what both acts need, where that is not on the disk yet: the benches run as
    plain Python meanwhile, and the services find it ready."""
    if is_compiled(core.run) and is_compiled(sensitivities.run_derivatives):
        yield None
        return
    with subprocess.Popen(
        COMPILER, env=tied_to_this_process(), start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def processor_seconds(pid: int) -> float:
    """Time that a process has had of the processors [s]; 0 where the system does not say."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, words[11:13])) / os.sysconf("SC_CLK_TCK")


def _compile() -> None:
    """Call all of it once."""
    end_with_parent()
    bench = Parameters.defaults()
    moved = bench.replace({"wire.resistance": 1.0001 * bench["wire.resistance"]})
    run = simulate(bench, np.arange(3) * 0.05, np.ones((3, len(bench["bench.channels"]))))
    sensitivities.Sensitivities.of(run, [moved], np.array([1e-4]))


def recording_time(protocol: str, bench: Parameters, speed: float = 1.0) -> float:
    """Seconds that a record of a protocol takes."""
    return STARTING + load_protocol(protocol, bench).duration / min(speed, REACHED)


if __name__ == "__main__":
    _compile()
