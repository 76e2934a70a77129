"""What a sensor's scale may be off by is in the errors, and shared by the numbers that it made."""

from dataclasses import replace

import numpy as np
import pytest
from wire_records import Sensors, Wire, ramp, staircase

from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EXACT_SENSORS
from sma_bench.records import Signal

R, H, CP = "wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"
TRUTH = {R: 2.75, H: 410.0, CP: 350.0}
AMBIENT = 297.3
VOLTS, AMPERES = "sensor.voltage.gain", "sensor.current.gain"


def read_by(fault, record):
    signals = {
        name: replace(s, values=fault.get(name.split(".")[1], lambda x: x)(s.values))
        for name, s in record.signals.items()
    }
    return replace(record, signals=signals)


def records():
    return staircase(seed=3), ramp(seed=3)


def test_numbers_share_the_errors_of_their_sensors():
    known = Parameters.of_paper().replace(
        uncertainty={**EXACT_SENSORS, AMPERES: 5e-3, "sensor.temperature.spot_share": 4e-3}
    )
    found = identify(records(), known)
    of_r, of_h, of_cp = (found.estimates[name] for name in (R, H, CP))
    assert of_r.systematic / of_r.value == pytest.approx(5e-3, rel=0.02)
    assert of_h.systematic / of_h.value == pytest.approx(np.hypot(5e-3, 4e-3), rel=0.02)
    assert of_cp.systematic / of_cp.value == pytest.approx(of_h.systematic / of_h.value, rel=0.02)
    correlation = found.correlation
    at = [correlation.names.index(name) for name in (R, H, CP)]
    matrix = correlation.matrix[np.ix_(at, at)]
    # A current read low makes R large, and h and c_p small.
    assert matrix[0, 1] == pytest.approx(-5e-3 / np.hypot(5e-3, 4e-3), abs=0.05)
    assert matrix[1, 2] > 0.9
    assert np.linalg.eigvalsh(correlation.matrix).min() > -1e-9


def test_a_calibration_puts_the_readings_right():
    wrong = {"current": lambda x: (x - 0.02) / 1.05, "voltage": lambda x: x / 0.97,
             "temperature": lambda x: AMBIENT + 0.8 * (x - AMBIENT)}  # fmt: skip
    known = Parameters.of_paper().replace({
        AMPERES: 1.05, "sensor.current.offset": 0.02, VOLTS: 0.97,
        "sensor.temperature.spot_share": 0.8, "environment.ambient_temperature": AMBIENT,
    }, EXACT_SENSORS)  # fmt: skip
    found = identify([read_by(wrong, one) for one in records()], known).estimates
    for name, truth in TRUTH.items():
        assert abs(found[name].value - truth) < 3.0 * found[name].std < 0.03 * truth, name


# --- What the record can show, it says.

KNOWN = Parameters.of_paper().replace(uncertainty=EXACT_SENSORS)
ROOM = "environment.ambient_temperature"


def drifting(record, kelvin, recorded=False):
    """A room that warms by so much over the record, perhaps with a thermometer in it."""
    wire = record["wire.temperature"]
    rise = kelvin * wire.time / wire.time[-1]
    signals = {**record.signals, wire.name: replace(wire, values=wire.values + rise)}
    if recorded:
        signals["ambient.temperature"] = Signal(
            "ambient.temperature", "K", wire.time[::50], AMBIENT + rise[::50]
        )
    return replace(record, signals=signals)


@pytest.mark.parametrize("recorded", [False, True])
def test_a_room_that_drifts_is_in_the_errors_or_taken_off(recorded):
    found = identify([drifting(staircase(seed=5, dwell=12.0), 1.5, recorded)], KNOWN)
    h, room = found.estimates[H], found.estimates[ROOM]
    assert abs(h.value - 410.0) < 3.0 * h.std
    assert h.statistical < 0.01 * 410.0
    # The mean over the plateaus' windows, which lie at their ends.
    assert abs(room.value - (AMBIENT + 0.75)) < 3.0 * room.std + 0.01
    said = [f for e in found.experiments for f in e.findings if "drift" in f.numbers]
    assert len(said) == (0 if recorded else 1)
    if said:
        assert said[0].numbers["drift"] == pytest.approx(1.5, rel=0.1)


