"""What wires pull against, and how they are driven: closed forms, a stiff solver, the energy."""

import numpy as np
import pytest
from effect_references import refined, stiffly, triangle, typical
from numpy.testing import assert_allclose

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import wire_length, wire_length_from_mass
from sma_bench.physics import Bench, simulate
from sma_bench.physics.bending import channel_section
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.material import direct_reading

WIRE = Parameters.of_paper()
PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}


def loaded(kind, *, rig=WIRE, **numbers):
    """A rig with `load.stiffness` (N/m), `load.preload` (N), `load.force` (N)."""
    return rig.replace({"load.kind": kind, **{f"load.{k}": v for k, v in numbers.items()}})


RIGS = {
    "force": loaded("force", force=12.0),
    "spring": loaded("spring", stiffness=1500.0, preload=4.0, force=2.0),
    "antagonist": loaded("antagonist", rig=WIRE.replace(PAIR), stiffness=400.0, preload=6.0),
}
NO_DRIFT = {"effect.deflection_drift.rate": 0.0, "effect.deflection_drift.bend": 0.0}  # of a sensor
LENGTH, SECTION = wire_length(WIRE), channel_section(WIRE)
COLD = SECTION * WIRE["wire.martensite_modulus"] / LENGTH  # N/m
TIME = np.arange(4001) * 0.02
HEATED = triangle(TIME, 7.0, 80.0)


def run(rig, **changed):
    wires = len(rig["bench.channels"])
    volts = np.zeros((TIME.size, wires))
    volts[:, 0] = HEATED
    return simulate(rig.replace(changed), TIME, volts)


def test_a_weight_is_held_and_the_wire_follows_the_closed_form():
    rig = RIGS["force"]
    found = run(rig)
    assert found.force[:, 0] == pytest.approx(12.0, rel=1e-9)
    xi, rise = found.martensite_fraction[:, 0], found.temperature[:, 0] - 296.15
    modulus = 55.4e9 + xi * (22.8e9 - 55.4e9)
    sigma = 12.0 / SECTION
    strain = (sigma - rig["wire.thermal_expansion_factor"] * rise) / modulus
    strain -= rig["wire.maximum_recoverable_strain"] * (1.0 - xi)
    strain -= sigma / 22.8e9  # the bench at rest is where it counts from
    assert found.elongation[:, 0] == pytest.approx(LENGTH * strain, abs=1e-12)
    assert xi.min() < 1e-6 and np.ptp(found.elongation) > 7e-3
    # Three wires in parallel share the load and draw their current each; twice as long, twice.
    three = run(rig, **{"wire.count": 3, "load.force": 36.0})
    assert three.elongation == pytest.approx(found.elongation, abs=1e-12)
    assert three.force == pytest.approx(3.0 * found.force)
    assert three.current == pytest.approx(3.0 * found.current)
    assert wire_length_from_mass(WIRE) == LENGTH == pytest.approx(0.1996, abs=1e-4)
    longer = run(rig, **{"wire.length": 2.0 * LENGTH})
    assert longer.elongation == pytest.approx(2.0 * found.elongation)


@pytest.mark.parametrize(("stiffness", "held"), [(1200.0, 5.0), (0.0, 9.0)])
def test_a_stiff_solver_that_knows_only_the_contract_agrees_on_a_wire_with_a_load(stiffness, held):
    load = {"stiffness": stiffness, "preload": held} if stiffness else {"force": held}
    rig = loaded("spring" if stiffness else "force", **load)
    rig = rig.replace({"effect.latent_heat.heat": 8e3})
    time = np.arange(0.0, 24.0, 0.2)
    volts = triangle(time, 7.0, 24.0)[:, np.newaxis]
    other = stiffly(rig, time, volts, 1e-7, stiffness * LENGTH / SECTION, held / SECTION)
    found = simulate(rig, *refined(time, volts, 20))
    scales = {"temperature": 0.3, "martensite_fraction": 3e-3, "stress": 3e5, "contraction": 3e-5}
    for name, scale in scales.items():
        assert np.abs(getattr(found, name)[::20] - other[name]).max() < scale, name
    assert found.martensite_fraction.min() < 0.6


BEAM = {
    "composite.deflection_per_strain": LENGTH,
    "composite.stress_per_deflection_front": 1500.0 / SECTION,
}
STILL = WIRE.replace({"wire.thermal_expansion_factor": 0.0})  # the cold wire would pull as it warms
STIFFEST = BY_NAME["load.stiffness"].high
WEIGHT, SOFT = loaded("force", force=9.0), loaded("spring", stiffness=1e-4, preload=9.0)
ON_SPRING = loaded("spring", stiffness=1500.0)
SLIDER = loaded("antagonist", rig=STILL.replace(PAIR), stiffness=400.0, preload=6.0)
AGAINST_COLD = loaded("spring", rig=STILL, stiffness=400.0 + COLD, preload=6.0)
SAME = {  # two loads on which each effect does the same: rigs, sign of the motion, accuracy
    ("spring", "beam"): (ON_SPRING, loaded("beam", rig=WIRE.replace(BEAM)), -1.0, 1e-6),
    ("force", "spring"): (WEIGHT, SOFT, 1.0, 1e-6),
    ("clamped", "spring"): (WIRE, loaded("spring", stiffness=STIFFEST), None, 1e-3),
    ("antagonist", "spring"): (SLIDER, AGAINST_COLD, -1.0, 1e-6),
}


