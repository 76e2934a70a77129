"""A process that is killed outright leaves none of those behind that it has started."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sma_bench.lifeline import tied_to_this_process

PATIENCE = 20.0  # s, on a busy machine
TIED = "import time; from sma_bench.lifeline import end_with_parent; end_with_parent({}); "
TIED += "print('here', flush=True); time.sleep(600)"
STARTS_A_NODE = """
import sys, time
from pathlib import Path
from sma_bench.ros.processes import NodeProcesses, private_ros_environment
private_ros_environment()
nodes = NodeProcesses("/killed", Path(sys.argv[1]).parent)
nodes.start("recorder", {"output": sys.argv[1]})
print(nodes.pid("recorder"), flush=True)
time.sleep(600)
"""
STARTS_AS_LAUNCH_DOES = """
import subprocess, sys, time
node = subprocess.Popen(
    [*sys.argv[2:], sys.executable, "-m", "sma_bench.nodes.start", "recorder", "--ros-args",
     "-p", "output:=" + sys.argv[1]],
    stdout=sys.stderr,  # what it says first may come before its number
)
print(node.pid, flush=True)
time.sleep(600)
"""
SAYS_WHEN_IT_IS_READY = """
import signal, sys
before = signal.signal
signal.signal = lambda *given: (before(*given), print("ready", flush=True))[0]
from sma_bench.nodes import start
getattr(start, sys.argv.pop(1))()  # as the executables of an installation
"""
RUNS_A_JOB = """
import sys, threading, time
from sma_bench.parameters import Parameters
from sma_bench.tasks.jobs import Worker, identify
settings = {"record": sys.argv[1:], "record_root": "/", "experiments": ["E9"],
            "output_root": "", "output_directory": ""}
worker = Worker("identification")
given = identify, settings, Parameters.defaults()
threading.Thread(target=worker.run, args=given, daemon=True).start()
while worker.process is None:
    time.sleep(0.01)
print(worker.process.pid, flush=True)
time.sleep(600)
"""


def within(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def started(program, *words):
    """A Python program that starts a process, and the number of that one."""
    command = [sys.executable, "-c", program, *map(str, words)]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    line = parent.stdout.readline()
    assert line, f"status {parent.wait()}"
    return parent, int(line)


def is_gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def ends_with(parent, pid):
    assert not is_gone(pid)
    parent.kill()
    parent.wait()
    try:
        return within(lambda: is_gone(pid))
    finally:
        if not is_gone(pid):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize(("program", "setsid"), [
    (STARTS_A_NODE, []), (STARTS_AS_LAUNCH_DOES, []), (STARTS_AS_LAUNCH_DOES, ["setsid"]),
], ids=["by a command", "as launch does", "setsid"])  # fmt: skip
def test_a_node_ends_with_whoever_started_it_unless_it_lives_by_itself_and_leaves_a_whole_bag(
        tmp_path, ros_domain, program, setsid):
    bag = tmp_path / "bag"
    parent, pid = started(program, bag, *setsid)
    assert within(bag.exists)
    if setsid:
        parent.kill()
        parent.wait()
        time.sleep(1.0)
        assert not is_gone(pid)
        os.kill(pid, signal.SIGHUP)  # as the end of a terminal would
        assert within(lambda: is_gone(pid))
    else:
        assert ends_with(parent, pid)
    assert (bag / "metadata.yaml").is_file()


@pytest.mark.parametrize(("number", "after"), [(signal.SIGINT, 0.25), (signal.SIGTERM, 0.6)])
def test_repeated_signals_end_a_node_silently_at_any_moment(tmp_path, ros_domain, number, after):
    log = tmp_path / "log"
    with log.open("wb") as stream:
        command = [sys.executable, "-c", SAYS_WHEN_IT_IS_READY, "experiment"]
        node = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stream)
    assert node.stdout.readline()
    time.sleep(after)
    while node.poll() is None:
        node.send_signal(number)
        time.sleep(0.01)
    node.communicate()
    assert node.returncode == 0 and "Traceback" not in log.read_text(), log.read_text()


def test_the_job_of_a_node_ends_with_it(measured_data):
    # The fit of all of eqs. (6) to (11) takes a minute.
    tests = sorted((measured_data / "sma_react" / "input" / "cal_sample_1").glob("*MPa.txt"))
    assert ends_with(*started(RUNS_A_JOB, *tests))


@pytest.mark.parametrize(("inherited", "lives"), [("inherited=True", True), ("", False)])
def test_an_environment_passed_on_by_a_program_in_between(inherited, lives):
    """As if started by another process: a shell around the command, or a parent that is gone."""
    environment = tied_to_this_process() | {"SMA_BENCH_STARTED_BY": str(os.getppid())}
    command = [sys.executable, "-c", TIED.format(inherited)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)
    try:
        if lives:
            assert process.stdout.readline() == b"here\n"
            time.sleep(0.5)
            assert process.poll() is None
        else:
            assert process.wait(PATIENCE) == -signal.SIGTERM
    finally:
        process.kill()
        process.communicate()
