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
        self.sent = []
        self.armed = False
        self.deaf = False
        self.limits = []
        self.stuck = False

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

    def __init__(self, waiver="", **contract):
        self.link = FakeLink()
        self.now = 100.0
        parameters = Parameters({f"bench.{name}": value for name, value in contract.items()})
        guard = Guard(["wire"], ["power", "temperature"], 1.0)
        self.driver = BenchDriver(
            self.link, BenchSensors(["front"], SETTINGS), guard, ["wire"],
            Limits.from_parameters(parameters), waiver=waiver,
            pause=lambda _: None,
        )

    def read(self, volt=0.0, ampere=None, kelvin=300.0, leak=0.0):
        duty = (volt / SUPPLY) ** 2
        mean = leak + duty**0.5 * (volt / RESISTANCE if ampere is None else ampere)
        telemetry = Telemetry(
            0, 0, 0, 0, SUPPLY, (mean, 0.0), (1.5, 1.5), (duty, 0.0, 0.0, 0.0), 0
        )
        taken = self.driver.take(Reading(telemetry, self.now), self.now)
        self.driver.temperature("wire", kelvin, self.now, self.now)
        return taken

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


@pytest.fixture
def bench():
    made = Bench()
    made.pass_time(0.1)
    return made


@pytest.fixture
def driving(bench):
    bench.driver.enable(bench.now)
    assert bench.pass_time(0.5, command=3.0) == ""
    assert bench.link.sent[-1] == [3000, 0, 0, 0]
    return bench


def test_nothing_is_driven_before_somebody_enables(bench):
    assert bench.driver.state == "idle"
    assert "not enabled (idle)" in bench.driver.command([2.0], bench.now)
    assert bench.driver.command([0.0], bench.now) == ""
    bench.pass_time(0.1)
    assert bench.link.sent == []
    assert bench.driver.gate.rejected == 1
    bench.driver.enable(bench.now)
    bench.pass_time(0.1)
    assert {tuple(s) for s in bench.link.sent if s != "stop"} == {(0, 0, 0, 0)}
    with pytest.raises(LinkError, match="enabled already"):
        bench.driver.enable(bench.now)


def test_a_command_is_repeated_until_its_timeout_then_zero_is_sent(driving):
    driving.link.sent.clear()
    assert driving.pass_time(1.0) == ""
    assert driving.link.sent[0] == [3000, 0, 0, 0]
    assert driving.link.sent[-1] == [0, 0, 0, 0]
    assert driving.driver.gate.timeouts == 1
    assert driving.driver.state == "enabled"


def test_a_stop_is_kept_until_reset_and_resetting_does_not_enable(driving):
    driving.driver.stop("stopped on request")
    assert driving.link.sent[-1] == "stop"
    assert driving.driver.state == "stopped: stopped on request"
    with pytest.raises(LinkError, match="stopped on request; reset first"):
        driving.driver.enable(driving.now)
    driving.driver.reset()
    driving.pass_time(1.0, command=3.0)
    assert driving.driver.state == "idle" and driving.link.sent[-1] == "stop"
    driving.driver.enable(driving.now)


@pytest.mark.parametrize(
    ("reading", "reason"),
    [
        ({"ampere": 3.4}, "over-current: wire at 3.40 A, limit 3 A"),
        ({"kelvin": 430.0}, "over-temperature: wire at 156.9 degC, limit 150.0 degC"),
        ({"ampere": 0.0}, "disagreement: wire carries 0.00 A at 3.00 V"),
        ({"volt": 0.0}, "disagreement: wire gets 0.00 V, commanded 3.00 V"),
        ({"kelvin": 390.0}, "heating rate: wire rises by 1800 K/s"),
        ({"volt": 10.8}, "over-current"),
    ],
)
def test_a_reading_that_breaks_a_rule_stops_and_says_why(driving, reading, reason):
    assert driving.pass_time(2.0, command=3.0, **reading).startswith(reason)
    assert driving.link.sent[-1] == "stop"
    assert driving.driver.state.startswith(f"stopped: {reason}")


