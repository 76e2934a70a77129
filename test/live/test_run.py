"""A run and a recording without ROS: the plan is followed, faults abort it at 0 V; what is recorded
when."""

import json
import math
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml

from sma_bench.errors import InputError
from sma_bench.hardware.safety import Guard, Limits
from sma_bench.live.recording import RECORDER, Readiness, Recording, recorded_type, recorder_state
from sma_bench.live.run import OpenLoop, Run, Surroundings
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol

PARAMETERS = Parameters.defaults()
LIMITS = Limits.from_parameters(PARAMETERS)
RESISTANCE = PARAMETERS["wire.resistance"]
PERIOD = 0.02
POWER = "/bench/wire/power"
RUNS = yaml.safe_load((Path(__file__).parents[1] / "runs.yaml").read_text())
LONG, WAITS = RUNS["long"], RUNS["waits"]


class Bench:
    """A run's outputs, and a wire that follows the commands or the test's own values."""

    def __init__(self, protocol=LONG, require_recorder=False):
        self.celsius, self.deaf, self.frozen, self.late = 25.0, False, False, 0
        # Temperature readings for steps that wait for it; None: none.
        self.told = lambda kelvin: kelvin
        self.sent, self.marks, self.states, self.shown = [], [], [], []
        self.send, self.mark = self.sent.append, self.marks.append
        self.enter, self.show = self.states.append, self.shown.append
        self.around = Surroundings()
        self.now, self.stamp = 100.0, 0.0
        self.guard = Guard(("wire",), ("power", "temperature"), 0.5)
        self.readiness = Readiness(lambda: require_recorder)
        self.run = Run(self, OpenLoop(), self.guard, self.readiness, 1)
        self.plan = lambda: parse_protocol(protocol, PARAMETERS)

    def surroundings(self):
        return self.around

    @property
    def state(self):
        return self.states[-1]

    def read(self):
        """Send the readings of one moment."""
        if not self.frozen:
            self.stamp = self.now
        volt = 0.0 if self.deaf or len(self.sent) <= self.late else self.sent[-1 - self.late][0]
        kelvin = self.celsius + 273.15
        self.guard.power("wire", volt, volt / RESISTANCE, self.stamp, self.now, LIMITS)
        self.guard.temperature("wire", kelvin, self.stamp, self.now, LIMITS)
        if self.told:
            self.run.heard("temperature", "wire", self.told(kelvin), self.stamp, self.now)

    def spend(self, seconds):
        for _ in range(round(seconds / PERIOD)):
            self.now += PERIOD
            self.read()
            self.run.tick(self.now, self.now)
            self.run.watch(self.now, self.plan)

    def start(self):
        self.read()
        return self.started(self.plan)

    def started(self, plan):
        """Success of a request to start, and its answer."""
        try:
            return True, self.run.start(self.now, plan)
        except InputError as error:
            return False, str(error)


def assert_cold(bench, reason):
    assert bench.state.startswith(f"aborted: {reason}")
    before = len(bench.sent)
    bench.spend(0.2)
    assert len(bench.sent) > before + 5
    assert not any(map(any, bench.sent[before - 1 :]))


def test_a_run_whose_commands_paused_is_aborted_because_the_bench_was_at_0_v_meanwhile():
    bench = Bench()
    bench.run = Run(bench, OpenLoop(), bench.guard, bench.readiness, 1, command_timeout=0.4)
    assert bench.start()[0]
    for pause in (0.3, 0.42):
        bench.spend(0.5)
        assert bench.state == "running: long" and bench.sent[-1] == [3.0]
        bench.now += pause  # a busy computer; the readings come in time again
        bench.read()
        bench.run.tick(bench.now, bench.now)
    assert_cold(bench, "no command was sent for 0.42 s, bench.command_timeout is 0.4 s")


UNHEARD = "warm waits for it: stale feedback: nothing new from temperature wire"


@pytest.mark.parametrize(("protocol", "wrong", "reason"), [
    (LONG, {"deaf": True}, "disagreement: wire gets 0.00 V, commanded 3.00 V, tolerance 0.25"),
    (LONG, {"frozen": True}, "stale feedback: wire/power arrives 0.5"),
    (LONG, {"celsius": math.nan}, "stale feedback: nothing new from wire/temperature"),
    (WAITS, {"told": None}, UNHEARD), (WAITS, {"told": lambda _: math.nan}, UNHEARD),
])  # fmt: skip
def test_what_is_wrong_with_the_readings_aborts(protocol, wrong, reason):
    """For other faults and the latch of an abort see test/nodes/test_experiment.py."""
    bench = Bench(protocol)
    assert bench.start()[0]
    bench.spend(0.5)
    assert bench.state == f"running: {protocol['name']}" and bench.sent[-1][0] > 1.0
    vars(bench).update(wrong)
    bench.spend(2.0)
    assert_cold(bench, reason)


