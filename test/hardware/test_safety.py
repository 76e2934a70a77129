"""Safety rules: what is refused, what trips and stays tripped; commands, model and readings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.hardware.expectation import Lasting, SharedWatch, WireModel, WireWatch
from sma_bench.hardware.safety import (
    CommandGate,
    Freshness,
    Guard,
    Interlock,
    Limits,
    Watchdog,
    command_fault,
    current_fault,
    temperature_fault,
)
from sma_bench.parameters import Parameters

LIMITS = Limits.from_parameters(Parameters.defaults())


def test_limits_are_those_of_the_contract_inclusive_and_nan_is_no_reading():
    assert (LIMITS.maximum_voltage, LIMITS.maximum_current) == (10.0, 3.0)
    assert (LIMITS.maximum_temperature, LIMITS.command_timeout) == (423.15, 0.5)
    assert (LIMITS.maximum_power, LIMITS.maximum_heating_rate) == (30.0, 1500.0)
    assert temperature_fault("wire", 423.15, LIMITS) == ""
    assert "wire at 150.1 degC, limit 150.0 degC" in temperature_fault("wire", 423.25, LIMITS)
    assert temperature_fault("wire", math.nan, LIMITS) == ""
    assert current_fault("wire", 3.0, LIMITS) == current_fault("wire", math.nan, LIMITS) == ""
    assert "over-current: wire at -3.10 A" in current_fault("wire", -3.1, LIMITS)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ([], "has 0 values, expected 2"),
        ([1.0], "has 1 values, expected 2"),
        ([1.0, math.nan], "has nan"),
        ([math.inf, 1.0], "has inf"),
        ([1.0, -0.1], "has -0.1 V, expected 0 to 10 V"),
        ([10.1, 1.0], "has 10.1 V, expected 0 to 10 V"),
    ],
)
def test_a_bad_command_has_a_reason(command, reason):
    assert reason in command_fault(command, 2, LIMITS)


@given(st.lists(st.floats(), max_size=4))
def test_an_accepted_command_is_always_as_long_and_as_large_as_the_bench_allows(command):
    if not command_fault(command, 2, LIMITS):
        assert len(command) == 2
        assert all(0.0 <= v <= 10.0 for v in command)


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.inf, math.nan])
def test_a_watchdog_cannot_be_switched_off(timeout):
    with pytest.raises(ValueError, match="positive and finite"):
        Watchdog(timeout)


def test_a_watchdog_is_expired_until_fed_and_when_its_clock_goes_back():
    watchdog = Watchdog(0.5)
    assert watchdog.expired(0.0)
    watchdog.feed(10.0)
    assert not watchdog.expired(10.5)
    assert watchdog.expired(10.51)
    assert watchdog.expired(9.9)
    assert watchdog.expired(math.nan)


def test_gate_keeps_the_outputs_on_a_bad_command_and_zeroes_them_on_silence():
    gate = CommandGate(2, LIMITS)
    assert gate.outputs(0.0) == (0.0, 0.0)
    assert gate.command([1.0, 2.0], 1.0) == ""
    assert "nan" in gate.command([math.nan, 2.0], 1.2)
    assert gate.outputs(1.5) == (1.0, 2.0)
    assert gate.outputs(1.51) == (0.0, 0.0)
    assert gate.outputs(9.0) == (0.0, 0.0)
    assert (gate.accepted, gate.rejected, gate.timeouts) == (1, 1, 1)
    gate = CommandGate(1, LIMITS)
    gate.command([3.0], 0.0)
    for k in range(1, 20):
        gate.command([math.nan], 0.1 * k)
    assert gate.outputs(0.6) == (0.0,)


def test_the_same_reading_again_is_not_fresh_and_the_first_reason_stays():
    fresh = Freshness("wire/power", 1.0)
    assert "never received" in fresh.fault(0.0)
    fresh.seen(stamp=5.0, now=100.0)
    fresh.seen(stamp=5.0, now=100.9)
    assert fresh.fault(101.0) == ""
    assert "nothing new from wire/power for 1.10 s, limit 1 s" in fresh.fault(101.1)
    fresh.seen(stamp=1.0, now=101.2)  # a restarted clock
    assert fresh.fault(101.3) == ""
    interlock = Interlock()
    interlock.trip("")
    assert not interlock.tripped
    interlock.trip("hot")
    interlock.trip("stale")
    assert interlock.reason == "hot"
    interlock.reset()
    assert not interlock.tripped


def guard(feedback=("power", "temperature")):
    made = Guard(["a", "b"], feedback, 1.0)
    for channel in ("a", "b"):
        made.power(channel, 1.0, 0.5, stamp=1.0, now=1.0, limits=LIMITS)
        made.temperature(channel, 300.0, stamp=1.0, now=1.0, limits=LIMITS)
    return made


def test_guard_is_content_with_fresh_cool_wires_and_names_the_one_that_is_not():
    assert guard().fault(1.5) == ""
    hot = guard()
    hot.temperature("b", 430.0, stamp=1.1, now=1.1, limits=LIMITS)
    assert hot.fault(1.5).startswith("over-temperature: b")
    loaded = guard()
    loaded.power("a", 9.0, 3.3, stamp=1.1, now=1.1, limits=LIMITS)
    assert loaded.fault(1.5).startswith("over-current: a")
    made = guard()
    made.recorder("bag: cannot be written: No space left on device")
    assert made.fault(1.5) == "recording failed: bag: cannot be written: No space left on device"
    made.recorder("")
    assert made.fault(1.5) == ""


def test_guard_without_a_camera_goes_by_the_model_only_where_no_temperature_comes():
    made = Guard(["a"], ["power"], 1.0)
    made.power("a", 1.0, 0.5, stamp=1.0, now=1.0, limits=LIMITS)
    assert made.fault(1.5) == ""
    made.temperature("a", 500.0, stamp=1.0, now=1.0, limits=LIMITS)
    assert "over-temperature" in made.fault(1.5)
    made = Guard(["a"], ["power"], 1.0)
    for k in range(400):
        now = 0.01 * k
        volt = 8.0 if k > 200 else 0.0
        made.power("a", volt, volt / LIMITS.model.resistance, stamp=now, now=now, limits=LIMITS)
        if k < 300:
            made.temperature("a", 340.0, stamp=now, now=now, limits=LIMITS)
            assert made.fault(now) == ""
    for k in range(400, 420):
        now = 0.01 * k
        made.power("a", 8.0, 8.0 / LIMITS.model.resistance, stamp=now, now=now, limits=LIMITS)
    assert made.fault(now).startswith("over-temperature by the model: a at 171")


@pytest.mark.parametrize("volt", [math.inf, -math.inf, 3e38, -3e38])
def test_one_reading_beyond_all_measure_does_not_blind_the_model_rule(volt):
    """6 V for 12 s at a wire that stays cold is a fault, whatever was read once before."""
    made = Guard(["a"], ["power", "temperature"], 1.0)
    made.power("a", volt, 1.0, stamp=0.9, now=0.9, limits=LIMITS)
    fault = ""
    for k in range(1200):
        now = 1.0 + 0.01 * k
        made.commanded([6.0])
        made.power("a", 6.0, 6.0 / 2.6987, stamp=now, now=now, limits=LIMITS)
        made.temperature("a", 296.15, stamp=now, now=now, limits=LIMITS)
        fault = fault or (made.fault(now) if k > 10 else "")
    assert fault.startswith("disagreement: a measured at 23 degC")


@pytest.mark.parametrize("volt", [math.inf, 3e38])
def test_after_a_reading_beyond_all_measure_a_wire_that_does_as_it_should_is_left_alone(volt):
    made = Guard(["a"], ["power"], 1.0)
    made.power("a", volt, 0.0, stamp=0.0, now=0.0, limits=LIMITS)
    assert made.fault(0.0).startswith("over-voltage: a gets")
    for k in range(1, 500):
        now = 0.01 * k
        made.commanded([0.0])
        made.temperature("a", 296.15, stamp=now, now=now, limits=LIMITS)
        made.power("a", 0.0, 0.0, stamp=now, now=now, limits=LIMITS)
        assert made.fault(now) == ""


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_makes_nothing_fresh(wrong):
    made, blind = guard(), math.isnan(wrong)
    for k in range(30):
        now = 1.0 + 0.1 * k
        for channel in ("a", "b"):
            ampere = wrong if blind else 0.5
            made.power(channel, 1.0, ampere, stamp=now, now=now, limits=LIMITS)
            made.temperature(channel, wrong, stamp=now, now=now, limits=LIMITS)
    stale = "stale feedback: nothing new from a/temperature"
    assert made.fault(3.95).startswith(stale if blind else "") and made.fault(3.95) != ""


def test_a_second_commander_is_refused_until_the_first_is_silent():
    gate = CommandGate(1, LIMITS)
    assert gate.command([3.0], 0.0, "/bench/experiment#1") == ""
    for k in range(1, 100):
        now = 0.02 * k
        assert gate.command([3.0], now, "/bench/experiment#1") == ""
        reason = gate.command([6.0], now, "/bench/experiment#2")
        assert reason == "/bench/experiment: /bench/experiment commands already"
        assert "a node without a name: /bench/experiment commands" in gate.command([6.0], now)
        assert gate.outputs(now) == (3.0,)
    assert gate.commander == "/bench/experiment"
    assert (gate.rejected, gate.last_rejection) == (198, gate.last_rejection)
    assert gate.command([6.0], now + 0.49, "/bench/experiment#2") != ""
    assert gate.command([6.0], now + 0.51, "/bench/experiment#2") == ""
    assert gate.outputs(now + 0.51) == (6.0,)
    assert gate.command([3.0], now + 0.52, "/bench/experiment#1") != ""


def test_zero_volts_are_obeyed_from_anybody_and_make_nobody_the_commander():
    gate = CommandGate(1, LIMITS)
    gate.command([3.0], 0.0, "/first#1")
    for k in range(1, 40):
        now = 0.02 * k
        assert gate.command([0.0], now, "/bench/dashboard#2") == ""
        assert gate.command([3.0], now, "/first#1") == ""
        assert gate.outputs(now) == (0.0,)
    assert gate.command([6.0], now, "/bench/dashboard#2") != ""
    for k in range(1, 40):
        gate.command([3.0], now + 0.02 * k, "/first#1")
    assert gate.outputs(now + 0.78) == (3.0,)
    gate = CommandGate(1, LIMITS)
    gate.command([0.0], 0.0, "/done#1")
    assert "commands already" in gate.command([3.0], 0.1, "/second#2")
    gate.clear()
    assert gate.command([3.0], 0.2, "/second#2") == ""


MODEL = WireModel.from_parameters(Parameters.defaults())
PERIOD = 0.01


def watch(commanded=3.0):
    made = WireWatch("wire", 1.0)
    made.commanded(commanded)
    return made


def powered(wire, volt, ampere, seconds, start=0.0, model=MODEL):
    """Reason after readings of `seconds`, ten ms apart."""
    reason = ""
    for k in range(round(seconds / PERIOD) + 1):
        now = start + k * PERIOD
        reason = wire.power(volt, ampere, now, now, model)
    return reason


def test_a_deviation_must_last_without_a_gap():
    lasting = Lasting(1.0)
    assert [lasting.note("far", 0.1 * k) for k in range(10)] == [""] * 10
    assert lasting.note("far", 1.0) == "far"
    assert lasting.note("", 1.1) == ""
    assert lasting.note("far", 1.2) == ""
    lasting = Lasting(1.0)
    assert lasting.note("far", 0.0) == ""
    assert lasting.note("far", 20.0) == ""


def test_a_wire_that_does_as_commanded_is_left_alone():
    assert powered(watch(), 3.0, 3.0 / MODEL.resistance, 3.0) == ""
    assert powered(watch(), 3.0, math.nan, 3.0) == ""
    assert powered(watch(0.9), 0.9, 0.0, 2.0) == ""
    wire = watch(0.0)
    for k in range(300):
        wire.commanded(6.0 if k % 2 else 0.0)
        now = k * PERIOD
        assert wire.power(6.0, 6.0 / MODEL.resistance, now, now, MODEL) == ""


def test_a_voltage_or_a_current_that_does_not_follow_is_told_with_both_numbers():
    assert powered(watch(), 0.0, 0.0, 0.9) == ""
    reason = powered(watch(), 0.0, 0.0, 1.1)
    assert reason == "disagreement: wire gets 0.00 V, commanded 3.00 V, tolerance 0.25 V"
    for volt in (2.0, 4.0, 6.0):
        assert "disagreement" in powered(watch(volt), volt, 0.5 * volt / MODEL.resistance, 1.1)


@pytest.mark.parametrize(
    ("commanded", "volt"), [(0.0, 0.2), (0.4, 0.0), (0.4, 0.6), (8.0, 8.6), (8.0, 7.4)]
)
def test_every_voltage_is_checked_small_ones_too(commanded, volt):
    ampere = volt / MODEL.resistance
    assert f"commanded {commanded:.2f} V" in powered(watch(commanded), volt, ampere, 1.1)
    near = commanded + 0.2 * (volt - commanded)
    assert powered(watch(commanded), near, near / MODEL.resistance, 1.1) == ""


@pytest.mark.parametrize(("ampere", "word"), [(0.0, "0.00 A"), (2.5, "2.50 A")])
def test_a_broken_or_shorted_wire_disagrees_with_its_resistance(ampere, word):
    reason = powered(watch(), 3.0, ampere, 1.1)
    assert reason.startswith(f"disagreement: wire carries {word} at 3.00 V, the model says 1.11 A")


def test_the_model_heats_as_equation_1_with_its_leads():
    steady = MODEL.ambient + 9.0 / MODEL.resistance / MODEL.heat_loss
    assert MODEL.warmed(MODEL.ambient, 3.0, 100.0) == pytest.approx(steady)
    early = MODEL.warmed(MODEL.ambient, 3.0, 1e-3) - MODEL.ambient
    assert early == pytest.approx(1e-3 * 9.0 / MODEL.resistance / MODEL.heat_capacity, rel=0.01)
    model = WireModel.from_parameters(
        Parameters.defaults().replace({"bench.lead_resistance": MODEL.resistance})
    )
    volt, ampere = 6.0, 6.0 / (2.0 * MODEL.resistance)
    rise = (0.5 * volt) ** 2 / MODEL.resistance / MODEL.heat_loss
    assert model.warmed(MODEL.ambient, volt, 100.0) == pytest.approx(MODEL.ambient + rise)
    assert model.heating_voltage(volt, ampere) == pytest.approx(volt)
    assert "disagreement" in powered(watch(volt), volt, ampere, 1.1)
    assert powered(watch(volt), volt, ampere, 1.1, model=model) == ""


def heat_after(readings, wire=None):
    """Verdict on the wire's heat after (volt, ampere, s) each."""
    wire, now = wire or watch(), 0.0
    for volt, ampere, seconds in readings:
        for _ in range(round(seconds / PERIOD)):
            now += PERIOD
            wire.power(volt, ampere, now, now, MODEL)
    return wire.heat(MODEL)


