"""Runs a protocol on the bench, and stops it at 0 V when something is wrong.

States: idle, running, done, aborted. Once started, the node owns the outputs and keeps sending
them (0 V when done or aborted) until `~/reset`. Should it die without a word, the command timeout
of the bridge or the simulator puts the outputs to 0 V.
"""

import json
import math
import time
from collections.abc import Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from sma_bench.border import is_inside
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Interlock, Limits
from sma_bench.nodes.base import LATCHED, MEASURED, BenchNode, run_node
from sma_bench.nodes.commander import COMMAND, signature, voltage_command
from sma_bench.nodes.recorder_state import BRIDGE, TOPIC, Beside, follow_recorder
from sma_bench.protocols import Protocol, load_protocol
from sma_bench.protocols.reading import is_path
from sma_bench.records.contract import place_of

_FILES = frozenset({"protocol", "reference"})
_FEEDBACK = ("power", "temperature")
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_WATCH_EVERY = 0.05
# Wall seconds for which readings of a simulation may stay away: a loaded machine may pause it, and
# nothing is heated meanwhile.
_SIMULATION_PAUSE = 10.0
_LAST_WORD = 0.5
# Wall seconds that a start waits for the recorder to hear every topic: discovery takes up to three.
_RECORDER_PATIENCE = 10.0
# Wall seconds of 0 V before a protocol: by then a simulated bench runs in step with the commands.
_LEAD_IN = 0.25
_PROGRESS_EVERY = 0.25


