"""Loads, drives, imposed motion and friction, against closed forms and the energy."""

import re

import numpy as np
import pytest
from effect_references import triangle, typical
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS
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
NO_DRIFT = {p.name: 0.0 for p in EFFECTS["deflection_drift"].switches}  # of a sensor
LENGTH, SECTION = wire_length(WIRE), channel_section(WIRE)
COLD = SECTION * WIRE["wire.martensite_modulus"] / LENGTH  # N/m
TIME = np.arange(4001) * 0.02
HEATED = triangle(TIME, 7.7, 80.0)


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
    strain -= sigma / 22.8e9  # elongation counts from the bench at rest
    assert found.elongation[:, 0] == pytest.approx(LENGTH * strain, abs=1e-12)
    assert xi.min() < 1e-6 and np.ptp(found.elongation) > 7e-3
    # Three parallel wires share the load and each draw their current; elongation goes with length.
    three = run(rig, **{"wire.count": 3, "load.force": 36.0})
    assert three.elongation == pytest.approx(found.elongation, abs=1e-12)
    assert three.force == pytest.approx(3.0 * found.force)
    assert three.current == pytest.approx(3.0 * found.current)
    assert wire_length_from_mass(WIRE) == LENGTH == pytest.approx(0.1996, abs=1e-4)
    longer = run(rig, **{"wire.length": 2.0 * LENGTH})
    assert longer.elongation == pytest.approx(2.0 * found.elongation)


BEAM = {"composite.deflection_per_strain": LENGTH,
        "composite.stress_per_deflection_front": 1500.0 / SECTION}  # fmt: skip
STILL = WIRE.replace({"wire.thermal_expansion_factor": 0.0})  # the cold wire would pull as it warms
STIFFEST = BY_NAME["load.stiffness"].high
WEIGHT, SOFT = loaded("force", force=9.0), loaded("spring", stiffness=1e-4, preload=9.0)
ON_SPRING = loaded("spring", stiffness=1500.0)
SLIDER = loaded("antagonist", rig=STILL.replace(PAIR), stiffness=400.0, preload=6.0)
AGAINST_COLD = loaded("spring", rig=STILL, stiffness=400.0 + COLD, preload=6.0)
SAME = {  # equivalent loads: rigs, sign of the motion, accuracy
    ("spring", "beam"): (ON_SPRING, loaded("beam", rig=WIRE.replace(BEAM)), -1.0, 1e-6),
    ("force", "spring"): (WEIGHT, SOFT, 1.0, 1e-6),
    ("clamped", "displacement"): (WIRE, WIRE.replace({"load.kind": "displacement"}), None, 1e-12),
    ("clamped", "spring"): (WIRE, loaded("spring", stiffness=STIFFEST), None, 1e-3),
    ("antagonist", "spring"): (SLIDER, AGAINST_COLD, -1.0, 1e-6),
}


@pytest.mark.parametrize(
    ("loads", "effect"),
    [(k, e.name) for k in SAME for e in EFFECTS.values() if set(k) <= set(e.loads)],
    ids=str,
)
def test_an_effect_acts_alike_on_two_equivalent_loads(loads, effect):
    """Those of the beam are compared with their equations in test_effect_equations.py."""
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
def test_the_work_on_a_load_is_stored_in_it_and_a_live_bench_agrees(name):
    """A weight and springs store all of the integral of F dx over the wires."""
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