REST = (0.0, 0.0, 2.0)
R = MODEL.resistance


@pytest.mark.parametrize(
    ("volt", "ampere"),
    [
        (8.0, 8.0 / R),
        (8.0, 0.0),  # the sensor is dead
        (8.0, math.nan),
        (6.5, 8.0**2 / R / 6.5),  # less resistance than the model's, more heat
        (math.nan, 8.0 / R),
        (0.0, 8.0 / R),  # a switch that does not open
    ],
)
def test_a_wire_that_nobody_sees_is_too_hot_by_the_model(volt, ampere):
    reason = heat_after([REST, (volt, ampere, 2.0)])
    assert reason.startswith("over-temperature by the model: wire at 17")
    assert "limit 150.0 degC" in reason


def test_a_wire_that_nobody_sees_is_as_hot_as_its_readings_allow():
    assert heat_after([REST, (7.0, 7.0 / R, 5.0)]) == ""
    assert heat_after([REST, (8.0, 8.0 / R, 0.1), REST, (8.0, 8.0 / R, 0.1)]) == ""
    reason = heat_after([(8.0, 8.0 / R, 0.05)])
    assert reason.startswith("over-temperature by the model: wire at 15")
    assert heat_after([(7.0, 7.0 / R, 0.05)]) == ""
    wire = watch()
    for stamp, volt in ((0.0, 0.0), (5.0, 9.0), (7.0, 0.0)):
        wire.power(volt, volt / R, stamp, stamp, MODEL)
    assert wire.heat(MODEL).startswith("over-temperature by the model: wire at 21")


