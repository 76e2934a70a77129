"""Faults of a record reach its diagnosis: clocks are repaired, doubtful signals exclude effects.
Synthetic records."""

from dataclasses import replace

import numpy as np
import pytest
from planted import believed, planted_pair

import sma_bench
from sma_bench.records.mend import comparable, doubtful_readings, mended, without_unseen_drive
from sma_bench.records.record import first_order_lag

LOSS = "wire.heat_transfer_coefficient"
LAB = {"bench.channels": ["wire"], "bench.channel_sides": ["front"], "load.kind": "clamped",
       "wire.resistance": 3.0, "wire.heat_transfer_coefficient": 80.0, "wire.specific_heat": 450.0,
       "wire.mass": 0.09e-3, "wire.surface_area": 236e-6, "environment.ambient_temperature": 296.0,
       "uncertainty.wire.heat_transfer_coefficient": 20.0, "uncertainty.wire.specific_heat": 100.0}
STAIRCASE = np.repeat([0.0, 0.4, 0.8, 1.0, 0.8, 0.4, 0.0], 150)


def record_of(volts=STAIRCASE):
    """Synthetic record at 10 Hz of a wire with the lab's parameters under volts (n,)."""
    time = np.arange(len(volts)) / 10.0
    run = sma_bench.simulate((time, volts[:, None]), LAB)
    record = sma_bench.measure(run, 1)
    kept = {n: s for n, s in record.signals.items() if n.startswith("wire.")}
    return replace(record,
                   signals={n: replace(s, received=s.time + 0.002) for n, s in kept.items()})


@pytest.fixture(scope="module")
def record():
    return record_of()


def with_signals(record, **changes):
    """The record with these changes to signals of its wire."""
    changed = {f"wire.{n}": replace(record[f"wire.{n}"], **more) for n, more in changes.items()}
    return replace(record, signals=record.signals | changed)


def with_temperature(record, **more):
    """The repaired record and the findings, after these changes to the temperature."""
    return mended(with_signals(record, temperature=more))


def test_a_clock_offset_is_corrected_and_a_far_too_small_variance_is_dropped(record):
    own = record["wire.temperature"].time
    for off in (37.0, -37.0, 0.4):  # with the last, messages arrive before their timestamps
        sound, (found,) = with_temperature(record, time=own + off)
        assert found.subject == "wire.temperature"
        assert found.numbers["offset"] == pytest.approx(-off, abs=0.01)
        assert sound["wire.temperature"].time == pytest.approx(own)
    # An image that arrives late keeps its timestamp, which may be right.
    sound, found = with_temperature(record, received=own + 0.4)
    assert not found and sound["wire.temperature"].time is own
    assert [f.subject for f in doubtful_readings(sound)] == ["wire.temperature"]  # or is wrong
    sound, (found,) = with_temperature(record, std=np.full(len(own), 1e-6))
    assert sound["wire.temperature"].std is None and found.subject == "wire.temperature"
    assert not with_temperature(record, std=np.full(len(own), found.numbers["scatter"]))[1]


def test_repeated_readings_count_once_but_coarse_readings_all_count(record):
    """A node publishes the last reading ten times a second; its sensor reads twice a second."""
    own = record["wire.temperature"]
    sound, (found,) = with_temperature(record, values=np.repeat(own.values[::5], 5))
    assert found.subject == "wire.temperature" and found.numbers["times"] == pytest.approx(5.0)
    kept = sound["wire.temperature"]
    assert np.array_equal(kept.values, own.values[::5]) and len(kept.received) == len(kept.time)
    assert kept.time == pytest.approx(own.time[::5], abs=1e-9)
    for period, digits in ((0.237, 9), (0.237, 1), (0.63, 9)):  # rows that appear up to one late
        times = np.arange(0.0, own.time[-1], period)
        read = np.round(np.interp(times, own.time, own.values), digits)
        held = read[np.searchsorted(times, own.time, side="right") - 1]
        kept = with_temperature(record, values=held)[0]["wire.temperature"]
        at = np.rint(kept.time / period)
        assert kept.time == pytest.approx(at * period, abs=0.015)
        assert np.array_equal(kept.values, read[at.astype(int)])
    assert not with_temperature(record, values=np.round(own.values))[1]


