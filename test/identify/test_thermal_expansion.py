"""E8 on synthetic clamped staircases with a known factor."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.identify.estimate import fit_linear
from sma_bench.identify.instruments.thermal_expansion import (
    check_size,
    identify_thermal_expansion,
    steady_windows,
)
from sma_bench.parameters import Parameters
from sma_bench.records.record import Record, Signal

NAME = "wire.thermal_expansion_factor"
PAPER = Parameters.of_paper()
THETA = -0.18e6
DIAMETER = 0.3e-3
AREA = math.pi * DIAMETER**2 / 4.0


def staircase(levels: list[float], hold: float = 30.0, period: float = 0.05) -> tuple:
    """Time and temperature of a PI-controlled staircase: exponential approach, overshoot."""
    time = np.arange(0.0, hold * len(levels), period)
    temperature = np.empty_like(time)
    before = levels[0]
    for k, level in enumerate(levels):
        part = (time >= k * hold) & (time < (k + 1) * hold)
        s = time[part] - k * hold
        temperature[part] = level + (before - level) * np.exp(-s / 2.0) * np.cos(s / 2.5)
        before = level
    return time, temperature


def record(
    levels: list[float] | None = None,
    theta: float = THETA,
    preload: float = 60e6,
    seed: int = 1,
    force_noise: float = 0.02,
    temperature_noise: float = 0.2,
    transform_above: float = math.inf,
) -> Record:
    up = list(np.linspace(298.15, 325.15, 7))
    levels = levels or up + up[::-1]
    rng = np.random.default_rng(seed)
    time, temperature = staircase(levels)
    stress = preload + theta * (temperature - levels[0])
    stress = stress + 10e6 * np.maximum(temperature - transform_above, 0.0)
    force = np.maximum(stress, 0.0) * AREA + force_noise * rng.standard_normal(len(time))
    measured = temperature + temperature_noise * rng.standard_normal(len(time))
    force_time = time + 0.013
    return Record(
        path=Path("clamped"),
        start_ns=0,
        signals={
            "force": Signal("force", "N", force_time, force),
            "wire.temperature": Signal("wire.temperature", "K", time, measured),
        },
    )


def test_factor_comes_back_and_is_judged_plausible() -> None:
    experiment = identify_thermal_expansion(record(), PAPER)
    estimate = experiment.estimates[NAME]
    assert estimate.value == pytest.approx(THETA, rel=0.03)
    assert estimate.std < 0.1 * abs(THETA)
    assert estimate.unit == "Pa/K"
    assert [f.severity for f in experiment.findings if f.subject == "Theta_T"] == ["info"]
    sure, unsure = (PAPER.replace(uncertainty={"wire.diameter": std}) for std in (0.0, 15e-6))
    stds = [identify_thermal_expansion(record(), p).estimates[NAME].std for p in (sure, unsure)]
    assert stds[1] == pytest.approx(math.hypot(stds[0], 0.1 * abs(THETA)), rel=0.05)


def test_plateaus_above_the_austenite_start_are_left_out_and_said() -> None:
    levels = list(np.arange(298.15, 365.0, 5.0))
    hot = record(levels=levels, preload=30e6, transform_above=336.1)
    experiment = identify_thermal_expansion(hot, PAPER)
    assert experiment.estimates[NAME].value == pytest.approx(THETA, rel=0.1)
    assert any("left out: the wire transforms" in f.text for f in experiment.findings)
    assert experiment.curves["used"].sum() < len(levels)


def test_paper_value_is_two_orders_too_large_and_of_the_other_sign() -> None:
    (finding,) = check_size(23.91e6, 0.1e6, Parameters.of_paper())
    assert finding.severity == "warning"
    assert "other sign" in finding.text
    assert "39 times the largest" in finding.text


def test_record_without_force_or_plateaus_is_refused_by_name() -> None:
    whole = record()
    time = whole["force"].time
    ramp = replace(whole["wire.temperature"], time=time, values=298.0 + 0.5 * time)
    signals = {"force": replace(whole["force"], values=5.0 + 0.0 * time), ramp.name: ramp}
    with pytest.raises(InputError, match="never holds still"):
        identify_thermal_expansion(replace(whole, signals=signals))
    bare = Record(whole.path, 0, {"wire.temperature": whole["wire.temperature"]})
    with pytest.raises(InputError, match="no signal force"):
        identify_thermal_expansion(bare)


def test_a_lone_reading_holds_still_for_no_time():
    assert steady_windows(np.array([1.0]), np.array([300.0])).shape == (0, 2)


def test_readings_that_no_bench_has_are_one_line():
    with pytest.raises(InputError, match="no straight line"):
        fit_linear(np.full((4, 2), np.inf), np.ones(4), np.eye(4))