SLOW = {"effect.ambient_drift.rate": 1e-12}  # takes the longer path of a step
RISES = {"effect.phase_dependent_resistance.temperature_coefficient": 1e-3}
DUTY = {"bench.drive": "duty", "bench.supply_voltage": 12.0}
LEADS = {"bench.lead_resistance": 0.5}


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize(("drive", "held", "effects"), [
    (DUTY, 3.0, {}), (DUTY, 3.0, SLOW), (LEADS, 6.0, {}), (LEADS, 6.0, SLOW), ({}, 4.0, RISES),
    ({"bench.drive": "current"}, 4.0, RISES), ({"bench.drive": "power"}, 4.0, RISES),
])  # fmt: skip
def test_every_drive_heats_as_defined_and_its_record_has_that_heat(drive, held, effects, count):
    """A duty of 1/4 at 12 V heats as 6 V do, and its mean is 3 V."""
    rig = WIRE.replace({**drive, **effects, "wire.count": count})
    found = simulate(rig, TIME, np.full(TIME.size, held))
    rise, ohm = found.temperature[-1, 0] - 296.15, WIRE["wire.resistance"]
    hot = ohm * (1.0 + 1e-3 * rise * (effects is RISES))
    through = {"duty": 6.0 / ohm, "current": held / ohm, "power": held / np.sqrt(ohm * hot)}
    amperes = through.get(rig["bench.drive"], held / (hot + rig["bench.lead_resistance"] * count))
    loss = WIRE["wire.heat_transfer_coefficient"] * WIRE["wire.surface_area"]
    assert rise == pytest.approx(amperes**2 * hot / loss, rel=1e-4) and rise > 30.0
    share = 0.5 if drive is DUTY else 1.0  # mean current over the direct one of the same heat
    assert found.current[-1, 0] == pytest.approx(count * amperes * share, rel=1e-4)
    if rig["bench.drive"] != "current":  # whose record has the command instead
        volts, flowing = direct_reading(rig, found.voltage, found.current)
        given = volts[-1] * flowing[-1] - flowing[-1] ** 2 * rig["bench.lead_resistance"]
        assert given == pytest.approx(count * amperes**2 * hot, rel=1e-4)


# --- Imposed motion, nonlinear springs and friction.

MACHINE = WIRE.replace({"load.kind": "displacement"})


def test_an_imposed_motion_of_a_warming_wire_follows_the_closed_form():
    """While it warms faster than it is pulled, xi is f(T, sigma) whichever way the ends move."""
    moved = 2e-4 + 5e-5 * np.sin(0.4 * TIME)
    found = simulate(MACHINE, TIME, np.sqrt(0.4 * TIME), elongation=moved)
    assert found.elongation[:, 0] == pytest.approx(found.deflection, abs=1e-15)
    assert found.deflection == pytest.approx(moved, abs=1e-15)
    assert 0.02 < found.martensite_fraction[-1, 0] < 0.9
    start, finish = (WIRE[f"wire.austenite_{end}_temperature"] for end in ("start", "finish"))

    def pulls(kelvin, metres, sigma):
        below = kelvin - start - sigma / WIRE["wire.stress_influence_austenite"]
        xi = 0.5 * (1.0 + np.cos(np.pi * np.clip(below / (finish - start), 0.0, 1.0)))
        modulus = 55.4e9 + xi * (22.8e9 - 55.4e9)
        strain = metres / LENGTH + WIRE["wire.maximum_recoverable_strain"] * (1.0 - xi)
        return modulus * strain + WIRE["wire.thermal_expansion_factor"] * (kelvin - 296.15), xi

    for k in range(0, TIME.size, 100):
        kelvin = found.temperature[k, 0]
        sigma = brentq(lambda s: pulls(kelvin, moved[k], s)[0] - s, -1e9, 3e9)  # noqa: B023
        assert found.force[k, 0] == pytest.approx(SECTION * sigma, rel=1e-6, abs=1e-6)
        assert found.martensite_fraction[k, 0] == pytest.approx(pulls(kelvin, moved[k], sigma)[1])


def test_superelastic_loading_and_unloading_follow_the_two_branches():
    """Superelasticity: martensite by g(T, sigma) while it is pulled, austenite by f on the way
    back, where the temperature changes by rounding only."""
    moved = LENGTH * np.interp(TIME, [0.0, 10.0, 40.0, 70.0], [0.0, -0.045, 0.02, -0.045])
    found = simulate(MACHINE, TIME, 6.0 + 0.0 * TIME, elongation=moved)
    kelvin, (a_s, a_f, m_s, m_f) = found.temperature[-1, 0], (WIRE[n] for n in TRANSITIONS.values())
    influences = [WIRE[f"wire.stress_influence_{phase}"] for phase in ("martensite", "austenite")]
    offset = WIRE["wire.thermal_expansion_factor"] * (kelvin - 296.15)

    def branch(sigma, pulled):
        low, high, influence = (m_f, m_s, influences[0]) if pulled else (a_s, a_f, influences[1])
        part = np.clip((kelvin - sigma / influence - low) / (high - low), 0.0, 1.0)
        return 0.5 * (1.0 + np.cos(np.pi * part))

    def excess(sigma, metres, pulled):
        xi = branch(sigma, pulled)
        strain = metres / LENGTH + WIRE["wire.maximum_recoverable_strain"] * (1.0 - xi)
        return (55.4e9 + xi * (22.8e9 - 55.4e9)) * strain + offset - sigma

    for k in (*range(600, 2000, 100), *range(2001, 3500, 100)):
        sigma = brentq(excess, -1e9, 3e9, args=(moved[k], k < 2000))
        assert found.stress[k, 0] == pytest.approx(sigma, rel=1e-6, abs=1e3)
    assert found.martensite_fraction[[600, 2000], 0] == pytest.approx([0.0, 1.0], abs=1e-9)
    pull, release = (found.force[k, 0] for k in (1500, 2500))  # at one elongation
    assert moved[1500] == pytest.approx(moved[2500]) and pull > release + 1.5


