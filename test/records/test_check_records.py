"""What is wrong with a record is said with its numbers; what is right is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify.estimate import fit_linear
from sma_bench.records import Record, Signal, check_record, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.records.check import check_response
from sma_bench.records.record import first_order_lag

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
    return {f.subject: f.text for f in check_record(record) if f.severity == severity}


def test_an_orderly_record_has_no_warnings():
    noise = np.random.default_rng(0).normal(size=len(CLOCK)) * 1e-3
    orderly = record(
        wire_voltage=TRIANGLE + noise,
        wire_current=TRIANGLE / 2.7 + noise,
        wire_temperature=settling(),
        deflection=1e-2 * TRIANGLE + noise * 1e-3,
    )
    assert found(orderly) == {} and found(orderly, "error") == {}


@pytest.mark.parametrize(
    "name", ["wire/staircase", "wire/ramp", "composite/triangle", "composite/step"]
)
def test_good_foreign_records_have_no_warnings(shared_data, name):
    foreign = read_record(shared_data / "foreign" / name)
    assert found(foreign) == {} and found(foreign, "error") == {}


def test_five_percent_of_losses_are_told_and_no_gap_is_seen(shared_data):
    wire = read_record(shared_data / "foreign/wire/staircase")
    losses = {f.subject: f.numbers["fraction"] for f in check_record(wire) if f.numbers}
    assert losses == pytest.approx(
        {"wire.voltage": 0.05, "wire.current": 0.05, "wire.temperature": 0.05}, abs=0.005
    )


def test_gap_is_reported_with_its_length_and_place():
    keep = (CLOCK < 5) | (CLOCK > 8)
    gappy = record(wire_voltage=(CLOCK[keep], TRIANGLE[keep]))
    assert found(gappy)["wire.voltage"] == (
        "1 gaps of more than 10 periods, the longest 3.02 s at t = 4.990 s"
    )


def test_half_the_samples_missing_is_a_warning():
    keep = np.random.default_rng(0).random(len(CLOCK)) < 0.7
    lossy = record(wire_voltage=(CLOCK[keep], TRIANGLE[keep]))
    assert "30" in found(lossy)["wire.voltage"] and "missing" in found(lossy)["wire.voltage"]


def test_backward_and_repeated_stamps_of_a_record_made_in_memory():
    time = CLOCK.copy()
    time[5], time[100] = time[3], time[99]
    assert found(record(force=(time, TRIANGLE)))["force"] == (
        "1 stamps go backward, 1 repeat the one before"
    )


def test_clock_offset_of_one_topic_is_measured():
    odd = record(wire_voltage=TRIANGLE, wire_temperature=settling(), deflection=TRIANGLE / 100)
    late = odd["wire.temperature"]
    odd.signals["wire.temperature"] = Signal(
        late.name, "K", CLOCK, late.values, CLOCK + 2.503, "/bench/wire/temperature"
    )
    finding = next(f for f in check_record(odd) if f.subject == "/bench/wire/temperature")
    assert finding.numbers["offset"] == pytest.approx(2.5)


def test_clock_drift_of_one_topic_is_measured():
    odd = record(wire_voltage=TRIANGLE, wire_temperature=settling(), deflection=TRIANGLE / 100)
    values = odd["deflection"].values
    odd.signals["deflection"] = Signal("deflection", "m", CLOCK, values, CLOCK * 1.005 + 0.003)
    finding = next(f for f in check_record(odd) if f.subject == "deflection")
    assert finding.numbers["drift"] == pytest.approx(0.09, abs=0.005)


def test_stamps_in_the_recorders_future_are_reported():
    odd = record(wire_voltage=TRIANGLE)
    odd.signals["wire.voltage"] = Signal("wire.voltage", "V", CLOCK, TRIANGLE, CLOCK - 0.05)
    assert "0.050 s after the messages were received" in found(odd)["wire.voltage"]


def test_kelvin_on_a_celsius_topic_is_an_error(tmp_path):
    kelvin = Signal("wire.temperature", "K", CLOCK, settling() + 273.15)
    write_record(tmp_path / "bag", [kelvin])
    errors = found(read_record(tmp_path / "bag"), "error")
    assert "seems to carry kelvin" in errors["wire.temperature"]


def test_temperature_below_absolute_zero_is_an_error():
    assert (
        "absolute zero"
        in found(record(wire_temperature=settling(start=-5)), "error")["wire.temperature"]
    )


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("wire_voltage", TRIANGLE * 1e3),
        ("wire_current", TRIANGLE * 1e3),
        ("deflection", TRIANGLE * 10),
        ("front_range", TRIANGLE * 30),
    ],
)
def test_values_beyond_belief_suggest_a_unit(name, values):
    assert "beyond belief" in found(record(**{name: values}))[name.replace("_", ".")]


def test_clipped_temperature_is_found_and_a_settled_one_is_not():
    clipped = np.minimum(settling(), 330.0)
    text = found(record(wire_voltage=TRIANGLE, wire_temperature=clipped))["wire.temperature"]
    assert "clipped at the highest value 330 K" in text
    assert found(record(wire_voltage=TRIANGLE, wire_temperature=settling())) == {}


def test_current_limit_of_the_supply_is_found_and_a_plateau_is_not():
    limited = np.minimum(TRIANGLE, 2.0)
    text = found(record(wire_voltage=TRIANGLE, wire_current=limited))["wire.current"]
    assert "clipped at the highest value 2 A" in text
    plateau = np.where(CLOCK < 10, 2.0, 0.0)
    assert found(record(wire_voltage=plateau, wire_current=plateau / 2)) == {}


def test_dead_sensor_is_found_only_while_something_happens():
    flat = np.full(len(CLOCK), 296.0)
    text = found(record(wire_voltage=TRIANGLE, wire_temperature=flat))["wire.temperature"]
    assert text == "stays at 296 K while the voltage changes"
    assert found(record(wire_voltage=TRIANGLE * 0, wire_temperature=flat)) == {}


def test_an_elongation_that_stays_is_a_clamp_where_a_force_changes_and_dead_where_none_does():
    flat = np.zeros(len(CLOCK))
    clamped = record(wire_voltage=TRIANGLE, elongation=flat, force=5.0 * TRIANGLE)
    assert "elongation" not in found(clamped)
    assert "stays at 0" in found(record(wire_voltage=TRIANGLE, elongation=flat))["elongation"]


def test_what_is_absent_is_told():
    told = found(record(wire_voltage=TRIANGLE), "info")
    assert told["wire.current"] == told["wire.temperature"] == "absent from the record"
    assert told["record"].startswith("no mechanical signal")
    assert "no channel" in found(record(deflection=TRIANGLE / 100))["record"]


def test_nan_and_inf_of_a_record_made_in_memory_are_counted():
    values = TRIANGLE.copy()
    values[:7], values[9] = np.nan, np.inf
    assert found(record(force=values))["force"] == "8 of 2000 values are NaN or Inf"


def test_a_record_on_two_clocks_is_told_and_a_stalled_recorder_is_not():
    orderly = record(wire_voltage=TRIANGLE, wire_temperature=settling())
    voltage = orderly["wire.voltage"]
    on_two = np.where(np.arange(len(CLOCK)) % 20 < 10, CLOCK, CLOCK + 3.0)
    stalled = CLOCK + np.maximum(0.0, 2.0 - CLOCK % 5.0)
    for received, told in ((on_two, True), (stalled, False)):
        orderly.signals["wire.voltage"] = replace(voltage, received=received)
        assert ("two publishers" in found(orderly).get("wire.voltage", "")) is told
    orderly.signals["wire.voltage"] = voltage
    for period, told in ((0.05, True), (10.0, False)):
        steps = tuple((k * period, f"ramp/{k % 2}") for k in range(100))
        said = found(replace(orderly, markers=steps)).get("experiment/marker", "")
        assert said.startswith("100 steps, 98 times back") is told


@pytest.mark.parametrize("rig", ["wire", "composite"])
def test_stored_runs_swapped_are_noticed_and_the_right_ones_are_not(shared_data, rig):
    """The voltages of one run beside the readings of another of the same bench."""
    runs = sorted((shared_data / "foreign" / rig).glob("*/metadata.yaml"))
    one, other = (read_record(path.parent) for path in runs)
    for command, response in ((one, other), (other, one)):
        voltages = {n: s for n, s in command.signals.items() if n.endswith("voltage")}
        readings = {n: s for n, s in response.signals.items() if not n.endswith("voltage")}
        told = found(replace(command, signals={**voltages, **readings}))
        for channel in command.channels:
            assert "stored runs or channels swapped" in told[f"{channel}.temperature"]
        assert not any("swapped" in text for text in found(command).values())


def test_channels_swapped_at_the_plug_are_noticed(shared_data):
    triangle = read_record(shared_data / "foreign/composite/triangle")
    front, back = (triangle.signals[f"{side}_1.temperature"] for side in ("front", "back"))
    crossed = triangle.signals | {
        "front_1.temperature": replace(back, name="front_1.temperature"),
        "back_1.temperature": replace(front, name="back_1.temperature"),
    }
    told = found(replace(triangle, signals=crossed))
    assert set(told) == {"front_1.temperature", "back_1.temperature"}
    assert all("swapped" in text for text in told.values())


def test_voltages_that_end_before_the_readings_are_a_finding():
    whole = record(wire_voltage=TRIANGLE, wire_temperature=settling())
    assert "wire.voltage" not in found(whole)
    volts = whole["wire.voltage"]
    half = len(volts) // 2
    cut = replace(volts, time=volts.time[:half], values=volts.values[:half], received=None)
    text = found(replace(whole, signals=whole.signals | {"wire.voltage": cut}))["wire.voltage"]
    missing = volts.time[-1] - volts.time[half - 1]
    assert text.startswith(f"ends {missing:.3g} s before the last temperature or deflection")
    assert f"at {cut.values[-1]:.3g} V" in text


def test_noise_alone_and_a_bench_at_rest_say_nothing_of_what_belongs_together():
    noise = 296.0 + 0.1 * np.random.default_rng(1).standard_normal(len(CLOCK))
    assert found(record(wire_voltage=TRIANGLE, wire_temperature=noise)) == {}
    assert found(record(wire_voltage=0.0 * TRIANGLE, wire_temperature=settling())) == {}


def test_readings_beyond_all_measure_leave_the_terminal_alone(capfd):
    """LAPACK writes past Python when it is given an infinity."""
    time = np.linspace(0.0, 19.9, 500)
    odd = record(wire_voltage=(time, np.where(time > 5.0, 1e200, 0.0)),
                 wire_temperature=(time, 296.0 + 20.0 * (time > 5.0)))  # fmt: skip
    assert list(check_response(odd)) == []
    design = np.column_stack([np.ones(4), np.array([0.0, 1.0, 2.0, np.inf])])
    with pytest.raises(InputError, match="no straight line"):
        fit_linear(design, np.ones(4), 1e-6 * np.eye(4))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("start", [0.0, 2.5])
def test_a_first_order_lag_keeps_a_share_of_what_was_before(start):
    course = np.random.default_rng(1).normal(size=50)
    expected, before = [], start
    for coming in course:
        before = 0.8 * before + 0.2 * coming
        expected.append(before)
    assert first_order_lag(course, 0.8, start) == pytest.approx(expected, rel=1e-12)
