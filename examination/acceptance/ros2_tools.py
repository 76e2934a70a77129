#!/usr/bin/env python3
"""The bench under ROS's own tools: colcon, ros2 run, launch, param, service, topic.

    python3 examination/acceptance/ros2_tools.py [WORD ...]   # rows that have one of the words

Runs where `ros2`, `launch` and colcon are found (a sourced Jazzy), and says so elsewhere; never in
the ordinary suite, which shows all that needs none of these tools (test/nodes, test/reliability).
Builds this checkout in a new workspace, plays each row with real processes, prints a table, and is
1 where a row fails. A new row is a function under `@row`: it returns the outcome, or raises Failed
with what went wrong instead.
"""

import importlib.util
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import psutil  # ros2cli needs it as well

ROOT = Path(__file__).resolve().parents[2]
CHECKOUT = ("--base-paths", str(ROOT), "--packages-select", "sma_bench")
PATIENCE = 240.0  # s: what compiles does it once
# What a node of the bench has after the end of its launch: to 0 V, and to be gone.
LEFT = 1.0
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
ROWS: list[tuple[str, str, Callable[["Stage"], str]]] = []


class Failed(Exception):
    """What went wrong."""


def row(item: str, what: str) -> Callable[[Callable[["Stage"], str]], None]:
    """Add a row: an item of the list that it belongs to, and what is done."""
    return lambda play: ROWS.append((item, what, play))


def need(condition: Any, said: str) -> None:
    if not condition:
        raise Failed(said)


# --- processes ----------------------------------------------------------------------------------


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
        until(lambda: text in self.output, f"nothing like {text!r} from {self.log.name}")

    def ends(self) -> int:
        """Exit status; nothing but lines."""
        until(lambda: self.poll() is not None, f"{self.log.name} goes on")
        need("Traceback" not in self.output, f"traceback: {self.output.strip()[-300:]}")
        return self.returncode

    def ctrl_c(self) -> None:
        """As the terminal does it: to all of them at once."""
        os.killpg(self.pid, signal.SIGINT)

    def ends_cleanly(self) -> str:
        """All nodes end, each with status 0."""
        nodes, status = self.children(recursive=True), self.ends()
        # asyncio loses the status of a node that has ended when launch sends it a signal just then.
        lost = re.findall(r"child process pid (\d+) exit status already read", self.output)
        died = re.findall(r"died \[pid (\d+), exit code (-?\d+), cmd '(\S+)", self.output)
        died = [(Path(path).name, code) for pid, code, path in died if pid not in lost]
        need(not died, f"died: {died}")
        until(lambda: not alive(nodes), "processes left over", 10.0)
        return f"status {status}, {len(nodes)} processes ended cleanly, no traceback"

    def clear(self) -> None:
        for process in [*(self.children(recursive=True) if self.is_running() else []), self]:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()


def alive(processes: list[psutil.Process]) -> list[psutil.Process]:
    def goes_on(process: psutil.Process) -> bool:
        with suppress(psutil.NoSuchProcess):
            return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
        return False

    return list(filter(goes_on, processes))


def name_of(process: psutil.Process) -> str:
    try:
        words = process.cmdline()
    except psutil.Error:
        return "?"
    return next((Path(word).name for word in words if "/lib/sma_bench/" in word), "?")


def until(condition: Callable[[], Any], otherwise: str, patience: float = PATIENCE) -> None:
    end = time.monotonic() + patience
    while not condition():
        need(time.monotonic() < end, f"{otherwise} within {patience:g} s")
        time.sleep(0.01)


# --- the stage ----------------------------------------------------------------------------------


