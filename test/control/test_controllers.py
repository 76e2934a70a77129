"""Controllers in closed loop: PI, the staircase of E8, the triangle of the paper; limits, wires
without a reading, bad references."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted import LOADS

from sma_bench.control import PI, DeflectionController, Gains, TemperatureController
from sma_bench.control import OutputLimits as Limits
from sma_bench.errors import InputError
from sma_bench.hardware.safety import Guard
from sma_bench.live.run import ClosedLoop, Run
from sma_bench.parameters import TABLE, Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics import Bench, simulate
from sma_bench.physics.linearised import OperatingPoint, maximum_deflection
from sma_bench.physics.material import direct_reading
from sma_bench.protocols import DEFLECTION, TEMPERATURE

# Standard errors after a lab's own identification; the others are those of Table I and of the
# sensors' data sheets.
AFTER_IDENTIFICATION = {"wire.resistance": 0.03, "wire.heat_transfer_coefficient": 8.0,
                        "wire.specific_heat": 10.0, "environment.ambient_temperature": 0.5}
NUMBERS = st.floats(-1e3, 1e3)
PAPER = Parameters.of_paper()
WIRE = PAPER.replace({}, AFTER_IDENTIFICATION)
PERIOD = 0.05
KELVIN = {"noise": 0.08, "resolution": 0.1}


def off_by_deviations(parameters, names, seed, deviations=1.0):
    """A bench whose parameters deviate from the identified ones by their standard errors."""
    draws = deviations * np.random.default_rng(seed).standard_normal(len(names))
    return parameters.replace({n: parameters[n] + z * parameters.std(n)
                               for n, z in zip(names, draws, strict=True)})


def run_loop(parameters, observe, reference, control, duration, period=PERIOD, late=0, noise=0.0,
             resolution=0.0, seed=1):
    """Run a controller on a simulated bench, whose `parameters` it may not know: time, reference,
    actual, measured and voltage as arrays.

    `observe`: the controlled quantity of a bench; `reference`: at a time in s; `control`: voltages
    (w,) for the reference, a reading, and the reference a `period` [s] later; `late`: periods from
    a reading to its command; `noise`, `resolution`: of a reading, in its unit, 0 for none."""
    plant, random = Bench(parameters), np.random.default_rng(seed)
    waiting = [np.zeros(len(parameters["bench.channels"]))] * late
    time, rows = period * np.arange(round(duration / period)), []
    for t in time.tolist():
        actual = observe(plant)
        read = actual + noise * random.standard_normal(actual.shape)
        if resolution > 0.0:
            read = np.round(read / resolution) * resolution
        waiting.append(control(reference(t), read, reference(t + period)))
        rows.append((np.asarray(reference(t)), actual, read, waiting.pop(0)))
        plant.advance(rows[-1][-1], period)
    columns = (np.array(column) for column in zip(*rows, strict=True))
    names = ("reference", "actual", "measured", "voltage")
    return SimpleNamespace(time=time, **dict(zip(names, columns, strict=True)))


def run(bench, controller, reference, duration, period=PERIOD, feedback=True, **reading):
    """Run a controller on a bench; reference: K, or m, at a time in s."""
    tip = isinstance(controller, DeflectionController)

    def step(wanted, read, ahead):
        if tip:
            return controller.step(ahead, float(read) if feedback else np.nan)
        return controller.step(wanted, read)

    return run_loop(bench, lambda plant: np.array(plant.deflection if tip else plant.temperature),
                    reference if tip else lambda t: np.array([reference(t)]), step, duration,
                    period, **reading)


def lag_response(loop, reference, seconds):
    """Outputs of a first-order lag of gain 6 and 0.2 s under the loop, every 0.01 s."""
    y, values, decay = 0.0, [], math.exp(-0.01 / 0.2)
    for _ in range(round(seconds / 0.01)):
        values.append(y)
        u = loop.step(reference, y, 0.01)
        y = 6.0 * u + (y - 6.0 * u) * decay
    return np.array(values)


def test_simc_answers_like_the_wanted_lag_and_leaves_saturation_at_once():
    gains = Gains.simc(gain=6.0, time_constant=0.2, delay=0.005, closed_loop_time=0.1)
    assert gains == (pytest.approx(0.2 / (6.0 * 0.105)), 0.2)
    y = lag_response(PI(gains, Limits(100.0)), 10.0, 2.0)
    assert y.max() < 10.1
    assert y[round(0.105 / 0.01)] == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=0.05)
    assert Gains.simc(1.0, 10.0, 0.1, 0.4).integral_time == pytest.approx(2.0)
    loop = PI(Gains.simc(6.0, 0.2, 0.005), Limits(3.0))
    assert lag_response(loop, 15.0, 3.0).max() < 15.0 * 1.02


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=30), st.floats(0.1, 50.0))
def test_output_never_leaves_its_range_nor_exceeds_its_rate(steps, rate):
    loop, last = PI(Gains(2.0, 0.3), Limits(10.0, rate)), 0.0
    for reference, measured in steps:
        output = loop.step(reference, measured, 0.05)
        assert 0.0 <= output <= 10.0
        assert abs(output - last) <= rate * 0.05 * (1.0 + 1e-9)
        last = output


SLOW_WIRE = WIRE.replace({"wire.heat_transfer_coefficient": 70.0})  # still air: tau 1.1 s
THERMAL = [p.name for p in TABLE if p.uncertainty and p.default
           and p.name.startswith(("wire.", "env"))
           and ("temperature" not in p.name or "ambient" in p.name)]
LEVELS = [303.15, 308.15, 313.15, 318.15, 323.15, 328.15]  # K, below A_s


@pytest.mark.parametrize(("wire", "dwell", "settling", "seed"), [
    (WIRE, 6.0, 0.5, 1), (SLOW_WIRE, 15.0, 3.0, 3),
], ids=["off and late", "still air, off and late"])  # fmt: skip
def test_staircase_below_a_s_is_tracked(wire, dwell, settling, seed):
    controller = TemperatureController(wire, PERIOD, delay=PERIOD + 0.0125)
    found = run(off_by_deviations(wire, THERMAL, seed), controller,
                lambda t: LEVELS[min(int(t / dwell + 1e-9), len(LEVELS) - 1)], dwell * len(LEVELS),
                late=1, seed=seed, **KELVIN)  # fmt: skip
    times, kelvins = (a.reshape(len(LEVELS), -1) for a in (found.time, found.actual))
    for time, kelvin, level in zip(times, kelvins, LEVELS, strict=True):
        off = kelvin - level
        assert abs(np.mean(off[-(len(off) // 4) :])) < 0.06  # the last quarter
        assert off.max() < 0.6  # K, noise included
        outside = np.flatnonzero(np.abs(off) > 0.5)
        assert time[outside[-1] + 1] - time[0] < settling
    assert found.actual.max() < WIRE["wire.austenite_start_temperature"] - 3.0


def test_unreachable_reference_does_not_wind_up():
    controller = TemperatureController(WIRE, PERIOD, maximum_power=4.0)  # enough for 321 K
    found = run(WIRE, controller, lambda t: 340.0 if t < 10.0 else 310.0, 12.0)
    assert found.actual[round(9.9 / PERIOD), 0] < 322.0
    np.testing.assert_allclose(found.actual[found.time > 11.0, 0], 310.0, atol=0.1)


def test_start_is_bumpless_and_volts_stay_within_the_supplys_limits():
    controller = TemperatureController(WIRE, PERIOD)
    heat = controller.step([320.0], [320.0])[0] ** 2 / WIRE["wire.resistance"]
    assert heat == pytest.approx(float(controller.heating.holding_power(320.0)))
    volts = TemperatureController(WIRE, PERIOD).step([410.0], [296.15])
    assert volts[0] == pytest.approx(0.9 * 3.0 * WIRE["wire.resistance"])
    strong = WIRE.replace({"bench.maximum_current": 20.0})
    assert TemperatureController(strong, PERIOD).step([410.0], [296.15]) <= 10.0


def test_sensor_that_reads_low_or_nothing_cannot_burn_the_wire():
    """An infrared spot wider than the wire: the model's own temperature limits the power."""
    controller = TemperatureController(WIRE, PERIOD)
    for _ in range(200):
        volts = controller.step([400.0], [300.0])
    steady = 296.15 + volts[0] ** 2 / WIRE["wire.resistance"] / controller.heating.loss
    assert steady == pytest.approx(WIRE["bench.maximum_temperature"] - 10.0, abs=0.1)
    names = {"bench.channels": ["a", "b", "c"], "bench.channel_sides": ["front"] * 3}
    controller = TemperatureController(WIRE.replace(names), PERIOD)
    volts = controller.step([320.0, 320.0, np.nan], [np.nan, 300.0, 300.0])
    assert volts[0] == volts[2] == 0.0 and volts[1] > 3.5
    assert np.all(controller.step([296.15] * 3, [296.0] * 3) == 0.0)


