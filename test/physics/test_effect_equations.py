"""Every effect's equation, against references written by plain means (effect_references.py)."""

import numpy as np
import pytest
from effect_references import (
    Heat,
    creep,
    done,
    forces_of_passive_wires,
    lagged_heating,
    pulses,
    refined,
)
from scipy.linalg import expm

from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, initial_state, material, simulate
from sma_bench.physics import columns as at
from sma_bench.physics.effects.matrix_thermal_mass import warm_together
from sma_bench.physics.effects.opposing_wires import HARDENING
from sma_bench.physics.effects.partial_transformation import ROUNDED
from sma_bench.physics.effects.side_heat_coupling import look_across
from sma_bench.physics.kernel import Kernel

pytest.importorskip("numba", reason="many simulations: slow without numba")

AMBIENT = 296.15
E_A, E_M, EPS_L = 55.4e9, 22.8e9, 0.044


def effect(parameters: Parameters, **numbers: float) -> Parameters:
    """`residual_strain__share=0.1` is effect.residual_strain.share."""
    return parameters.replace(
        {f"effect.{name.replace('__', '.')}": value for name, value in numbers.items()}
    )


def warm(step, duration=12.0):
    """Pulses that stay below the transformation."""
    time, voltage = pulses(step, duration)
    return time, 0.5 * voltage


# --- electrical


def test_supply_drop_divides_the_voltage(composite_rig):
    time, voltage = pulses(0.05)
    run = simulate(effect(composite_rig, supply_drop__resistance=0.3), time, voltage)
    divided = simulate(composite_rig, time, voltage * 2.6987 / 2.9987)
    assert run.temperature == pytest.approx(divided.temperature, rel=1e-12)
    assert run.current == pytest.approx(voltage / 2.9987, rel=1e-13)


def test_current_and_heat_follow_the_resistance_of_phase_and_temperature(composite_rig):
    rig = effect(composite_rig, phase_dependent_resistance__austenite_change=0.2,
                 phase_dependent_resistance__temperature_coefficient=3e-4)
    time, voltage = refined(*pulses(0.02, 8.0), 40)
    run = simulate(rig, time, voltage)
    ohm = 2.6987 * (1 + 0.2 * (1 - run.martensite_fraction)) * (
        1 + 3e-4 * (run.temperature - AMBIENT)
    )
    assert np.ptp(run.martensite_fraction) > 0.9
    assert run.current == pytest.approx(voltage / ohm, rel=1e-13)
    heat = Heat(rig)
    taken = np.diff(run.temperature, axis=0) * heat.capacity
    power = voltage**2 / ohm - heat.loss * (run.temperature - AMBIENT)
    given = 0.5 * np.diff(time)[:, np.newaxis] * (
        power[:-1] + power[1:] + (voltage[:-1]**2 - voltage[1:]**2) / ohm[1:]
    )
    assert np.abs(np.cumsum(given - taken, axis=0)).max() < 1e-3 * np.abs(np.cumsum(taken)).max()


# --- thermal


@pytest.mark.parametrize("numbers", [
    {"matrix_thermal_mass__heat_capacity": 0.3, "matrix_thermal_mass__inner_share": 0.35},
    {"matrix_thermal_mass__heat_capacity": 0.01, "supply_drop__resistance": 0.2},
])
def test_wire_and_silicone_are_exact_at_any_step(composite_rig, numbers):
    rig = effect(composite_rig, **numbers)
    time, voltage = warm(0.5)
    run = simulate(rig, time, voltage)
    assert np.all(run.martensite_fraction == 1.0)
    assert run.temperature == pytest.approx(Heat(rig).solve(time, voltage), abs=2e-6)


@pytest.mark.parametrize("sides", [
    ("front", "front", "back", "back"), ("front", "front", "front", "back"),
])
@pytest.mark.parametrize("matrix", [0.0, 0.2])
def test_all_that_changes_the_heat_at_once_converges_to_the_equations(
    composite_rig, sides, matrix
):
    rig = effect(
        composite_rig.replace({"bench.channel_sides": sides}),
        matrix_thermal_mass__heat_capacity=matrix, matrix_thermal_mass__inner_share=0.4,
        side_heat_coupling__conductance=0.05, ambient_drift__rate=0.02, ambient_drift__bend=1e-3,
        temperature_dependent_convection__rise=4e-3, supply_drop__resistance=0.2,
        phase_dependent_resistance__temperature_coefficient=2e-3,
    )
    time, voltage = warm(0.25)
    reference = Heat(rig).solve(time, voltage)
    errors = []
    for parts in (50, 100):
        run = simulate(rig, *refined(time, voltage, parts))
        assert np.all(run.martensite_fraction == 1.0)
        errors.append(np.abs(run.temperature[::parts] - reference).max())
    assert errors[1] < 0.05
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.3)


