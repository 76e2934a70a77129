"""Nodes that identify and diagnose recorded bags on request.

    ros2 param set /bench/identification record "['my_bag']"
    ros2 service call /bench/identification/identify std_srvs/srv/Trigger

The work runs in a process of its own and the request waits in one of the executor's threads, so
that parameters, a second request ("busy"), `~/cancel` and the end of the node are served meanwhile.
"""

import json
import threading
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import BenchNode
from sma_bench.ros.node import LATCHED
from sma_bench.tasks.jobs import CANCELLED, Task, Worker, busy, diagnose, identify, output_inside


class JobNode(BenchNode):
    """Answers a service (std_srvs/Trigger) whose message is a result as JSON, or one line that says
    why there is none.

    Latched: `~/state` ("idle", "busy", "busy: 42 %, pairs") and `~/result` (the last JSON).
    `~/cancel` ends the work, whose request is then answered so.
    """

    with_uncertainty = True
    # One request at work, one that is refused, and the node's other callbacks.
    executor_type = staticmethod(lambda: MultiThreadedExecutor(4))
    outputs: ClassVar[dict[str, str]]
    """parameters that name what is written, and the end that such a name must have"""

    def __init__(self, name: str, service: str, task: Task) -> None:
        super().__init__(name)
        self._task = task
        self.check_settings(self.settings)
        self._busy = threading.Lock()
        self._worker = Worker(name)
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self._result = self.create_publisher(String, "~/result", LATCHED)
        waiting = ReentrantCallbackGroup()
        self.create_service(Trigger, service, self._on_request, callback_group=waiting)
        self.serve(cancel=self._cancel)
        self._requests, self._failure = 0, ""
        self._tell_state("idle")

    def check_settings(self, settings: dict[str, Any]) -> None:
        for name, suffix in self.outputs.items():
            output_inside(settings, name, suffix)

    def on_result(self, result: str) -> None:
        """What else to do with a result."""

    def health(self) -> list[DiagnosticStatus]:
        level = DiagnosticStatus.WARN if self._failure else DiagnosticStatus.OK
        message = self._failure or self._state_text
        return [self.status("work", level, message, {"requests": self._requests})]

    def close(self) -> None:
        self._worker.kill()

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._busy.acquire(blocking=False):
            response.success = False
            response.message = f"busy: another {self.get_name()} is running"
            return response
        self._requests, self._failure = self._requests + 1, ""
        self._tell_state("busy")
        try:
            # What is set from here on is for the next request.
            response.message = self._worker.run(
                self._task, self.settings, self.parameters,
                lambda share, what: self._tell_state(busy(share, what)),
            )
            response.success = True
            self._result.publish(String(data=response.message))
            self.on_result(response.message)
        except InputError as error:
            response.success, response.message = False, str(error)
            self._failure = response.message
            self.get_logger().error(response.message)
        finally:
            self._tell_state("idle")
            self._busy.release()
        return response

    def _cancel(self) -> tuple[bool, str]:
        return (True, CANCELLED) if self._worker.cancel() else (False, "nothing is running")

    def _tell_state(self, state: str) -> None:
        self._state_text = state
        self._state.publish(String(data=state))


class IdentificationNode(JobNode):
    """Identifies parameters from records on request: set `record`, call `~/identify`."""

    outputs: ClassVar = {"output_directory": ""}

    def __init__(self) -> None:
        super().__init__("identification", "~/identify", identify)


class DiagnosisNode(JobNode):
    """Diagnoses the gap between bench and model on request: set `record`, call `~/diagnose`.

    `~/gap`, latched: level WARN where simulation and bench disagree beyond the noise, of the
    whole and of each measured quantity.
    """

    outputs: ClassVar = {"improved": ".yaml", "report": ""}

    def __init__(self) -> None:
        super().__init__("diagnosis", "~/diagnose", diagnose)
        self._gap = self.create_publisher(DiagnosticArray, "~/gap", LATCHED)

    def on_result(self, result: str) -> None:
        message = DiagnosticArray()
        message.header.stamp = self.stamp()
        for gap in json.loads(result)["gap"]:
            level = DiagnosticStatus.WARN if gap["is_gap"] else DiagnosticStatus.OK
            values = [KeyValue(key=key, value=value) for key, value in gap["values"].items()]
            message.status.append(DiagnosticStatus(
                level=level, name=f"diagnosis: {gap['name']}", message=gap["message"],
                values=values,
            ))  # fmt: skip
        self._gap.publish(message)
        self.get_logger().info(message.status[0].message)
