"""Every experiment that identification knows has its pictures."""

import numpy as np
import pytest

from sma_bench.identify.constitutive.joint_fit import fit_constitutive
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.instruments.tensile import identify_tensile
from sma_bench.identify.instruments.thermal_expansion import identify_thermal_expansion
from sma_bench.identify.whole_model import identify_moving_bench
from sma_bench.parameters import Parameters
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.synthetic import paper_specimens as specimens
from sma_bench.synthetic.bench_records import protocol_record

PAPER = Parameters.defaults()


@pytest.fixture(scope="module")
def isobaric():
    return specimens.isobaric_records(PAPER)


def has_data(picture):
    drawn = [line.get_ydata() for ax in picture.figure.axes for line in ax.get_lines()]
    return any(len(values) > 2 and np.ptp(np.asarray(values, float)) > 0.0 for values in drawn)


def test_one_stress_gives_the_contraction_several_the_diagram_too(isobaric):
    names = [p.name for p in experiment_pictures(identify_isobaric(isobaric[:1], PAPER))]
    assert names == ["figure_08_upfr"]
    pictures = experiment_pictures(identify_isobaric(isobaric, PAPER))
    assert [p.name for p in pictures] == ["figure_08_upfr", "stress_temperature"]
    assert all(map(has_data, pictures))


def test_diagram_has_lines_through_its_points(isobaric):
    experiment = identify_isobaric(isobaric, PAPER)
    picture = experiment_pictures(experiment)[1]
    (ax,) = picture.figure.axes
    ends = [line.get_xydata() for line in ax.get_lines() if len(line.get_xdata()) == 2]
    assert len(ends) == 4
    for (cold, low), (hot, high) in ends:
        assert (high - low) / (hot - cold) == pytest.approx(7.0, abs=0.3)


def test_tensile_and_clamped_tests_are_drawn():
    tensile = identify_tensile(specimens.tensile_records(PAPER), PAPER)
    clamped = identify_thermal_expansion(specimens.clamped_record(PAPER), PAPER)
    names = [p.name for e in (tensile, clamped) for p in experiment_pictures(e)]
    assert names == ["figure_09_tensile", "figure_10_thermal_expansion"]


def test_constitutive_fit_is_drawn_over_its_loops(isobaric):
    (picture,) = experiment_pictures(fit_constitutive(isobaric[:3], PAPER, law="contract"))
    assert has_data(picture)
    assert "(9) to (11)" in picture.caption


@pytest.mark.slow
def test_fit_of_the_composite_is_drawn_against_its_signals():
    rig = specimens.composite_rig(PAPER)
    experiment = identify_moving_bench([protocol_record("composite_step", rig, 3)], rig)
    (picture,) = experiment_pictures(experiment)
    assert len(picture.figure.axes) == 4
    assert "deflection" in picture.figure.axes[0].get_ylabel()
    assert has_data(picture)