def test_too_much_power_and_too_many_volts_stop():
    hot = Bench(maximum_power=3.0)
    hot.pass_time(0.1)
    hot.driver.enable(hot.now)
    assert hot.pass_time(1.0, command=3.0) == "over-power: wire takes 3.3 W, limit 3 W"
    low = Bench(maximum_voltage=2.0)
    low.pass_time(0.1)
    low.driver.enable(low.now)
    assert low.pass_time(1.0, volt=2.6).startswith("over-voltage: wire gets 2.60 V, limit 2 V")


def test_missing_feedback_is_an_obstacle_and_stale_feedback_a_reason(driving):
    with pytest.raises(LinkError, match="no feedback: wire/power was never received"):
        Bench().driver.enable(100.0)
    driving.now += 1.2
    assert driving.driver.tick(driving.now).startswith("stale feedback: nothing new from wire/")


def test_a_device_that_stopped_or_left_is_the_reason(driving):
    driving.link.status.state = DeviceState.STOPPED
    driving.link.status.cause = CAUSES.index("command timeout")
    driving.link.status.silence = "device refused V: above the duty limit"
    reason = driving.pass_time(0.1, command=3.0)
    assert reason == (
        "command timeout, found by the device (device refused V: above the duty limit)"
    )


def test_a_lost_connection_is_the_reason(driving):
    driving.link.status.connected = False
    driving.link.status.problem = "the device is silent for 0.51 s"
    assert driving.pass_time(0.1) == "not connected: the device is silent for 0.51 s"
    driving.link.status.connected = True
    assert driving.driver.state.startswith("stopped: not connected")


def test_a_failed_recorder_stops_the_drive_and_a_reset_forgets_it(driving):
    driving.driver.recorder("disk full")
    assert driving.pass_time(0.1, command=3.0) == "recording failed: disk full"
    assert not driving.link.armed
    with pytest.raises(LinkError, match="stopped: recording failed"):
        driving.driver.enable(driving.now)
    driving.driver.reset()
    driving.pass_time(0.05)
    driving.driver.enable(driving.now)
    assert driving.pass_time(0.1, command=3.0) == ""


def test_an_answer_that_nobody_here_asked_for_stops_the_drive(driving):
    driving.link.status.unasked = "device refused A: armed already"
    reason = driving.pass_time(0.1, command=3.0)
    assert reason.startswith("another host speaks to the device: it answered 'device refused A")
    assert not driving.link.armed


def test_a_limit_beyond_the_devices_is_refused():
    bench = Bench(maximum_voltage=12.0)
    bench.pass_time(0.1)
    with pytest.raises(LinkError, match="maximum_voltage is 12 V, the device allows 10 V"):
        bench.driver.enable(bench.now)
    bench = Bench(drive="duty", supply_voltage=12.0, maximum_voltage=12.0)
    bench.pass_time(0.1)
    message = r"maximum_voltage is 12 V, the device allows 10 V"
    with pytest.raises(LinkError, match=message):
        bench.driver.enable(bench.now)


def test_self_test_needs_a_bench_that_is_not_driven_and_finds_a_stop_that_fails(bench):
    assert [f.check for f in bench.driver.self_test() if not f.passed] == ["clock"]
    assert bench.driver.state == "idle"
    bench.link.deaf = True
    assert not bench.driver.self_test()[-1].passed
    with pytest.raises(LinkError, match="self-test: stop: FAILED"):
        bench.driver.enable(bench.now)
    bench.link.deaf = False
    bench.driver.enable(bench.now)
    with pytest.raises(LinkError, match="enabled: stop first"):
        bench.driver.self_test()