def test_latent_heat_with_silicone_is_spread_as_the_matrix_exponential_says(composite_rig):
    rig = effect(composite_rig, latent_heat__heat=9e3, matrix_thermal_mass__heat_capacity=0.08,
                 matrix_thermal_mass__inner_share=0.3, side_heat_coupling__conductance=0.02)
    wires, _ = Kernel(rig, None).memory(None)
    look_across(wires)
    heat, step = Heat(rig), 0.13
    loss, across = heat.loss, 0.02
    warm_together(wires, 0, 0.0, loss, AMBIENT, step)
    inner, outer = loss / 0.3, loss / 0.7
    rates = np.zeros((3, 3))  # wire, silicone, and a heating of the wire that stays
    rates[0] = np.array([-inner, inner, heat.capacity]) / heat.capacity
    rates[1, :2] = np.array([inner, -(inner + outer + across)]) / 0.08
    response = expm(rates * step)[:2, 2] * 9e3 / 343.2 / step  # of 1 K/s; xi + 1 within the step
    assert [wires[0, at.LAG], wires[0, at.MATRIX_LAG]] == pytest.approx(response, rel=1e-9)


# --- transformation


def wave(*peaks, step=0.005):
    """Slow voltage (n, 1) through these values, 4 s from one to the next."""
    time = np.arange(0.0, 4.0 * (len(peaks) - 1), step)
    return time, np.interp(time, 4.0 * np.arange(len(peaks)), peaks)[:, np.newaxis]


def held(rig, time, voltage, sigma=0.0):
    return simulate(rig, time, voltage, boundary=Boundary.held_stress(sigma))


def turns(run):
    """Samples at which the temperature turns."""
    rising = np.diff(run.temperature[:, 0]) >= 0
    return [0, *(np.flatnonzero(rising[1:] != rising[:-1]) + 1), len(run.time) - 1]


def ordered_together(u, v, memory):
    """Plackett's distribution: the root of (q - 1) C^2 - [1 + (q - 1)(u + v)] C + q u v = 0."""
    rest = max(1.0 - memory, ROUNDED)
    ratio = (2.0 - rest) / rest
    return np.array([min(np.roots([ratio - 1.0, -1.0 - (ratio - 1.0) * (u + x), ratio * u * x]))
                     for x in v]) if memory else u * v  # fmt: skip


@pytest.mark.parametrize("memory", [0.0, 0.4, 0.9, 1.0])
def test_incomplete_loops_lie_between_the_contracts_rule_and_the_full_loop(wire_rig, memory):
    rig = effect(wire_rig, partial_transformation__memory=memory)
    run = held(rig, *wave(0, 4.6, 3.4, 4.7, 4.3, 4.65, 4.0, 6.5, 0))
    kelvin, xi = run.temperature[:, 0], run.martensite_fraction[:, 0]
    f, g = material.austenite_ramp(kelvin, 0.0, rig), material.martensite_ramp(kelvin, 0.0, rig)
    ends = turns(run)
    for first, last in zip(ends[:-1], ends[1:], strict=True):
        part = slice(first, last + 1)
        rising = kelvin[last] > kelvin[first]
        share, left = (f[part], xi[part]) if rising else (g[part], 1.0 - xi[part])
        if left[0] == 0.0:
            continue
        contract = left[0] * share / share[0]
        flat = left[0] * np.minimum(1.0, share / min(share[0], left[0]))
        between = (left >= contract - 1e-9) & (left <= flat + 1e-9)
        assert between.all()
        u, v = min(left[0] / share[0], 1.0), share / share[0]
        expected = contract if u == 1.0 else share[0] * ordered_together(u, v, memory)
        assert left == pytest.approx(expected, abs=1e-9)
        assert memory < 1.0 or left == pytest.approx(flat, abs=0.02)
    assert len(ends) == 9
    assert 0.1 < xi[ends[1]] < 0.9


