"""Deflection control in closed loop: the paper's triangle, front and back by turns."""

import numpy as np
import pytest
from closed_loops import identified, off_by_deviations, rmse, run_deflection

from sma_bench.control.deflection import DeflectionController, deflection_reference_fault
from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters
from sma_bench.physics import simulate
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection
from sma_bench.synthetic.bench_records import Feedback, run_loop

COMPOSITE = identified(
    {
        "bench.channels": ["front_1", "front_2", "back_1", "back_2"],
        "bench.channel_sides": ["front", "front", "back", "back"],
    }
)
UNCERTAIN = [
    p.name for p in TABLE
    if p.uncertainty and p.default and p.name.startswith(("wire.", "environment.", "composite."))
    and "_per_" not in p.name
]
FRONT = np.array([True, True, False, False])
PEAK, RISE, REST = 0.03, 5.0, 5.0  # m, s
CYCLE = 2.0 * (2.0 * RISE + REST)
PERIOD, READING = 0.05, {"noise": 7e-5, "resolution": 5e-5}


def triangle(t, peak=PEAK):
    """Front, rest, back, rest, as in Fig. 15 a."""
    edges = np.cumsum([0.0, RISE, RISE, REST, RISE, RISE, REST])
    return float(np.interp(t % CYCLE, edges, np.array([0, 1, 0, 0, -1, 0, 0]) * peak))


def controlled(bench, feedback=True, late=0):
    controller = DeflectionController(
        COMPOSITE, PERIOD, delay=PERIOD * late + 0.005, feedback=feedback
    )
    return run_deflection(bench, controller, triangle, CYCLE, Feedback(PERIOD, late, **READING))


def open_loop(bench):
    """The paper's own: a triangular voltage whose peak leads to the wanted peak."""
    peak = OperatingPoint.at_deflection(COMPOSITE, PEAK, "heating").voltage.max()
    clock = iter(np.arange(round(CYCLE / PERIOD)) * PERIOD)

    def voltage(*_):
        level = triangle(next(clock), peak)
        return np.where(FRONT, max(level, 0.0), max(-level, 0.0))

    return run_loop(
        bench, lambda plant: np.array(plant.deflection), lambda t: np.array(triangle(t)), voltage,
        CYCLE, Feedback(PERIOD),
    )


def error(run):
    return rmse(run.reference, run.actual)


def test_triangle_is_tracked_better_than_open_loop_with_parameters_known_and_late_commands():
    closed, voltage_only = error(controlled(COMPOSITE)), error(open_loop(COMPOSITE))
    assert closed < 0.06e-3
    assert closed < 0.01 * voltage_only
    assert error(controlled(COMPOSITE, late=1)) < 0.5 * error(
        controlled(COMPOSITE, feedback=False, late=1)
    )


@pytest.mark.parametrize("seed", range(2))
def test_triangle_is_tracked_better_than_open_loop_with_parameters_off(seed):
    bench = off_by_deviations(COMPOSITE, UNCERTAIN, seed)
    closed = error(controlled(bench))
    assert closed < 0.5e-3
    assert closed < 0.2 * error(controlled(bench, feedback=False))
    assert closed < 0.05 * error(open_loop(bench))


def test_weaker_side_is_tracked_as_well_and_a_lasting_offset_integrated_away():
    weak = {"composite.stress_per_deflection_back": 3.5e9}
    closed = error(controlled(COMPOSITE.replace(weak)))
    assert closed < 0.2e-3
    assert closed < 0.1 * error(controlled(COMPOSITE.replace(weak), feedback=False))
    bench = COMPOSITE.replace({"wire.austenite_start_temperature": 334.0})
    controller = DeflectionController(COMPOSITE, PERIOD)
    run = run_deflection(bench, controller, lambda _: -0.02, 6.0, Feedback(PERIOD))
    np.testing.assert_allclose(run.actual[run.time > 4.0], -0.02, atol=0.02e-3)


def test_feedforward_inverts_partial_loops():
    """Reversals within reversals: without the branch of the moment this is off by millimetres."""
    def wave(t):
        return 0.02 + 0.008 * np.sin(t) + 0.008 * np.sin(2.7 * t)

    controller = DeflectionController(COMPOSITE, 0.02, feedback=False)
    run = run_deflection(COMPOSITE, controller, wave, 20.0, Feedback(0.02))
    settled = run.time > 1.0
    assert rmse(run.reference[settled], run.actual[settled]) < 0.02e-3
    held = OperatingPoint.at_deflection(COMPOSITE, 0.02, "heating")
    cooled = OperatingPoint.at_deflection(COMPOSITE, 0.02, "cooling")
    assert held.temperature[0] - cooled.temperature[0] > 3.0


def test_only_the_side_of_the_reference_is_heated():
    run = controlled(COMPOSITE)
    ahead = np.array([triangle(t + PERIOD) for t in run.time])
    assert np.all(run.voltage >= 0.0)
    assert np.all(run.voltage[ahead <= 0.0][:, FRONT] == 0.0)
    assert np.all(run.voltage[ahead >= 0.0][:, ~FRONT] == 0.0)
    assert run.voltage.max() <= 0.9 * 3.0 * COMPOSITE["wire.resistance"] * (1.0 + 1e-9)


