"""What is claimed of held-out data is what the improved file keeps on other drives."""

from dataclasses import replace

import numpy as np
import pytest
from planted import believed, planted_record, true_bench

from sma_bench.diagnose.shrinkage import shrinkage, unknown_share
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import observe, shared_bin

NOISE = Noise(white=1e-5, drift=3e-4, time=5.0, period=0.5, usual=5e-5)


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """A record, and one of the same drive with the sides swapped."""
    folder = tmp_path_factory.mktemp("views")
    wanted = {"quantities": ("deflection",)}
    records = [
        planted_record(folder / "one", **wanted),
        planted_record(folder / "turned", turned=True, **wanted),
    ]
    shortest = shared_bin(records, believed())
    return [observe(record, believed(), shortest, ("deflection",)) for record in records]


def test_a_true_model_takes_all_of_a_gap_away_and_what_another_leaves_may_be_more_elsewhere(views):
    noise = {"deflection": replace(NOISE, drift=0.0)}
    truth, believes = true_bench(), believed()
    found = shrinkage(views, believes, truth, truth, noise)["deflection"]
    assert found.fraction > 0.95
    assert found.ci90[1] - found.ci90[0] < 0.1
    moved = ("wire.heat_transfer_coefficient", "wire.austenite_start_temperature")
    half = truth.replace({name: 0.5 * (believes[name] + truth[name]) for name in moved})
    wide = shrinkage(views, believes, half, half, noise)["deflection"]
    left = 1.0 - wide.fraction
    assert wide.ci90[0] < 1.0 - 1.4 * left
    assert wide.fraction <= wide.ci90[1] <= 1.0


def test_a_drive_that_no_record_has_shown_is_said_to_be_one(views):
    one, turned = views
    late = one.between(float(np.median(one.grid)), np.inf)
    assert unknown_share([one], [one], believed()) == 0.0
    assert unknown_share([one], [late], believed()) < 0.05
    moment = one.between(one.signals[0].time[-2], np.inf)
    assert unknown_share([one], [moment], believed()) == 0.0
    assert unknown_share([late], [one], believed()) > unknown_share([one], [turned], believed())
