"""What wires pull against, and how they are driven: closed forms, a stiff solver, the energy."""

import numpy as np
import pytest
from effect_references import refined, typical
from numpy.testing import assert_allclose
from stiff_solver import Wires, solve, triangle

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length, wire_length_from_mass
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import Bench, material, simulate
from sma_bench.physics.bending import channel_section
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.heat import direct_reading

WIRE = Parameters.of_paper()
PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
RIGS = {
    "force": WIRE.replace({"load.kind": "force", "load.force": 12.0}),
    "spring": WIRE.replace({
        "load.kind": "spring", "load.stiffness": 1500.0, "load.preload": 4.0, "load.force": 2.0,
    }),
    "antagonist": WIRE.replace({
        **PAIR, "load.kind": "antagonist", "load.stiffness": 400.0, "load.preload": 6.0,
    }),
}
STIFFEST = BY_NAME["load.stiffness"].high
NO_DRIFT = {"effect.deflection_drift.rate": 0.0, "effect.deflection_drift.bend": 0.0}  # of a sensor
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
    modulus = rig["wire.austenite_modulus"] + xi * (
        rig["wire.martensite_modulus"] - rig["wire.austenite_modulus"]
    )
    sigma = 12.0 / channel_section(rig)
    strain = (sigma - rig["wire.thermal_expansion_factor"] * rise) / modulus
    strain -= rig["wire.maximum_recoverable_strain"] * (1.0 - xi)
    strain -= sigma / rig["wire.martensite_modulus"]  # the bench at rest is where it counts from
    assert found.elongation[:, 0] == pytest.approx(wire_length(rig) * strain, abs=1e-12)
    assert xi.min() < 1e-6 and np.ptp(found.elongation) > 7e-3


def test_a_wire_that_does_not_transform_and_a_spring_are_two_springs():
    rig = RIGS["spring"].replace({"wire.austenite_start_temperature": 700.0,
                                  "wire.austenite_finish_temperature": 720.0})
    found = run(rig)
    own = channel_section(rig) * rig["wire.martensite_modulus"] / wire_length(rig)
    rise = found.temperature[:, 0] - 296.15
    pulls = channel_section(rig) * rig["wire.thermal_expansion_factor"] * rise
    shorter = pulls / (own + 1500.0)  # from where martensite bears 6 N
    assert found.elongation[:, 0] == pytest.approx(-shorter, abs=1e-13)
    assert found.force[:, 0] == pytest.approx(6.0 + 1500.0 * shorter, rel=1e-9)


@pytest.mark.parametrize(("stiffness", "held"), [(1200.0, 5.0), (0.0, 9.0)])
def test_a_stiff_solver_that_knows_only_the_contract_agrees_on_a_wire_with_a_load(
    stiffness, held
):
    load = {"load.kind": "spring", "load.stiffness": stiffness, "load.preload": held}
    rig = WIRE.replace({"effect.latent_heat.heat": 8e3, **(
        load if stiffness else {"load.kind": "force", "load.force": held}
    )})  # fmt: skip
    time = np.arange(0.0, 24.0, 0.2)
    volts = triangle(time, 7.0, 24.0)[:, np.newaxis]
    springs = np.array([stiffness * wire_length(rig) / channel_section(rig)])
    wires = Wires(rig, np.array([0]), springs, 8e3, held / channel_section(rig))
    other = solve(wires, time, volts, rtol=1e-7)
    found = simulate(rig, *refined(time, volts, 20))
    for name, scale in (("temperature", 1.0), ("martensite_fraction", 1e-2), ("stress", 1e6),
                        ("contraction", 1e-4)):
        error = np.abs(getattr(found, name)[::20] - other[name]).max() / scale
        assert error < 0.3, (name, error)
    assert found.martensite_fraction.min() < 0.6


def effects_of(*loads):
    """Effects that all of these loads can have, each at its typical size."""
    return [e.name for e in EFFECTS.values() if set(loads) <= set(e.loads)]


MOTION = ("temperature", "martensite_fraction", "stress", "temperature_reading")


