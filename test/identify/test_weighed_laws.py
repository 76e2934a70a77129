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

KEEP = ("voltage", "elongation")
TRANSITIONS = dict(zip(
    (f"wire.{name}_temperature" for name in (
        "austenite_start", "austenite_finish", "martensite_start", "martensite_finish")),
    (338.0, 362.0, 336.0, 314.0), strict=True,
))


def bench(law="cosine", more=()):
    return moving_lab("spring", {**TRANSITIONS, "wire.law": law, **dict(more)})


def believed():
    """The same bench, of which nobody states a law."""
    known = bench()
    stated = known.given - {"wire.law"}
    return Parameters({n: known[n] for n in stated}, known.given_uncertainty)


def run(truth, shape, seed, top=5.5, period=35.0):
    drive = strokes(truth, shape, period, 110.0, top)
    return replace(moving_record(truth, drive, seed, KEEP), path=f"{shape}_{seed}")


@pytest.fixture(scope="module", params=["cosine", "logistic", "normal"])
def weighed(request):
    truth = bench(request.param, {"wire.resistance": 2.75, "effect.latent_heat.heat": 8e3})
    records = [run(truth, shape, seed) for seed, shape in enumerate(("triangle", "step"))]
    return truth, identify(records, believed())


def test_the_records_tell_the_law(weighed):
    truth, found = weighed
    assert found.law.name == truth["wire.law"]
    assert found.law.probability > 0.9
    assert found.law.probability + sum(found.law.others.values()) == pytest.approx(1.0)
    assert found.parameters["wire.law"] == truth["wire.law"]
    again = identification_from(found.to_json(), "result")
    assert again.law == found.law


def test_a_band_holds_what_no_fit_saw(weighed):
    truth, found = weighed
    unseen = run(truth, "sine", 9, period=22.0)
    band = found.predict(unseen)["deflection"]
    moved = np.interp(band.time, unseen["elongation"].time, unseen["elongation"].values)
    stroke = np.ptp(moved)
    assert np.std(band.mean - moved) < 0.015 * stroke
    assert np.mean((moved > band.low) & (moved < band.high)) > 0.9
    assert np.mean(band.high - band.low) < 0.3 * stroke
    narrow = found.predict(unseen, probability=0.5)["deflection"]
    assert np.all(narrow.high - narrow.low < band.high - band.low)


def test_a_stated_law_is_kept_and_others_are_not_tried():
    truth = bench("logistic")
    found = identify([run(truth, "triangle", 1)], bench("cosine"))
    assert found.law.name == "cosine" and found.law.others == {}
    assert found.parameters["wire.law"] == "cosine"


def test_runs_that_differ_are_said_to_and_widen_the_band():
    rooms = (0.0, 2.5, -2.5, 1.5)
    truth = bench()
    same = [run(truth, "triangle", seed) for seed in range(4)]
    apart = [
        run(truth.replace({"environment.ambient_temperature": 296.15 + away,
                           "wire.maximum_recoverable_strain": 0.044 * (1.0 + 0.01 * away)}),
            "triangle", seed)
        for seed, away in enumerate(rooms)
    ]

    def told(records):
        found = identify(records, bench())
        (repeats,) = (
            f.numbers["repeats"] for e in found.experiments for f in e.findings
            if "repeats" in f.numbers
        )
        band = found.predict(run(truth, "step", 8))["deflection"]
        return repeats, np.mean(band.high - band.low)

    moved = [record["elongation"].values for record in apart]
    pairs = [(a, b) for k, a in enumerate(moved) for b in moved[:k]]
    measured = np.sqrt(np.mean([np.mean((a - b) ** 2) for a, b in pairs])) / np.ptp(moved[0])
    (quiet, narrow), (restless, wide) = told(same), told(apart)
    assert measured / 1.5 < restless < 1.5 * measured
    assert quiet < 0.5 * restless
    assert narrow < wide


def test_nothing_is_predicted_from_what_was_not_identified():
    with pytest.raises(InputError, match="E10"):
        identification_from({"parameters": {}, "experiments": [], "warnings": []}, "r").predict(
            run(bench(), "step", 1)
        )