def nested(rig, kelvin, memory):
    """xi along temperatures at no stress: straight lines over the ramp to where loops opened."""
    f, g = material.austenite_ramp(kelvin, 0.0, rig), material.martensite_ramp(kelvin, 0.0, rig)
    xi, rising, opened = [1.0], True, [(1.0, f[0], g[0])]
    start = (1.0, f[0])
    for k in range(1, len(kelvin)):
        turned = (kelvin[k] >= kelvin[k - 1]) != rising
        if turned:
            rising = not rising
            opened.append((xi[-1], f[k - 1], g[k - 1]))
            start = (xi[-1], f[k - 1]) if rising else (1.0 - xi[-1], g[k - 1])
        own = f[k] if rising else g[k]
        while True:
            at_xi, at_f, at_g = opened[-2] if len(opened) > 1 else (1.0 - rising, 0.0, 0.0)
            phase_there, end = (at_xi, at_f) if rising else (1.0 - at_xi, at_g)
            if len(opened) < 2:
                phase_there = end = 0.0
            aim, aim_own = memory * phase_there, memory * end
            steep = (start[0] - aim) / (start[1] - aim_own) if start[1] > aim_own else 0.0
            if own >= end or len(opened) < 2:
                break
            start = (aim + steep * (end - aim_own), end)
            del opened[-2:]
        left = aim + steep * (own - aim_own)
        xi.append(left if rising else 1.0 - left)
    return np.array(xi)


@pytest.mark.parametrize("memory", [0.3, 1.0])
def test_return_points_follow_nested_loops(wire_rig, memory):
    rig = effect(wire_rig, partial_transformation__return_point=memory)
    run = held(rig, *wave(0, 4.6, 3.9, 4.5, 4.0, 4.4, 4.0, 4.65, 3.5, 4.3, 0))
    xi = run.martensite_fraction[:, 0]
    assert xi == pytest.approx(nested(rig, run.temperature[:, 0], memory), abs=1e-9)
    assert len(turns(run)) == 11
    plain = held(wire_rig, run.time, run.voltage)
    assert np.max(np.abs(plain.martensite_fraction[:, 0] - xi)) > 0.02 * memory


@pytest.mark.parametrize("memory", [-0.5, -0.2, 0.5, 1.0])
def test_the_fraction_goes_one_way_and_without_jumps_whatever_the_memory(wire_rig, memory):
    rig = effect(wire_rig, partial_transformation__memory=memory)
    run = held(rig, *wave(0, 4.6, 3.4, 4.8, 4.3, 5, 4, 6.5, 0, 5, 3, 5.4), 80e6)
    change = np.diff(run.martensite_fraction[:, 0])
    rise = np.diff(run.temperature[:, 0])
    assert np.max(change * np.sign(rise)) < 1e-12
    assert np.max(np.abs(change) - 0.5 * np.abs(rise)) < 1e-12


def test_transitions_shift_by_the_cycles_done(wire_rig):
    rig = effect(wire_rig, transition_drift__shift=8.0, transition_drift__cycles=2.0,
                 transition_drift__plastic_strain=2e-3)
    run = held(rig, *wave(0, 7, 0, 7, 0, 7, 0))
    ends = turns(run)
    assert len(ends) == 7
    for n, (first, last) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        part = slice(first, last + 1)
        unshifted = run.temperature[part, 0] - 8.0 * done(n / 2, 2.0)
        curve = material.cooled_fraction if n % 2 else material.heated_fraction
        assert run.martensite_fraction[part, 0] == pytest.approx(
            curve(unshifted, 0.0, rig), abs=1e-9
        )
    at_rest = run.contraction[ends[::2], 0]
    assert at_rest == pytest.approx([-2e-3 * done(n, 2.0) for n in range(4)], abs=1e-5)


def test_stress_dependence_adds_to_that_of_the_parameters(composite_rig):
    time, voltage = pulses(0.05)
    run = simulate(effect(composite_rig, stress_dependent_transition__austenite=5e-8,
                          stress_dependent_transition__martensite=-3e-8), time, voltage)
    same = simulate(composite_rig.replace({
        "wire.stress_influence_austenite": 1 / (1 / 7.3e6 + 5e-8),
        "wire.stress_influence_martensite": 1 / (1 / 8.0e6 - 3e-8),
    }), time, voltage)
    assert run.deflection == pytest.approx(same.deflection, abs=1e-12)


