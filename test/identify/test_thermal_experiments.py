"""E1 to E3 on synthetic staircases and ramps: right numbers, and wrong models noticed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wire_records import Sensors, Wire, ramp, staircase

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SIMULATOR
from sma_bench.parameters.parameter import EXACT_SENSORS
from sma_bench.protocols import load_protocol
from sma_bench.records.record import Record, Signal

R, H, T0 = "wire.resistance", "wire.heat_transfer_coefficient", "environment.ambient_temperature"
CP = "wire.specific_heat"
PARAMETERS = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)


def result(*records, experiments=("E1", "E2")):
    return identify(records, PARAMETERS, experiments)


def about(found, subject, words):
    """Texts of the warnings on a subject that hold all the words."""
    return [w for w in found.warnings if subject in w and all(word in w for word in words)]


def test_an_offset_of_the_current_sensor_is_found_and_moves_no_number():
    found = result(staircase(sensors=Sensors(offset=0.03), seed=3))
    for name, truth in ((R, 2.75), (H, 410.0), (T0, 297.3)):
        assert abs(found.estimates[name].value - truth) < 2.0 * found.estimates[name].std
    assert found.warnings == ()
    offset = next(f.numbers for f in found.experiments[0].findings if f.subject == "current")
    assert offset["offset"] == pytest.approx(0.03, abs=3 * offset["offset_std"])


@pytest.mark.compiled
def test_resistance_that_differs_between_heating_and_cooling_is_noticed():
    found = result(staircase(cooling=(780.0, 2.70)), experiments=["E1"])
    (warning,) = about(found, R, ["heating", "cooling", "depends on the phase"])
    share = float(warning.split("(")[1].split(" %")[0])
    assert share == pytest.approx(100.0 * 0.05 / 2.75, abs=0.15)
    estimate = found.estimates[R]
    assert estimate.value == pytest.approx(2.75, abs=0.002)
    assert "heating slope" in estimate.method
    assert estimate.std > 0.02


@pytest.mark.compiled
def test_resistance_that_changes_with_the_phase_is_noticed_as_a_bend():
    found = result(staircase(Wire(resistance_change=-0.05)))
    assert about(found, R, ["not a straight line"])
    # The heating is judged by measured power: h itself is constant here.
    assert about(found, H, ["not a straight line"]) == []
    assert abs(found.estimates[H].value - 410.0) < 2.0 * found.estimates[H].std


@pytest.mark.compiled
def test_coefficient_that_rises_with_temperature_is_noticed():
    found = result(staircase(Wire(bend=5e-4)))
    (warning,) = about(found, H, ["not a straight line", "rises"])
    h, known = found.estimates[H], PARAMETERS[H]
    assert known + (h.value - known) / h.informed > 410.0  # before it was joined with the known
    assert found.estimates[H].std > 5.0
    assert about(found, R, ["straight"]) == []


@pytest.mark.compiled
def test_what_a_staircase_lacks_is_said():
    unsettled = result(staircase(Wire(mass=8e-3)))
    assert about(unsettled, H, ["plateaus had not settled"])
    short = result(staircase(dwell=6.0))
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


@pytest.mark.compiled
def test_markers_keep_two_protocols_of_one_bag_apart():
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


@pytest.mark.compiled
def test_leads_and_parallel_wires_are_taken_off_what_is_identified():
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


# --- E3: ramps.

WEIGHED = Parameters(
    {n: Parameters.defaults()[n] for n in ("wire.mass", "wire.surface_area")}, EXACT_SENSORS
)
KNOWN = Parameters.of_paper().replace({R: 2.75, H: 410.0}, {R: 0.001, H: 0.4, **EXACT_SENSORS})


def found_cp(*records, parameters=KNOWN):
    found = identify(records, parameters, ["E3"])
    return found, found.estimates[CP]


def remarks(found):
    return [f.text for e in found.experiments for f in e.findings]


def test_differentiated_noise_biases_the_slope_of_the_paper_and_not_the_fit():
    found, cp = found_cp(ramp(seed=5))
    paper = found.experiments[0].details["differentiator"]
    assert abs(paper.value - 350.0) > 10.0 * abs(cp.value - 350.0)
    assert "biased by noise" in paper.method
    curves = found.experiments[0].curves
    assert len(curves["force"]) == len(curves["rate"]) == paper.n
    assert len(curves["temperature"]) == len(curves["model"]) == len(curves["voltage"])


@pytest.mark.compiled
def test_offset_between_the_clocks_is_told_from_thermal_inertia():
    delay = 0.02
    found, cp = found_cp(ramp(sensors=Sensors(100.0, 80.0, delay=delay), seed=1))
    # A camera's lag of some milliseconds looks like a delay: the two are known together.
    late = [f.numbers for f in found.experiments[0].findings if "delay" in f.numbers][0]
    assert abs(late["delay"] - delay) < 2.5 * late["delay_std"] < 0.006
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    assert any("pass for thermal inertia" in text for text in remarks(found))


@pytest.mark.compiled
@pytest.mark.parametrize("late", [300_000, 5_000_000, 9_700_000])
def test_steps_of_a_ramp_that_all_come_early_or_late_between_two_readings_are_no_delay(late):
    """As on a bench in real time, where commands and readings have one clock."""
    rig, names = Parameters.of_paper(), ("wire.voltage", "wire.temperature", "voltage_command")
    bench = VirtualBench(rig, {p.name: p.default for p in SIMULATOR})
    read, protocol, volts = {name: [] for name in names}, load_protocol("quick_ramp", rig), (0.0,)
    for command in range(40 * 20):
        at = command * 50_000_000 + late
        for reading in bench.advance(volts, at):
            if reading.kind == "power":
                read[names[0]].append((reading.time / 1e9, reading.values[0][0]))
            elif reading.kind == "temperature":
                read[names[1]].append((reading.time / 1e9, reading.values[0] + 273.15))
        volts = tuple(protocol.voltage(max(command / 20.0 - 1.0, 0.0)).tolist())
        read[names[2]].append((at / 1e9, *volts))
    signals = {n: Signal(n, u, *np.array(read[n]).T) for n, u in zip(names, "VKV", strict=True)}
    result = identify([Record(Path("bag"), 0, signals)], PARAMETERS, ["E3"])
    (found,) = result.experiments
    delay = found.details["delay"]
    assert abs(delay.value) < 2.0 * delay.std < 0.012
    (told,) = [f.numbers for f in found.findings if "delay" in f.numbers]
    assert abs(told["delay"]) < 2.0 * told["delay_std"] < 0.009
    assert not any("pass for thermal inertia" in text for text in remarks(result))


def test_without_a_jump_the_clock_offset_stays_in_the_error():
    found, cp = found_cp(ramp(rest=0.0, repeat=1))
    assert any("cannot be told from thermal inertia" in text for text in remarks(found))
    assert cp.std / cp.informed**0.5 > 0.03 * cp.value  # before it was joined with the known


@pytest.mark.compiled
def test_temperature_above_austenite_start_is_noticed_and_left_out():
    found, cp = found_cp(ramp(top=4.2))
    (warning,) = [w for w in found.warnings if "above A_s" in w]
    assert "A_s = 331.8 K" in warning
    model = found.experiments[0].curves["temperature"]
    assert np.nanmax(model) < 331.81 + 0.5
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    found, cp = found_cp(ramp(), ramp(top=4.2, seed=1))
    assert cp.n == found_cp(ramp())[1].n
    assert any("4 of 8 ramps are left out" in text for text in remarks(found))


def test_second_thermal_mass_is_noticed_in_the_residuals():
    found, cp = found_cp(ramp(lag=0.1, seed=3))
    assert abs(cp.value - 350.0) < 2.5 * cp.std
    assert any("two time constants" in w and "does not follow eq. (2)" in w for w in found.warnings)


def test_ramps_alone_give_specific_heat_and_coefficient_together():
    found, cp = found_cp(ramp(), parameters=WEIGHED.replace({R: 2.75}, {R: 0.001}))
    h = found.estimates[H]
    assert abs(h.value - 410.0) < 2.5 * h.std < 8.0
    assert abs(cp.value - 350.0) < 2.5 * cp.std < 8.0


@pytest.mark.compiled
def test_ramps_that_contradict_the_known_heat_loss_or_do_not_warm_are_noticed():
    found, cp = found_cp(ramp(Wire(coefficient=380.0)))
    assert any("ask for a steady rise +7." in w for w in found.warnings)
    assert abs(cp.value - 350.0) < 2.0 * cp.std
    with pytest.raises(InputError, match="temperature rises by .* expected 10 times"):
        found_cp(ramp(top=0.2))