def test_live_and_whole_runs_agree_under_imposed_motion_and_unmoved_ends_stay():
    moved, live = 3e-4 * np.sin(0.3 * TIME), Bench(MACHINE)
    found = simulate(MACHINE, TIME, HEATED, elongation=moved)
    live.follow(TIME[:2001], HEATED[:2001], moved[:2001])
    assert live.force == pytest.approx(found.force[2000], rel=1e-9)
    live.advance([0.0], 1.0)
    assert live.elongation == pytest.approx(moved[2000], abs=1e-15)
    first = simulate(MACHINE, TIME[:2001], HEATED[:2001], elongation=moved[:2001])
    rest = (TIME[2000:], HEATED[2000:])
    second = simulate(MACHINE, *rest, elongation=moved[2000:], initial=first.final)
    assert np.array_equal(second.force, found.force[2000:])


@pytest.mark.parametrize(
    ("rig", "moved", "words"),
    [(MACHINE, np.zeros(3), "elongation has shape (3,), expected (4001,)"),
     (MACHINE, np.where(TIME == 2.0, np.nan, 0.0), "elongation of sample 100 is nan"),
     (WEIGHT, 0.0 * TIME, "elongation with load.kind force, expected displacement")],
)  # fmt: skip
def test_a_motion_that_cannot_be_imposed_is_refused(rig, moved, words):
    with pytest.raises(InputError, match=re.escape(words)):
        simulate(rig, TIME, HEATED, elongation=moved)


@pytest.mark.parametrize("stiffening", [60.0, -60.0])
def test_a_spring_that_is_not_linear_follows_its_curve(stiffening):
    rig = RIGS["spring"].replace({"load.stiffening": stiffening})
    found, straight = run(rig), run(RIGS["spring"])
    x = -found.elongation[:, 0]
    pulled = rig["load.stiffness"] * np.expm1(stiffening * x) / stiffening
    held = rig["load.force"] + rig["load.preload"]
    assert found.force[:, 0] == pytest.approx(held + pulled, abs=1e-6)
    softer = x.max() + straight.elongation.min()
    assert np.sign(softer) == -np.sign(stiffening) and abs(softer) > 1e-4


@pytest.mark.parametrize("name", RIGS)
def test_friction_opposes_the_motion_and_holds_a_standing_load(name):
    rig, effects = RIGS[name].replace({"load.friction": 0.8}), {
        "effect.latent_heat.heat": 8e3, "effect.residual_strain.share": 0.1,
    }  # fmt: skip
    still = simulate(rig, TIME, np.zeros((TIME.size, len(rig["bench.channels"]))))
    assert not np.any(still.contraction)
    for changed in ({}, effects):
        found = run(rig, **changed)
        x = found.deflection if name == "antagonist" else -found.elongation[:, 0]
        pull = found.force[:, 0] - (found.force[:, 1] if name == "antagonist" else 0.0)
        held = rig["load.force"] + (rig["load.preload"] if name == "spring" else 0.0)
        rubs, step = pull - held - (name != "force") * rig["load.stiffness"] * x, np.diff(x)
        assert np.all(np.abs(rubs) < 0.8 + 1e-6)
        assert rubs[1:][step > 1e-12] == pytest.approx(0.8, abs=1e-6)
        assert rubs[1:][step < -1e-12] == pytest.approx(-0.8, abs=1e-6)
        assert np.ptp(x) > 1e-3 and np.mean(step == 0.0) > 0.01
        # Without friction the loop is wider.
        assert np.ptp(run(RIGS[name], **changed).deflection) > np.ptp(found.deflection)
