"""Nodes whose one service does a long piece of work, in a process of its own.

The request waits for it in one of the executor's threads, so that parameters, a second request
("busy") and the end of the node are served meanwhile.
"""

import json
import threading
from abc import ABC, abstractmethod
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import BenchNode
from sma_bench.results import GapState, gap_states
from sma_bench.ros.node import LATCHED
from sma_bench.tasks.jobs import (
    CANCELLED,
    DiagnosisJob,
    IdentificationJob,
    Job,
    JobProcess,
    busy,
    output_inside,
)

# One request at work, one that is refused, and the node's other callbacks.
_THREADS = 4


def _executor() -> MultiThreadedExecutor:
    """With a thread to spare for every callback of a JobNode."""
    return MultiThreadedExecutor(_THREADS)


class JobNode(BenchNode, ABC):
    """Answers a service (std_srvs/Trigger) whose message is a result as JSON, or why there is none.

    Latched: `~/state` ("idle", "busy", "busy: 42 %, pairs") and `~/result` (the last JSON).
    `~/cancel` ends the work, whose request is then answered so.
    """

    with_uncertainty = True
    executor_type = _executor

    def __init__(self, name: str, service: str) -> None:
        super().__init__(name)
        self.check_settings(self.settings)
        self._busy = threading.Lock()
        self._process = JobProcess(name)
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self._result = self.create_publisher(String, "~/result", LATCHED)
        self.create_service(
            Trigger, service, self._on_request, callback_group=ReentrantCallbackGroup()
        )
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._requests, self._failure = 0, ""
        self._tell_state("idle")

    @abstractmethod
    def job(self) -> Job:
        """What is asked for, from the parameters of this moment; InputError where it cannot be."""

    def on_result(self, job: Any, result: str) -> None:
        """What else to do with the result of a job."""

    def health(self) -> list[DiagnosticStatus]:
        """What the node is at, and why the last request failed."""
        failed = bool(self._failure) and not self._busy.locked()
        return [self.status(
            "work", DiagnosticStatus.WARN if failed else DiagnosticStatus.OK,
            self._failure if failed else self._state_text, {"requests": self._requests},
        )]  # fmt: skip

    def close(self) -> None:
        """Nobody waits for the work any more."""
        self._process.kill()

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._busy.acquire(blocking=False):
            response.success = False
            response.message = f"busy: another {self.get_name()} is running"
            return response
        try:
            self._answer(response)
        finally:
            self._tell_state("idle")
            self._busy.release()
        return response

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._process.cancel()
        response.message = CANCELLED if response.success else "nothing is running"
        return response

    def _tell(self, share: float, what: str) -> None:
        self._tell_state(busy(share, what))

    def _tell_state(self, state: str) -> None:
        self._state_text = state
        self._state.publish(String(data=state))

    def _answer(self, response: Trigger.Response) -> None:
        self._tell_state("busy")
        self._requests += 1
        self._failure = ""
        try:
            # What is set from here on is for the next request.
            job = self.job()
            response.message = self._process.run(job, self._tell)
            response.success = True
        except InputError as error:
            response.success = False
            response.message = self._failure = str(error)
            self.get_logger().error(response.message)
            return
        self._result.publish(String(data=response.message))
        self.on_result(job, response.message)


class IdentificationNode(JobNode):
    """Identifies parameters from records on request: set `record`, call `~/identify`. The message
    is the contract's JSON, or why there is none."""

    def __init__(self) -> None:
        super().__init__("identification", "~/identify")

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Nothing may be written outside output_root."""
        where = "output_directory"
        output_inside(settings["output_root"], settings[where], where)

    def job(self) -> IdentificationJob:
        """The node's parameters, as they are now."""
        return IdentificationJob.from_settings(self.settings, self.parameters)

    def on_result(self, job: IdentificationJob, _: str) -> None:
        """Say what it is from."""
        self.get_logger().info(f"identified from {', '.join(job.records)}")


class DiagnosisNode(JobNode):
    """Diagnoses the gap between bench and model on request: set `record`, call `~/diagnose`. The
    message is the contract's JSON, or why there is none.

    `~/gap`, latched: level WARN where simulation and bench disagree beyond the noise, of the
    whole and of each measured quantity.
    """

    def __init__(self) -> None:
        super().__init__("diagnosis", "~/diagnose")
        self._gap = self.create_publisher(DiagnosticArray, "~/gap", LATCHED)

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Nothing may be written outside output_root."""
        for name, suffix in (("improved", ".yaml"), ("report", "")):
            output_inside(settings["output_root"], settings[name], name, suffix)

    def job(self) -> DiagnosisJob:
        """The node's parameters, as they are now."""
        return DiagnosisJob.from_settings(self.settings, self.parameters)

    def on_result(self, job: DiagnosisJob, result: str) -> None:
        """Publish the gap."""
        states = gap_states(json.loads(result))
        message = DiagnosticArray(status=[self._status(state) for state in states])
        message.header.stamp = self.get_clock().now().to_msg()
        self._gap.publish(message)
        self.get_logger().info(f"{states[0].message}, from {', '.join(job.records)}")

    def _status(self, state: GapState) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if state.is_gap else DiagnosticStatus.OK,
            name=f"{self.get_name()}: {state.name}",
            message=state.message,
            values=[KeyValue(key=key, value=value) for key, value in state.values.items()],
        )
