"""A run of a protocol or reference on the bench, stopped at 0 V on any fault. No ROS.
Once started, it owns the outputs and keeps sending (0 V when done or aborted) until a reset."""

import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field
from typing import Any
from typing import Protocol as Interface

from sma_bench.errors import InputError
from sma_bench.hardware.safety import Freshness, Guard
from sma_bench.live.recording import Readiness
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import TUNING
from sma_bench.protocols import TIP, Protocol, Quantity, Segment, Waiting, load_protocol

IDLE, RUNNING, DONE, ABORTED = "idle", "running", "done", "aborted"
_START_TIMEOUT, _LATE = 10.0, 0.8  # s that a start waits; a late reading, of the feedback timeout
_LEAD_IN = 0.25  # s of 0 V first: by then a simulated bench runs in step with the commands
_PROGRESS_EVERY = 0.25  # s
_BEYOND = 1e4  # K or m: not a reading; a single one would saturate a controller's integral


class OpenLoop:
    """Drives the voltages of a protocol; `needs`: quantities that must be measured to drive."""

    needs: Sequence[str] = ()

    def plan(self, settings: dict[str, Any], parameters: Parameters) -> Protocol:
        """The protocol of the next run. InputError: it cannot be followed."""
        return load_protocol(settings["protocol"], parameters)

    def begin(self, settings: dict[str, Any], parameters: Parameters) -> None:
        """Called when a run starts."""

    def volts(self, protocol: Protocol, elapsed: float) -> list[float]:
        """Volts of every channel at `elapsed` s of the run."""
        return protocol.level(elapsed).tolist()

    def heard(self, quantity: str, channel: str, value: float) -> None:
        """A reading: temperature [K] of a channel, deflection [m]."""


class ClosedLoop(OpenLoop):
    """Controls the wires' temperatures (experiment E8) or the tip's deflection. SI units."""

    def __init__(self, quantity: Quantity, settings: dict[str, Any], parameters: Parameters,
                 follow: Callable[[Sequence[float]], None]) -> None:
        """`follow` is called with each commanded level of the reference."""
        # Imported here: only controllers need the linear model.
        from sma_bench.control import DeflectionController, TemperatureController
        if not (quantity.tip or "temperature" in settings["feedback"]):
            raise InputError("feedback: temperature control cannot do without temperature")
        self._quantity, self._follow = quantity, follow
        self.needs = ("deflection",) if quantity.tip else ()
        self._controller: Any = DeflectionController if quantity.tip else TemperatureController
        self._period = 1.0 / settings["command_rate"]
        self._asked: Sequence[float] | None = None
        self._readings = dict.fromkeys(quantity.targets(parameters), math.nan)
        # The first design also compiles the physics: do it before the start.
        self.begin(settings, parameters)

    def plan(self, settings: dict[str, Any], parameters: Parameters) -> Protocol:
        """The reference; InputError unless the bench can reach every level."""
        if not settings["reference"]:  # at rest, until the topic gives one
            names, rest = self._quantity.targets(parameters), self._quantity.rest(parameters)
            level = (rest,) * len(names)
            return Protocol("topic", names, (Segment("follow", math.inf, level, level),), rest=rest)
        reference = load_protocol(settings["reference"], parameters, self._quantity)
        for segment in reference.segments:
            for level in (segment.start, segment.stop):
                if fault := self._controller.reference_fault(level, parameters):
                    raise InputError(f"{reference.name}: {segment.step}: {fault}")
        return reference

    def begin(self, settings: dict[str, Any], parameters: Parameters) -> None:
        """Design the controller again, for the present parameters."""
        self._asked = None
        tuning = {p.name: settings[p.name] for p in TUNING}
        self._law = self._controller(parameters, self._period, **tuning)

    def volts(self, protocol: Protocol, elapsed: float) -> list[float]:
        wanted, upcoming = (protocol.level(moment).tolist() if self._asked is None else self._asked
                            for moment in (elapsed, elapsed + self._period))
        self._follow(wanted)
        readings = list(self._readings.values())
        if self._quantity.tip:
            return list(self._law.step(upcoming[0], readings[0]).tolist())
        return list(self._law.step(wanted, readings).tolist())

    def ask(self, asked: Sequence[float], followed: Protocol | None, parameters: Parameters) -> str:
        """Take a reference from the topic, if the run has no end; returns why not, or ""."""
        if followed is None:
            return "reference on the topic, but no run follows it: start first"
        if math.isfinite(followed.duration):
            return f"reference on the topic, but {followed.name} is followed: -p \"reference:=''\""
        fault: str = self._controller.reference_fault(asked, parameters)
        if not fault:
            self._asked = asked
        return fault

    def heard(self, quantity: str, channel: str, value: float) -> None:
        """During a gap (the camera's shutter) the last reading is used until it is stale."""
        if (quantity == "deflection") == self._quantity.tip:
            self._readings[channel or TIP] = value


