"""Temperature control: PI, the staircase of E8, limits, wires without a reading, bad references."""

import math

import numpy as np
import pytest
from closed_loops import identified, off_by_deviations, step_figures
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.control.temperature import (
    PI,
    Gains,
    HeatBudget,
    Heating,
    OutputLimits,
    TemperatureController,
    temperature_reference_fault,
)
from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters
from sma_bench.physics import simulate
from sma_bench.physics.heat import direct_reading
from sma_bench.synthetic.bench_records import Feedback, run_temperature

numbers = st.floats(-1e3, 1e3)


def lag_response(loop, reference, gain, tau, seconds):
    """Outputs of a first-order lag under the loop, every 0.01 s."""
    y, values = 0.0, []
    decay = math.exp(-0.01 / tau)
    for _ in range(round(seconds / 0.01)):
        values.append(y)
        u = loop.step(reference, y, 0.01)
        y = gain * u + (y - gain * u) * decay
    return np.array(values)


def test_simc_answers_like_the_wanted_lag_and_shortens_the_integral_time_of_a_slow_plant():
    gains = Gains.simc(gain=6.0, time_constant=0.2, delay=0.005, closed_loop_time=0.1)
    assert gains.integral_time == 0.2
    assert gains.proportional == pytest.approx(0.2 / (6.0 * 0.105))
    y = lag_response(PI(gains, OutputLimits(0.0, 100.0)), 10.0, 6.0, 0.2, 2.0)
    assert y.max() < 10.1
    assert y[round(0.105 / 0.01)] == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=0.05)
    assert Gains.simc(1.0, 10.0, 0.1, 0.4).integral_time == pytest.approx(2.0)


def test_anti_windup_leaves_saturation_at_once():
    gains = Gains.simc(6.0, 0.2, 0.005)
    limited = lag_response(PI(gains, OutputLimits(0.0, 3.0)), 15.0, 6.0, 0.2, 3.0)
    assert limited.max() < 15.0 * 1.02
    wound_up = PI(Gains(gains.proportional, gains.integral_time, 1e6), OutputLimits(0.0, 3.0))
    assert lag_response(wound_up, 15.0, 6.0, 0.2, 3.0).max() > 15.0 * 1.05


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=30), st.floats(0.1, 50.0))
def test_output_never_leaves_its_range_nor_exceeds_its_rate(steps, rate):
    loop, last = PI(Gains(2.0, 0.3), OutputLimits(0.0, 10.0, rate)), 0.0
    for reference, measured in steps:
        output = loop.step(reference, measured, 0.05)
        assert 0.0 <= output <= 10.0
        assert abs(output - last) <= rate * 0.05 * (1.0 + 1e-9)
        last = output


@given(st.floats(0.0, 10.0), numbers, numbers, st.floats(-5.0, 5.0))
def test_take_over_is_bumpless(output, reference, measured, feedforward):
    loop = PI(Gains(2.0, 0.3), OutputLimits(0.0, 10.0))
    loop.take_over(output, reference, measured, feedforward)
    assert loop.step(reference, measured, 0.01, feedforward) == pytest.approx(output, abs=1e-9)


def test_bad_number_is_quoted():
    loop = PI(Gains(1.0, 1.0), OutputLimits(0.0, 1.0))
    for build, quoted in (
        (lambda: Gains(math.nan, 1.0), "proportional is nan"),
        (lambda: Gains(1.0, 0.0), "integral_time is 0.0 s"),
        (lambda: Gains.simc(0.0, 1.0, 0.1), "gain is 0.0"),
        (lambda: OutputLimits(2.0, 1.0), "low is 2.0 above high 1.0"),
        (lambda: loop.step(0.0, 0.0, 0.0), "dt is 0.0 s"),
        (lambda: loop.step(math.nan, 0.0, 0.1), "reference nan"),
        (lambda: TemperatureController(WIRE, 0.0), "period is 0.0 s"),
        (lambda: TemperatureController(WIRE, 0.05).step([1, 2], [1], 0.05), r"shape \(2,\)"),
    ):
        with pytest.raises(InputError, match=quoted):
            build()


WIRE = identified()
SLOW_WIRE = WIRE.replace({"wire.heat_transfer_coefficient": 70.0})  # still air: tau 1.1 s
THERMAL = [
    p.name for p in TABLE
    if p.uncertainty and p.default and p.name.startswith(("wire.", "env"))
    and ("temperature" not in p.name or "ambient" in p.name)
]
LEVELS = [303.15, 308.15, 313.15, 318.15, 323.15, 328.15]  # K, below A_s
PERIOD, READING = 0.05, {"noise": 0.08, "resolution": 0.1}


def staircase(dwell):
    return lambda t: np.array([LEVELS[min(int(t / dwell + 1e-9), len(LEVELS) - 1)]])


