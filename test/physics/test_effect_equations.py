"""Every effect's equation, against independent references (effect_references.py)."""

import effect_references as by_hand
import numpy as np
import pytest
from effect_references import COMPOSITE, WIRE, pulses, refined
from scipy.integrate import trapezoid

from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, initial_state, simulate
from sma_bench.physics.effects.opposing_wires import HARDENING
from sma_bench.physics.effects.partial_transformation import ROUNDED

pytest.importorskip("numba", reason="many simulations: slow without numba")

AMBIENT = 296.15
E_A, E_M, EPS_L = 55.4e9, 22.8e9, 0.044
FRONT_ONLY = np.array([1.0, 1.0, 0.0, 0.0])


def effect(parameters: Parameters, numbers: str) -> Parameters:
    """Parameters with effects as in `slack: strain=4e-3, ambient_drift: rate=0.02 bend=1e-3`."""
    stated = {}
    for one in numbers.split(","):
        name, own = one.split(":")
        for number in own.split():
            key, value = number.split("=")
            stated[f"effect.{name.strip()}.{key}"] = float(value)
    return parameters.replace(stated)


BETA = "composite.stress_per_deflection_"
STEEPER = 1 / (1 / 7.3e6 + 5e-8), 1 / (1 / 8.0e6 - 3e-8)


@pytest.mark.parametrize(("numbers", "names", "values", "share"), [
    ("supply_drop: resistance=0.3", (), (), 2.6987 / 2.9987),
    ("stress_dependent_transition: austenite=5e-8 martensite=-3e-8", by_hand.INFLUENCES, STEEPER,
     1),
    ("side_asymmetry: ratio=0.25", (f"{BETA}front", f"{BETA}back"), (6.25e9, 3.0e9), 1),
])  # fmt: skip
def test_an_effect_equals_a_change_of_parameters_or_voltage(numbers, names, values, share):
    time, voltage = pulses(0.05)
    run = simulate(effect(COMPOSITE, numbers), time, voltage)
    others = COMPOSITE.replace(dict(zip(names, values, strict=True)))
    other = simulate(others, time, share * voltage)
    assert run.temperature == pytest.approx(other.temperature, rel=1e-12)
    assert run.deflection == pytest.approx(other.deflection, abs=1e-12)
    assert run.current == pytest.approx(share * voltage / 2.6987, rel=1e-13)


@pytest.mark.parametrize("law", ["cosine", "logistic", "normal"])
@pytest.mark.parametrize("bend", [0.8, -0.5])
def test_a_bent_shift_equals_another_stress_influence_at_constant_stress(law, bend):
    sigma, knee = 90e6, 50e6
    influences = dict(zip(by_hand.INFLUENCES, (7.3e6, 8e6), strict=True))
    rig = WIRE.replace({"wire.law": law, **influences})
    shifts = sigma + bend * (np.hypot(sigma, knee) - knee)
    steeper = {name: rig[name] * sigma / shifts for name in by_hand.INFLUENCES}
    time = np.arange(0.0, 12.0, 0.02)
    voltage, held = by_hand.triangle(time, 6.5, 5.0)[:, np.newaxis], Boundary.held_stress(sigma)
    bent = effect(rig, f"stress_dependent_transition: bend={bend} bend_stress={knee}")
    run = simulate(bent, time, voltage, boundary=held)
    other = simulate(rig.replace(steeper), time, voltage, boundary=held)
    plain = simulate(rig, time, voltage, boundary=held)
    assert run.martensite_fraction == pytest.approx(other.martensite_fraction, abs=1e-9)
    assert np.abs(run.martensite_fraction - plain.martensite_fraction).max() > 0.2


