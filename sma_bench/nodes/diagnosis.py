"""Diagnoses the gap between bench and model on request: set `record`, call `~/diagnose`."""

import json
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from sma_bench.nodes.base import run_node
from sma_bench.nodes.job_node import JobNode, job_executor
from sma_bench.results import GapState, gap_states
from sma_bench.ros.node import LATCHED
from sma_bench.tasks.jobs import DiagnosisJob, output_inside


class DiagnosisNode(JobNode):
    """`~/diagnose`: the message is the contract's JSON, or why there is none.

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


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("diagnosis", DiagnosisNode, argv, job_executor)


if __name__ == "__main__":
    raise SystemExit(main())
