"""sma-bench linearise: E11 about any operating point."""

import json

import numpy as np
import pytest

from sma_bench.cli import main
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection
from sma_bench.synthetic.paper_specimens import composite_rig

RIG = composite_rig(Parameters.defaults())


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    write_parameters(path, RIG)
    return str(path)


def answered(tmp_path, *words):
    path = tmp_path / "linear.json"
    assert main(["linearise", *words, "--json", str(path), "--force"]) == 0
    return json.loads(path.read_text())


@pytest.mark.parametrize(("load", "way"), [("weight", -1.0), ("antagonist", 1.0), (None, 1.0)])
def test_half_of_the_largest_deflection_is_the_point_as_in_the_paper(
    load, way, rig, tmp_path, capsys, pytestconfig
):
    path = pytestconfig.rootpath / "config" / f"{load}_rig.yaml" if load else rig
    found = answered(tmp_path, "--params", str(path))
    largest = maximum_deflection(read_parameters(path))
    assert found["operating_point"]["deflection"] == pytest.approx(0.5 * way * largest)
    printed = capsys.readouterr().out
    assert "b_1 of stress" in printed and "operating point on heating" in printed


def test_gain_is_the_slope_of_the_steady_states(rig, tmp_path, branch="cooling"):
    found = answered(tmp_path, "--params", rig, "--deflection", "-0.012", "--branch", branch)
    point = found["operating_point"]
    assert point["deflection"] == pytest.approx(-0.012)
    volts = np.array(list(point["voltage"].values()))
    step = np.where(volts > 0.0, 1e-4, 0.0)
    low, high = (
        OperatingPoint.at_voltage(RIG, volts + sign * step, branch).deflection for sign in (-1, 1)
    )
    gains = [found["deflection_per_volt"][c] for c, v in point["voltage"].items() if v > 0.0]
    assert sum(gains) == pytest.approx((high - low) / 2e-4, rel=1e-3)


def test_a_report_shows_the_tangent(rig, tmp_path):
    words = ["--params", rig, "--temperature", "345", "345", "296.15", "296.15"]
    words += ["--report", str(tmp_path / "page"), "--column", "single", "--font", "6"]
    assert main(["linearise", *words]) == 0
    assert (tmp_path / "page" / "linearised.png").stat().st_size > 10_000
    page = (tmp_path / "page" / "index.html").read_text()
    assert "SHA-256" in page and "sma-bench linearise" in page and "b_1 of stress" in page
    drawn = (tmp_path / "page" / "linearised.svg").read_text()
    assert "mrad" not in page and "deflection [mm]" in drawn
    assert 'width="252' in drawn  # pt, 89 mm
    assert (tmp_path / "page" / "linearised.csv").read_text().startswith("panel,curve,")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--deflection 3.0", "deflection is 3 m, expected at most"),
        ("--voltage 1 2", "--voltage: 2 numbers, expected 1 or 4"),
        ("--temperature 200", "lies below ambient"),
        ("--set effect.latent_heat.heat=1e4", "is on, expected eqs. (10), (11) as they are"),
    ],
)
def test_a_point_that_cannot_be_is_one_line(words, said, rig, capsys):
    assert main(["linearise", "--params", rig, *words.split()]) == 2
    printed = capsys.readouterr().err
    assert said in printed and printed.count("\n") == 1
