"""What a scan of a storage file has found, to compare two ways of scanning."""

from typing import Any

from sma_bench.findings import Finding
from sma_bench.records.harvest import Harvest


def everything_in(harvest: Harvest) -> tuple[dict[Any, Any], list[Finding]]:
    """Counts, times, lengths and bytes of every topic, and what is said to be lost."""
    topics = {}
    for key, topic in harvest.topics.items():
        times, lengths, joined = topic.taken()
        topics[key] = topic.count, times.tolist(), lengths.tolist(), joined
    return topics, harvest.findings