@pytest.mark.compiled
def test_staircases_in_different_air_are_not_pooled_without_a_word():
    still, moved = (staircase(Wire(coefficient=h), seed=7, dwell=12.0) for h in (410.0, 492.0))
    found = identify([still, moved], KNOWN, ["E1", "E2"])
    assert any(H in w and "2 staircases lie" in w for w in found.warnings)
    alike = identify([still, staircase(seed=8, dwell=12.0)], KNOWN, ["E1", "E2"])
    assert alike.warnings == ()
    # A doubt about the heat loss is one about the specific heat.
    bent = identify([staircase(Wire(bend=2e-3), dwell=12.0), ramp()], KNOWN)
    assert any(CP in w and "of which E2 says" in w for w in bent.warnings)


@pytest.mark.compiled
def test_what_the_cameras_messages_state_takes_the_data_sheets_place():
    read = []
    for record in records():
        wire = record["wire.temperature"]
        std = np.hypot(0.3, 0.01 * (wire.values - AMBIENT))
        read.append(replace(record, signals={**record.signals, wire.name: replace(wire, std=std)}))
    known = Parameters.of_paper().replace(uncertainty={AMPERES: 0.0, VOLTS: 0.0})
    found = identify(read, known).estimates
    for name in (H, CP):
        assert found[name].systematic == pytest.approx(0.01 * found[name].value, rel=0.1)
    assert found[ROOM].shares["sensor.temperature.offset"] == pytest.approx(0.3, rel=0.1)
    stated = known.replace(uncertainty=EXACT_SENSORS)
    assert identify(read, stated).estimates[H].systematic == pytest.approx(0.0, abs=1e-9)


# --- Monte Carlo: the stated errors are true ones.

TRIALS = 12
GAIN_STD = 3e-4  # of the voltmeter; that of a calibrated one
CALIBRATED = Parameters.of_paper().replace(
    uncertainty={**EXACT_SENSORS, VOLTS: GAIN_STD, "sensor.temperature.lag": 0.0}
)


def deviation(seed):
    """(3,) errors of R, h and c_p in stated standard errors, for a wire and a bench drawn anew."""
    rng = np.random.default_rng(seed)
    ranges = ((2.4, 3.2), (300.0, 500.0), (250.0, 450.0), (292.0, 303.0))
    ohm, loss, heat, ambient = (rng.uniform(*ends) for ends in ranges)
    truth = Wire(ohm, loss, heat, ambient=ambient)
    # No supply hits its levels exactly, and no two benches have the same converter errors.
    scale = rng.uniform(0.97, 1.03)
    gain = GAIN_STD * rng.standard_normal()
    steady = Sensors(offset=rng.normal(0.0, 0.02), scale_error=gain)
    moving = Sensors(100.0, 80.0, offset=0.01, delay=rng.uniform(-0.005, 0.005), scale_error=gain)
    # Nor does a supply know when it will be read: in step with the readings c_p is 0.1 % low.
    lead = 4.0 + rng.uniform(0.0, 1.0 / moving.power_rate)
    records = [staircase(truth, steady, seed, 15.0, top=6.25 * scale, increment=0.5 * scale),
               ramp(truth, moving, seed + 5000, top=2.5 * scale, lead=lead)]  # fmt: skip
    found = identify(records, CALIBRATED).estimates
    true = zip((R, H, CP), (ohm, loss, heat), strict=True)
    return [(found[name].value - value) / found[name].std for name, value in true]


@pytest.mark.slow
def test_intervals_of_95_percent_hold_the_truth_as_often_as_they_say():
    errors = np.array([deviation(s) for s in range(TRIALS)])
    # 36 numbers: 2.5 deviations of a binomial below 95 %.
    assert np.mean(np.abs(errors) < 1.96) >= 0.86
    # And neither a bias that hides in the spread, by three deviations of a mean, nor errors for
    # show.
    assert np.all(np.abs(errors.mean(axis=0)) < 3.0 / np.sqrt(TRIALS)), errors.mean(axis=0)
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.2
