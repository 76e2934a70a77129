"""The bench driver (enabling, commands, stops) on a fake link controlled by the test."""

from collections import Counter
from dataclasses import replace

import pytest

from sma_bench.hardware.bench_driver import BenchDriver, device_limits
from sma_bench.hardware.bench_sensors import BenchSensors, SharedWatch
from sma_bench.hardware.safety import Guard, Limits
from sma_bench.hardware.serial_link import LateAnswer, LinkError, LinkStatus
from sma_bench.hardware.serial_messages import CAUSES, DeviceIdentity, DeviceState, Telemetry
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SERIAL_BRIDGE

SETTINGS = {parameter.name: parameter.default for parameter in SERIAL_BRIDGE}
DEVICE = DeviceIdentity("sma-uno", "0", "power-on", 10.0, 0.2, 6.5, 12.0, (6.0, 15.0), 1.0, 8.0,
                        2.0)
SUPPLY, RESISTANCE = 12.0, 2.6987


class FakeLink:
    """A fake link: obeys and remembers its calls."""

    def __init__(self):
        self.status = LinkStatus(connected=True, device=DEVICE, connections=1)
        self.sent, self.limits, self.armings = [], [], 0
        self.armed = self.deaf = self.stuck = False
        # Number of late answers by the command's letter; delay of frames in s.
        self.late, self.lag, self.device_time, self.leaks = Counter(), 0.0, 0.0, 0.0
        self.pass_time(0.0)

    def pass_time(self, seconds):
        """Frames with the device's measurements so far arrive."""
        self.device_time += seconds
        if not self.lag:
            self.status.newest = telemetry(self.device_time, self.leaks if self.armed else 0.0)
        self.lag = max(self.lag - seconds, 0.0)

    def answer(self, letter):
        if self.late[letter]:
            self.late[letter] -= 1
            raise LateAnswer(f"no answer to {letter}")

    def limit(self, numbers):
        self.limits = list(numbers)
        self.answer("C")

    def arm(self):
        self.armings += 1
        if self.armed:
            raise LinkError("device refused A: armed already")
        self.armed = True
        self.answer("A")
        self.status.state = DeviceState.ARMED
        if self.stuck:
            self.stop()
            self.status.cause = CAUSES.index("current with all outputs off")

    def drive(self, millivolts):
        if not self.armed:
            raise LinkError("not armed")
        self.sent.append(list(millivolts))

    def stop(self):
        self.sent.append("stop")
        if self.armed or not self.deaf:  # a deaf one stops by its own timeout
            cause = CAUSES.index("command timeout" if self.deaf else "stop byte")
            self.status.state, self.status.cause = DeviceState.STOPPED, cause
        self.armed = False

    def reset(self):
        self.status.state, self.status.left = DeviceState.IDLE, ""
        self.answer("R")


def telemetry(time, mean=0.0, duty=0.0):
    """A frame of a device driven with this duty."""
    return Telemetry(0, round(1e6 * time), 0, 0, SUPPLY, (mean, 0.0), (1.5, 1.5),
                     (duty, 0.0, 0.0, 0.0), 0, time=time)  # fmt: skip


class Bench:
    """A driver of one wire; during `pass_time` readings arrive that agree with the last command."""

    def __init__(self, waiver="", enabled=False, seconds=0.1, **contract):
        self.link, self.now = FakeLink(), 100.0
        parameters = Parameters({f"bench.{name}": value for name, value in contract.items()})
        self.limits = Limits.from_parameters(parameters)
        self.guard = Guard(["wire"], ["power", "temperature"], 1.0)
        self.driver = BenchDriver(self.link, BenchSensors(["front"], SETTINGS), self.guard,
                                  ["wire"], self.limits, waiver=waiver, pause=self.link.pass_time)
        self.pass_time(seconds)
        if enabled:
            self.driver.enable(self.now)

    def read(self, volt=0.0, ampere=None, kelvin=300.0, leak=0.0):
        duty = (volt / SUPPLY) ** 2
        mean = leak + duty**0.5 * (volt / RESISTANCE if ampere is None else ampere)
        self.driver.take(telemetry(self.now, mean, duty), self.now)
        self.guard.temperature("wire", kelvin, self.now, self.now, self.limits)

    def pass_time(self, seconds, command=None, **reading):
        for _ in range(round(seconds / 0.01)):
            self.now += 0.01
            if command is not None:
                self.driver.command([command], self.now)
            sent = [s for s in self.link.sent if s != "stop"]
            volt = sent[-1][0] / 1e3 if sent and self.link.armed else 0.0
            self.read(**{"volt": volt, **reading})
            if reason := self.driver.tick(self.now):
                return reason
        return ""

    def says(self, **status):
        vars(self.link.status).update(status)

    def refuses(self, why):
        with pytest.raises(LinkError, match=why):
            self.driver.enable(self.now)


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def driving():
    made = Bench(enabled=True)
    assert made.pass_time(0.5, command=3.0) == ""
    assert made.link.sent[-1] == [3000, 0, 0, 0]
    return made


