"""Wires that pull a weight, a spring or each other: diagnosed from motion and voltage alone."""

from pathlib import Path

import numpy as np
import pytest
from planted import LOADS, few_effects, machine_drive, moving_lab, moving_record, strokes

from sma_bench.diagnose import diagnose, search
from sma_bench.estimation.unknowns import unknowns_of_records
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol
from sma_bench.records import Record, Signal

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

MOVED = (*("wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat"),
         *("wire.austenite_start_temperature", "wire.martensite_finish_temperature"),
         "wire.maximum_recoverable_strain")
DUTY = {"bench.drive": "duty", "bench.supply_voltage": 12.0}
CASES = {"force": ({"effect.latent_heat.heat": 9e3}, DUTY),
         "antagonist": ({"effect.residual_strain.share": 0.1}, {"bench.lead_resistance": 0.2})}


# Stated value and standard deviation of a wire of 0.15 mm.
THIN_WIRE = {
    "load.kind": ("force", None), "load.force": (1.962, None), "wire.length": (0.2, None),
    "wire.diameter": (1.5e-4, None), "wire.mass": (2.2796e-5, None),
    "wire.surface_area": (9.4248e-5, None), "wire.resistance": (9.5744, 0.19),
    "wire.heat_transfer_coefficient": (94.97, 13.5), "wire.specific_heat": (431.55, 36.0),
    "wire.austenite_start_temperature": (343.0, 3.0),
    "wire.austenite_finish_temperature": (351.76, 3.0),
    "wire.martensite_start_temperature": (335.41, 3.0),
    "wire.martensite_finish_temperature": (326.2, 3.0), "wire.austenite_modulus": (7.31e10, 5e9),
    "wire.martensite_modulus": (2.92e10, 3e9), "wire.maximum_recoverable_strain": (0.0407, 0.004),
    "environment.ambient_temperature": (295.45, None), "bench.maximum_voltage": (30.0, None),
    "bench.maximum_current": (5.0, None)}  # fmt: skip


def diagnosed(load, effect, drive=()):
    """Diagnosis from a minute each of triangles and steps; sines are held out."""
    believed, random = moving_lab(load, drive), np.random.default_rng(4)
    off = {n: believed[n] + believed.std(n) * random.standard_normal() for n in MOVED}
    bench = believed.replace({**off, **effect})
    *seen, unseen = (
        moving_record(bench, strokes(bench, shape, 20.0, 60.0, top=5.6), seed,
                      ("voltage", "elongation", "deflection", "force"))
        for shape, seed in (("triangle", 4), ("step", 5), ("sine", 13))
    )
    with few_effects(("latent_heat", "residual_strain", "deflection_drift")):
        return diagnose(seen, believed, [unseen])


@pytest.mark.slow
@pytest.mark.parametrize("load", CASES)
def test_a_planted_effect_is_named_from_motion_and_voltage(load):
    effect, drive = CASES[load]
    found = diagnosed(load, effect, drive)
    ((number, size),) = effect.items()
    first = found.to_json()["candidates"][0]
    assert (first["name"], found.verdict) == (number.split(".")[1], "effect")
    found_size = first["parameters"][number]
    assert abs(found_size["value"] - size) < 4.0 * found_size["std"]
    assert found.shrinkage["deflection"].fraction > 0.8
    assert {o.quantities for o in found.observations} == {("deflection",)}
    assert bool(found.to_json()["where"]["side"]) == (load == "antagonist")
    assert ("side" in f"{found} {' '.join(found.to_json()['why'])}") == (load == "antagonist")


def test_an_effect_under_imposed_motion_is_named_from_the_force():
    believed = moving_lab("displacement")
    bench = believed.replace({"effect.residual_strain.share": 0.15})
    seen = [
        moving_record(bench, machine_drive(bench, shape, 20.0, 60.0), seed,
                      ("voltage", "elongation", "force"))
        for shape, seed in (("triangle", 4), ("sine", 5))
    ]
    with few_effects(("latent_heat", "residual_strain", "deflection_drift")):
        found = diagnose(seen, believed)
    assert (found.verdict, found.cause) == ("effect", ("residual_strain",))
    assert found.shrinkage["force"].fraction > 0.8 and "deflection" not in found.not_compared
    assert found.to_json()["where"]["signal"] == "force"
    assert "deflection_drift" not in {name for c in found.candidates for name in c.effects}


def test_a_drive_of_the_single_wire_is_proposed_if_parameters_may_hide_an_effect():
    found = diagnosed("spring", {"effect.latent_heat.heat": 1e3})
    proposed = found.to_json()["next_experiment"]
    assert found.verdict != "effect" and "latent_heat" in proposed["separates"]
    assert proposed["kind"] == "protocol" and "side" not in proposed["why"].split(" with ")[0]
    protocol = parse_protocol(proposed["protocol"], moving_lab("spring"))
    assert protocol.duration == pytest.approx(60.0 * proposed["minutes"], rel=0.01)


@pytest.mark.parametrize("load", LOADS)
def test_a_stated_effect_is_fitted_under_its_prior_and_is_no_candidate(load):
    name = "effect.latent_heat.heat"
    for value, std in ((0.0, 4e3), (6e3, 0.0)):
        rig = moving_lab(load, {name: value}, {name: std})
        unknowns = unknowns_of_records(rig, ("deflection",))
        found = [(item.mean, item.std) for item in unknowns.items if item.name == name]
        assert found == [(value, std)] * (std > 0.0)  # exact with an uncertainty of 0
        assert "latent_heat" not in search.possible_effects(rig, ("deflection",))


@pytest.mark.parametrize("load", ["force", "spring", "antagonist"])
def test_stated_friction_is_fitted_and_excludes_slack(load):
    for given, stds, moved in (({}, {}, False), ({}, {"load.friction": 0.2}, True),
                               ({"load.friction": 0.5}, {}, True),
                               ({"load.friction": 0.5}, {"load.friction": 0.0}, False)):
        rig = moving_lab(load, given, stds)
        assert ("load.friction" in unknowns_of_records(rig, ("deflection",)).names) == moved
        slack = "slack" in search.possible_effects(rig, ("deflection",))
        assert slack == (load == "spring" and not given and not stds)


def test_a_lag_that_pulls_recalibration_far_away_is_found_from_the_stated_parameters():
    """A thermocouple of 1.5 s on a thin wire that lifts a weight, by another simulator: from
    recalibration the search finds a camera's long exposure only, with half of the gain."""
    table = np.loadtxt(Path(__file__).with_name("thermocouple.csv"), delimiter=",", skiprows=1)
    time, volts, milliamperes, celsius, lifted = table.T
    columns = {"wire.voltage": ("V", volts), "wire.current": ("A", 1e-3 * milliamperes),
               "wire.temperature": ("K", celsius + 273.15), "elongation": ("m", -1e-3 * lifted)}
    signals = {name: Signal(name, unit, time, values) for name, (unit, values) in columns.items()}
    lab = {name: value for name, (value, _) in THIN_WIRE.items()}
    stds = {name: std for name, (_, std) in THIN_WIRE.items() if std}
    found = diagnose([Record(Path("thermocouple"), 0, signals)], Parameters(lab, stds))
    assert found.cause == ("temperature_lag",) and found.candidates[0].probability > 0.8
    size = found.to_json()["size"]["temperature_lag"]["effect.temperature_lag.time_constant"]
    assert size["value"] == pytest.approx(1.5, rel=0.05)
