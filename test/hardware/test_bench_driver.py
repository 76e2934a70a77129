"""Who may drive the bench, and what stops it: the driver on a link that obeys the test."""

import pytest

from sma_bench.errors import InputError
from sma_bench.hardware.bench_driver import BenchDriver
from sma_bench.hardware.bench_sensors import BenchSensors, device_channels
from sma_bench.hardware.conversation import LinkError
from sma_bench.hardware.device import DeviceIdentity, LinkStatus, Reading
from sma_bench.hardware.expectation import SharedWatch
from sma_bench.hardware.safety import Guard, Limits
from sma_bench.hardware.serial_messages import CAUSES, DeviceState, Telemetry
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SERIAL_BRIDGE

SETTINGS = {parameter.name: parameter.default for parameter in SERIAL_BRIDGE}
DEVICE = DeviceIdentity(
    "sma-uno", "0", "power-on", 10.0, 0.2, 0.9, 6.5, 12.0, 900.0, (6.0, 15.0), 1.0, 8.0, 2.0
)
SUPPLY = 12.0
RESISTANCE = 2.6987


class FakeLink:
    """Does as it is told and remembers it."""

    def __init__(self):
        self.status = LinkStatus(connected=True, device=DEVICE, connections=1)
        self.sent, self.limits = [], []
        self.armed = self.deaf = self.stuck = False

    def limit(self, numbers):
        self.limits = list(numbers)

    def arm(self):
        self.armed = True
        self.status.state = DeviceState.ARMED
        if self.stuck:
            self.stop()
            self.status.cause = CAUSES.index("current with all outputs off")

    def drive(self, millivolts):
        if not self.armed:
            raise LinkError("not armed")
        self.sent.append(list(millivolts))
        return len(self.sent)

    def stop(self):
        self.armed = False
        self.sent.append("stop")
        if not self.deaf:
            self.status.state, self.status.cause = DeviceState.STOPPED, CAUSES.index("stop byte")

    def reset(self):
        self.status.state = DeviceState.IDLE


class Bench:
    """A driver of one wire; `pass_time` lets readings come that agree with the last command."""

    def __init__(self, waiver="", enabled=False, seconds=0.1, **contract):
        self.link = FakeLink()
        self.now = 100.0
        parameters = Parameters({f"bench.{name}": value for name, value in contract.items()})
        guard = Guard(["wire"], ["power", "temperature"], 1.0)
        self.driver = BenchDriver(
            self.link, BenchSensors(["front"], SETTINGS), guard, ["wire"],
            Limits.from_parameters(parameters), waiver=waiver, pause=lambda _: None,
        )
        self.pass_time(seconds)
        if enabled:
            self.driver.enable(self.now)

    def read(self, volt=0.0, ampere=None, kelvin=300.0, leak=0.0):
        duty = (volt / SUPPLY) ** 2
        mean = leak + duty**0.5 * (volt / RESISTANCE if ampere is None else ampere)
        telemetry = Telemetry(
            0, 0, 0, 0, SUPPLY, (mean, 0.0), (1.5, 1.5), (duty, 0.0, 0.0, 0.0), 0
        )
        self.driver.take(Reading(telemetry, self.now), self.now)
        self.driver.temperature("wire", kelvin, self.now, self.now)

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
    assert "not enabled (idle)" in bench.driver.command([2.0], bench.now)
    assert bench.driver.command([0.0], bench.now) == ""
    bench.pass_time(0.1)
    assert bench.link.sent == [] and bench.driver.gate.rejected == 1
    bench.driver.enable(bench.now)
    bench.pass_time(0.1)
    assert {tuple(s) for s in bench.link.sent if s != "stop"} == {(0, 0, 0, 0)}
    bench.refuses("enabled already")


def test_a_command_is_repeated_until_its_timeout_then_zero_is_sent(driving):
    driving.link.sent.clear()
    assert driving.pass_time(1.0) == ""
    assert (driving.link.sent[0], driving.link.sent[-1]) == ([3000, 0, 0, 0], [0, 0, 0, 0])
    assert (driving.driver.gate.timeouts, driving.driver.state) == (1, "enabled")


def test_a_stop_is_kept_until_reset_and_resetting_does_not_enable(driving):
    driving.driver.stop("stopped on request")
    assert driving.link.sent[-1] == "stop"
    assert driving.driver.state == "stopped: stopped on request"
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
    (lambda b: b.driver.recorder("disk full"), "recording failed: disk full"),
    (lambda b: b.says(state=DeviceState.STOPPED, cause=COMMAND_TIMEOUT, silence="V refused"),
     "command timeout, found by the device (V refused)"),
    (lambda b: b.says(connected=False, problem="silent"), "not connected: silent"),
    (lambda b: b.says(unasked="device refused A: armed already"),
     "another host speaks to the device: it answered 'device refused A"),
    (lambda b: setattr(b, "now", b.now + 1.2), "stale feedback: nothing new from wire/"),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "reason"), STOPS, ids=[reason for _, reason in STOPS])
