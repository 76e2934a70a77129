"""The chain broken at the measured temperatures: before it, after it, or the thermometer."""

import pytest
from planted import believed, planted_record

from sma_bench.diagnose.chain import (
    T_TO_DEFLECTION,
    V_TO_DEFLECTION,
    break_chain,
    reading_of,
)
from sma_bench.estimation.observation import observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import fit
from sma_bench.estimation.unknowns import unknowns_of_records

ALL = ("current", "temperature", "deflection")


def recalibrated(path, effects=None, quantities=ALL):
    view = observe(planted_record(path / "bag", effects, quantities=quantities), believed())
    unknowns = unknowns_of_records(believed(), quantities)
    problem = Problem.of([view]).with_nuisances(believed())
    return fit(problem, unknowns, unknowns.start(), far=True)


def blocks(links):
    return {link.block: link.gap for link in links}


def test_without_an_effect_every_block_is_near_its_noise(tmp_path):
    links = break_chain(recalibrated(tmp_path))
    gaps = blocks(links)
    assert list(gaps) == ["V -> current", "V -> temperature", T_TO_DEFLECTION, V_TO_DEFLECTION]
    assert gaps["V -> current"] < 0.5
    assert gaps["V -> temperature"] < 0.5
    assert gaps[V_TO_DEFLECTION] < 0.5
    for link in links:
        assert link.ci90[0] <= link.gap <= link.ci90[1]


def test_a_slow_thermometer_leaves_the_voltages_to_tell_the_deflection(tmp_path):
    links = break_chain(recalibrated(tmp_path, {"effect.temperature_lag.time_constant": 0.8}))
    gaps = blocks(links)
    assert gaps[T_TO_DEFLECTION] > 5.0 * gaps[V_TO_DEFLECTION]
    assert "temperatures is to be doubted first" in reading_of(links)


def test_a_mechanical_cause_stays_whatever_drives_the_model(tmp_path):
    links = break_chain(recalibrated(tmp_path, {"effect.residual_strain.share": 0.15}))
    gaps = blocks(links)
    assert gaps[V_TO_DEFLECTION] > 2.0
    assert gaps[T_TO_DEFLECTION] == pytest.approx(gaps[V_TO_DEFLECTION], rel=0.5)
    assert "acts after the temperature" in reading_of(links)