@pytest.mark.parametrize(
    ("wire", "dwell", "settling", "seed", "late"),
    [(WIRE, 6.0, 0.5, None, 0), (WIRE, 6.0, 0.5, 1, 1), (WIRE, 6.0, 0.5, 2, 0),
     (SLOW_WIRE, 15.0, 3.0, None, 1), (SLOW_WIRE, 15.0, 3.0, 3, 0)],
    ids=["as known", "off and late", "off", "still air, late", "still air, off"],
)  # fmt: skip
def test_staircase_below_a_s_is_tracked(wire, dwell, settling, seed, late):
    bench = wire if seed is None else off_by_deviations(wire, THERMAL, seed)
    controller = TemperatureController(wire, PERIOD, delay=PERIOD * late + 0.0125)
    loop = Feedback(PERIOD, late, **READING, seed=seed or 0)
    run = run_temperature(bench, controller, staircase(dwell), dwell * len(LEVELS), loop)
    samples = round(dwell / PERIOD)
    starts = [bench["environment.ambient_temperature"], *LEVELS[:-1]]
    for k, (start, stop) in enumerate(zip(starts, LEVELS, strict=True)):
        part = slice(k * samples, (k + 1) * samples)
        steady_error, overshoot, settled = step_figures(
            run.time[part], run.actual[part, 0], start, stop, band=0.5
        )
        assert abs(steady_error) < 0.06
        assert overshoot * (stop - start) < 0.6  # K, noise included
        assert settled < settling
    assert run.actual.max() < WIRE["wire.austenite_start_temperature"] - 3.0


def test_unreachable_reference_does_not_wind_up():
    controller = TemperatureController(WIRE, PERIOD, maximum_power=4.0)  # enough for 321 K

    def reference(t):
        return np.array([340.0 if t < 10.0 else 310.0])

    run = run_temperature(WIRE, controller, reference, 12.0, Feedback(PERIOD))
    late = run.time > 11.0
    assert run.actual[round(9.9 / PERIOD), 0] < 322.0
    np.testing.assert_allclose(run.actual[late, 0], 310.0, atol=0.1)


def test_start_is_bumpless_and_volts_stay_within_the_supplys_limits():
    controller = TemperatureController(WIRE, PERIOD)
    volt = controller.step([320.0], [320.0], PERIOD)
    assert volt[0] ** 2 / WIRE["wire.resistance"] == pytest.approx(
        float(controller.heating.holding_power(320.0))
    )
    volts = TemperatureController(WIRE, PERIOD).step([410.0], [296.15], PERIOD)
    assert volts[0] == pytest.approx(0.9 * 3.0 * WIRE["wire.resistance"])
    strong = WIRE.replace({"bench.maximum_current": 20.0})
    assert TemperatureController(strong, PERIOD).step([410.0], [296.15], PERIOD) <= 10.0


def test_sensor_that_reads_low_or_nothing_cannot_burn_the_wire():
    """An infrared spot wider than the wire: the model's own temperature limits the power."""
    controller = TemperatureController(WIRE, PERIOD)
    for _ in range(200):
        volts = controller.step([400.0], [300.0], PERIOD)
    steady = 296.15 + volts[0] ** 2 / WIRE["wire.resistance"] / controller.heating.loss
    assert steady == pytest.approx(WIRE["bench.maximum_temperature"] - 10.0, abs=0.1)
    names = {"bench.channels": ["a", "b", "c"], "bench.channel_sides": ["front"] * 3}
    controller = TemperatureController(WIRE.replace(names), PERIOD)
    volts = controller.step([320.0, 320.0, np.nan], [np.nan, 300.0, 300.0], PERIOD)
    assert volts[0] == volts[2] == 0.0
    assert np.all(controller.step([296.15] * 3, [296.0] * 3, PERIOD) == 0.0)
    assert volts[1] > 3.5


def test_power_toward_a_temperature_leads_there_and_its_budget_holds_the_highest():
    heating = Heating.of(WIRE)
    power = heating.power_toward(330.0, 310.0, 0.05)
    run = simulate(WIRE, [0.0, 5.0], np.full(2, float(heating.voltage(
        heating.holding_power(310.0)))))
    again = simulate(WIRE, [0.0, 0.05], np.full(2, float(heating.voltage(power))),
                     initial=run.final)
    assert again.temperature[-1, 0] == pytest.approx(330.0, abs=1e-6)
    heating = Heating.of(WIRE)
    budget = HeatBudget(heating, 1)
    for _ in range(100):
        budget.spend(budget.highest_power(0.05), 0.05)
        assert budget.temperature[0] <= heating.maximum_temperature + 1e-9
    assert budget.temperature[0] == pytest.approx(heating.maximum_temperature)


@pytest.mark.parametrize("drive", [
    {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.4},
    {"bench.drive": "current", "wire.count": 2, "bench.maximum_current": 8.0},
])
def test_any_drive_holds_a_temperature_and_stays_within_the_current(drive):
    rig = WIRE.replace(drive)
    controller = TemperatureController(rig, PERIOD)
    run = run_temperature(rig, controller, lambda _: np.array([325.0]), 4.0, Feedback(PERIOD))
    assert run.actual[-1, 0] == pytest.approx(325.0, abs=0.05)
    assert run.actual.max() < 325.4  # the model's power is the right one
    hardest = controller.heating.voltage(controller.heating.maximum_power)
    through = simulate(rig, [0.0, 1e-3], np.full(2, float(hardest)))
    volts, amperes = direct_reading(rig, through.voltage, through.current)
    assert amperes[0, 0] <= 0.9 * rig["bench.maximum_current"] * (1.0 + 1e-9)
    assert float(hardest) <= rig["bench.maximum_voltage"] and volts[0, 0] <= 12.0


def test_temperature_reference():
    for reference, expected in (
        ([320.0], ""), ([280.0], ""), ([320.0, 320.0], "has 2 temperatures, expected 1"),
        ([math.nan], "has nan K"), ([-5.0], "has -5 K"), ([420.0], "at most 413.15 K"),
    ):
        fault = temperature_reference_fault(reference, Parameters.of_paper())
        assert expected in fault and bool(expected) == bool(fault)
