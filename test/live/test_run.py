"""A run without ROS: it follows what is planned, and leaves the wire cold."""

import json
import math

import pytest

from sma_bench.errors import InputError
from sma_bench.hardware.safety import Guard, Limits
from sma_bench.live.recording import RECORDER, Beside
from sma_bench.live.run import OpenLoop, Run, Surroundings
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol

PARAMETERS = Parameters.defaults()
LIMITS = Limits.from_parameters(PARAMETERS)
RESISTANCE = PARAMETERS["wire.resistance"]
PERIOD = 0.02
LONG = {"name": "long", "steps": [{"kind": "hold", "level": 3.0, "duration": 1000.0}]}
SHORT = {
    "name": "short",
    "steps": [
        {"kind": "hold", "name": "warm", "level": 2.0, "duration": 1.0},
        {"kind": "rest", "name": "cool", "duration": 0.5},
    ],
}


class Bench:
    """A run's outputs, and a wire that gets what is commanded or else what the test wants."""

    def __init__(self, protocol=LONG, parameters=PARAMETERS, loop=None, require_recorder=False):
        self.parameters = parameters
        self.celsius, self.ampere, self.deaf, self.frozen = 25.0, None, False, False
        self.tells = True
        self.sent, self.marks, self.states, self.shown = [], [], [], []
        self.around = Surroundings()
        self.now = 100.0
        self.stamp = 0.0
        channels = parameters["bench.channels"]
        self.guard = Guard(channels, ("power", "temperature"), 0.5)
        self.beside = Beside(require_recorder)
        self.run = Run(self, loop or OpenLoop(), self.guard, self.beside, len(channels))
        self.plan = lambda: parse_protocol(protocol, parameters)

    def surroundings(self):
        return self.around

    def send(self, voltage):
        self.sent.append(voltage)

    def mark(self, step):
        self.marks.append(step)

    def enter(self, state):
        self.states.append(state)

    def show(self, progress):
        self.shown.append(progress)

    @property
    def state(self):
        return self.states[-1]

    def read(self):
        """The readings of one moment."""
        if not self.frozen:
            self.stamp = self.now
        for k, channel in enumerate(self.parameters["bench.channels"]):
            volt = 0.0 if self.deaf or not self.sent else self.sent[-1][k]
            ampere = volt / RESISTANCE if self.ampere is None else self.ampere
            self.guard.power(channel, volt, ampere, self.stamp, self.now, LIMITS)
            self.guard.temperature(channel, self.celsius + 273.15, self.stamp, self.now, LIMITS)
            if self.tells:
                kelvin = self.celsius + 273.15
                self.run.heard("temperature", channel, kelvin, self.stamp, self.now)

    def spend(self, seconds):
        for _ in range(round(seconds / PERIOD)):
            self.now += PERIOD
            self.read()
            self.run.tick(self.now, self.now)
            self.run.watch(self.now, self.plan)

    def start(self):
        self.read()
        return self.run.start(self.now, self.plan)


@pytest.fixture
def bench():
    """One that drives the wire with 3 V."""
    bench = Bench()
    assert bench.start() == (True, "long: 1000 s")
    bench.spend(0.5)
    assert bench.state == "running: long" and bench.sent[-1] == [3.0]
    return bench


def assert_cold(bench, reason):
    assert bench.state.startswith(f"aborted: {reason}")
    before = len(bench.sent)
    bench.spend(0.2)
    assert len(bench.sent) > before + 5
    assert not any(map(any, bench.sent[before - 1 :]))


def test_steps_are_marked_and_sent_after_a_lead_in_and_0_v_ends_it():
    bench = Bench(SHORT)
    bench.start()
    bench.spend(0.2)
    assert bench.sent == [[0.0]] * 10 and bench.marks == []  # a simulation gets into step
    bench.spend(2.5)
    assert bench.marks == ["short/warm", "short/cool", "short/done"]
    assert bench.state == "done: short"
    begun = bench.sent.index([2.0])
    assert bench.sent[begun : begun + 50] == [[2.0]] * 50
    assert bench.sent[begun + 50 :] == [[0.0]] * (len(bench.sent) - begun - 50)
    assert {p["duration"] for p in bench.shown} == {1.5}
    assert 4 <= len(bench.shown) <= 7


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"celsius": 160.0}, "over-temperature: wire at 160.0 degC"),
        ({"ampere": 3.5}, "over-current: wire at 3.50 A, limit 3 A"),
        ({"deaf": True}, "disagreement: wire gets 0.00 V, commanded 3.00 V, tolerance 0.25 V"),
        ({"frozen": True}, "stale feedback: nothing new from wire/"),
        ({"celsius": math.nan}, "stale feedback: nothing new from wire/temperature"),
    ],
)
def test_what_is_wrong_with_the_readings_aborts(bench, wrong, reason):
    vars(bench).update(wrong)
    bench.spend(2.0)
    assert_cold(bench, reason)


