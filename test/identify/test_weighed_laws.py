"""Laws of the wire weighed by records, and predictions with the limits that they hold."""

from dataclasses import replace

import numpy as np
import pytest
from planted import moving_lab, moving_record, strokes

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.identify.result import identification_from
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.report.experiment_figures import bench_fit_pictures

ROOM, STROKE = "environment.ambient_temperature", "wire.maximum_recoverable_strain"
KEEP = ("voltage", "elongation")
GRADE = dict(zip(TRANSITIONS.values(), (338.0, 362.0, 336.0, 314.0), strict=True))


def bench(law="cosine", more=()):
    return moving_lab("spring", {**GRADE, "wire.law": law, **dict(more)})


def run(truth, shape, seed, top=5.5, period=35.0):
    drive = strokes(truth, shape, period, 110.0, top)
    return replace(moving_record(truth, drive, seed, KEEP), path=f"{shape}_{seed}")


@pytest.fixture(scope="module", params=["cosine", "logistic", "normal"])
def weighed(request):
    truth = bench(request.param, {"wire.resistance": 2.75, "effect.latent_heat.heat": 8e3})
    records = [run(truth, shape, seed) for seed, shape in enumerate(("triangle", "step"))]
    known = bench()
    stated = {n: known[n] for n in known.given - {"wire.law"}}
    believed = Parameters(stated, known.given_uncertainty)
    return truth, identify(records, believed)


def test_the_records_tell_the_law_and_its_band_holds_what_no_fit_saw(weighed):
    truth, found = weighed
    assert found.law.name == found.parameters["wire.law"] == truth["wire.law"]
    # Where the load orients all martensite, brinson is the cosine.
    same = found.law.others.get("brinson", 0.0) if found.law.name == "cosine" else 0.0
    assert found.law.probability > 0.6 and found.law.probability + same > 0.9
    assert found.law.probability + sum(found.law.others.values()) == pytest.approx(1.0)
    assert identification_from(found.to_json(), "result").law == found.law

    unseen = run(truth, "sine", 9, period=22.0)
    band, narrow = (found.predict(unseen, share)["deflection"] for share in (0.9, 0.5))
    moved = np.interp(band.time, unseen["elongation"].time, unseen["elongation"].values)
    stroke = np.ptp(moved)
    assert np.std(band.mean - moved) < 0.015 * stroke
    assert np.mean((moved > band.low) & (moved < band.high)) > 0.9
    assert np.mean(band.high - band.low) < 0.3 * stroke
    assert np.all(narrow.high - narrow.low < band.high - band.low)


def test_no_bench_that_is_drawn_misses_what_was_fitted(weighed):
    fit, places = max(
        (own for one in weighed[1].experiments[0].laws for own in one.drawn), key=lambda own: own[0]
    )[1:]
    readings = fit.problem.predict_many([fit.unknowns.parameters(x) for x in places])
    off = np.sqrt(np.mean((readings - fit.predicted[:, np.newaxis]) ** 2, axis=0))
    assert np.max(off) < 0.05 * np.ptp(fit.predicted)
    assert np.min(np.max(np.abs(places - fit.x), axis=1)) > 0.01


def test_the_report_draws_the_limits_of_another_run(weighed):
    for picture in bench_fit_pictures(weighed[1].experiments[0]):
        for axes in picture.figure.axes:
            fitted, low, high = (line.get_ydata() for line in axes.lines[1:])
            assert np.mean((fitted > low) & (fitted < high)) > 0.9


@pytest.mark.parametrize(("law", "more"), [
    ("cosine", {}), ("brinson", {"wire.detwinning_start_stress": 50e6}),
])  # fmt: skip
def test_a_stated_law_is_kept_and_others_are_not_tried(law, more):
    truth = bench("logistic" if law == "cosine" else law, more)
    found = identify([run(truth, "triangle", 1)], bench(law, more))
    assert (found.law.name, found.law.others) == (law, {}) and found.parameters["wire.law"] == law
    assert set(more) <= set(found.estimates)


def test_a_coefficient_of_which_nothing_is_stated_may_be_constant():
    h = "wire.heat_transfer_coefficient"
    truth = bench("cosine", {h: 90.0})
    stated = {n: truth[n] for n in truth.given - {h, "wire.convection"}}
    std = {n: s for n, s in truth.given_uncertainty.items() if n != h}
    records = [run(truth, shape, 1, 3.6) for shape in ("triangle", "step")]
    found = identify(records, Parameters(stated, std))
    assert found.parameters["wire.convection"] == "constant"
    unseen = run(truth, "sine", 9, 3.0, 22.0)
    band = found.predict(unseen)["deflection"]
    moved = np.interp(band.time, unseen["elongation"].time, unseen["elongation"].values)
    assert np.std(band.mean - moved) < 0.01 * np.ptp(moved)


def test_runs_that_differ_are_said_to_and_widen_the_band():
    truth = bench()

    def differing(rooms):
        """What is found of runs in rooms so many K away, which also stretch the wire."""
        benches = [
            truth.replace({ROOM: 296.15 + away, STROKE: 0.044 * (1.0 + 0.01 * away)})
            for away in rooms
        ]
        records = [run(own, "triangle", seed) for seed, own in enumerate(benches)]
        found = identify(records, truth)
        findings = [f.numbers for f in found.experiments[0].findings]
        (repeats,) = (numbers["repeats"] for numbers in findings if "repeats" in numbers)
        band = found.predict(run(truth, "step", 8))["deflection"]
        return records, repeats, np.mean(band.high - band.low)

    records, restless, wide = differing((0.0, 2.5, -2.5, 1.5))
    _, quiet, narrow = differing((0.0, 0.0, 0.0, 0.0))
    moved = [record["elongation"].values for record in records]
    pairs = [(a, b) for k, a in enumerate(moved) for b in moved[:k]]
    measured = np.sqrt(np.mean([np.mean((a - b) ** 2) for a, b in pairs])) / np.ptp(moved[0])
    assert measured / 1.5 < restless < 1.5 * measured
    assert quiet < 0.5 * restless and narrow < wide


def test_nothing_is_predicted_from_what_was_not_identified():
    with pytest.raises(InputError, match="E10"):
        identification_from({"parameters": {}, "experiments": [], "warnings": []}, "r").predict(
            run(bench(), "step", 1)
        )
