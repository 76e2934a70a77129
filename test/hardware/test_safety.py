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
MODEL = WireModel.from_parameters(Parameters.defaults())
R = MODEL.resistance
PERIOD = 0.01
NAN, INF = math.nan, math.inf


def moments(seconds, begin=0.0):
    """Every 10 ms after `begin`."""
    return [begin + PERIOD * k for k in range(1, round(seconds / PERIOD) + 1)]


def test_limits_are_those_of_the_contract_inclusive_and_nan_is_no_reading():
    assert (LIMITS.maximum_voltage, LIMITS.maximum_current) == (10.0, 3.0)
    assert (LIMITS.maximum_temperature, LIMITS.command_timeout) == (423.15, 0.5)
    assert (LIMITS.maximum_power, LIMITS.maximum_heating_rate) == (30.0, 1500.0)
    assert temperature_fault("wire", 423.15, LIMITS) == temperature_fault("wire", NAN, LIMITS) == ""
    assert "wire at 150.1 degC, limit 150.0 degC" in temperature_fault("wire", 423.25, LIMITS)
    assert current_fault("wire", 3.0, LIMITS) == current_fault("wire", NAN, LIMITS) == ""
    assert "over-current: wire at -3.10 A" in current_fault("wire", -3.1, LIMITS)


@given(st.lists(st.floats(), max_size=4))
def test_an_accepted_command_is_as_long_and_as_large_as_the_bench_allows(command):
    good = len(command) == 2 and all(0.0 <= v <= 10.0 for v in command)
    assert good == (command_fault(command, 2, LIMITS) == "")
    assert "has nan" in command_fault([1.0, NAN], 2, LIMITS)
    assert "has -0.1 V, expected 0 to 10 V" in command_fault([1.0, -0.1], 2, LIMITS)


def test_a_watchdog_is_never_off_and_the_gate_zeroes_its_outputs_on_silence_and_bad_commands():
    for timeout in (0.0, -1.0, INF, NAN):
        with pytest.raises(ValueError, match="positive and finite"):
            Watchdog(timeout)
    watchdog = Watchdog(0.5)
    assert watchdog.expired(0.0)
    watchdog.feed(10.0)
    assert [watchdog.expired(t) for t in (10.5, 10.51, 9.9, NAN)] == [False, True, True, True]
    gate = CommandGate(2, LIMITS)
    assert gate.outputs(0.0) == (0.0, 0.0)
    assert gate.command([1.0, 2.0], 1.0) == "" and "nan" in gate.command([NAN, 2.0], 1.2)
    assert gate.outputs(1.5) == (1.0, 2.0)
    assert gate.outputs(1.51) == gate.outputs(9.0) == (0.0, 0.0)
    assert (gate.accepted, gate.rejected, gate.timeouts) == (1, 1, 1)
    gate.command([3.0, 0.0], 10.0)
    for k in range(1, 20):  # bad ones feed nothing
        gate.command([NAN, 0.0], 10.0 + 0.1 * k)
    assert gate.outputs(10.6) == (0.0, 0.0)


def test_the_same_reading_again_is_not_fresh_and_the_first_reason_stays():
    fresh, interlock = Freshness("wire/power", 1.0), Interlock()
    stale = "nothing new from wire/power for 1.10 s, limit 1 s"
    assert "never received" in fresh.fault(0.0)
    for stamp, seen, now, fault in (
        (5.0, 100.0, 100.5, ""),
        (5.0, 100.9, 101.0, ""),
        (5.0, 101.05, 101.1, stale),
        (1.0, 101.2, 101.3, ""),  # a restarted clock
    ):
        fresh.seen(stamp=stamp, now=seen)
        assert fault in fresh.fault(now) and bool(fault) == bool(fresh.fault(now))
    for reason, kept in (("", ""), ("hot", "hot"), ("stale", "hot")):
        interlock.trip(reason)
        assert (interlock.tripped, interlock.reason) == (bool(kept), kept)
    interlock.reset()
    assert not interlock.tripped


