"""A smooth input names the stage of what no effect is like, and when it acts."""

from dataclasses import replace

import numpy as np
import pytest
from planted import ALL, planted_record, true_bench

from sma_bench.diagnose.process_noise import missed, process_noise
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
    ("voltage", -0.06, ALL[1:], "thermal"),  # more power than was recorded
    ("current", 0.05, ALL, "electrical"),
    ("deflection", 0.08, ALL, "mechanical"),
    ("temperature", 0.06, ALL, "sensor"),
])  # fmt: skip
def test_the_stage_that_something_acts_on_gains_most_and_when(of, by, measured, stage, tmp_path):
    bench = true_bench()
    record = changed(planted_record(tmp_path / "bag", bench=bench, quantities=measured), of, by)
    problem = Problem.of([observe(record, bench, 0.2, measured)])
    found = fit(problem, unknowns_of(bench, (), shapes={}), np.zeros(0), rounds=1)
    inputs = process_noise(found)
    first, second, *_ = inputs
    assert first == stage and inputs[first].gain > inputs[second].gain + 5.0
    said = missed(found, first, inputs[first])
    assert said.stage == stage and START - 1.5 < said.start < said.stop < STOP + 1.5


def test_where_nothing_is_missing_no_input_gains(tmp_path):
    bench = true_bench()
    record = planted_record(tmp_path / "bag", bench=bench)
    problem = Problem.of([observe(record, bench, 0.2, ALL)])
    found = fit(problem, unknowns_of(bench, (), shapes={}), np.zeros(0), rounds=1)
    assert all(one.gain < 3.0 for one in process_noise(found).values())
