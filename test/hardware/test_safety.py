"""Safety rules on commands and readings: refusals, limits, the model, latched reasons."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.hardware import safety
from sma_bench.hardware.bench_sensors import SharedWatch
from sma_bench.hardware.safety import Wire, broken, power_rules
from sma_bench.parameters import Parameters

LIMITS = safety.Limits.from_parameters(Parameters.defaults())
R = LIMITS.resistance
PERIOD = 0.01
NAN, INF = math.nan, math.inf


def moments(seconds, begin=0.0):
    return [begin + PERIOD * k for k in range(1, round(seconds / PERIOD) + 1)]


def is_said(expected, reason):
    """The reason begins with `expected`; "" means that there is no reason."""
    return reason.startswith(expected) and bool(reason) == bool(expected)


def test_limits_are_those_of_the_contract_inclusive_and_nan_is_no_reading():
    assert (LIMITS.maximum_voltage, LIMITS.maximum_current) == (10.0, 3.0)
    assert (LIMITS.maximum_temperature, LIMITS.command_timeout) == (423.15, 0.5)
    assert (LIMITS.maximum_power, LIMITS.maximum_heating_rate) == (30.0, 1500.0)
    for rules, name, good, bad, said in ((safety.temperature_rules, "kelvin", 423.15, 423.25,
                                          "over-temperature: b at 150.1 degC, limit 150"),
                                         (power_rules, "ampere", 3.0, -3.1,
                                          "over-current: b at -3.10 A, limit 3 A")):
        for value in (good, NAN):
            assert broken(rules(Wire("b", **{name: value}), LIMITS)) == {}
        (reason,) = broken(rules(Wire("b", **{name: bad}), LIMITS)).values()
        assert is_said(said, reason)


@given(st.lists(st.floats(), max_size=4))
def test_an_accepted_command_is_as_long_and_as_large_as_the_bench_allows(command):
    good = len(command) == 2 and all(0.0 <= v <= 10.0 for v in command)
    gate = safety.CommandGate(2, LIMITS)
    assert good == (gate.command(command, 1.0) == "")
    assert gate.outputs(1.0) == (tuple(command) if good else (0.0, 0.0))
    assert "has nan" in gate.command([1.0, NAN], 1.0)
    assert "has -0.1 V, expected 0 to 10 V" in gate.command([1.0, -0.1], 1.0)


def test_a_watchdog_is_never_off_and_the_gate_zeroes_its_outputs_on_silence_and_bad_commands():
    for timeout in (0.0, -1.0, INF, NAN):
        with pytest.raises(ValueError, match="positive and finite"):
            safety.Watchdog(timeout)
    watchdog = safety.Watchdog(0.5)
    assert watchdog.expired(0.0)
    watchdog.feed(10.0)
    assert [watchdog.expired(t) for t in (10.5, 10.51, 9.9, NAN)] == [False, True, True, True]
    gate = safety.CommandGate(2, LIMITS)
    assert gate.outputs(0.0) == (0.0, 0.0)
    assert gate.command([1.0, 2.0], 1.0) == "" and "nan" in gate.command([NAN, 2.0], 1.2)
    assert gate.outputs(1.5) == (1.0, 2.0)
    assert gate.outputs(1.51) == gate.outputs(9.0) == (0.0, 0.0)
    assert (gate.accepted, gate.rejected, gate.timeouts) == (1, 1, 1)
    gate.command([3.0, 0.0], 10.0)
    for k in range(1, 20):  # bad ones feed nothing
        gate.command([NAN, 0.0], 10.0 + 0.1 * k)
    assert gate.outputs(10.6) == (0.0, 0.0)


def test_a_reading_that_comes_late_by_its_stamp_is_stale_by_any_clock_that_runs_like_ours():
    fresh = safety.Freshness("wire/power", 1.0)
    assert "never received" in fresh.fault(0.0)
    silent = "stale feedback: nothing new from wire/power for"
    late = "stale feedback: wire/power arrives {} s late by its timestamps, limit 1 s"
    for stamp, seen, now, fault in (
        (95.0, 100.0, 100.5, ""),
        (95.0, 100.9, 101.0, ""),
        (95.0, 101.0, 101.1, f"{silent} 1.10 s, limit 1 s"),  # repeated
        (95.0, 101.05, 101.1, late.format("1.05")),
        (95.3, 101.2, 102.1, ""),  # of a busy computer
        (91.0, 102.2, 102.25, late.format("6.20")),  # delayed, or its clock was set back
        (96.4, 102.4, 103.5, f"{silent} 1.10 s"),
    ):
        fresh.seen(stamp=stamp, now=seen)
        assert is_said(fault, fresh.fault(now)), (stamp, fresh.fault(now))
    fresh.learn_clock()
    fresh.seen(stamp=96.5, now=104.0)
    assert fresh.fault(104.0) == "" and "7.5 s before" in fresh.doubt(1.0)
    fresh.seen(stamp=200.0, now=104.1)  # one alone does no harm
    fresh.seen(stamp=96.6, now=104.2)
    assert fresh.fault(105.1) == ""
    fresh.seen(stamp=200.0, now=105.3)
    assert fresh.fault(105.3).startswith("wire/power has timestamps 94.7 s after their arrival")


@pytest.mark.parametrize(("pace", "is_stale"), [(1.0, False), (0.9995, False), (0.9, True)])
def test_a_clock_may_run_slowly_but_not_as_slowly_as_a_growing_delay(pace, is_stale):
    fresh = safety.Freshness("wire/power", 1.0)
    for k in range(50_000):
        fresh.seen(stamp=pace * 0.1 * k, now=30.0 + 0.1 * k)
    assert bool(fresh.fault(5030.0)) == is_stale


class Bench:
    """A guard and readings of its channels, received and stamped at `now` s."""

    def __init__(self, channels=("a",), feedback=("power", "temperature")):
        self.guard = safety.Guard(list(channels), list(feedback), 1.0)
        self.channels = channels

    def read(self, now, volt=None, ampere=None, kelvin=None):
        for channel in self.channels:
            if kelvin is not None:
                self.guard.temperature(channel, kelvin, stamp=now, now=now, limits=LIMITS)
            if volt is not None:
                ampere = volt / R if ampere is None else ampere
                self.guard.power(channel, volt, ampere, stamp=now, now=now, limits=LIMITS)
        return self.guard.fault(now)


def test_guard_without_a_camera_goes_by_the_model_only_where_no_temperature_comes():
    bench = Bench(feedback=["power"])
    for now in moments(4.2):
        # Measured at 340 K for 3 s, then no temperature any more.
        fault = bench.read(now, 8.0 if now > 2.0 else 0.0, kelvin=340.0 if now < 3.0 else None)
        assert fault == "" or now >= 3.0
    assert fault.startswith("over-temperature by the model: a at 171")
    bench = Bench(feedback=["power"])
    assert bench.read(1.0, 1.0) == ""
    assert "over-temperature" in bench.read(1.0, kelvin=500.0)


@pytest.mark.parametrize("volt", [INF, -INF, 3e38, -3e38])
def test_one_impossible_reading_does_not_disable_the_rule_of_the_model(volt):
    """A wire that stays cold at 6 V for 12 s is a fault, whatever single reading came before; a
    wire that warms as modelled is not."""
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
def test_nan_and_infinity_are_no_fresh_reading(wrong):
    bench = Bench("ab")
    assert bench.read(1.0, 1.0, 0.5, 300.0) == ""
    for k in range(1, 30):
        bench.read(1.0 + 0.1 * k, 1.0, wrong if math.isnan(wrong) else 0.5, wrong)
    stale = "stale feedback: nothing new from a/temperature" if math.isnan(wrong) else ""
    fault = bench.guard.fault(3.95)
    assert fault != "" and fault.startswith(stale)


def test_a_second_commander_is_refused_until_the_first_is_silent_but_for_zero_volts():
    gate, one, other = safety.CommandGate(1, LIMITS), "/bench/experiment#1", "/bench/experiment#2"
    for now in (0.02 * k for k in range(100)):
        assert gate.command([3.0], now, one) == ""
        said = "/bench/experiment: /bench/experiment commands already"
        assert gate.command([6.0], now, other) == said
        assert "an unsigned sender: /bench/experiment commands" in gate.command([6.0], now)
        assert gate.outputs(now) == (3.0,)
    assert (gate.commander, gate.rejected) == ("/bench/experiment", 200)
    assert gate.command([6.0], now + 0.49, other) != ""
    assert gate.command([6.0], now + 0.51, other) == ""
    assert gate.outputs(now + 0.51) == (6.0,)
    assert gate.command([3.0], now + 0.52, one) != ""
    # 0 V from any sender is obeyed for as long as a command.
    gate = safety.CommandGate(1, LIMITS)
    gate.command([3.0], 0.0, one)
    for now in moments(0.8):
        assert gate.command([0.0], now, other) == gate.command([3.0], now, one) == ""
        assert gate.outputs(now) == (0.0,)
    assert gate.command([6.0], now, other) != ""
    for now in moments(0.8, 0.8):
        gate.command([3.0], now, one)
    assert gate.outputs(now) == (3.0,)
    # `clear` also releases a commander who commands 0 V.
    gate = safety.CommandGate(1, LIMITS)
    gate.command([0.0], 0.0, one)
    assert "commands already" in gate.command([3.0], 0.1, other)
    gate.clear()
    assert gate.command([3.0], 0.2, other) == ""


def watched(commanded, *readings, limits=LIMITS, unseen=False):
    wire, now = Wire("wire"), 0.0
    wire.command(commanded)
    for volt, ampere, seconds in readings:
        for _ in range(round(seconds / PERIOD)):
            now += PERIOD
            wire.power(volt, ampere, now, limits)
            reasons = broken(power_rules(wire, limits, 1.0, unseen), now, wire.since)
    return reasons


def powered(commanded, volt, ampere, seconds=1.12, limits=LIMITS):
    reasons = watched(commanded, (volt, ampere, seconds), limits=limits)
    return reasons.get("follows") or reasons.get("conducts", "")


def test_a_deviation_must_last_without_a_gap():
    since = {}

    def noted(value, now):
        return broken({"far": safety.Rule(value, 1.0, lambda: "far", hold=1.0)}, now, since)

    assert [noted(2.0, 0.1 * k) for k in range(11)] == [{}] * 10 + [{"far": "far"}]
    assert noted(NAN, 1.05) == {} and noted(2.0, 1.06) == {"far": "far"}
    assert noted(1.0, 1.1) == noted(2.0, 1.2) == noted(2.0, 20.0) == {}


def test_a_wire_with_the_commanded_voltage_is_no_fault_and_one_with_another_disagrees():
    """Also at small voltages; broken and shorted wires are found by their resistance."""
    for commanded, volt, ampere in ((3.0, 3.0, 3.0 / R), (3.0, 3.0, NAN), (0.9, 0.9, 0.0),
                                    (8.0, 8.45, 8.45 / R)):
        assert powered(commanded, volt, ampere, 3.0) == ""
    wire = Wire("wire")
    for k, now in enumerate(moments(3.0)):
        wire.command(6.0 if k % 2 else 0.0)
        wire.power(6.0, 6.0 / R, now, LIMITS)
        assert broken(power_rules(wire, LIMITS, 1.0), now, wire.since) == {}
    for commanded, volt in ((0.4, 0.0), (0.0, 0.2), (0.4, 0.6), (8.0, 8.6), (8.0, 7.4),
                            (9.9, 9.34)):
        said = f"disagreement: wire gets {volt:.2f} V, commanded {commanded:.2f} V, tolerance"
        assert powered(commanded, volt, volt / R).startswith(said)
        near = commanded + 0.2 * (volt - commanded)
        assert powered(commanded, near, near / R) == powered(commanded, volt, volt / R, 0.9) == ""
    assert powered(3.0, 3.0, 0.7) == powered(3.0, 3.0, 1.53) == ""  # 0.1 A and 30 %
    for ampere in (0.0, 0.56, 0.66, 1.57, 2.5):
        said = f"disagreement: wire carries {ampere:.2f} A at 3.00 V, the model says 1.11 A"
        assert powered(3.0, 3.0, ampere).startswith(said)


def test_a_reading_may_belong_to_one_of_the_last_ten_commands_and_to_none_before():
    for later, said in ((9, False), (10, True)):
        wire, since = Wire("wire"), {}
        for command in (6.0, *[0.0] * later):
            wire.command(command)
        for now in moments(1.2):
            wire.power(6.0, 6.0 / R, now, LIMITS)
            reasons = broken(power_rules(wire, LIMITS, 1.0), now, since)
        assert ("follows" in reasons) == said


def test_the_least_resistance_of_a_circuit_is_what_its_tolerance_leaves():
    rig = Parameters.defaults().replace({"bench.lead_resistance": 1.0})
    for tolerance, left in ((0.3, 0.7), (0.95, 0.05), (0.99, 0.05)):
        loose = rig.replace({"bench.resistance_tolerance": tolerance})
        limits = safety.Limits.from_parameters(loose)
        assert limits.least_resistance == pytest.approx(left * (R + 1.0))


def test_the_model_heats_as_equation_1_with_its_leads():
    steady = LIMITS.ambient + 9.0 / R / LIMITS.heat_loss
    assert LIMITS.warmed(LIMITS.ambient, 3.0, 100.0) == pytest.approx(steady)
    early = LIMITS.warmed(LIMITS.ambient, 3.0, 1e-3) - LIMITS.ambient
    assert early == pytest.approx(1e-3 * 9.0 / R / LIMITS.heat_capacity, rel=0.01)
    leads = Parameters.defaults().replace({"bench.lead_resistance": R})
    limits, volt, ampere = safety.Limits.from_parameters(leads), 6.0, 6.0 / (2.0 * R)
    rise = (0.5 * volt) ** 2 / R / LIMITS.heat_loss
    assert limits.warmed(LIMITS.ambient, volt, 100.0) == pytest.approx(LIMITS.ambient + rise)
    assert limits.heating_voltage(volt, ampere) == pytest.approx(volt)
    assert "disagreement" in powered(volt, volt, ampere)
    assert powered(volt, volt, ampere, limits=limits) == ""


def test_without_a_camera_a_wire_is_as_hot_as_its_readings_allow():
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
        reason = watched(3.0, *readings, unseen=True).get("heat", "")
        assert is_said(f"over-temperature by the model: wire at {celsius}" * bool(celsius), reason)
        assert not reason or "limit 150.0 degC" in reason
    wire = Wire("wire")
    for stamp, volt in ((0.0, 0.0), (5.0, 9.0), (7.0, 0.0)):  # far apart: the last one's volts
        wire.power(volt, volt / R, stamp, LIMITS)
    (reason,) = broken(power_rules(wire, LIMITS, unseen=True)).values()
    assert reason.startswith("over-temperature by the model: wire at 21")


def test_without_a_camera_an_aged_wire_is_as_hot_as_its_power_makes_it():
    """A new wire would reach 161 degC at 7.7 V. A missing current is replaced by the last measured
    one, for a second."""
    rest, aged, dumb = (0.0, 0.0, 2.0), 7.7 / (1.2 * R), (7.7, NAN, 0.02)
    for celsius, *readings in (
        (0, *[(7.7, aged, 0.05), dumb] * 20),
        (15, (7.7, aged, 0.5), (7.7, NAN, 1.5)),
        (16, (8.5, 8.5 / (1.2 * R), 2.0)),
        (16, (7.7, 0.55 * 7.7 / R, 2.0)),  # no wire: a sensor that has lost half
    ):
        reason = watched(3.0, rest, *readings, unseen=True).get("heat", "")
        assert is_said(f"over-temperature by the model: wire at {celsius}" * bool(celsius), reason)


def test_pulses_between_two_readings_heat_as_they_were_sent():
    """Readings every 0.2 s sample pulses of that period at one phase, always on or always off."""
    mean = 0.3 * 8.0**2 / R / LIMITS.heat_loss
    for phase, volt in ((0, 8.0), (10, 0.0)):
        bench, wire = Bench(feedback=["power"]), 0.0
        for k in range(400):
            bench.guard.commanded([8.0 if (k + phase) % 20 < 6 else 0.0])
            if k % 20 == 5:
                wire = bench.read(PERIOD * k, volt, kelvin=LIMITS.ambient + mean)
                assert wire == ""
        # The same with a camera that shows no warming.
        for k in range(400, 800):
            bench.guard.commanded([8.0 if (k + phase) % 20 < 6 else 0.0])
            if k % 20 == 5:
                wire = bench.read(PERIOD * k, volt, kelvin=LIMITS.ambient - 40.0)
        assert wire.startswith("disagreement: a measured at -17 degC, the model says ")
    # Commands from before the last reading no longer count.
    held = Wire("a")
    held.command(0.0)
    for now in (0.0, 1.0):
        held.command(8.0)
        held.power(8.0, 8.0 / LIMITS.circuit, now, LIMITS)
    assert held.modelled == pytest.approx(LIMITS.warmed(LIMITS.ambient, 8.0, 1.0), abs=0.1)


def test_a_camera_that_sees_no_warming_disagrees_and_a_too_fast_warming_is_reported():
    bench = Bench(feedback=["temperature"])
    assert all(bench.read(0.1 * k, kelvin=400.0) == "" for k in range(50))
    bench, reasons = Bench(feedback=["temperature"]), []
    for now in moments(2.0):
        bench.read(now, 6.0)
        reasons.append(bench.read(now, kelvin=LIMITS.ambient))
    assert reasons[50] == ""
    assert reasons[-1].startswith("disagreement: a measured at 23 degC, the model says 107 degC")
    # Jitter of the stamps does not count as a heating rate.
    bench = Bench(feedback=["temperature"])
    for kelvin, now, fault in (
        (300.0, 0.0, ""), (340.0, 0.001, ""),
        (400.0, 0.05, "heating rate: a rises by 2000 K/s, limit 1500 K/s"),
        (300.0, 0.10, ""), (NAN, 0.2, ""),
    ):
        assert bench.read(now, kelvin=kelvin) == fault


def test_an_aged_wire_in_a_cold_room_and_a_draught_is_not_taken_for_a_blind_camera():
    """The heat follows from its current, and its temperature at rest is the room's, within 20 K."""
    aged, draught, room = 1.2 * R, 1.7, LIMITS.ambient - 18.0
    rise = 7.7**2 / aged / LIMITS.heat_loss
    for at_rest, driven, cut in ((room, room + rise / draught, ""),
                                 (room, room, "5 degC, the model says 120 degC"),
                                 (room - 30.0, room + 15.0, "20 degC, the model says 118 degC")):
        bench = Bench(feedback=["power"])
        for now in moments(3.0):
            assert bench.read(now, 0.0, 0.0, at_rest) == ""
        for k, now in enumerate(moments(1.5, 3.0)):
            fault = bench.read(now, 7.7, 7.7 / aged)
            fault = bench.read(now, kelvin=driven) if k % 4 == 0 and k > 40 else fault
        assert is_said(f"disagreement: a measured at {cut}" * bool(cut), fault)
    bench = Bench(feedback=["power"])  # warm again before it is read: that is no room
    for now in moments(3.0):
        bench.read(now, 0.0, 0.0, room)
    bench.guard.commanded([7.7])
    bench.read(3.0 + PERIOD, kelvin=room + 60.0)
    for k, now in enumerate(moments(1.5, 3.0 + PERIOD)):
        fault = bench.read(now, 7.7, 7.7 / aged)
        fault = bench.read(now, kelvin=room + rise / draught) if k > 40 else fault
    assert fault == ""
    bench = Bench(feedback=["power"])  # pulses that no reading meets: what is warm then is no room
    for k, now in enumerate(moments(6.0)):
        bench.guard.commanded([3.0 if k % 4 == 2 else 0.0])
        fault = bench.read(now, 0.0, 0.0, room + 58.0 if now < 3.0 else LIMITS.ambient - 50.0)
    assert fault == ""


def found_open(volts, broken, seed, seconds):
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
        if reason := watch.power(v, amperes, PERIOD * k, LIMITS.circuit):
            return reason
    return ""


DRIVES = {"weak beside strong": lambda draw: (6.0, float(draw.choice([0.0, 1.5, 2.0]))),
          "apart": lambda draw: (float(draw.uniform(3.0, 8.0)), float(draw.uniform(0.0, 2.5))),
          "alike": lambda draw: float(draw.uniform(0.0, 8.0)) * np.array([1.0, 1.0 / 3.0])}


@pytest.mark.parametrize("drive", DRIVES)
def test_an_open_wire_is_found_by_its_steps_and_a_sound_one_is_not_wherever_its_phases_are(drive):
    volts = DRIVES[drive]
    assert found_open(volts, None, 0, 60.0) == found_open(volts, None, 1, 30.0) == ""
    if drive == "alike":  # those that always step alike cannot be told apart
        assert found_open(volts, 1, 0, 30.0) == ""
        return
    for seed in range(4):
        reason = found_open(volts, 1, seed, 30.0)
        assert reason.startswith("open: front_2 takes ")
        assert reason.endswith("(it shares a sensor with front_1)")
