"""The compiled simulation: equations satisfied at every sample, boundaries, chaining, input."""

import numpy as np
import pytest
from effect_references import COMPOSITE, alloy, on_sides
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.physics import (
    Bench,
    Boundary,
    bending_coefficients,
    heat,
    initial_state,
    material,
    simulate,
)

# Every order of the ranges, differing influences, stiff and soft composites.
RANGES = (st.floats(320, 345), st.floats(3, 40), st.floats(305, 335), st.floats(3, 40))
rigs = st.builds(
    lambda ranges, influences, beta, theta: {
        **alloy(ranges, influences),
        "composite.stress_per_deflection_front": beta,
        "composite.stress_per_deflection_back": 0.6 * beta,
        "wire.thermal_expansion_factor": theta,
    },
    st.tuples(*RANGES),
    st.tuples(st.floats(4e6, 15e6), st.floats(4e6, 15e6)),
    st.floats(5e8, 2e11),
    st.floats(-0.5e6, 0.3e6),
)
SECOND_CYCLE = {"wire.stress_influence_austenite": 13.8e6, "wire.stress_influence_martensite": 8e6}


def random_voltage(seed, samples, wires, period):
    rng = np.random.default_rng(seed)
    time = np.arange(samples) * period
    held = np.repeat(rng.uniform(0.0, 6.8, (samples // 5 + 1, wires)), 5, axis=0)[:samples]
    held[rng.random(samples) < 0.1] = 0.0
    return time, held


def rule_errors(run):
    """Distance of every sample from the rule of material.py, reversals followed from outside."""
    p = run.parameters
    f = material.austenite_ramp(run.temperature, run.stress, p)
    g = material.martensite_ramp(run.temperature, run.stress, p)
    trend = np.sign(heat.steady_temperature(run.voltage, p) - run.temperature)
    errors = np.zeros_like(run.temperature)
    for i in range(run.temperature.shape[1]):
        rising, xi_r, ramps_r = True, 1.0, (f[0, i], g[0, i])
        for k in range(1, len(run.time)):
            if trend[k - 1, i] and (trend[k - 1, i] > 0) != rising:
                rising = not rising
                xi_r, ramps_r = run.martensite_fraction[k - 1, i], (f[k - 1, i], g[k - 1, i])
            there = material.fraction_since_reversal(rising, xi_r, ramps_r, (f[k, i], g[k, i]))
            errors[k, i] = abs(run.martensite_fraction[k, i] - there)
    return errors


@settings(deadline=None, max_examples=60)
@given(
    st.one_of(rigs, st.just(SECOND_CYCLE)),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.005, 0.05, 0.5]),
)
def test_phase_stress_and_bending_hold_together_at_every_sample(numbers, seed, period):
    rig = COMPOSITE.replace(numbers)
    time, voltage = random_voltage(seed, 120, 4, period)
    run = simulate(rig, time, voltage)
    per_wire = run.contraction[:, [0, 0, 1, 1]]
    sigma = material.stress(run.temperature, run.martensite_fraction, per_wire, rig)
    assert np.abs(run.stress - sigma).max() < 1.0
    alpha, front, back = bending_coefficients(rig)
    pulled = run.stress.reshape(-1, 2, 2).sum(axis=2)
    assert np.abs(pulled - run.contraction * alpha * np.array([front, back])).max() < 10.0
    assert run.deflection == pytest.approx(alpha * (run.contraction[:, 0] - run.contraction[:, 1]))
    assert rule_errors(run).max() < 1e-9


def printed(kelvin, low, high, shift):
    """Eqs. (10) and (11)."""
    return 0.5 + 0.5 * np.cos(np.pi / (high - low) * (np.clip(kelvin - shift, low, high) - low))


@pytest.mark.parametrize("sigma", [0.0, 150e6])
def test_full_loop_at_held_stress_is_equations_10_and_11(wire_rig, sigma):
    rig = wire_rig.replace(SECOND_CYCLE)
    time = np.arange(0.0, 60.0, 0.01)
    voltage = 7.5 * np.sin(np.pi * time / 60.0)
    run = simulate(rig, time, voltage, boundary=Boundary.held_stress(sigma))
    assert run.stress == pytest.approx(np.full_like(run.stress, sigma), abs=1.0)
    kelvin, xi = run.temperature[:, 0], run.martensite_fraction[:, 0]
    top = int(np.argmax(kelvin))
    heated = printed(kelvin, 331.81, 353.61, sigma / 13.8e6)
    cooled = printed(kelvin, 325.09, 353.39, sigma / 8e6)
    assert (xi[top], xi[-1]) == (0.0, 1.0)
    assert xi[: top + 1] == pytest.approx(heated[: top + 1], abs=1e-10)
    assert xi[top:] == pytest.approx(cooled[top:], abs=1e-10)
    assert material.heated_fraction(kelvin, sigma, rig) == pytest.approx(heated, abs=1e-12)
    assert material.cooled_fraction(kelvin, sigma, rig) == pytest.approx(cooled, abs=1e-12)


@pytest.mark.parametrize(
    "sides", [("back",), ("back", "front", "back"), ("front", "back") * 6], ids=len
)
def test_any_number_of_wires_in_any_order_of_sides(sides):
    rig = on_sides(COMPOSITE, sides)
    time, voltage = random_voltage(3, 300, len(sides), 0.05)
    run = simulate(rig, time, voltage, boundary=Boundary.bending(rig))
    assert run.temperature.shape == (300, len(sides))
    # Each side is on its own, so it moves as a rig that has that side only.
    expected = np.zeros(300)
    for side in set(sides):
        members = [i for i, name in enumerate(sides) if name == side]
        alone = on_sides(COMPOSITE, (side,) * len(members))
        part = simulate(alone, time, voltage[:, members], boundary=Boundary.bending(alone))
        assert np.array_equal(part.stress, run.stress[:, members])
        expected += part.deflection
    assert run.deflection == pytest.approx(expected, abs=1e-15)


NONE = np.zeros((3, 1))


def line_of(work, *arguments, **options):
    with pytest.raises(InputError) as error:
        work(*arguments, **options)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("time", "voltage", "said"),
    [
        ([0.0, 2.0, 1.0], NONE, "time goes from 2.0 to 1.0 s at sample 2"),
        ([0.0, np.nan, 1.0], NONE, "time of sample 1 is nan"),
        ([0.0, 1.0, 2.0], [[0.0], [np.inf], [0.0]], "voltage of sample 1"),
        ([0.0, 1.0], NONE, "voltage has shape (3, 1), expected (2, 1)"),
        ([], np.zeros((0, 1)), "time has shape (0,)"),
    ],
)
def test_bad_samples_are_refused_in_one_line(wire_rig, time, voltage, said):
    assert said in line_of(simulate, wire_rig, time, voltage)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ({"temperature": 450.0, "martensite_fraction": 0.5}, "expected 0 above A_f"),
        ({"temperature": 290.0, "martensite_fraction": 0.5}, "expected 1 below M_f"),
        ({"temperature": [300.0, 310.0]}, "temperature has shape (2,)"),
        ({"martensite_fraction": 1.2}, "expected 0 to 1"),
        ({"temperature": float("nan")}, "expected finite"),
        ({"boundary": Boundary(stiffness=(1.0, 2.0, 3.0))}, "stiffness has shape"),
        ({"boundary": Boundary.held_stress(float("nan"))}, "load is nan"),
    ],
)
def test_impossible_initial_states_and_boundaries_are_refused(wire_rig, state, said):
    given = {"boundary": Boundary.held_stress(0.0), **state}
    assert said in line_of(initial_state, wire_rig, **given)


def test_live_steps_states_of_another_rig_and_hot_air_are_refused(wire_rig):
    bench = Bench(wire_rig)
    bench.advance([3.0], 0.1)
    before = bench.temperature.copy()
    assert "voltage has shape (2,), expected (1,)" in line_of(bench.advance, [1.0, 2.0], 0.1)
    assert "voltage is [nan]" in line_of(bench.advance, [np.nan], 0.1)
    assert "dt is nan s" in line_of(bench.advance, [1.0], np.nan)
    assert np.array_equal(bench.temperature, before)
    text = line_of(Bench, wire_rig, initial=initial_state(COMPOSITE))
    assert "4 wires on 2 sides, expected 1 on 1" in text
    hot = wire_rig.replace({"environment.ambient_temperature": 372.0})
    assert "expected 0 above A_f" in line_of(simulate, hot, [0.0, 1.0], NONE[:2])