@pytest.mark.parametrize("drive", [
    {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.4},
    {"bench.drive": "current", "wire.count": 2, "bench.maximum_current": 8.0},
    {"bench.drive": "power", "effect.phase_dependent_resistance.austenite_change": -0.15},
])  # fmt: skip
def test_any_drive_holds_a_temperature_and_stays_within_the_current(drive):
    rig = WIRE.replace(drive)
    controller = TemperatureController(rig, PERIOD)
    found = run(rig, controller, lambda _: 325.0, 4.0)
    assert found.actual[-1, 0] == pytest.approx(325.0, abs=0.05)
    assert found.actual.max() < 325.4  # the model's power is the right one
    hardest = controller.heating.voltage(controller.heating.maximum_power)
    through = simulate(rig, [0.0, 1e-3], np.full(2, float(hardest)))
    volts, amperes = direct_reading(rig, through.voltage, through.current)
    assert amperes[0, 0] <= 0.9 * rig["bench.maximum_current"] * (1.0 + 1e-9)
    assert float(hardest) <= rig["bench.maximum_voltage"] and volts[0, 0] <= 12.0


COMPOSITE = WIRE.replace({"bench.channels": ["front_1", "front_2", "back_1", "back_2"],
                          "bench.channel_sides": ["front", "front", "back", "back"]})  # fmt: skip