@pytest.mark.parametrize(("drive", "deaf", "late", "is_done"), [
    (1.0, (0.0, 9.0), 0, False), (0.06, (0.0, 9.0), 0, False), (1.0, (0.9, 9.0), 0, False),
    (1.0, (0.0, 0.7), 0, True), (1.0, (1.2, 9.0), 0, True), (0.06, (9.0, 9.0), 15, True)])
@pytest.mark.parametrize("rest", [0.0, 0.5])
def test_a_run_too_short_for_the_rule_of_voltages_is_not_done_without_its_voltages(
        drive, deaf, late, is_done, rest):
    """Voltages that never appear, or disappear at the end (hidden by a rest); late readings."""
    bench = Bench({"name": "brief", "steps": [{"kind": "hold", "level": 3.0, "duration": drive},
                                              *[{"kind": "rest", "duration": rest}] * (rest > 0)]})
    bench.guard, bench.late = Guard(("wire",), ("power", "temperature"), 2.0), late
    bench.run = Run(bench, OpenLoop(), bench.guard, bench.readiness, 1)
    for _ in range(2):  # what was read in the first does not count in the second
        assert bench.start()[0]
        for k in range(160):
            bench.deaf = deaf[0] < (k + 0.5) * PERIOD < deaf[1]
            bench.spend(PERIOD)
        if is_done or (rest and deaf[0]):
            assert bench.state == "done: brief"
        else:
            assert_cold(bench, "disagreement: wire g")  # gets, or got
        bench.run.reset()


def test_a_run_with_a_pulse_between_two_readings_is_done_though_no_reading_shows_it():
    bench = Bench({"name": "brief", "steps": [
        {"kind": "rest", "duration": 0.18}, {"kind": "hold", "level": 3.0, "duration": 0.06},
        {"kind": "rest", "duration": 0.3}]})
    assert bench.start()[0]
    for k in range(100):
        bench.now += PERIOD
        if k % 10 == 0:
            bench.read()
        bench.run.tick(bench.now, bench.now)
        bench.run.watch(bench.now, bench.plan)
    assert max(volts for volts, in bench.sent) == 3.0 and bench.state == "done: brief"


def test_what_keeps_a_run_from_starting_is_said_and_nothing_is_driven():
    bench = Bench(WAITS)
    bench.told = None
    refused = bench.started(bench.plan)
    assert refused == (False, "no feedback: wire/power was never received")
    assert bench.start() == (False, "warm waits for temperature, which is not published")
    for around, why in (
        (Surroundings(commands_heard=False), "nothing listens to voltage_command"),
        (Surroundings(clock_fault="there is no /clock"), "there is no /clock"),
    ):
        bench.around = around
        assert bench.start() == (False, why)
    other, bench.around = "deflection_controller/state", Surroundings()
    bench.readiness.state(other, "running: sine", bench.now)
    assert bench.start()[1].startswith("warm waits")  # which has died
    bench.around = Surroundings(present={other})
    assert bench.start() == (False, "deflection_controller is running: sine")
    bench.readiness.state(other, "done: sine", bench.now)

    def missing():
        raise InputError("p.yaml: no such file")

    assert bench.started(missing) == (False, "p.yaml: no such file")
    bench.spend(0.5)
    late = Run(bench, OpenLoop(), bench.guard, bench.readiness, 1, autostart=True)
    late.watch(bench.now, missing)
    assert bench.state == "aborted: not started: p.yaml: no such file"
    assert not any(map(any, bench.sent))


def test_a_start_waits_until_every_topic_is_recorded_and_is_refused_where_nothing_records():
    bench = Bench(require_recorder=True)

    def recorder_says(state, messages):
        said = {"state": state, "output": "bag", "failure": "", "messages": messages}
        bench.readiness.state(RECORDER, json.dumps(said), bench.now)

    assert bench.start()[1].startswith("no recorder (nothing publishes recorder/state)")
    bench.around = Surroundings(present={RECORDER}, published=lambda: ["/a", "/b", POWER])
    assert bench.start() == (False, "no valid state of the recorder received yet")
    recorder_says("recording", {"/a": 1, POWER: 0})
    unheard = "the recorder does not hear /b, /bench/wire/power yet"
    assert bench.start() == (True, f"starts as soon as it can: {unheard}")
    for _ in range(11):
        recorder_says("recording", {"/a": 1, POWER: 0})
        bench.spend(1.0)
    assert_cold(bench, f"not started: {unheard}")

    def start():
        bench.run.reset()
        recorder_says("recording", {"/a": 1, "/b": 0, POWER: 9})
        assert bench.start()[0]

    start()
    bench.spend(9.0)
    assert bench.state == "running: long"
    bench.spend(2.0)
    assert_cold(bench, "the recorder has been silent for 10 s")
    start()
    recorder_says("closed", {"/a": 1})
    bench.spend(0.1)
    assert_cold(bench, "the recorder does not record: closed")