@pytest.mark.parametrize("wrong", [999.9, 0.0])
def test_single_outliers_are_left_out_and_reported(record, wrong):
    own, at = record["wire.temperature"].values, [200, 700]
    values = own.copy()
    values[at] = wrong
    sound, (found,) = with_temperature(record, values=values)
    assert sound["wire.temperature"].values == pytest.approx(np.delete(own, at))
    assert found.numbers["outliers"] == 2.0
    # A coarse reading that flickers in its last digit has no outliers.
    slow = 296.1 + 0.1 * (np.arange(len(own)) * 5 // len(own))
    slow[[100, 300, 800]] += 0.1
    assert not with_temperature(record, values=np.round(slow, 1))[1]


@pytest.mark.parametrize(("volts", "begin", "end", "kept"), [
    (STAIRCASE, 20.0, 50.0, (50.0, 105.0)),  # two steps unseen: the longer piece remains
    (STAIRCASE, 17.0, 29.0, (0.0, 105.0)),  # constant voltage
    (STAIRCASE, 40.0, 41.5, (0.0, 105.0)),  # as brief as a late message
    (np.linspace(0.0, 1.0, 1050), 20.0, 50.0, (0.0, 105.0)),  # a ramp continues
    (np.interp(np.arange(1050), [0, 500, 1000], [0, 1, 0]), 40.0, 75.0, (0.0, 40.0)),
])
def test_only_the_longest_piece_with_a_recorded_drive_is_compared(volts, begin, end, kept):
    record = record_of(volts)
    seen = {n: (s, (s.time <= begin) | (s.time >= end)) for n, s in record.signals.items()}
    gaps = {n: replace(s, time=s.time[k], values=s.values[k], received=s.received[k])
            for n, (s, k) in seen.items()}
    sound, found = without_unseen_drive(replace(record, signals=gaps))
    times = sound["wire.temperature"].time
    assert (times[0], times[-1]) == pytest.approx(kept, abs=0.2)
    cut = [] if kept[1] - kept[0] > 100.0 else [pytest.approx(end - begin, abs=0.2), None]
    assert [f.numbers.get("gap") for f in found] == cut


@pytest.mark.parametrize("hold", [20, 50])
def test_a_random_binary_drive_is_no_switched_supply(hold):
    volts = np.repeat(np.random.default_rng(2).integers(0, 2, 1000 // hold), hold) * 0.9
    assert not list(doubtful_readings(record_of(volts)))


def turned(record):
    """A current of the sign opposite to its voltage."""
    return with_signals(record, current={"values": -record["wire.current"].values})


def clipped(record):
    kelvin = record["wire.temperature"].values
    values = np.minimum(kelvin, np.quantile(kelvin, 0.8))
    return with_signals(record, temperature={"values": values})


def switched(record):
    """Readings of two values, within the PWM of a supply."""
    driven = record["wire.voltage"].values > 0.1
    random = np.random.default_rng(1).random((2, len(driven)))
    volts, amperes = np.where(random < 0.15 * driven, [[12.0], [4.0]], 0.0)
    return with_signals(record, voltage={"values": volts}, current={"values": amperes})


@pytest.mark.parametrize(("changed", "reported", "excluded"), [
    (turned, "wire.current", ()), (clipped, "clipped", ("temperature_lag",)),
    (switched, "PWM", ("temperature_lag", "supply_drop", "latent_heat")),
])
def test_a_fault_of_a_record_is_reported_and_is_no_cause(record, changed, reported, excluded):
    found = sma_bench.diagnose(changed(record), LAB)
    assert found.cause == ()
    line = found.to_json()["record"][0]
    assert reported in line and line in " ".join(str(found).split())
    assert not set(excluded) & {c.name for c in found.candidates}
    assert (changed is switched) == (len(found.candidates) == 3)


def test_levels_beyond_a_sensors_range_are_left_out_of_a_staircase():
    volts = np.repeat([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0], 150)
    whole = record_of(volts)
    kelvin = whole["wire.temperature"].values
    limit = 0.5 * (kelvin[: 5 * 150].max() + kelvin.max())
    cut = with_signals(whole, temperature={"values": np.minimum(kelvin, limit)})
    unsure = LAB | {"uncertainty.wire.heat_transfer_coefficient": 60.0}
    h, clipped = (sma_bench.identify(one, unsure, ["E2"]).estimates[LOSS] for one in (whole, cut))
    assert clipped.n < h.n and clipped.value == pytest.approx(h.value, rel=0.02)


def test_clipped_currents_are_left_out_even_where_the_voltage_is_constant():
    volts = np.concatenate([STAIRCASE, np.full(100, 0.8), np.zeros(100)])
    whole = record_of(volts)
    cut = with_signals(whole, current={"values": np.minimum(whole["wire.current"].values, 0.2)})
    sound, (found,) = comparable(cut, [])
    assert sound["wire.current"].values.max() < 0.2
    assert found.numbers["count"] == pytest.approx(np.sum(volts > 0.7), abs=3)


def test_a_far_too_large_specific_heat_is_reported_as_a_lagging_thermometer():
    levels = np.repeat([0.0, 0.2, 0.4, 0.6, 0.4, 0.2, 0.0], 400)
    read = record_of(np.append(levels, np.interp(np.arange(2400), [0, 1200, 2400], [0, 0.4, 0])))
    kelvin = read["wire.temperature"].values
    late = first_order_lag(kelvin, np.exp(-0.1 / 6.0), kelvin[0])
    found = sma_bench.identify(with_signals(read, temperature={"values": late}), LAB)
    assert any("times the stated 450" in w and "that lags" in w for w in found.warnings)


@pytest.mark.parametrize("wrong", ["swapped", "out of range", "late", "turned"])
def test_common_faults_of_real_benches_are_reported_and_name_no_effect(tmp_path, wrong):
    """Channels swapped at the plug, a tip that leaves its sensor's range, voltages that are stamped
    when they are commanded, an axis that points the other way: nothing is wrong with the bench."""

    def as_read(record):
        tip = record["deflection"]
        front, back = (record[f"{side}_1.temperature"] for side in ("front", "back"))
        voltages = (s for s in record.signals.values() if s.name.endswith("voltage"))
        signals = {
            "swapped": [replace(front, name=back.name), replace(back, name=front.name)],
            "out of range": [replace(tip, values=np.clip(tip.values, -0.02, 0.02))],
            "turned": [replace(tip, values=-tip.values)],
            "late": [replace(v, time=v.time - 0.25, received=None) for v in voltages]}[wrong]
        return replace(record, signals=record.signals | {s.name: s for s in signals})

    seen, unseen = ([as_read(r) for r in some] for some in planted_pair(tmp_path))
    found = sma_bench.diagnose(seen, believed(), unseen)
    assert found.cause == () and found.candidates[0].name == "recalibration"
    reported = {"swapped": "channels swapped", "out of range": "clipped",
                "late": "different clocks", "turned": "its sign was inverted"}
    assert reported[wrong] in (lines := " ".join(found.record))
    assert ("are not used, because" in lines) == (wrong in ("swapped", "out of range"))
    after = {q: s.rmse_after / s.noise_floor for q, s in found.shrinkage.items()}
    assert wrong == "late" or max(after.values()) < 1.2
    assert ("temperature" in after) == (wrong != "swapped")


def test_a_stated_lag_and_spot_share_of_a_sensor_are_no_cause(record):
    """A thermocouple whose lag, and whose share of the wire's rise, its owner knows."""
    own = record["wire.temperature"].values
    slow = first_order_lag(own - 296.0, float(np.exp(-0.1 / 2.0)))
    read = with_signals(record, temperature={"values": 296.0 + 0.85 * slow})
    stated = {"sensor.temperature.lag": 2.0, "sensor.temperature.spot_share": 0.85}
    found = sma_bench.diagnose(read, LAB | stated)
    assert found.cause == () and found.verdict in ("no_gap", "recalibration")
    left = sma_bench.compare(read, [LAB | stated]).differences
    (kelvin,) = (d.rms for d in left if d.signal == "wire.temperature")
    assert kelvin < 0.5 < 3.0 < np.ptp(own)


def test_the_expansion_of_a_cold_wire_is_not_taken_for_a_reversed_sign():
    """Its length is not stated; 40 um of expansion in as much noise could look inverted."""
    spring = {"load.kind": "spring", "load.stiffness": 1000.0, "load.preload": 5.0}
    bench = {k: v for k, v in (LAB | spring).items() if not k.startswith("uncertainty.")}
    time = np.arange(0.0, 120.0, 0.02)
    volts = 0.5 * (1.0 - np.cos(time * np.pi / 20.0))
    record = sma_bench.measure(sma_bench.simulate((time, volts[:, None]), bench), 1)
    still = record["elongation"]
    grows = 4e-5 * (volts / volts.max()) ** 2
    seen = grows + 1e-5 * np.random.default_rng(3).standard_normal(len(time))
    cold = replace(still, time=time, values=np.round(seen, 5), std=None)
    stated = sma_bench.load_parameters(bench)
    # A motion of millimetres is no expansion.
    for times, turned in ((1.0, []), (100.0, ["elongation"])):
        tip = replace(cold, values=times * cold.values)
        held = replace(record, signals=record.signals | {"elongation": tip})
        found = [f.subject for f in mended(held, stated)[1] if f.subject == "elongation"]
        assert found == turned
