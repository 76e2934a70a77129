"""What is known of a record reaches its diagnosis: clocks are mended, doubted signals hold effects
back. Synthetic records."""

from dataclasses import replace

import numpy as np
import pytest

import sma_bench
from sma_bench.records.trust import mended, under_suspicion

LAB = {
    "bench.channels": ["wire"], "bench.channel_sides": ["front"], "load.kind": "clamped",
    "wire.resistance": 3.0, "wire.heat_transfer_coefficient": 80.0, "wire.specific_heat": 450.0,
    "wire.mass": 0.09e-3, "wire.surface_area": 236e-6, "environment.ambient_temperature": 296.0,
    "uncertainty.wire.heat_transfer_coefficient": 20.0, "uncertainty.wire.specific_heat": 100.0,
}  # fmt: skip


def record_of(volts):
    """A wire of the lab's numbers under volts (n,) at 10 Hz, as its sensors read it."""
    time = np.arange(len(volts)) / 10.0
    run = sma_bench.simulate((time, volts[:, None]), LAB)
    record = sma_bench.measure(run, 1)
    kept = {n: s for n, s in record.signals.items() if n.startswith("wire.")}
    return replace(
        record, signals={n: replace(s, received=s.time + 0.002) for n, s in kept.items()}
    )


def staircase():
    return np.repeat([0.0, 0.4, 0.8, 1.0, 0.8, 0.4, 0.0], 150)


def late_clock(record, off):
    """The thermometer's stamps on a clock of its own."""
    own = record["wire.temperature"]
    return replace(
        record, signals=record.signals | {"wire.temperature": replace(own, time=own.time + off)}
    )


@pytest.mark.parametrize("off", [37.0, -37.0])
def test_a_clock_of_another_time_is_moved_back_by_when_messages_came(off):
    record = record_of(staircase())
    sound, found = mended(late_clock(record, off))
    assert [f.subject for f in found] == ["wire.temperature"]
    assert found[0].numbers["offset"] == pytest.approx(-off, abs=0.01)
    assert sound["wire.temperature"].time == pytest.approx(record["wire.temperature"].time)
    assert not mended(record)[1]
    # A picture that takes its time keeps its right stamp.
    own = record["wire.temperature"]
    late = {"wire.temperature": replace(own, received=own.time + 0.4)}
    sound, found = mended(replace(record, signals=record.signals | late))
    assert not found and sound["wire.temperature"].time is own.time


def test_a_diagnosis_mends_the_clock_says_so_and_names_no_lag():
    found = sma_bench.diagnose(late_clock(record_of(staircase()), 37.0), LAB)
    assert found.cause == ()
    (line,) = found.to_json()["record"]
    assert "wire.temperature" in line and "37.0" in line
    assert line in " ".join(str(found).split())


def test_readings_of_two_values_within_a_pwm_hold_every_effect_back():
    record = record_of(staircase())
    rng = np.random.default_rng(1)
    read = {
        name: replace(
            record[name],
            values=np.where(
                rng.random(len(record[name])) < 0.15 * (record["wire.voltage"].values > 0.1),
                top,
                0.0,
            ),
        )
        for name, top in (("wire.voltage", 12.0), ("wire.current", 4.0))
    }
    switched = replace(record, signals=record.signals | read)
    assert {f.subject for f in under_suspicion(switched)} == set(read)
    found = sma_bench.diagnose(switched, LAB)
    assert found.cause == ()
    assert {c.name for c in found.candidates} <= {"recalibration", "no_gap", "unexplained"}
    assert any("PWM" in line for line in found.record)


@pytest.mark.parametrize("hold", [20, 50])
def test_a_random_binary_drive_is_no_switched_supply(hold):
    volts = np.repeat(np.random.default_rng(2).integers(0, 2, 1000 // hold), hold) * 0.9
    assert not list(under_suspicion(record_of(volts)))


def test_a_clipped_thermometer_holds_the_effects_of_its_sensor_back():
    record = record_of(staircase())
    own = record["wire.temperature"]
    top = float(np.quantile(own.values, 0.8))
    clipped = replace(own, values=np.minimum(own.values, top))
    found = sma_bench.diagnose(
        replace(record, signals=record.signals | {"wire.temperature": clipped}), LAB
    )
    assert "temperature_lag" not in " ".join(c.name for c in found.candidates)
    assert any("clipped" in line for line in found.record)


def test_a_variance_that_the_scatter_contradicts_is_left_out_and_said():
    record = record_of(staircase())
    own = record["wire.temperature"]
    stated = replace(own, std=np.full(len(own), 1e-6))
    sound, found = mended(replace(record, signals=record.signals | {own.name: stated}))
    assert sound["wire.temperature"].std is None
    assert found[0].subject == "wire.temperature"
    honest = replace(own, std=np.full(len(own), found[0].numbers["scatter"]))
    assert not mended(replace(record, signals=record.signals | {own.name: honest}))[1]


def test_a_current_that_runs_against_its_voltage_is_turned_and_said():
    record = record_of(staircase())
    own = record["wire.current"]
    turned = {"wire.current": replace(own, values=-own.values)}
    sound, found = mended(replace(record, signals=record.signals | turned))
    assert sound["wire.current"].values == pytest.approx(own.values)
    assert [f.subject for f in found] == ["wire.current"]
    found = sma_bench.diagnose(replace(record, signals=record.signals | turned), LAB)
    assert found.cause == () and "wire.current" in found.record[0]


@pytest.mark.parametrize("name, wrong", [("wire.temperature", 999.9), ("wire.temperature", 0.0)])
def test_single_readings_far_off_are_left_out_and_named(name, wrong):
    record = record_of(staircase())
    own = record[name]
    values = own.values.copy()
    values[[200, 700]] = wrong
    outlying = {name: replace(own, values=values)}
    sound, found = mended(replace(record, signals=record.signals | outlying))
    assert len(sound[name]) == len(own) - 2 and sound[name].values == pytest.approx(
        np.delete(own.values, [200, 700])
    )
    assert [f.numbers["outliers"] for f in found] == [2.0]
    # A reading of few digits flickers by its last one, which is none.
    slow = 296.1 + 0.1 * (np.arange(len(own)) * 5 // len(own))
    slow[[100, 300, 800]] += 0.1
    flickering = {name: replace(own, values=np.round(slow, 1))}
    assert not mended(replace(record, signals=record.signals | flickering))[1]


def test_numbers_that_nobody_stated_are_fitted_so_well_that_no_effect_gains_by_them():
    drawn = {"resistance": 1.3, "heat_transfer_coefficient": 600.0, "specific_heat": 480.0}
    rig = {name: value for name, value in LAB.items() if name.startswith(("bench", "load"))}
    time = np.arange(1200) / 10.0
    volts = np.repeat([0.0, 0.5, 1.0, 1.5, 1.0, 0.5, 0.0, 1.25], 150)
    true = rig | {f"wire.{name}": value for name, value in drawn.items()}
    run = sma_bench.simulate((time, volts[:, None]), true)
    found = sma_bench.diagnose(sma_bench.measure(run, 1), rig)
    assert found.verdict == "recalibration"
    assert max(c.log_evidence for c in found.candidates) < 2.0
