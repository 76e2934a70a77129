"""The checks of identification work and can fail, on a few cases; `./bench check` has all."""

import json

import numpy as np
import pytest

from examination import pieces
from examination.attack_lab.cases import ATTACKS
from examination.check import attacks, worlds
from examination.check import identification as campaign
from examination.check.identification import EXPERIMENTS
from sma_bench.identify import whole_model

# One of each kind: within the errors, warned about, seen in the record, in stated numbers, refused.
OF_WIRES = (*("E1 to E3 camera gain +5 %", "E1 to E3 lead of 0.1 ohm", "E1 to E3 camera saturates"),
            "E1 to E3 spot half filled")  # fmt: skip
OF_TABLES = (
    *("E5 sample lags 8 s", "E5 signal saturates", "E7 soft grips", "E7 a slip in the rise"),
    *("E8 spot half filled", "E8 wrong diameter: 6 % too large"),
)


def silent(result):
    return [n for n, x in result["numbers"].items() if attacks.verdict(x) == "silent"]


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.compiled) for name in OF_WIRES), *OF_TABLES]
)
def test_a_wrong_number_is_within_its_error_or_warned_about(name):
    (attack,) = [a for a in ATTACKS if name == f"{a.experiment} {a.name}"]
    result = attacks.run("attack", ATTACKS.index(attack), 0)
    assert result["numbers"] or result["refused"]
    assert silent(result) == []
    if name.endswith("half filled") and name.startswith("E1"):  # only affected numbers
        warned = {name for name, x in result["numbers"].items() if x["warnings"]}
        assert warned == {"wire.heat_transfer_coefficient", "wire.specific_heat"}


def test_a_clean_bag_raises_no_warning():
    result = attacks.judge(attacks.clean_bag(np.random.default_rng(1), 1))
    assert result["warnings"] == [] and silent(result) == []
    assert len(ATTACKS) >= 40


@pytest.mark.slow
def test_a_drawn_bench_comes_back_from_its_bags(tmp_path, monkeypatch, capsys):
    for name, rate in EXPERIMENTS.items():
        monkeypatch.setitem(EXPERIMENTS, name, 0.1 * rate)
    # One drive of the composite and one start are enough here.
    monkeypatch.delitem(EXPERIMENTS, "composite_step")
    monkeypatch.setattr(whole_model, "starts", lambda unknowns: [unknowns.start()])
    file = tmp_path / "result.json"
    # One bench is too few for the verdict: with all 17 numbers inside, coverage counts as too high.
    assert campaign.main(["--draws", "1", "--seed", "11", "--json", str(file)]) in (0, 1)
    assert "wire.mass, wire.surface_area, wire.diameter" in capsys.readouterr().out
    (result,) = json.loads(file.read_text()).values()
    numbers = result["parameters"].values()
    z = np.array([abs(n["value"] - n["truth"]) / n["std"] for n in numbers])
    assert z.size == 17 and np.mean(z < pieces.Z_95) > 0.75 and z.max() < 4.0
    assert sum(n["std"] < 0.1 * n["prior_std"] for n in numbers) > 8


@pytest.mark.compiled
def test_a_wire_of_another_simulator_returns_to_its_start(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(3)
    for world in worlds.WORLDS.values():
        wire = {n: np.mean(x) for n, x in (worlds.HELD["wires"] | world["wires"]).items()}
        run = worlds.run_of("half", world["law"], list(wire.values()), rng)
        volts, moved = run["wire.voltage"], run["elongation"]
        on = np.interp(moved.time, volts.time, volts.values) > 0.0
        assert 6e-3 < -np.median(moved.values[on]) < 30e-3
        assert np.abs(moved.values[[0, -1]]).max() < 0.02 * np.ptp(moved.values)
    played = dict.fromkeys(worlds.WAYS, 1.0) | {"laws": "cosine 100%"}
    monkeypatch.setattr(worlds, "in_pieces", lambda run, jobs, options: [played for _ in jobs])
    assert worlds.main(["--seeds", "1"]) == 0
    played["nothing stated"] = 1.6
    assert worlds.main(["--world", "logistic"]) == 1 and "outside" in capsys.readouterr().out