UNCERTAIN = [p.name for p in TABLE if p.uncertainty and p.default
             and p.name.startswith(("wire.", "environment.", "composite."))
             and "_per_" not in p.name]
FRONT = np.array([True, True, False, False])
PEAK, RISE, REST = 0.03, 5.0, 5.0  # m, s
CYCLE = 2.0 * (2.0 * RISE + REST)


def triangle(t, peak=PEAK):
    """Front, rest, back, rest, as in Fig. 15 a."""
    edges = np.cumsum([0.0, RISE, RISE, REST, RISE, RISE, REST])
    return float(np.interp(t % CYCLE, edges, np.array([0, 1, 0, 0, -1, 0, 0]) * peak))


def driven(bench, reference, duration, parameters=COMPOSITE, feedback=True, **reading):
    """A run under a controller that knows the `parameters`."""
    controller = DeflectionController(parameters, PERIOD)
    return run(bench, controller, reference, duration, feedback=feedback, **reading)


def controlled(bench, feedback=True, late=0):
    delay = PERIOD * late + 0.005
    controller = DeflectionController(COMPOSITE, PERIOD, delay=delay)
    return run(bench, controller, triangle, CYCLE, feedback=feedback, late=late, noise=7e-5,
               resolution=5e-5)


def open_loop(bench):
    """The paper's own: a triangular voltage whose peak leads to the wanted peak."""
    peak = OperatingPoint.at_deflection(COMPOSITE, PEAK, "heating").voltage.max()
    clock = iter(np.arange(round(CYCLE / PERIOD)) * PERIOD)

    def voltage(*_):
        level = triangle(next(clock), peak)
        return np.where(FRONT, max(level, 0.0), max(-level, 0.0))

    return run_loop(bench, lambda plant: np.array(plant.deflection), triangle, voltage, CYCLE,
                    PERIOD)


