"""The bench under ROS's own tools: colcon, ros2 run, launch, param, service, topic.

    python3 -m pytest -v examination/acceptance/ros2_tools.py [-k WORD]

Needs `ros2`, `launch` and colcon (a sourced Jazzy), and is skipped without them. Not part of the
test suite, which tests everything that needs none of these tools (test/nodes, test/reliability).
Builds this checkout in a new workspace and runs each test with real processes.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

for needed in ("launch_ros", "rclpy", "psutil"):  # the last comes with ros2cli
    pytest.importorskip(needed)
if missing := [tool for tool in ("ros2", "colcon") if shutil.which(tool) is None]:
    pytest.skip(f"{missing} not found: source a ROS 2 Jazzy setup file", allow_module_level=True)

import psutil  # noqa: E402
import rclpy  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
CHECKOUT = ("--base-paths", str(ROOT), "--packages-select", "sma_bench")
PATIENCE = 480.0  # s: the first run compiles
# s after the end of a launch, within which a node must set 0 V, and must have ended.
LEFT = 1.0
WARM = "name: warm\nsteps:\n- {kind: hold, name: hold, level: 3.0, duration: 600.0}\n"
OWN_LAUNCH_FILE = """\
import launch, launch_ros.actions
def generate_launch_description():
    return launch.LaunchDescription([launch_ros.actions.Node(
        package='sma_bench', executable='experiment', name='experiment', namespace='own',
        output='screen', parameters=[{'feedback': ['power']}])])
"""


class Program(psutil.Popen):
    """A program in a session of its own, as in a terminal, with all its child processes."""

    def __init__(self, command: list[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        with log.open("wb") as out:
            super().__init__(command, stdout=out, stderr=subprocess.STDOUT, env=environment,
                             stdin=subprocess.DEVNULL, start_new_session=True, cwd=log.parent)

    @property
    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def says(self, text: str) -> None:
        until(lambda: text in self.output, lambda: f"no {text!r}: {self.output[-600:]}")

    def nodes(self) -> list[psutil.Process]:
        return self.children(recursive=True)

    def ctrl_c(self) -> None:
        """Send SIGINT to all processes at once, as a terminal does."""
        os.killpg(self.pid, signal.SIGINT)

    def ends(self) -> None:
        until(lambda: self.poll() is not None, "it goes on")
        assert "Traceback" not in self.output

    def ends_cleanly(self) -> None:
        nodes = self.nodes()
        self.ends()
        # asyncio loses the exit status of a node that ends just when launch sends it a signal.
        lost = re.findall(r"child process pid (\d+) exit status already read", self.output)
        died = re.findall(r"died \[pid (\d+), exit code", self.output)
        assert set(died) <= set(lost), self.output[-600:]
        until(lambda: not alive(nodes), "processes left over", 10.0)

    def clear(self) -> None:
        for process in [*(self.nodes() if self.is_running() else ()), self]:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()


def alive(processes: Any) -> list[Any]:
    found = []
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            if process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


def until(condition: Any, otherwise: Any, patience: float = PATIENCE) -> None:
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            pytest.fail(otherwise if isinstance(otherwise, str) else otherwise())
        time.sleep(0.01)


class Stage:
    """A built workspace, a ROS domain and a folder; all processes are ended after a test."""

    def __init__(self, folder: Path) -> None:
        os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self.folder, self.environment = folder, dict(os.environ)
        self.programs: list[Program] = []
        assert "1 package finished" in self.run("colcon", "build", *CHECKOUT)
        setup = shlex.quote(str(folder / "install" / "local_setup.bash"))
        shown = self.run("bash", "-c", f". {setup} && env -0")
        self.environment |= dict(line.partition("=")[::2] for line in shown.split("\0") if line)
        rclpy.init(args=[])
        self._ears, executor = rclpy.create_node("acceptance"), SingleThreadedExecutor()
        executor.add_node(self._ears)
        threading.Thread(target=executor.spin, daemon=True).start()

    def run(self, *command: str, status: int | None = 0) -> str:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=PATIENCE, check=False,
                              cwd=self.folder, env=self.environment)
        assert status is None or done.returncode == status, done.stdout
        return done.stdout

    def start(self, *command: str) -> Program:
        log = self.folder / f"{time.monotonic_ns()}.log"
        self.programs.append(Program(list(command), log, self.environment))
        return self.programs[-1]

    def launch(self, file: str = "wire_bench", **arguments: object) -> Program:
        """`ros2 launch` of one of the package's files; without recording by default."""
        given = {"record": "false", "nodes": "identification"} | arguments
        words = (f"{name}:={value}" for name, value in given.items())
        return self.start("ros2", "launch", "sma_bench", f"{file}.launch.py", *words)

    def driven(self, namespace: str, **given: str) -> tuple[Program, list[Any]]:
        """A launched simulated bench whose experiment heats the wire, and the received commands."""
        warm, commands, topic = self.folder / "warm.yaml", [], f"/{namespace}/voltage_command"
        warm.write_text(WARM)
        self._ears.create_subscription(Float64MultiArray, topic, commands.append, 1000)
        bench = self.launch(namespace=namespace, protocol=warm, autostart="true", **given)
        until(lambda: commands and commands[-1].data[0] > 1.0, "no volts commanded")
        return bench, commands

    def clear(self) -> None:
        while self.programs:
            self.programs.pop().clear()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    stage = Stage(tmp_path_factory.mktemp("workspace"))
    yield stage
    stage.run("ros2", "daemon", "stop", status=None)


