"""What is wrong with a record is said with its numbers; what is right is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_read_bags import FOREIGN

from sma_bench.errors import InputError
from sma_bench.identify.estimate import fit_linear
from sma_bench.records import Record, Signal, check_record, read_record
from sma_bench.records.check import check_response

CLOCK = np.arange(2000) * 0.01
TRIANGLE = 3 * np.abs((CLOCK / 10) % 2 - 1)


def settling(rise=60.0, start=296.0):
    """A wire warming up and cooling down again."""
    warm = start + rise * (1 - np.exp(-CLOCK / 1.5))
    cold = start + rise * np.exp(-(CLOCK - 10) / 1.5)
    return np.round(np.where(CLOCK < 10, warm, cold), 1)


def record(**signals):
    units = {"voltage": "V", "current": "A", "temperature": "K", "range": "m", "force": "N"}
    made = {}
    for name, values in signals.items():
        name = name.replace("_", ".", 1)
        time, values = values if isinstance(values, tuple) else (CLOCK, values)
        made[name] = Signal(name, units.get(name.split(".")[-1], "m"), time, values, time + 0.003)
    return Record(Path("bag"), 0, made)


def found(record, severity="warning"):
    """What is said of each subject, as numbers."""
    return {f.subject: f.numbers for f in check_record(record) if f.severity == severity}


def received(made, name, times, topic=""):
    """The record with other receive times of one signal."""
    signal = replace(made[name], received=times, topic=topic)
    return replace(made, signals={**made.signals, name: signal})


@pytest.mark.parametrize("name", FOREIGN)
def test_good_foreign_records_have_no_warnings_and_their_losses_are_told(shared_data, name):
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
# Name -> a record, and what is said of which subject: severity, and numbers.
WRONG = {
    "a gap": (record(wire_voltage=(CLOCK[GAP], TRIANGLE[GAP])), "wire.voltage", "warning",
              {"gaps": 1, "longest": 3.02}),
    "losses": (record(wire_voltage=(CLOCK[LOSSES], TRIANGLE[LOSSES])), "wire.voltage", "warning",
               {"fraction": 1 - LOSSES.mean()}),
    "disorder": (record(force=(REPEATED, TRIANGLE)), "force", "warning",
                 {"backward": 1, "duplicates": 1}),
    "holes": (record(force=HOLES), "force", "warning", {"count": 8}),
    "a clock off": (received(THREE, "wire.temperature", CLOCK + 2.503, "/b/wire/temperature"),
                    "/b/wire/temperature", "warning", {"offset": 2.5}),
    "a clock that drifts": (received(THREE, "deflection", CLOCK * 1.005 + 0.003), "deflection",
                            "warning", {"drift": 0.09}),
    "stamps in the future": (received(record(wire_voltage=TRIANGLE), "wire.voltage", CLOCK - 0.05),
                             "wire.voltage", "warning", {"offset": -0.05}),
    "below absolute zero": (record(wire_temperature=settling(start=-5)), "wire.temperature",
                            "error", {"low": -5.0}),
    "kelvin as Celsius": (record(wire_temperature=settling() + 273.15), "wire.temperature",
                          "error", {"low": 569.15}),
    "Celsius as kelvin": (record(wire_temperature=settling() - 273.15), "wire.temperature",
                          "error", {"low": 22.85}),
    "millivolts": (record(wire_voltage=TRIANGLE * 1e3), "wire.voltage", "warning", {"high": 3e3}),
    "milliamperes": (record(wire_current=TRIANGLE * 1e3), "wire.current", "warning", {"high": 3e3}),
    "centimetres": (record(deflection=TRIANGLE * 10), "deflection", "warning", {"high": 30.0}),
    "a far target": (record(front_range=TRIANGLE * 30), "front.range", "warning", {"high": 90.0}),
    "a clipped temperature": (record(wire_voltage=TRIANGLE,
                                     wire_temperature=np.minimum(settling(), 330.0)),
                              "wire.temperature", "warning", {"value": 330.0}),
    "a current limit": (record(wire_voltage=TRIANGLE, wire_current=np.minimum(TRIANGLE, 2.0)),
                        "wire.current", "warning", {"value": 2.0}),
    "a reversed current": (record(wire_voltage=TRIANGLE, wire_current=-TRIANGLE), "wire.current",
                           "warning", {"share": 1.0}),
    "a current on another clock": (
        record(wire_voltage=TRIANGLE, wire_current=np.interp(CLOCK - 0.25, CLOCK, TRIANGLE)),
        "wire.voltage", "warning", {"apart": 0.25}),
    "an elongation of the wrong sign": (
        record(wire_voltage=TRIANGLE, wire_temperature=settling(), elongation=1e-5 * settling()),
        "elongation", "warning", {"together": 1.0}),
    "a single reading far off": (record(wire_temperature=SPIKE), "wire.temperature", "warning",
                                 {"outliers": 1}),
    "a camera that drops out": (record(wire_temperature=DROPPED), "wire.temperature", "warning",
                                {"outliers": 12}),
    "a dead sensor": (record(wire_voltage=TRIANGLE, wire_temperature=FLAT), "wire.temperature",
                      "warning", {"value": 296.0}),
    "a dead elongation": (record(wire_voltage=TRIANGLE, elongation=0.0 * CLOCK), "elongation",
                          "warning", {"value": 0.0}),
    "no channel": (record(deflection=TRIANGLE / 100), "record", "warning", {}),
    "no current": (record(wire_voltage=TRIANGLE), "wire.current", "info", {}),
    "no mechanics": (record(wire_voltage=TRIANGLE), "record", "info", {}),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_its_numbers(case):
    odd, subject, severity, numbers = WRONG[case]
    told = found(odd, severity)[subject]
    assert {name: told[name] for name in numbers} == pytest.approx(numbers, abs=0.01)


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
def test_what_is_right_is_not_wrong(case):
    assert found(RIGHT[case]) == found(RIGHT[case], "error") == {}


@pytest.mark.parametrize("rig", ["wire", "composite"])
def test_stored_runs_or_channels_swapped_are_noticed_and_the_right_ones_are_not(shared_data, rig):
    """The voltages of one run beside the readings of another of the same bench."""
    runs = sorted((shared_data / "foreign" / rig).glob("*/metadata.yaml"))
    one, other = (read_record(path.parent) for path in runs)
    for command, response in ((one, other), (other, one)):
        voltages = {n: s for n, s in command.signals.items() if n.endswith("voltage")}
        readings = {n: s for n, s in response.signals.items() if not n.endswith("voltage")}
        told = found(replace(command, signals={**voltages, **readings}))
        for channel in command.channels:
            assert "explained" in told[f"{channel}.temperature"]
        assert not any("explained" in numbers for numbers in found(command).values())
    if rig == "composite":  # channels at the plug
        triangle = read_record(shared_data / "foreign/composite/triangle")
        names = ["front_1.temperature", "back_1.temperature"]
        crossed = {a: replace(triangle[b], name=a) for a, b in zip(names, names[::-1], strict=True)}
        told = found(replace(triangle, signals=triangle.signals | crossed))
        assert set(told) == {*names}
        assert all(n["explained"] < 0.93 < n["follows"] for n in told.values())
        tip = triangle["deflection"]
        signals = triangle.signals | {"deflection": replace(tip, values=-tip.values)}
        turned = replace(triangle, signals=signals)
        assert found(turned)["deflection"]["together"] < -0.8


def test_a_reading_that_never_changes_follows_nothing():
    still = record(wire_voltage=TRIANGLE, deflection=np.full(len(CLOCK), 0.002))
    assert list(check_response(still)) == []


def test_voltages_that_end_before_the_readings_are_a_finding():
    whole = record(wire_voltage=TRIANGLE, wire_temperature=settling())
    assert "wire.voltage" not in found(whole)
    volts = whole["wire.voltage"]
    half = len(volts) // 2
    cut = replace(volts, time=volts.time[:half], values=volts.values[:half], received=None)
    told = found(replace(whole, signals=whole.signals | {"wire.voltage": cut}))["wire.voltage"]
    assert told == {"missing": volts.time[-1] - volts.time[half - 1], "volts": cut.values[-1]}


def test_readings_beyond_all_measure_leave_the_terminal_alone(capfd):
    """LAPACK writes past Python when it is given an infinity."""
    time = np.linspace(0.0, 19.9, 500)
    volts, kelvin = np.where(time > 5.0, 1e200, 0.0), 296.0 + 20.0 * (time > 5.0)
    odd = record(wire_voltage=(time, volts), wire_temperature=(time, kelvin))
    assert list(check_response(odd)) == []
    design = np.column_stack([np.ones(4), np.array([0.0, 1.0, 2.0, np.inf])])
    with pytest.raises(InputError, match="no straight line"):
        fit_linear(design, np.ones(4), 1e-6 * np.eye(4))
    assert capfd.readouterr() == ("", "")
