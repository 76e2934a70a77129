"""Laws of the phase and free convection, against independent references."""

import effect_references as by_hand
import numpy as np
import pytest
from effect_references import COMPOSITE, WIRE, pulses
from scipy.special import ndtr, ndtri

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import LAWS, TRANSITIONS
from sma_bench.physics import Boundary, initial_state, kernel, material, simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.laws import normal

pytest.importorskip("numba", reason="many simulations: slow without numba")

AMBIENT = 296.15
# A wire of 0.5 mm as catalogues have it, wide hysteresis and unequal ranges.
GRADE = dict(zip(TRANSITIONS.values(), (345.0, 363.0, 338.0, 312.0), strict=True))
C_A, C_M = 7.3e6, 9.0e6
STOCK = WIRE.replace({**GRADE, "wire.stress_influence_austenite": C_A,
                      "wire.stress_influence_martensite": C_M,
                      "wire.hysteresis_spread": 0.25})  # fmt: skip
SIGNALS = ("temperature", "martensite_fraction", "stress", "bending", "deflection_reading")
OHM, HEAT = WIRE["wire.resistance"], by_hand.Heat(WIRE)


def of_law(parameters, law):
    return parameters.replace({"wire.law": law})


def led(rig, turns, sigma=0.0, step=0.05):
    """Temperatures [K] in even steps from rest through `turns`, and xi of a wire at constant stress
    that has almost no heat capacity."""
    legs = [np.linspace(a, b, int(abs(b - a) / step) + 1)[1:]
            for a, b in zip((AMBIENT, *turns), turns, strict=False)]  # fmt: skip
    kelvin = np.concatenate([[AMBIENT], *legs])
    volts = np.sqrt((np.append(kelvin[1:], kelvin[-1]) - AMBIENT) * HEAT.loss * OHM)
    light = rig.replace({"wire.mass": 1e-7, "wire.specific_heat": 50.0})
    held = Boundary.held_stress(sigma)
    run = simulate(light, np.arange(kelvin.size), volts, boundary=held)
    assert run.temperature[:, 0] == pytest.approx(kelvin, abs=1e-9)
    return kelvin, run.martensite_fraction[:, 0]


def test_cold_ends_transform_later_and_close_their_loops():
    wire = of_law(STOCK, "normal").replace({"wire.length": 0.2})
    kelvin, middle = led(wire, (420.0, 330.0, 420.0))
    _, xi = led(wire.replace({"wire.end_length": 0.004}), (420.0, 330.0, 420.0))
    centres, halves, deviation = normal.groups(wire)
    piece, hot = 2.0 * 0.004 / 0.2, kelvin[: np.argmax(kelvin) + 1]
    ends = [AMBIENT + warmth * (hot - AMBIENT) for warmth in (0.25, 0.6, 0.9)]
    left = sum(ndtr((np.mean(centres) + np.mean(halves) - end) / deviation) for end in ends)
    assert xi[: hot.size] == pytest.approx((1.0 - 3.0 * piece) * middle[: hot.size] + piece * left)
    assert xi[-1] == pytest.approx(xi[hot.size - 1]) and xi[-1] > piece
    with pytest.raises(InputError, match="end_length"):
        of_law(wire, "cosine").replace({"wire.end_length": 0.004})


def shifting(law, sigma):
    """Stresses [Pa] by which the ranges of heating and of cooling shift."""
    if law == "brinson":
        return sigma, max(sigma - 100e6, 0.0)
    if law == "extended":
        softer = 1.0 / 22.8e9 - 1.0 / 55.4e9
        return (sigma * (1.0 - np.exp(-sigma / 50e6) + softer * sigma / 0.044 / 2.0),) * 2
    return sigma, sigma