# --- mechanical


def sides(run):
    """Sum of stresses of each side (n, 2), and the stiffness that it bends (2,)."""
    pulled = run.stress.reshape(-1, 2, 2).sum(axis=2)
    return pulled, np.array(Boundary.bending(run.parameters).stiffness)


def stretched(run, strain):
    """Stress of eq. (6) where the strain of eq. (9) is `strain` (n, w)."""
    p, xi = run.parameters, run.martensite_fraction
    modulus = E_A + xi * (E_M - E_A)
    expansion = p["wire.thermal_expansion_factor"] * (run.temperature - AMBIENT)
    return modulus * (strain - run.contraction[:, [0, 0, 1, 1]]) + expansion


@pytest.mark.parametrize("share", [0.15, -0.1])
def test_residual_strain_is_exact_in_every_sample(composite_rig, share):
    run = simulate(effect(composite_rig, residual_strain__share=share), *pulses(0.05))
    austenite = 1.0 - run.martensite_fraction
    most = np.maximum.accumulate(austenite, axis=0)
    strain = EPS_L * ((1 - share) * austenite + share * most)
    assert np.any((most < 0.9) & (most > 0.1))
    assert np.abs(run.stress - stretched(run, strain)).max() < 1.0
    pulled, stiffness = sides(run)
    assert np.abs(pulled - stiffness * run.contraction).max() < 10.0


def test_the_first_heating_is_the_papers_and_the_residue_stays_at_rest(composite_rig):
    rig = effect(composite_rig, residual_strain__share=0.1)
    time = np.arange(0.0, 20.0, 0.02)
    voltage = 6.3 * (time < 2.0)[:, np.newaxis] * np.array([1.0, 1.0, 0.0, 0.0])
    run, paper = simulate(rig, time, voltage), simulate(composite_rig, time, voltage)
    top = int(np.argmax(run.temperature[:, 0]))
    assert np.array_equal(run.deflection[: top + 1], paper.deflection[: top + 1])
    assert paper.deflection[-1] == pytest.approx(0.0, abs=1e-9)
    free = 0.1 * (1.0 - run.martensite_fraction[:, 0].min()) * EPS_L
    assert run.contraction[-1, 0] == pytest.approx(2 * E_M * free / (2 * E_M + 5.0e9), rel=1e-6)
    assert run.contraction[-1, 1] == 0.0


def test_a_step_of_load_creeps_as_a_standard_linear_solid(composite_rig):
    rig = effect(composite_rig, viscoelastic_matrix__relaxation=0.5,
                 viscoelastic_matrix__time_constant=5.0)
    time = np.arange(0.0, 40.0, 0.01)
    at_rest = np.zeros((time.size, 4))
    before = simulate(rig, time[:10], at_rest[:10], boundary=Boundary(stiffness=60e9)).final
    loaded = Boundary(stiffness=60e9, load=-30e6)
    run = simulate(rig, time, at_rest, initial=before, boundary=loaded)
    expected = creep(time, 30e6, 2 * E_M + 60e9, 0.5 * 60e9, 5.0)
    assert run.contraction[1:, 0] == pytest.approx(expected[1:], rel=1e-3)
    assert run.contraction[-1, 0] / run.contraction[1, 0] > 1.2


def test_the_matrix_of_a_driven_side_follows_the_standard_linear_solid(composite_rig):
    rig = effect(composite_rig, viscoelastic_matrix__relaxation=0.3,
                 viscoelastic_matrix__time_constant=2.0)
    run = simulate(rig, *refined(*pulses(0.02), 5))
    pulled, stiffness = sides(run)
    lagging = np.zeros_like(run.bending)
    for k, step in enumerate(np.diff(run.time)):  # trapezoids: dq/dt = (e - q)/tau
        towards = run.bending[k] + run.bending[k + 1]
        lagging[k + 1] = (lagging[k] * (4.0 - step) + step * towards) / (4.0 + step)
    expected = stiffness * (run.bending + 0.3 * (run.bending - lagging))
    assert pulled == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())


