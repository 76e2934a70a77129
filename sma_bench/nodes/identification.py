"""Identifies parameters from records on request: set `record`, call `~/identify`."""

from collections.abc import Sequence
from typing import Any

from sma_bench.nodes.base import run_node
from sma_bench.nodes.job_node import JobNode, job_executor
from sma_bench.tasks.jobs import IdentificationJob, output_inside


class Identification(JobNode):
    """`~/identify`: the message is the contract's JSON, or why there is none."""

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


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("identification", Identification, argv, job_executor)


if __name__ == "__main__":
    raise SystemExit(main())
