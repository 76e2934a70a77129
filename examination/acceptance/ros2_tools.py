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
import json
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 60.0
# What a node of the bench has after the end of its launch: to 0 V, and to be gone.
LEFT = 1.0

ROWS: list[tuple[str, str, Callable[["Stage"], str]]] = []


class Failed(Exception):
    """What went wrong."""


def row(item: str, what: str) -> Callable[[Callable[["Stage"], str]], None]:
    """Add a row: an item of the list that it belongs to, and what is done."""
    return lambda play: ROWS.append((item, what, play))


def need(condition: Any, said: str) -> None:
    if not condition:
        raise Failed(said)


# --- processes -----------------------------------------------------------------------------------


class Program:
    """A program in a session of its own, as in a terminal, and everything that it starts."""

    def __init__(self, command: list[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        with log.open("wb") as stream:
            self.process = subprocess.Popen(
                command, stdout=stream, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                start_new_session=True, cwd=log.parent, env=environment,
            )  # fmt: skip

    @property
    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def says(self, text: str, patience: float = PATIENCE) -> None:
        """Wait for a text."""
        otherwise = f"nothing like {text!r} from {self.log.name}"
        until(lambda: text in self.output, otherwise, patience, self)

    def children(self) -> list[int]:
        """Nodes and whatever else it has started, and they have."""
        pids = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit()]
        parents = {pid: stat(pid)[1:2] for pid in pids}
        found = [self.process.pid]
        for parent in found:
            found += [child for child, of in parents.items() if of == [str(parent)]]
        return alive(found[1:])

    def ends(self, patience: float = PATIENCE) -> int:
        """Exit status."""
        until(lambda: self.process.poll() is not None, f"{self.log.name} goes on", patience, self)
        return self.process.returncode

    def ctrl_c(self) -> None:
        """As the terminal does it: to all of them at once."""
        os.killpg(self.process.pid, signal.SIGINT)

    def clear(self) -> None:
        for pid in [*self.children(), self.process.pid]:
            kill(pid)
        kill(-self.process.pid)
        self.process.wait()


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, number)


