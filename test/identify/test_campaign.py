"""The campaign `./bench check identification` works, and can fail."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

CHECK = Path(__file__).resolve().parents[1] / "check"


@pytest.fixture(scope="module")
def campaign():
    sys.path.insert(0, str(CHECK))
    spec = importlib.util.spec_from_file_location("campaign", CHECK / "identification.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def results_with(campaign, deviations):
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


def test_true_errors_pass_and_others_fail(campaign):
    normal = np.random.default_rng(1).standard_normal((50, len(campaign.IDENTIFIED)))
    results = results_with(campaign, normal)
    honest = campaign.summarise(results)
    assert honest["passed"]
    assert honest["coverage"] == pytest.approx(0.95, abs=0.02)
    assert honest["interval"][0] < 0.95 < honest["interval"][1]
    assert not campaign.summarise(results, error_scale=0.6)["passed"]
    assert not campaign.summarise(results, error_scale=2.0)["passed"]


def test_a_missing_estimate_fails(campaign):
    results = results_with(
        campaign, np.random.default_rng(1).standard_normal((50, len(campaign.IDENTIFIED)))
    )
    del results[3]["parameters"]["wire.resistance"]
    summary = campaign.summarise(results)
    assert summary["missing"] == 1
    assert not summary["passed"]
    assert summary["parameters"]["wire.resistance"]["n"] == 49


def test_clopper_pearson_is_the_exact_interval(campaign):
    # 47 of 50: the table of Clopper and Pearson (1934), continued.
    assert campaign.clopper_pearson(47, 50) == pytest.approx((0.8345, 0.9875), abs=1e-4)
    assert campaign.clopper_pearson(50, 50)[1] == 1.0
    assert campaign.clopper_pearson(0, 50)[0] == 0.0


@pytest.mark.slow
def test_a_drawn_bench_comes_back_from_its_bags(campaign, tmp_path, monkeypatch, capsys):
    from simulated_lab.instruments import Instruments

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