def test_a_camera_that_sees_no_warming_disagrees():
    wire = watch()
    assert all(wire.temperature(400.0, 0.1 * k, MODEL) == "" for k in range(50))
    wire = watch(6.0)
    reasons = []
    for k in range(200):
        now = k * PERIOD
        wire.power(6.0, 6.0 / MODEL.resistance, now, now, MODEL)
        reasons.append(wire.temperature(MODEL.ambient, now, MODEL))
    assert reasons[50] == ""
    assert reasons[-1].startswith("disagreement: wire measured at 23 degC, the model says 107 degC")


def test_warming_faster_than_the_limit_is_told_but_not_a_jittering_stamp():
    wire = watch()
    assert wire.rate(300.0, 0.0, 1000.0) == ""
    assert wire.rate(340.0, 0.001, 1000.0) == ""
    reason = wire.rate(400.0, 0.05, 1000.0)
    assert reason == "heating rate: wire rises by 2000 K/s, limit 1000 K/s"
    assert wire.rate(300.0, 0.10, 1000.0) == ""
    assert wire.rate(math.nan, 0.2, 1000.0) == ""


def shared_readings(draw, volts, broken, seconds):
    """(volts, amperes) of two wires as one noisy sensor shares them out; phases follow in 0.3 s."""
    austenite = np.zeros(2)
    for k in range(round(seconds / PERIOD)):
        if k % 100 == 0:
            v = np.array(volts(draw))
        austenite += (np.where(v > 4.5, 1.0, 0.0) - austenite) * PERIOD / 0.3
        conductance = (1.0 + 0.17 * austenite) / R * (np.arange(2) != broken)
        total = math.hypot(*v) or 1.0
        mean = float(conductance @ v**2) / total + draw.normal(0.0, 0.06)
        amperes = mean * v / total
        yield v, np.where((v > 0.0) & (v < 0.3), np.nan, amperes)