def test_current_and_heat_follow_the_resistance_of_phase_and_temperature():
    by_phase, by_heat = "austenite_change=0.2 hump=0.1", "temperature_coefficient=3e-4"
    changes = f"{by_phase} {by_heat} martensite_coefficient=1e-3"
    rig = effect(COMPOSITE, f"phase_dependent_resistance: {changes}")
    time, voltage = refined(*pulses(0.02, 8.0), 40)
    run = simulate(rig, time, voltage)
    xi = run.martensite_fraction
    ohm = 2.6987 * (1 + 0.2 * (1 - xi) + 0.4 * xi * (1 - xi))
    ohm *= 1 + (3e-4 + 1e-3 * xi) * (run.temperature - AMBIENT)
    assert np.ptp(run.martensite_fraction) > 0.9
    assert run.current == pytest.approx(voltage / ohm, rel=1e-13)
    heat = by_hand.Heat(rig)
    taken = np.diff(run.temperature, axis=0) * heat.capacity
    power = voltage**2 / ohm - heat.loss * (run.temperature - AMBIENT)
    held = (voltage[:-1] ** 2 - voltage[1:] ** 2) / ohm[1:]
    given = 0.5 * np.diff(time)[:, np.newaxis] * (power[:-1] + power[1:] + held)
    assert np.abs(np.cumsum(given - taken, axis=0)).max() < 1e-3 * np.abs(np.cumsum(taken)).max()


def test_an_overloaded_supply_heats_with_its_reduced_voltage():
    time, voltage = pulses(0.05)
    rig = effect(COMPOSITE, "supply_drop: overload=0.5 knee=1.4")
    left = np.minimum(voltage, 2.6987 * (voltage + 0.5 * 1.4) / (2.6987 + 0.5))
    run, plain = simulate(rig, time, voltage), simulate(COMPOSITE, time, left)
    assert np.any(left < voltage) and np.any((left == voltage) & (voltage > 0.0))
    assert run.temperature == pytest.approx(plain.temperature, rel=1e-12)
    assert run.current == pytest.approx(plain.current, rel=1e-12)


def test_a_transistor_keeps_its_voltage_at_any_current_and_passes_none_below_it():
    time, voltage = pulses(0.05)
    run = simulate(effect(COMPOSITE, "supply_drop: threshold=3.2"), time, voltage)
    plain = simulate(COMPOSITE, time, np.maximum(voltage - 3.2, 0.0))
    assert run.temperature == pytest.approx(plain.temperature, rel=1e-12)
    assert run.current == pytest.approx(plain.current, rel=1e-12)
    assert np.any(run.current > 0.0) and np.any(run.current[voltage > 0.0] == 0.0)


def test_a_battery_sags_and_recovers_with_its_time_constant():
    time, volts, share, tau = np.arange(0.0, 60.0, 0.01), 5.0, 0.4 / 2.6987, 8.0
    voltage = np.outer(np.where(time < 30.0, volts, 0.0), np.ones(4))
    rig = effect(COMPOSITE, f"supply_drop: battery=0.4 battery_time={tau}")
    run = simulate(rig, time, voltage)
    loaded = np.minimum(time, 30.0)  # tau du/dt = R_b (V - u)/R - u, then with V = 0 at no current
    sag = volts * share / (1.0 + share) * -np.expm1(-(1.0 + share) * loaded / tau)
    sag *= np.exp(-np.maximum(time - 30.0, 0.0) / tau)
    assert run.sag == pytest.approx(np.outer(sag, np.ones(4)), abs=1e-3 * volts * share)
    plain = simulate(COMPOSITE, time, np.maximum(voltage - run.sag, 0.0))
    assert run.current == pytest.approx(plain.current, rel=1e-12)
    assert np.abs(run.temperature - plain.temperature).max() < 1e-9


@pytest.mark.parametrize(("sides", "matrix"), [("ffbb", 0.0), ("fffb", 0.2)])
def test_all_effects_on_the_heat_together_converge_to_the_equations(sides, matrix):
    whole = {"f": "front", "b": "back"}
    rig = effect(
        COMPOSITE.replace({"bench.channel_sides": tuple(whole[s] for s in sides)}),
        f"matrix_thermal_mass: heat_capacity={matrix} inner_share=0.4, "
        "side_heat_coupling: conductance=0.05 plume=-0.2, ambient_drift: rate=0.02 bend=1e-3 "
        "gust=5 instant=2 fading=6, matrix_thermal_mass: clamp_conductance=0.03 clamp_time=3, "
        "temperature_dependent_convection: rise=4e-3, supply_drop: resistance=0.2 threshold=0.1, "
        "phase_dependent_resistance: temperature_coefficient=2e-3",
    )
    time, voltage = pulses(0.25, 12.0)
    reference = by_hand.Heat(rig).solve(time, 0.5 * voltage)
    errors = []
    for parts in (50, 100):
        run = simulate(rig, *refined(time, 0.5 * voltage, parts))
        assert np.all(run.martensite_fraction == 1.0)
        errors.append(np.abs(run.temperature[::parts] - reference).max())
    assert errors[1] < 0.05
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.3)