def alike(one, other, scale=1.0):
    """Whether two benches with one effect do the same; the first wire's, the motion to scale."""
    for name in MOTION:
        here, there = getattr(one, name)[:, 0], getattr(other, name)[:, 0]
        assert_allclose(here, there, rtol=1e-6, atol=1e-6 * np.ptp(there), err_msg=name)
    moved = scale * other.deflection_reading
    assert_allclose(one.deflection_reading, moved, atol=1e-6 * np.ptp(moved))
    assert np.ptp(one.martensite_fraction[:, 0]) > 0.3


@pytest.mark.parametrize("effect", effects_of("spring", "beam"))
def test_an_effect_on_a_spring_is_the_one_on_a_beam_of_the_same_stiffness(effect):
    """The beam's are held to equations of their own in test_effect_equations.py."""
    length, section = wire_length(WIRE), channel_section(WIRE)
    spring = WIRE.replace({"load.kind": "spring", "load.stiffness": 1500.0})
    beam = WIRE.replace({
        "load.kind": "beam", "composite.deflection_per_strain": length,
        "composite.stress_per_deflection_front": 1500.0 / section,
    })
    here, there = (run(typical(rig, effect), **NO_DRIFT) for rig in (spring, beam))
    alike(here, there, -1.0)


@pytest.mark.parametrize("effect", effects_of("force", "spring"))
def test_an_effect_under_a_weight_is_the_one_of_an_endlessly_soft_spring(effect):
    soft = {"load.kind": "spring", "load.stiffness": 1e-4, "load.preload": 9.0}
    weight = {"load.kind": "force", "load.force": 9.0}
    alike(*(run(typical(WIRE.replace(load), effect)) for load in (weight, soft)))


@pytest.mark.parametrize("effect", effects_of("clamped", "spring"))
def test_an_effect_on_a_clamped_wire_is_the_one_of_an_endlessly_stiff_spring(effect):
    stiff = WIRE.replace({"load.kind": "spring", "load.stiffness": STIFFEST})
    one, other = (run(typical(rig, effect), **NO_DRIFT) for rig in (WIRE, stiff))
    for name in MOTION:
        here, there = getattr(one, name), getattr(other, name)
        assert_allclose(here, there, atol=1e-3 * np.ptp(there), err_msg=name)


@pytest.mark.parametrize("effect", effects_of("antagonist", "spring"))
def test_an_effect_against_a_cold_wire_is_the_one_of_a_spring_as_stiff(effect):
    cold = channel_section(WIRE) * WIRE["wire.martensite_modulus"] / wire_length(WIRE)
    still = {"wire.thermal_expansion_factor": 0.0}
    pair = RIGS["antagonist"].replace(still)
    spring = WIRE.replace({
        **still, "load.kind": "spring", "load.stiffness": 400.0 + cold, "load.preload": 6.0,
    })
    here, there = (run(typical(rig, effect), **NO_DRIFT) for rig in (pair, spring))
    alike(here, there, -1.0)


def test_both_wires_of_an_antagonist_balance_the_slider():
    found = run(RIGS["antagonist"])
    assert found.force[0] == pytest.approx([6.0, 6.0], rel=1e-9)
    assert found.deflection[0] == pytest.approx(0.0, abs=1e-12)
    resultant = found.force[:, 0] - found.force[:, 1]
    assert resultant == pytest.approx(400.0 * found.deflection, abs=1e-8)
    assert found.contraction[:, 0] == pytest.approx(-found.contraction[:, 1], abs=1e-15)
    front = material.stress(found.temperature[:, 0], found.martensite_fraction[:, 0],
                          found.contraction[:, 0] - 6.0 / (channel_section(WIRE) * 22.8e9), WIRE)
    assert found.stress[:, 0] == pytest.approx(front, rel=1e-9)
    assert found.deflection.max() > 1e-3 and np.ptp(found.martensite_fraction[:, 0]) > 0.3


@pytest.mark.parametrize("name", RIGS)
def test_the_work_done_on_a_load_is_what_it_stores(name):
    """Of the sum of F dx over the wires, a weight and springs keep all: no force is lost."""
    rig, found = RIGS[name], run(RIGS[name])
    x = found.deflection if name == "antagonist" else -found.elongation[:, 0]
    pull = found.force[:, 0] - (found.force[:, 1] if name == "antagonist" else 0.0)
    work = np.sum(0.5 * (pull[1:] + pull[:-1]) * np.diff(x[: TIME.size]))
    held = rig["load.force"] + (rig["load.preload"] if name == "spring" else 0.0)
    stored = 0.5 * rig["load.stiffness"] * (x[-1] ** 2 - x[0] ** 2) + held * (x[-1] - x[0])
    assert work == pytest.approx(stored, abs=1e-9)
    assert np.abs(found.energy_balance().imbalance).max() < 1e-12