def test_what_breaks_a_rule_stops_and_says_why_until_it_is_reset(driving, wrong, reason):
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


def test_self_test_needs_a_bench_that_is_not_driven_and_finds_a_stop_that_fails(bench):
    assert [f.check for f in bench.driver.self_test() if not f.passed] == ["clock"]
    assert bench.driver.state == "idle"
    bench.link.deaf = True
    assert not bench.driver.self_test()[-1].passed
    bench.refuses("self-test: stop: FAILED")
    bench.link.deaf = False
    bench.driver.enable(bench.now)
    with pytest.raises(LinkError, match="enabled: stop first"):
        bench.driver.self_test()


def test_enabling_tests_itself_first_unless_it_has_or_somebody_says_why_not(bench):
    assert bench.driver.tested == "due"
    bench.link.stuck = True
    bench.refuses("relay: FAILED, .*current with all outputs off")
    bench.link.stuck = False
    bench.driver.enable(bench.now)
    assert bench.driver.tested == "passed"
    bench.driver.stop("a fault")
    assert bench.driver.tested == "due"
    assert Bench(waiver="no relay here").driver.tested == "waived: no relay here"


def test_the_device_gets_the_rigs_limits_within_its_own_and_one_beyond_is_refused():
    volts, mean, peak, least, hot, cooling = Bench(enabled=True).link.limits
    assert (volts, mean, peak) == (10000, 6500, 12000)
    assert least == pytest.approx(1e3 * 0.7 * RESISTANCE, abs=1)
    assert 7400 < hot <= 8000 and 150 < cooling < 250
    small = Bench(
        enabled=True, maximum_current=1.0, maximum_temperature=330.0, maximum_voltage=5.0
    ).link.limits
    assert small[:2] == [6000, 2400] and small[4] < 4500
    pair = Limits.from_parameters(Parameters({"wire.count": 2}))
    assert pair.model.circuit == pytest.approx(RESISTANCE / 2.0)
    for drive in ({}, {"drive": "duty", "supply_voltage": 12.0}):
        Bench(maximum_voltage=12.0, **drive).refuses(
            "maximum_voltage is 12 V, the device allows 10 V"
        )


def test_current_with_all_outputs_off_stops_and_shouts_until_it_ends(bench):
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


def test_more_current_than_the_outputs_explain_is_a_short_circuit_at_once(driving):
    reason = driving.pass_time(0.2, command=3.0, leak=0.4)
    assert "short circuit: the front board carries 0.6" in reason


def test_sensors_and_outputs_are_those_of_the_sides():
    assert device_channels(["front"]) == (0,)
    assert device_channels(["front", "front", "back", "back"]) == (0, 1, 2, 3)
    assert device_channels(["back", "front", "back"]) == (2, 0, 3)
    with pytest.raises(InputError, match="2 channels at the front"):
        device_channels(["front", "front", "front"])

    def deflection(front, back, sensors=("front", "back")):
        settings = {**SETTINGS, "range.sensors": sensors, "range.front_standoff": 0.09}
        return BenchSensors(["front", "back"], settings)._deflection(front, back)

    inf, nan = float("inf"), float("nan")
    assert deflection(0.08, 0.112) == pytest.approx(0.011)
    assert deflection(inf, 0.112) == pytest.approx(0.012)
    assert deflection(0.08, 0.2, ("front",)) == pytest.approx(0.010)
    assert BenchSensors(["front"], SETTINGS).range_sensors == ()
    assert deflection(inf, inf) == pytest.approx(nan, nan_ok=True)
    with pytest.raises(InputError, match="'top', expected front or back"):
        BenchSensors(["front"], {**SETTINGS, "range.sensors": ("top",)})


@pytest.mark.parametrize("sensor", ["supply", "front_current", "back_current"])
def test_a_calibration_far_from_nominal_is_refused(sensor):
    table = {parameter.name: parameter for parameter in SERIAL_BRIDGE}
    for name, values in (("gain", (-1.0, 0.0, 0.4, 2.1, 100.0)), ("offset", (-2.1, 2.1))):
        for value in values:
            with pytest.raises(InputError, match=f"calibration.{sensor}.{name} is"):
                table[f"calibration.{sensor}.{name}"].validated(value, "test")


def test_an_open_wire_beside_a_driven_one_keeps_the_drive_off_until_it_is_whole(monkeypatch):
    found = ["open: front_2 takes 0% of its current"]
    monkeypatch.setattr(SharedWatch, "power", lambda *_: found[0])
    made, sensors = Bench(), BenchSensors(["front", "front"], SETTINGS)
    assert sensors.shared == ((0, 1),) and BenchSensors(["front", "back"], SETTINGS).shared == ()
    made.driver = BenchDriver(
        made.link, sensors, Guard(["a", "b"], ["power"], 1.0), ["a", "b"],
        Limits.from_parameters(Parameters()),
    )
    made.driver.temperature = lambda *_: None
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
    assert bench.driver.applied == pytest.approx((3.0,))
    # 6 V are expected.
    assert "disagreement" in bench.pass_time(3.0, command=3.0, volt=0.5)