def found_open(volts, broken, seed, seconds):
    draw = np.random.default_rng(seed)
    watch = SharedWatch(("front_1", "front_2"))
    for k, (v, i) in enumerate(shared_readings(draw, volts, broken, seconds)):
        if reason := watch.power(v, i, PERIOD * k, MODEL):
            return reason
    return ""


def weak_beside_strong(draw):
    return 6.0, float(draw.choice([0.0, 1.5, 2.0]))


def apart(draw):
    return float(draw.uniform(3.0, 8.0)), float(draw.uniform(0.0, 2.5))


def alike(draw):
    volt = float(draw.uniform(0.0, 8.0))
    return volt, volt / 3.0


@pytest.mark.parametrize("volts", [weak_beside_strong, apart])
@pytest.mark.parametrize("seed", range(4))
def test_an_open_wire_beside_a_stronger_one_is_found_by_its_steps(volts, seed):
    reason = found_open(volts, 1, seed, 30.0)
    assert reason.startswith("open: front_2 takes ") and reason.endswith("beside front_1")


@pytest.mark.parametrize("volts", [weak_beside_strong, apart, alike])
def test_sound_wires_are_not_found_open_however_long_and_wherever_their_phases_are(volts):
    assert [found_open(volts, None, seed, 60.0) for seed in range(2)] == ["", ""]


def test_wires_that_always_step_alike_cannot_be_told_apart():
    assert found_open(alike, 1, 0, 30.0) == ""