def error(found):
    """Root mean square, m."""
    return float(np.sqrt(np.mean(np.square(found.actual - found.reference))))


def test_triangle_is_tracked_better_than_open_loop_with_parameters_known_off_and_late_commands():
    """And only the side of the reference is heated."""
    found = controlled(COMPOSITE)
    assert error(found) < min(0.06e-3, 0.01 * error(open_loop(COMPOSITE)))
    blind = controlled(COMPOSITE, feedback=False, late=1)
    assert error(controlled(COMPOSITE, late=1)) < 0.5 * error(blind)
    ahead = np.array([triangle(t + PERIOD) for t in found.time])
    assert np.all(found.voltage >= 0.0)
    assert np.all(found.voltage[ahead <= 0.0][:, FRONT] == 0.0)
    assert np.all(found.voltage[ahead >= 0.0][:, ~FRONT] == 0.0)
    assert found.voltage.max() <= 0.9 * 3.0 * COMPOSITE["wire.resistance"] * (1.0 + 1e-9)
    bench = off_by_deviations(COMPOSITE, UNCERTAIN, 0)
    closed = error(controlled(bench))
    assert closed < min(0.5e-3, 0.2 * error(controlled(bench, feedback=False)))
    assert closed < 0.05 * error(open_loop(bench))


def test_feedforward_inverts_partial_loops():
    """Reversals within reversals: without the branch of the moment this is off by millimetres."""
    controller = DeflectionController(COMPOSITE, 0.02)
    found = run(COMPOSITE, controller, lambda t: 0.02 + 0.008 * (np.sin(t) + np.sin(2.7 * t)), 15.0,
                0.02, feedback=False)
    off = (found.actual - found.reference)[found.time > 1.0]
    assert np.sqrt(np.mean(off**2)) < 0.02e-3


def test_an_unreachable_deflection_neither_winds_up_nor_burns_nor_does_a_dead_sensor():
    hottest = COMPOSITE["bench.maximum_temperature"] - 9.0
    largest = maximum_deflection(COMPOSITE)
    found = driven(COMPOSITE, lambda t: 2.0 * largest if t < 5.0 else 0.02, 8.0)
    assert simulate(COMPOSITE, found.time, found.voltage).temperature.max() < hottest
    assert found.actual[np.searchsorted(found.time, 4.0)] > 0.95 * largest
    assert abs(found.actual[np.searchsorted(found.time, 6.0)] - 0.02) < 0.1e-3
    # One that reads 0 whatever the wires do; the model's temperature limits the power.
    controller = DeflectionController(COMPOSITE, PERIOD)
    volts = np.array([controller.step(0.02, 0.0) for _ in range(200)])
    burnt = simulate(COMPOSITE, np.arange(200) * PERIOD, volts)
    assert burnt.temperature.max() < hottest
    # Without one the feedforward goes on.
    blind = driven(COMPOSITE, lambda t: 0.02, 8.0, feedback=False)
    assert blind.actual[-1] == pytest.approx(0.02, abs=0.1e-3)


SUPPLIES = {"force": {"bench.drive": "duty"}, "spring": {"bench.lead_resistance": 0.3},
            "antagonist": {"bench.drive": "current"}}  # fmt: skip
RIGS = {load: PAPER.replace({"load.kind": load, **LOADS[load], **supply})
        for load, supply in SUPPLIES.items()}


@pytest.mark.parametrize("load", RIGS)
def test_wires_with_a_load_follow_a_wave_of_their_position(load):
    rig = RIGS[load]
    largest = maximum_deflection(rig)
    sign, back = (1.0, -1.0) if load == "antagonist" else (-1.0, 0.8)
    part = np.array([0.0, 1.0, 0.4, 0.9, 0.0, back, 0.0])

    def wave(t):
        return sign * 0.5 * largest * float(np.interp(t, np.arange(7.0) * 5.0, part))

    names = [n for n in UNCERTAIN if n.startswith("wire.") and n != "wire.mass"]
    off = off_by_deviations(rig, names, 3, 0.5)
    exact, wrong, blind = (driven(bench, wave, 30.0, rig, feedback, noise=2e-5)
                           for bench, feedback in ((rig, True), (off, True), (off, False)))
    assert error(exact) < 0.01 * largest
    assert error(wrong) < 0.04 * largest and error(wrong) < 0.7 * error(blind)
    assert np.all(exact.voltage >= 0.0)