@pytest.mark.parametrize("sigma", [0.0, 120e6])
@pytest.mark.parametrize("law", LAWS)
def test_every_law_has_the_same_four_temperatures_shifted_by_stress(law, sigma):
    kelvin, xi = led(of_law(STOCK, law), (420.0, 297.0), sigma)
    top = int(np.argmax(kelvin))
    a_s, a_f, m_s, m_f = GRADE.values()
    hot, cold = shifting(law, sigma)
    found = [
        np.interp([a_s + hot / C_A, a_f + hot / C_A], kelvin[:top], xi[:top]),
        np.interp([m_s + cold / C_M, m_f + cold / C_M], kelvin[:top:-1], xi[:top:-1]),
    ]
    sharp = dict.fromkeys(("cosine", "brinson", "extended"), (1.0, 0.0))
    ends = (sharp | {"exponential": (1.0, 0.025)}).get(law, (0.975, 0.025))
    assert found[0] == pytest.approx(ends, abs=2e-3)
    assert found[1] == pytest.approx([1.0 - end for end in ends], abs=2e-3)
    # The formulas that identification and controllers use are these branches.
    rig = of_law(STOCK, law)
    assert xi[:top] == pytest.approx(kernel.heated_fraction(kelvin[:top], sigma, rig), abs=6e-3)
    assert xi[top:] == pytest.approx(kernel.cooled_fraction(kelvin[top:], sigma, rig), abs=6e-3)


def left(law, x):
    """Fraction left at the share x of a range."""
    if law == "exponential":
        return np.minimum(np.exp(-np.log(40.0) * x), 1.0)
    return 1.0 / (1.0 + np.exp(np.log(39.0) * (2.0 * x - 1.0)))


@pytest.mark.parametrize("law", ["exponential", "logistic"])
def test_partial_loops_of_a_composite_follow_the_rule_and_the_stress_at_every_sample(law):
    run = simulate(of_law(COMPOSITE, law), *pulses(0.05, 12.0))
    p, kelvin, sigma, xi = COMPOSITE, run.temperature, run.stress, run.martensite_fraction
    a_s, a_f, m_s, m_f = (p[name] for name in TRANSITIONS.values())
    f = left(law, (kelvin - a_s - sigma / 7.3e6) / (a_f - a_s))
    g = left(law, (m_s - kelvin + sigma / 8.0e6) / (m_s - m_f))
    per_wire = run.contraction[:, [0, 0, 1, 1]]
    assert np.abs(sigma - material.stress(kelvin, xi, per_wire, p)).max() < 1.0
    steady = run.voltage**2 / OHM / HEAT.loss + AMBIENT
    off, turned = by_hand.rule_errors(run, f, g, steady)
    assert off < 1e-8 and turned > 10 and np.ptp(xi) > 0.9


def test_shares_of_two_other_laws_are_limited_to_a_sum_of_one():
    """With a larger sum the branches would not be monotone, and steps could not be solved."""
    def branch(soft, sharp):
        own = {f"effect.transformation_law.{n}": x
               for n, x in (("logistic", soft), ("exponential", sharp))}  # fmt: skip
        return led(WIRE.replace(own), (380.0, 300.0))[1]

    half = branch(0.5, 0.5)
    assert branch(1.0, 1.0) == pytest.approx(half, abs=1e-9)
    turn = int(np.argmin(half))
    each = 0.5 * (branch(1.0, 0.0) + branch(0.0, 1.0))
    assert half[:turn] == pytest.approx(each[:turn], abs=1e-9)
    assert np.all(np.diff(half[:turn]) <= 1e-12) and np.all(np.diff(half[turn:]) >= -1e-12)


UP, DOWN = 18.0 / 3.92, 26.0 / 3.92  # K, deviations of STOCK's branches
HALF, SPREAD = 14.5, 0.25 * 14.5  # K, of its hysteresis
TOGETHER = (UP**2 - DOWN**2) / 4.0


def grains(count, seed):
    """Thresholds [K] on heating and on cooling, drawn from the distribution that STOCK states."""
    centres = (UP**2 + DOWN**2) / 2 - SPREAD**2
    covariance = [[centres, TOGETHER], [TOGETHER, SPREAD**2]]
    rng = np.random.default_rng(seed)
    drawn = rng.multivariate_normal([339.5, HALF], covariance, count, method="cholesky")
    return drawn[:, 0] + drawn[:, 1], drawn[:, 0] - drawn[:, 1]


