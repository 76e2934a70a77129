"""Experiments whose pictures are none of the paper's (test_paper.py) have theirs."""

import numpy as np
import pytest

from sma_bench.identify.constitutive.joint_fit import fit_constitutive
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.whole_model import identify_moving_bench
from sma_bench.parameters import Parameters
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.synthetic import paper_specimens as specimens
from sma_bench.synthetic.bench_records import protocol_record

PAPER = Parameters.defaults()


def test_a_diagram_a_joint_fit_and_a_moving_bench_are_drawn():
    isobaric = specimens.isobaric_records(PAPER)
    rig = specimens.composite_rig(PAPER)
    experiments = (
        identify_isobaric(isobaric, PAPER),
        fit_constitutive(isobaric[:3], PAPER, law="contract"),
        identify_moving_bench([protocol_record("composite_step", rig, 3)], rig),
    )
    shown = [picture for experiment in experiments for picture in experiment_pictures(experiment)]
    upfr, diagram, joint, moving = shown
    assert (upfr.name, diagram.name) == ("figure_08_upfr", "stress_temperature")
    assert "(9) to (11)" in joint.caption and len(moving.figure.axes) == 4
    assert "deflection" in moving.figure.axes[0].get_ylabel()
    for picture in shown:
        drawn = [line.get_ydata() for ax in picture.figure.axes for line in ax.get_lines()]
        assert any(len(y) > 2 and np.ptp(np.asarray(y, float)) > 0.0 for y in drawn)
    # The diagram has lines through its points.
    (ax,) = diagram.figure.axes
    ends = [line.get_xydata() for line in ax.get_lines() if len(line.get_xdata()) == 2]
    assert len(ends) == 4
    for (cold, low), (hot, high) in ends:
        assert (high - low) / (hot - cold) == pytest.approx(7.0, abs=0.3)