class Bench:
    """A guard, and readings of its channels at a moment: `now` s, also their stamp."""

    def __init__(self, channels=("a",), feedback=("power", "temperature")):
        self.guard, self.channels = Guard(list(channels), list(feedback), 1.0), channels

    def read(self, now, volt=None, ampere=None, kelvin=None, channels=None):
        for channel in channels or self.channels:
            if kelvin is not None:
                self.guard.temperature(channel, kelvin, stamp=now, now=now, limits=LIMITS)
            if volt is not None:
                ampere = volt / R if ampere is None else ampere
                self.guard.power(channel, volt, ampere, stamp=now, now=now, limits=LIMITS)
        return self.guard.fault(now)


def test_guard_is_content_with_fresh_cool_wires_and_names_the_one_that_is_not():
    for wrong, fault in (
        ({}, ""),
        ({"kelvin": 430.0, "channels": "b"}, "over-temperature: b"),
        ({"volt": 9.0, "ampere": 3.3, "channels": "a"}, "over-current: a"),
    ):
        bench = Bench("ab")
        assert bench.read(1.0, 1.0, 0.5, 300.0) == ""
        bench.read(1.1, **wrong)
        assert bench.guard.fault(1.5).startswith(fault) and bool(bench.guard.fault(1.5)) == bool(
            fault
        )
    bench = Bench()
    for said, fault in (("bag: no space left", "recording failed: bag: no space left"), ("", "")):
        bench.read(1.0, 1.0, kelvin=300.0)
        bench.guard.recorder(said)
        assert bench.guard.fault(1.5) == fault


def test_guard_without_a_camera_goes_by_the_model_only_where_no_temperature_comes():
    bench = Bench(feedback=["power"])
    for now in moments(4.2):
        # Seen at 340 K for 3 s, then by nobody.
        fault = bench.read(now, 8.0 if now > 2.0 else 0.0, kelvin=340.0 if now < 3.0 else None)
        assert fault == "" or now >= 3.0
    assert fault.startswith("over-temperature by the model: a at 171")
    bench = Bench(feedback=["power"])
    assert bench.read(1.0, 1.0) == ""
    assert "over-temperature" in bench.read(1.0, kelvin=500.0)


@pytest.mark.parametrize("volt", [INF, -INF, 3e38, -3e38])
def test_one_reading_beyond_all_measure_does_not_blind_the_model_rule(volt):
    """6 V for 12 s at a wire that stays cold is a fault, whatever was read once before; and a wire
    that does as it should is left alone."""
    bench, found = Bench(), ""
    bench.read(0.9, volt, 1.0)
    for now in moments(12.0, 1.0):
        bench.guard.commanded([6.0])
        fault = bench.read(now, 6.0, kelvin=296.15)
        found = found or (fault if now > 1.12 else "")
    assert found.startswith("disagreement: a measured at 23 degC")
    bench = Bench(feedback=["power"])
    assert bench.read(0.0, volt, 0.0).startswith("over-voltage: a gets" if volt > 0.0 else "")
    for now in moments(5.0):
        bench.guard.commanded([0.0])
        assert bench.read(now, 0.0, kelvin=296.15) == ""


@pytest.mark.parametrize("wrong", [NAN, INF, -INF])
def test_what_is_no_number_makes_nothing_fresh(wrong):
    bench = Bench("ab")
    bench.read(1.0, 1.0, 0.5, 300.0)
    for k in range(1, 30):
        bench.read(1.0 + 0.1 * k, 1.0, wrong if math.isnan(wrong) else 0.5, wrong)
    stale = "stale feedback: nothing new from a/temperature" if math.isnan(wrong) else ""
    fault = bench.guard.fault(3.95)
    assert fault != "" and fault.startswith(stale)


def test_a_second_commander_is_refused_until_the_first_is_silent_but_for_zero_volts():
    gate, one, other = CommandGate(1, LIMITS), "/bench/experiment#1", "/bench/experiment#2"
    for now in (0.02 * k for k in range(100)):
        assert gate.command([3.0], now, one) == ""
        said = "/bench/experiment: /bench/experiment commands already"
        assert gate.command([6.0], now, other) == said
        assert "a node without a name: /bench/experiment commands" in gate.command([6.0], now)
        assert gate.outputs(now) == (3.0,)
    assert (gate.commander, gate.rejected) == ("/bench/experiment", 200)
    assert gate.command([6.0], now + 0.49, other) != ""
    assert gate.command([6.0], now + 0.51, other) == ""
    assert gate.outputs(now + 0.51) == (6.0,)
    assert gate.command([3.0], now + 0.52, one) != ""
    gate = CommandGate(1, LIMITS)
    gate.command([3.0], 0.0, one)
    for now in moments(0.8):
        assert gate.command([0.0], now, other) == gate.command([3.0], now, one) == ""
        assert gate.outputs(now) == (0.0,)
    assert gate.command([6.0], now, other) != ""
    for now in moments(0.8, 0.8):
        gate.command([3.0], now, one)
    assert gate.outputs(now) == (3.0,)
    gate = CommandGate(1, LIMITS)
    gate.command([0.0], 0.0, one)
    assert "commands already" in gate.command([3.0], 0.1, other)
    gate.clear()
    assert gate.command([3.0], 0.2, other) == ""