def five_groups(count, skew=0.0):
    """Thresholds [K] of grains in the five groups of laws/normal.py; skewed centres follow two
    half normal distributions about one peak."""
    heated, cooled = [], []
    rest = np.sqrt((UP**2 + DOWN**2) / 2 - SPREAD**2 - TOGETHER**2 / SPREAD**2)
    z = 1.1 * np.arange(-2, 3)
    shares = np.linalg.solve(np.vander(z, 5, increasing=True).T, [1.0, 0.0, 1.0, 0.0, 3.0])
    for share, half in zip(shares, HALF + SPREAD * z, strict=True):
        centre = 339.5 + TOGETHER / SPREAD**2 * (half - HALF)
        n = round(count * share)
        p, low, high = (np.arange(n) + 0.5) / n, 1.0 - skew, 1.0 + skew
        away = np.where(p < 0.5 * low, low * ndtri(p / low), high * ndtri((p + skew) / high))
        within = centre + rest * (away - away.mean()) / (away.std() if skew else 1.0)
        heated.append(within + half)
        cooled.append(within - half)
    return np.concatenate(heated), np.concatenate(cooled)


def switched(hot, cold, heated, cooled):
    """Martensite fraction of relays along T - sigma/C_A and T - sigma/C_M."""
    martensite, shares = np.ones(heated.size, bool), []
    for a, m in zip(hot, cold, strict=True):
        martensite = np.where(a >= heated, False, martensite | (m < cooled))
        shares.append(martensite.mean())
    return np.array(shares)


LOOPS = (358.0, 320.0, 352.0, 330.0, 348.0, 334.0, 353.0, 318.0, 364.0, 326.0, 400.0, 300.0)


@pytest.mark.parametrize("skew", [0.0, -0.4, 0.5])
def test_the_normal_law_equals_many_grains_that_switch_one_by_one(skew):
    rig = of_law(STOCK, "normal").replace({"wire.transition_skew": skew})
    kelvin, xi = led(rig, LOOPS, step=0.2)
    heated, cooled = five_groups(20_000, skew)
    if skew:  # shifted to keep the 2.5 and 97.5 % points within half a kelvin
        off = [np.quantile(heated, [0.025, 0.975]) - (345.0, 363.0),
               np.quantile(cooled, [0.025, 0.975]) - (312.0, 338.0)]  # fmt: skip
        heated, cooled = heated - np.mean(off), cooled - np.mean(off)
        assert np.abs(off - np.mean(off)).max() < 0.5 < np.mean(off) / skew
    expected = switched(kelvin, kelvin, heated, cooled)
    assert xi == pytest.approx(expected, abs=0.012 if skew else 2e-3)
    if not skew:  # five groups stand for a continuous distribution
        off = xi - switched(kelvin, kelvin, *grains(40_000, 1))
        assert np.sqrt(np.mean(off**2)) < 0.015 and np.abs(off).max() < 0.06


def oriented(law, sigma):
    """Share of martensite formed at this stress [Pa] that has a strain, by the default numbers."""
    if law == "extended":
        return 1.0 - np.exp(-sigma / 50e6)
    return np.sin(0.5 * np.pi * np.clip((sigma - 100e6) / 70e6, 0.0, 1.0)) ** 2


@pytest.mark.parametrize("law", ["brinson", "extended"])
@pytest.mark.parametrize("sigma", [40e6, 130e6, 250e6])
def test_the_strain_of_martensite_depends_on_the_load(law, sigma):
    rig, strain = of_law(STOCK, law), STOCK["wire.maximum_recoverable_strain"]
    time, newton = np.arange(0.0, 40.0, 0.05), sigma * np.pi * 0.25 * STOCK["wire.diameter"] ** 2
    volts = np.where(time % 20.0 < 8.0, 6.8, 0.0)
    run = simulate(rig, time, volts, boundary=Boundary.held_stress(sigma))
    assert run.martensite_fraction.min() == 0.0 and run.martensite_fraction[-1, 0] == 1.0
    # It was stretched before it was mounted; the stress restores only a part of that strain.
    kept = run.contraction[-1, 0] - run.contraction[0, 0]
    assert kept == pytest.approx(strain * (1.0 - oriented(law, sigma)), abs=1e-6)
    # A wire that bears the stress at rest is oriented by it: strokes are equal, and smaller.
    borne = simulate(rig.replace({"load.kind": "force", "load.force": newton}), time, volts)
    assert np.ptp(borne.contraction[[0, 380, -1]]) < 1e-6
    assert np.ptp(borne.contraction) == pytest.approx(np.ptp(run.contraction) - kept, abs=1e-6)


