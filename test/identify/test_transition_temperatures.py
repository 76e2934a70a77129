"""E5: tangents on a real powder, prestrain, zero rate, drifting baselines on synthetic peaks."""

from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.instruments.transition_temperatures import (
    identify_heating_rates,
    identify_transition_temperatures,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import TRANSITIONS
from sma_bench.records.dsc import DscRecord, DscSegment, read_dsc
from sma_bench.synthetic.paper_specimens import dsc_record

KELVIN = 273.15
TABLE_II = {1: (351.29, 371.05, 355.49, 324.93), 2: (331.81, 353.61, 353.39, 325.09)}

# Two points of the outermost flank where a ruler lies on it, then two of the straight stretch
# outside the peak, as (T, mW): read by eye off plots of DSC.txt without any tangents in them (heat
# flow less baseline over sample temperature in degC, grid of 1 K and 1 mW, cooling drawn peak
# upward). The reader had seen what the code made of the file by then, so the readings are a check
# of the drawing and no blind test. M_s (start of segments 2 and 6) depends on where the ruler
# lies: its flank bends, and in segment 2 rulers on it cross the baseline anywhere from 63.3 to
# 66 degC. The 4 K over which the code's tangents are smoothed were settled with that in view.
BY_HAND = {
    "segment_2/start": (((58.0, 352.1), (61.5, 350.0)), ((75.0, 347.65), (88.0, 347.6))),
    "segment_2/finish": (((30.7, 361.0), (31.75, 365.0)), ((-12.0, 347.07), (5.0, 347.5))),
    "segment_4/start": (((59.45, -322.0), (61.05, -318.0)), ((10.0, -332.15), (40.0, -331.67))),
    "segment_4/finish": (((92.0, -329.0), (94.1, -330.0)), ((101.0, -331.5), (106.5, -331.68))),
    "segment_6/start": (((57.7, 346.0), (61.3, 344.7)), ((75.0, 343.46), (98.0, 343.42))),
    "segment_6/finish": (((31.35, 350.0), (32.4, 352.0)), ((-12.0, 343.2), (5.0, 343.4))),
    "segment_8/start": (((59.0, -330.0), (60.4, -328.0)), ((0.0, -335.77), (40.0, -335.45))),
    "segment_8/finish": (((90.1, -334.0), (92.3, -334.5)), ((110.0, -335.46), (145.0, -335.43))),
}


def crossing(flank, base):
    (slope, level), (rate, zero) = (np.polyfit(*np.array(points).T, 1) for points in (flank, base))
    return (zero - level) / (slope - rate)


@pytest.fixture(scope="module")
def powder(measured_data):
    return read_dsc(measured_data / "sma_react" / "input" / "preprocessor_samples" / "DSC.txt")


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


def test_rates_and_cycles_that_changed_together_are_said(powder):
    experiment = identify_heating_rates(powder)
    assert experiment.curves["table"].shape == (2, 6)
    assert any("changed together; the line to zero rate" in f.text for f in experiment.findings)
    assert experiment.estimates[TRANSITIONS["A_f"]].value == pytest.approx(368.6, abs=1.0)
    assert experiment.details["A_f lag"].value == pytest.approx(10.0, abs=6.0)
    # `identify` takes no law of the rate from such a run.
    (found,) = identify([powder], Parameters.of_paper()).experiments
    assert "segment_8/start" in found.details
    assert not any("zero rate" in name for name in found.details)


def scan(number, per_minute, start, finish, drift=0.0, height=300.0, lag=0.0):
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
    noise = np.random.default_rng(number).normal(0.0, 0.05, len(time))
    flow = sign * (200.0 + peak) + bent + noise
    return DscSegment(
        number,
        "heating" if rate > 0 else "cooling",
        rate,
        time,
        flow * 1e-5,
        np.zeros(len(time)),
        temperature,
        temperature,
    )


def record_of(*segments):
    return DscRecord(Path("synthetic"), 1e-5, {}, segments)


def run(*cycles, drift=0.0):
    """Heating and cooling for each (rate in K/min, temperatures), 8 s late."""
    segments = []
    for rate, (a_s, a_f, m_s, m_f) in cycles:
        segments.append(scan(len(segments) + 1, rate, a_s, a_f, drift, lag=8.0))
        segments.append(scan(len(segments) + 1, -rate, m_s, m_f, drift, lag=8.0))
    return record_of(*segments)


def test_trapezoidal_peaks_give_their_corners_and_area():
    found = identify_transition_temperatures(
        record_of(scan(1, 5.0, 320.0, 350.0), scan(2, -5.0, 335.0, 305.0))
    )
    truth = {"A_s": 320.0, "A_f": 350.0, "M_s": 335.0, "M_f": 305.0}
    for name, kelvin in truth.items():
        assert found.estimates[TRANSITIONS[name]].value == pytest.approx(kelvin, abs=0.3)
    # Area: 300 W/kg over two thirds of 30 K at 5 K/min.
    for label in ("segment_1", "segment_2"):
        heat = found.details[f"{label}/latent_heat"]
        assert heat.value == pytest.approx(300.0 * 20.0 / (5.0 / 60.0), rel=0.03)
    assert any("lies above A_s" in f.text for f in found.findings if f.severity == "warning")


def test_error_covers_the_difference_between_rates_and_says_what_changed():
    slow, fast = scan(1, 5.0, 320.0, 350.0), scan(2, 10.0, 322.0, 353.0)
    found = identify_transition_temperatures(record_of(fast, slow, scan(3, -6.0, 335.0, 305.0)))
    estimate = found.estimates[TRANSITIONS["A_s"]]
    assert estimate.value == pytest.approx(320.0, abs=0.3)
    assert estimate.std > 1.5
    assert any("cannot be told apart" in f.text for f in found.findings)


def test_scan_without_a_peak_is_left_out_and_a_run_of_them_is_an_error():
    flat = scan(1, 6.0, 320.0, 350.0, height=0.0)
    with pytest.raises(InputError, match="no heating or cooling scan with a whole peak"):
        identify_transition_temperatures(record_of(flat))
    found = identify_transition_temperatures(record_of(flat, scan(2, -6.0, 335.0, 305.0)))
    assert set(found.estimates) == {TRANSITIONS["M_s"], TRANSITIONS["M_f"]}
    assert any("segment 1" in f.text and "left out" in f.text for f in found.findings)


def test_table_two_comes_back_with_its_prestrain():
    experiment = identify_heating_rates(run((5.0, TABLE_II[1]), (5.0, TABLE_II[2])))
    table = experiment.curves["table"]
    assert table[:, 0].tolist() == [1.0, 2.0]
    lag = 8.0 * 5.0 / 60.0 * np.array([1.0, 1.0, -1.0, -1.0])
    for row, cycle in zip(table, (1, 2), strict=True):
        np.testing.assert_allclose(row[2:], np.array(TABLE_II[cycle]) + lag, atol=0.4)
    (finding,) = [f for f in experiment.findings if f.subject == "prestrain"]
    assert "the mark of prestrain" in finding.text
    assert finding.numbers["A_s"] == pytest.approx(331.81 - 351.29, abs=0.5)
    a_s = experiment.estimates[TRANSITIONS["A_s"]]
    assert a_s.value == pytest.approx(331.81 + lag[0], abs=0.4)
    assert a_s.std < 2.0  # the first cycle's 19.5 K are prestrain, not an error
    alike = identify_heating_rates(run((5.0, TABLE_II[2]), (5.0, TABLE_II[2])))
    (finding,) = [f for f in alike.findings if f.subject == "prestrain"]
    assert "no shift beyond the errors" in finding.text


def test_identify_gives_table_two_and_the_prestrain_shift_for_cycles_at_one_rate():
    paper = Parameters.of_paper()
    result = identify([dsc_record(paper)], paper)
    a_s = result.estimates[TRANSITIONS["A_s"]]
    assert a_s.value == pytest.approx(331.81, abs=0.5)
    assert a_s.std < 1.0
    assert [f for e in result.experiments for f in e.findings if "prestrain" in f.text]


def test_several_rates_in_one_run_or_several_are_extrapolated_to_zero():
    rates = (20.0, 10.0, 5.0)
    one = identify_heating_rates(run((10.0, TABLE_II[1]), *((r, TABLE_II[2]) for r in rates)))
    for name, truth in zip(TRANSITIONS, TABLE_II[2], strict=True):
        estimate = one.estimates[TRANSITIONS[name]]
        assert "zero rate" in estimate.method
        assert estimate.value == pytest.approx(truth, abs=0.4), name
        assert abs(estimate.value - truth) < 2.5 * estimate.std, name
        expected = 8.0 if name.startswith("A") else -8.0
        assert one.details[f"{name} lag"].value == pytest.approx(expected, abs=2.0)
    runs = [run((10.0, TABLE_II[1]), (r, TABLE_II[2])) for r in rates]
    several = identify_heating_rates(runs)
    assert len(several.curves["table"]) == 6
    estimate = several.estimates[TRANSITIONS["A_f"]]
    assert estimate.value == pytest.approx(TABLE_II[2][1], abs=0.4)


@pytest.mark.parametrize("drift", [-60.0, 60.0])
def test_drifting_baseline_moves_the_onsets_by_less_than_a_kelvin(drift):
    cycles = [(5.0, TABLE_II[2]), (5.0, TABLE_II[2])]
    flat, bent = (identify_heating_rates(run(*cycles, drift=d)) for d in (0.0, drift))
    for name in TRANSITIONS.values():
        assert abs(bent.estimates[name].value - flat.estimates[name].value) < 1.0, name
