"""Temperature control in closed loop: the staircase of E8, limits, wires without a reading."""

from collections.abc import Callable

import numpy as np
import pytest
from closed_loops import identified, step_figures

from sma_bench.control.temperature import HeatBudget, Heating, TemperatureController
from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters
from sma_bench.physics import simulate
from sma_bench.physics.heat import direct_reading
from sma_bench.synthetic.bench_records import Feedback, run_temperature

WIRE = identified()
SLOW_WIRE = WIRE.replace({"wire.heat_transfer_coefficient": 70.0})  # still air: tau 1.1 s
THERMAL = [
    p.name for p in TABLE
    if p.uncertainty and p.default and p.name.startswith(("wire.", "env"))
    and ("temperature" not in p.name or "ambient" in p.name)
]
LEVELS = [303.15, 308.15, 313.15, 318.15, 323.15, 328.15]  # K, below A_s
PERIOD, READING = 0.05, {"noise": 0.08, "resolution": 0.1}


def staircase(dwell: float) -> Callable[[float], np.ndarray]:
    return lambda t: np.array([LEVELS[min(int(t / dwell + 1e-9), len(LEVELS) - 1)]])


def off_by_one_deviation(parameters: Parameters, seed: int) -> Parameters:
    random = np.random.default_rng(seed)
    return parameters.replace(
        {name: parameters[name] + random.standard_normal() * parameters.std(name)
         for name in THERMAL}
    )


@pytest.mark.parametrize("late", [0, 1], ids=["prompt", "one period late"])
@pytest.mark.parametrize("seed", [None, 1, 2, 3])
@pytest.mark.parametrize(
    ("wire", "dwell", "settling"), [(WIRE, 6.0, 0.5), (SLOW_WIRE, 15.0, 3.0)],
    ids=["the paper's wire", "a wire in still air"],
)
def test_staircase_below_a_s_is_tracked(
    wire: Parameters, dwell: float, settling: float, seed: int | None, late: int
) -> None:
    bench = wire if seed is None else off_by_one_deviation(wire, seed)
    controller = TemperatureController(wire, PERIOD, delay=PERIOD * late + 0.0125)
    loop = Feedback(PERIOD, late, **READING, seed=seed or 0)
    run = run_temperature(bench, controller, staircase(dwell), dwell * len(LEVELS), loop)
    samples = round(dwell / PERIOD)
    starts = [bench["environment.ambient_temperature"], *LEVELS[:-1]]
    for k, (start, stop) in enumerate(zip(starts, LEVELS, strict=True)):
        part = slice(k * samples, (k + 1) * samples)
        figures = step_figures(run.time[part], run.actual[part, 0], start, stop, band=0.5)
        assert abs(figures.steady_error) < 0.06
        assert figures.overshoot * (stop - start) < 0.6  # K, noise included
        assert figures.settling_time < settling
    assert run.actual.max() < WIRE["wire.austenite_start_temperature"] - 3.0


def test_stress_of_the_staircase_gives_back_the_thermal_expansion_factor() -> None:
    controller = TemperatureController(WIRE, PERIOD)
    run = run_temperature(WIRE, controller, staircase(6.0), 36.0, Feedback(PERIOD, **READING))
    sigma = simulate(WIRE, run.time, run.voltage).stress[:, 0]
    held = np.arange(run.time.size) % 120 > 60
    slope = np.polyfit(run.measured[held, 0], sigma[held], 1)[0]
    assert slope == pytest.approx(WIRE["wire.thermal_expansion_factor"], rel=0.01)


def test_unreachable_reference_does_not_wind_up() -> None:
    controller = TemperatureController(WIRE, PERIOD, maximum_power=4.0)  # enough for 321 K

    def reference(t: float) -> np.ndarray:
        return np.array([340.0 if t < 10.0 else 310.0])

    run = run_temperature(WIRE, controller, reference, 12.0, Feedback(PERIOD))
    late = run.time > 11.0
    assert run.actual[round(9.9 / PERIOD), 0] < 322.0
    np.testing.assert_allclose(run.actual[late, 0], 310.0, atol=0.1)


