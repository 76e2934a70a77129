"""Constitutive parameters from bags of the wire rig with a load frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from examination.check.identification import draw_bench, measured
from examination.check.rigs import FINE, WORK, draw_record, draw_rig, try_rig
from sma_bench.errors import InputError
from sma_bench.estimation.rig import Hold, find_holds
from sma_bench.identify import identify
from sma_bench.identify.isobaric import isobaric_tests
from sma_bench.identify.signals import holds_frame
from sma_bench.identify.whole_model import identify_load_frame
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records import Record, Signal

SEED = 5


@pytest.fixture(scope="module")
def lab():
    """A bench drawn at random with its isobaric and its clamped record."""
    bench = draw_bench(np.random.default_rng(SEED))
    records = {
        name: Record(Path(name), 0, {s.name: s for s in measured(name, bench.truth, SEED)})
        for name in ("isobaric", "clamped")
    }
    return bench, records


def test_clamped_staircase_alone_tells_the_thermal_expansion_factor(lab):
    bench, records = lab
    found = identify_load_frame([records["clamped"]], bench.known)
    estimate = found.estimates["wire.thermal_expansion_factor"]
    true = bench.truth["wire.thermal_expansion_factor"]
    assert abs(estimate.value - true) < 3.0 * estimate.std
    assert estimate.std < 0.02 * abs(true)
    untold = next(f for f in found.findings if f.subject == "priors").text
    assert "wire.maximum_recoverable_strain" in untold


def test_a_load_is_followed_where_it_was_measured_and_nowhere_else():
    """A stamp minutes after the last reading of the force made a fit hundreds of times slower."""
    time = np.concatenate([np.arange(0.0, 70.0, 0.05), np.arange(100.0, 160.0, 0.05)])
    force = np.where(time < 60.0, 2.0, np.where(time < 70.0, 0.2 * time - 10.0, 6.0))
    still = {"elongation": 1e-3 * np.sin(time), "force": force}
    record = Record(Path("bag"), 0, {name: Signal(name, "m", time, values) for name,
                                     values in still.items()})  # fmt: skip
    holds = find_holds(record, 0.0, 1000.0)
    assert holds[0].start == 0.0 and holds[-1].stop == 1000.0
    assert all(a.stop == b.start for a, b in zip(holds, holds[1:], strict=False))
    followed = [hold for hold in holds if not hold.steady]
    assert 40 <= len(followed) <= 80
    assert [h.value for h in followed if h.start < 85.0 < h.stop] == pytest.approx([5.0], abs=0.1)
    for hold in followed:
        if hold.stop - hold.start < 1.0 and not 69.0 < hold.start < 101.0:
            middle = 0.5 * (hold.start + hold.stop)
            assert hold.value == pytest.approx(np.interp(middle, time, force), abs=0.1)


def test_experiment_6_alone_is_done_where_it_is_asked_for(lab):
    bench, records = lab
    found = identify([records["isobaric"]], bench.known, ["E6"])
    assert [e.name for e in found.experiments] == ["E6"]
    for name, symbol in TRANSITIONS.items():
        estimate = found.estimates[symbol]
        assert abs(estimate.value - bench.truth[symbol]) < 3.0 * estimate.std, name


def test_wires_in_parallel_share_the_force_of_a_frame(lab):
    bench, records = lab
    one, two = (bench.known.replace({"wire.count": count}) for count in (1, 2))
    hold = Hold(0.0, 1.0, clamped=False, value=25.0, std=0.0)
    assert hold.boundary(0.0, two).load == 0.5 * hold.boundary(0.0, one).load
    alone, shared = ([t.stress for t in isobaric_tests(records["isobaric"], p)] for p in (one, two))
    assert alone and shared == pytest.approx(0.5 * np.array(alone))


def test_a_source_of_current_without_volts_drives_a_frame(lab):
    bench, records = lab
    read = {n: s for n, s in records["isobaric"].signals.items() if not n.endswith(".voltage")}
    record = replace(records["isobaric"], signals=read)
    assert holds_frame(record, bench.known.replace({"bench.drive": "current"}))
    assert not holds_frame(record, bench.known)


def test_a_force_that_is_neither_held_nor_clamped_is_refused(lab):
    bench, records = lab
    record = records["isobaric"]
    force = record["force"]
    wandering = 5.0 + 3.0 * np.sin(force.time / 7.0) + 0.02 * np.cos(90.0 * force.time)
    signals = {**record.signals, "force": Signal("force", "N", force.time, wandering)}
    with pytest.raises(InputError, match="expected held loads or a clamped wire"):
        identify_load_frame([replace(record, signals=signals)], bench.known)


def test_held_load_without_a_thermometer_is_fitted_all_the_same():
    rng = np.random.default_rng([38, 86])
    record = draw_record(draw_rig("force", rng), rng)
    assert {"elongation", "force"} <= set(record.signals)
    assert "front_wire.temperature" not in record.signals
    found = try_rig(86)
    assert [found[work] for work in WORK] == [FINE] * 2, found