@pytest.mark.parametrize(
    ("loads", "effect"),
    [(k, e.name) for k in SAME for e in EFFECTS.values() if set(k) <= set(e.loads)],
    ids=str,
)
def test_an_effect_on_one_load_is_the_one_on_another_that_does_the_same(loads, effect):
    """The beam's are held to equations of their own in test_effect_equations.py."""
    one, other, sign, accuracy = SAME[loads]
    drift = {} if loads == ("force", "spring") else NO_DRIFT
    here, there = (run(typical(rig, effect), **drift) for rig in (one, other))
    for name in ("temperature", "martensite_fraction", "stress", "temperature_reading"):
        actual, expected = getattr(here, name)[:, 0], getattr(there, name)[:, 0]
        assert_allclose(actual, expected, 1e-6, accuracy * np.ptp(expected), err_msg=name)
    if sign:
        moved = sign * there.deflection_reading
        assert_allclose(here.deflection_reading, moved, atol=accuracy * np.ptp(moved))
        assert np.ptp(here.martensite_fraction[:, 0]) > 0.3


@pytest.mark.parametrize("name", RIGS)
def test_the_work_done_on_a_load_is_what_it_stores_and_a_live_bench_goes_there(name):
    """Of the sum of F dx over the wires, a weight and springs keep all: no force is lost."""
    rig, found = RIGS[name], run(RIGS[name])
    x = found.deflection if name == "antagonist" else -found.elongation[:, 0]
    pull = found.force[:, 0] - (found.force[:, 1] if name == "antagonist" else 0.0)
    work = np.sum(0.5 * (pull[1:] + pull[:-1]) * np.diff(x[: TIME.size]))
    held = rig["load.force"] + (rig["load.preload"] if name == "spring" else 0.0)
    stored = 0.5 * rig["load.stiffness"] * (x[-1] ** 2 - x[0] ** 2) + held * (x[-1] - x[0])
    assert work == pytest.approx(stored, abs=1e-9)
    live = Bench(rig)
    for k in range(2000):
        live.advance(found.voltage[k], TIME[k + 1] - TIME[k])
    assert live.deflection == pytest.approx(found.deflection[2000], abs=1e-12)
    assert live.force == pytest.approx(found.force[2000], rel=1e-9)


SLOW = {"effect.ambient_drift.rate": 1e-12}  # takes the longer way of a step


@pytest.mark.parametrize("effects", [{}, SLOW])
def test_a_duty_heats_with_its_share_of_the_supplys_square(effects):
    """On 1/4 of the time at 12 V heats as 6 V do, its mean is 3 V, and a record reads 6 V."""
    held = np.full(TIME.size, 1.0)
    steady = simulate(WIRE.replace(effects), TIME, 6.0 * held)
    switched = WIRE.replace({"bench.drive": "duty", "bench.supply_voltage": 12.0, **effects})
    duty = simulate(switched, TIME, 3.0 * held)
    assert duty.temperature == pytest.approx(steady.temperature, rel=1e-12)
    assert duty.current[0, 0] == pytest.approx(3.0 / WIRE["wire.resistance"])
    volts, amperes = direct_reading(duty.parameters, duty.voltage, duty.current)
    assert volts == pytest.approx(6.0) and amperes == pytest.approx(steady.current)


def test_a_current_source_heats_more_where_the_resistance_rises_and_a_voltage_less():
    rises = {"effect.phase_dependent_resistance.temperature_coefficient": 1e-3}
    held = np.full(TIME.size, 4.0)
    plain, volts, amperes = (
        simulate(WIRE.replace(given), TIME, held)
        for given in ({}, rises, {**rises, "bench.drive": "current"})
    )
    assert volts.temperature[-1] < plain.temperature[-1] - 0.5 < amperes.temperature[-1] - 1.0
    assert amperes.current == pytest.approx(plain.current)
    loss = WIRE["wire.heat_transfer_coefficient"] * WIRE["wire.surface_area"]
    rise = amperes.temperature[-1, 0] - 296.15
    heat = amperes.current[0, 0] ** 2 * WIRE["wire.resistance"] * (1.0 + 1e-3 * rise)
    assert rise == pytest.approx(heat / loss, rel=1e-4)


@pytest.mark.parametrize(("count", "effects"), [(1, {}), (2, SLOW)])
def test_leads_take_their_share_of_the_voltage(effects, count):
    rig = WIRE.replace({"bench.lead_resistance": 0.5, "wire.count": count, **effects})
    found = simulate(rig, TIME, np.full(TIME.size, 6.0))
    ohm = WIRE["wire.resistance"] / count
    assert found.current[0, 0] == pytest.approx(6.0 / (ohm + 0.5))
    alone = simulate(WIRE.replace(effects), TIME, np.full(TIME.size, 6.0 * ohm / (ohm + 0.5)))
    assert found.temperature == pytest.approx(alone.temperature, rel=1e-12)