def test_a_start_waits_until_readings_come_steadily_and_only_for_so_long():
    """As on a busy computer that starts other nodes: readings are nearly stale, or stale."""
    bench = Bench()  # readings are stale after 0.5 s
    bench.run = Run(bench, OpenLoop(), bench.guard, bench.readiness, 1, True, 0.5, 2.0)

    def be_late(*holes):
        for hole in holes:
            bench.spend(1.0)
            bench.now += hole
            bench.run.watch(bench.now, bench.plan)

    be_late(0.42, 0.6, 1.0, 0.42, 0.45)
    assert bench.states == [] and bench.sent == []
    bench.spend(1.9)
    assert bench.states == []
    bench.spend(0.2)
    assert bench.state == "running: long"
    bench.run.stop()
    bench.run.reset()
    driven = len(bench.sent)
    be_late(0.42)
    said = "starts as soon as it can: readings have come in time for 0.0 s, expected 2 s"
    assert bench.start() == (True, said)
    be_late(*[0.42] * 8)
    assert_cold(bench, "not started: readings have come in time for 0.")
    assert not any(map(any, bench.sent[driven:]))
    # Slow but regular readings count as in time.
    bench.run.reset()
    read, bench.read = bench.read, lambda: round(bench.now / PERIOD) % 17 or read()
    bench.spend(5.0)
    assert bench.start() == (True, "long: 1000 s")


def test_a_step_ends_when_the_wire_is_warm_or_with_its_limit_and_the_next_has_its_whole_time():
    bench = Bench(WAITS)
    assert bench.start() == (True, "waits: 6 s at most")
    bench.spend(0.2)
    assert bench.sent == [[0.0]] * 10 and bench.marks == []  # a simulation gets into step
    bench.spend(1.05)
    assert len(bench.shown) == 4  # a second
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


# --- recording

READING, STATE = "/bench/wire/temperature", "/bench/experiment/state"


def recording_to(bag, idle=(False, 0.0)):
    """A recording that has begun, and a function that gives it a message."""
    recording = Recording("bag", lambda: idle, pytest.fail, lambda _: bag)
    recording.begin("bag")
    for topic in (READING, STATE):
        recording.add(topic, "t")

    def tell(topic, second, text="x"):
        recording.write(topic, round(second * 1e9), text.encode(), bytes.decode)

    return recording, tell


def stamps(bag, of=READING):
    """Stamps (ns) of a topic's recorded messages."""
    written = [call.args for call in bag.write.call_args_list]
    return [stamp for topic, stamp, _ in written if topic == of]


def test_what_is_recorded_and_that_messages_of_one_tick_keep_their_order():
    """For several bags in turn see test/nodes/test_recorder.py."""
    for topic, kind in (
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/bench/wire/power", "sensor_msgs/msg/BatteryState"),
        ("/bench/experiment/progress", ""), ("/other/wire/power", ""),
    ):  # fmt: skip
        assert recorded_type(topic, "/bench/") == kind
    bag = Mock(path="bag")
    recording, tell = recording_to(bag)
    for _ in range(3):
        tell(READING, 1.0)
    assert recording.finish() and bag.close.called and not recording.finish()
    tell(READING, 2.0)  # not written
    assert stamps(bag) == [10**9, 10**9 + 1, 10**9 + 2]
    messages = {READING: 3, STATE: 0}
    said = {"state": "recording", "output": "bag", "failure": "", "messages": messages}
    assert recorder_state(recording.state("recording")) == said


@pytest.mark.parametrize(("margin", "expected"), [(0.0, [2.0, 3.0]), (1.0, [1.0, 2.0, 3.0, 4.0])])
def test_idle_time_is_left_out_where_asked_but_for_a_margin(margin, expected):
    bag = Mock(path="bag")
    recording, tell = recording_to(bag, (True, margin))
    tell(READING, 0)
    said = recorder_state(recording.state("recording"))  # a run that waits for it can begin
    assert said["messages"][READING] == 1 and recording.total == 0
    states = {0: "idle", 1.9: "running: ramp", 3.1: "done: ramp"}
    for moment in sorted([*states, *range(1, 7)]):
        tell(*((STATE, moment, states[moment]) if moment in states else (READING, moment)))
    assert [stamp / 1e9 for stamp in stamps(bag)] == expected
