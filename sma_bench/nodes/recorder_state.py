"""What the recorder beside a node says of itself: a run that is not recorded heats for nothing."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from sma_bench.border import COUNTS, TEXT, read_fields, shown
from sma_bench.errors import InputError
from sma_bench.nodes.base import LATCHED

TOPIC = "recorder/state"
_FAILED = "failed"
_FIELDS = {"state": TEXT, "output": TEXT, "failure": TEXT, "messages": COUNTS}


def follow_recorder(node: Node, note: Callable[[str], None]) -> None:
    """Call `note` with why the namespace's recorder failed, or with "" when it records."""
    node.create_subscription(
        String, TOPIC, lambda message: note(recorder_failure(message.data)), LATCHED
    )


def recorder_failure(text: str) -> str:
    """Why it failed, from a message of its `~/state`; "" when it did not, or says nothing clear."""
    try:
        told = read_fields(text, {"state": TEXT, "failure": TEXT}, TOPIC)
    except InputError:
        return ""
    return shown(told["failure"]) or _FAILED if told["state"] == _FAILED else ""


def recorder_state(text: str) -> dict[str, Any] | None:
    """`state`, `output`, `failure` and `messages` (counts by topic); None where it is none."""
    try:
        return read_fields(text, _FIELDS, TOPIC)
    except InputError:
        return None
