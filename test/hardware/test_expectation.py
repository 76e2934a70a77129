"""Commands, model and readings of one wire: what disagrees for long enough is a fault."""

import math

import numpy as np
import pytest

from sma_bench.hardware.expectation import Lasting, SharedWatch, WireModel, WireWatch
from sma_bench.parameters import Parameters

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
    assert reason == "disagreement: wire gets 0.00 V, commanded 3.00 V, tolerance 0.25 V"


@pytest.mark.parametrize(
    ("commanded", "volt"), [(0.0, 0.2), (0.4, 0.0), (0.4, 0.6), (8.0, 8.6), (8.0, 7.4)]
)
def test_every_voltage_is_checked_small_ones_too(commanded, volt):
    ampere = volt / MODEL.resistance
    assert f"commanded {commanded:.2f} V" in powered(watch(commanded), volt, ampere, 1.1)
    near = commanded + 0.2 * (volt - commanded)
    assert powered(watch(commanded), near, near / MODEL.resistance, 1.1) == ""


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
    assert MODEL.warmed(MODEL.ambient, 3.0, 100.0) == pytest.approx(steady)
    early = MODEL.warmed(MODEL.ambient, 3.0, 1e-3) - MODEL.ambient
    assert early == pytest.approx(1e-3 * 9.0 / MODEL.resistance / MODEL.heat_capacity, rel=0.01)


def test_leads_carry_the_current_and_take_their_share_of_the_volts():
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


def test_a_wire_that_nobody_sees_may_be_as_hot_as_its_limit_and_for_a_moment_driven_hard():
    assert heat_after([REST, (7.0, 7.0 / R, 5.0)]) == ""
    assert heat_after([REST, (8.0, 8.0 / R, 0.1), REST, (8.0, 8.0 / R, 0.1)]) == ""


def test_a_wire_of_unknown_temperature_counts_as_hot():
    """The bridge that starts may follow one that died driving."""
    reason = heat_after([(8.0, 8.0 / R, 0.05)])
    assert reason.startswith("over-temperature by the model: wire at 15")
    assert heat_after([(7.0, 7.0 / R, 0.05)]) == ""


def test_a_gap_in_the_readings_was_driven_as_hard_as_either_end():
    wire = watch()
    for stamp, volt in ((0.0, 0.0), (5.0, 9.0), (7.0, 0.0)):
        wire.power(volt, volt / R, stamp, stamp, MODEL)
    assert wire.heat(MODEL).startswith("over-temperature by the model: wire at 21")


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