def test_no_latent_heat_is_lost_between_wire_and_silicone():
    silicone = "matrix_thermal_mass: heat_capacity=0.08 inner_share=0.3, "
    rig = effect(COMPOSITE, silicone + "latent_heat: heat=9e3 tilt=-3e3")
    time, voltage = refined(*pulses(0.02, 8.0), 20)
    run = simulate(rig, time, voltage)
    loss, step, around = by_hand.Heat(rig).loss, time[1], np.full_like(run.temperature, AMBIENT)
    inner, outer = loss / 0.3, loss / 0.7
    rate = 0.5 * step * (inner + outer) / 0.08
    for k, towards in enumerate(run.temperature[:-1] + run.temperature[1:]):  # trapezoids
        given = 0.5 * step * (inner * towards + 2.0 * outer * AMBIENT) / 0.08
        around[k + 1] = (around[k] * (1.0 - rate) + given) / (1.0 + rate)
    excess = run.temperature - around
    electrical = voltage[:-1] ** 2 / 2.6987 * step
    left = electrical - inner * 0.5 * step * (excess[:-1] + excess[1:])
    taken = by_hand.Heat(rig).capacity * np.diff(run.temperature, axis=0)
    xi = run.martensite_fraction
    taken -= 0.091e-3 * np.diff(9e3 * xi - 3e3 * (np.square(xi) - xi), axis=0)
    assert np.ptp(run.martensite_fraction) > 0.5
    assert np.abs(np.cumsum(left - taken, axis=0)).max() < 1e-4 * np.cumsum(electrical).max()


def test_no_martensite_gives_heat_off_on_its_way_to_austenite():
    time, voltage = pulses(0.05, 12.0)
    tilted = [simulate(effect(COMPOSITE, f"latent_heat: heat=9e3 tilt={tilt}"), time, voltage)
              for tilt in (9e3, 25e3, -9e3, -25e3)]
    for as_much, more in (tilted[:2], tilted[2:]):
        assert np.array_equal(more.temperature, as_much.temperature)
    even = simulate(effect(COMPOSITE, "latent_heat: heat=0 tilt=9e3"), time, voltage)
    assert np.array_equal(even.temperature, simulate(COMPOSITE, time, voltage).temperature)


def driven(rig, *peaks, sigma=0.0):
    """A wire at constant stress [Pa] with a slow voltage through `peaks`, 4 s from one to the next;
    and the samples at which its temperature reverses."""
    time = np.arange(0.0, 4.0 * (len(peaks) - 1), 0.005)
    voltage = np.interp(time, 4.0 * np.arange(len(peaks)), peaks)[:, np.newaxis]
    run = simulate(rig, time, voltage, boundary=Boundary.held_stress(sigma))
    rising = np.diff(run.temperature[:, 0]) >= 0
    return run, [0, *(np.flatnonzero(rising[1:] != rising[:-1]) + 1), len(time) - 1]


def ordered_together(u, v, memory):
    """Plackett's distribution: the root of (q - 1) C^2 - [1 + (q - 1)(u + v)] C + q u v = 0."""
    if not memory:
        return u * v
    rest = max(1.0 - memory, ROUNDED)
    q = (2.0 - rest) / rest
    both = (np.roots([q - 1.0, -1.0 - (q - 1.0) * (u + x), q * u * x]) for x in v)
    return np.array([min(roots[roots > -1e-12]) for roots in both])


@pytest.mark.parametrize("memory", [-0.5, 0.0, 0.4, 1.0])
def test_incomplete_loops_lie_between_the_contracts_rule_and_the_full_loop(memory):
    rig = effect(WIRE, f"partial_transformation: memory={memory}")
    run, ends = driven(rig, 0, 4.6, 3.4, 4.7, 4.3, 4.65, 4.0, 6.5, 0)
    kelvin, xi = run.temperature[:, 0], run.martensite_fraction[:, 0]
    f, g = by_hand.full_loop(rig, kelvin)
    for first, last in zip(ends[:-1], ends[1:], strict=True):
        part = slice(first, last + 1)
        rising = kelvin[last] > kelvin[first]
        share, left = (f[part], xi[part]) if rising else (g[part], 1.0 - xi[part])
        if left[0] == 0.0:
            continue
        contract = left[0] * share / share[0]
        flat = left[0] * np.minimum(1.0, share / min(share[0], left[0]))
        assert memory < 0.0 or np.all((left >= contract - 1e-9) & (left <= flat + 1e-9))
        assert np.all(np.diff(left) <= 1e-12)
        u, v = min(left[0] / share[0], 1.0), share / share[0]
        expected = contract if u == 1.0 else share[0] * ordered_together(u, v, memory)
        assert left == pytest.approx(expected, abs=1e-9)
        assert memory < 1.0 or left == pytest.approx(flat, abs=0.02)
    assert len(ends) == 9
    assert 0.1 < xi[ends[1]] < 0.9