# --- one wire against its model -------------------------------------------------------------------


def watched(commanded, *readings, model=MODEL):
    """A wire's watch after (volt, ampere, s) each, ten ms apart; `said` is its last reason."""
    wire, now = WireWatch("wire", 1.0), 0.0
    wire.commanded(commanded)
    for volt, ampere, seconds in readings:
        for _ in range(round(seconds / PERIOD)):
            now += PERIOD
            wire.said = wire.power(volt, ampere, now, now, model)
    return wire


def powered(commanded, volt, ampere, seconds=1.12, model=MODEL):
    return watched(commanded, (volt, ampere, seconds), model=model).said


def test_a_deviation_must_last_without_a_gap():
    lasting = Lasting(1.0)
    assert [lasting.note("far", 0.1 * k) for k in range(11)] == [""] * 10 + ["far"]
    assert lasting.note("", 1.1) == lasting.note("far", 1.2) == ""
    assert lasting.note("far", 20.0) == ""


def test_a_wire_that_does_as_commanded_is_left_alone_and_one_that_does_not_disagrees():
    """Small voltages too; broken and shorted wires by their resistance."""
    for commanded, volt, ampere in ((3.0, 3.0, 3.0 / R), (3.0, 3.0, NAN), (0.9, 0.9, 0.0)):
        assert powered(commanded, volt, ampere, 3.0) == ""
    wire = WireWatch("wire", 1.0)
    for k, now in enumerate(moments(3.0)):
        wire.commanded(6.0 if k % 2 else 0.0)
        assert wire.power(6.0, 6.0 / R, now, now, MODEL) == ""
    for commanded, volt in ((0.4, 0.0), (0.0, 0.2), (0.4, 0.6), (8.0, 8.6), (8.0, 7.4)):
        said = f"disagreement: wire gets {volt:.2f} V, commanded {commanded:.2f} V, tolerance"
        assert powered(commanded, volt, volt / R).startswith(said)
        near = commanded + 0.2 * (volt - commanded)
        assert powered(commanded, near, near / R) == powered(commanded, volt, volt / R, 0.9) == ""
    for ampere in (0.0, 0.56, 2.5):
        said = f"disagreement: wire carries {ampere:.2f} A at 3.00 V, the model says 1.11 A"
        assert powered(3.0, 3.0, ampere).startswith(said)


def test_the_model_heats_as_equation_1_with_its_leads():
    steady = MODEL.ambient + 9.0 / R / MODEL.heat_loss
    assert MODEL.warmed(MODEL.ambient, 3.0, 100.0) == pytest.approx(steady)
    early = MODEL.warmed(MODEL.ambient, 3.0, 1e-3) - MODEL.ambient
    assert early == pytest.approx(1e-3 * 9.0 / R / MODEL.heat_capacity, rel=0.01)
    leads = Parameters.defaults().replace({"bench.lead_resistance": R})
    model, volt, ampere = WireModel.from_parameters(leads), 6.0, 6.0 / (2.0 * R)
    rise = (0.5 * volt) ** 2 / R / MODEL.heat_loss
    assert model.warmed(MODEL.ambient, volt, 100.0) == pytest.approx(MODEL.ambient + rise)
    assert model.heating_voltage(volt, ampere) == pytest.approx(volt)
    assert "disagreement" in powered(volt, volt, ampere)
    assert powered(volt, volt, ampere, model=model) == ""


