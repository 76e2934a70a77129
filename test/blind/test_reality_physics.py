"""Pieces of the reality against what is known of them: field, film, energy, grains, loops."""

import numpy as np
import pytest
from reality_rig import COMPOSITE, drive, needs_numba
from scipy.linalg import expm

from examination.blind.reality import World, happen
from examination.blind.reality.heat import (
    BACK_WIRE,
    FRONT_WIRE,
    NODES,
    free_convection,
    radiation,
    strip_of,
    warm,
)
from examination.blind.reality.transformation import (
    grain_classes,
    grains_at_rest,
    ramp,
    ramp_table,
    transform,
    turn,
)

LOSS = 115.772 * 0.0001885  # W/K


def test_film_of_a_steam_pipe_is_as_worked_out_by_hand() -> None:
    # Pipe of 0.1 m at 165 in air of 23 degC: at 367 K tables of air give k = 0.0313 W/(m K),
    # nu = 22.8e-6 and alpha = 32.8e-6 m2/s, so Ra = 5.07e6, Nu = 23.1, h = 7.23 W/(m2 K).
    assert free_convection(np.array([142.0]), 296.15, 0.1) == pytest.approx(7.23, rel=0.01)
    black = radiation(np.array([142.0]), 296.15) / 0.9
    assert black == pytest.approx(5.670374e-8 * (438.15**4 - 296.15**4) / 142.0)


@needs_numba
@pytest.mark.parametrize("features", [
    {},
    {"silicone_heat_capacity": 0.1, "side_conductance": 0.02},
    {"silicone_heat_capacity": 0.5, "silicone_share": 0.8},
    {"side_conductance": 0.05},
    {"latent_heat": 15e3},
    {"latent_heat": 15e3, "transformation_lag": 0.5, "silicone_heat_capacity": 0.05},
    {"resistance_austenite_change": -0.2, "supply_resistance": 0.3},
])  # fmt: skip
def test_all_heat_leaves_by_the_film(features: dict[str, float]) -> None:
    time, voltage = drive("triangles", 40.0)
    time = np.concatenate([time, np.arange(40.0, 400.0, 0.1)])
    voltage = np.concatenate([voltage, np.zeros((len(time) - len(voltage), 4))])
    outcome = happen(World(COMPOSITE, features), time, voltage)
    step = np.diff(time)[:, np.newaxis]
    supplied = np.sum((outcome.voltage * outcome.current)[:-1] * step)
    leads = np.sum(outcome.current[:-1] ** 2 * step) * features.get("supply_resistance", 0.0)
    excess = outcome.surface - outcome.ambient[:, np.newaxis]
    lost = np.sum(0.5 * (excess[:-1] + excess[1:]) * step)
    film = LOSS / (1.0 - features.get("silicone_share", 0.5))
    # The resistance is a sample old in `current`, hence no more than 0.1 %.
    tolerance = 1e-3 if "supply_resistance" in features else 2e-4
    assert film * lost == pytest.approx(supplied - leads, rel=tolerance)
    assert outcome.temperature[-1] == pytest.approx(293.4596, abs=0.05)


def test_field_follows_the_exponential_of_its_matrix() -> None:
    world = World(COMPOSITE, {"silicone_heat_capacity": 0.1, "side_conductance": 0.02})
    parts = strip_of(world)
    conduction = np.zeros((NODES, NODES))
    for j, link in enumerate(parts.link):
        conduction[j : j + 2, j : j + 2] += link * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for end in (0, NODES - 1):
        conduction[end, end] += 1.0 / (1.0 / parts.rim + 1.0 / parts.film)
    power = np.zeros(NODES)
    power[FRONT_WIRE], power[BACK_WIRE] = 1.5, 0.4
    steady = np.linalg.solve(conduction, power)
    rate = -conduction / parts.capacity[:, np.newaxis]
    expected = 293.0 + steady - expm(2.0 * rate) @ steady
    errors = []
    for steps in (50, 100, 200):
        field, scratch = np.full((1, NODES), 293.0), np.zeros((5, NODES))
        sources = np.array([[1.5, 0.4], [0.0, 0.0]])
        for _ in range(steps):
            warm(parts, field, 0, sources, 293.0, 1.0, 2.0 / steps, scratch)
        errors.append(np.max(np.abs(field[0] - expected)))
    assert errors[0] / errors[1] > 3.5
    assert errors[1] / errors[2] > 3.5
    assert errors[2] < 2e-3