def nested(rig, kelvin, memory):
    """xi along temperatures at zero stress: straight lines over the ramp to the loops' start."""
    f, g = by_hand.full_loop(rig, kelvin)
    xi, rising, opened = [1.0], True, [(1.0, f[0], g[0])]
    start = (1.0, f[0])
    for k in range(1, len(kelvin)):
        if (kelvin[k] >= kelvin[k - 1]) != rising:
            rising = not rising
            opened.append((xi[-1], f[k - 1], g[k - 1]))
            start = (xi[-1], f[k - 1]) if rising else (1.0 - xi[-1], g[k - 1])
        own = f[k] if rising else g[k]
        while True:
            phase_there = end = 0.0
            if len(opened) > 1:
                at_xi, at_f, at_g = opened[-2]
                phase_there, end = (at_xi, at_f) if rising else (1.0 - at_xi, at_g)
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
def test_return_points_follow_nested_loops(memory):
    rig = effect(WIRE, f"partial_transformation: return_point={memory}")
    peaks = (0, 4.6, 3.9, 4.5, 4.0, 4.4, 4.0, 4.65, 3.5, 4.3, 0)
    run, ends = driven(rig, *peaks)
    xi = run.martensite_fraction[:, 0]
    assert xi == pytest.approx(nested(rig, run.temperature[:, 0], memory), abs=1e-9)
    assert len(ends) == 11
    plain, _ = driven(WIRE, *peaks)
    assert np.max(np.abs(plain.martensite_fraction[:, 0] - xi)) > 0.02 * memory


def test_transitions_shift_by_the_cycles_done():
    numbers = "shift=8.0 cycles=2.0 plastic_strain=2e-3 martensite_shift=-3.0"
    rig = effect(WIRE, f"transition_drift: {numbers}")
    run, ends = driven(rig, 0, 7, 0, 7, 0, 7, 0)
    assert len(ends) == 7
    for n, (first, last) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        part = slice(first, last + 1)
        shift = 5.0 if n % 2 else 8.0
        unshifted = run.temperature[part, 0] - shift * by_hand.done(n / 2, 2.0)
        f, g = by_hand.full_loop(rig, unshifted)
        expected = 1.0 - g if n % 2 else f
        assert run.martensite_fraction[part, 0] == pytest.approx(expected, abs=1e-9)
    at_rest = run.contraction[ends[::2], 0]
    assert at_rest == pytest.approx([-2e-3 * by_hand.done(n, 2.0) for n in range(4)], abs=1e-5)


def pulled_by(numbers, step=0.05, share=1.0):
    """Pulses on a composite: the run, sums of stresses (n, 2) and stiffness (2,) of its sides."""
    time, voltage = pulses(step)
    run = simulate(effect(COMPOSITE, numbers), time, voltage * share)
    pulled = run.stress.reshape(-1, 2, 2).sum(axis=2)
    return run, pulled, np.array(Boundary.of(run.parameters).stiffness)


def stretched(run, strain):
    """Stress of eq. (6) where the strain of eq. (9) is `strain` (n, w)."""
    modulus = E_A + run.martensite_fraction * (E_M - E_A)
    expansion = run.parameters["wire.thermal_expansion_factor"] * (run.temperature - AMBIENT)
    return modulus * (strain - run.contraction[:, [0, 0, 1, 1]]) + expansion