def test_a_wire_that_nobody_sees_is_as_hot_as_its_readings_allow():
    rest, hot = (0.0, 0.0, 2.0), (8.0, 8.0 / R, 0.1)
    for celsius, *readings in (
        (17, rest, (8.0, 8.0 / R, 2.0)),
        (17, rest, (8.0, 0.0, 2.0)),  # the sensor is dead
        (17, rest, (8.0, NAN, 2.0)),
        (17, rest, (6.5, 8.0**2 / R / 6.5, 2.0)),  # less resistance than the model's, more heat
        (17, rest, (NAN, 8.0 / R, 2.0)),
        (17, rest, (0.0, 8.0 / R, 2.0)),  # a switch that does not open
        (15, (8.0, 8.0 / R, 0.05)),  # of a wire as warm as it may have been before
        (0, rest, (7.0, 7.0 / R, 5.0)),
        (0, rest, hot, rest, hot),
        (0, (7.0, 7.0 / R, 0.05)),
    ):
        reason = watched(3.0, *readings).heat(MODEL)
        said = f"over-temperature by the model: wire at {celsius}" if celsius else ""
        assert reason.startswith(said) and bool(reason) == bool(said)
        assert not reason or "limit 150.0 degC" in reason
    wire = WireWatch("wire", 1.0)
    for stamp, volt in ((0.0, 0.0), (5.0, 9.0), (7.0, 0.0)):  # far apart: the last one's volts
        wire.power(volt, volt / R, stamp, stamp, MODEL)
    assert wire.heat(MODEL).startswith("over-temperature by the model: wire at 21")


def test_a_camera_that_sees_no_warming_disagrees_and_too_fast_a_warming_is_told():
    wire = WireWatch("wire", 1.0)
    assert all(wire.temperature(400.0, 0.1 * k, MODEL) == "" for k in range(50))
    wire, reasons = WireWatch("wire", 1.0), []
    wire.commanded(6.0)
    for now in moments(2.0):
        wire.power(6.0, 6.0 / R, now, now, MODEL)
        reasons.append(wire.temperature(MODEL.ambient, now, MODEL))
    assert reasons[50] == ""
    assert reasons[-1].startswith("disagreement: wire measured at 23 degC, the model says 107 degC")
    # A stamp that jitters is no warming.
    for kelvin, now in ((300.0, 0.0), (340.0, 0.001)):
        assert wire.rate(kelvin, now, 1000.0) == ""
    reason = wire.rate(400.0, 0.05, 1000.0)
    assert reason == "heating rate: wire rises by 2000 K/s, limit 1000 K/s"
    assert wire.rate(300.0, 0.10, 1000.0) == wire.rate(NAN, 0.2, 1000.0) == ""


# --- two wires behind one sensor ------------------------------------------------------------------


def found_open(volts, broken, seed, seconds):
    """What is found of two wires as one noisy sensor shares them out; phases follow in 0.3 s."""
    draw, austenite = np.random.default_rng(seed), np.zeros(2)
    watch = SharedWatch(("front_1", "front_2"))
    for k in range(round(seconds / PERIOD)):
        if k % 100 == 0:
            v = np.array(volts(draw))
        austenite += (np.where(v > 4.5, 1.0, 0.0) - austenite) * PERIOD / 0.3
        conductance = (1.0 + 0.17 * austenite) / R * (np.arange(2) != broken)
        total = math.hypot(*v) or 1.0
        amperes = (float(conductance @ v**2) / total + draw.normal(0.0, 0.06)) * v / total
        amperes = np.where((v > 0.0) & (v < 0.3), np.nan, amperes)
        if reason := watch.power(v, amperes, PERIOD * k, MODEL):
            return reason
    return ""


def weak_beside_strong(draw):
    return 6.0, float(draw.choice([0.0, 1.5, 2.0]))


def apart(draw):
    return float(draw.uniform(3.0, 8.0)), float(draw.uniform(0.0, 2.5))


def alike(draw):
    volt = float(draw.uniform(0.0, 8.0))
    return volt, volt / 3.0


@pytest.mark.parametrize("volts", [weak_beside_strong, apart, alike])
def test_an_open_wire_is_found_by_its_steps_and_a_sound_one_is_not_wherever_its_phases_are(volts):
    assert found_open(volts, None, 0, 60.0) == found_open(volts, None, 1, 30.0) == ""
    if volts is alike:  # those that always step alike cannot be told apart
        assert found_open(volts, 1, 0, 30.0) == ""
        return
    for seed in range(4):
        reason = found_open(volts, 1, seed, 30.0)
        assert reason.startswith("open: front_2 takes ") and reason.endswith("beside front_1")
