"""E5: tangents on a real powder, prestrain, zero rate, drifting baselines on synthetic peaks."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
import yaml

from sma_bench.errors import InputError
from sma_bench.identify.transition_temperatures import identify_transition_temperatures
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records import open_record
from sma_bench.records.instruments import DscRecord, DscSegment

KELVIN = 273.15
TABLE_II = {1: (351.29, 371.05, 355.49, 324.93), 2: (331.81, 353.61, 353.39, 325.09)}

# Tangents drawn by hand on plots of DSC.txt.
BY_HAND = yaml.safe_load(Path(__file__).with_name("tangents_by_hand.yaml").read_text())


def crossing(flank, base):
    (slope, level), (rate, zero) = (np.polyfit(*np.array(points).T, 1) for points in (flank, base))
    return (zero - level) / (slope - rate)


@pytest.fixture(scope="module")
def powder(measured_data):
    return open_record(measured_data / "sma_react" / "input" / "preprocessor_samples" / "DSC.txt")


def test_a_powders_tangents_are_those_drawn_by_hand_with_peaks_and_latent_heat_by_cycle(powder):
    found = identify_transition_temperatures(powder)
    for where, drawn in BY_HAND.items():
        by_hand = crossing(*drawn)
        assert found.details[where].value - KELVIN == pytest.approx(by_hand, abs=1.0), where
    for number, peak in {2: 33.5, 4: 64.4, 6: 34.2, 8: 63.3}.items():
        label = f"segment_{number}"
        assert found.details[f"{label}/peak"].value - KELVIN == pytest.approx(peak, abs=0.3)
        # What goes in on heating comes out on cooling: 34 to 37 kJ/kg in all four scans.
        heat = found.details[f"{label}/latent_heat"]
        assert abs(heat.value - 35.4e3) < 2.0 * heat.std
    assert "5 K/min, cycle 2" in found.estimates[TRANSITIONS["A_s"]].method
    assert "10 K/min, cycle 1" in found.details["segment_4/start"].method
    # Rates and cycles that changed together are said and pass for no law of the rate.
    assert any("changed together" in f.text for f in found.findings)
    assert not any("zero rate" in name for name in found.details)
    assert found.details["cycle 1, 10 K/min: A_s"].value == found.details["segment_4/start"].value


def scan(number, per_minute, start, finish, drift=0.0, height=300.0, lag=0.0, noise=0.05):
    """A scan from 273.15 to 453.15 K or back whose tangents meet the base at start and finish, all
    late by `lag` s; the base drifts by so many W/kg. W for 10 mg."""
    rate = per_minute / 60.0
    first, last = (273.15, 453.15) if rate > 0 else (453.15, 273.15)
    time = np.arange(0.0, abs((last - first) / rate), 0.5)
    temperature = first + rate * time
    sign = np.sign(rate)
    knots = sign * (start + (finish - start) / 3.0 * np.arange(4) + lag * rate)
    peak = np.interp(sign * temperature, knots, [0.0, height, height, 0.0])
    bent = drift * ((temperature - 273.15) / 180.0) ** 2
    flow = sign * (200.0 + peak) + bent
    flow += np.random.default_rng(number).normal(0.0, noise, len(time))
    courses = (time, flow * 1e-5, np.zeros(len(time)), temperature, temperature)
    return DscSegment(number, rate, *courses)


def record_of(*segments):
    return DscRecord(Path("synthetic"), 1e-5, {}, segments)


def run(*cycles, drift=0.0):
    """Heating and cooling for each (rate in K/min, temperatures), 8 s late."""
    segments = []
    for rate, (a_s, a_f, m_s, m_f) in cycles:
        segments.append(scan(len(segments) + 1, rate, a_s, a_f, drift, lag=8.0))
        segments.append(scan(len(segments) + 1, -rate, m_s, m_f, drift, lag=8.0))
    return record_of(*segments)


@pytest.mark.parametrize("noise", [0.05, 0.3, 2.0])  # W/kg, of a height of 300
def test_trapezoidal_peaks_give_their_corners_and_area(noise):
    scans = (
        scan(1, 5.0, 320.0, 350.0, noise=noise), scan(2, -5.0, 335.0, 305.0, noise=noise)
    )
    found = identify_transition_temperatures(record_of(*scans))
    kelvin = [found.estimates[name].value for name in TRANSITIONS.values()]
    assert kelvin == pytest.approx([320.0, 350.0, 335.0, 305.0], abs=0.3)
    # Area: 300 W/kg over two thirds of 30 K at 5 K/min.
    for label in ("segment_1", "segment_2"):
        heat = found.details[f"synthetic/{label}/latent_heat"]
        assert heat.value == pytest.approx(300.0 * 20.0 / (5.0 / 60.0), rel=0.03)
    assert any("lies above A_s" in f.text for f in found.findings if f.severity == "warning")


def test_scan_without_a_peak_is_left_out_and_a_run_of_them_is_an_error():
    flat = scan(1, 6.0, 320.0, 350.0, height=0.0)
    with pytest.raises(InputError, match="no heating or cooling scan with a whole peak"):
        identify_transition_temperatures(record_of(flat))
    found = identify_transition_temperatures(record_of(flat, scan(2, -6.0, 335.0, 305.0)))
    assert set(found.estimates) == {TRANSITIONS["M_s"], TRANSITIONS["M_f"]}
    assert any("segment 1" in f.text and "left out" in f.text for f in found.findings)


def test_table_two_comes_back_with_its_prestrain():
    experiment = identify_transition_temperatures(run((5.0, TABLE_II[1]), (5.0, TABLE_II[2])))
    lag = 8.0 * 5.0 / 60.0 * np.array([1.0, 1.0, -1.0, -1.0])
    for cycle, row in TABLE_II.items():
        read = [experiment.details[f"cycle {cycle}, 5 K/min: {name}"].value for name in TRANSITIONS]
        assert read == pytest.approx(np.array(row) + lag, abs=0.4)
    (finding,) = [f for f in experiment.findings if f.subject == "prestrain"]
    assert "the mark of prestrain" in finding.text
    assert finding.numbers["A_s"] == pytest.approx(331.81 - 351.29, abs=0.5)
    a_s = experiment.estimates[TRANSITIONS["A_s"]]
    assert a_s.value == pytest.approx(331.81 + lag[0], abs=0.4)
    assert a_s.std < 2.0  # the first cycle's 19.5 K are prestrain, not an error
    alike = identify_transition_temperatures(run((5.0, TABLE_II[2]), (5.0, TABLE_II[2])))
    assert not any("from cycle 1 to 2" in f.text for f in alike.findings)


def test_runs_of_several_rates_are_extrapolated_to_zero():
    runs = [run((10.0, TABLE_II[1]), (rate, TABLE_II[2])) for rate in (20.0, 10.0, 5.0)]
    found = identify_transition_temperatures(runs)
    assert "run 3, cycle 2, 5 K/min: A_s" in found.details
    for name, truth in zip(TRANSITIONS, TABLE_II[2], strict=True):
        estimate = found.estimates[TRANSITIONS[name]]
        assert "zero rate" in estimate.method
        assert estimate.value == pytest.approx(truth, abs=0.4), name
        assert abs(estimate.value - truth) < 2.5 * estimate.std, name
        expected = 8.0 if name.startswith("A") else -8.0
        assert found.details[f"{name} lag"].value == pytest.approx(expected, abs=2.0)


def test_drifting_baseline_moves_the_onsets_by_less_than_a_kelvin():
    cycles = [(5.0, TABLE_II[2])] * 2
    runs = [run(*cycles, drift=d) for d in (0.0, -60.0, 60.0)]
    flat, *bent = map(identify_transition_temperatures, runs)
    for name, one in product(TRANSITIONS.values(), bent):
        assert abs(one.estimates[name].value - flat.estimates[name].value) < 1.0, name
