"""Effects at the command line: each can be switched on, wrong ones are one line, all are listed."""

import json

import numpy as np
import pytest

from sma_bench.cli import main
from sma_bench.parameters.documentation import effects_page
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import read_record

SIGNALS = ("front_1.current", "back_1.temperature", "deflection")


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Options of a simulation with incomplete loops between whole ones, and its plain result."""
    folder = tmp_path_factory.mktemp("effects")
    drive = "--protocol composite_diagnosis_triangles --rate 50"
    options = ["simulate", "--params", "config/demo_rig.yaml", *drive.split()]
    assert main([*options, "--out", str(folder / "plain")]) == 0
    return options, read_record(folder / "plain")


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=list(EFFECTS))
def test_every_effect_can_be_switched_on_and_shows_where_it_says(effect, bench, tmp_path, capsys):
    options, plain = bench
    out = tmp_path / "bag"
    size = f"{effect.name}={effect.size.uncertainty:g}"
    assert main([*options, "--out", str(out), "--effect", size]) == 0
    found = read_record(out)
    # Steps are shorter where an effect is on, so the last digits differ everywhere.
    changed = [
        name
        for name in SIGNALS
        if not np.allclose(found[name].values, plain[name].values, rtol=1e-9, atol=1e-12)
    ]
    assert {name.rpartition(".")[2] for name in changed} == set(effect.acts_on)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("latend_heat=3", "unknown effect latend_heat, did you mean latent_heat?"),
        ("latent_heat", "expected NAME=VALUE"),
        ("latent_heat=", "'' is not a number"),
        ("latent_heat=nan", "effect.latent_heat.heat is nan"),
        ("latent_heat=1e9", "expected 0 to 60000 J/kg"),
        ("slack.stress=1", "effect slack: no number 'stress', expected strain"),
        ("=1", "unknown effect"),
    ],
)
def test_a_wrong_effect_is_one_line_and_writes_nothing(bench, tmp_path, capsys, text, said):
    options, _ = bench
    assert main([*options, "--out", str(tmp_path / "bag"), "--effect", text]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.startswith("sma-bench: ")
    assert said in error
    assert not (tmp_path / "bag").exists()


def test_effects_are_listed_with_stage_range_and_how_they_show(tmp_path, capsys):
    file = tmp_path / "effects.json"
    assert main(["effects", "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    listed = {entry["name"]: entry for entry in json.loads(file.read_text())["effects"]}
    assert list(listed) == list(EFFECTS)
    for name, effect in EFFECTS.items():
        line = next(line for line in printed.splitlines() if line.startswith(f"{name} "))
        assert effect.stage in line
        assert listed[name]["parameters"][0]["name"] == effect.size.name
    assert "0 to 60000 J/kg" in printed
    assert main(["effects", "--markdown"]) == 0
    assert capsys.readouterr().out == effects_page()
