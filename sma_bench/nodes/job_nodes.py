"""Nodes that identify, diagnose and investigate recorded bags on request.

    ros2 param set /bench/identification record "['my_bag']"
    ros2 service call /bench/identification/identify std_srvs/srv/Trigger

The work runs in a process of its own while a thread waits for it, so that the node answers."""

import json
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.srv import SetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import BenchNode
from sma_bench.parameters import Parameters
from sma_bench.ros.node import LATCHED
from sma_bench.tasks import jobs


class WorkNode(BenchNode):
    """Publishes, latched, `~/state` (a line) and `~/result` (the last one, as JSON)."""

    with_uncertainty = True
    outputs: ClassVar[dict[str, str]]  # parameters that name outputs, and the suffix of these

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.check_settings(self.settings)
        self._worker, self._state, self._failure = jobs.Worker(name), "", ""
        self._publish_state, self._publish_result = self.line("~/state"), self.line("~/result")

    def check_settings(self, settings: dict[str, Any]) -> None:
        for name, suffix in self.outputs.items():
            jobs.output_inside(settings, name, suffix)

    def health(self) -> list[DiagnosticStatus]:
        level = DiagnosticStatus.WARN if self._failure else DiagnosticStatus.OK
        return [self.status("work", level, self._failure or self._state)]

    def close(self) -> None:
        self._worker.end("ended with its node")

    def _enter(self, state: str, failure: str = "") -> None:
        if failure:
            self.get_logger().error(failure)
        self._state, self._failure = state, failure
        self._publish_state(state)


class JobNode(WorkNode):
    """Offers a service (std_srvs/Trigger) whose answer is a result as JSON, or one line with the
    reason of a failure. States: "idle", "busy", "busy: 42 %, pairs". `~/cancel` ends the work."""

    # Threads: one request at work, one that is refused, and the node's other callbacks.
    executor_type = staticmethod(lambda: MultiThreadedExecutor(4))

    def __init__(self, name: str, service: str, task: jobs.Task) -> None:
        super().__init__(name)
        self._task, self._busy = task, threading.Lock()
        self.serve(ReentrantCallbackGroup(), **{service: self.on_request})
        self.serve(cancel=lambda: (
            (True, jobs.CANCELLED) if self._worker.end() else (False, "nothing is running")))
        self._enter("idle")

    def on_result(self, result: str) -> None:
        """Use a result further; for nodes to override."""

    def on_request(self) -> str:
        if not self._busy.acquire(blocking=False):
            raise InputError(f"busy: another {self.get_name()} is running")
        failure = ""
        self._enter("busy")
        try:
            # Parameters set from here on apply to the next request.
            result = self._worker.run(
                self._task, self.settings, self.parameters,
                lambda share, what: self._enter(f"busy: {100.0 * share:.0f} %, {what}"))
            self._publish_result(result)
            self.on_result(result)
            return result
        except InputError as error:
            failure = " ".join(str(error).split())
            raise
        finally:
            self._enter("idle", failure)
            self._busy.release()


class IdentificationNode(JobNode):
    """Identifies parameters from records on request: set `record`, call `~/identify`."""

    outputs: ClassVar = {"output_directory": ""}

    def __init__(self) -> None:
        super().__init__("identification", "identify", jobs.identify)


class DiagnosisNode(JobNode):
    """Diagnoses the gap between bench and model on request: set `record`, call `~/diagnose`.
    `~/gap`, latched: WARN where they disagree beyond the noise, overall and per quantity."""

    outputs: ClassVar = {"improved": ".yaml", "report": ""}

    def __init__(self) -> None:
        super().__init__("diagnosis", "diagnose", jobs.diagnose)
        self._gap = self.create_publisher(DiagnosticArray, "~/gap", LATCHED)

    def on_result(self, result: str) -> None:
        message = DiagnosticArray()
        message.header.stamp = self.stamp()
        for gap in json.loads(result)["gap"]:
            level = DiagnosticStatus.WARN if gap["is_gap"] else DiagnosticStatus.OK
            values = [KeyValue(key=key, value=value) for key, value in gap["values"].items()]
            message.status.append(DiagnosticStatus(level=level, name=f"diagnosis: {gap['name']}",
                                                   message=gap["message"], values=values))
        self._gap.publish(message)
        self.get_logger().info(message.status[0].message)


