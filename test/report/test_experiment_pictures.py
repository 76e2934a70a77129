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


def has_data(picture):
    drawn = [line.get_ydata() for ax in picture.figure.axes for line in ax.get_lines()]
    return any(len(values) > 2 and np.ptp(np.asarray(values, float)) > 0.0 for values in drawn)


def test_instrument_tests_are_drawn():
    isobaric = specimens.isobaric_records(PAPER)
    (alone,) = experiment_pictures(identify_isobaric(isobaric[:1], PAPER))
    contraction, diagram = experiment_pictures(identify_isobaric(isobaric, PAPER))
    tensile = identify_tensile(specimens.tensile_records(PAPER), PAPER)
    clamped = identify_thermal_expansion(specimens.clamped_record(PAPER), PAPER)
    (pulled,), (held,) = experiment_pictures(tensile), experiment_pictures(clamped)
    (joint,) = experiment_pictures(fit_constitutive(isobaric[:3], PAPER, law="contract"))
    shown = (alone, contraction, diagram, pulled, held, joint)
    assert all(map(has_data, shown)) and "(9) to (11)" in joint.caption
    assert [picture.name for picture in shown[:5]] == [
        "figure_08_upfr", "figure_08_upfr", "stress_temperature", "figure_09_tensile",
        "figure_10_thermal_expansion",
    ]  # fmt: skip
    # The diagram has lines through its points.
    (ax,) = diagram.figure.axes
    ends = [line.get_xydata() for line in ax.get_lines() if len(line.get_xdata()) == 2]
    assert len(ends) == 4
    for (cold, low), (hot, high) in ends:
        assert (high - low) / (hot - cold) == pytest.approx(7.0, abs=0.3)


@pytest.mark.slow
def test_fit_of_the_composite_is_drawn_against_its_signals():
    rig = specimens.composite_rig(PAPER)
    experiment = identify_moving_bench([protocol_record("composite_step", rig, 3)], rig)
    (picture,) = experiment_pictures(experiment)
    assert len(picture.figure.axes) == 4
    assert "deflection" in picture.figure.axes[0].get_ylabel()
    assert has_data(picture)
