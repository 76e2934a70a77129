"""A smooth input finds the stage of an unknown disturbance, and when it acts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planted import ALL, planted_record, true_bench

from sma_bench.diagnose.left_over import missed, process_noise, sensor_curve
from sma_bench.diagnose.sizes import decision_inputs
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import fit
from sma_bench.estimation.unknowns import unknowns_of

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

START, STOP = 7.5, 13.5  # s, a stroke of the back
BENCH = true_bench()


def found_in(record, measured=ALL):
    """The bench's fit to a record, and the best input to each stage."""
    problem = Problem.of([observe(record, BENCH, 0.2, measured)])
    fitted = fit(problem, unknowns_of(BENCH, (), shapes={}), np.zeros(0), rounds=1)
    return fitted, process_noise(fitted)


def changed(record, of, by):
    """The record, its signals of a quantity times 1 + by within the stretch, about 300 K."""
    zero, signals = 300.0 if of == "temperature" else 0.0, dict(record.signals)
    for name, s in record.signals.items():
        if name.rpartition(".")[2] == of:
            bump = np.clip(np.minimum(s.time - START, STOP - s.time), 0.0, 1.0)
            signals[name] = replace(s, values=zero + (s.values - zero) * (1.0 + by * bump))
    return replace(record, signals=signals)


@pytest.mark.parametrize(("of", "by", "measured", "stage"), [
    ("voltage", -0.06, ALL, "electrical"),  # the true voltage is higher than recorded
    ("voltage", -0.06, ALL[1:], "electrical"),
    ("air", 8.0, ALL, "thermal"),
    ("deflection", 0.08, ALL, "mechanical"),
    ("temperature", 0.06, ALL, "sensor"),
    ("current", 0.05, ALL, "sensor"),  # its reading alone
])
def test_the_disturbed_stage_gains_most_and_the_time_is_found(of, by, measured, stage, tmp_path):
    air = {"gust": by, "instant": START, "fading": 4.0} if of == "air" else {}
    real = BENCH.replace({f"effect.ambient_drift.{n}": v for n, v in air.items()})
    record = planted_record(tmp_path / "bag", bench=real, quantities=measured)
    fitted, inputs = found_in(changed(record, of, by), measured)
    first, second, *_ = inputs
    assert first == stage and inputs[first].gain > inputs[second].gain + 5.0
    found = missed(fitted, first, inputs[first])
    assert found.stage == stage and START - 1.5 < found.start < found.stop < STOP + 1.5


def test_a_reading_that_follows_the_drive_or_is_nonlinear_is_of_the_sensor_stage(tmp_path):
    record = planted_record(tmp_path / "bag", bench=BENCH)
    tip, volts = record["deflection"], record[f"{BENCH['bench.channels'][0]}.voltage"]
    follows = 1e-4 * np.interp(tip.time, volts.time, volts.values)
    share = tip.values / np.max(np.abs(tip.values))
    for wrong in (follows, 0.15 * tip.values * share, -0.15 * tip.values * share**2):
        read = replace(tip, values=tip.values + wrong)
        fitted, inputs = found_in(replace(record, signals={**record.signals, "deflection": read}))
        assert next(iter(inputs)) == "sensor"
        assert wrong is follows or sensor_curve(fitted) > 100.0
    fitted, inputs = found_in(record)
    assert all(one.gain < 3.0 for one in inputs.values()) and sensor_curve(fitted) < 3.0


def test_strain_that_is_lost_at_the_first_pull_is_a_rival_and_no_residual_strain(tmp_path):
    """As where crimps straighten; what remains after cooling has the other sign."""
    problem = Problem.of([observe(planted_record(tmp_path / "bag", bench=BENCH), BENCH, 0.2)])
    plain = unknowns_of(BENCH, (), shapes={})
    before = fit(problem, plain, np.zeros(0), rounds=1)
    gains = SimpleNamespace(gain=0.0, ratio=0.0, outlier=0.0)
    for share in (-0.5, 0.5):
        ended = fit(problem, plain.with_effects(["residual_strain"]), np.array([share]), rounds=0)
        found = decision_inputs(SimpleNamespace(
            recalibrated=before, nominal=before, pairs={}, problem=problem, curve=7.0,
            singles={"residual_strain": replace(ended, evidence=before.evidence + 50.0)},
            left_by_best=gains, beyond=gains, inputs_by_best={"sensor": gains}))
        gain = found.candidates["residual_strain"].gain
        assert (gain, found.curve) == ((0.0, 50.0) if share < 0.0 else (pytest.approx(50.0), 7.0))
