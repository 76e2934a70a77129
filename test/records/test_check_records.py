"""`check_record` reports what is wrong with a record, and nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify.fits import fit_linear
from sma_bench.records import Record, Signal, check_record, read_record
from sma_bench.records.check import check_response

FOREIGN = ("wire/staircase", "wire/ramp", "composite/triangle", "composite/step")
CLOCK = np.arange(2000) * 0.01
TRIANGLE = 3 * np.abs((CLOCK / 10) % 2 - 1)


def settling(rise=60.0, start=296.0):
    """A wire warming up and cooling down again."""
    warm, cold = 1 - np.exp(-CLOCK / 1.5), np.exp(-(CLOCK - 10) / 1.5)
    return np.round(start + rise * np.where(CLOCK < 10, warm, cold), 1)


def record(**signals):
    units = {"voltage": "V", "current": "A", "temperature": "K", "range": "m", "force": "N"}
    made = {}
    for name, values in signals.items():
        name = name.replace("_", ".", 1)
        time, values = values if isinstance(values, tuple) else (CLOCK, values)
        made[name] = Signal(name, units.get(name.split(".")[-1], "m"), time, values, time + 0.003)
    return Record(Path("bag"), 0, made)


def found(record, severity="warning"):
    """Numbers of the findings of a severity, by subject."""
    return {f.subject: f.numbers for f in check_record(record) if f.severity == severity}


def received(made, name, times, topic=""):
    """The record with other receive times of one signal."""
    signal = replace(made[name], received=times, topic=topic)
    return replace(made, signals={**made.signals, name: signal})


@pytest.mark.parametrize("name", FOREIGN)
def test_good_foreign_records_have_no_warnings_and_their_losses_are_reported(shared_data, name):
    foreign = read_record(shared_data / "foreign" / name)
    assert found(foreign) == found(foreign, "error") == {}
    losses = {f.subject: f for f in check_record(foreign) if "fraction" in f.numbers}
    if name == "wire/staircase":
        lost = {subject: f.numbers["fraction"] for subject, f in losses.items()}
        names = ("wire.voltage", "wire.current", "wire.temperature")
        assert lost == pytest.approx(dict.fromkeys(names, 0.05), abs=0.005)


GAP = (CLOCK < 5) | (CLOCK > 8)
LOSSES = np.random.default_rng(0).random(len(CLOCK)) < 0.7
REPEATED = CLOCK.copy()
REPEATED[5], REPEATED[100] = REPEATED[3], REPEATED[99]
HOLES = TRIANGLE.copy()
HOLES[:7], HOLES[9] = np.nan, np.inf
THREE = record(wire_voltage=TRIANGLE, wire_temperature=settling(), deflection=TRIANGLE / 100)
FLAT = np.full(len(CLOCK), 296.0)
SPIKE = settling()
SPIKE[700] = 999.9
DROPPED = settling()
DROPPED[700:712] = 273.15
CODED = settling()
CODED[50:450:20] = 273.15
LATE = np.interp(CLOCK - 0.25, CLOCK, TRIANGLE)
CLIPPED = {"wire_voltage": TRIANGLE, "wire_temperature": np.minimum(settling(), 330.0)}
GROWN = {"wire_voltage": TRIANGLE, "wire_temperature": settling(), "elongation": 1e-5 * settling()}
# What is wrong; subject and numbers of the finding; a record or its signals; severity (0 warning).
WRONG = [
    ("gap", "wire.voltage", {"gaps": 1, "longest": 3.02},
     {"wire_voltage": (CLOCK[GAP], TRIANGLE[GAP])}),
    ("a pause of all", "wire.voltage, wire.temperature", {"gaps": 1, "longest": 3.02},
     {"wire_voltage": (CLOCK[GAP], TRIANGLE[GAP]),
      "wire_temperature": (CLOCK[GAP], settling()[GAP])}),
    ("losses", "wire.voltage", {"fraction": 1 - LOSSES.mean()},
     {"wire_voltage": (CLOCK[LOSSES], TRIANGLE[LOSSES])}),
    ("disorder", "force", {"backward": 1, "duplicates": 1}, {"force": (REPEATED, TRIANGLE)}),
    ("holes", "force", {"count": 8}, {"force": HOLES}),
    ("clock off", "/b/wire/temperature", {"offset": 2.5},
     received(THREE, "wire.temperature", CLOCK + 2.503, "/b/wire/temperature")),
    ("clock that drifts", "deflection", {"drift": 0.09},
     received(THREE, "deflection", CLOCK * 1.005 + 0.003)),
    ("stamps in the future", "wire.voltage", {"offset": -0.05},
     received(record(wire_voltage=TRIANGLE), "wire.voltage", CLOCK - 0.05)),
    ("below zero", "wire.temperature", {"low": -5.0}, {"wire_temperature": settling(start=-5)}, 1),
    ("kelvin", "wire.temperature", {"low": 569.15}, {"wire_temperature": settling() + 273.15}, 1),
    ("Celsius", "wire.temperature", {"low": 22.85}, {"wire_temperature": settling() - 273.15}, 1),
    ("millivolts", "wire.voltage", {"high": 3e3}, {"wire_voltage": TRIANGLE * 1e3}),
    ("milliamperes", "wire.current", {"high": 3e3}, {"wire_current": TRIANGLE * 1e3}),
    ("centimetres", "deflection", {"high": 30.0}, {"deflection": TRIANGLE * 10}),
    ("far target", "front.range", {"high": 90.0}, {"front_range": TRIANGLE * 30}),
    ("clipped", "wire.temperature", {"value": 330.0}, CLIPPED),
    ("current limit", "wire.current", {"value": 2.0},
     {"wire_voltage": TRIANGLE, "wire_current": np.minimum(TRIANGLE, 2.0)}),
    ("reversed current", "wire.current", {"share": 1.0},
     {"wire_voltage": TRIANGLE, "wire_current": -TRIANGLE}),
    ("current on another clock", "wire.voltage", {"apart": 0.25},
     {"wire_voltage": TRIANGLE, "wire_current": LATE}),
    ("elongation of the wrong sign", "elongation", {"together": 1.0}, GROWN),
    ("single reading", "wire.temperature", {"outliers": 1}, {"wire_temperature": SPIKE}),
    ("camera drops out", "wire.temperature", {"outliers": 12}, {"wire_temperature": DROPPED}),
    ("code of a fault", "wire.temperature", {"outliers": 20}, {"wire_temperature": CODED}),
    ("dead sensor", "wire.temperature", {"value": 296.0},
     {"wire_voltage": TRIANGLE, "wire_temperature": FLAT}),
    ("dead elongation", "elongation", {"value": 0.0},
     {"wire_voltage": TRIANGLE, "elongation": 0.0 * CLOCK}),
    ("no channel", "record", {}, {"deflection": TRIANGLE / 100}),
    ("no current", "wire.current", {}, {"wire_voltage": TRIANGLE}, 2),
    ("no mechanics", "record", {}, {"wire_voltage": TRIANGLE}, 2)]


@pytest.mark.parametrize("case", WRONG, ids=lambda case: case[0])
def test_what_is_wrong_is_reported_with_its_numbers(case):
    _, subject, numbers, odd, *severity = case
    made = odd if isinstance(odd, Record) else record(**odd)
    reported = found(made, ("warning", "error", "info")[sum(severity)])[subject]
    assert {name: reported[name] for name in numbers} == pytest.approx(numbers, abs=0.01)


PLATEAU = np.where(CLOCK < 10, 2.0, 0.0)
NOISE = np.random.default_rng(1).standard_normal(len(CLOCK))
RIGHT = {
    "a settled temperature": record(wire_voltage=TRIANGLE, wire_temperature=settling()),
    "a plateau": record(wire_voltage=PLATEAU, wire_current=PLATEAU / 2),
    "a sensor while nothing happens": record(wire_voltage=TRIANGLE * 0, wire_temperature=FLAT),
    "a clamp": record(wire_voltage=TRIANGLE, elongation=0.0 * CLOCK, force=5.0 * TRIANGLE),
    "noise alone": record(wire_voltage=TRIANGLE, wire_temperature=296.0 + 0.1 * NOISE),
    "a bench at rest": record(wire_voltage=0.0 * TRIANGLE, wire_temperature=settling()),
    "all of a wire, with noise": record(
        wire_voltage=TRIANGLE + 1e-3 * NOISE, wire_current=TRIANGLE / 2.7 + 1e-3 * NOISE,
        wire_temperature=settling(), deflection=1e-2 * TRIANGLE + 1e-6 * NOISE)}


@pytest.mark.parametrize("case", RIGHT)
def test_a_good_record_has_no_warnings(case):
    assert found(RIGHT[case]) == found(RIGHT[case], "error") == {}


@pytest.mark.parametrize("rig", ["wire", "composite"])
def test_swapped_runs_or_channels_are_noticed_and_the_right_ones_are_not(shared_data, rig):
    """The voltages of one run beside the readings of another of the same bench."""
    runs = sorted((shared_data / "foreign" / rig).glob("*/metadata.yaml"))
    one, other = (read_record(path.parent) for path in runs)
    for command, response in ((one, other), (other, one)):
        voltages = {n: s for n, s in command.signals.items() if n.endswith("voltage")}
        readings = {n: s for n, s in response.signals.items() if not n.endswith("voltage")}
        swapped = found(replace(command, signals={**voltages, **readings}))
        for channel in command.channels:
            assert "explained" in swapped[f"{channel}.temperature"]
        assert not any("explained" in numbers for numbers in found(command).values())
    if rig == "composite":  # two channels swapped at the plug
        triangle = read_record(shared_data / "foreign/composite/triangle")
        names = ["front_1.temperature", "back_1.temperature"]
        crossed = {a: replace(triangle[b], name=a) for a, b in zip(names, names[::-1], strict=True)}
        swapped = found(replace(triangle, signals=triangle.signals | crossed))
        assert set(swapped) == {*names}
        assert all(n["explained"] < 0.93 < n["follows"] for n in swapped.values())
        tip = triangle["deflection"]
        signals = triangle.signals | {"deflection": replace(tip, values=-tip.values)}
        turned = replace(triangle, signals=signals)
        assert found(turned)["deflection"]["together"] < -0.8


def test_the_heat_of_a_gap_is_not_asked_for():
    """A bench that ended while it was hot and starts again when it is cold."""
    run = CLOCK < 8
    both = np.concatenate([CLOCK[run], CLOCK[run] + 40.0])
    again = {"wire_voltage": (both, np.tile(PLATEAU[run], 2)),
             "wire_temperature": (both, np.tile(settling()[run], 2))}
    assert list(check_response(record(**again))) == []


def test_a_reading_that_never_changes_follows_nothing():
    still = record(wire_voltage=TRIANGLE, deflection=np.full(len(CLOCK), 0.002))
    assert list(check_response(still)) == []


def test_voltages_that_end_before_the_readings_are_a_finding():
    whole = record(wire_voltage=TRIANGLE, wire_temperature=settling())
    assert "wire.voltage" not in found(whole)
    volts = whole["wire.voltage"]
    half = len(volts) // 2
    cut = replace(volts, time=volts.time[:half], values=volts.values[:half], received=None)
    numbers = found(replace(whole, signals=whole.signals | {"wire.voltage": cut}))["wire.voltage"]
    assert numbers == {"missing": volts.time[-1] - volts.time[half - 1], "volts": cut.values[-1]}


def test_absurd_readings_print_nothing_on_the_terminal(capfd):
    """LAPACK, when given an infinity, prints on its own."""
    time = np.linspace(0.0, 19.9, 500)
    volts, kelvin = np.where(time > 5.0, 1e200, 0.0), 296.0 + 20.0 * (time > 5.0)
    odd = record(wire_voltage=(time, volts), wire_temperature=(time, kelvin))
    assert list(check_response(odd)) == []
    design = np.column_stack([np.ones(4), np.array([0.0, 1.0, 2.0, np.inf])])
    with pytest.raises(InputError, match="no straight line"):
        fit_linear(design, np.ones(4), 1e-6 * np.eye(4))
    assert capfd.readouterr() == ("", "")