@pytest.mark.parametrize(("share", "recovery"), [(0.15, 0.0), (-0.1, 0.0), (0.15, 0.3)])
def test_residual_strain_is_exact_and_absent_in_the_first_heating(share, recovery):
    numbers = f"residual_strain: share={share} recovery={recovery}"
    run, pulled, stiffness = pulled_by(numbers)
    austenite = 1.0 - run.martensite_fraction
    kept, most = np.zeros(austenite.shape[1]), np.zeros_like(austenite)
    for k, now in enumerate(austenite):
        most[k] = np.maximum(kept, now)  # m decreases after the step
        kept = now + (most[k] - now) * np.exp(-recovery * 0.05)
    strain = EPS_L * ((1 - share) * austenite + share * most)
    assert np.any((most < 0.9) & (most > 0.1))
    assert np.abs(run.stress - stretched(run, strain)).max() < 1.0
    assert np.abs(pulled - stiffness * run.contraction).max() < 10.0
    paper = simulate(COMPOSITE, run.time, run.voltage)
    falls = int(np.argmax(np.any(np.diff(austenite, axis=0) < 0.0, axis=1)))
    assert falls > 5
    assert np.array_equal(run.deflection[: falls + 1], paper.deflection[: falls + 1])


def test_the_matrix_of_a_driven_side_follows_the_standard_linear_solid():
    numbers = "relaxation=0.3 time_constant=2.0 spread_relaxation=0.2"
    run, pulled, stiffness = pulled_by(f"viscoelastic_matrix: {numbers}", 0.004)
    expected = stiffness * run.bending
    for share, tau in ((0.3, 2.0), (0.1, 0.25), (0.1, 16.0)):
        lagging = np.zeros_like(run.bending)
        for k, step in enumerate(np.diff(run.time)):  # trapezoids: dq/dt = (e - q)/tau
            towards = run.bending[k] + run.bending[k + 1]
            rest = lagging[k] * (2.0 * tau - step)
            lagging[k + 1] = (rest + step * towards) / (2.0 * tau + step)
        expected = expected + share * stiffness * (run.bending - lagging)
    assert pulled == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize("engagement", [0.3, 1.0])
def test_both_sides_balance_if_a_share_of_the_bending_reaches_the_other(engagement):
    numbers = f"opposing_wires: engagement={engagement} detwinning_stress=1e9"
    run, pulled, stiffness = pulled_by(numbers, share=FRONT_ONLY)
    front = pulled[:, 0] / stiffness[0]
    back = front - run.bending[:, 0]
    assert np.abs(back).max() > 1e-3
    # The front's wires feel the share of the back's bending, the back's wires that of the front's.
    assert run.contraction[:, 0] == pytest.approx(front - engagement * back, abs=1e-9)
    assert stiffness[1] * back == pytest.approx(2 * E_M * (engagement * front - back), abs=100.0)


@pytest.mark.parametrize("step", [0.005, 0.1])
@pytest.mark.parametrize(("gap", "detwinning"), [(0.0, 20e6), (6e-3, 1e9), (6e-3, 20e6)])
def test_passive_wires_yield_and_stay_stretched_and_buckled_ones_never_push(gap, detwinning, step):
    kind = f"buckled=0.5 gap={gap}" if gap else "engagement=0.5"
    numbers = f"opposing_wires: {kind} detwinning_stress={detwinning}"
    run, pulled, stiffness = pulled_by(numbers, step, FRONT_ONLY)
    # Two martensitic wires on the back's silicone.
    modulus = 4.0e9 * 2 * E_M / (4.0e9 + (1.0 - 0.5**2) * 2 * E_M)
    felt = 0.5 * (run.contraction[:, 0] - gap)
    force, stretch = by_hand.forces_of_passive_wires(
        felt, modulus, 2 * detwinning, 2 * HARDENING, buckled=gap > 0.0
    )
    reaction = 0.5 * stiffness[0] / stiffness[1] * force
    expected = stiffness[0] * run.contraction[:, 0] + reaction
    assert pulled[:, 0] == pytest.approx(expected, abs=20.0)
    bent = run.contraction[:, 0] - 0.5 * force / stiffness[1]
    assert run.bending[:, 0] == pytest.approx(bent, abs=1e-9)
    assert (stretch.max() > 1e-3) == (detwinning < 1e9)
    yields = np.diff(stretch)
    apart = (force == 0.0) & (run.contraction[:, 0] > 1e-3)
    seen = (force > 0.0, apart) if gap else (yields > 0.0, yields < 0.0)
    assert min(map(np.sum, seen)) > 5


