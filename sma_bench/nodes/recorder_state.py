"""What the recorder and the bridge beside a node say of themselves: a run that is not recorded, or
whose volts reach no wire, heats for nothing."""

from collections.abc import Callable, Iterable, Set
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from sma_bench.border import COUNTS, TEXT, read_fields, shown
from sma_bench.errors import InputError
from sma_bench.nodes.base import LATCHED

TOPIC = "recorder/state"
BRIDGE = "serial_bridge/state"
_FAILED = "failed"
_RECORDING = "recording"
_ENABLED = "enabled"
# Wall s: the recorder speaks each second; a disk, or a loaded machine, may keep it for a while.
_SILENT = 10.0
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


class Beside:
    """Whether the recorder, where one has to be there, and the bridge, where there is one, are
    ready for a run, and go on in it. Answers with a line for people, or "" when all is well."""

    def __init__(self, recorder_required: bool) -> None:
        self._required = recorder_required
        self._recorder: dict[str, Any] | None = None
        self._heard = 0.0
        self._bridge = ""

    def recorder(self, text: str, now: float) -> None:
        """A message of the recorder's state, at `now` s."""
        self._recorder, self._heard = recorder_state(text), now

    def bridge(self, text: str) -> None:
        """A message of the bridge's state."""
        self._bridge = shown(text)

    def obstacle(self, present: Set[str], now: float) -> str:
        """Why no run may start, where the topics `present` have a publisher."""
        if BRIDGE in present and self._bridge != _ENABLED:
            return f"serial_bridge is not enabled: {self._bridge or 'it has not said its state'}"
        if self._required and TOPIC not in present:
            last = self._recorder or {}
            why = shown(last.get("failure", "")) or "nothing says so on recorder/state"
            return f"no recorder is there ({why}); -p require_recorder:=false starts without"
        return self._recorder_fault(now) if self._required else ""

    def fault(self, now: float) -> str:
        """Why a run must not go on."""
        if self._bridge not in ("", _ENABLED):
            return f"serial_bridge: {self._bridge}"
        return self._recorder_fault(now) if self._required else ""

    def unheard(self, published: Iterable[str]) -> list[str]:
        """Those of the bench's topics that the recorder has not subscribed to."""
        messages = self._recorder["messages"] if self._recorder else {}
        return sorted(topic for topic in published if topic not in messages)

    def _recorder_fault(self, now: float) -> str:
        if self._recorder is None:
            return "the recorder has not said its state"
        if self._recorder["state"] != _RECORDING:
            why = self._recorder["failure"] or self._recorder["state"]
            return f"the recorder does not record: {shown(why)}"
        if now - self._heard > _SILENT:
            return f"the recorder has been silent for {now - self._heard:.0f} s"
        return ""
