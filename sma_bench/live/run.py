"""A run of the bench: a protocol or a controller's reference, stopped at 0 V when something is
wrong. No ROS, no clock of its own.

States: idle, running, done, aborted. Once started, a run owns the outputs and keeps sending them
(0 V when done or aborted) until it is reset.
"""

import math
from collections.abc import Callable, Set
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

from sma_bench.errors import InputError
from sma_bench.hardware.safety import Freshness, Guard, Interlock
from sma_bench.live.recording import Beside
from sma_bench.parameters import Parameters
from sma_bench.protocols import Protocol, Waiting, load_protocol

IDLE, RUNNING, DONE, ABORTED = "idle", "running", "done", "aborted"
# s that a start waits for the recorder to hear every topic: discovery takes up to three.
_RECORDER_PATIENCE = 10.0
# s of 0 V before a protocol: by then a simulated bench runs in step with the commands.
_LEAD_IN = 0.25
_PROGRESS_EVERY = 0.25


class OpenLoop:
    """The voltages of a protocol."""

    def plan(self, settings: dict[str, Any], parameters: Parameters) -> Protocol:
        """What the next run follows: name, duration and steps.

        Raises:
            InputError: it cannot be followed.
        """
        return load_protocol(settings["protocol"], parameters)

    def begin(self, settings: dict[str, Any], parameters: Parameters) -> None:
        """A run starts now."""

    def volts(self, protocol: Protocol, elapsed: float) -> list[float]:
        """Volts of every channel at `elapsed` s of the run."""
        return protocol.voltage(elapsed).tolist()

    def fault(self, now: float) -> str:
        """Why it cannot be followed now, or ""."""
        return ""


@dataclass(frozen=True)
class Surroundings:
    """Who else is on the bench's topics.

    Attributes:
        commands_heard: whether anyone listens to the commands.
        has_time: False where simulated time has not begun.
        present: topics of states, of those that `Beside` knows, with a publisher.
        published: topics of the bench that a recorder has to hear.
    """

    commands_heard: bool = True
    has_time: bool = True
    present: Set[str] = field(default_factory=frozenset)
    published: Callable[[], list[str]] = list


class Outputs(Interface):
    """What a run acts on."""

    def surroundings(self) -> Surroundings:
        """Who else is there now."""

    def send(self, voltage: list[float]) -> None:
        """A command, V of every channel."""

    def mark(self, step: str) -> None:
        """A step of the protocol begins."""

    def enter(self, state: str) -> None:
        """The run's state has changed."""

    def show(self, progress: dict[str, Any]) -> None:
        """How far the run is, for people."""


