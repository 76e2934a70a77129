"""What is recorded of a bench, and what a recorder and a bridge say of themselves. No ROS."""

import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Set
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sma_bench.border import COUNTS, TEXT, read_fields, shown
from sma_bench.errors import InputError
from sma_bench.records.contract import STRING, place_of

if TYPE_CHECKING:  # which most who ask how the recorder does are without
    from sma_bench.records.bag_writer import BagWriter

RECORDER, BRIDGE = "recorder/state", "serial_bridge/state"
FAILED, RECORDING, STATE = "failed", "recording", "/state"
_RUNNING, _ENABLED = "running", "enabled"
RUN_STATES = {"experiment/state", "temperature_controller/state", "deflection_controller/state"}
_SILENT = 10.0  # s: it speaks each second, but a disk, or a loaded machine, may keep it
_FIELDS = {"state": TEXT, "output": TEXT, "failure": TEXT, "messages": COUNTS}


def recorded_type(topic: str, inside: str) -> str:
    """Type of a topic that belongs into a bag of the bench below `inside`, "" for another one."""
    if topic == "/diagnostics":
        return "diagnostic_msgs/msg/DiagnosticArray"
    if topic.startswith(inside) and topic.removeprefix(inside) in RUN_STATES:
        return STRING
    place = place_of(topic) if topic.startswith(inside) else None
    return place.type if place else ""


class Recording:
    """Messages of its topics, in one bag after the other; a disk's `failure` ends the recording."""

    def __init__(self, output: str, idle: Callable[[], tuple[bool, float]],
                 failed: Callable[[InputError], None],
                 open_bag: "Callable[[str], BagWriter]") -> None:
        """`output`: the first bag, "" for one named after the time; `idle`: skip it, margin (s)."""
        self._first, self._idle, self._failed, self._open_bag = output, idle, failed, open_bag
        self._bag: BagWriter | None = None
        # Messages that wait for a run that begins; newest stamp of each topic, and of a run's, ns.
        self._kept: deque[tuple[str, int, bytes]] = deque()
        self._latest, self._running = dict[str, int](), dict[str, bool]()
        self._closed_at = 0
        self.failure: InputError | None = None
        self.output = ""
        self.topics, self.messages = dict[str, str](), dict[str, int]()

    @property
    def open(self) -> bool:
        return self._bag is not None

    @property
    def total(self) -> int:
        """Messages in the bag of the moment, or the last one."""
        return sum(self.messages.values())

    def next_output(self) -> str:
        """The one asked for, then the same with a number; it must not exist."""
        first = self._first or time.strftime("record_%Y%m%d_%H%M%S")
        if not self.output and self._first:
            return first
        names = (first if k == 1 else f"{first}_{k}" for k in count(1))
        return next(name for name in names if not Path(name).exists())

    def begin(self, output: str) -> None:
        """A new bag with all topics known by now; InputError: it cannot be written."""
        self._bag = self._open_bag(output)
        self.output = str(self._bag.path)
        self.messages, self._latest = {}, {}
        for topic, kind in self.topics.items():
            self.add(topic, kind)

    def finish(self) -> bool:
        """Give the bag its index; whether there was a bag, and it is whole."""
        if self._bag is None:
            return False
        self._guarded(self._bag.close)
        self._bag = None
        return self.failure is None

    def add(self, topic: str, kind: str) -> bool:
        """Record a topic from now on, in later bags too; whether the disk took it."""
        self.topics[topic] = kind
        if self._bag is None:
            return True
        self.messages[topic] = 0
        return self._guarded(self._bag.add_topic, topic, kind)

    def write(self, topic: str, stamp: int, data: bytes, text: Callable[[bytes], str]) -> None:
        """A serialized message, heard at `stamp` ns; `text` reads that of a state's."""
        # A simulated clock ticks coarsely: two messages of one tick keep their order.
        stamp = self._latest[topic] = max(stamp, self._latest.get(topic, 0) + 1)
        if topic.endswith(STATE):
            self._running[topic] = text(data).startswith(_RUNNING)
        if self._bag is None:
            return
        skip, seconds = self._idle()
        margin = round(seconds * 1e9)
        if stamp > self._closed_at:  # nothing ran: the last seconds wait for a run that begins
            while self._kept and self._kept[0][1] < stamp - margin:
                self._kept.popleft()
        self._kept.append((topic, stamp, data))
        if any(self._running.values()) or not skip:
            self._closed_at = stamp + margin
        if stamp > self._closed_at:
            return
        while self._kept:
            kept = self._kept.popleft()
            if self._guarded(self._bag.write, *kept):
                self.messages[kept[0]] += 1

    def flush(self) -> None:
        if self._bag is not None:
            self._guarded(self._bag.flush)

    def state(self, state: str) -> str:
        """What a recorder says of itself, as JSON; `recorder_state` reads it. A topic of which
        messages only wait for a run has 1: it is heard, and the run may begin."""
        messages = {topic: n or int(topic in self._latest) for topic, n in self.messages.items()}
        return json.dumps({"state": state, "output": self.output,
                           "failure": str(self.failure or ""), "messages": messages})

    def _guarded(self, action: Callable[..., None], *arguments: object) -> bool:
        """Whether the disk took it; if not, the recording has failed with the disk's line."""
        try:
            action(*arguments)
        except InputError as error:
            self.fail(error)
        return self.failure is None

    def fail(self, error: InputError) -> None:
        """End the recording: the first reason counts."""
        self.failure = self.failure or error
        self._failed(error)