def test_enabling_tests_itself_first_unless_it_has_or_somebody_says_why_not(bench):
    assert bench.driver.tested == "due"
    bench.link.stuck = True
    with pytest.raises(LinkError, match="relay: FAILED, .*current with all outputs off"):
        bench.driver.enable(bench.now)
    bench.link.stuck = False
    bench.driver.enable(bench.now)
    assert bench.driver.tested == "passed"
    bench.driver.stop("a fault")
    assert bench.driver.tested == "due"
    waiving = Bench(waiver="no relay here").driver
    assert waiving.tested == "waived: no relay here"


def test_the_device_gets_the_rigs_limits_within_its_own(bench):
    bench.driver.enable(bench.now)
    volts, mean, peak, least, hot, cooling = bench.link.limits
    assert (volts, mean, peak) == (10000, 6500, 12000)
    assert least == pytest.approx(1e3 * 0.7 * RESISTANCE, abs=1)
    assert 7400 < hot <= 8000 and 150 < cooling < 250
    small = Bench(maximum_current=1.0, maximum_temperature=330.0, maximum_voltage=5.0)
    small.pass_time(0.1)
    small.driver.enable(small.now)
    assert small.link.limits[0] == 6000 and small.link.limits[1] == 2400
    assert small.link.limits[4] < 4500
    parameters = Parameters({"wire.count": 2})
    assert Limits.from_parameters(parameters).model.circuit == pytest.approx(RESISTANCE / 2.0)


def test_current_with_all_outputs_off_stops_and_shouts_until_it_ends(bench):
    assert "0.50 A through the front board with its outputs off" in bench.pass_time(0.5, leak=0.5)
    assert bench.driver.state.startswith("still flowing: pull the plug (0.50 A")
    assert bench.link.sent[-1] == "stop"
    bench.pass_time(0.3)
    assert bench.driver.state.startswith("stopped: 0.50 A through the front board")


def test_a_device_that_says_current_still_flows_is_shouted_for(bench):
    bench.link.status.state = DeviceState.STILL_FLOWING
    bench.link.status.cause = CAUSES.index("current with all outputs off")
    assert bench.driver.state == "still flowing: pull the plug (current with all outputs off)"
    for request in (lambda: bench.driver.enable(bench.now), bench.driver.reset):
        with pytest.raises(LinkError, match="still flowing: pull the plug"):
            request()


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


def test_an_open_wire_beside_a_driven_one_stops_the_drive_until_it_is_reset(monkeypatch):
    found = ["open: front_2 takes 0% of its current"]
    monkeypatch.setattr(SharedWatch, "power", lambda *_: found[0])
    made = Bench()
    sensors = BenchSensors(["front", "front"], SETTINGS)
    assert sensors.shared == ((0, 1),) and BenchSensors(["front", "back"], SETTINGS).shared == ()
    guard = Guard(["a", "b"], ["power"], 1.0)
    limits = Limits.from_parameters(Parameters())
    made.driver = BenchDriver(made.link, sensors, guard, ["a", "b"], limits)
    made.driver.temperature = lambda *_: None
    made.read()
    with pytest.raises(LinkError, match="open: front_2"):
        made.driver.enable(made.now)
    found[0] = ""
    made.read()
    made.driver.enable(made.now)


def test_a_duty_is_driven_as_the_direct_voltage_of_its_heat():
    bench = Bench(drive="duty", supply_voltage=12.0, maximum_voltage=8.0)
    bench.pass_time(0.1)
    bench.driver.enable(bench.now)
    assert bench.link.limits[0] == DEVICE.maximum_voltage * 1e3  # 9.8 V and a margin
    assert bench.pass_time(1.0, command=0.75) == ""
    assert bench.link.sent[-1] == [3000, 0, 0, 0]  # sqrt(0.75 V x 12 V)
    assert bench.driver.applied == pytest.approx((3.0,))
    # 6 V are expected.
    assert "disagreement" in bench.pass_time(3.0, command=3.0, volt=0.5)
