"""E1 and E2 on synthetic staircases: right numbers, and wrong models noticed."""

from dataclasses import replace

import pytest

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import EXACT_SENSORS

R, H, T0 = "wire.resistance", "wire.heat_transfer_coefficient", "environment.ambient_temperature"
CP = "wire.specific_heat"
PARAMETERS = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)


def result(*records, experiments=("E1", "E2")):
    return identify(records, PARAMETERS, experiments)


def about(found, subject, words):
    """Texts of the warnings on a subject that hold all the words."""
    return [w for w in found.warnings if subject in w and all(word in w for word in words)]


def test_resistance_coefficient_and_ambient_come_back_within_two_errors(staircase, wire, sensors):
    found = result(staircase(sensors=sensors(offset=0.03), seed=3))
    for name, truth in ((R, 2.75), (H, 410.0), (T0, 297.3)):
        estimate = found.estimates[name]
        assert abs(estimate.value - truth) < 2.0 * estimate.std
        assert estimate.std < 0.01 * truth
    assert found.warnings == ()
    details = found.experiments[0].details
    assert details["heating"].n == 26
    assert details["cooling"].n == 25
    assert details["heating"].value == pytest.approx(2.75, abs=3 * details["heating"].std)
    offset = next(f.numbers for f in found.experiments[0].findings if f.subject == "current")
    assert offset["offset"] == pytest.approx(0.03, abs=3 * offset["offset_std"])


def test_resistance_that_differs_between_heating_and_cooling_is_noticed(staircase):
    found = result(staircase(cooling_resistance=2.70), experiments=["E1"])
    (warning,) = about(found, R, ["heating", "cooling", "depends on the phase"])
    share = float(warning.split("(")[1].split(" %")[0])
    assert share == pytest.approx(100.0 * 0.05 / 2.75, abs=0.15)
    estimate = found.estimates[R]
    assert estimate.value == pytest.approx(2.75, abs=0.002)
    assert "heating slope" in estimate.method
    assert estimate.std > 0.02


def test_resistance_that_changes_with_the_phase_is_noticed_as_a_bend(staircase, wire):
    found = result(staircase(wire(resistance_change=-0.05)))
    assert about(found, R, ["not a straight line"])
    # The heating is judged by measured power: h itself is constant here.
    assert about(found, H, ["not a straight line"]) == []
    assert abs(found.estimates[H].value - 410.0) < 2.0 * found.estimates[H].std


def test_coefficient_that_rises_with_temperature_is_noticed(staircase, wire):
    found = result(staircase(wire(bend=5e-4)))
    (warning,) = about(found, H, ["not a straight line", "rises"])
    h, known = found.estimates[H], PARAMETERS[H]
    assert known + (h.value - known) / h.informed > 410.0  # before it was joined with the known
    assert found.estimates[H].std > 5.0
    assert about(found, R, ["straight"]) == []


def test_two_staircases_join_into_a_smaller_error_but_not_below_the_sensors_scale(staircase):
    known = PARAMETERS.replace(uncertainty={"sensor.voltage.gain": 1e-3})
    one = identify([staircase(seed=1)], known, ["E1"]).estimates[R]
    both = identify([staircase(seed=1), staircase(seed=2)], known, ["E1"]).estimates[R]
    assert both.n == 2 * one.n
    assert both.statistical < 0.8 * one.statistical
    assert both.systematic == pytest.approx(2.75e-3, rel=0.01)
    assert 2.75e-3 < both.std < one.std


def test_what_a_staircase_lacks_is_said(staircase, wire):
    unsettled = result(staircase(wire(mass=8e-3)))
    assert about(unsettled, H, ["plateaus had not settled"])
    short = result(staircase(dwell=6.0))
    assert any("shrink in proportion" in f.text for e in short.experiments for f in e.findings)
    for found, name, truth in ((unsettled, H, 410.0), (short, R, 2.75)):
        assert abs(found.estimates[name].value - truth) < 2.5 * found.estimates[name].std
    given = PARAMETERS.replace({T0: 300.0}, {T0: 0.3})
    elsewhere = identify([staircase()], given, ["E2"])
    assert about(elsewhere, T0, ["stated ambient 300.00 K"])
    for name, value, experiment in (("temperature", 297.0, "E2"), ("current", 0.1, "E1")):
        record = staircase()
        record[f"wire.{name}"].values[:] = value
        with pytest.raises(InputError, match="expected it to follow the voltage"):
            result(record, experiments=[experiment])


def test_markers_keep_two_protocols_of_one_bag_apart(staircase):
    plain = result(staircase()).experiments[0]
    marks = tuple((30.0 * k + 0.1, f"staircase/step {k}") for k in range(51))
    marked = result(staircase(markers=((0.0, "warm up/rest"), *marks))).experiments[0]
    assert "protocol staircase" in marked.source
    assert marked.estimates[R].n == plain.estimates[R].n - 1


def behind_leads(record, leads, count):
    """The same wires, `count` in parallel, as a voltmeter before their leads (ohm) sees them."""
    scale = {"wire.voltage": 1.0 + count * leads / 2.75, "wire.current": count}
    signals = {
        name: replace(signal, values=signal.values * scale.get(name, 1.0))
        for name, signal in record.signals.items()
    }
    return replace(record, signals=signals)


def test_leads_and_parallel_wires_are_taken_off_what_is_identified(staircase, ramp):
    leads, count = 0.3, 2
    shown = (staircase(seed=5, increment=0.5), ramp(seed=5))
    records = [behind_leads(one, leads, count) for one in shown]
    stated = PARAMETERS.replace(
        {"bench.lead_resistance": leads, "wire.count": count}, {"bench.lead_resistance": 0.002}
    )
    found = identify(records, stated, ["E1", "E2", "E3"]).estimates
    for name, truth in ((R, 2.75), (H, 410.0), (CP, 350.0)):
        assert abs(found[name].value - truth) < 2.5 * found[name].std
        assert found[name].std < 0.02 * truth
    assert found[R].systematic >= count * 0.002
    unaware = identify(records, PARAMETERS, ["E1"]).estimates[R]
    assert unaware.value == pytest.approx(2.75 / count + leads, rel=2e-3)
    with pytest.raises(InputError, match="expected more than bench.lead_resistance, 5 ohm"):
        identify(shown, PARAMETERS.replace({"bench.lead_resistance": 5.0}), ["E1"])