def test_nothing_is_driven_before_somebody_enables(bench):
    assert bench.driver.state == "idle"
    assert bench.driver.diagnostics(bench.now)["last_rejection"] == ""
    assert "not enabled (idle)" in bench.driver.command([2.0], bench.now)
    assert bench.driver.command([0.0], bench.now) == ""
    bench.pass_time(0.1)
    assert bench.link.sent == [] and bench.driver.gate.rejected == 1
    bench.driver.enable(bench.now)
    bench.pass_time(0.1)
    assert [s for s in bench.link.sent if s != "stop"] == [[0, 0, 0, 0]] * 5  # not at every tick
    bench.refuses("enabled already")
    silent = Bench(enabled=True)
    assert silent.pass_time(0.1) == "" and silent.link.sent[-1] == [0, 0, 0, 0]


def test_an_offset_of_a_sensor_is_no_current_in_a_wire_at_a_small_duty():
    """At 1.2 V (a duty of 0.01) an offset of 0.08 A of the board looks like 0.8 A in its wire."""
    bench = Bench()
    assert bench.pass_time(1.0, leak=0.08) == ""
    bench.driver.enable(bench.now)
    assert bench.pass_time(3.0, command=1.2, leak=0.08) == ""
    assert bench.pass_time(0.1, command=0.4, leak=0.08) == ""
    reason = bench.pass_time(1.2, command=3.0, leak=0.08, ampere=0.0)
    assert reason.startswith("disagreement: wire carries 0.00 A at 3.00 V")
    # Readings while enabled do not change the zero.
    bench = Bench(enabled=True, seconds=1.0)
    assert bench.pass_time(2.0, command=0.0, leak=0.08) == ""
    assert "disagreement: wire carries" in bench.pass_time(2.0, command=1.2, leak=0.08)


def test_a_command_is_repeated_until_its_timeout_then_zero_is_sent(driving):
    driving.link.sent.clear()
    assert driving.pass_time(1.0) == ""
    assert (driving.link.sent[0], driving.link.sent[-1]) == ([3000, 0, 0, 0], [0, 0, 0, 0])
    assert (driving.driver.gate.timeouts, driving.driver.state) == (1, "enabled")


def test_a_stop_is_kept_until_reset_and_resetting_does_not_enable(driving):
    driving.driver.stop("stopped on request")
    driving.driver.stop("later")
    assert driving.link.sent[-1] == "stop"
    assert driving.driver.state == "stopped: stopped on request"
    said = driving.driver.diagnostics(driving.now)
    assert (said["outputs"], said["commander"]) == ("0", "")
    driving.refuses("stopped on request; reset first")
    driving.driver.reset()
    driving.pass_time(1.0, command=3.0)
    assert driving.driver.state == "idle" and driving.link.sent[-1] == "stop"
    driving.driver.enable(driving.now)
    assert driving.pass_time(0.1, command=3.0) == "" and driving.link.sent[-1] == [3000, 0, 0, 0]


COMMAND_TIMEOUT = CAUSES.index("command timeout")
OFF_CURRENT = CAUSES.index("current with all outputs off")
STOPS = [  # what happens to a bench that is driven with 3 V, and the reason
    ({"ampere": 3.4}, "over-current: wire at 3.40 A, limit 3 A"),
    ({"kelvin": 430.0}, "over-temperature: wire at 156.9 degC, limit 150.0 degC"),
    ({"ampere": 0.0}, "disagreement: wire carries 0.00 A at 3.00 V"),
    ({"volt": 0.0}, "disagreement: wire gets 0.00 V, commanded 3.00 V"),
    ({"kelvin": 390.0}, "heating rate: wire rises by 1800 K/s"),
    ({"volt": 10.8}, "over-current"),
    ({"leak": 0.4}, "short circuit: the front board carries 0.6"),
    (lambda b: b.guard.recorder("disk full"), "recording failed: disk full"),
    (lambda b: b.says(state=DeviceState.STOPPED, cause=COMMAND_TIMEOUT, silence="V refused"),
     "command timeout, found by the device (V refused)"),
    (lambda b: b.says(connected=False, problem="silent"), "not connected: silent"),
    (lambda b: b.says(unasked="device refused A: armed already"),
     "another host speaks to the device: it answered 'device refused A"),
    (lambda b: setattr(b, "now", b.now + 1.2), "stale feedback: nothing new from wire/"),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "reason"), STOPS, ids=[reason for _, reason in STOPS])