def recorder_state(text: str) -> dict[str, Any] | None:
    """`state`, `output`, `failure` and `messages` (counts by topic); None where it is none."""
    try:
        return read_fields(text, _FIELDS, RECORDER)
    except InputError:
        return None


def recorder_failure(text: str) -> str:
    """Why it failed, from a message of its `~/state`; "" when it did not, or says nothing clear.
    These two fields are enough for it: a run must not go on for want of the others."""
    with suppress(InputError):
        said = read_fields(text, {"state": TEXT, "failure": TEXT}, RECORDER)
        return shown(said["failure"]) or FAILED if said["state"] == FAILED else ""
    return ""


class Readiness:
    """Whether the recorder, where one has to be there, and the bridge, where there is one, are
    ready for a run, and go on in it: else it would heat for nothing. Answers with a line, or ""."""

    def __init__(self, required: Callable[[], bool] = lambda: False) -> None:
        self.required = required  # whether a recorder is
        self._recorder: dict[str, Any] | None = None
        self._heard, self._bridge = 0.0, ""
        self._others = dict[str, str]()  # states of whatever else drives

    def recorder(self, text: str, now: float) -> None:
        """A message of the recorder's state, at `now` s."""
        self._recorder, self._heard = recorder_state(text), now

    def bridge(self, text: str) -> None:
        self._bridge = shown(text)

    def other(self, topic: str, text: str) -> None:
        self._others[topic] = shown(text)

    def obstacle(self, present: Set[str], now: float) -> str:
        """Why no run may start, where the topics `present` have a publisher."""
        if BRIDGE in present and self._bridge != _ENABLED:
            return f"serial_bridge is not enabled: {self._bridge or 'it has not said its state'}"
        for topic in self._others.keys() & present:
            if self._others[topic].startswith(_RUNNING):
                return f"{topic.removesuffix(STATE)} is {self._others[topic]}"
        if self.required() and RECORDER not in present:
            last = self._recorder or {}
            why = shown(last.get("failure", "")) or "nothing says so on recorder/state"
            return f"no recorder is there ({why}); -p require_recorder:=false starts without"
        return self._recorder_fault(now) if self.required() else ""

    def fault(self, now: float) -> str:
        if self._bridge not in ("", _ENABLED):
            return f"serial_bridge: {self._bridge}"
        return self._recorder_fault(now) if self.required() else ""

    def not_recorded(self, published: Iterable[str], wanted: Iterable[str]) -> list[str]:
        """Those of the bench's topics that the recorder has not subscribed to, or, where they are
        `wanted` (`wire/power`), has no message of: a subscription may take a second to be known."""
        messages = self._recorder["messages"] if self._recorder else {}
        readings = tuple(f"/{name}" for name in wanted)
        return sorted(topic for topic in published
                      if topic not in messages or topic.endswith(readings) and not messages[topic])

    def _recorder_fault(self, now: float) -> str:
        if self._recorder is None:
            return "the recorder has not said its state"
        if self._recorder["state"] != RECORDING:
            why = self._recorder["failure"] or self._recorder["state"]
            return f"the recorder does not record: {shown(why)}"
        if now - self._heard > _SILENT:
            return f"the recorder has been silent for {now - self._heard:.0f} s"
        return ""