def test_channel_friction_opposes_every_motion_of_its_side():
    run, pulled, stiffness = pulled_by("opposing_wires: channel_friction=4e6")
    excess, motion = (pulled - stiffness * run.contraction)[1:], np.diff(run.contraction, axis=0)
    moves = np.abs(motion) > 1e-9
    assert np.abs(excess).max() < 4e6 + 100.0
    assert excess[moves] == pytest.approx(4e6 * np.sign(motion[moves]), abs=100.0)
    assert min(np.sum(motion[moves] > 0.0), np.sum(motion[moves] < 0.0), np.sum(~moves)) > 20


@pytest.mark.parametrize("length", [0.2, -0.3])
def test_wires_nearer_to_the_middle_bend_more_against_more_stiffness(length):
    run, pulled, _ = pulled_by(f"side_asymmetry: lever={length}")
    longer = 1.0 + length * np.array([1.0, -1.0])
    assert np.abs(pulled - np.array([5e9, 4e9]) * longer**2 * run.bending).max() < 10.0
    assert run.deflection == pytest.approx(run.bending @ (longer * [1.0, -1.0]), abs=1e-12)


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_slack_is_a_dead_zone_of_exactly_its_strain(step):
    slack = 4e-3
    run, pulled, stiffness = pulled_by(f"slack: strain={slack}", step)
    e, b = run.contraction, run.bending
    assert run.stress == pytest.approx(stretched(run, EPS_L * (1 - run.martensite_fraction)), abs=1)
    assert pulled == pytest.approx(stiffness * b, abs=10.0)
    taut, pushing = b > 0.0, b < 0.0
    hanging = ~taut & ~pushing
    assert min(np.sum(taut[1:]), np.sum(pushing), np.sum(hanging[1:])) > 5
    assert (e - b)[taut] == pytest.approx(slack, abs=1e-12)
    assert (e - b)[pushing] == pytest.approx(0.0, abs=1e-12)
    assert np.all((e >= -1e-12) & (e <= slack + 1e-12) | ~hanging)
    assert np.abs(pulled[hanging]).max() < 10.0


@pytest.mark.parametrize("step", [0.005, 0.1])
@pytest.mark.parametrize("hard", [0.0, 2e-3])
def test_soft_slack_is_taken_up_gradually(step, hard):
    run, pulled, stiffness = pulled_by(f"slack: soft_strain=3e-3 strain={hard}", step)
    beyond, b = run.contraction - hard, run.bending
    assert pulled == pytest.approx(stiffness * b, abs=50.0)
    expected = np.where(beyond < 6e-3, np.square(beyond) / 12e-3, beyond - 3e-3)
    pulls = b > 1e-9
    assert b[pulls] == pytest.approx(expected[pulls], abs=1e-8)
    assert min(np.sum(beyond[pulls] < 6e-3), np.sum(beyond[pulls] > 6e-3)) > 5
    assert np.all(beyond[~pulls] < 2e-5)


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_wires_that_rub_in_their_sleeves_slide_at_the_friction_and_stick_below_it(step):
    slack, friction = 3e-3, 5e6
    numbers = f"rubbing_strain={slack} friction={friction}"
    run, pulled, stiffness = pulled_by(f"slack: {numbers}", step)
    play = run.contraction - run.bending
    assert pulled == pytest.approx(stiffness * run.bending, abs=10.0)
    assert np.all((play > -1e-12) & (play < slack + 1e-12))
    inside, slid = (play > 1e-9) & (play < slack - 1e-9), np.diff(play, axis=0, prepend=0.0)
    assert np.abs(pulled[inside]).max() < friction + 10.0
    slides = inside & (np.abs(slid) > 1e-9)
    assert pulled[slides] == pytest.approx(friction * np.sign(slid[slides]), abs=10.0)
    # The play reaches both ends, and only there the friction is exceeded.
    assert np.all(pulled[play <= 1e-9] < friction + 10.0)
    assert np.all(pulled[play >= slack - 1e-9] > -friction - 10.0)
    assert min(np.sum(pulled > 2.0 * friction), np.sum(inside & ~slides), np.sum(slid < -1e-9)) > 2