def test_a_broken_rule_stops_with_its_reason_until_a_reset(driving, wrong, reason):
    if callable(wrong):
        wrong(driving)
        found = driving.driver.tick(driving.now)
    else:
        found = driving.pass_time(2.0, command=3.0, **wrong)
    assert found.startswith(reason)
    assert driving.link.sent[-1] == "stop" and not driving.link.armed
    if driving.link.status.connected:
        assert driving.driver.state == f"stopped: {found}"
        driving.refuses("stopped: ")
        driving.says(unasked="")
        driving.driver.reset()
        driving.pass_time(0.1)
        driving.driver.enable(driving.now)
        assert driving.pass_time(0.1, command=3.0) == ""


def test_too_much_power_and_too_many_volts_stop_and_without_feedback_nothing_begins():
    hot, low = Bench(enabled=True, maximum_power=3.0), Bench(enabled=True, maximum_voltage=2.0)
    assert hot.pass_time(1.0, command=3.0) == "over-power: wire takes 3.3 W, limit 3 W"
    assert low.pass_time(1.0, volt=2.6).startswith("over-voltage: wire gets 2.60 V, limit 2 V")
    Bench(seconds=0.0).refuses("no feedback: wire/power was never received")


def test_enabling_runs_the_self_test_first_unless_it_was_run_or_is_waived(bench):
    """The self-test refuses a driven bench, and finds a stop that fails and a stuck switch."""
    assert bench.driver.tested == "due"
    found = bench.driver.self_test()
    checks = ["connection", "link", "clock", "supply", "currents", "relay", "stop"]
    assert [f.check for f in found] == checks
    assert [f.check for f in found if not f.passed] == ["clock"]
    assert bench.driver.state == "idle"
    for broken, why in (("deaf", "self-test: stop: FAILED"),
                        ("stuck", "relay: FAILED, .*current with all outputs off")):
        setattr(bench.link, broken, True)
        assert broken == "stuck" or not bench.driver.self_test()[-1].passed
        bench.refuses(why)
        setattr(bench.link, broken, False)
    bench.driver.enable(bench.now)
    assert bench.driver.tested == "passed"
    with pytest.raises(LinkError, match="enabled: stop first"):
        bench.driver.self_test()
    bench.driver.stop("a fault")
    assert bench.driver.tested == "due"
    assert Bench(waiver="no relay here").driver.tested == "waived: no relay here"


def test_a_late_answer_is_requested_again_at_rest_but_not_for_ever(bench):
    for letter in "CAR":
        bench.link.late[letter] = 2
        bench.driver.enable(bench.now)
        assert bench.link.late[letter] == 0 and bench.driver.state == "enabled"
        bench.driver.stop("a fault")
        bench.link.late["R"] = 1
        bench.driver.reset()
    for letter, why in (("A", "relay: FAILED, no answer to A"), ("C", "no answer to C")):
        bench.link.late[letter] = 100
        bench.refuses(why)
        assert not bench.link.armed and bench.driver.state == "idle"
        bench.link.late.clear()


def test_a_wrong_answer_is_not_requested_again_and_without_a_device_nothing_is(bench):
    bench.link.stuck = True
    assert not bench.driver.self_test()[-2].passed and bench.link.armings == 1
    bench.link.stuck, bench.link.armed = False, True
    assert not bench.driver.self_test()[-2].passed and bench.link.armings == 2
    for missing in ({"connected": False}, {"connected": True, "device": None}):
        bench.says(**missing)
        assert [str(f) for f in bench.driver.self_test()] == ["connection: FAILED, no reading yet"]
    assert [f.check for f in Bench(seconds=0.0).driver.self_test()] == ["connection"]


