"""E5 over cycles and rates: prestrain, zero rate, drifting baselines."""

from pathlib import Path

import numpy as np
import pytest

from sma_bench.identify import identify
from sma_bench.identify.instruments.transition_temperatures import identify_heating_rates
from sma_bench.parameters import Parameters
from sma_bench.records.dsc import DscRecord, DscSegment, read_dsc
from sma_bench.synthetic.paper_specimens import dsc_record

TABLE_II = {1: (351.29, 371.05, 355.49, 324.93), 2: (331.81, 353.61, 353.39, 325.09)}
NAMES = ("A_s", "A_f", "M_s", "M_f")
PARAMETER = {
    "A_s": "wire.austenite_start_temperature", "A_f": "wire.austenite_finish_temperature",
    "M_s": "wire.martensite_start_temperature", "M_f": "wire.martensite_finish_temperature",
}


def segment(
    number: int, per_minute: float, start: float, finish: float, drift: float = 0.0
) -> DscSegment:
    """A scan from 273.15 to 453.15 K or back with a trapezoidal peak, lag 8 s; W for 10 mg."""
    rate = per_minute / 60.0
    first, last = (273.15, 453.15) if rate > 0 else (453.15, 273.15)
    time = np.arange(0.0, abs((last - first) / rate), 0.5)
    temperature = first + rate * time
    sign = np.sign(rate)
    third = (finish - start) / 3.0
    knots = sign * (start + third * np.arange(4) + 8.0 * rate)
    peak = np.interp(sign * temperature, knots, [0.0, 300.0, 300.0, 0.0])
    # A drift of the baseline over the whole scan, bent, in W/kg.
    bent = drift * ((temperature - 273.15) / 180.0) ** 2
    noise = np.random.default_rng(number).normal(0.0, 0.05, len(time))
    flow = sign * (200.0 + peak) + bent + noise
    return DscSegment(
        number, "heating" if rate > 0 else "cooling", rate, time, flow * 1e-5,
        np.zeros(len(time)), temperature, temperature,
    )


def run(*cycles: tuple[float, tuple[float, ...]], drift: float = 0.0) -> DscRecord:
    """Heating and cooling for each (rate in K/min, temperatures)."""
    segments = []
    for rate, (a_s, a_f, m_s, m_f) in cycles:
        segments.append(segment(len(segments) + 1, rate, a_s, a_f, drift))
        segments.append(segment(len(segments) + 1, -rate, m_s, m_f, drift))
    return DscRecord(Path("run.txt"), 1e-5, {}, tuple(segments))


def test_table_two_comes_back_with_its_prestrain() -> None:
    record = run((5.0, TABLE_II[1]), (5.0, TABLE_II[2]))
    experiment = identify_heating_rates(record)
    table = experiment.curves["table"]
    assert table[:, 0].tolist() == [1.0, 2.0]
    lag = 8.0 * 5.0 / 60.0 * np.array([1.0, 1.0, -1.0, -1.0])
    for row, cycle in zip(table, (1, 2), strict=True):
        np.testing.assert_allclose(row[2:], np.array(TABLE_II[cycle]) + lag, atol=0.4)
    (finding,) = [f for f in experiment.findings if f.subject == "prestrain"]
    assert "the mark of prestrain" in finding.text
    assert finding.numbers["A_s"] == pytest.approx(331.81 - 351.29, abs=0.5)
    a_s = experiment.estimates[PARAMETER["A_s"]]
    assert a_s.value == pytest.approx(331.81 + lag[0], abs=0.4)
    # The first cycle's 19.5 K are prestrain, not an error.
    assert a_s.std < 2.0


def test_equal_cycles_show_no_prestrain() -> None:
    experiment = identify_heating_rates(run((5.0, TABLE_II[2]), (5.0, TABLE_II[2])))
    (finding,) = [f for f in experiment.findings if f.subject == "prestrain"]
    assert "no shift beyond the errors" in finding.text


def test_several_rates_are_extrapolated_to_zero() -> None:
    cycles = [(10.0, TABLE_II[1])] + [(r, TABLE_II[2]) for r in (20.0, 10.0, 5.0)]
    experiment = identify_heating_rates(run(*cycles))
    for name, truth in zip(NAMES, TABLE_II[2], strict=True):
        estimate = experiment.estimates[PARAMETER[name]]
        assert "zero rate" in estimate.method
        assert estimate.value == pytest.approx(truth, abs=0.4), name
        assert abs(estimate.value - truth) < 2.5 * estimate.std, name
        lag = experiment.details[f"{name} lag"]
        expected = 8.0 if name.startswith("A") else -8.0
        assert lag.value == pytest.approx(expected, abs=2.0)


def test_separate_runs_at_several_rates_join() -> None:
    runs = [run((10.0, TABLE_II[1]), (r, TABLE_II[2])) for r in (20.0, 10.0, 5.0)]
    experiment = identify_heating_rates(runs)
    assert len(experiment.curves["table"]) == 6
    estimate = experiment.estimates[PARAMETER["A_f"]]
    assert estimate.value == pytest.approx(TABLE_II[2][1], abs=0.4)


@pytest.mark.parametrize("drift", [-60.0, 60.0])
def test_drifting_baseline_moves_the_onsets_by_less_than_a_kelvin(drift: float) -> None:
    cycles = [(5.0, TABLE_II[2]), (5.0, TABLE_II[2])]
    flat, bent = (identify_heating_rates(run(*cycles, drift=d)) for d in (0.0, drift))
    for name in NAMES:
        difference = bent.estimates[PARAMETER[name]].value - flat.estimates[PARAMETER[name]].value
        assert abs(difference) < 1.0, name


def test_rates_and_cycles_that_changed_together_are_said(measured_data: Path) -> None:
    path = measured_data / "sma_react/input/preprocessor_samples/DSC.txt"
    experiment = identify_heating_rates(read_dsc(path))
    assert experiment.curves["table"].shape == (2, 6)
    assert any("changed together; the line to zero rate" in f.text for f in experiment.findings)
    a_f = experiment.estimates[PARAMETER["A_f"]]
    assert a_f.value == pytest.approx(368.6, abs=1.0)
    lag = experiment.details["A_f lag"]
    assert lag.value == pytest.approx(10.0, abs=6.0)


def test_identify_gives_table_two_and_the_prestrain_shift_for_cycles_at_one_rate():
    parameters = Parameters.of_paper()
    result = identify([dsc_record(parameters)], parameters)
    a_s = result.estimates["wire.austenite_start_temperature"]
    assert a_s.value == pytest.approx(331.81, abs=0.5)
    assert a_s.std < 1.0
    shifts = [f.text for e in result.experiments for f in e.findings if "prestrain" in f.text]
    assert len(shifts) >= 1


def test_identify_takes_no_law_of_the_rate_from_a_run_whose_cycles_differ_in_rate(measured_data):
    record = read_dsc(measured_data / "sma_react/input/preprocessor_samples/DSC.txt")
    result = identify([record], Parameters.of_paper())
    assert "segment_8/start" in result.experiments[0].details
    assert not any("zero rate" in name for name in result.experiments[0].details)