def test_stress_detwins_cold_martensite_and_it_stays_detwinned():
    rig = of_law(STOCK, "brinson").replace({"load.kind": "displacement", "wire.length": 0.2})
    strain, time = STOCK["wire.maximum_recoverable_strain"], np.arange(0.0, 60.0, 0.02)
    # Heated and cooled without stress, stretched, released by a twentieth and stretched again.
    way = np.interp(time, [0, 5, 20, 40, 44, 48, 58], [0, -1, -1, 0, -0.05, 0, 0.05])
    run = simulate(rig, time, np.where(time < 10.0, 6.8, 0.0), elongation=0.2 * strain * way)
    cold, sigma = time > 20.0, run.stress[:, 0]
    shares = oriented("brinson", np.maximum.accumulate(sigma[cold]))
    assert sigma[cold] == pytest.approx(22.8e9 * strain * (1.0 + way[cold] - shares), abs=2e6)
    assert 0.5 < shares[-1] < 1.0 and np.ptp(sigma[(time > 40.0) & (time < 44.0)]) > 40e6


def test_r_phase_lengthens_a_cooling_wire_before_martensite_does():
    r_phase = {"wire.r_phase_strain": 0.005, "wire.r_phase_temperature": 345.0}
    time, held = np.arange(0.0, 8.0, 0.005), Boundary.held_stress(64e6)
    run, without = (
        simulate(STOCK.replace(own), time, np.where(time < 2.0, 6.8, 0.0), boundary=held)
        for own in (r_phase, {})
    )
    kelvin, xi = run.temperature[:, 0], run.martensite_fraction[:, 0]
    share = np.cos(0.5 * np.pi * np.clip((kelvin - 64e6 / 16e6 - 341.0) / 8.0, 0.0, 1.0)) ** 2
    longer = without.contraction[:, 0] - run.contraction[:, 0]
    assert longer[1:] == pytest.approx(0.005 * share[1:] * (1.0 - xi[:-1]), abs=1e-9)
    assert longer.max() > 0.003 and longer[-1] == 0.0


def test_grains_of_a_clamped_wire_switch_at_its_own_stress():
    time = np.arange(0.0, 60.0, 0.05)
    volts = 4.6 * np.sin(np.pi * time / 60.0) + 0.9 * np.sin(np.pi * time / 4.0)
    run = simulate(of_law(STOCK, "normal"), time, np.abs(volts))
    kelvin, sigma, xi = (a[:, 0] for a in (run.temperature, run.stress, run.martensite_fraction))
    assert sigma == pytest.approx(material.stress(kelvin, xi, 0.0, STOCK), abs=1.0)
    assert np.ptp(xi) > 0.05 and np.ptp(sigma) > 50e6
    expected = switched(kelvin - sigma / C_A, kelvin - sigma / C_M, *five_groups(20_000))
    assert xi == pytest.approx(expected, abs=2e-3)


def test_a_state_without_history_keeps_its_fraction_under_every_law():
    time, free = np.arange(0.0, 10.0, 0.05), Boundary.held_stress(0.0)
    used = simulate(STOCK, time, 4.9 * np.sin(np.pi * time / 10.0), boundary=free).final
    for law in LAWS:
        rig, states = of_law(STOCK, law), [(used, 0.02)]  # continued from a run under another law
        for kelvin, xi in ((340.0, 0.5), (345.0, 0.8), (330.0, 0.99), (297.0, 1.0)):
            warm = initial_state(rig, temperature=kelvin, martensite_fraction=xi, boundary=free)
            states.append((warm, 1e-6))
        for state, near in states:
            volts = np.full(3, np.sqrt((state.temperature[0] - AMBIENT) * HEAT.loss * OHM))
            run = simulate(rig, [0.0, 0.01, 0.02], volts, initial=state, boundary=free)
            xi = run.martensite_fraction[-1, 0]
            assert xi == pytest.approx(state.martensite_fraction[0], abs=near), law
        with pytest.raises(InputError, match="expected 0 above A_f"):
            initial_state(rig, temperature=400.0, martensite_fraction=0.5, boundary=free)