@pytest.mark.parametrize(("walking", "opposite"), [(0.0, 0.0), (0.1, 0.2)])
def test_a_spot_larger_than_the_wire_mixes_radiances_from_the_first_sample(walking, opposite):
    """The wire leaves the spot as the beam bends, and the spot sees wires of the other side."""
    drift, (time, voltage) = "ambient_drift: rate=0.02", pulses(0.05)
    numbers = f"missing=0.1 walking={walking} opposite={opposite}"
    rig = effect(COMPOSITE, f"temperature_underfill: {numbers}, {drift}")
    warm = initial_state(rig, temperature=325.0)
    run = simulate(rig, time, voltage, initial=warm)
    assert np.all(run.temperature[0] == 325.0)
    missing = 0.1 + walking * np.abs(run.bending[:, :1] - run.bending[:, 1:]) / 0.01
    mean = run.temperature.reshape(-1, 2, 2).mean(axis=2)[:, [1, 1, 0, 0]]
    radiance = (1.0 - missing - opposite) * run.temperature**4.5 + opposite * mean**4.5
    radiance += missing * (AMBIENT + 0.02 * time[:, np.newaxis]) ** 4.5
    assert np.ptp(missing) >= walking
    assert run.temperature_reading == pytest.approx(radiance ** (1 / 4.5), rel=1e-12)
    plain = simulate(effect(COMPOSITE, drift), time, voltage, initial=warm)
    assert np.array_equal(run.deflection, plain.deflection)


def test_a_reading_has_a_slow_share_and_is_late_by_half_an_exposure():
    time = np.arange(0.0, 30.0, 0.01)
    fast, slow, mixed, exposed = (
        simulate(effect(COMPOSITE, f"temperature_lag: {n}"), time, np.full((time.size, 4), 4.0))
        for n in ("time_constant=0.3", "time_constant=2.0",
                  "time_constant=0.3 slow_share=0.4 slow_time=2.0", "exposure=0.6")
    )  # fmt: skip
    expected = 0.6 * fast.temperature_reading + 0.4 * slow.temperature_reading
    assert mixed.temperature_reading == pytest.approx(expected, rel=1e-12)
    # Same mean delay and width of the step response as an average over the exposure.
    behind = (exposed.temperature - exposed.temperature_reading)[:, 0]
    rise = exposed.temperature[-1, 0] - AMBIENT
    tau = by_hand.Heat(COMPOSITE).capacity / by_hand.Heat(COMPOSITE).loss
    assert trapezoid(behind, time) / rise == pytest.approx(0.3, rel=0.01)
    moment = trapezoid(behind * time, time) / rise
    assert moment == pytest.approx(0.3 * tau + 0.3**2 / 2 + 0.6**2 / 24, rel=0.01)


def test_a_lagging_sensor_follows_the_exact_response():
    rig = effect(COMPOSITE, "temperature_lag: time_constant=0.5")
    tau = 0.091e-3 * 343.2 / (403.26 * 395.84e-6)
    rise = 16.0 / (2.6987 * 403.26 * 395.84e-6)
    errors = []
    for step in (0.04, 0.02):
        time = np.arange(0.0, 4.0, step)
        run = simulate(rig, time, np.full((time.size, 4), 4.0))
        expected = AMBIENT + by_hand.lagged_heating(time, rise, tau, 0.5)
        errors.append(np.abs(run.temperature_reading[:, 0] - expected).max())
    assert errors[1] < 0.03
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)


def test_only_the_reading_of_the_deflection_drifts():
    numbers = "rate=1e-5 bend=-2e-7 warm_up=3e-4 warm_up_time=5 by_heat=2e-6 mount_time=4"
    rig = effect(COMPOSITE, f"deflection_drift: {numbers}")
    time, voltage = pulses(0.05)
    run, paper = simulate(rig, time, voltage), simulate(COMPOSITE, time, voltage)
    assert np.array_equal(run.deflection, paper.deflection)
    drift = run.deflection_reading - run.deflection
    mount, kept = np.zeros(len(time)), np.exp(-0.05 / 4)
    for k, rise in enumerate(run.temperature.mean(axis=1)[1:] - AMBIENT):
        mount[k + 1] = kept * mount[k] + (1.0 - kept) * rise
    expected = 1e-5 * time - 2e-7 * time**2 + 3e-4 * (1.0 - np.exp(-time / 5)) + 2e-6 * mount
    assert drift == pytest.approx(expected, abs=1e-15)
    assert np.array_equal(run.temperature_reading, paper.temperature)
