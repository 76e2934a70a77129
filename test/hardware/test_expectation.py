"""Commands, model and readings of one wire: what disagrees for long enough is a fault."""

import math

import pytest

from sma_bench.hardware.expectation import Lasting, WireModel, WireWatch
from sma_bench.parameters import Parameters

MODEL = WireModel.from_parameters(Parameters.defaults())
PERIOD = 0.01


def watch(commanded=3.0):
    made = WireWatch("wire", 1.0)
    made.commanded(commanded)
    return made


def powered(wire, volt, ampere, seconds, start=0.0):
    """Reason after readings of `seconds`, ten ms apart."""
    reason = ""
    for k in range(round(seconds / PERIOD) + 1):
        now = start + k * PERIOD
        reason = wire.power(volt, ampere, now, now, MODEL)
    return reason


def test_a_deviation_must_last_without_a_gap():
    lasting = Lasting(1.0)
    assert [lasting.note("far", 0.1 * k) for k in range(10)] == [""] * 10
    assert lasting.note("far", 1.0) == "far"
    assert lasting.note("", 1.1) == ""
    assert lasting.note("far", 1.2) == ""


def test_a_pause_between_two_readings_proves_nothing():
    lasting = Lasting(1.0)
    assert lasting.note("far", 0.0) == ""
    assert lasting.note("far", 20.0) == ""


def test_a_wire_that_does_as_commanded_is_left_alone():
    assert powered(watch(), 3.0, 3.0 / MODEL.resistance, 3.0) == ""
    assert powered(watch(), 3.0, math.nan, 3.0) == ""


def test_a_voltage_that_does_not_follow_is_told_with_both_numbers():
    assert powered(watch(), 0.0, 0.0, 0.9) == ""
    reason = powered(watch(), 0.0, 0.0, 1.1)
    assert reason == "disagreement: wire gets 0.00 V, commanded 3.00 V, tolerance 0.5 V"


def test_a_reading_may_belong_to_any_of_the_last_commands():
    wire = watch(0.0)
    for k in range(300):
        wire.commanded(6.0 if k % 2 else 0.0)
        now = k * PERIOD
        assert wire.power(6.0, 6.0 / MODEL.resistance, now, now, MODEL) == ""


@pytest.mark.parametrize(("ampere", "word"), [(0.0, "0.00 A"), (2.5, "2.50 A")])
def test_a_broken_or_shorted_wire_disagrees_with_its_resistance(ampere, word):
    reason = powered(watch(), 3.0, ampere, 1.1)
    assert reason.startswith(f"disagreement: wire carries {word} at 3.00 V, the model says 1.11 A")


def test_one_of_two_wires_broken_is_seen_from_2_volts_on():
    for volt in (2.0, 4.0, 6.0):
        assert "disagreement" in powered(watch(volt), volt, 0.5 * volt / MODEL.resistance, 1.1)


def test_below_a_volt_the_current_says_nothing():
    assert powered(watch(0.9), 0.9, 0.0, 2.0) == ""


def test_the_model_heats_as_equation_1():
    steady = MODEL.ambient + 9.0 / MODEL.resistance / MODEL.heat_loss
    assert MODEL.heated(MODEL.ambient, 3.0, 100.0) == pytest.approx(steady)
    early = MODEL.heated(MODEL.ambient, 3.0, 1e-3) - MODEL.ambient
    assert early == pytest.approx(1e-3 * 9.0 / MODEL.resistance / MODEL.heat_capacity, rel=0.01)


def test_a_camera_that_sees_no_warming_disagrees():
    wire = watch(6.0)
    reasons = []
    for k in range(200):
        now = k * PERIOD
        wire.power(6.0, 6.0 / MODEL.resistance, now, now, MODEL)
        reasons.append(wire.temperature(MODEL.ambient, now, MODEL))
    assert reasons[50] == ""
    assert reasons[-1].startswith("disagreement: wire measured at 23 degC, the model says 107 degC")


def test_a_temperature_without_any_power_reading_is_not_judged():
    wire = watch()
    assert all(wire.temperature(400.0, 0.1 * k, MODEL) == "" for k in range(50))


def test_warming_faster_than_the_limit_is_told_but_not_a_jittering_stamp():
    wire = watch()
    assert wire.rate(300.0, 0.0, 1000.0) == ""
    assert wire.rate(340.0, 0.001, 1000.0) == ""
    reason = wire.rate(400.0, 0.05, 1000.0)
    assert reason == "heating rate: wire rises by 2000 K/s, limit 1000 K/s"
    assert wire.rate(300.0, 0.10, 1000.0) == ""
    assert wire.rate(math.nan, 0.2, 1000.0) == ""