@pytest.mark.parametrize("law", LAWS)
def test_every_effect_works_under_every_law_or_the_pair_is_refused_by_name(law):
    time, voltage = pulses(0.0625, 12.0)
    base = of_law(COMPOSITE, law).replace(by_hand.SECONDARY)
    alone = simulate(base, time, voltage)
    assert np.ptp(alone.martensite_fraction) > 0.9
    for effect in EFFECTS.values():
        switches = (p for p in by_hand.SWITCHES if p.name.split(".")[1] == effect.name)
        on = {p.name: p.uncertainty for p in switches}
        if law not in effect.laws:
            with pytest.raises(InputError, match=f"effect {effect.name} with wire.law {law}"):
                base.replace(on)
            continue
        rig = base.replace(on)
        run = simulate(rig, time, voltage)
        names = (*SIGNALS, "current", "temperature_reading")
        assert all(np.all(np.isfinite(getattr(run, n))) for n in names), effect.name
        assert run.martensite_fraction.min() >= 0.0 and run.martensite_fraction.max() <= 1.0
        moved = [np.abs(getattr(run, n) - getattr(alone, n)).max() for n in names]
        assert max(np.array(moved) / (1.0, 1e-2, 1e6, 1e-4, 1e-4, 0.01, 1.0)) > 0.5, effect.name
        # A split run equals the whole one to the last bit.
        second = simulate(rig, time[69:], voltage[69:],
                          initial=simulate(rig, time[:70], voltage[:70]).final)
        assert all(np.array_equal(getattr(second, n), getattr(run, n)[69:]) for n in SIGNALS)
    refused = [e.name for e in EFFECTS.values() if law not in e.laws]
    own = {"normal": ["partial_transformation"], "brinson": ["residual_strain"]}
    refusing = (own | {"extended": own["brinson"]}).get(law, [])
    assert sorted(refused) == sorted(refusing + ["transformation_law"] * (law != "cosine"))


def churchill_chu(diameter, excess, ambient):
    """h [W/(m2 K)] of a thin horizontal cylinder in air, with properties of air from tables
    at 300 and 350 K (Incropera and DeWitt), linear in between."""
    film = ambient + 0.5 * excess

    def at(low, high):
        return low + (high - low) * (film - 300.0) / 50.0

    nu, alpha = at(15.89e-6, 20.92e-6), at(22.5e-6, 29.9e-6)
    k, prandtl = at(26.3e-3, 30.0e-3), at(0.707, 0.700)
    rayleigh = 9.81 * excess * diameter**3 / (film * nu * alpha)
    root = 0.387 * rayleigh ** (1 / 6) / (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    return (0.60 + root) ** 2 * k / diameter


def grey(surface, ambient):
    return 0.4 * 5.67e-8 * (surface**4 - ambient**4) / (surface - ambient)


@pytest.mark.parametrize("diameter", [0.1e-3, 0.5e-3])
def test_free_convection_depends_on_diameter_and_temperature(diameter):
    numbers = {"wire.convection": "free", "wire.diameter": diameter, **GRADE}
    rig = Parameters(numbers)
    named = rig["wire.heat_transfer_coefficient"]
    expected = churchill_chu(diameter, 60.0, AMBIENT) + grey(AMBIENT + 60.0, AMBIENT)
    assert named == pytest.approx(expected, rel=0.02)
    stated = Parameters({**numbers, "wire.heat_transfer_coefficient": 1.4 * named})
    # Steady state at every power: the loss is by h(T), which is the stated h at 60 K.
    time, area = np.arange(0.0, 60.0, 0.05), rig["wire.surface_area"]
    for bench, scale in ((rig, 1.0), (stated, 1.4)):
        for excess in (20.0, 60.0, 130.0):
            heat = excess * scale * named * area
            volts = np.full(time.size, np.sqrt(heat * bench["wire.resistance"]))
            kelvin = simulate(bench, time, volts).temperature[-1, 0]
            natural, reference = (churchill_chu(diameter, rise, AMBIENT)
                                  for rise in (kelvin - AMBIENT, 60.0))  # fmt: skip
            left = scale * named - grey(AMBIENT + 60.0, AMBIENT)
            h = grey(kelvin, AMBIENT) + left * natural / reference
            assert heat / area / (kelvin - AMBIENT) == pytest.approx(h, rel=0.03)
            assert excess != 60.0 or kelvin == pytest.approx(AMBIENT + 60.0, abs=0.05)
    back = rig.replace({"wire.convection": "constant"})
    assert back["wire.heat_transfer_coefficient"] == 403.26
