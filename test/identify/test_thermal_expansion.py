"""E8 on synthetic clamped staircases with a known factor."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify.staircases import identify_thermal_expansion, steady_windows
from sma_bench.parameters import Parameters
from sma_bench.records.record import Record, Signal

NAME = "wire.thermal_expansion_factor"
PAPER = Parameters.of_paper()
THETA = -0.18e6
AREA = math.pi * 0.3e-3**2 / 4.0  # m^2
UP = np.linspace(298.15, 325.15, 7)


def record(
    levels: Any = (*UP, *UP[::-1]), preload: float = 60e6, transform_above: float = math.inf
) -> Record:
    """Of 30 s at each of the levels (K), which a PI controller comes to with an overshoot."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 30.0 * len(levels), 0.05)
    k, s = (time / 30.0).astype(int), time % 30.0
    level, before = np.array(levels)[k], np.array(levels)[np.maximum(k - 1, 0)]
    temperature = level + (before - level) * np.exp(-s / 2.0) * np.cos(s / 2.5)
    stress = preload + THETA * (temperature - levels[0])
    stress = stress + 10e6 * np.maximum(temperature - transform_above, 0.0)
    force = np.maximum(stress, 0.0) * AREA + 0.02 * rng.standard_normal(len(time))
    measured = temperature + 0.2 * rng.standard_normal(len(time))
    signals = (Signal("force", "N", time + 0.013, force),
               Signal("wire.temperature", "K", time, measured))  # fmt: skip
    return Record(Path("clamped"), 0, {signal.name: signal for signal in signals})


def test_factor_comes_back_and_is_judged_plausible() -> None:
    experiment = identify_thermal_expansion([record()], PAPER)
    estimate = experiment.estimates[NAME]
    assert estimate.value == pytest.approx(THETA, rel=0.03)
    assert estimate.std < 0.1 * abs(THETA)
    assert [f.severity for f in experiment.findings if f.subject == "Theta_T"] == ["info"]
    sure, unsure = (PAPER.replace(uncertainty={"wire.diameter": std}) for std in (0.0, 15e-6))
    stds = [identify_thermal_expansion([record()], p).estimates[NAME].std for p in (sure, unsure)]
    assert stds[1] == pytest.approx(math.hypot(stds[0], 0.1 * abs(THETA)), rel=0.05)


def test_wires_in_parallel_share_the_force() -> None:
    one, two = (
        identify_thermal_expansion([record()], PAPER.replace({"wire.count": count})).estimates[NAME]
        for count in (1, 2)
    )
    assert (two.value, two.std) == pytest.approx((0.5 * one.value, 0.5 * one.std), rel=0.02)


def test_plateaus_above_the_austenite_start_are_left_out_and_said() -> None:
    levels = list(np.arange(298.15, 365.0, 5.0))
    hot = record(levels=levels, preload=30e6, transform_above=336.1)
    experiment = identify_thermal_expansion([hot], PAPER)
    assert experiment.estimates[NAME].value == pytest.approx(THETA, rel=0.1)
    assert any("left out: the wire transforms" in f.text for f in experiment.findings)
    assert experiment.curves["used"].sum() < len(levels)


def test_record_without_force_or_plateaus_is_refused_by_name() -> None:
    whole = record()
    time = whole["force"].time
    ramp = replace(whole["wire.temperature"], time=time, values=298.0 + 0.5 * time)
    signals = {"force": replace(whole["force"], values=5.0 + 0.0 * time), ramp.name: ramp}
    with pytest.raises(InputError, match="never holds still"):
        identify_thermal_expansion([replace(whole, signals=signals)], PAPER)
    bare = Record(whole.path, 0, {"wire.temperature": whole["wire.temperature"]})
    with pytest.raises(InputError, match="no signal force"):
        identify_thermal_expansion([bare], PAPER)


def test_a_lone_reading_holds_still_for_no_time():
    assert steady_windows(np.array([1.0]), np.array([300.0])).shape == (0, 2)