class Stage:
    """A built workspace, a ROS domain and a folder; what a row starts is gone after it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = dict(os.environ)
        self._programs: list[Program] = []
        self._ears: Any = None

    def build(self) -> str:
        """In a new workspace."""
        (self.folder / "ws").mkdir()
        started = time.monotonic()
        text = self.run("colcon", "build", *CHECKOUT)
        need("1 package finished" in text, text[-300:])
        setup = self.folder / "ws" / "install" / "local_setup.bash"
        shown = self.run("bash", "-c", f". {shlex.quote(str(setup))} && env -0")
        self.environment |= dict(line.partition("=")[::2] for line in shown.split("\0") if line)
        return f"built in {time.monotonic() - started:.0f} s"

    def run(self, *command: str, status: int | None = 0) -> str:
        """Output of a command that ends by itself, with this exit status."""
        streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        streams |= {"stdin": subprocess.DEVNULL, "text": True, "timeout": PATIENCE}
        where: dict[str, Any] = {"cwd": self.folder / "ws", "env": self.environment}
        done = subprocess.run(command, check=False, **streams, **where)
        said = f"{shlex.join(command)}: {done.stdout.strip()[-400:]}"
        need(status is None or done.returncode == status, said)
        return done.stdout

    def start(self, *command: str) -> Program:
        name = f"{len(self._programs):02d}_{command[-1][:20].strip('/')}".replace("/", "_")
        self._programs.append(Program(list(command), self.folder / name, self.environment))
        return self._programs[-1]

    def launch(self, file: str = "wire_bench", **arguments: object) -> Program:
        """`ros2 launch` of one of the package's files; nothing recorded unless asked for."""
        given = {"record": "false", "nodes": "identification"} | arguments
        words = (f"{name}:={value}" for name, value in given.items())
        return self.start("ros2", "launch", "sma_bench", f"{file}.launch.py", *words)

    def call(self, service: str) -> tuple[bool, str]:
        """Answer of a std_srvs/Trigger service."""
        text = self.run("ros2", "service", "call", service, "std_srvs/srv/Trigger")
        found = re.search(r"success=(\w+), message=(['\"])(.*)\2\)", text)
        if found is None:
            raise Failed(f"{service}: {text.strip()[-200:]}")
        return found[1] == "True", found[3]

    def hear(self, topic: str, kind: str, latched: bool = False) -> list[Any]:
        """Messages of a topic, growing; heard by a node of the script's own."""
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rosidl_runtime_py.utilities import get_message

        if self._ears is None:
            rclpy.init(args=[])
            self._ears = rclpy.create_node("acceptance")
            executor = SingleThreadedExecutor()
            executor.add_node(self._ears)
            threading.Thread(target=executor.spin, daemon=True).start()
        qos = QoSProfile(depth=1000)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        heard: list[Any] = []
        self._ears.create_subscription(get_message(kind), topic, heard.append, qos)
        return heard

    def driven(self, namespace: str) -> tuple[Program, list[Any]]:
        """A launched simulated bench whose experiment heats the wire, and the commands heard."""
        warm = self.folder / "warm.yaml"
        step = "{kind: hold, name: hold, level: 3.0, duration: 600.0}"
        warm.write_text(f"name: warm\nsteps:\n- {step}\n")
        commands = self.hear(f"/{namespace}/voltage_command", "std_msgs/msg/Float64MultiArray")
        bench = self.launch(namespace=namespace, protocol=warm, autostart="true")
        until(lambda: commands and commands[-1].data[0] > 1.0, "no volts commanded")
        return bench, commands

    def clear(self) -> str:
        """End all that was started; the last lines of each."""
        programs, self._programs = self._programs, []
        for program in reversed(programs):
            program.clear()
        return " | ".join(line for p in programs for line in p.output.splitlines()[-3:])


# --- rows ---------------------------------------------------------------------------------------


@row("4", "colcon test with pytest")
def colcon_test(stage: Stage) -> str:
    chosen = ["test/parameters", "test/packaging/test_manifests.py", "-m", "not slow", "-q"]
    stage.run("colcon", "test", *CHECKOUT, "--pytest-args", *chosen)
    said = stage.run("colcon", "test-result", "--all")
    found = re.search(r"Summary: (\d+) tests, 0 errors, 0 failures", said)
    if found is None or int(found[1]) <= 50:
        raise Failed(said.strip()[-200:])
    return found[0].removeprefix("Summary: ")


@row("8", "the first start of an installed package: a simulated composite bench")
def first_start(stage: Stage) -> str:
    power = stage.hear("/first/front_1/power", "sensor_msgs/msg/BatteryState")
    bench = stage.launch("composite_bench", namespace="first")
    bench.says("[simulator-1]: process started")
    node = next(p for p in bench.children(recursive=True) if name_of(p) == "simulator")
    used = []
    bench.says("[simulator-1] starting")
    for _ in range(2):  # its first word, its first reading
        # Seconds of the processor: those of the wall are the machine's.
        used.append(sum(node.cpu_times()[:2]))
        until(lambda: power, "no reading")
    need(used[0] <= 1.0, f"first word after {used[0]:.2f} s of CPU")
    need(used[1] <= 10.0, f"first reading after {used[1]:.2f} s of CPU")
    return f"the simulator's first word and reading after {used[0]:.2f} and {used[1]:.2f} s of CPU"


@row("-", "every launch file in every mode comes up and ends with Ctrl-C")
def every_mode(stage: Stage) -> str:
    modes = [
        ("wire_bench", "simulated", "false", "simulating"),
        ("composite_bench", "simulated", "true", "simulating"),
        ("wire_bench", "hardware", "false", "not connected"),
    ]
    for file, mode, camera, said in modes:
        bench = stage.launch(file, namespace=f"{file}_{mode}", mode=mode, camera=camera)
        for text in (said, "identification", "experiment]: idle"):
            bench.says(text)
        bench.ctrl_c()
        bench.ends_cleanly()
    return ", ".join(f"{file} {mode}" for file, mode, *_ in modes)