_WAITING, _RUNNING = "waiting for confirmation", "running"
_LOOK_EVERY, _END_TIMEOUT = 0.05, 10.0  # s; the latter for a run to end when the node ends


class InvestigationNode(WorkNode):
    """Investigates the gap between bench and model, as `sma-bench investigate` does: set `folder`
    (and `record`), call `~/start`, which continues from the folder's contents; `~/confirm` runs the
    proposed experiment, `~/stop` ends all, at 0 V. States: idle, diagnosing, waiting for
    confirmation: PROTOCOL, running: PROTOCOL, named: CAUSE, inseparable, budget spent, a test is
    needed, stopped, failed: why. The result is the report so far; its `next` is the proposal."""

    outputs: ClassVar = {"folder": ""}

    def __init__(self) -> None:
        from sma_bench.ros.bench_client import NodeCalls  # not needed by the other two nodes

        super().__init__("investigation")
        self._stopping, self._confirmed = threading.Event(), threading.Event()
        self._work: threading.Thread | None = None
        self._calls = NodeCalls(self, lambda: time.sleep(_LOOK_EVERY))
        self._calls.client("experiment/start")
        self._calls.client("experiment/stop")
        self._calls.client("experiment/set_parameters", SetParameters)
        self._calls.follow("experiment")
        self._calls.follow("recorder")
        self.serve(start=self.on_start, confirm=self.on_confirm, stop=self.on_stop)
        self._enter("idle")

    def drain(self, spin: Callable[[], None]) -> None:
        """Stop the bench while the experiment node's answer can still be received."""
        self.on_stop()
        end = time.monotonic() + _END_TIMEOUT
        while self._is_busy() and time.monotonic() < end:
            spin()

    def close(self) -> None:
        self._stopping.set()
        super().close()

    def on_start(self) -> str:
        if self._is_busy():
            raise InputError(f"busy: {self._state}")
        folder = jobs.investigation_folder(self.settings)
        self._stopping.clear()
        given = self.settings, self.parameters  # parameters set later apply to the next start
        self._work = threading.Thread(target=self._investigate, args=given, daemon=True)
        self._work.start()
        return f"in {folder}"

    def on_confirm(self) -> str:
        if not self._state.startswith(_WAITING) or self._stopping.is_set():
            raise InputError(f"nothing to confirm: {self._state}")
        self._confirmed.set()
        return self._state

    def on_stop(self) -> str:
        answer = f"stopping, was {self._state}" if self._is_busy() else "nothing is running"
        self._stopping.set()
        if self._state.startswith(_RUNNING):  # at once; the thread then waits for the answer
            self._calls.client("experiment/stop").call_async(Trigger.Request())
        self._worker.end()
        return answer

    def _is_busy(self) -> bool:
        return self._work is not None and self._work.is_alive()

    def _investigate(self, settings: Mapping[str, Any], parameters: Parameters) -> None:
        def check_stop(_: str = "") -> None:
            if self._stopping.is_set():
                raise InputError("stopped on request")

        def report(share: float, what: str) -> None:
            if self._stopping.is_set():  # the request came before the process had started
                self._worker.end()
            self._enter(f"diagnosing: {100.0 * share:.0f} %, {what}")

        try:
            while True:
                self._enter("diagnosing")
                check_stop()
                result = self._worker.run(jobs.investigate, settings, parameters, report)
                self._publish_result(result)
                story = json.loads(result)
                if (following := story["next"]) is None:
                    self._enter(str(story["outcome"]))
                    return
                self._confirmed.clear()
                if self.settings["confirm"]:
                    self._enter(f"{_WAITING}: {following['protocol']}")
                    while not self._confirmed.wait(_LOOK_EVERY):
                        check_stop()
                self._enter(f"{_RUNNING}: {following['protocol']}")
                self._calls.run_recorded(
                    following["file"], following["protocol"], 60.0 * following["minutes"],
                    following["bag"], check_stop, self.simulated)
        except InputError as error:
            if self._stopping.is_set():
                self._enter("stopped")
            else:
                self._enter(f"failed: {error}", str(error))