class Run:
    """See the module. `now` is s of a monotonic clock, `time` s of the bench's clock."""

    def __init__(
        self, outputs: Outputs, loop: OpenLoop, guard: Guard, beside: Beside, channels: int,
        autostart: bool = False, feedback_timeout: float = 1.0,
    ) -> None:
        """`autostart`: start as soon as nothing is in the way; `feedback_timeout`: s for which
        what a step waits for may stay away."""
        self._feedback_timeout = feedback_timeout
        self._outputs, self._loop, self._guard, self._beside = outputs, loop, guard, beside
        self._zero = [0.0] * channels
        self._interlock = Interlock()
        self._autostart = autostart
        self._started: float | None = None
        self._begin = self._progress_due = 0.0
        self._patience = math.inf
        self._waiting: Waiting | None = None
        self._passed_over = self._time = 0.0
        self._readings: dict[str, Freshness] = {}
        self.state = self.said = IDLE
        self.protocol: Protocol | None = None
        self.step = ""

    @property
    def running(self) -> bool:
        """Whether the wires are driven."""
        return self.state == RUNNING

    def fault(self, now: float) -> str:
        """Why the wires must not be driven now, or ""."""
        return self._guard.fault(now) or self._loop.fault(now) or self._unmeasured(now)

    def heard(self, quantity: str, channel: str, value: float, stamp: float, now: float) -> None:
        """A reading that a step may wait for: temperature [K] of a channel, deflection [m]."""
        if not math.isfinite(value):
            return
        name = " ".join(part for part in (quantity, channel) if part)
        fresh = self._readings.setdefault(name, Freshness(name, self._feedback_timeout))
        fresh.seen(stamp, now)
        if self._waiting is not None:
            self._waiting.heard(quantity, channel, value, self._time)

    def _unmeasured(self, now: float) -> str:
        """What a step of the running protocol waits for and nobody measures (any more), or ""."""
        if not self.running or self._waiting is None:
            return ""
        return self._missing(self._waiting.protocol, now)

    def _missing(self, protocol: Protocol, now: float) -> str:
        for segment in protocol.segments:
            if segment.until is None:
                continue
            for quantity in segment.until.quantities or {""}:
                known = [f for name, f in self._readings.items() if name.startswith(quantity)]
                faults = [fault for fresh in known if (fault := fresh.fault(now))]
                if not known:
                    wanted = quantity or "temperature or deflection"
                    return f"{segment.step} waits for {wanted}, which nobody publishes"
                if faults:
                    return f"{segment.step} waits for it: {faults[0]}"
        return ""

    def obstacle(self, now: float) -> str:
        """What keeps the next run from starting, or ""."""
        around = self._outputs.surroundings()
        if not around.commands_heard:
            return "nothing listens to voltage_command"
        if not around.has_time:
            return "use_sim_time is set, but there is no /clock"
        return self._beside.obstacle(around.present, now) or self.fault(now)

    # --- time ---------------------------------------------------------------------------------

    def tick(self, now: float, time: float) -> None:
        """One command."""
        self._time = time
        self.check(now)
        if self.running:
            self._follow(now, time)
        elif self.state != IDLE:
            self._send(self._zero)

    def watch(self, now: float, plan: Callable[[], Protocol]) -> None:
        """The same care on a clock that goes on when a simulation stops."""
        if self._autostart and self.state == IDLE and not self.obstacle(now):
            if not (unheard := self._unheard()):
                self._autostart = False
                self._start_planned(now, plan)
            elif now > self._patience:
                self.abort(f"not started: {_not_heard(unheard)}")
        self.check(now)
        if self.state == ABORTED:
            self._send(self._zero)

    def _start_planned(self, now: float, plan: Callable[[], Protocol]) -> None:
        try:
            protocol = plan()
            if missing := self._missing(protocol, now):
                raise InputError(missing)
            self._start(now, protocol)
        except InputError as error:  # a file that has changed since it was chosen
            self.abort(f"not started: {error}")

    def check(self, now: float) -> None:
        """Abort where something is wrong."""
        if self.running and (reason := self.fault(now) or self._beside.fault(now)):
            self.abort(reason)

    def abort(self, reason: str) -> None:
        """0 V, until a reset."""
        self._autostart = False
        self._interlock.trip(reason)
        self._send(self._zero)
        self._finish(ABORTED)

    def close(self) -> None:
        """Leave the outputs at 0 V."""
        if self.running:
            self.abort("the node was ended")
        if self.state != IDLE:
            self._send(self._zero)

    # --- requests: whether it is done, and a line ---------------------------------------------

    def start(self, now: float, plan: Callable[[], Protocol]) -> tuple[bool, str]:
        """Follow what is planned, as soon as all of it is recorded."""
        if self.running:
            return False, f"already running {self._name}"
        if self._interlock.tripped:
            return False, f"aborted: {self._interlock.reason}; reset first"
        if obstacle := self.obstacle(now):
            return False, obstacle
        if unheard := self._unheard():
            self._autostart, self._patience = True, now + _RECORDER_PATIENCE
            return True, f"starts as soon as all is recorded: {_not_heard(unheard)}"
        try:
            protocol = plan()
        except InputError as error:
            return False, str(error)
        if missing := self._missing(protocol, now):
            return False, missing
        self._start(now, protocol)
        return True, f"{protocol.name}: {protocol.length}"

    def stop(self) -> tuple[bool, str]:
        """Abort, running or not."""
        self.abort("stopped on request")
        return True, f"aborted: {self._interlock.reason}"

    def reset(self) -> tuple[bool, str]:
        """Forget why it was aborted."""
        if self.running:
            return False, "running: stop first"
        self._interlock.reset()
        self._guard.recorder("")
        self.enter(IDLE)
        return True, IDLE

    # --- what happens -------------------------------------------------------------------------

    def enter(self, state: str, detail: str = "") -> None:
        """Say the state."""
        self.state = state
        self.said = f"{state}: {detail}" if detail else state
        self._outputs.enter(self.said)

    @property
    def _name(self) -> str:
        return self.protocol.name if self.protocol else ""

    def _unheard(self) -> list[str]:
        """Topics of the bench that the recorder has to hear, and does not yet."""
        if not self._beside.required:
            return []
        return self._beside.unheard(self._outputs.surroundings().published())

    def _start(self, now: float, protocol: Protocol) -> None:
        self.protocol, self._started, self.step = protocol, None, ""
        self._begin, self._passed_over = now + _LEAD_IN, 0.0
        self._waiting = Waiting(protocol) if protocol.waits else None
        self.enter(RUNNING, protocol.name)

    def _follow(self, now: float, time: float) -> None:
        if now < self._begin:
            self._send(self._zero)
            return
        assert self.protocol is not None
        self._started = time if self._started is None else self._started
        elapsed = time - self._started + self._passed_over
        if self._waiting is not None and 0.0 <= elapsed < self.protocol.duration:
            ahead = self._waiting.passed_over(elapsed, time)
            self._passed_over, elapsed = self._passed_over + ahead, elapsed + ahead
        step = self.protocol.step_at(elapsed)
        if elapsed > 0.0 and not step:
            self._finish(DONE)
            return
        self._mark(step)
        self._send(self._loop.volts(self.protocol, elapsed))
        self._show_progress(now, elapsed)

    def _finish(self, state: str) -> None:
        self._send(self._zero)
        if self.running:
            self._mark(state)
        self.enter(state, self._interlock.reason or self._name)

    def _mark(self, step: str) -> None:
        if step != self.step:
            self.step = step
            self._outputs.mark(f"{self._name}/{step}")

    def _show_progress(self, now: float, elapsed: float) -> None:
        """A few times a second: the protocol, its step, s gone and in all."""
        if now < self._progress_due or self.protocol is None:
            return
        self._progress_due = now + _PROGRESS_EVERY
        duration = self.protocol.duration - self._passed_over
        self._outputs.show({
            "protocol": self._name, "step": self.step,
            "elapsed": round(elapsed - self._passed_over, 3),
            "duration": duration if math.isfinite(duration) else None,
        })  # fmt: skip

    def _send(self, voltage: list[float]) -> None:
        self._guard.commanded(voltage)
        self._outputs.send(voltage)


def _not_heard(topics: list[str]) -> str:
    return f"the recorder does not hear {', '.join(topics)} yet"
