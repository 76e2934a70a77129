"""The campaign `./bench check identification` works, and can fail."""

import json

import numpy as np
import pytest

from examination.check import identification as campaign


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
    honest = campaign.summarise(results)
    assert honest["passed"]
    assert honest["coverage"] == pytest.approx(0.95, abs=0.02)
    assert honest["interval"][0] < 0.95 < honest["interval"][1]
    assert not campaign.summarise(results, error_scale=0.6)["passed"]
    assert not campaign.summarise(results, error_scale=2.0)["passed"]


def test_a_missing_estimate_fails():
    results = results_with(
        np.random.default_rng(1).standard_normal((50, len(campaign.IDENTIFIED)))
    )
    del results[3]["parameters"]["wire.resistance"]
    summary = campaign.summarise(results)
    assert summary["missing"] == 1
    assert not summary["passed"]
    assert summary["parameters"]["wire.resistance"]["n"] == 49


def test_clopper_pearson_is_the_exact_interval():
    # 47 of 50: the table of Clopper and Pearson (1934), continued.
    assert campaign.clopper_pearson(47, 50) == pytest.approx((0.8345, 0.9875), abs=1e-4)
    assert campaign.clopper_pearson(50, 50)[1] == 1.0
    assert campaign.clopper_pearson(0, 50)[0] == 0.0


@pytest.mark.slow
def test_a_drawn_bench_comes_back_from_its_bags(tmp_path, monkeypatch, capsys):
    from examination.simulated_lab.instruments import Instruments

    clock = Instruments.clock
    monkeypatch.setattr(Instruments, "clock", lambda self, rate: clock(self, 0.5 * rate))
    file = tmp_path / "result.json"
    # One bench is too few for the verdict itself: all 17 inside would be too many.
    assert campaign.main(["--draws", "1", "--seed", "11", "--json", str(file)]) in (0, 1)
    out, err = capsys.readouterr()
    assert "not over DDS" in out
    assert "wire.mass, wire.surface_area, wire.diameter" in out
    assert "1/1" in err
    results = json.loads(file.read_text())["draws"]
    summary = campaign.summarise(results)
    assert summary["missing"] == 0
    assert summary["n"] == 17
    assert summary["coverage"] > 0.75
    # The same errors, stated ten times too small, are caught.
    assert campaign.summarise(results, error_scale=0.1)["coverage"] < 0.6