def passive_modulus(engagement):
    """S' of two martensitic wires on the back's silicone."""
    return 4.0e9 * 2 * E_M / (4.0e9 + (1.0 - engagement**2) * 2 * E_M)


def test_passive_wires_resist_elastically_up_to_the_detwinning_stress(composite_rig):
    time, voltage = pulses(0.05)
    front_only = voltage * np.array([1.0, 1.0, 0.0, 0.0])
    rig = effect(composite_rig, opposing_wires__engagement=1.0,
                 opposing_wires__detwinning_stress=1e9)
    run = simulate(rig, time, front_only)
    # K_f/K_b of what acts on the back's silicone acts on the front's.
    stiffer = Boundary(stiffness=(5.0e9 + 5.0 / 4.0 * 2 * E_M, 4.0e9), lever=(1.0, -1.0))
    assert run.deflection == pytest.approx(
        simulate(composite_rig, time, front_only, boundary=stiffer).deflection, abs=1e-12
    )


@pytest.mark.parametrize("engagement", [0.3, 1.0])
def test_both_sides_balance_with_what_reaches_the_other(composite_rig, engagement):
    rig = effect(composite_rig, opposing_wires__engagement=engagement,
                 opposing_wires__detwinning_stress=1e9)
    time, voltage = pulses(0.05)
    run = simulate(rig, time, voltage * np.array([1.0, 1.0, 0.0, 0.0]))
    pulled, stiffness = sides(run)
    front = pulled[:, 0] / stiffness[0]
    back = front - run.bending[:, 0]
    assert np.abs(back).max() > 1e-3
    # The front's wires feel the share of the back's bending, the back's wires that of the front's.
    assert run.contraction[:, 0] == pytest.approx(front - engagement * back, abs=1e-9)
    assert stiffness[1] * back == pytest.approx(2 * E_M * (engagement * front - back), abs=100.0)


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_beyond_the_detwinning_stress_passive_wires_yield_and_stay_stretched(composite_rig, step):
    rig = effect(composite_rig, opposing_wires__engagement=0.5,
                 opposing_wires__detwinning_stress=20e6)
    time, voltage = pulses(step)
    run = simulate(rig, time, voltage * np.array([1.0, 1.0, 0.0, 0.0]))
    force, stretch = forces_of_passive_wires(
        0.5 * run.contraction[:, 0], passive_modulus(0.5), 2 * 20e6, 2 * HARDENING
    )
    pulled, stiffness = sides(run)
    reaction = 0.5 * stiffness[0] / stiffness[1] * force
    expected = stiffness[0] * run.contraction[:, 0] + reaction
    assert pulled[:, 0] == pytest.approx(expected, abs=20.0)
    assert run.bending[:, 0] == pytest.approx(
        run.contraction[:, 0] - 0.5 * force / stiffness[1], abs=1e-9
    )
    assert np.sum(np.diff(stretch) > 0.0) > 5 and np.sum(np.diff(stretch) < 0.0) > 5
    assert stretch.max() > 1e-3


def test_the_stretch_bends_at_rest_and_is_recovered_by_heating_the_passive_side(composite_rig):
    rig = effect(composite_rig, opposing_wires__engagement=1.0,
                 opposing_wires__detwinning_stress=60e6)
    time = np.arange(0.0, 24.0, 0.02)
    voltage = np.zeros((time.size, 4))
    voltage[time < 2.0, :2] = 6.3
    voltage[(time >= 12.0) & (time < 16.0), 2:] = 7.0
    run = simulate(rig, time, voltage)
    before, after = np.searchsorted(time, 11.9), np.searchsorted(time, 15.9)
    _, stretch = forces_of_passive_wires(
        run.contraction[:before, 0], 2 * E_M, 2 * 60e6, 2 * HARDENING
    )
    elastic = 5.0 / 4.0 * 2 * E_M
    expected = elastic * stretch[-1] / (5.0e9 + elastic + 2 * E_M)
    assert run.bending[before, 0] == pytest.approx(expected, rel=1e-6)
    assert run.deflection[before] > 1e-3
    assert run.martensite_fraction[after, 2] == 0.0
    assert run.bending[after, 0] == pytest.approx(0.0, abs=1e-12)


