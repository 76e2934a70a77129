"""Wires that pull a weight, a spring or each other: diagnosed from motion and voltage alone."""

from pathlib import Path

import numpy as np
import pytest
from planted import few_effects

from sma_bench.diagnose import diagnose, search
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol
from sma_bench.records import Record, Signal
from sma_bench.synthetic.bench_records import signals_of, simulate_finely

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

PAIR = {"bench.channels": ("left", "right"), "bench.channel_sides": ("front", "back")}
LOADS = {
    "clamped": {"load.kind": "clamped"},
    "force": {"load.kind": "force", "load.force": 6.0},
    "spring": {"load.kind": "spring", "load.stiffness": 800.0, "load.preload": 6.0},
    "antagonist": {**PAIR, "load.kind": "antagonist", "load.stiffness": 200.0,
                   "load.preload": 6.0},
    "beam": {"load.kind": "beam"},
}  # fmt: skip
LAB = {"wire.length": 0.2, "wire.stress_influence_austenite": 8e6,
       "wire.stress_influence_martensite": 8e6}  # fmt: skip
PAPER = Parameters.of_paper()
FEW = ("latent_heat", "residual_strain", "deflection_drift")
MOVED = ("wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
         "wire.austenite_start_temperature", "wire.martensite_finish_temperature",
         "wire.maximum_recoverable_strain")  # fmt: skip
# Of the wire and its sensors; and of a beam only.


def recorded(bench, shape, seed):
    """A minute of strokes; voltage and motion, with 20 um of noise."""
    time = np.arange(0.0, 60.0, 0.04)
    inside = ((time - 2.0) % 20.0) / 20.0
    stroke = {"triangle": 2.0 * np.minimum(inside, 1.0 - inside),
              "step": (inside < 0.5) * (0.6 + 0.4 * ((time // 20.0) % 2)),
              "sine": np.sin(np.pi * inside) ** 2}[shape]  # fmt: skip
    wires = len(bench["bench.channels"])
    turn = (time // 20.0).astype(int) % wires
    volts = np.stack([5.6 * stroke * (turn == k) * (time > 2.0) for k in range(wires)], axis=1)
    if bench["bench.drive"] == "duty":  # the same heat
        volts = volts**2 / bench["bench.supply_voltage"]
    random = np.random.default_rng(seed)
    signals = {}
    for s in signals_of(simulate_finely(bench, time, volts)):
        quantity = s.name.rsplit(".", 1)[-1]
        if quantity in ("voltage", "elongation", "deflection", "force"):
            noise = {"voltage": 0.0, "force": 0.02}.get(quantity, 2e-5)
            values = s.values + noise * random.standard_normal(len(s.values))
            signals[s.name] = Signal(s.name, s.unit, s.time, values)
    return Record(Path(shape), 0, signals)


def diagnosed(load, effect, seed, drive=()):
    believed = PAPER.replace({**LAB, **LOADS[load], **dict(drive)}, {"load.preload": 0.5})
    random = np.random.default_rng(seed)
    off = {n: believed[n] + believed.std(n) * random.standard_normal() for n in MOVED}
    bench = believed.replace({**off, **effect})
    seen = [recorded(bench, shape, seed + k) for k, shape in enumerate(("triangle", "step"))]
    with few_effects(FEW):
        return diagnose(seen, believed, [recorded(bench, "sine", seed + 9)])


CASES = [
    ("spring", {"effect.residual_strain.share": 0.1}, ()),
    ("force", {"effect.latent_heat.heat": 9e3},
     {"bench.drive": "duty", "bench.supply_voltage": 12.0}),
    ("antagonist", {"effect.residual_strain.share": 0.1}, {"bench.lead_resistance": 0.2}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("load", "effect", "drive"),
    [CASES[0], *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES[1:])],
    ids=[case[0] for case in CASES],
)
def test_what_was_planted_is_named_from_motion_and_voltage(load, effect, drive):
    found = diagnosed(load, effect, 4, drive)
    (number, size), (name,) = next(iter(effect.items())), [n.split(".")[1] for n in effect]
    first = found.to_json()["candidates"][0]
    assert (first["name"], found.decision.verdict) == (name, "effect")
    assert (
        abs(first["parameters"][number]["value"] - size) < 4.0 * first["parameters"][number]["std"]
    )
    assert found.shrinkage["deflection"].fraction > 0.8
    assert {o.quantities for o in found.observations} == {("deflection",)}
    assert bool(found.to_json()["where"]["side"]) == (load == "antagonist")
    assert ("side" in f"{found} {' '.join(found.to_json()['why'])}") == (load == "antagonist")


def test_a_drive_of_its_one_wire_is_proposed_where_parameters_may_hide_an_effect():
    found = diagnosed("spring", {"effect.latent_heat.heat": 1e3}, 4)
    proposed = found.to_json()["next_experiment"]
    assert found.decision.verdict != "effect" and "latent_heat" in proposed["separates"]
    assert proposed["kind"] == "protocol" and "side" not in proposed["why"].split(" with ")[0]
    protocol = parse_protocol(proposed["protocol"], PAPER.replace({**LAB, **LOADS["spring"]}))
    assert protocol.duration == pytest.approx(60.0 * proposed["minutes"], rel=0.01)


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize(("value", "std"), [(0.0, 4e3), (6e3, 0.0)])
def test_an_effect_that_is_stated_is_moved_under_its_prior_and_no_candidate(load, value, std):
    name = "effect.latent_heat.heat"
    rig = PAPER.replace({**LAB, **LOADS[load], name: value}, {name: std})
    unknowns = unknowns_of_records(rig, ("deflection",))
    found = [(item.mean, item.std) for item in unknowns.items if item.name == name]
    assert found == [(value, std)] * (std > 0.0)  # of none it is exact
    assert "latent_heat" not in search._possible(rig, ("deflection",))
