"""What the recorder beside a node says of itself: a run that is not recorded heats for nothing."""

import json
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String

from sma_bench.nodes.base import LATCHED

TOPIC = "recorder/state"
_FAILED = "failed"


def follow_recorder(node: Node, note: Callable[[str], None]) -> None:
    """Call `note` with why the namespace's recorder failed, or with "" when it records."""
    node.create_subscription(
        String, TOPIC, lambda message: note(recorder_failure(message.data)), LATCHED
    )


def recorder_failure(state: str) -> str:
    """Why it failed, from a message of its `~/state`; "" when it did not, or says nothing clear."""
    try:
        told = json.loads(state)
        failed = told["state"] == _FAILED
        return str(told["failure"] or _FAILED) if failed else ""
    except (ValueError, TypeError, KeyError):
        return ""