@needs_numba
def test_field_settles_where_its_resistances_say() -> None:
    conductance = 0.01
    world = World(COMPOSITE, {"side_conductance": conductance, "silicone_heat_capacity": 0.02})
    voltage = np.zeros((6000, 4))
    voltage[:, :2] = 1.0
    outcome = happen(world, np.arange(6000) * 0.02, voltage)
    front, back = outcome.temperature[-1, 0] - 293.4596, outcome.temperature[-1, 2] - 293.4596
    assert back / front == pytest.approx(conductance / (conductance + LOSS), rel=1e-4)
    assert LOSS * (front + back) == pytest.approx(1.0 / 3.05138, rel=1e-4)
    surface = outcome.surface[-1, 0] - 293.4596
    assert surface == pytest.approx(0.5 * front, rel=1e-4)


@pytest.mark.parametrize("smoothness", [0.0, 0.4, 1.0])
def test_ramps_keep_their_mean_and_width(smoothness: float) -> None:
    table = ramp_table(smoothness)
    position = np.linspace(-0.99, 1.99, 3001)
    value, slope = np.array([ramp(table, x) for x in position]).T
    assert np.all(np.diff(value) >= -1e-15)
    weight = slope / np.sum(slope)
    mean = np.sum(weight * position)
    assert mean == pytest.approx(0.5, abs=1e-6)
    deviation = np.sqrt(np.sum(weight * (position - mean) ** 2))
    assert deviation == pytest.approx(np.sqrt(0.25 - 2.0 / np.pi**2), rel=1e-3)
    if smoothness == 0.0:
        exact = np.sin(0.5 * np.pi * np.clip(position, 0.0, 1.0)) ** 2
        assert np.max(np.abs(value - exact)) < 1e-11


def test_grains_have_the_mean_and_spread_that_were_asked_for() -> None:
    classes = grain_classes(World(COMPOSITE, {"grain_spread": 3.0}))
    finish, weight = classes.austenite_finish, classes.weight
    mean = np.sum(weight * finish)
    assert np.sum(weight) == pytest.approx(1.0)
    assert mean == pytest.approx(353.2866)
    assert np.sqrt(np.sum(weight * (finish - mean) ** 2)) == pytest.approx(3.0)


def walk(memory: float, temperatures: list[float], features: dict[str, float]) -> list[float]:
    """Martensite fraction of a wire free of stress after each of the temperatures [K]."""
    classes = grain_classes(World(COMPOSITE, features))
    table, grains = ramp_table(0.0), grains_at_rest(1, len(classes.weight))
    now, seen = 290.0, []
    for goal in temperatures:
        for kelvin in np.linspace(now, goal, 200)[1:]:
            if (kelvin > now) != grains.rising[0]:
                turn(classes, table, memory, grains, 0, now, 0.0)
            xi, _ = transform(classes, table, memory, grains, 0, kelvin, 0.0)
            now = kelvin
        seen.append(xi)
    return seen


@pytest.mark.parametrize("features", [{}, {"grain_spread": 3.0}])
def test_loops_close_with_memory_and_not_without(features: dict[str, float]) -> None:
    loop = [345.0, 312.0, 341.0, 315.0, 341.0, 312.0, 345.0]
    first, _, inner, _, inner_again, _, last = walk(1.0, loop, features)
    assert inner_again == pytest.approx(inner, abs=1e-9)
    assert last == pytest.approx(first, abs=1e-9)
    open_first, *_, open_last = walk(0.0, loop, features)
    assert open_first == pytest.approx(first, abs=1e-9)
    assert abs(open_last - open_first) > 0.02


def test_memory_forgets_what_a_larger_loop_has_passed() -> None:
    straight = walk(1.0, [370.0], {})
    wiggled = walk(1.0, [345.0, 314.0, 340.0, 312.0, 350.0, 318.0, 370.0, 300.0], {})
    assert wiggled[-2] == pytest.approx(straight[-1], abs=1e-12)
    assert wiggled[-1] == 1.0


def test_without_memory_a_partial_loop_is_the_contract_s_proportion() -> None:
    def f(kelvin: float) -> float:
        return 0.5 * (1.0 + np.cos(np.pi * (kelvin - 334.001) / (353.2866 - 334.001)))

    def g(kelvin: float) -> float:
        return 0.5 * (1.0 - np.cos(np.pi * (kelvin - 307.5032) / (319.834 - 307.5032)))

    heated, cooled, reheated = walk(0.0, [345.0, 313.0, 341.0], {})
    assert heated == pytest.approx(f(345.0), abs=1e-10)
    assert 1.0 - cooled == pytest.approx((1.0 - heated) * g(313.0), abs=1e-10)
    assert reheated == pytest.approx(cooled * f(341.0), abs=1e-10)
