"""E1 to E3 and E8 on synthetic staircases and ramps: right numbers with right errors; wrong models
and sensors are noticed."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wire_records import Sensors, Wire, changed, ramp, staircase

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.staircases import identify_thermal_expansion, steady_windows
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EXACT_SENSORS
from sma_bench.records.record import Record, Signal

R, H, T0 = "wire.resistance", "wire.heat_transfer_coefficient", "environment.ambient_temperature"
CP = "wire.specific_heat"
TRUTH, AMBIENT = {R: 2.75, H: 410.0, CP: 350.0}, 297.3
VOLTS, AMPERES = "sensor.voltage.gain", "sensor.current.gain"
PAPER = Parameters.of_paper()
PARAMETERS = PAPER.replace(uncertainty=EXACT_SENSORS)


def result(*records, experiments=("E1", "E2"), parameters=PARAMETERS):
    return identify(records, parameters, experiments)


def about(found, subject, *words):
    """Texts of the warnings on a subject that contain all the words."""
    return [w for w in found.warnings if subject in w and all(word in w for word in words)]


def remarks(found):
    return [f.text for e in found.experiments for f in e.findings]


def is_right(found, name, errors=2.0, truth=None):
    e = found.estimates[name]
    return abs(e.value - (truth or TRUTH.get(name, AMBIENT))) < errors * e.std


def test_an_offset_of_the_current_sensor_is_found_and_changes_no_result():
    found = result(staircase(sensors=Sensors(offset=0.03), seed=3))
    assert all(is_right(found, name) for name in (R, H, T0)) and found.warnings == ()
    offset = next(f.numbers for f in found.experiments[0].findings if f.subject == "current")
    assert offset["offset"] == pytest.approx(0.03, abs=3 * offset["offset_std"])


@pytest.mark.compiled
def test_resistance_that_differs_between_heating_and_cooling_is_noticed():
    found = result(staircase(cooling=(780.0, 2.70)), experiments=["E1"])
    (warning,) = about(found, R, "heating", "cooling", "depends on the phase")
    share = float(warning.split("(")[1].split(" %")[0])
    assert share == pytest.approx(100.0 * 0.05 / 2.75, abs=0.15)
    estimate = found.estimates[R]
    assert estimate.value == pytest.approx(2.75, abs=0.002)
    assert "heating slope" in estimate.method and estimate.std > 0.02


@pytest.mark.compiled
def test_a_resistance_or_a_coefficient_that_changes_is_noticed_as_a_bend():
    found = result(staircase(Wire(resistance_change=-0.05)))
    # E2 uses the measured power here, and h itself is constant.
    assert about(found, R, "not a straight line") and not about(found, H, "not a straight line")
    assert is_right(found, H)
    found = result(staircase(Wire(bend=5e-4)))
    (warning,) = about(found, H, "not a straight line", "rises")
    h, known = found.estimates[H], PARAMETERS[H]
    assert known + (h.value - known) / h.informed > 410.0  # before combination with the prior
    assert h.std > 5.0 and not about(found, R, "straight")


@pytest.mark.compiled
def test_faults_of_a_staircase_are_reported():
    unsettled = result(staircase(Wire(mass=8e-3)))
    assert about(unsettled, H, "plateaus had not settled")
    assert is_right(unsettled, H, 2.5) and is_right(result(staircase(dwell=6.0)), R, 2.5)
    given = PARAMETERS.replace({T0: 300.0}, {T0: 0.3})
    assert about(result(staircase(), experiments=["E2"], parameters=given), T0,
                 "stated ambient 300.00 K")
    for name, value, experiment in (("temperature", 297.0, "E2"), ("current", 0.1, "E1")):
        record = changed(staircase(), **{name: lambda x, value=value: 0.0 * x + value})
        with pytest.raises(InputError, match="expected it to follow the voltage"):
            result(record, experiments=[experiment])


def behind_leads(record, leads, count):
    """The record of `count` such wires in parallel, with the voltage before their leads (ohm)."""
    return changed(record, voltage=lambda x: x * (1.0 + count * leads / 2.75),
                   current=lambda x: x * count)


@pytest.mark.compiled
def test_results_are_corrected_for_leads_and_parallel_wires():
    leads, count = 0.3, 2
    shown = (staircase(seed=5, increment=0.5), ramp(seed=5))
    records = [behind_leads(one, leads, count) for one in shown]
    stated = {"bench.lead_resistance": leads, "wire.count": count}
    stated = PARAMETERS.replace(stated, {"bench.lead_resistance": 0.002})
    found = result(*records, experiments=["E1", "E2", "E3"], parameters=stated)
    for name, truth in TRUTH.items():
        assert is_right(found, name, 2.5) and found.estimates[name].std < 0.02 * truth
    assert found.estimates[R].systematic >= count * 0.002
    unaware = result(*records, experiments=["E1"]).estimates[R]
    assert unaware.value == pytest.approx(2.75 / count + leads, rel=2e-3)
    with pytest.raises(InputError, match="expected more than bench.lead_resistance, 5 ohm"):
        result(*shown, parameters=PARAMETERS.replace({"bench.lead_resistance": 5.0}))


# --- E3: ramps.
WEIGHED = Parameters(
    {n: Parameters.defaults()[n] for n in ("wire.mass", "wire.surface_area")}, EXACT_SENSORS
)
KNOWN = PAPER.replace({R: 2.75, H: 410.0}, {R: 0.001, H: 0.4, **EXACT_SENSORS})


def ramps(*records, parameters=KNOWN):
    return identify(records, parameters, ["E3"])


def test_differentiated_noise_biases_the_slope_of_the_paper_but_not_the_fit():
    found = ramps(ramp(seed=5))
    (e3,) = found.experiments
    paper, curves = e3.details["differentiator"], e3.curves
    assert abs(paper.value - 350.0) > 10.0 * abs(found.estimates[CP].value - 350.0)
    assert "biased by noise" in paper.method
    assert len(curves["force"]) == len(curves["rate"]) == paper.n
    assert len(curves["temperature"]) == len(curves["model"]) == len(curves["voltage"])


@pytest.mark.compiled
def test_an_offset_between_clocks_is_separated_from_thermal_inertia():
    found = ramps(ramp(sensors=Sensors(100.0, 80.0, delay=0.02), seed=1))
    # A camera lag of some milliseconds looks like a delay: only their sum is known.
    late = [f.numbers for f in found.experiments[0].findings if "delay" in f.numbers][0]
    assert abs(late["delay"] - 0.02) < 2.5 * late["delay_std"] < 0.006
    assert is_right(found, CP)
    assert any("pass for thermal inertia" in text for text in remarks(found))


def test_without_a_jump_the_clock_offset_stays_in_the_error():
    found = ramps(ramp(rest=0.0, repeat=1))
    cp = found.estimates[CP]
    assert any("cannot be told from thermal inertia" in text for text in remarks(found))
    assert cp.std / cp.informed**0.5 > 0.03 * cp.value  # before combination with the prior


@pytest.mark.compiled
def test_temperature_above_austenite_start_is_noticed_and_left_out():
    found = ramps(ramp(top=4.2))
    (warning,) = [w for w in found.warnings if "above A_s" in w]
    assert "A_s = 331.8 K" in warning and is_right(found, CP)
    assert np.nanmax(found.experiments[0].curves["temperature"]) < 331.81 + 0.5
    found = ramps(ramp(), ramp(top=4.2, seed=1))
    assert found.estimates[CP].n == ramps(ramp()).estimates[CP].n
    assert any("4 of 8 ramps are left out" in text for text in remarks(found))


def test_second_thermal_mass_is_noticed_in_the_residuals():
    found = ramps(ramp(lag=0.1, seed=3))
    assert is_right(found, CP, 2.5)
    assert any("two time constants" in w and "does not follow eq. (2)" in w for w in found.warnings)


def test_ramps_alone_give_specific_heat_and_coefficient_together():
    found = ramps(ramp(), parameters=WEIGHED.replace({R: 2.75}, {R: 0.001}))
    for name in (H, CP):
        assert is_right(found, name, 2.5) and 2.5 * found.estimates[name].std < 8.0


@pytest.mark.compiled
def test_ramps_that_contradict_the_known_heat_loss_or_do_not_warm_are_noticed():
    found = ramps(ramp(Wire(coefficient=380.0)))
    assert any("fit a steady rise +7." in w for w in found.warnings) and is_right(found, CP)
    with pytest.raises(InputError, match="temperature rises by .* expected 10 times"):
        ramps(ramp(top=0.2))


# --- Sensors: scale errors are in the errors, and common to the numbers that depend on them.
def both():
    return staircase(seed=3), ramp(seed=3)


def test_numbers_share_the_errors_of_their_sensors():
    known = {**EXACT_SENSORS, AMPERES: 5e-3, "sensor.temperature.spot_share": 4e-3}
    found = identify(both(), PAPER.replace(uncertainty=known))
    of_r, of_h, of_cp = (e.systematic / e.value for e in map(found.estimates.get, (R, H, CP)))
    whole = np.hypot(5e-3, 4e-3)
    assert (of_r, of_h, of_cp) == pytest.approx((5e-3, whole, of_h), rel=0.02)
    assert of_h == pytest.approx(whole, rel=0.02)
    correlation = found.correlation
    at = [correlation.names.index(name) for name in (R, H, CP)]
    matrix = correlation.matrix[np.ix_(at, at)]
    # A current that is read too low makes R too large, and h and c_p too small.
    assert matrix[0, 1] == pytest.approx(-5e-3 / whole, abs=0.05) and matrix[1, 2] > 0.9
    assert np.linalg.eigvalsh(correlation.matrix).min() > -1e-9


def test_a_stated_calibration_corrects_the_readings():
    read = [changed(one, voltage=lambda x: x / 0.97,
                    temperature=lambda x: AMBIENT + 0.8 * (x - AMBIENT),
                    current=lambda x: (x - 0.02) / 1.05) for one in both()]
    known = PAPER.replace({AMPERES: 1.05, "sensor.current.offset": 0.02, VOLTS: 0.97, T0: AMBIENT,
                           "sensor.temperature.spot_share": 0.8}, EXACT_SENSORS)
    found = identify(read, known)
    for name, truth in TRUTH.items():
        assert is_right(found, name, 3.0) and found.estimates[name].std < 0.01 * truth, name


@pytest.mark.parametrize("recorded", [False, True])
def test_a_drifting_room_is_in_the_errors_or_subtracted(recorded):
    record = staircase(seed=5, dwell=12.0)
    time = record["wire.temperature"].time
    rise = 1.5 * time / time[-1]
    record = changed(record, temperature=lambda x: x + rise)
    if recorded:
        room = Signal("ambient.temperature", "K", time[::50], AMBIENT + rise[::50])
        record.signals[room.name] = room
    found = identify([record], PARAMETERS)
    assert is_right(found, H, 3.0) and found.estimates[H].statistical < 0.01 * 410.0
    # The mean over the plateaus' windows, which lie at their ends.
    room = found.estimates[T0]
    assert abs(room.value - (AMBIENT + 0.75)) < 3.0 * room.std + 0.01
    drifts = [f.numbers["drift"] for e in found.experiments for f in e.findings
              if "drift" in f.numbers]
    assert drifts == ([] if recorded else [pytest.approx(1.5, rel=0.1)])


@pytest.mark.compiled
def test_staircases_in_different_air_are_pooled_with_a_warning():
    still, moved = (staircase(Wire(coefficient=h), seed=7, dwell=12.0) for h in (410.0, 492.0))
    assert about(result(still, moved), H, "2 staircases lie")
    assert result(still, staircase(seed=8, dwell=12.0)).warnings == ()
    # A warning about the heat loss also concerns the specific heat.
    bent = identify([staircase(Wire(bend=2e-3), dwell=12.0), ramp()], PARAMETERS)
    assert about(bent, CP, "about which E2 warns")


@pytest.mark.compiled
def test_errors_in_the_cameras_messages_replace_those_of_its_data_sheet():
    read = []
    for record in both():
        wire = record["wire.temperature"]
        std = np.hypot(0.3, 0.01 * (wire.values - AMBIENT))
        read.append(replace(record, signals={**record.signals, wire.name: replace(wire, std=std)}))
    known = PAPER.replace(uncertainty={AMPERES: 0.0, VOLTS: 0.0})
    found = identify(read, known).estimates
    for name in (H, CP):
        assert found[name].systematic == pytest.approx(0.01 * found[name].value, rel=0.1)
    assert found[T0].shares["sensor.temperature.offset"] == pytest.approx(0.3, rel=0.1)
    assert identify(read, PARAMETERS).estimates[H].systematic == pytest.approx(0.0, abs=1e-9)


# Monte Carlo: the stated errors are right.
TRIALS = 8
GAIN_STD = 3e-4  # of a calibrated voltmeter
CALIBRATED = PAPER.replace(
    uncertainty={**EXACT_SENSORS, VOLTS: GAIN_STD, "sensor.temperature.lag": 0.0}
)


def deviation(seed):
    """(3,) errors of R, h and c_p in stated standard errors, for a wire and a bench drawn anew."""
    rng = np.random.default_rng(seed)
    ranges = ((2.4, 3.2), (300.0, 500.0), (250.0, 450.0), (292.0, 303.0))
    *true, ambient = (rng.uniform(*ends) for ends in ranges)
    wire = Wire(*true, ambient=ambient)
    # No supply hits its levels exactly, and no two benches have the same converter errors.
    scale = rng.uniform(0.97, 1.03)
    gain = GAIN_STD * rng.standard_normal()
    steady = Sensors(offset=rng.normal(0.0, 0.02), scale_error=gain)
    moving = Sensors(100.0, 80.0, offset=0.01, delay=rng.uniform(-0.005, 0.005), scale_error=gain)
    # The supply is not in step with the readings: if it were, c_p would be 0.1 % low.
    lead = 4.0 + rng.uniform(0.0, 1.0 / moving.power_rate)
    records = [staircase(wire, steady, seed, 15.0, top=6.25 * scale, increment=0.5 * scale),
               ramp(wire, moving, seed + 5000, top=2.5 * scale, lead=lead)]  # fmt: skip
    found = identify(records, CALIBRATED).estimates
    return [(found[name].value - value) / found[name].std
            for name, value in zip((R, H, CP), true, strict=True)]


@pytest.mark.slow
def test_95_percent_intervals_contain_the_true_numbers_as_often_as_they_should():
    errors = np.array([deviation(s) for s in range(TRIALS)])
    # 24 numbers: 2.5 deviations of a binomial below 95 %.
    assert np.mean(np.abs(errors) < 1.96) >= 0.83
    # No bias within the spread (three deviations of the mean), and errors not too large.
    assert np.all(np.abs(errors.mean(axis=0)) < 3.0 / np.sqrt(TRIALS)), errors.mean(axis=0)
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.2


# --- E8: clamped staircases with a known factor.
NAME, THETA = "wire.thermal_expansion_factor", -0.18e6
AREA = math.pi * 0.3e-3**2 / 4.0  # m^2
UP = np.linspace(298.15, 325.15, 7)


def clamped(levels=(*UP, *UP[::-1]), preload=60e6, transform_above=math.inf):
    """A record of 30 s at each level (K), reached with an overshoot as by a PI controller."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 30.0 * len(levels), 0.05)
    k, s = (time / 30.0).astype(int), time % 30.0
    level, before = np.array(levels)[k], np.array(levels)[np.maximum(k - 1, 0)]
    temperature = level + (before - level) * np.exp(-s / 2.0) * np.cos(s / 2.5)
    stress = preload + THETA * (temperature - levels[0])
    stress = stress + 10e6 * np.maximum(temperature - transform_above, 0.0)
    force = np.maximum(stress, 0.0) * AREA + 0.02 * rng.standard_normal(len(time))
    measured = temperature + 0.2 * rng.standard_normal(len(time))
    signals = (Signal("force", "N", time + 0.013, force),
               Signal("wire.temperature", "K", time, measured))  # fmt: skip
    return Record(Path("clamped"), 0, {signal.name: signal for signal in signals})