@pytest.fixture
def stage(built):
    yield built
    built.clear()


@pytest.mark.parametrize(("file", "mode", "camera", "container", "said"), [
    ("wire_bench", "simulated", "false", "false", "simulating"),
    ("composite_bench", "simulated", "true", "false", "simulating"),
    ("composite_bench", "simulated", "true", "true", "simulating"),
    ("wire_bench", "hardware", "false", "false", "not connected")])
def test_every_launch_file_in_every_mode_comes_up_and_ends_with_ctrl_c(stage, file, mode, camera,
                                                                       container, said):
    given = {"mode": mode, "camera": camera, "container": container}
    bench = stage.launch(file, namespace=f"{file}_{mode}_{container}", **given)
    for text in (said, "identification", "experiment]: idle"):
        bench.says(text)
    bench.ctrl_c()
    bench.ends_cleanly()


def test_a_node_takes_a_list_from_a_users_own_launch_file(stage):
    file = stage.folder / "own.launch.py"
    file.write_text(OWN_LAUNCH_FILE)
    stage.start("ros2", "launch", str(file)).says("idle")
    assert "['power']" in stage.run("ros2", "param", "get", "/own/experiment", "feedback")


@pytest.mark.parametrize("container", ["false", "true"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nodes_whose_launch_is_gone_go_to_zero_volts_and_end(stage, number, container):
    bench, commands = stage.driven(f"{number.name.lower()}_{container}", container=container)
    nodes = bench.nodes()
    bench.send_signal(number)
    since, last = time.monotonic(), 0.0
    while left := alive(nodes):
        last = time.monotonic() - since
        assert last < 20.0, f"{left} of {nodes} left over"
        time.sleep(0.01)
    time.sleep(0.3)
    assert commands[-1].data[0] == 0.0 and last <= LEFT


def test_ctrl_c_twice_and_while_nodes_import_ends_cleanly(stage):
    bench, commands = stage.driven("impatient")
    bench.ctrl_c()
    time.sleep(0.05)
    bench.ctrl_c()
    bench.ends_cleanly()
    assert commands[-1].data[0] == 0.0
    for k in range(8):  # from the start of the interpreter to the first line of the node
        bench = stage.launch(namespace=f"early_{k}")
        bench.says("process started")
        time.sleep(0.15 * k)
        bench.ctrl_c()
        bench.ends()


def test_parameters_are_dumped_and_loaded_and_what_is_wrong_is_refused(stage):
    names = ("simulator", "experiment", "recorder", "twin", "identification")
    bench = stage.launch(namespace="set", twin="true", record="true", output=stage.folder / "set")
    until(lambda: bench.output.count("]: ready") >= len(names), "not all ready")
    for name in names:
        file = stage.folder / f"{name}.yaml"
        file.write_text(stage.run("ros2", "param", "dump", f"/set/{name}"))
        told = stage.run("ros2", "param", "load", f"/set/{name}", str(file))
        assert not [x for x in told.splitlines() if "fail" in x and "read" not in x], told
    launch = ("ros2", "launch", "sma_bench", "wire_bench.launch.py")
    assert "bogus: not one of" in stage.run(*launch, "protocol:=bogus", status=1)
    words = ("ir_camera", "--ros-args", "-p", "wires:=4")
    assert "Traceback" not in stage.run("ros2", "run", "sma_bench", *words, status=2)


def test_the_package_as_ros2_sees_it(stage):
    told = stage.run("ros2", "pkg", "executables", "sma_bench").split()[1::2]
    assert {"simulator", "serial_bridge", "twin", "sma-bench"} <= {*told}, told
    assert "<license" in stage.run("ros2", "pkg", "xml", "sma_bench")


def test_a_qos_override_by_parameter(stage):
    override = "qos_overrides./qos/wire/power.publisher.reliability:=best_effort"
    given = ["--ros-args", "-r", "__ns:=/qos", "-p", override, "--params-file"]
    rig = str(ROOT / "config" / "wire_rig.yaml")
    stage.start("ros2", "run", "sma_bench", "simulator", *given, rig).says("simulating")
    assert "BEST_EFFORT" in stage.run("ros2", "topic", "info", "-v", "/qos/wire/power")