@dataclass(frozen=True)
class Surroundings:
    """The bench's topics: is there a subscriber of commands, what is wrong with our clock, which
    states for `Readiness` have a publisher (`present`), what must be recorded (`published`)."""

    commands_heard: bool = True
    clock_fault: str = ""
    present: Set[str] = field(default_factory=frozenset)
    published: Callable[[], list[str]] = list


class Outputs(Interface):
    """The outputs of a run: voltages, the step that begins (`mark`), its state, its progress."""

    def surroundings(self) -> Surroundings: ...
    def send(self, voltage: list[float]) -> None: ...
    def mark(self, step: str) -> None: ...
    def enter(self, state: str) -> None: ...
    def show(self, progress: dict[str, Any]) -> None: ...


class Run:
    """See the module. `now` is s of a monotonic clock, `time` s of the bench's clock."""

    def __init__(self, outputs: Outputs, loop: OpenLoop, guard: Guard, readiness: Readiness,
                 channels: int, autostart: bool = False, feedback_timeout: float = 1.0,
                 steady: float = 0.0, command_timeout: float = math.inf) -> None:
        """`autostart`: start as soon as possible; `feedback_timeout`: s without readings that a
        step waits for; `steady`: s for which readings must come in time before a start;
        `command_timeout`: s without a command until the bench goes to 0 V by itself."""
        self._outputs, self._loop, self._guard, self._readiness = outputs, loop, guard, readiness
        self._feedback_timeout, self._steady = feedback_timeout, steady
        self._command_timeout = command_timeout
        self._zero, self._autostart, self._start_by = [0.0] * channels, autostart, math.inf
        self._watched = self._late = -math.inf  # s: last watch; last time that something was late
        self._aborted = ""  # the first reason since the last reset
        # s: end of the lead-in; next progress message; time of waiting steps skipped; last tick.
        self._begin = self._progress_due = self._skipped = self._time = 0.0
        self._started: float | None = None  # s of the bench's clock, after the lead-in
        self._waiting: Waiting | None = None
        self._readings = {name: Freshness(f"joint_states ({name})", feedback_timeout, guard.aged)
                          for name in loop.needs}
        self.state, self.state_text, self.step = IDLE, IDLE, ""
        self.protocol: Protocol | None = None

    @property
    def running(self) -> bool:
        return self.state == RUNNING

    def heard(self, quantity: str, channel: str, value: float, stamp: float, now: float) -> None:
        """A reading: temperature [K] of a channel, deflection [m]."""
        if not abs(value) < _BEYOND:
            return
        self._loop.heard(quantity, channel, value)
        name = f"{quantity} {channel}".strip()
        new = Freshness(name, self._feedback_timeout, self._guard.aged)
        fresh = self._readings.setdefault(name, new)
        fresh.seen(stamp, now)
        if self._waiting is not None:
            self._waiting.heard(quantity, channel, value, self._time)

    def fault(self, now: float) -> str:
        """Why the wires must not be driven now, or ""."""
        waiting = self._waiting if self.running else None
        missing = self._missing(waiting.protocol, now) if waiting else ""
        needed = (self._readings[name].fault(now) for name in self._loop.needs)
        return self._guard.fault(now) or next(filter(None, needed), "") or missing

    def obstacle(self, now: float) -> str:
        """Why the next run cannot start, or ""."""
        around = self._outputs.surroundings()
        if not around.commands_heard:
            return "nothing listens to voltage_command"
        return (around.clock_fault or self._readiness.obstacle(around.present, now)
                or self.fault(now))

    def _missing(self, protocol: Protocol, now: float) -> str:
        """Report of a step that waits for a quantity that is not measured (any more), or ""."""
        for segment in protocol.segments:
            if not segment.until:
                continue
            for quantity in {end.partition("_")[0] for end in segment.until} - {"settled"} or {""}:
                known = [f for name, f in self._readings.items() if name.startswith(quantity)]
                if not known:
                    wanted = quantity or "temperature or deflection"
                    return f"{segment.step} waits for {wanted}, which is not published"
                if fault := next(filter(None, (fresh.fault(now) for fresh in known)), ""):
                    return f"{segment.step} waits for it: {fault}"
        return ""

    def _not_yet(self, now: float) -> str:
        """What a start still waits for (steady readings, topics not yet recorded), or ""."""
        if (steady := now - self._late) < self._steady:
            return f"readings have come in time for {steady:.1f} s, expected {self._steady:g} s"
        if not self._readiness.required():
            return ""
        published = self._outputs.surroundings().published()
        topics = self._readiness.not_recorded(published, self._guard.wanted)
        return f"the recorder does not hear {', '.join(topics)} yet" if topics else ""

    def tick(self, now: float, time: float) -> None:
        """Send the command for this time, or 0 V."""
        silent, self._time = time - self._time, time
        if self.running and self._started is not None and silent > self._command_timeout:
            self.abort(f"no command was sent for {silent:.2f} s, bench.command_timeout is "
                       f"{self._command_timeout:g} s: the outputs were at 0 V")
        self.check(now)
        if not self.running or self.protocol is None or now < self._begin:
            if self.state != IDLE:
                self._send(self._zero)
            return
        self._started = time if self._started is None else self._started
        elapsed = time - self._started + self._skipped
        if self._waiting is not None and 0.0 <= elapsed < self.protocol.duration:
            ahead = self._waiting.passed_over(elapsed, time)
            self._skipped, elapsed = self._skipped + ahead, elapsed + ahead
        step = self.protocol.step_at(elapsed)
        if elapsed > 0.0 and not step:
            # A deviation breaks a rule only when it lasts, so a brief run is checked here: a wire
            # that strays aborts it, one that got 0 V only once late readings have had their time.
            never, late = self._guard.unanswered(), elapsed - self.protocol.duration
            if reason := self._guard.strays(now) or (late >= self._feedback_timeout and never):
                self.abort(reason)
            elif never:
                self._send(self._zero)
            else:
                self._finish(DONE)
            return
        self._mark(step)
        self._send(self._loop.volts(self.protocol, elapsed))
        if now >= self._progress_due:
            self._progress_due = now + _PROGRESS_EVERY
            duration = self.protocol.duration - self._skipped
            self._outputs.show({"protocol": self._name, "step": self.step,
                                "elapsed": round(elapsed - self._skipped, 3),
                                "duration": duration if math.isfinite(duration) else None})

    def watch(self, now: float, plan: Callable[[], Protocol]) -> None:
        """Check, and start when requested, on a clock that runs on when a simulation stops."""
        if max(self._guard.oldest(now), now - self._watched) > _LATE * self._feedback_timeout:
            self._late = now
        self._watched = now
        if self._autostart and self.state == IDLE:
            if not (reason := self.obstacle(now) or self._not_yet(now)):
                self._autostart = False
                try:
                    self._start(now, plan)
                except InputError as error:  # a file that has changed since it was chosen
                    self.abort(f"not started: {error}")
            elif now > self._start_by:
                self.abort(f"not started: {reason}")
        self.check(now)
        if self.state == ABORTED:
            self._send(self._zero)

    def check(self, now: float) -> None:
        """Abort the run on a fault."""
        if self.running and (reason := self.fault(now) or self._readiness.fault(now)):
            self.abort(reason)

    def abort(self, reason: str) -> None:
        """0 V, until a reset."""
        self._autostart, self._aborted = False, self._aborted or reason
        self._send(self._zero)
        self._finish(ABORTED)

    def close(self) -> None:
        if self.running:
            self.abort("the node was ended")
        if self.state != IDLE:
            self._send(self._zero)

    def start(self, now: float, plan: Callable[[], Protocol]) -> str:
        """Start the planned run, now or once readings are steady and recorded. InputError: no."""
        if self.running:
            raise InputError(f"already running {self._name}")
        if self._aborted:
            raise InputError(f"aborted: {self._aborted}; reset first")
        if obstacle := self.obstacle(now):
            raise InputError(obstacle)
        if reason := self._not_yet(now):
            self._autostart, self._start_by = True, now + _START_TIMEOUT
            return f"starts as soon as it can: {reason}"
        protocol = self._start(now, plan)
        return f"{protocol.name}: {protocol.length}"

    def stop(self) -> str:
        self.abort("stopped on request")
        return f"aborted: {self._aborted}"

    def reset(self) -> str:
        if self.running:
            raise InputError("running: stop first")
        self._aborted = ""
        self._guard.reset()
        for fresh in self._readings.values():
            fresh.learn_clock()
        self.enter(IDLE)
        return IDLE

    def enter(self, state: str, detail: str = "") -> None:
        self.state = state
        self.state_text = f"{state}: {detail}" if detail else state
        self._outputs.enter(self.state_text)

    @property
    def _name(self) -> str:
        return self.protocol.name if self.protocol else ""

    def _start(self, now: float, plan: Callable[[], Protocol]) -> Protocol:
        protocol = plan()
        if missing := self._missing(protocol, now):
            raise InputError(missing)
        self.protocol, self._started, self.step = protocol, None, ""
        self._begin, self._skipped = now + _LEAD_IN, 0.0
        self._waiting = Waiting(protocol) if protocol.waits else None
        self._guard.begin()
        self.enter(RUNNING, protocol.name)
        return protocol

    def _finish(self, state: str) -> None:
        self._send(self._zero)
        if self.running:
            self._mark(state)
        self.enter(state, self._aborted or self._name)

    def _mark(self, step: str) -> None:
        if step != self.step:
            self.step = step
            self._outputs.mark(f"{self._name}/{step}")

    def _send(self, voltage: list[float]) -> None:
        self._guard.commanded(voltage)
        self._outputs.send(voltage)