def expansion(record, parameters=PAPER):
    experiment = identify_thermal_expansion([record], parameters)
    return experiment, experiment.estimates[NAME]


def test_the_factor_is_recovered_and_plausible_and_parallel_wires_share_the_force():
    experiment, estimate = expansion(clamped())
    assert estimate.value == pytest.approx(THETA, rel=0.03)
    assert estimate.std < 0.1 * abs(THETA)
    assert [f.severity for f in experiment.findings if f.subject == "Theta_T"] == ["info"]
    sure, unsure = (expansion(clamped(), PAPER.replace(uncertainty={"wire.diameter": std}))[1].std
                    for std in (0.0, 15e-6))
    assert unsure == pytest.approx(math.hypot(sure, 0.1 * abs(THETA)), rel=0.05)
    with pytest.raises(InputError, match="nothing to identify"):  # the force is a weight's
        identify([clamped()], PAPER.replace({"load.kind": "force", "load.force": 4.0}))
    two = expansion(clamped(), PAPER.replace({"wire.count": 2}))[1]
    half = (0.5 * estimate.value, 0.5 * estimate.std)
    assert (two.value, two.std) == pytest.approx(half, rel=0.02)


def test_plateaus_above_the_austenite_start_are_left_out_and_reported():
    levels = list(np.arange(298.15, 365.0, 5.0))
    experiment, estimate = expansion(clamped(levels, preload=30e6, transform_above=336.1))
    assert estimate.value == pytest.approx(THETA, rel=0.1)
    assert any("left out: the wire transforms" in f.text for f in experiment.findings)
    assert experiment.curves["used"].sum() < len(levels)


def test_record_without_force_or_plateaus_is_refused_by_name():
    whole = clamped()
    time = whole["force"].time
    steady = Signal("wire.temperature", "K", time, 298.0 + 0.5 * time)
    signals = {"force": replace(whole["force"], values=5.0 + 0.0 * time), steady.name: steady}
    bare = {"wire.temperature": whole["wire.temperature"]}
    for read, message in ((signals, "never holds still"), (bare, "no signal force")):
        with pytest.raises(InputError, match=message):
            expansion(replace(whole, signals=read))
    assert steady_windows(np.array([1.0]), np.array([300.0])).shape == (0, 2)
