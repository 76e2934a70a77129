"""Limits of a simulated run, from the uncertainties of a parameter file."""

import json

import numpy as np
import pytest
from planted import moving_lab, strokes

from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.estimation.laws import band_of
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.physics import simulate
from sma_bench.synthetic.bench_records import signals_of


def test_a_band_holds_a_bench_within_the_stated_uncertainties():
    known = moving_lab("spring", stds={"wire.resistance": 0.1, "load.stiffness": 40.0})
    time, volts = strokes(known, "triangle", 30.0, 60.0)

    def asked(bench):
        return signals_of(simulate(bench, time, volts))

    band = band_of(known, asked, 0.9)
    low, high = band["elongation"].low, band["elongation"].high
    assert not any(name.endswith("voltage") for name in band)
    within, far = (
        simulate(known.replace({"wire.resistance": ohms}), time, volts).elongation[:, 0]
        for ohms in (known["wire.resistance"] - 0.05, known["wire.resistance"] - 0.8)
    )
    assert np.all((within >= low) & (within <= high))
    assert np.mean((far >= low) & (far <= high)) < 0.8


def test_a_band_needs_uncertainties_and_a_share():
    with pytest.raises(InputError, match="uncertainty"):
        band_of(Parameters.defaults(), lambda bench: None, 0.9)
    with pytest.raises(InputError, match="share"):
        band_of(moving_lab("spring"), lambda bench: [], 1.0)


def test_the_command_adds_the_band_to_its_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_parameters("lab.yaml", moving_lab("spring"))
    asked = ["simulate", "--protocol", "quick_ramp", "--params", "lab.yaml", "--rate", "10"]
    assert main([*asked, "--out", "made", "--band", "0.9", "--json", "made.json"]) == 0
    band = json.loads((tmp_path / "made.json").read_text())["band"]
    low, high = (np.array(band["limits"]["elongation"][end]) for end in ("low", "high"))
    assert band["share"] == 0.9 and len(band["time"]) == len(low) and np.all(low < high)
    assert main([*asked, "--out", "again", "--band", "0.9"]) == 2