def test_a_bench_with_its_effects_is_followed():
    rig = RIGS["spring"].replace({"effect.latent_heat.heat": 6e3, "wire.transition_spread": 1.0})
    found = driven(rig, lambda t: -3e-3 * (1.0 - np.cos(0.8 * t)) / 2.0, 12.0, rig)
    assert error(found) < 0.05e-3


def test_no_voltage_follows_from_a_bad_number_and_a_reference_out_of_reach_is_quoted():
    with pytest.raises(InputError, match="clamped"):
        DeflectionController(PAPER, PERIOD)
    assert not DeflectionController(COMPOSITE, PERIOD).step(np.nan, 0.0).any()
    pair = {"bench.channels": ["a", "b"], "bench.channel_sides": ["front", "back"]}
    sides = PAPER.replace(pair)
    front = sides.replace({"bench.channel_sides": ["front", "front"]})
    for controller, reference, bench, expected in (
        (TemperatureController, [320.0], PAPER, ""), (TemperatureController, [280.0], PAPER, ""),
        (TemperatureController, [320.0, 320.0], PAPER, "has 2 temperatures, expected 1"),
        (TemperatureController, [math.nan], PAPER, "has nan K"),
        (TemperatureController, [-5.0], PAPER, "has -5 K"),
        (TemperatureController, [420.0], PAPER, "at most 413.15 K"),
        (DeflectionController, [0.02], sides, ""), (DeflectionController, [-0.02], sides, ""),
        (DeflectionController, [0.0], front, ""),
        (DeflectionController, [np.inf], sides, "is inf m"),
        (DeflectionController, [0.08], sides, "to the front"),
        (DeflectionController, [-0.08], sides, "to the back"),
        (DeflectionController, [-0.01], front, "no wire on the back"),
        (DeflectionController, [-1e-3], RIGS["spring"], ""),
        (DeflectionController, [1e-3], RIGS["spring"], "a wire with a load only shortens"),
        (DeflectionController, [-0.05], RIGS["spring"], "expected at most"),
    ):  # fmt: skip
        fault = controller.reference_fault(reference, bench)
        assert expected in fault and bool(expected) == bool(fault)


@pytest.mark.parametrize(("quantity", "node"), [(TEMPERATURE, "temperature_controller"),
                                               (DEFLECTION, "deflection_controller")])  # fmt: skip
def test_one_reading_that_no_bench_has_changes_nothing(quantity, node):
    settings = {p.name: p.default for p in NODE_TABLES[node]} | {"reference": ""}
    wanted, now = ([330.0] * 4, 315.0) if quantity is TEMPERATURE else ([0.01], 0.009)
    loops = [ClosedLoop(quantity, settings, COMPOSITE, lambda _: None) for _ in range(2)]
    commanded = []
    for loop, odd in zip(loops, ((), (math.nan, math.inf, 1e306, -1e306)), strict=True):
        protocol = loop.plan(settings, COMPOSITE)
        assert loop.ask(wanted, protocol, COMPOSITE) == ""
        run = Run(None, loop, Guard((), ("power",), 1.0), None, 4)
        for k in range(40):
            for name in quantity.targets(COMPOSITE):
                heard = ("deflection", "") if quantity.tip else ("temperature", name)
                for value in (now, *(odd if k == 20 else ())):
                    run.heard(*heard, value, PERIOD * k, PERIOD * k)
            commanded.append(loop.volts(protocol, PERIOD * k))
    assert commanded[:40] == commanded[40:] and max(commanded[-1]) > 1.0