@pytest.mark.parametrize("name", RIGS)
def test_a_live_bench_goes_where_the_whole_record_goes(name):
    rig = RIGS[name]
    whole, live = run(rig), Bench(rig)
    for k in range(2500):
        live.advance(whole.voltage[k], TIME[k + 1] - TIME[k])
    assert live.elongation == pytest.approx(whole.elongation[2500], abs=1e-12)
    assert live.deflection == pytest.approx(whole.deflection[2500], abs=1e-12)
    assert live.force == pytest.approx(whole.force[2500], rel=1e-9)


def test_wires_in_parallel_share_the_load_and_draw_their_current_each():
    one, three = run(RIGS["force"]), run(RIGS["force"], **{"wire.count": 3, "load.force": 36.0})
    assert three.elongation == pytest.approx(one.elongation, abs=1e-12)
    assert three.force == pytest.approx(3.0 * one.force) and three.current.max() > 2.0
    assert three.current == pytest.approx(3.0 * one.current)


@pytest.mark.parametrize("effects", [{}, {"effect.ambient_drift.rate": 1e-12}])
def test_a_duty_heats_with_its_share_of_the_supplys_square(effects):
    """On 1/4 of the time at 12 V heats as 6 V do, its mean is 3 V, and a record reads 6 V."""
    held, time = np.full(TIME.size, 1.0), TIME
    steady = simulate(WIRE.replace(effects), time, 6.0 * held)
    duty = simulate(
        WIRE.replace({"bench.drive": "duty", "bench.supply_voltage": 12.0, **effects}),
        time, 3.0 * held,
    )
    assert duty.temperature == pytest.approx(steady.temperature, rel=1e-12)
    assert duty.current[0, 0] == pytest.approx(3.0 / WIRE["wire.resistance"])
    volts, amperes = direct_reading(duty.parameters, duty.voltage, duty.current)
    assert volts == pytest.approx(6.0) and amperes == pytest.approx(steady.current)
    if not effects:
        electrical = duty.energy_balance().electrical.sum()
        assert electrical == pytest.approx(0.25 * 144.0 / WIRE["wire.resistance"] * time[-1])


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


@pytest.mark.parametrize("effects", [{}, {"effect.ambient_drift.rate": 1e-12}])
@pytest.mark.parametrize("count", [1, 2])
def test_leads_take_their_share_of_the_voltage(effects, count):
    rig = WIRE.replace({"bench.lead_resistance": 0.5, "wire.count": count, **effects})
    found = simulate(rig, TIME, np.full(TIME.size, 6.0))
    ohm = WIRE["wire.resistance"] / count
    assert found.current[0, 0] == pytest.approx(6.0 / (ohm + 0.5))
    at_wire = 6.0 * ohm / (ohm + 0.5)
    alone = simulate(WIRE.replace(effects), TIME, np.full(TIME.size, at_wire))
    assert found.temperature == pytest.approx(alone.temperature, rel=1e-12)


@pytest.mark.parametrize(("given", "said"), [
    ({"load.kind": "rope"}, "load.kind is 'rope', expected clamped, force, spring, antagonist"),
    ({"load.kind": "spring"}, "load.stiffness is 0 N/m"),
    ({"load.kind": "antagonist"}, "with load.kind antagonist, expected front and back"),
    ({"load.kind": "force", **PAIR}, "with load.kind force, expected one side"),
    ({"bench.drive": "pwm"}, "bench.drive is 'pwm', expected voltage, duty, current"),
    ({"wire.count": 0}, "wire.count is 0"),
])
def test_a_load_that_cannot_be_is_one_line(given, said):
    with pytest.raises(InputError) as error:
        WIRE.replace(given)
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_given_length_is_taken_and_else_that_of_the_mass():
    assert wire_length(WIRE) == wire_length_from_mass(WIRE) == pytest.approx(0.1996, abs=1e-4)
    longer = run(RIGS["force"], **{"wire.length": 2.0 * wire_length(WIRE)})
    assert longer.elongation == pytest.approx(2.0 * run(RIGS["force"]).elongation)
