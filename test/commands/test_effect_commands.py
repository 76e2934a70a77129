"""Effects by name and size: each shows in the signals that it states, all are listed; E11 about any
operating point."""

import json

import numpy as np
import pytest

import sma_bench
from sma_bench.cli import main
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.node_tables import markdown
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.linearised import OperatingPoint, maximum_deflection
from sma_bench.synthetic.bench_records import signals_of
from sma_bench.synthetic.paper_specimens import composite_rig

# Partial loops between full ones.
DRIVE, DEMO = "composite_diagnosis_triangles", "config/demo_rig.yaml"


def readings(**effects):
    signals = signals_of(sma_bench.simulate(DRIVE, DEMO, effects=effects, rate=50.0))
    names = ("front_1.current", "back_1.temperature", "deflection")
    return {s.name.rpartition(".")[2]: s.values for s in signals if s.name in names}


@pytest.fixture(scope="module")
def plain():
    return readings()


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=list(EFFECTS))
def test_every_effect_can_be_switched_on_and_shows_where_it_says(effect, plain):
    found = readings(**{effect.name: effect.size.uncertainty})
    # The steps are shorter with an effect, so last digits differ in all signals.
    same = [q for q in plain if np.allclose(found[q], plain[q], rtol=1e-9, atol=1e-12)]
    assert set(plain) - set(same) == set(effect.acts_on)


def test_effects_are_listed_with_stage_range_and_how_they_show(tmp_path, capsys):
    file = tmp_path / "effects.json"
    assert main(["effects", "--json", str(file)]) == 0
    lines = {line.split(" ")[0]: line for line in capsys.readouterr().out.splitlines()}
    listed = {entry["name"]: entry for entry in json.loads(file.read_text())["effects"]}
    assert list(listed) == list(EFFECTS)
    for name, effect in EFFECTS.items():
        assert effect.stage in lines[name]
        assert listed[name]["parameters"][0]["name"] == effect.size.name
    assert main(["effects", "--markdown"]) == 0
    assert capsys.readouterr().out == markdown("effects")


@pytest.mark.parametrize(("load", "way"), [("weight", -1.0), ("antagonist", 1.0), (None, 1.0)])
def test_e11_is_about_half_of_the_largest_deflection_and_its_gain_the_slope_of_steady_states(
    load, way, tmp_path, capsys, pytestconfig
):
    path, answer = tmp_path / "rig.yaml", tmp_path / "linear.json"
    write_parameters(path, composite_rig(Parameters.defaults()))
    path = pytestconfig.rootpath / "config" / f"{load}_rig.yaml" if load else path
    rig = read_parameters(path)
    words = ["linearise", "--params", str(path), "--json", str(answer), "--force"]
    assert main(words) == 0
    found = json.loads(answer.read_text())
    largest = 0.5 * way * maximum_deflection(rig)
    assert found["operating_point"]["deflection"] == pytest.approx(largest)
    printed = capsys.readouterr().out
    assert "b_1 of stress" in printed and "Operating point on heating" in printed
    if load:
        return
    assert main([*words, "--deflection", "-0.012", "--branch", "cooling"]) == 0
    found = json.loads(answer.read_text())
    volts = np.array(list(found["operating_point"]["voltage"].values()))
    step = np.where(volts > 0.0, 1e-4, 0.0)
    low, high = (
        OperatingPoint.at_voltage(rig, volts + sign * step, "cooling").deflection
        for sign in (-1, 1)
    )
    gains = np.array(list(found["deflection_per_volt"].values()))[volts > 0.0]
    assert gains.sum() == pytest.approx((high - low) / 2e-4, rel=1e-3)