def test_frames_that_are_late_are_not_taken_for_those_of_a_closed_relay(bench):
    """Frames from before the relay closed show no current and no stop: they prove nothing."""
    bench.link.leaks, bench.link.lag = 0.5, 0.4
    bench.refuses("relay: FAILED, closed, nothing driven: at most 0.50 A")
    bench.link.leaks, bench.link.lag, begun = 0.0, 100.0, bench.link.device_time
    bench.refuses("relay: FAILED, the device's readings are late")
    assert bench.link.device_time - begun < 15.0  # relay and stop, three times each
    assert not bench.link.armed
    bench.link.lag = 0.5
    bench.says(newest=None)  # nothing came yet
    bench.driver.enable(bench.now)


def test_the_device_gets_the_rigs_limits_within_its_own_and_one_beyond_is_refused():
    volts, mean, peak, least, hot, cooling = Bench(enabled=True).link.limits
    assert (volts, mean, peak) == (10000, 6500, 12000)
    assert least == pytest.approx(1e3 * 0.7 * RESISTANCE, abs=1)
    assert 7400 < hot <= 8000 and 150 < cooling < 250
    less = {"maximum_current": 1.0, "maximum_temperature": 330.0, "maximum_voltage": 5.0}
    small = Bench(enabled=True, **less).link.limits
    assert small[:2] == [6000, 2400] and small[4] < 4500
    warmer_room = {"bench.maximum_temperature": 300.0, "environment.ambient_temperature": 305.0}
    cool = Limits.from_parameters(Parameters(warmer_room))
    least_hot = 1.1 * (cool.heat_loss * cool.heated) ** 0.5  # as of a kelvin above the room
    assert device_limits(cool, DEVICE, SUPPLY)[4] == pytest.approx(1e3 * least_hot, abs=1)
    hasty = Bench()
    hasty.says(device=replace(DEVICE, command_timeout=0.05))
    hasty.refuses("the device's timeout is 0.05 s: too short")
    hasty.says(device=replace(DEVICE, command_timeout=0.07))
    hasty.driver.enable(hasty.now)
    pair = Limits.from_parameters(Parameters({"wire.count": 2}))
    assert pair.circuit == pytest.approx(RESISTANCE / 2.0)
    for drive in ({}, {"drive": "duty", "supply_voltage": 12.0}):
        beyond = Bench(maximum_voltage=12.0, **drive)
        beyond.refuses("maximum_voltage is 12 V, the device allows 10 V")


def test_current_with_all_outputs_off_stops_and_is_reported_until_it_ends(bench):
    assert "0.50 A through the front board with its outputs off" in bench.pass_time(0.5, leak=0.5)
    assert bench.driver.state.startswith("still flowing: pull the plug (0.50 A")
    assert bench.link.sent[-1] == "stop"
    bench.pass_time(0.3)
    assert bench.driver.state.startswith("stopped: 0.50 A through the front board")
    bench = Bench()
    bench.says(state=DeviceState.STILL_FLOWING, cause=OFF_CURRENT)
    assert bench.driver.state == "still flowing: pull the plug (current with all outputs off)"
    bench.refuses("still flowing: pull the plug")
    with pytest.raises(LinkError, match="still flowing: pull the plug"):
        bench.driver.reset()


def test_an_open_wire_beside_a_driven_one_keeps_the_drive_off_until_it_is_whole(monkeypatch):
    found = ["open: front_2 takes 0% of its current"]
    monkeypatch.setattr(SharedWatch, "power", lambda *_: found[0])
    made, sensors = Bench(), BenchSensors(["front", "front"], SETTINGS)
    made.driver = BenchDriver(made.link, sensors, Guard(["a", "b"], ["power"], 1.0), ["a", "b"],
                              Limits.from_parameters(Parameters()), pause=made.link.pass_time)
    made.guard.temperature = lambda *_: None
    made.read()
    made.refuses("open: front_2")
    found[0] = ""
    made.read()
    made.driver.enable(made.now)


def test_a_duty_is_driven_as_the_direct_voltage_of_its_heat():
    bench = Bench(enabled=True, drive="duty", supply_voltage=12.0, maximum_voltage=8.0)
    assert bench.link.limits[0] == DEVICE.maximum_voltage * 1e3  # 9.8 V and a margin
    assert bench.pass_time(1.0, command=0.75) == ""
    assert bench.link.sent[-1] == [3000, 0, 0, 0]  # sqrt(0.75 V x 12 V)
    assert [p.voltage for p in bench.driver.newest.powers] == pytest.approx([3.0])
    # 6 V are expected.
    assert "disagreement" in bench.pass_time(3.0, command=3.0, volt=0.5)
