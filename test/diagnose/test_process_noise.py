"""A smooth input names the stage of what no effect is like, and when it acts."""

from dataclasses import replace

import numpy as np
import pytest
from planted import ALL, planted_record, true_bench

from sma_bench.diagnose.left_over import missed, process_noise
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import fit
from sma_bench.estimation.unknowns import unknowns_of

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

START, STOP = 7.5, 13.5  # s, a stroke of the back


def bump(time):
    """(n,) up to 1 within the stretch, 0 outside."""
    return np.clip(np.minimum(time - START, STOP - time), 0.0, 1.0)


def changed(record, of, by):
    """The record, its signals of a quantity times 1 + by within the stretch, about 300 K."""
    zero = 300.0 if of == "temperature" else 0.0
    signals = {
        name: replace(s, values=zero + (s.values - zero) * (1.0 + by * bump(s.time)))
        if name.rpartition(".")[2] == of else s
        for name, s in record.signals.items()
    }  # fmt: skip
    return replace(record, signals=signals)


@pytest.mark.parametrize(("of", "by", "measured", "stage"), [
    ("voltage", -0.06, ALL, "electrical"),  # more than was recorded
    ("voltage", -0.06, ALL[1:], "electrical"),
    ("air", 8.0, ALL, "thermal"),
    ("deflection", 0.08, ALL, "mechanical"),
    ("temperature", 0.06, ALL, "sensor"),
    ("current", 0.05, ALL, "sensor"),  # its reading alone
])  # fmt: skip
def test_the_stage_that_something_acts_on_gains_most_and_when(of, by, measured, stage, tmp_path):
    bench = true_bench()
    air = {"gust": by, "instant": START, "fading": 4.0} if of == "air" else {}
    real = bench.replace({f"effect.ambient_drift.{n}": v for n, v in air.items()})
    record = changed(planted_record(tmp_path / "bag", bench=real, quantities=measured), of, by)
    problem = Problem.of([observe(record, bench, 0.2, measured)])
    found = fit(problem, unknowns_of(bench, (), shapes={}), np.zeros(0), rounds=1)
    inputs = process_noise(found)
    first, second, *_ = inputs
    assert first == stage and inputs[first].gain > inputs[second].gain + 5.0
    said = missed(found, first, inputs[first])
    assert said.stage == stage and START - 1.5 < said.start < said.stop < STOP + 1.5


@pytest.mark.parametrize("of_drive", [True, False])
def test_a_reading_that_follows_the_drive_or_bends_is_the_sensors(of_drive, tmp_path):
    bench = true_bench()
    record = planted_record(tmp_path / "bag", bench=bench)
    tip, volts = record["deflection"], record[f"{bench['bench.channels'][0]}.voltage"]
    wrong = 1e-4 * np.interp(tip.time, volts.time, volts.values)
    if not of_drive:
        wrong = 0.15 * tip.values**2 / np.max(np.abs(tip.values))
    bent = {**record.signals, "deflection": replace(tip, values=tip.values + wrong)}
    problem = Problem.of([observe(replace(record, signals=bent), bench, 0.2, ALL)])
    found = fit(problem, unknowns_of(bench, (), shapes={}), np.zeros(0), rounds=1)
    assert next(iter(process_noise(found))) == "sensor"


def test_where_nothing_is_missing_no_input_gains(tmp_path):
    bench = true_bench()
    record = planted_record(tmp_path / "bag", bench=bench)
    problem = Problem.of([observe(record, bench, 0.2, ALL)])
    found = fit(problem, unknowns_of(bench, (), shapes={}), np.zeros(0), rounds=1)
    assert all(one.gain < 3.0 for one in process_noise(found).values())