def test_asymmetry_is_in_the_stiffness_of_the_sides(composite_rig):
    time, voltage = pulses(0.05)
    run = simulate(effect(composite_rig, side_asymmetry__ratio=0.25), time, voltage)
    same = simulate(composite_rig.replace({
        "composite.stress_per_deflection_front": 1.25 * 5.0e9,
        "composite.stress_per_deflection_back": 0.75 * 4.0e9,
    }), time, voltage)
    assert np.array_equal(run.deflection, same.deflection)


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_slack_is_a_dead_zone_of_exactly_its_strain(composite_rig, step):
    slack = 4e-3
    run = simulate(effect(composite_rig, slack__strain=slack), *pulses(step))
    free = EPS_L * (1.0 - run.martensite_fraction)
    pulled, stiffness = sides(run)
    e, b = run.contraction, run.bending
    assert run.stress == pytest.approx(stretched(run, free), abs=1.0)
    assert pulled == pytest.approx(stiffness * b, abs=10.0)
    taut, pushing = b > 0.0, b < 0.0
    hanging = ~taut & ~pushing
    assert min(np.sum(taut[1:]), np.sum(pushing), np.sum(hanging[1:])) > 5
    assert (e - b)[taut] == pytest.approx(slack, abs=1e-12)
    assert (e - b)[pushing] == pytest.approx(0.0, abs=1e-12)
    assert np.all((e >= -1e-12) & (e <= slack + 1e-12) | ~hanging)
    assert np.abs(pulled[hanging]).max() < 10.0


# --- sensors


def test_a_spot_beyond_the_wire_mixes_radiances(composite_rig):
    rig = effect(composite_rig, temperature_underfill__missing=0.3, ambient_drift__rate=0.02)
    time, voltage = pulses(0.05)
    run = simulate(rig, time, voltage)
    air = AMBIENT + 0.02 * time[:, np.newaxis]
    radiance = 0.7 * run.temperature**4.5 + 0.3 * air**4.5
    assert run.temperature_reading == pytest.approx(radiance ** (1 / 4.5), rel=1e-12)
    plain = simulate(effect(composite_rig, ambient_drift__rate=0.02), time, voltage)
    assert np.array_equal(run.deflection, plain.deflection)


def test_a_lagging_sensor_follows_the_exact_response(composite_rig):
    rig = effect(composite_rig, temperature_lag__time_constant=0.5)
    tau = 0.091e-3 * 343.2 / (403.26 * 395.84e-6)
    rise = 16.0 / (2.6987 * 403.26 * 395.84e-6)
    errors = []
    for step in (0.04, 0.02):
        time = np.arange(0.0, 4.0, step)
        run = simulate(rig, time, np.full((time.size, 4), 4.0))
        expected = AMBIENT + lagged_heating(time, rise, tau, 0.5)
        errors.append(np.abs(run.temperature_reading[:, 0] - expected).max())
    assert errors[1] < 0.03
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)


def test_the_zero_of_the_deflection_drifts_by_itself(composite_rig):
    rig = effect(composite_rig, deflection_drift__rate=1e-5, deflection_drift__bend=-2e-7)
    time, voltage = pulses(0.05)
    run, paper = simulate(rig, time, voltage), simulate(composite_rig, time, voltage)
    assert np.array_equal(run.deflection, paper.deflection)
    drift = run.deflection_reading - run.deflection
    assert drift == pytest.approx(1e-5 * time - 2e-7 * time**2, abs=1e-15)
    assert np.array_equal(run.temperature_reading, paper.temperature)


def test_a_bench_that_starts_warm_is_read_so_from_the_first_sample(composite_rig):
    rig = effect(composite_rig, temperature_underfill__missing=0.3,
                 temperature_lag__time_constant=0.2, viscoelastic_matrix__relaxation=0.4)
    start = initial_state(rig, temperature=325.0)
    run = simulate(rig, [0.0, 1e-6], np.zeros((2, 4)), initial=start)
    seen = (0.7 * 325.0**4.5 + 0.3 * AMBIENT**4.5) ** (1 / 4.5)
    assert run.temperature_reading == pytest.approx(np.full((2, 4), seen), abs=1e-3)
    # Its matrix has had the time to relax.
    assert run.deflection[1] == pytest.approx(run.deflection[0], abs=1e-7)
