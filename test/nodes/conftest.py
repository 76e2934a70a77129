"""Nodes as processes, and a node of the test that communicates with them."""

import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import json_schema
import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from forked_nodes import ForkedNode  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.parameter import Parameter as RosParameter  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import BatteryState, JointState, Range, Temperature  # noqa: E402
from std_msgs.msg import Float64, Float64MultiArray, String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from sma_bench.ros.node import LATCHED, OneThreadExecutor, stamp_of  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
NAMESPACE = "/bench"
PATIENCE = 30.0
SETTLING = 0.3
KINDS = {"power": (BatteryState,), "temperature": (Temperature,),
         "true_temperature": (Temperature,), "joint_states": (JointState,), "range": (Range,),
         "marker": (String,), "clock": (Clock, 1), "voltage_command": (Float64MultiArray,),
         "setpoint": (Float64MultiArray,), "diagnostics": (DiagnosticArray,),
         "gap": (DiagnosticArray, LATCHED), "thermal": (Float64,), "state": (String, LATCHED),
         "result": (String, LATCHED), "progress": (String, LATCHED)}  # fmt: skip


class RunningNode:
    """A process, its output in a file."""

    def __init__(self, process, log):
        self.process, self.log = process, log

    def end(self, number=signal.SIGINT):
        """Send a signal and return the exit status."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE)

    def ended_with(self, status, said):
        """It ends by itself, with one line about the reason."""
        ended = self.process.wait(PATIENCE)
        return ended == status and said in self.output and "Traceback" not in self.output

    @property
    def output(self):
        return self.log.read_text()


class TestBench:
    """The test's node, and the processes that it started."""

    __test__ = False

    def __init__(self, folder):
        rclpy.init(args=[])
        self.node = rclpy.create_node("test", namespace=NAMESPACE)
        self._executor = OneThreadExecutor()
        self._executor.add_node(self.node)
        self._folder, self._processes, self._clients = folder, [], {}
        self.diagnostics = self.hear("/diagnostics")

    def start(self, name, *files, options=None, remap=None, **parameters):
        """Start a node; `__` in a parameter name means a dot."""
        arguments = ["--ros-args", "-r", f"__ns:={NAMESPACE}"]
        for old, new in (remap or {}).items():
            arguments += ["-r", f"{old}:={new}"]
        for file in files:
            arguments += ["--params-file", str(file)]
        for key, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ["-p", f"{key.replace('__', '.')}:={text}"]
        return self.start_with(name, arguments, **(options or {}))

    def start_with(self, name, arguments, **options):
        """Start a node with this command line."""
        if options:
            return self.run(name, ["-m", "sma_bench.nodes.start", name, *arguments], **options)
        log = self._log(name)
        return self._running(ForkedNode(name, arguments, log), log)

    def run(self, name, command, **options):
        """Start another Python program."""
        log, words = self._log(name), [sys.executable, *command]
        with log.open("wb") as out:
            process = subprocess.Popen(
                words, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, **options
            )
        return self._running(process, log)

    def _log(self, name):
        log = self._folder / f"{name}_{len(self._processes)}.log"
        log.touch()
        return log

    def _running(self, process, log):
        self._processes.append(RunningNode(process, log))
        return self._processes[-1]

    def until(self, condition, patience=PATIENCE):
        """Spin until the condition holds, and return it."""
        end = time.monotonic() + patience
        while not (value := condition()):
            if time.monotonic() > end:
                logs = "\n".join(f"{p.log.name}: {p.output}" for p in self._processes)
                pytest.fail(f"not within {patience} s; logs:\n{logs}")
            self._executor.spin_once(timeout_sec=0.02)
        return value

    def spend(self, seconds):
        """Spin for a while."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def hear(self, *topics):
        """Messages of topics (types follow from the names); a list, or one for each topic."""
        heard = [[] for _ in topics]
        for topic, messages in zip(topics, heard, strict=True):
            kind, *qos = KINDS[topic.rpartition("/")[2]]
            heard_one = partial(self._take, topic, messages)
            self.node.create_subscription(kind, topic, heard_one, *(qos or [10_000]))
        return heard if len(heard) > 1 else heard[0]

    def _take(self, topic, messages, message):
        if isinstance(message, String):
            json_schema.check(topic, message.data)
        messages.append(message)

    def stamped_after(self, messages, is_shown, cause, wait=None):
        """ns from the first call of `cause` to the stamp of the first message that shows it;
        `cause` is called repeatedly while waiting; `wait` replaces `until`."""
        seen, sent = len(messages), time.time_ns()
        (wait or self.until)(lambda: cause() or any(map(is_shown, messages[seen:])))
        return stamp_of(next(filter(is_shown, messages[seen:]))) - sent

    def status(self, part):
        """Newest status of a part of a node, such as `twin: gap`; None before the first."""
        found = (s for a in reversed(self.diagnostics) for s in a.status)
        return next((s for s in found if s.name == f"{NAMESPACE}/{part}"), None)

    def value(self, key):
        """Newest diagnostic text under a key, "" before the first."""
        values = (v for a in reversed(self.diagnostics) for s in a.status for v in s.values)
        return next((v.value for v in values if v.key == key), "")

    def talk(self, topic, kind):
        """A publisher that has a subscriber."""
        publisher = self.node.create_publisher(kind, topic, 100)
        self.until(publisher.get_subscription_count)
        return publisher

    def trigger(self, service):
        return self._answer(self.trigger_later(service))

    def trigger_later(self, service):
        """Start a call; returns the future of its answer."""
        return self.know(service).call_async(Trigger.Request())

    def refused(self, service, said):
        """True if the call is refused, with `said` in its one line."""
        answer = self.trigger(service)
        return not answer.success and said in answer.message and "\n" not in answer.message

    def set_parameter(self, node, name, value):
        """Result of setting one parameter: successful, reason."""
        return self.set_in_turn(node, name, [value])[0]

    def set_in_turn(self, node, name, values):
        """Results of setting one parameter to several values, in one call."""
        messages = [RosParameter(name, value=value).to_parameter_msg() for value in values]
        client = self.know(f"{node}/set_parameters", SetParameters)
        future = client.call_async(SetParameters.Request(parameters=messages))
        return self._answer(future).results

    def _answer(self, future):
        self.until(future.done)
        return future.result()

    def know(self, service, kind=Trigger):
        """A client that the server has matched, too. A client cannot see that, and an answer to one
        that the server has not matched yet is lost with a warning."""
        if service not in self._clients:
            client = self._clients[service] = self.node.create_client(kind, service)
            self.until(client.service_is_ready)
            self.spend(SETTLING)
        return self._clients[service]

    def close(self):
        for process in self._processes:
            if process.process.poll() is None:
                process.process.kill()
                process.process.wait()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def bench(ros_domain, tmp_path):
    """A bench in a ROS domain of its own."""
    made = TestBench(tmp_path)
    try:
        yield made
    finally:
        made.close()