def test_a_stop_and_an_abort_are_latched_and_a_running_protocol_neither_started_nor_reset(bench):
    assert bench.run.reset() == (False, "running: stop first")
    assert bench.start() == (False, "already running long")
    assert bench.run.stop() == (True, "aborted: stopped on request")
    assert_cold(bench, "stopped on request")
    started, why = bench.start()
    assert not started and why.startswith("aborted: stopped on request") and "reset first" in why
    assert bench.run.reset() == (True, "idle")
    bench.guard.recorder("bag: cannot be written: No space left on device")
    assert bench.start()[0] is False
    assert bench.run.reset()[0] and bench.start()[0]  # without it
    bench.spend(0.5)
    bench.run.close()
    assert bench.sent[-1] == [0.0] and bench.state == "aborted: the node was ended"


def test_without_feedback_or_listeners_or_time_there_is_no_start():
    bench = Bench()
    refused = bench.run.start(bench.now, bench.plan)
    assert refused == (False, "no feedback: wire/power was never received")
    bench.read()
    for around, why in (
        (Surroundings(commands_heard=False), "nothing listens to voltage_command"),
        (Surroundings(has_time=False), "use_sim_time is set, but there is no /clock"),
    ):
        bench.around = around
        assert bench.start() == (False, why)


def test_a_protocol_that_cannot_be_read_any_more_is_the_answer_or_ends_the_autostart():
    bench = Bench()

    def missing():
        raise InputError("p.yaml: no such file")

    bench.read()
    assert bench.run.start(bench.now, missing) == (False, "p.yaml: no such file")
    late = Run(bench, OpenLoop(), bench.guard, bench.beside, 1, autostart=True)
    late.watch(bench.now, missing)
    assert bench.state == "aborted: not started: p.yaml: no such file"


def test_a_start_waits_until_every_topic_is_recorded_and_is_refused_where_nothing_records():
    bench = Bench(require_recorder=True)

    def recorder_says(state, messages):
        said = {"state": state, "output": "bag", "failure": "", "messages": messages}
        bench.beside.recorder(json.dumps(said), bench.now)

    assert "no recorder is there" in bench.start()[1]
    bench.around = Surroundings(present={RECORDER}, published=lambda: ["/a", "/b", "/c"])
    assert bench.start() == (False, "the recorder has not said its state")
    recorder_says("recording", {"/a": 1})
    assert bench.start() == (
        True, "starts as soon as all is recorded: the recorder does not hear /b, /c yet"
    )
    for _ in range(11):
        recorder_says("recording", {"/a": 1})
        bench.spend(1.0)
    assert_cold(bench, "not started: the recorder does not hear /b, /c yet")
    bench.run.reset()
    recorder_says("recording", {"/a": 1, "/b": 0, "/c": 9})
    assert bench.start()[0]
    bench.spend(9.0)
    assert bench.state == "running: long"
    bench.spend(2.0)
    assert_cold(bench, "the recorder has been silent for 10 s")
    bench.run.reset()
    recorder_says("recording", {"/a": 1, "/b": 0, "/c": 9})
    assert bench.start()[0]
    recorder_says("closed", {"/a": 1})
    bench.spend(0.1)
    assert_cold(bench, "the recorder does not record: closed")


# --- Steps that end when something happens.

WAITS = {
    "name": "waits",
    "steps": [
        {"kind": "hold", "name": "warm", "level": 2.0, "duration": 5.0,
         "until": {"temperature_above": 320.0}},
        {"kind": "rest", "name": "cool", "duration": 1.0},
    ],
}  # fmt: skip


def test_a_step_ends_when_the_wire_is_warm_or_with_its_limit_and_the_next_has_its_whole_time():
    bench = Bench(WAITS)
    assert bench.start() == (True, "waits: 6 s at most")
    bench.spend(1.25)
    assert bench.sent[-1] == [2.0] and bench.shown[-1]["duration"] == 6.0
    bench.celsius = 50.0
    bench.spend(0.5)
    assert bench.sent[-1] == [0.0] and bench.marks[-1] == "waits/cool"
    assert bench.shown[-1]["duration"] == pytest.approx(2.0, abs=0.1)
    assert bench.state == "running: waits"
    bench.spend(0.7)
    assert bench.state == "done: waits"
    bench = Bench(WAITS)
    bench.start()
    bench.spend(5.1)
    assert bench.sent[-1] == [2.0]
    bench.spend(0.3)
    assert bench.sent[-1] == [0.0] and bench.marks[-1] == "waits/cool"


def test_what_a_step_waits_for_must_be_measured_before_anything_is_driven():
    bench = Bench(WAITS)
    bench.tells = False
    assert bench.start() == (False, "warm waits for temperature, which nobody publishes")
    bench.spend(0.5)
    assert not any(map(any, bench.sent))


@pytest.mark.parametrize("kelvin", [None, math.nan])
def test_a_reading_that_a_step_waits_for_and_that_stays_away_ends_the_run_cold(kelvin):
    bench = Bench(WAITS)
    bench.start()
    bench.spend(1.0)
    assert bench.sent[-1] == [2.0]
    bench.tells = False
    for _ in range(60):
        if kelvin is not None:
            bench.run.heard("temperature", "wire", kelvin, bench.now, bench.now)
        bench.spend(0.02)
    assert_cold(bench, "warm waits for it: stale feedback: nothing new from temperature wire")