class Experiment(BenchNode):
    """One protocol at a time.

    What else drives the outputs under the same rules, a controller, overrides `plan`, `volts` and
    `fault`.
    """

    _state = "idle"

    def __init__(self, name: str = "experiment") -> None:
        super().__init__(name)
        self._require_feedback()
        self.check_settings(self.settings)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        simulated = self.get_parameter("use_sim_time").value
        self._clock = self.get_clock() if simulated else steady
        patience = _SIMULATION_PAUSE if simulated else 0.0
        self._interlock = Interlock()
        self._protocol: Protocol | None = None
        self._started: float | None = None
        self._begin = 0.0
        self._said = self._state
        self._step = ""
        self._progress_due = 0.0
        self._autostart = self.settings["autostart"]
        channels = self.parameters["bench.channels"]
        self._zero = [0.0] * len(channels)
        self._labelled = partial(voltage_command, channels, signed=signature(self))
        self._feedback_timeout = max(self.settings["feedback_timeout"], patience)
        self._guard = Guard(channels, self.settings["feedback"], self._feedback_timeout)
        self._command = self.create_publisher(Float64MultiArray, COMMAND, MEASURED)
        self._marker = self.create_publisher(String, "experiment/marker", LATCHED)
        self._state_publisher = self.create_publisher(String, "~/state", LATCHED)
        self._progress = self.create_publisher(String, "~/progress", LATCHED)
        for channel in channels:
            self.create_subscription(
                BatteryState, f"{channel}/power", partial(self._on_power, channel),
                NEWEST,
            )
            self.create_subscription(
                Temperature, f"{channel}/temperature", partial(self._on_temperature, channel),
                NEWEST,
            )
        follow_recorder(self, self._guard.recorder)
        self._beside = Beside(self.settings["require_recorder"])
        self._patience = math.inf
        self.create_subscription(String, BRIDGE, self._on_bridge, LATCHED)
        self.create_subscription(
            String, TOPIC, lambda m: self._beside.recorder(m.data, time.monotonic()), LATCHED
        )
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(1.0 / self.settings["command_rate"], self._tick, clock=self._clock)
        self.create_timer(_WATCH_EVERY, self._watch, clock=steady)
        self._enter("idle")
        if not self._autostart:
            name = self.get_fully_qualified_name()
            self.get_logger().info(f"starts with {name}/start, or by itself: -p autostart:=true")

    def held(self) -> Set[str]:
        """The limits always, everything that is said of the bench while it is driven."""
        driving = self._state == "running"
        return {name for name in self._contract if driving or name.startswith("bench.")}

    def check_settings(self, settings: dict[str, Any]) -> None:
        """A protocol must be readable before it becomes the parameter's value."""
        self._require_inside(settings)
        self.plan(settings)

    def _require_inside(self, settings: dict[str, Any]) -> None:
        """Whoever started the node may have named any file, whoever sets parameters may not."""
        for name in _FILES & settings.keys():
            path, root = settings[name], settings["protocol_root"]
            if path == self.settings[name] or not is_path(path):
                continue
            if not is_inside(Path(path), Path(root or ".")):
                where = root or "where the node was started"
                raise InputError(f"{name}: {path} lies outside protocol_root ({where})")

    def plan(self, settings: dict[str, Any]) -> Protocol:
        """What the next run follows: name, duration and steps; InputError when it cannot be."""
        return load_protocol(settings["protocol"], self.parameters)

    def volts(self, elapsed: float) -> list[float]:
        """Volts of every channel at `elapsed` s of the run."""
        return self._protocol.voltage(elapsed).tolist()

    def fault(self) -> str:
        """Why the wires must not be driven now, or ""."""
        return self._guard.fault(time.monotonic())

    def close(self) -> None:
        """Leave the outputs at 0 V."""
        if self._state == "idle":
            return
        if self._state == "running":
            self._abort("the node was ended")
        self._send(self._zero)
        end = time.monotonic() + _LAST_WORD
        for publisher in (self._command, self._marker, self._state_publisher):
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))

    def _require_feedback(self) -> None:
        for kind in self.settings["feedback"]:
            if kind not in _FEEDBACK:
                raise InputError(f"feedback: {kind!r}, expected {' or '.join(_FEEDBACK)}")

    def health(self) -> list[DiagnosticStatus]:
        """How the run goes, and what keeps the next one from starting."""
        aborted = self._state == "aborted"
        return [self.status(
            "run", DiagnosticStatus.ERROR if aborted else DiagnosticStatus.OK, self._said,
            {
                "protocol": self._protocol.name if self._protocol else "", "step": self._step,
                "obstacle": "" if self._state == "running" else self._obstacle(),
            },
        )]  # fmt: skip

    # Who is beside

    def _on_bridge(self, message: String) -> None:
        self._beside.bridge(message.data)
        if self._state == "running":
            self._check()

    def on_time_went_back(self, reason: str) -> None:
        """No step and no volt would be that of its time."""
        if self._state == "running":
            self._abort(reason)

    # Readings

    def _on_power(self, channel: str, message: BatteryState) -> None:
        self._guard.power(
            channel, message.voltage, message.current, seconds(message), time.monotonic(),
            Limits.from_parameters(self.parameters),
        )

    def _on_temperature(self, channel: str, message: Temperature) -> None:
        self._guard.temperature(
            channel, message.temperature + CELSIUS_ZERO, seconds(message), time.monotonic(),
            Limits.from_parameters(self.parameters),
        )

    # Time

    def _tick(self) -> None:
        """One command."""
        if self._state == "running":
            self._check()
        if self._state == "running":
            self._follow_protocol()
        elif self._state != "idle":
            self._send(self._zero)

    def _watch(self) -> None:
        """The same care on a clock that goes on when a simulation stops."""
        if self._autostart and self._state == "idle" and not self._obstacle():
            if not (unheard := self._unheard()):
                self._autostart = False
                self._start()
            elif time.monotonic() > self._patience:
                self._abort(f"not started: {_not_heard(unheard)}")
        if self._state == "running":
            self._check()
        elif self._state == "aborted":
            self._send(self._zero)

    def _check(self) -> None:
        reason = self.fault() or self._beside.fault(time.monotonic())
        if reason:
            self._abort(reason)

    def _follow_protocol(self) -> None:
        if time.monotonic() < self._begin:
            self._send(self._zero)
            return
        now = self._clock.now().nanoseconds / 1e9
        self._started = now if self._started is None else self._started
        elapsed = now - self._started
        if elapsed >= self._protocol.duration:
            self._finish("done")
            return
        self._mark(self._protocol.step_at(elapsed))
        self._send(self.volts(elapsed))
        self._tell_progress(elapsed)

    # What happens

    def _obstacle(self) -> str:
        if self._command.get_subscription_count() == 0:
            return "nothing listens to voltage_command"
        if self._clock.now().nanoseconds == 0:
            return "use_sim_time is set, but there is no /clock"
        present = {name for name in (BRIDGE, TOPIC) if self.count_publishers(name)}
        return self._beside.obstacle(present, time.monotonic()) or self.fault()

    def _unheard(self) -> list[str]:
        """Topics of the bench that the recorder has to hear, and does not yet."""
        if not self.settings["require_recorder"]:
            return []
        inside = self.get_namespace().rstrip("/") + "/"
        published = [
            topic for topic, types in self.get_topic_names_and_types()
            if (place := place_of(topic)) and topic.startswith(inside) and place.type in types
            and self.count_publishers(topic)
        ]  # fmt: skip
        return self._beside.unheard(published)

    def _start(self) -> None:
        self._protocol = self.plan(self.settings)
        self._started = None
        self._begin = time.monotonic() + _LEAD_IN
        self._step = ""
        self._enter("running", self._protocol.name)

    def _abort(self, reason: str) -> None:
        self._autostart = False
        self._interlock.trip(reason)
        self._send(self._zero)
        self.get_logger().error(f"0 V: {reason}")
        self._finish("aborted")

    def _finish(self, state: str) -> None:
        self._send(self._zero)
        if self._state == "running":
            self._mark(state)
        name = self._protocol.name if self._protocol else ""
        self._enter(state, self._interlock.reason or name)

    def _enter(self, state: str, detail: str = "") -> None:
        self._state = state
        text = self._said = f"{state}: {detail}" if detail else state
        self._state_publisher.publish(String(data=text))
        self.get_logger().info(text)

    def _mark(self, step: str) -> None:
        if step != self._step:
            self._step = step
            self._marker.publish(String(data=f"{self._protocol.name}/{step}"))

    def _tell_progress(self, elapsed: float) -> None:
        """A few times a second, for people: the protocol, its step, s gone and in all."""
        if (now := time.monotonic()) < self._progress_due:
            return
        self._progress_due = now + _PROGRESS_EVERY
        duration = self._protocol.duration
        self._progress.publish(String(data=json.dumps({
            "protocol": self._protocol.name, "step": self._step, "elapsed": round(elapsed, 3),
            "duration": duration if math.isfinite(duration) else None,
        })))  # fmt: skip

    def _send(self, voltage: list[float]) -> None:
        self._guard.commanded(voltage)
        self._command.publish(self._labelled(voltage))

    # Services

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._state == "running":
            return _answer(response, False, f"already running {self._protocol.name}")
        if self._interlock.tripped:
            return _answer(response, False, f"aborted: {self._interlock.reason}; reset first")
        if obstacle := self._obstacle():
            return _answer(response, False, obstacle)
        if unheard := self._unheard():
            self._autostart, self._patience = True, time.monotonic() + _RECORDER_PATIENCE
            why = f"starts as soon as all is recorded: {_not_heard(unheard)}"
            return _answer(response, True, why)
        try:
            self._start()
        except InputError as error:
            return _answer(response, False, str(error))
        return _answer(response, True, f"{self._protocol.name}: {self._protocol.duration:g} s")

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._abort("stopped on request")
        return _answer(response, True, f"aborted: {self._interlock.reason}")

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._state == "running":
            return _answer(response, False, "running: stop first")
        self._interlock.reset()
        self._guard.recorder("")
        self._enter("idle")
        return _answer(response, True, "idle")


def _not_heard(topics: list[str]) -> str:
    return f"the recorder does not hear {', '.join(topics)} yet"


def seconds(message: BatteryState | Temperature | JointState) -> float:
    """Acquisition stamp in s."""
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9


def _answer(response: Trigger.Response, success: bool, message: str) -> Trigger.Response:
    response.success = success
    response.message = message
    return response


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("experiment", Experiment, argv)


if __name__ == "__main__":
    raise SystemExit(main())