def test_unreachable_deflection_neither_winds_up_nor_burns():
    largest = maximum_deflection(COMPOSITE)

    def reference(t):
        return 2.0 * largest if t < 5.0 else 0.02

    run = run_deflection(COMPOSITE, DeflectionController(COMPOSITE, PERIOD), reference, 8.0,
                         Feedback(PERIOD))
    hottest = simulate(COMPOSITE, run.time, run.voltage).temperature.max()
    assert hottest < COMPOSITE["bench.maximum_temperature"] - 9.0
    assert run.actual[np.searchsorted(run.time, 4.0)] > 0.95 * largest
    assert abs(run.actual[np.searchsorted(run.time, 6.0)] - 0.02) < 0.1e-3


def test_dead_sensor_cannot_burn_the_wires_and_without_one_the_feedforward_goes_on():
    """It reads 0 whatever the wires do; the model's temperature limits the power."""
    controller = DeflectionController(COMPOSITE, PERIOD)
    volts = np.array([controller.step(0.02, 0.0, PERIOD) for _ in range(200)])
    run = simulate(COMPOSITE, np.arange(200) * PERIOD, volts)
    assert run.temperature.max() < COMPOSITE["bench.maximum_temperature"] - 9.0
    blind, open_ = (DeflectionController(COMPOSITE, PERIOD, feedback=f) for f in (True, False))
    for k in range(20):
        wanted = 0.001 * k
        np.testing.assert_array_equal(
            blind.step(wanted, np.nan, PERIOD), open_.step(wanted, 0.0, PERIOD)
        )


def test_bad_number_is_quoted():
    for build, quoted in (
        (lambda: DeflectionController(Parameters.of_paper(), 0.05), "clamped"),
        (lambda: DeflectionController(COMPOSITE, -1.0), "period is -1.0 s"),
        (lambda: DeflectionController(COMPOSITE, 0.05).step(np.nan, 0.0, 0.05), "nan m"),
    ):
        with pytest.raises(InputError, match=quoted):
            build()


PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
LOADS = {
    "force": {"load.kind": "force", "load.force": 8.0, "bench.drive": "duty"},
    "spring": {"load.kind": "spring", "load.stiffness": 800.0, "load.preload": 5.0,
               "bench.lead_resistance": 0.3},
    "antagonist": {**PAIR, "load.kind": "antagonist", "load.stiffness": 200.0,
                   "load.preload": 6.0, "bench.drive": "current"},
}  # fmt: skip


@pytest.mark.parametrize("load", LOADS)
def test_wires_with_a_load_follow_a_wave_of_their_position(load):
    rig = Parameters.of_paper().replace(LOADS[load])
    largest = maximum_deflection(rig)
    part = np.array([0.0, 1.0, 0.4, 0.9, 0.0, -1.0 if load == "antagonist" else 0.8, 0.0])
    sign = 1.0 if load == "antagonist" else -1.0

    def wave(t):
        return sign * 0.5 * largest * float(np.interp(t, np.arange(7.0) * 5.0, part))

    names = [n for n in UNCERTAIN if n.startswith("wire.") and n != "wire.mass"]
    off = off_by_deviations(rig, names, 3, 0.5)
    exact, wrong, blind = (
        run_deflection(bench, DeflectionController(rig, PERIOD, feedback=feedback), wave, 30.0,
                       Feedback(PERIOD, noise=2e-5))
        for bench, feedback in ((rig, True), (off, True), (off, False))
    )
    assert error(exact) < 0.01 * largest
    assert error(wrong) < 0.04 * largest and error(wrong) < 0.7 * error(blind)
    assert np.all(exact.voltage >= 0.0)


def test_a_bench_with_its_effects_is_followed():
    found = {"effect.latent_heat.heat": 6e3, "wire.transition_spread": 1.0}
    rig = Parameters.of_paper().replace({**LOADS["spring"], **found})

    def wave(t):
        return -3e-3 * (1.0 - np.cos(0.8 * t)) / 2.0

    run = run_deflection(rig, DeflectionController(rig, PERIOD), wave, 12.0, Feedback(PERIOD))
    assert error(run) < 0.05e-3


SIDES = Parameters.of_paper().replace(PAIR)
FRONT_ONLY = SIDES.replace({"bench.channel_sides": ["front", "front"]})
SPRING = Parameters.of_paper().replace(LOADS["spring"])


def test_a_deflection_out_of_reach_is_refused():
    for metres, parameters, expected in (
        (0.02, SIDES, ""), (-0.02, SIDES, ""), (0.0, FRONT_ONLY, ""), (np.inf, SIDES, "is inf m"),
        (0.08, SIDES, "to the front"), (-0.08, SIDES, "to the back"),
        (-0.01, FRONT_ONLY, "no wire on the back"), (-1e-3, SPRING, ""),
        (1e-3, SPRING, "a wire with a load only shortens"), (-0.05, SPRING, "expected at most"),
    ):
        fault = deflection_reference_fault([metres], parameters)
        assert expected in fault and bool(expected) == bool(fault)
