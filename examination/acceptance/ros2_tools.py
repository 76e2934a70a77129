"""The bench under ROS's own tools: colcon, ros2 run, launch, param, service, topic.

    python3 -m pytest -v examination/acceptance/ros2_tools.py [-k WORD]

Runs where `ros2`, `launch` and colcon are found (a sourced Jazzy), and is skipped elsewhere; never
in the ordinary suite, which shows all that needs none of these tools (test/nodes,
test/reliability). Builds this checkout in a new workspace and plays each test with real processes.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
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
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rosidl_runtime_py.utilities import get_message  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
CHECKOUT = ("--base-paths", str(ROOT), "--packages-select", "sma_bench")
PATIENCE = 240.0  # s: what compiles does it once
# s, that a node of the bench has after the end of its launch: to 0 V, and to be gone.
LEFT = 1.0
STRING = "std_msgs/msg/String"
WARM = "name: warm\nsteps:\n- {kind: hold, name: hold, level: 3.0, duration: 600.0}\n"
OWN_LAUNCH_FILE = """\
import launch, launch_ros.actions
def generate_launch_description():
    return launch.LaunchDescription([launch_ros.actions.Node(
        package='sma_bench', executable='experiment', name='experiment', namespace='own',
        output='screen', parameters=[{'feedback': ['power']}])])
"""
IN_THE_RECORD = """\
import sys, sma_bench
r = sma_bench.load(sys.argv[1])
print(len(r.markers), r.markers[0][1], r.markers[-1][1], r["voltage_command"].values[0].max())
"""


class Program(psutil.Popen):
    """A program in a session of its own, as in a terminal, and everything that it starts."""

    def __init__(self, command: list[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        streams = {"stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL, "env": environment}
        with log.open("wb") as out:
            super().__init__(command, stdout=out, start_new_session=True, cwd=log.parent, **streams)

    @property
    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def says(self, text: str) -> None:
        until(lambda: text in self.output, lambda: f"no {text!r}: {self.output[-600:]}")

    def nodes(self) -> dict[Any, str]:
        """All that it has started, with the nodes' names."""
        found = {process: process.cmdline() for process in self.children(recursive=True)}
        return {
            process: next((Path(w).name for w in words if "/lib/sma_bench/" in w), "?")
            for process, words in found.items()
        }

    def ends(self) -> None:
        """With nothing but lines."""
        until(lambda: self.poll() is not None, "it goes on")
        assert "Traceback" not in self.output

    def ctrl_c(self) -> None:
        """As the terminal does it: to all of them at once."""
        os.killpg(self.pid, signal.SIGINT)

    def ends_cleanly(self) -> None:
        """All nodes end, each with status 0."""
        nodes = self.nodes()
        self.ends()
        # asyncio loses the status of a node that has ended when launch sends it a signal just then.
        lost = re.findall(r"child process pid (\d+) exit status already read", self.output)
        died = re.findall(r"died \[pid (\d+), exit code (-?\d+), cmd '(\S+)", self.output)
        assert [one for one in died if one[0] not in lost] == []
        until(lambda: not alive(nodes), "processes left over", 10.0)

    def clear(self) -> None:
        for process in [*(self.nodes() if self.is_running() else ()), self]:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()


def alive(processes: Any) -> list[Any]:
    pids = [process.pid for process in processes if process.is_running()]
    states = {process.pid: process.info["status"] for process in psutil.process_iter(["status"])}
    return [pid for pid in pids if states.get(pid, "gone") not in ("gone", psutil.STATUS_ZOMBIE)]


def until(condition: Any, otherwise: Any, patience: float = PATIENCE) -> None:
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            pytest.fail(otherwise if isinstance(otherwise, str) else otherwise())
        time.sleep(0.01)


