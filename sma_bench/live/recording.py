"""Recording a bench into bags, and the states of recorder and bridge that a run needs. No ROS."""

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

if TYPE_CHECKING:  # most importers only read states and need no bag library
    from sma_bench.records.bag_writer import BagWriter

RECORDER, BRIDGE = "recorder/state", "serial_bridge/state"
FAILED, RECORDING, STATE = "failed", "recording", "/state"
_RUNNING, _ENABLED = "running", "enabled"
RUN_STATES = {"experiment/state", "temperature_controller/state", "deflection_controller/state"}
_SILENT = 10.0  # s; it publishes every second, but a slow disk or a loaded machine may delay it
_FIELDS = {"state": TEXT, "output": TEXT, "failure": TEXT, "messages": COUNTS}


def recorded_type(topic: str, inside: str) -> str:
    """Type of a topic that a bag of the bench below `inside` contains, "" if it does not."""
    if topic == "/diagnostics":
        return "diagnostic_msgs/msg/DiagnosticArray"
    if topic.startswith(inside) and topic.removeprefix(inside) in RUN_STATES:
        return STRING
    place = place_of(topic) if topic.startswith(inside) else None
    return place.type if place else ""


class Recording:
    """Writes messages to one bag after the other; a disk error (`failure`) ends the recording."""

    def __init__(self, output: str, idle: Callable[[], tuple[bool, float]],
                 failed: Callable[[InputError], None],
                 open_bag: "Callable[[str], BagWriter]") -> None:
        """`output`: the first bag ("": named by time); `idle`: leave out idle time?, margin (s)."""
        self._first, self._idle, self._failed, self._open_bag = output, idle, failed, open_bag
        self._bag: BagWriter | None = None
        self._waiting: deque[tuple[str, int, bytes]] = deque()  # messages before a run
        self._latest, self._running = dict[str, int](), dict[str, bool]()  # ns; by topic
        self._closed_at = 0  # ns: messages after this wait for a run
        self.failure: InputError | None = None
        self.output = ""
        self.topics, self.messages = dict[str, str](), dict[str, int]()

    @property
    def open(self) -> bool:
        return self._bag is not None

    @property
    def total(self) -> int:
        """Messages in the present bag, or the last one."""
        return sum(self.messages.values())

    def next_output(self) -> str:
        """The requested name, later the same with a number; it must not exist."""
        first = self._first or time.strftime("record_%Y%m%d_%H%M%S")
        if not self.output and self._first:
            return first
        names = (first if k == 1 else f"{first}_{k}" for k in count(1))
        return next(name for name in names if not Path(name).exists())

    def begin(self, output: str) -> None:
        """Open a bag with all topics known by now. InputError: it cannot be written."""
        self._bag = self._open_bag(output)
        self.output = str(self._bag.path)
        self.messages, self._latest = {}, {}
        for topic, kind in self.topics.items():
            self.add(topic, kind)

    def finish(self) -> bool:
        """Close the bag with its index. True if there was a bag, and it is complete."""
        if self._bag is None:
            return False
        self._attempt(self._bag.close)
        self._bag = None
        return self.failure is None

    def add(self, topic: str, kind: str) -> bool:
        """Record a topic from now on, in later bags, too. False: disk error."""
        self.topics[topic] = kind
        if self._bag is None:
            return True
        self.messages[topic] = 0
        return self._attempt(self._bag.add_topic, topic, kind)

    def write(self, topic: str, stamp: int, data: bytes, text: Callable[[bytes], str]) -> None:
        """Record a serialized message received at `stamp` ns; `text` decodes one of a state."""
        # A simulated clock ticks coarsely: keep the order of messages of one tick.
        stamp = self._latest[topic] = max(stamp, self._latest.get(topic, 0) + 1)
        if topic.endswith(STATE):
            self._running[topic] = text(data).startswith(_RUNNING)
        if self._bag is None:
            return
        skip, seconds = self._idle()
        margin = round(seconds * 1e9)
        if stamp > self._closed_at:  # nothing runs: keep the last seconds in case a run begins
            while self._waiting and self._waiting[0][1] < stamp - margin:
                self._waiting.popleft()
        self._waiting.append((topic, stamp, data))
        if any(self._running.values()) or not skip:
            self._closed_at = stamp + margin
        if stamp > self._closed_at:
            return
        while self._waiting:
            message = self._waiting.popleft()
            if self._attempt(self._bag.write, *message):
                self.messages[message[0]] += 1

    def flush(self) -> None:
        if self._bag is not None:
            self._attempt(self._bag.flush)

    def state(self, state: str) -> str:
        """The recorder's state as JSON, for `recorder_state`. A topic whose messages only wait for
        a run counts 1, so that the run may begin."""
        messages = {topic: n or int(topic in self._latest) for topic, n in self.messages.items()}
        return json.dumps({"state": state, "output": self.output,
                           "failure": str(self.failure or ""), "messages": messages})

    def _attempt(self, action: Callable[..., None], *arguments: object) -> bool:
        """Do it; on a disk error the recording fails. False once it has failed."""
        try:
            action(*arguments)
        except InputError as error:
            self.fail(error)
        return self.failure is None

    def fail(self, error: InputError) -> None:
        """End the recording; the first reason is kept."""
        self.failure = self.failure or error
        self._failed(error)