@row("1", "camera:=true, which gives a node a list; a user's own launch file that gives one")
def lists(stage: Stage) -> str:
    heard = stage.hear("/lists/wire/temperature", "sensor_msgs/msg/Temperature")
    stage.launch(namespace="lists", camera="true")
    until(lambda: len(heard) > 20, "no temperatures of the camera")
    need(heard[-1].variance > 0.0, "the temperatures are not the camera's")
    file = stage.folder / "own.launch.py"
    file.write_text(OWN_LAUNCH_FILE)
    stage.start("ros2", "launch", str(file)).says("idle")
    said = stage.run("ros2", "param", "get", "/own/experiment", "feedback").strip()
    need("['power']" in said, said)
    return f"temperatures of the camera, with their variance; ros2 param get: {said}"


def killed(number: int, namespace: str, stage: Stage) -> str:
    """How long the nodes of a launch that is gone went on, and to which volts."""
    bench, commands = stage.driven(namespace)
    names = {node: name_of(node) for node in bench.children(recursive=True)}
    bench.send_signal(number)
    ended: dict[psutil.Process, float] = {}
    since = time.monotonic()
    while len(ended) < len(names):
        going, passed = alive(list(names)), time.monotonic() - since
        ended |= dict.fromkeys(names.keys() - going - ended.keys(), passed)
        need(passed < 20.0, f"left over: {sorted(names[node] for node in going)}")
        time.sleep(0.01)
    times = ", ".join(f"{names[node]} {after:.2f} s" for node, after in ended.items())
    time.sleep(0.3)
    need(commands[-1].data[0] == 0.0, f"the last command is {commands[-1].data[0]} V")
    need(max(ended.values()) <= LEFT, f"gone later than {LEFT} s: {times}")
    return f"last command 0 V; gone: {times}"


for sent, space in ((signal.SIGTERM, "terminated"), (signal.SIGKILL, "killed")):
    row("2", f"{sent.name} to launch alone, while 3 V are commanded")(partial(killed, sent, space))


@row("3", "two benches at once: in real time, and above it")
def two_benches(stage: Stage) -> str:
    states, markers = [], []
    for name in ("left", "right"):
        kind, topic = "std_msgs/msg/String", f"/{name}/experiment"
        markers.append(stage.hear(f"{topic}/marker", kind))
        states.append(stage.hear(f"{topic}/state", kind, latched=True))
        stage.launch(namespace=name, protocol="quick_ramp", autostart="true")
    until(lambda: all(s and s[-1].data.startswith("running") for s in states), "not both run")
    until(lambda: all(len(heard) > 1 for heard in markers), "no second step")
    stage.clear()
    first = stage.launch(namespace="fast", protocol="quick_ramp", speed="5.0")
    first.says("simulating")
    second = stage.launch(namespace="faster", protocol="quick_ramp", speed="5.0")
    second.ends()
    line = next((x for x in second.output.splitlines() if "/clock is there" in x), "")
    need(line, second.output[-300:])
    need(first.poll() is None, "the first bench has ended")
    return f"both run in real time; above it: {line.partition('] ')[2]}"


@row("5", "autostart with a recorder: the record begins before the run")
def recorded_from_the_start(stage: Stage) -> str:
    bag = stage.folder / "whole"
    states = stage.hear("/whole/experiment/state", "std_msgs/msg/String", latched=True)
    run = {"protocol": "quick_ramp", "autostart": "true", "speed": "20.0"}
    bench = stage.launch(namespace="whole", record="true", output=bag, **run)
    until(lambda: states and states[-1].data.startswith("done"), "not done")
    bench.ctrl_c()
    bench.ends_cleanly()
    said = stage.run(sys.executable, "-c", IN_THE_RECORD, str(bag)).strip().splitlines()[-1]
    need(said.endswith(" 0.0") and "/done" in said, said)
    return f"steps, first, last, first volts in the record: {said}"


@row("7", "Ctrl-C twice, 50 ms apart, to launch and all nodes; and while nodes import, 8 moments")
def impatient(stage: Stage) -> str:
    bench, commands = stage.driven("impatient")
    bench.ctrl_c()
    time.sleep(0.05)
    bench.ctrl_c()
    said = bench.ends_cleanly()
    need(commands[-1].data[0] == 0.0, "not 0 V at the end")
    for k in range(8):  # from the interpreter's own start to the node's first line
        bench = stage.launch(namespace=f"early_{k}")
        bench.says("process started")
        time.sleep(0.15 * k)
        bench.ctrl_c()
        bench.ends()
    return f"{said}, the interpreter's own start included"