class Stage:
    """A built workspace, a ROS domain and a folder; what a test starts is gone after it."""

    def __init__(self, folder: Path) -> None:
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
        """Output of a command that ends by itself, with this exit status."""
        streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        streams |= {"stdin": subprocess.DEVNULL, "text": True, "timeout": PATIENCE}
        where: dict[str, Any] = {"cwd": self.folder, "env": self.environment}
        done = subprocess.run(command, check=False, **streams, **where)
        assert status is None or done.returncode == status, done.stdout
        return done.stdout

    def start(self, *command: str) -> Program:
        log = self.folder / f"{time.monotonic_ns()}.log"
        self.programs.append(Program(list(command), log, self.environment))
        return self.programs[-1]

    def launch(self, file: str = "wire_bench", **arguments: object) -> Program:
        """`ros2 launch` of one of the package's files; nothing recorded unless asked for."""
        given = {"record": "false", "nodes": "identification"} | arguments
        words = (f"{name}:={value}" for name, value in given.items())
        return self.start("ros2", "launch", "sma_bench", f"{file}.launch.py", *words)

    def call(self, service: str) -> tuple[bool, str]:
        """Answer of a std_srvs/Trigger service."""
        text = self.run("ros2", "service", "call", service, "std_srvs/srv/Trigger")
        found = re.search(r"success=(\w+), message=(['\"])(.*)\2\)", text)
        assert found, text
        return found[1] == "True", found[3]

    def hear(self, topic: str, kind: str, latched: bool = False) -> list[Any]:
        """Messages of a topic, growing; heard by a node of the test's own."""
        qos = QoSProfile(depth=1000)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        heard: list[Any] = []
        self._ears.create_subscription(get_message(kind), topic, heard.append, qos)
        return heard

    def driven(self, namespace: str) -> tuple[Program, list[Any]]:
        """A launched simulated bench whose experiment heats the wire, and the commands heard."""
        warm = self.folder / "warm.yaml"
        warm.write_text(WARM)
        commands = self.hear(f"/{namespace}/voltage_command", "std_msgs/msg/Float64MultiArray")
        bench = self.launch(namespace=namespace, protocol=warm, autostart="true")
        until(lambda: commands and commands[-1].data[0] > 1.0, "no volts commanded")
        return bench, commands

    def clear(self) -> None:
        while self.programs:
            self.programs.pop().clear()


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    stage = Stage(tmp_path_factory.mktemp("workspace"))
    yield stage
    stage.run("ros2", "daemon", "stop", status=None)


@pytest.fixture
def stage(built):
    yield built
    built.clear()


def test_first_start_of_an_installed_package_speaks_at_once_and_reads_in_ten_seconds(stage):
    power = stage.hear("/first/front_1/power", "sensor_msgs/msg/BatteryState")
    bench = stage.launch("composite_bench", namespace="first")
    bench.says("[simulator-1]: process started")
    (node,) = [process for process, name in bench.nodes().items() if name == "simulator"]
    bench.says("[simulator-1] starting")
    # Seconds of the processor: those of the wall are the machine's.
    assert sum(node.cpu_times()[:2]) <= 1.0
    until(lambda: power, "no reading")
    assert sum(node.cpu_times()[:2]) <= 10.0


@pytest.mark.parametrize(
    ("file", "mode", "camera", "said"),
    [
        ("wire_bench", "simulated", "false", "simulating"),
        ("composite_bench", "simulated", "true", "simulating"),
        ("wire_bench", "hardware", "false", "not connected"),
    ],
)
def test_every_launch_file_in_every_mode_comes_up_and_ends_with_ctrl_c(
    stage, file, mode, camera, said
):
    bench = stage.launch(file, namespace=f"{file}_{mode}", mode=mode, camera=camera)
    for text in (said, "identification", "experiment]: idle"):
        bench.says(text)
    bench.ctrl_c()
    bench.ends_cleanly()


def test_nodes_take_lists_from_the_package_and_from_a_users_own_launch_file(stage):
    heard = stage.hear("/lists/wire/temperature", "sensor_msgs/msg/Temperature")
    stage.launch(namespace="lists", camera="true")
    until(lambda: len(heard) > 20, "no temperatures of the camera")
    assert heard[-1].variance > 0.0  # the camera's
    file = stage.folder / "own.launch.py"
    file.write_text(OWN_LAUNCH_FILE)
    stage.start("ros2", "launch", str(file)).says("idle")
    assert "['power']" in stage.run("ros2", "param", "get", "/own/experiment", "feedback")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nodes_whose_launch_is_gone_go_to_zero_volts_and_end(stage, number):
    bench, commands = stage.driven(number.name.lower())
    nodes = bench.nodes()
    bench.send_signal(number)
    since, last = time.monotonic(), 0.0
    while left := alive(nodes):
        last = time.monotonic() - since
        assert last < 20.0, f"{left} of {nodes} left over"
        time.sleep(0.01)
    time.sleep(0.3)
    assert commands[-1].data[0] == 0.0 and last <= LEFT


