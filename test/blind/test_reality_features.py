"""Every feature of the reality: it does what it says, and vanishes as it is turned off."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from reality_rig import COMPOSITE, drive, needs_numba

from examination.blind.reality import BY_NAME, FEATURES, Outcome, World, happen

ACTING = [f for f in FEATURES if not f.setting and f.stage != "sensor"]
FRONT, BACK = slice(0, 2), slice(2, 4)

SIZES = {
    "resistance_austenite_change": -0.2, "resistance_temperature_coefficient": 1e-3,
    "supply_resistance": 0.3, "current_limit": 0.6, "contact_growth": 0.5,
    "latent_heat": 12e3, "convection_by_correlation": 1.0, "silicone_heat_capacity": 0.05,
    "side_conductance": 0.01, "ambient_rate": 0.02, "ambient_wave": 2.0, "draught": 0.5,
    "grain_spread": 4.0, "kinetics_smoothness": 1.0, "return_point_memory": 1.0,
    "transition_drift": 8.0, "plastic_strain": 0.004, "r_phase": 0.3, "transformation_lag": 1.0,
    "stress_influence_factor_austenite": 1.5, "stress_influence_factor_martensite": 1.5,
    "unrecovered_strain": 0.2, "matrix_relaxation": 0.3, "opposing": 0.5,
    "stiffness_asymmetry": 0.4, "slack": 0.005, "friction": 0.002, "stiffening": 500.0,
    "clamp_slip": 0.003,
}  # fmt: skip
SETTINGS = {"clamp_slip_time": 10.0, "drift_cycles": 1.0}


@cache
def outcome(name: str = "", size: float = 0.0, shape: str = "nested") -> Outcome:
    features = {**SETTINGS, name: size} if name else {}
    return happen(World(COMPOSITE, features), *drive(shape), 0.5)


def gap(one: Outcome, other: Outcome) -> float:
    """Largest difference: in noise of believable instruments (0.1 mm, 5 mA, 0.2 K)."""
    return max(
        float(np.max(np.abs(one.deflection - other.deflection))) / 1e-4,
        float(np.max(np.abs(one.current - other.current))) / 5e-3,
        float(np.max(np.abs(one.temperature - other.temperature))) / 0.2,
    )


def at(time: float) -> int:
    return round(time / 0.02)


@pytest.mark.parametrize("name", [f.name for f in ACTING])
def test_feature_shows(name: str) -> None:
    assert gap(outcome(name, SIZES[name]), outcome()) > 2.0


@needs_numba
@pytest.mark.parametrize("name", [f.name for f in ACTING if f.name != "current_limit"])
def test_feature_vanishes_as_it_is_turned_off(name: str) -> None:
    off, size = BY_NAME[name].off, SIZES[name]
    little = gap(outcome(name, off + 1e-3 * (size - off)), outcome())
    assert 0.0 < little < 0.01 * gap(outcome(name, size), outcome())


def test_current_limit_vanishes_as_it_rises() -> None:
    highest = outcome().current.max()
    gaps = [gap(outcome("current_limit", share * highest), outcome()) for share in (0.9, 0.99, 1)]
    assert gaps[0] > 5.0 * gaps[1] > 0.0
    assert gaps[2] < 1e-9


@pytest.mark.parametrize("name", [f.name for f in FEATURES if f.stage == "sensor"])
def test_sensor_feature_does_nothing_to_the_bench(name: str) -> None:
    feature = BY_NAME[name]
    size = feature.high if feature.high != feature.off else feature.low
    assert gap(outcome(name, size), outcome()) == 0.0


# --- what each one does -------------------------------------------------------------------------


def resistance_by_phase(o: Outcome, base: Outcome) -> None:
    expected = 3.05138 * (1.0 - 0.2 * (1.0 - o.martensite_fraction))
    np.testing.assert_allclose(o.current * expected, o.voltage, rtol=1e-9)


def resistance_by_temperature(o: Outcome, base: Outcome) -> None:
    expected = 3.05138 * (1.0 + 1e-3 * (o.temperature - 293.4596))
    np.testing.assert_allclose(o.current * expected, o.voltage, rtol=1e-9)


def voltage_drops_in_the_leads(o: Outcome, base: Outcome) -> None:
    np.testing.assert_allclose(o.current, o.voltage / 3.35138, rtol=1e-12)
    np.testing.assert_array_equal(o.voltage, base.voltage)
    ratio = (o.temperature[at(8)] - 293.4596) / (base.temperature[at(8)] - 293.4596)
    np.testing.assert_allclose(ratio[FRONT], (3.05138 / 3.35138) ** 2, rtol=1e-6)


def current_stays_below_its_limit(o: Outcome, base: Outcome) -> None:
    assert o.current.max() == 0.6 < base.current.max()


def contact_ages_while_driven(o: Outcome, base: Outcome) -> None:
    added = o.voltage[at(7)] / np.where(o.current[at(7)], o.current[at(7)], 1.0) - 3.05138
    assert added[FRONT] == pytest.approx(6.0 * 0.5 / 60.0, rel=0.01)
    assert np.all(o.current[:, BACK][: at(20)] == 0.0)


def latent_heat_slows_transformation(o: Outcome, base: Outcome) -> None:
    assert np.all(o.temperature[at(8), FRONT] < base.temperature[at(8), FRONT] - 5.0)
    before_it_starts = at(4.0)
    assert np.all(base.temperature[before_it_starts] < 334.0)
    assert o.temperature[before_it_starts] == pytest.approx(base.temperature[before_it_starts])


def film_is_weaker_at_small_excess(o: Outcome, base: Outcome) -> None:
    assert np.all(o.temperature[at(3), FRONT] > base.temperature[at(3), FRONT] + 0.1)
    assert np.all(o.temperature[at(10), FRONT] < base.temperature[at(10), FRONT] - 0.5)


def silicone_is_slow(o: Outcome, base: Outcome) -> None:
    assert np.all(o.temperature[at(6), FRONT] < base.temperature[at(6), FRONT] - 5.0)
    assert np.all(o.temperature[at(39), FRONT] > base.temperature[at(39), FRONT] + 1.0)


def heat_crosses_the_matrix(o: Outcome, base: Outcome) -> None:
    assert np.all(o.temperature[at(9), BACK] > 300.0)
    assert base.temperature[at(9), BACK] == pytest.approx(293.4596)
    assert np.all(o.temperature[at(9), FRONT] < base.temperature[at(9), FRONT])


def room_warms(o: Outcome, base: Outcome) -> None:
    assert o.ambient[at(30)] == pytest.approx(293.4596 + 0.6)
    assert np.all(o.temperature[at(19), BACK] > 293.4596 + 0.3)


def room_waves(o: Outcome, base: Outcome) -> None:
    assert o.ambient[at(15)] == pytest.approx(293.4596 + 2.0 * np.sin(np.pi / 6.0))


def gusts_only_cool(o: Outcome, base: Outcome) -> None:
    assert np.all(o.temperature <= base.temperature + 1e-9)
    other = happen(
        World(COMPOSITE, {"draught": 0.5, "draught_seed": 1.0}), *drive("nested"), 0.5
    )
    assert gap(o, other) > 2.0


def grains_start_early_and_finish_late(o: Outcome, base: Outcome) -> None:
    just_below_start = np.argmax(base.temperature[:, 0] > 333.0)
    assert base.martensite_fraction[just_below_start, 0] == 1.0
    assert 0.8 < o.martensite_fraction[just_below_start, 0] < 0.999
    assert o.martensite_fraction.min() > base.martensite_fraction.min()


def ramps_have_tails(o: Outcome, base: Outcome) -> None:
    just_below_start = np.argmax(base.temperature[:, 0] > 333.0)
    assert 0.98 < o.martensite_fraction[just_below_start, 0] < 0.999


def inner_loop_is_remembered(o: Outcome, base: Outcome) -> None:
    # Cooled again as far as before, the wire transforms no further than before.
    before, again = at(16), at(23)
    assert o.martensite_fraction[again, 0] == pytest.approx(o.martensite_fraction[before, 0])
    assert base.martensite_fraction[again, 0] > base.martensite_fraction[before, 0] + 0.02
    first = slice(0, at(13))
    assert o.deflection[first] == pytest.approx(base.deflection[first], abs=1e-9)


def transition_shifts_with_cycles(o: Outcome, base: Outcome) -> None:
    first_start = slice(0, at(5))
    assert o.deflection[first_start] == pytest.approx(base.deflection[first_start], abs=1e-5)
    # Higher temperatures are needed later, so less is transformed.
    hot = at(28.5)
    assert np.all(o.martensite_fraction[hot, FRONT] > base.martensite_fraction[hot, FRONT])


def wires_grow_longer(o: Outcome, base: Outcome) -> None:
    assert o.side_deflection[at(19), 0] < base.side_deflection[at(19), 0] - 1e-4
    assert o.stress[-1, 0] < -1e6


def loaded_wires_transform_later_on_heating(o: Outcome, base: Outcome) -> None:
    assert o.martensite_fraction[at(8), 0] > base.martensite_fraction[at(8), 0] + 0.02


def loaded_wires_transform_earlier_on_cooling(o: Outcome, base: Outcome) -> None:
    assert o.martensite_fraction[at(14), 0] > base.martensite_fraction[at(14), 0] + 0.02
    assert o.martensite_fraction[at(8), 0] == pytest.approx(base.martensite_fraction[at(8), 0])


def part_of_the_strain_comes_earlier(o: Outcome, base: Outcome) -> None:
    just_at_start = np.argmax(base.temperature[:, 0] > 334.0)
    assert base.deflection[just_at_start] < 1e-4
    assert o.deflection[just_at_start] > 3e-3


def phase_follows_late(o: Outcome, base: Outcome) -> None:
    rising = slice(at(1), at(7.5))
    assert np.all(o.martensite_fraction[rising] >= base.martensite_fraction[rising] - 1e-9)
    assert o.martensite_fraction[at(7.5), 0] > base.martensite_fraction[at(7.5), 0] + 0.1


def contraction_stays_after_a_loop(o: Outcome, base: Outcome) -> None:
    loops = happen(World(COMPOSITE, {"unrecovered_strain": 0.2}), *drive("triangles", 26.0), 0.5)
    assert loops.side_deflection[-1, 0] > 1e-3
    assert base.side_deflection[at(6), 0] == pytest.approx(o.side_deflection[at(6), 0], abs=1e-6)


def rest_position_creeps_back(o: Outcome, base: Outcome) -> None:
    steps = happen(
        World(COMPOSITE, {"matrix_relaxation": 0.3, "relaxation_time": 10.0}),
        *drive("steps", 24.0), 0.5,
    )  # fmt: skip
    after = steps.side_deflection[[at(16), at(23)], 0]
    assert after[0] > 1.5 * after[1] > 1e-4


def other_side_resists(o: Outcome, base: Outcome) -> None:
    assert np.all(o.stress[at(8), BACK] > 2e7)
    assert base.stress[at(8), BACK] == pytest.approx(0.0, abs=1.0)
    assert o.deflection[at(8)] < 0.9 * base.deflection[at(8)]


def front_is_stiffer_than_back(o: Outcome, base: Outcome) -> None:
    assert o.deflection[at(8)] < base.deflection[at(8)] - 2e-4
    later = at(34)
    assert -o.side_deflection[later, 1] < -base.side_deflection[later, 1] - 2e-4


def slack_is_taken_up_first(o: Outcome, base: Outcome) -> None:
    lost = np.max(base.deflection - o.deflection)
    assert 0.5 * 0.005 < lost < 2.0 * 0.005
    starts = [int(np.argmax(each.deflection > 1e-4)) for each in (o, base)]
    assert starts[0] > starts[1] + 5


def tip_stays_behind(o: Outcome, base: Outcome) -> None:
    assert np.max(np.abs(o.deflection - base.deflection)) == pytest.approx(0.002)
    assert np.array_equal(o.side_deflection, base.side_deflection)


def large_bending_is_harder(o: Outcome, base: Outcome) -> None:
    small, large = at(5), at(8)
    assert o.deflection[small] == pytest.approx(base.deflection[small], rel=0.02)
    assert o.deflection[large] < 0.97 * base.deflection[large]


def clamp_slips_once(o: Outcome, base: Outcome) -> None:
    moved = o.deflection - base.deflection
    assert np.all(moved[: at(9.9)] == 0.0)
    assert moved[at(10.1) :] == pytest.approx(0.003)


DOES: dict[str, Callable[[Outcome, Outcome], None]] = {
    "resistance_austenite_change": resistance_by_phase,
    "resistance_temperature_coefficient": resistance_by_temperature,
    "supply_resistance": voltage_drops_in_the_leads,
    "current_limit": current_stays_below_its_limit,
    "contact_growth": contact_ages_while_driven,
    "latent_heat": latent_heat_slows_transformation,
    "convection_by_correlation": film_is_weaker_at_small_excess,
    "silicone_heat_capacity": silicone_is_slow,
    "side_conductance": heat_crosses_the_matrix,
    "ambient_rate": room_warms,
    "ambient_wave": room_waves,
    "draught": gusts_only_cool,
    "grain_spread": grains_start_early_and_finish_late,
    "kinetics_smoothness": ramps_have_tails,
    "return_point_memory": inner_loop_is_remembered,
    "transition_drift": transition_shifts_with_cycles,
    "plastic_strain": wires_grow_longer,
    "stress_influence_factor_austenite": loaded_wires_transform_later_on_heating,
    "stress_influence_factor_martensite": loaded_wires_transform_earlier_on_cooling,
    "r_phase": part_of_the_strain_comes_earlier,
    "transformation_lag": phase_follows_late,
    "unrecovered_strain": contraction_stays_after_a_loop,
    "matrix_relaxation": rest_position_creeps_back,
    "opposing": other_side_resists,
    "stiffness_asymmetry": front_is_stiffer_than_back,
    "slack": slack_is_taken_up_first,
    "friction": tip_stays_behind,
    "stiffening": large_bending_is_harder,
    "clamp_slip": clamp_slips_once,
}


@pytest.mark.parametrize("name", [f.name for f in ACTING])
def test_feature_does_what_it_says(name: str) -> None:
    DOES[name](outcome(name, SIZES[name]), outcome())