@row("9", "nodes:=none, and parameters that cannot change")
def fixed_parameters(stage: Stage) -> str:
    bench = stage.launch(namespace="fixed", nodes="none")
    bench.says("experiment]: idle")
    need("identification" not in bench.output, "identification was started")
    set_one = partial(stage.run, "ros2", "param", "set", status=None)
    refused = set_one("/fixed/experiment", "use_sim_time", "true")
    need("failed" in refused.lower(), refused)
    node = stage.start("ros2", "run", "sma_bench", "diagnosis", "--ros-args", "-r", "__ns:=/fixed")
    node.says("starting diagnosis")
    until(lambda: "/fixed/diagnosis" in stage.run("ros2", "node", "list"), "no diagnosis")
    outside = set_one("/fixed/diagnosis", "improved", "/etc/x.yaml")
    need("failed" in outside.lower() and "/etc/x.yaml" in outside, outside)
    return f"no identification; {refused.strip()}; {outside.strip()}"


@row("10", "diagnostics of every node; recorder start, split, stop; a cancelled identification")
def services(stage: Stage) -> str:
    heard = stage.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    bag, added = stage.folder / "served", {"twin": "true", "camera": "true", "record": "true"}
    added["nodes"] = "identification,diagnosis"
    stage.launch("composite_bench", namespace="served", output=bag, **added)
    wanted = {"simulator", "experiment", "recorder", "twin", "ir_camera", "synthetic_camera"}
    wanted |= {"identification", "diagnosis"}

    def seen() -> set[str]:
        names = [status.name for message in list(heard) for status in message.status]
        return {n.split(":")[0].split("/")[-1] for n in names if n.startswith("/served/")}

    until(lambda: wanted <= seen(), "no diagnostics of some node")
    until(lambda: (bag / "metadata.yaml").exists() or any(bag.glob("*.mcap")), "no bag")
    for service in ("split", "stop", "start"):
        success, said = stage.call(f"/served/recorder/{service}")
        need(success, f"{service}: {said}")
    bags = sorted(p.name for p in stage.folder.glob("served*") if p.is_dir())
    need(len(bags) == 3, f"bags: {bags}")
    success, said = stage.call("/served/identification/cancel")
    need(not success and "nothing is running" in said, said)
    return f"{', '.join(sorted(wanted))}; bags {', '.join(bags)}; cancel: {said}"


@row("12", "a QoS override by parameter")
def qos(stage: Stage) -> str:
    override = "qos_overrides./qos/wire/power.publisher.reliability:=best_effort"
    given = ["--ros-args", "-r", "__ns:=/qos", "-p", override, "--params-file"]
    rig = str(ROOT / "config" / "wire_rig.yaml")
    stage.start("ros2", "run", "sma_bench", "simulator", *given, rig).says("simulating")
    said = stage.run("ros2", "topic", "info", "-v", "/qos/wire/power")
    need("BEST_EFFORT" in said, said)
    return "ros2 topic info -v: BEST_EFFORT"


# --- the table ----------------------------------------------------------------------------------


def main(words: list[str]) -> int:
    missing = [tool for tool in ("ros2", "colcon", "git") if shutil.which(tool) is None]
    missing += [m for m in ("launch_ros", "rclpy") if importlib.util.find_spec(m) is None]
    if missing:
        print(f"skipped: {', '.join(missing)} not found: source a ROS 2 Jazzy setup file")
        return 0
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    stage, verdicts = Stage(Path(tempfile.mkdtemp(prefix="ros2_tools_"))), []
    print("| item | done | outcome | s |\n| --- | --- | --- | --- |", flush=True)
    chosen = [r for r in ROWS if not words or any(w in r[1] or w == r[0] for w in words)]
    for item, what, act in [("4", "colcon build", Stage.build), *chosen]:
        started = time.monotonic()
        try:
            verdict, outcome = "ok", act(stage)
            stage.clear()
        except (Failed, subprocess.SubprocessError, StopIteration) as error:
            verdict, outcome = "FAILED", f"{str(error) or type(error).__name__}; {stage.clear()}"
        verdicts.append(verdict)
        outcome = f"{verdict}: {' '.join(outcome.split())}".replace("|", "/")
        print(f"| {item} | {what} | {outcome} | {time.monotonic() - started:.0f} |", flush=True)
        if act is Stage.build and verdict != "ok":
            break
    failed = verdicts.count("FAILED")
    print(f"{len(verdicts) - failed} ok, {failed} FAILED")
    subprocess.run(["ros2", "daemon", "stop"], stdout=subprocess.DEVNULL, check=False)
    if failed:
        print(f"logs: {stage.folder}")
        return 1
    shutil.rmtree(stage.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
