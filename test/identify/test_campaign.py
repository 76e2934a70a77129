"""The campaign `./bench check identification` works, and can fail."""

import json

import numpy as np
import pytest

from examination import pieces
from examination.check import identification as campaign
from examination.simulated_lab import EXPERIMENTS, Clocks
from sma_bench.identify import whole_model


def results_with(deviations):
    """Results (draws, parameters) whose errors are these many stated standard errors."""
    return [
        {
            "seed": seed,
            "parameters": {
                name: {"truth": 1.0, "value": 1.0 + 0.1 * z, "std": 0.1, "prior_std": 1.0}
                for name, z in zip(campaign.IDENTIFIED, row, strict=True)
            },
        }
        for seed, row in enumerate(deviations)
    ]


def test_true_errors_pass_and_others_fail():
    normal = np.random.default_rng(1).standard_normal((50, len(campaign.IDENTIFIED)))
    results = results_with(normal)
    assert campaign.passed(results)
    found = [(name, z) for row in normal for name, z in zip(campaign.IDENTIFIED, row, strict=True)]
    assert pieces.print_coverage(found, pieces.Z_95) == pytest.approx(0.95, abs=0.02)
    assert not campaign.passed(results, error_scale=0.6)
    assert not campaign.passed(results, error_scale=2.0)
    del results[3]["parameters"]["wire.resistance"]
    assert not campaign.passed(results)


@pytest.mark.slow
def test_a_drawn_bench_comes_back_from_its_bags(tmp_path, monkeypatch, capsys):
    at = Clocks.at
    monkeypatch.setattr(Clocks, "at", lambda self, rate: at(self, 0.1 * rate))
    # One drive of the composite and one start are enough for a play.
    monkeypatch.delitem(EXPERIMENTS, "composite_step")
    monkeypatch.setattr(whole_model, "starts", lambda unknowns: [unknowns.start()])
    file = tmp_path / "result.json"
    # One bench is too few for the verdict itself: all 17 inside would be too many.
    assert campaign.main(["--draws", "1", "--seed", "11", "--json", str(file)]) in (0, 1)
    out, err = capsys.readouterr()
    assert "not over DDS" in out and "composite_step" not in out
    assert "wire.mass, wire.surface_area, wire.diameter" in out
    assert "1/1" in err
    results = [*json.loads(file.read_text()).values()]
    numbers = results[0]["parameters"].values()
    z = np.array([abs(n["value"] - n["truth"]) / n["std"] for n in numbers])
    assert z.size == 17 and np.mean(z < pieces.Z_95) > 0.75 and z.max() < 4.0
    assert sum(n["std"] < 0.1 * n["prior_std"] for n in numbers) > 8


def halved(job):
    return job[1] / 2


def test_a_check_in_pieces_goes_on_where_it_was_left(tmp_path, capsys):
    file = tmp_path / "kept.json"
    arguments = ["--processes", "1", "--json", str(file)]
    options = pieces.options_of("halves", None, arguments, **pieces.IN_PIECES)
    jobs = [("a", 4), ("b", 6)]
    file.write_text(json.dumps({str(jobs[0]): 7.0}))
    assert pieces.in_pieces(halved, jobs, options) == [7.0, 3.0]
    assert json.loads(file.read_text()) == {str(jobs[0]): 7.0, str(jobs[1]): 3.0}