def test_two_benches_run_at_once_in_real_time_and_one_above_it(stage):
    topics = [f"/{name}/experiment" for name in ("left", "right")]
    states = [stage.hear(f"{topic}/state", STRING, latched=True) for topic in topics]
    markers = [stage.hear(f"{topic}/marker", STRING) for topic in topics]
    for name in ("left", "right"):
        stage.launch(namespace=name, protocol="quick_ramp", autostart="true")
    until(lambda: all(s and s[-1].data.startswith("running") for s in states), "not both run")
    until(lambda: all(len(heard) > 1 for heard in markers), "no second step")
    stage.clear()
    first = stage.launch(namespace="fast", protocol="quick_ramp", speed="5.0")
    first.says("simulating")
    second = stage.launch(namespace="faster", protocol="quick_ramp", speed="5.0")
    second.ends()
    assert "/clock is there" in second.output and first.poll() is None


def test_with_autostart_the_record_begins_before_the_run(stage):
    bag = stage.folder / "whole"
    states = stage.hear("/whole/experiment/state", STRING, latched=True)
    given = {"protocol": "quick_ramp", "autostart": "true", "speed": "20.0"}
    bench = stage.launch(namespace="whole", record="true", output=bag, **given)
    until(lambda: states and states[-1].data.startswith("done"), "not done")
    bench.ctrl_c()
    bench.ends_cleanly()
    said = stage.run(sys.executable, "-c", IN_THE_RECORD, str(bag)).strip().splitlines()[-1]
    assert said.endswith(" 0.0") and "/done" in said


def test_ctrl_c_twice_and_while_nodes_import_ends_cleanly(stage):
    bench, commands = stage.driven("impatient")
    bench.ctrl_c()
    time.sleep(0.05)
    bench.ctrl_c()
    bench.ends_cleanly()
    assert commands[-1].data[0] == 0.0
    for k in range(8):  # from the interpreter's own start to the node's first line
        bench = stage.launch(namespace=f"early_{k}")
        bench.says("process started")
        time.sleep(0.15 * k)
        bench.ctrl_c()
        bench.ends()


def test_nodes_none_and_parameters_that_cannot_change(stage):
    bench = stage.launch(namespace="fixed", nodes="none")
    bench.says("experiment]: idle")
    assert "identification" not in bench.output
    setting = ("ros2", "param", "set")
    refused = stage.run(*setting, "/fixed/experiment", "use_sim_time", "true", status=None)
    assert "failed" in refused.lower()
    node = stage.start("ros2", "run", "sma_bench", "diagnosis", "--ros-args", "-r", "__ns:=/fixed")
    node.says("starting diagnosis")
    until(lambda: "/fixed/diagnosis" in stage.run("ros2", "node", "list"), "no diagnosis")
    outside = stage.run(*setting, "/fixed/diagnosis", "improved", "/etc/x.yaml", status=None)
    assert "failed" in outside.lower() and "/etc/x.yaml" in outside


def test_every_node_has_diagnostics_and_recorder_and_identification_their_services(stage):
    heard = stage.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    bag, added = stage.folder / "served", {"twin": "true", "camera": "true", "record": "true"}
    added["nodes"] = "identification,diagnosis"
    stage.launch("composite_bench", namespace="served", output=bag, **added)
    wanted = {"simulator", "experiment", "recorder", "twin", "ir_camera", "synthetic_camera"}
    wanted |= {"identification", "diagnosis"}

    def seen() -> set[str]:
        names = [status.name for message in list(heard) for status in message.status]
        return {n.split(":")[0].split("/")[-1] for n in names if n.startswith("/served/")}

    until(lambda: wanted <= seen(), lambda: f"no diagnostics of {wanted - seen()}")
    until(lambda: (bag / "metadata.yaml").exists() or any(bag.glob("*.mcap")), "no bag")
    for service in ("split", "stop", "start"):
        success, said = stage.call(f"/served/recorder/{service}")
        assert success, f"{service}: {said}"
    assert len([path for path in stage.folder.glob("served*") if path.is_dir()]) == 3
    success, said = stage.call("/served/identification/cancel")
    assert not success and "nothing is running" in said


def test_a_qos_override_by_parameter(stage):
    override = "qos_overrides./qos/wire/power.publisher.reliability:=best_effort"
    given = ["--ros-args", "-r", "__ns:=/qos", "-p", override, "--params-file"]
    rig = str(ROOT / "config" / "wire_rig.yaml")
    stage.start("ros2", "run", "sma_bench", "simulator", *given, rig).says("simulating")
    assert "BEST_EFFORT" in stage.run("ros2", "topic", "info", "-v", "/qos/wire/power")
