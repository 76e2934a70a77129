"""Safety rules: what is refused, what trips, and what stays tripped."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

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


def test_limits_are_those_of_the_contract():
    assert (LIMITS.maximum_voltage, LIMITS.maximum_current) == (10.0, 3.0)
    assert (LIMITS.maximum_temperature, LIMITS.command_timeout) == (423.15, 0.5)
    assert (LIMITS.maximum_power, LIMITS.maximum_heating_rate) == (30.0, 1500.0)


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


def test_limits_are_inclusive_and_nan_is_no_reading():
    assert temperature_fault("wire", 423.15, LIMITS) == ""
    assert "wire at 150.1 degC, limit 150.0 degC" in temperature_fault("wire", 423.25, LIMITS)
    assert temperature_fault("wire", math.nan, LIMITS) == ""
    assert current_fault("wire", 3.0, LIMITS) == current_fault("wire", math.nan, LIMITS) == ""
    assert "over-current: wire at -3.10 A" in current_fault("wire", -3.1, LIMITS)


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


def test_bad_commands_do_not_feed_the_watchdog():
    gate = CommandGate(1, LIMITS)
    gate.command([3.0], 0.0)
    for k in range(1, 20):
        gate.command([math.nan], 0.1 * k)
    assert gate.outputs(0.6) == (0.0,)


def test_the_same_reading_again_is_not_fresh():
    fresh = Freshness("wire/power", 1.0)
    assert "never received" in fresh.fault(0.0)
    fresh.seen(stamp=5.0, now=100.0)
    fresh.seen(stamp=5.0, now=100.9)
    assert fresh.fault(101.0) == ""
    assert "nothing new from wire/power for 1.10 s, limit 1 s" in fresh.fault(101.1)
    fresh.seen(stamp=1.0, now=101.2)  # a restarted clock
    assert fresh.fault(101.3) == ""


def test_the_first_reason_stays_until_the_reset():
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


def test_guard_takes_a_nan_reading_for_none_at_all():
    blind = guard()
    for k in range(30):
        now = 1.0 + 0.1 * k
        for channel in ("a", "b"):
            blind.power(channel, 1.0, math.nan, stamp=now, now=now, limits=LIMITS)
            blind.temperature(channel, math.nan, stamp=now, now=now, limits=LIMITS)
    assert blind.fault(3.95).startswith("stale feedback: nothing new from a/temperature")


def test_guard_without_a_camera_demands_power_only_but_heeds_a_temperature_that_comes():
    made = Guard(["a"], ["power"], 1.0)
    made.power("a", 1.0, 0.5, stamp=1.0, now=1.0, limits=LIMITS)
    assert made.fault(1.5) == ""
    made.temperature("a", 500.0, stamp=1.0, now=1.0, limits=LIMITS)
    assert "over-temperature" in made.fault(1.5)


def test_guard_goes_by_the_model_only_where_no_temperature_comes():
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


def test_guard_minds_a_recorder_that_failed_until_another_records():
    made = guard()
    made.recorder("bag: cannot be written: No space left on device")
    assert made.fault(1.5) == "recording failed: bag: cannot be written: No space left on device"
    made.recorder("")
    assert made.fault(1.5) == ""


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


@pytest.mark.parametrize("wrong", [math.inf, -math.inf])
def test_what_is_no_number_makes_nothing_fresh(wrong):
    made = guard()
    for k in range(30):
        now = 1.0 + 0.1 * k
        for channel in ("a", "b"):
            made.power(channel, 1.0, 0.5, stamp=now, now=now, limits=LIMITS)
            made.temperature(channel, wrong, stamp=now, now=now, limits=LIMITS)
    assert made.fault(3.95) != ""


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


def test_a_commander_of_zero_volts_holds_the_outputs_until_it_is_silent():
    gate = CommandGate(1, LIMITS)
    gate.command([0.0], 0.0, "/done#1")
    assert "commands already" in gate.command([3.0], 0.1, "/second#2")
    gate.clear()
    assert gate.command([3.0], 0.2, "/second#2") == ""