def stat(pid: int) -> list[str]:
    """State, parent and so on of a process; empty where it is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def alive(pids: list[int]) -> list[int]:
    return [pid for pid in pids if stat(pid)[:1] not in ([], ["Z"])]


def name_of(pid: int) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    except OSError:
        return "?"
    return next((Path(word).name for word in words if "/lib/sma_bench/" in word), words[0])


def until(
    condition: Callable[[], Any], otherwise: str, patience: float = PATIENCE,
    program: Program | None = None,
) -> Any:
    """Wait for it and return it."""
    end = time.monotonic() + patience
    while not (value := condition()):
        if time.monotonic() > end:
            tail = program.output.strip().splitlines()[-3:] if program else []
            raise Failed(" | ".join([f"{otherwise} within {patience:g} s", *tail]))
        time.sleep(0.01)
    return value


# --- the stage -----------------------------------------------------------------------------------


class Stage:
    """A built workspace, a ROS domain and a folder; what a row starts is gone after it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.source = folder / "ws" / "src" / "sma_bench"
        self.environment = dict(os.environ)
        self._programs: list[Program] = []
        self._ears: Any = None

    def build(self) -> str:
        """In a new workspace: what a commit of everything here would hold."""
        wanted = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        listed = subprocess.run(wanted, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (self.source / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.source / name)
        started = time.monotonic()
        text = self.run("colcon", "build", "--packages-select", "sma_bench")
        need("1 package finished" in text, text[-300:])
        setup = self.folder / "ws" / "install" / "local_setup.bash"
        shown = self.run("bash", "-c", f". {shlex.quote(str(setup))} && env -0")
        self.environment |= dict(line.partition("=")[::2] for line in shown.split("\0") if line)
        return f"built in {time.monotonic() - started:.0f} s"

    def run(self, *command: str, patience: float = 120.0, status: int | None = 0) -> str:
        """Output of a command that ends by itself, with this exit status."""
        done = subprocess.run(
            list(command), cwd=self.folder / "ws", env=self.environment, timeout=patience,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            check=False,
        )  # fmt: skip
        if status is not None:
            need(done.returncode == status, f"{shlex.join(command)}: {done.stdout.strip()[-400:]}")
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
        need(found, f"{service}: {text.strip()[-200:]}")
        return found[1] == "True", found[3]

    def hear(self, topic: str, kind: str, latched: bool = False) -> list[tuple[float, Any]]:
        """Arrivals and messages of a topic, growing; heard by a node of the script's own."""
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
        heard: list[tuple[float, Any]] = []
        self._ears.create_subscription(
            get_message(kind), topic, lambda m: heard.append((time.monotonic(), m)), qos
        )
        return heard

    def clear(self) -> None:
        for program in reversed(self._programs):
            program.clear()
        self._programs = []


# --- what several rows do ------------------------------------------------------------------------


@contextmanager
def driven(stage: Stage, namespace: str) -> Iterator[tuple[Program, Any]]:
    """A launched simulated bench whose experiment heats the wire, and the commands heard."""
    warm = stage.folder / "warm.yaml"
    warm.write_text("name: warm\nsteps:\n- {kind: hold, name: hold, level: 3.0, duration: 600.0}\n")
    commands = stage.hear(f"/{namespace}/voltage_command", "std_msgs/msg/Float64MultiArray")
    bench = stage.launch(namespace=namespace, protocol=warm, autostart="true")
    until(lambda: commands and commands[-1][1].data[0] > 1.0, "no volts commanded", 240.0, bench)
    yield bench, commands


def no_traceback(program: Program) -> None:
    need("Traceback" not in program.output, f"traceback: {program.output.strip()[-300:]}")


def clean_end(program: Program) -> str:
    """All nodes end, each with status 0, and nothing but lines."""
    children = program.children()
    status = program.ends()
    no_traceback(program)
    # asyncio loses the status of a node that has ended when launch sends it a signal just then.
    lost = re.findall(r"child process pid (\d+) exit status already read", program.output)
    died = re.findall(r"died \[pid (\d+), exit code (-?\d+), cmd '(\S+)", program.output)
    died = [(Path(path).name, code) for pid, code, path in died if pid not in lost]
    need(not died, f"died: {died}")
    until(lambda: not alive(children), "processes left over", 10.0)
    return f"status {status}, {len(children)} processes ended cleanly, no traceback"


# --- rows ----------------------------------------------------------------------------------------


@row("4", "colcon build; colcon test with pytest")
def colcon_test(stage: Stage) -> str:
    chosen = ["test/parameters", "test/packaging/test_manifests.py", "-m", "not slow", "-q"]
    stage.run("colcon", "test", "--packages-select", "sma_bench", "--pytest-args", *chosen)
    said = stage.run("colcon", "test-result", "--all")
    found = re.search(r"Summary: (\d+) tests, 0 errors, 0 failures", said)
    need(found and int(found[1]) > 50, said.strip()[-200:])
    return found[0].removeprefix("Summary: ")


@row("8", "the first start of an installed package: a simulated composite bench")
def first_start(stage: Stage) -> str:
    power = stage.hear("/first/front_1/power", "sensor_msgs/msg/BatteryState")
    started = time.monotonic()
    bench = stage.launch("composite_bench", namespace="first")
    bench.says("[simulator-1]: process started", 240.0)
    begun = time.monotonic()
    node = next(p for p in bench.children() if name_of(p) == "simulator")

    def used() -> tuple[float, float]:
        """s of the processor, and on the wall."""
        fields = stat(node)
        ticks = int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK"), time.monotonic() - begun

    bench.says("[simulator-1] starting", 240.0)
    word, spoken = used()
    until(lambda: power, "no reading", 240.0, bench)
    reading, first = used()
    # Seconds of the processor: those of the wall are the machine's.
    need(word <= 1.0, f"first word after {word:.2f} s of CPU")
    need(reading <= 10.0, f"first reading after {reading:.2f} s of CPU")
    return (f"{begun - started:.1f} s of launch; the simulator's first word after {word:.2f} s of "
            f"CPU ({spoken:.1f} s on the wall), first reading {reading:.2f} s ({first:.1f} s)")


@row("-", "every launch file in every mode comes up and ends with Ctrl-C")
def every_mode(stage: Stage) -> str:
    played = []
    for file, mode, camera in [
        ("wire_bench", "simulated", "false"), ("composite_bench", "simulated", "true"),
        ("wire_bench", "hardware", "false"),
    ]:  # fmt: skip
        namespace = f"{file}_{mode}"
        bench = stage.launch(file, namespace=namespace, mode=mode, camera=camera)
        bench.says({"simulated": "simulating", "hardware": "not connected"}[mode], 120.0)
        bench.says("identification")
        bench.says("experiment]: idle")
        bench.ctrl_c()
        clean_end(bench)
        played.append(f"{file} {mode}")
    return ", ".join(played)


@row("1", "camera:=true, which gives a node a list")
def camera(stage: Stage) -> str:
    heard = stage.hear("/lists/wire/temperature", "sensor_msgs/msg/Temperature")
    stage.launch(namespace="lists", camera="true")
    until(lambda: len(heard) > 20, "no temperatures of the camera", 240.0)
    need(heard[-1][1].variance > 0.0, "the temperatures are not the camera's")
    return "temperatures of the camera, with their variance"


@row("1", "a user's own launch file with parameters=[{'feedback': ['power']}]")
def own_launch_file(stage: Stage) -> str:
    file = stage.folder / "own.launch.py"
    file.write_text(
        "from launch import LaunchDescription\nfrom launch_ros.actions import Node\n\n\n"
        "def generate_launch_description():\n    return LaunchDescription([Node(\n"
        "        package='sma_bench', executable='experiment', name='experiment',\n"
        "        namespace='own', output='screen', parameters=[{'feedback': ['power']}])])\n"
    )
    program = stage.start("ros2", "launch", str(file))
    program.says("idle")
    said = stage.run("ros2", "param", "get", "/own/experiment", "feedback").strip()
    need("['power']" in said, said)
    return f"ros2 param get: {said}"


def killed(number: int, namespace: str, stage: Stage) -> str:
    """How long the nodes of a launch that is gone went on, and to which volts."""
    with driven(stage, namespace) as (bench, commands):
        names = {pid: name_of(pid) for pid in bench.children()}
        kill(bench.process.pid, number)
        since = time.monotonic()
        ended: dict[int, float] = {}
        while len(ended) < len(names):
            going = alive(list(names))
            ended |= {pid: time.monotonic() - since for pid in names.keys() - going - ended.keys()}
            left = sorted(names[pid] for pid in going)
            need(time.monotonic() - since < 20.0, f"left over: {left}")
            time.sleep(0.01)
        times = ", ".join(f"{names[pid]} {after:.2f} s" for pid, after in ended.items())
        time.sleep(0.3)
        need(commands[-1][1].data[0] == 0.0, f"the last command is {commands[-1][1].data[0]} V")
        need(max(ended.values()) <= LEFT, f"gone later than {LEFT} s: {times}")
        return f"last command 0 V; gone: {times}"


for number, namespace in ((signal.SIGTERM, "terminated"), (signal.SIGKILL, "killed")):
    row("2", f"{number.name} to launch alone, while 3 V are commanded")(
        partial(killed, number, namespace)
    )


@row("3", "two benches at once: in real time, and above it")
def two_benches(stage: Stage) -> str:
    runs = {}
    for name in ("left", "right"):
        heard = stage.hear(f"/{name}/experiment/marker", "std_msgs/msg/String")
        states = stage.hear(f"/{name}/experiment/state", "std_msgs/msg/String", latched=True)
        stage.launch(namespace=name, protocol="quick_ramp", autostart="true")
        runs[name] = (heard, states)
    until(lambda: all(s and s[-1][1].data.startswith("running") for _, s in runs.values()),
          "not both run", 240.0)
    until(lambda: all(len(heard) > 1 for heard, _ in runs.values()), "no second step", 240.0)
    stage.clear()
    first = stage.launch(namespace="fast", protocol="quick_ramp", speed="5.0")
    first.says("simulating", 240.0)
    second = stage.launch(namespace="faster", protocol="quick_ramp", speed="5.0")
    second.ends()
    line = next((x for x in second.output.splitlines() if "/clock is there" in x), "")
    need(line and not second.children(), second.output[-300:])
    need(first.process.poll() is None, "the first bench has ended")
    return f"both run in real time; above it: {line.partition('] ')[2]}"


@row("5", "autostart with a recorder: the record begins before the run")
def recorded_from_the_start(stage: Stage) -> str:
    bag = stage.folder / "whole"
    states = stage.hear("/whole/experiment/state", "std_msgs/msg/String", latched=True)
    bench = stage.launch(namespace="whole", protocol="quick_ramp", autostart="true", speed="20.0",
                         record="true", output=bag)
    until(lambda: states and states[-1][1].data.startswith("done"), "not done", 240.0, bench)
    bench.ctrl_c()
    clean_end(bench)
    code = (
        "import sys, sma_bench; r = sma_bench.load(sys.argv[1]); v = r['voltage_command'];"
        "print(len(r.markers), r.markers[0][1], r.markers[-1][1], float(v.values[0].max()))"
    )
    said = stage.run(sys.executable, "-c", code, str(bag)).strip().splitlines()[-1]
    need(said.endswith(" 0.0") and "/done" in said, said)
    return f"steps, first, last, first volts in the record: {said}"


@row("7", "Ctrl-C twice, 50 ms apart, to launch and all nodes")
def impatient(stage: Stage) -> str:
    with driven(stage, "impatient") as (bench, commands):
        bench.ctrl_c()
        time.sleep(0.05)
        bench.ctrl_c()
        said = clean_end(bench)
        need(commands[-1][1].data[0] == 0.0, "not 0 V at the end")
        return said


@row("7", "Ctrl-C while the nodes import, 8 moments")
def interrupted_imports(stage: Stage) -> str:
    for k in range(8):  # from the interpreter's own start to the node's first line
        bench = stage.launch(namespace=f"early_{k}")
        bench.says("process started")
        time.sleep(0.15 * k)
        bench.ctrl_c()
        bench.ends()
        no_traceback(bench)
    return "no traceback, the interpreter's own start included"


@row("9", "nodes:=none, and parameters that cannot change")
def fixed_parameters(stage: Stage) -> str:
    bench = stage.launch(namespace="fixed", nodes="none")
    bench.says("experiment]: idle")
    need("identification" not in bench.output, "identification was started")
    refused = stage.run("ros2", "param", "set", "/fixed/experiment", "use_sim_time", "true",
                        status=None)
    need("failed" in refused.lower(), refused)
    node = stage.start("ros2", "run", "sma_bench", "diagnosis", "--ros-args", "-r", "__ns:=/fixed")
    node.says("starting diagnosis")
    until(lambda: "/fixed/diagnosis" in stage.run("ros2", "node", "list"), "no diagnosis")
    outside = stage.run("ros2", "param", "set", "/fixed/diagnosis", "improved", "/etc/x.yaml",
                        status=None)
    need("failed" in outside.lower() and "/etc/x.yaml" in outside, outside)
    return f"no identification; {refused.strip()}; {outside.strip()}"


@row("10", "diagnostics of every node; recorder start, split, stop; a cancelled identification")
def services(stage: Stage) -> str:
    heard = stage.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    bag = stage.folder / "served"
    bench = stage.launch("composite_bench", namespace="served", record="true", output=bag,
                         twin="true", nodes="identification,diagnosis", camera="true")
    wanted = {"simulator", "experiment", "recorder", "identification", "diagnosis", "twin",
              "ir_camera", "synthetic_camera"}

    def seen() -> set[str]:
        return {s.name.split(":")[0].split("/")[-1] for _, m in list(heard) for s in m.status
                if s.name.startswith("/served/")}

    until(lambda: wanted <= seen(), "no diagnostics of some node", 240.0, bench)
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
    node = stage.start(
        "ros2", "run", "sma_bench", "simulator", "--ros-args", "-r", "__ns:=/qos", "-p",
        "qos_overrides./qos/wire/power.publisher.reliability:=best_effort", "--params-file",
        str(stage.source / "config" / "wire_rig.yaml"),
    )
    node.says("simulating", 240.0)
    said = stage.run("ros2", "topic", "info", "-v", "/qos/wire/power")
    need("BEST_EFFORT" in said, said)
    return "ros2 topic info -v: BEST_EFFORT"


# --- the table -----------------------------------------------------------------------------------


def missing() -> str:
    """Why nothing can be played here, or ""."""
    for tool in ("ros2", "colcon", "git"):
        if shutil.which(tool) is None:
            return f"{tool} is not found: source a ROS 2 Jazzy setup file"
    for module in ("launch_ros", "rclpy"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed for {sys.executable}"
    return ""


def main(words: list[str]) -> int:
    if reason := missing():
        print(f"skipped: {reason}")
        return 0
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    folder = Path(tempfile.mkdtemp(prefix="ros2_tools_"))
    stage = Stage(folder)
    verdicts = []
    print("| item | done | outcome | s |\n| --- | --- | --- | --- |", flush=True)
    for item, what, act in [("4", "colcon build", Stage.build), *ROWS]:
        if act is not Stage.build and words and not any(w in what or w == item for w in words):
            continue
        started = time.monotonic()
        try:
            verdict, outcome = "ok", act(stage)
        except (Failed, subprocess.SubprocessError, StopIteration) as error:
            verdict, outcome = "FAILED", str(error) or type(error).__name__
        finally:
            stage.clear()
        verdicts.append(verdict)
        outcome = f"{verdict}: {' '.join(outcome.split())}".replace("|", "/")
        print(f"| {item} | {what} | {outcome} | {time.monotonic() - started:.0f} |", flush=True)
        if act is Stage.build and verdict != "ok":
            break
    counts = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
    print(json.dumps(counts))
    subprocess.run(["ros2", "daemon", "stop"], stdout=subprocess.DEVNULL, check=False)
    if "FAILED" in counts:
        print(f"logs: {folder}")
        return 1
    shutil.rmtree(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
