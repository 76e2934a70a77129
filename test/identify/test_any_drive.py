"""E0: what a drive that was made for something else tells of R, h and c_p."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from wire_records import Sensors, Wire, record_of

import sma_bench
from sma_bench.errors import InputError
from sma_bench.records.record import Signal, first_order_lag

TRUTH = {"wire.resistance": 3.0, "wire.heat_transfer_coefficient": 80.0,
         "wire.specific_heat": 500.0}  # fmt: skip
LAB = {"bench.channels": ["wire"], "bench.channel_sides": ["front"], "wire.mass": 0.09e-3,
       "wire.surface_area": 236e-6, "wire.resistance": 3.3, "wire.heat_transfer_coefficient": 60.0,
       "wire.specific_heat": 450.0, "uncertainty.wire.resistance": 0.3,
       "uncertainty.wire.heat_transfer_coefficient": 30.0,
       "uncertainty.wire.specific_heat": 150.0}  # fmt: skip


def on_wait_off(t):
    return np.where((t > 5.0) & (t < 40.0), 0.9, 0.0)


def random_binary(t):
    return 0.9 * np.random.default_rng(1).integers(0, 2, 33)[(t / 2.5).astype(int)]


def record_read(drive, quantities=("voltage", "current", "temperature")):
    wire = Wire(3.0, 80.0, 500.0, LAB["wire.mass"], LAB["wire.surface_area"], ambient=296.0)
    record = record_of(wire, Sensors(), 1, drive, 80.0, 0.05)
    signals = {name: record[name] for name in (f"wire.{q}" for q in quantities)}
    return replace(record, signals=signals)


@pytest.mark.parametrize("drive", [on_wait_off, random_binary])
def test_any_drive_that_excites_gives_resistance_loss_and_heat(drive):
    found = sma_bench.identify(record_read(drive), LAB)
    assert "E0" in [e.name for e in found.experiments]
    for name, true in TRUTH.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, abs=3.0 * estimate.std)
        assert estimate.std < 0.15 * true
        assert estimate.informed > 0.8
    assert not found.is_misfit
    better = next(f.text for e in found.experiments for f in e.findings if f.subject == "E0")
    assert all(name in better for name in ("E1", "E2", "E3"))
    alone = sma_bench.identify(record_read(drive, ("voltage", "current")), LAB).estimates
    assert set(alone) == {"wire.resistance"}  # of a current comes no heat loss
    assert alone["wire.resistance"].value == pytest.approx(3.0, rel=0.03)


def test_a_source_of_current_without_volts_drives_a_fit():
    record = record_read(random_binary, ("current", "temperature"))
    found = sma_bench.identify(record, LAB | {"bench.drive": "current"})
    loss = found.estimates["wire.heat_transfer_coefficient"].value
    assert loss / found.parameters["wire.resistance"] == pytest.approx(80.0 / 3.0, rel=0.05)
    with pytest.raises(InputError, match="no voltage of wire"):
        sma_bench.identify(record, LAB)


def test_a_run_that_is_given_twice_is_refused():
    record = record_read(random_binary)
    with pytest.raises(InputError, match="copy: holds the samples of"):
        sma_bench.identify([record, replace(record, path=Path("copy"))], LAB)


def test_a_wire_that_stands_still_has_no_force_unless_it_was_read():
    record = record_read(random_binary)
    time = record["wire.voltage"].time
    still = Signal("elongation", "m", time, np.zeros(len(time)))
    record = replace(record, signals={**record.signals, "elongation": still})
    assert "force of a clamped wire" not in str(sma_bench.identify(record, LAB).notes)


def test_a_wire_at_rest_or_not_read_has_nothing_to_identify():
    for record in (record_read(lambda t: 0.0 * t), record_read(random_binary, ("voltage",))):
        with pytest.raises(InputError, match="E0"):
            sma_bench.identify(record, LAB)


def test_steps_and_a_slow_thermometer_alone_predict_other_steps():
    """Steady states tell the loss of heat; how fast a wire warms, and the thermometer, one fit of
    all, though nobody states mass or area."""
    def steps(t):
        return np.array([0.0, 0.5, 0.9, 0.7, 0.3, 0.0])[np.minimum(t / 14.0, 5.0).astype(int)]

    def lagged(time, kelvin, seconds):
        even = np.arange(time[0], time[-1], 0.02)
        late = first_order_lag(np.interp(even, time, kelvin), np.exp(-0.02 / seconds), kelvin[0])
        return np.interp(time, even, late)

    def seen(drive):
        record = record_read(drive, ("voltage", "temperature"))
        own = record["wire.temperature"]
        late = lagged(own.time, own.values, 1.0)
        return replace(record, signals={**record.signals, own.name: replace(own, values=late)})

    stated = {name: LAB[name] for name in ("bench.channels", "bench.channel_sides")}
    found = sma_bench.identify(seen(steps), {**stated, "wire.resistance": 3.0})
    assert [e.name for e in found.experiments] == ["E2", "E0"]
    lag = found.estimates["sensor.temperature.lag"]
    assert abs(lag.value - 1.0) < 3.0 * lag.std < 0.3
    other = seen(random_binary)["wire.temperature"]
    model = sma_bench.simulate(seen(random_binary), found.parameters)
    read = lagged(model.time, model.temperature[:, 0], lag.value)
    missed = np.interp(other.time, model.time, read) - other.values
    assert np.std(missed) < 0.02 * np.ptp(other.values)