def recorder_state(text: str) -> dict[str, Any] | None:
    """`state`, `output`, `failure` and `messages` (counts by topic); None if not a valid state."""
    try:
        return read_fields(text, _FIELDS, RECORDER)
    except InputError:
        return None


def recorder_failure(text: str) -> str:
    """Why the recorder failed, by its `~/state`; "" if it did not, or the message is invalid. Only
    these two fields are needed: a run must not go on because others are missing."""
    with suppress(InputError):
        state = read_fields(text, {"state": TEXT, "failure": TEXT}, RECORDER)
        return shown(state["failure"]) or FAILED if state["state"] == FAILED else ""
    return ""


class Readiness:
    """Checks that the recorder (if required) and the bridge (if there is one) are ready before and
    during a run, which would otherwise heat for nothing. Methods return a reason, or ""."""

    def __init__(self, required: Callable[[], bool] = lambda: False) -> None:
        self.required = required  # must there be a recorder?
        self._recorder: dict[str, Any] | None = None
        self._heard, self._states = 0.0, dict[str, str]()

    def state(self, topic: str, text: str, now: float) -> None:
        """Note the state of recorder, bridge or another driving node, received at `now` s."""
        self._states[topic] = shown(text)
        if topic == RECORDER:
            self._recorder, self._heard = recorder_state(text), now

    def obstacle(self, present: Set[str], now: float) -> str:
        """Why no run may start, or ""; `present`: state topics that have a publisher."""
        states = {topic: self._states.get(topic, "") for topic in present}
        if BRIDGE in states and states[BRIDGE] != _ENABLED:
            return f"serial_bridge is not enabled: {states[BRIDGE] or 'no state received yet'}"
        for topic, state in states.items():
            if topic in RUN_STATES and state.startswith(_RUNNING):
                return f"{topic.removesuffix(STATE)} is {state}"
        if self.required() and RECORDER not in present:
            last = self._recorder or {}
            why = shown(last.get("failure", "")) or "nothing publishes recorder/state"
            return f"no recorder ({why}); -p require_recorder:=false starts without"
        return self._recorder_fault(now) if self.required() else ""

    def fault(self, now: float) -> str:
        if (bridge := self._states.get(BRIDGE, _ENABLED)) != _ENABLED:
            return f"serial_bridge: {bridge}"
        return self._recorder_fault(now) if self.required() else ""

    def not_recorded(self, published: Iterable[str], wanted: Iterable[str]) -> list[str]:
        """Topics of the bench that the recorder has not subscribed to, or `wanted` ones
        (`wire/power`) of which it has no message: a subscription may take a second to match."""
        messages = self._recorder["messages"] if self._recorder else {}
        readings = tuple(f"/{name}" for name in wanted)
        return sorted(topic for topic in published
                      if topic not in messages or topic.endswith(readings) and not messages[topic])

    def _recorder_fault(self, now: float) -> str:
        if self._recorder is None:
            return "no valid state of the recorder received yet"
        if self._recorder["state"] != RECORDING:
            why = self._recorder["failure"] or self._recorder["state"]
            return f"the recorder does not record: {shown(why)}"
        if now - self._heard > _SILENT:
            return f"the recorder has been silent for {now - self._heard:.0f} s"
        return ""