def test_power_rises_no_faster_than_its_limit() -> None:
    controller = TemperatureController(WIRE, PERIOD, power_rate=5.0)
    run = run_temperature(WIRE, controller, lambda _: np.array([320.0]), 3.0, Feedback(PERIOD))
    power = run.voltage[:, 0] ** 2 / WIRE["wire.resistance"]
    assert np.abs(np.diff(power)).max() <= 5.0 * PERIOD * (1.0 + 1e-9)
    assert run.actual[-1, 0] == pytest.approx(320.0, abs=0.2)


def test_start_on_a_warm_wire_is_bumpless() -> None:
    controller = TemperatureController(WIRE, PERIOD)
    volt = controller.step([320.0], [320.0], PERIOD)
    assert volt[0] ** 2 / WIRE["wire.resistance"] == pytest.approx(
        float(controller.heating.holding_power(320.0))
    )


def test_sensor_that_reads_low_cannot_burn_the_wire() -> None:
    """An infrared spot wider than the wire: the model's own temperature limits the power."""
    controller = TemperatureController(WIRE, PERIOD)
    for _ in range(200):
        volts = controller.step([400.0], [300.0], PERIOD)
    steady = 296.15 + volts[0] ** 2 / WIRE["wire.resistance"] / controller.heating.loss
    assert steady == pytest.approx(WIRE["bench.maximum_temperature"] - 10.0, abs=0.1)


def test_wire_without_a_reading_or_a_reference_is_off() -> None:
    names = {"bench.channels": ["a", "b", "c"], "bench.channel_sides": ["front"] * 3}
    controller = TemperatureController(WIRE.replace(names), PERIOD)
    volts = controller.step([320.0, 320.0, np.nan], [np.nan, 300.0, 300.0], PERIOD)
    assert volts[0] == volts[2] == 0.0
    assert np.all(controller.step([296.15] * 3, [296.0] * 3, PERIOD) == 0.0)
    assert volts[1] > 3.5


def test_voltage_stays_within_supply_limits() -> None:
    volts = TemperatureController(WIRE, PERIOD).step([410.0], [296.15], PERIOD)
    assert volts[0] == pytest.approx(0.9 * 3.0 * WIRE["wire.resistance"])
    strong = WIRE.replace({"bench.maximum_current": 20.0})
    assert TemperatureController(strong, PERIOD).step([410.0], [296.15], PERIOD) <= 10.0


def test_power_toward_a_temperature_leads_there_exactly() -> None:
    heating = Heating.of(WIRE)
    power = heating.power_toward(330.0, 310.0, 0.05)
    run = simulate(WIRE, [0.0, 5.0], np.full(2, float(heating.voltage(
        heating.holding_power(310.0)))))
    again = simulate(WIRE, [0.0, 0.05], np.full(2, float(heating.voltage(power))),
                     initial=run.final)
    assert again.temperature[-1, 0] == pytest.approx(330.0, abs=1e-6)


def test_heat_budget_holds_the_highest_temperature() -> None:
    heating = Heating.of(WIRE)
    budget = HeatBudget(heating, 1)
    for _ in range(100):
        budget.spend(budget.highest_power(0.05), 0.05)
        assert budget.temperature[0] <= heating.maximum_temperature + 1e-9
    assert budget.temperature[0] == pytest.approx(heating.maximum_temperature)


@pytest.mark.parametrize(
    ("build", "quoted"),
    [
        (lambda: TemperatureController(WIRE, 0.0), "period is 0.0 s"),
        (lambda: TemperatureController(WIRE, 0.05, maximum_power=-1.0), "maximum_power is -1.0"),
        (lambda: TemperatureController(WIRE, 0.05, power_rate=-2.0), "power_rate is -2.0"),
        (lambda: TemperatureController(WIRE, 0.05, delay=-0.1), "delay is -0.07"),
        (lambda: TemperatureController(WIRE, 0.05).step([1, 2], [1], 0.05), r"shape \(2,\)"),
        (lambda: TemperatureController(WIRE, 0.05).step([300], [300], 0.0), "dt is 0.0 s"),
    ],
)
def test_bad_number_is_quoted(build: object, quoted: str) -> None:
    with pytest.raises(InputError, match=quoted):
        build()


@pytest.mark.parametrize("drive", [
    {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.4},
    {"bench.drive": "current", "wire.count": 2, "bench.maximum_current": 8.0},
])
def test_any_drive_holds_a_temperature_and_stays_within_the_current(drive) -> None:
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
