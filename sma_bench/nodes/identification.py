"""Identifies parameters from records on request: set `record`, call `~/identify`.

The fit runs in a process of its own; the request waits for it in one of the executor's threads,
so that parameters, a second request ("busy") and the end of the node are served meanwhile.
"""

import threading
from collections.abc import Sequence

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import LATCHED, BenchNode, run_node
from sma_bench.nodes.identification_job import Job, JobProcess

# One request at work, one that is refused, and the node's other callbacks.
_THREADS = 4


class Identification(BenchNode):
    """`~/identify` (std_srvs/Trigger): the message is the contract's JSON, or why there is none."""

    with_uncertainty = True

    def __init__(self) -> None:
        super().__init__("identification")
        self._busy = threading.Lock()
        self._process = JobProcess()
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self._result = self.create_publisher(String, "~/result", LATCHED)
        self.create_service(
            Trigger, "~/identify", self._on_identify, callback_group=ReentrantCallbackGroup()
        )
        self._state.publish(String(data="idle"))

    def close(self) -> None:
        """Nobody waits for the fit any more."""
        self._process.kill()

    def _on_identify(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._busy.acquire(blocking=False):
            response.success = False
            response.message = "busy: another identification is running"
            return response
        try:
            self._identify(response)
        finally:
            self._state.publish(String(data="idle"))
            self._busy.release()
        return response

    def _identify(self, response: Trigger.Response) -> None:
        self._state.publish(String(data="busy"))
        try:
            # What is set from here on is for the next request.
            job = Job.from_settings(self.settings, self.parameters)
            response.message = self._process.run(job)
            response.success = True
        except InputError as error:
            response.success = False
            response.message = str(error)
            self.get_logger().error(response.message)
            return
        self._result.publish(String(data=response.message))
        self.get_logger().info(f"identified from {', '.join(job.records)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node(
        "identification", Identification, argv, lambda: MultiThreadedExecutor(_THREADS)
    )


if __name__ == "__main__":
    raise SystemExit(main())
