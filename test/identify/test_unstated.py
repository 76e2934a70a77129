"""The user's data outrank a default that nobody stated, whatever the alloy and the noise."""

import numpy as np
import pytest

from examination.attack_lab.instruments import Alloy
from examination.check.alloys import coverage, examine, isobaric_tests
from sma_bench.cli import main
from sma_bench.diagnose.diagnosis import about_unstated
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameter import TRANSITIONS

TRUTH = {"A_s": 356.0, "A_f": 372.0, "M_s": 352.0, "M_f": 336.0}
OTHER = Alloy(*TRUTH.values(), 7e6, 7e6, 60e9, 28e9, 0.035, -0.2e6)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """A file of another alloy than the paper's, whose cycles differ by some kelvins."""
    folder = tmp_path_factory.mktemp("other")
    random = np.random.default_rng(2)
    (test,) = isobaric_tests(OTHER, random, folder, [100e6], scatter=8.0, cycles=8)
    return test


def found(params):
    """Value and deviation of the four temperatures."""
    return {n: (params[t], params.std(t)) for n, t in TRANSITIONS.items()}


@pytest.fixture(scope="module")
def alone(noisy):
    """What is found without any parameter file."""
    return identify([noisy], Parameters())


def test_a_noisy_test_of_another_alloy_gives_that_alloy(alone):
    for name, (value, std) in found(alone.parameters).items():
        assert 2.0 < std < 9.0
        assert abs(value - TRUTH[name]) < 2.0 * std
    assert any("another alloy" in note.text for note in alone.notes)


def test_a_template_and_the_own_result_change_nothing(noisy, alone, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alone = found(alone.parameters)
    assert main(["parameters", "--out", "template.yaml"]) == 0
    template = read_parameters("template.yaml")
    assert found(identify([noisy], template).parameters) == alone
    code = main(["identify", str(noisy.path), "--params", "template.yaml", "--out", "own.yaml"])
    assert code == 0
    own = read_parameters("own.yaml")
    assert own.given.isdisjoint({"wire.resistance", "wire.martensite_modulus"})
    again = found(identify([noisy], own).parameters)
    for name, (value, std) in again.items():
        assert value == pytest.approx(alone[name][0], abs=0.1)
        assert std == pytest.approx(alone[name][1], rel=0.06)
    # A diagnosis has the same priors from the template as from nothing.
    one, other = (
        unknowns_of_records(p, ("temperature", "deflection")) for p in (Parameters(), template)
    )
    assert one.items == other.items
    (said,) = about_unstated(one, template)
    assert "wire.specific_heat" in said.text and "wire.mass" in said.text
    paper = Parameters.of_paper()
    assert not about_unstated(unknowns_of_records(paper, ("temperature", "deflection")), paper)


def test_intervals_hold_the_truth_of_drawn_alloys():
    """`./bench check alloys` draws more."""
    # Those of few cycles, whose bootstrap is quick.
    rows = [row for draw in (0, 1, 3, 5) for row in examine(5, draw)]
    assert {row["method"] for row in rows} == {"E5", "E6", "E7", "E8"}
    assert coverage(rows) > 0.8
    assert coverage([row for row in rows if row["far"] > 3.0]) > 0.8
    assert max(abs(row["z"]) for row in rows) < 8.0
