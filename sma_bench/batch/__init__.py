"""Many records, each by itself: over the cores of this machine, or over a cluster."""

from sma_bench.batch.task import Outcome, Task
from sma_bench.batch.workers import on_cluster, on_processes

__all__ = ["Outcome", "Task", "on_cluster", "on_processes"]
