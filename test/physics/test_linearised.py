"""The linearised model against numerical differentiation of the nonlinear one, on both rigs."""

import numpy as np
import pytest
from effect_references import FOUR
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters
from sma_bench.physics import Boundary, material, simulate
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.heat import temperature_rate, time_constant
from sma_bench.physics.linearised import SMOOTHER, coefficient_table, linearise
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection

WIRE = Parameters.of_paper()
COMPOSITE = WIRE.replace(FOUR)
GIVEN = ("composite.deflection_per", "composite.stress_per", *SMOOTHER)
DRAWN = ("wire.", "env", "comp")
UNCERTAIN = [
    p.name
    for p in TABLE
    if p.uncertainty and p.name.startswith(DRAWN) and not p.name.startswith(GIVEN)
]
BRANCHES = ("heating", "cooling")
WHOLE = {"s": "start", "f": "finish"}
FAST = settings(max_examples=25, deadline=None, derandomize=True)


@st.composite
def rigs(draw: st.DrawFn, base: Parameters = COMPOSITE) -> Parameters:
    """Parameters up to two standard deviations off, the sides of the composite unlike."""
    values = {n: base[n] + draw(st.floats(-2.0, 2.0)) * base.std(n) for n in UNCERTAIN}
    values["composite.stress_per_deflection_back"] = draw(st.floats(1e9, 4e9))
    return base.replace(values)


@st.composite
def points(draw: st.DrawFn, base: Parameters) -> OperatingPoint:
    """Anywhere inside the transformation, on the full loop or in a partial one, wires unlike."""
    p = draw(rigs(base))
    wires = len(p["bench.channels"])
    part, fraction = (
        np.array([draw(st.floats(0.05, 0.95)) for _ in range(wires)]) for _ in range(2)
    )
    branch = draw(st.sampled_from(BRANCHES))
    boundary, stress = None, material.stress(340.0, fraction, 0.0, p)
    if wires == 1 and draw(st.booleans()):
        boundary, stress = Boundary.held_stress(50e6), 50e6
    elif wires == 4:  # two wires on either side share its load
        pairs = material.modulus(fraction, p).reshape(2, 2)
        shorter = stress.reshape(2, 2).sum(axis=1) / (
            pairs.sum(axis=1) + np.array(Boundary.of(p).stiffness)
        )
        stress = stress - (pairs * shorter[:, np.newaxis]).ravel()
    phase, ends = ("austenite", "sf") if branch == "heating" else ("martensite", "fs")
    low, high = (p[f"wire.{phase}_{WHOLE[end]}_temperature"] for end in ends)
    kelvin = low + part * (high - low) + stress / p[f"wire.stress_influence_{phase}"]
    try:
        point = OperatingPoint.of_state(p, kelvin, fraction, branch, boundary)
    except InputError:
        assume(False)  # wires so unlike that their stresses put them outside the other range
    ramp = material.austenite_ramp if branch == "heating" else material.martensite_ramp
    inside = ramp(point.temperature, point.stress, p)
    assume(np.all((inside > 1e-3) & (inside < 0.999)))
    return point


def nonlinear_derivative(
    point: OperatingPoint, direction: np.ndarray, time: np.ndarray, latent_heat: float = 0.0
) -> np.ndarray:
    """(n, 1 + 2 w) change of the outputs per volt along `direction`, one-sided, extrapolated."""
    rig = point.parameters.replace({"effect.latent_heat.heat": latent_heat})

    def change(step: float) -> np.ndarray:
        voltage = np.tile(point.voltage + step * direction, (time.size, 1))
        run = simulate(rig, time, voltage, initial=point.state, boundary=point.boundary)
        outputs = np.column_stack([run.deflection, run.temperature, run.stress])
        return (outputs - outputs[0]) / step

    coarse, middle, fine = change(4e-4), change(2e-4), change(1e-4)
    return (8.0 * fine - 6.0 * middle + coarse) / 3.0


def assert_tangent(
    point: OperatingPoint, weights: np.ndarray, time: np.ndarray, tolerance: float = 2e-6,
    latent_heat: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """The step response (n, 1 + 2 w), to the largest nonlinear one of each kind of output."""
    direction = weights if point.branch == "heating" else -weights
    system = linearise(point, latent_heat).state_space()
    actual = lsim(system, np.tile(direction, (time.size, 1)), time)[1]
    expected = nonlinear_derivative(point, direction, time, latent_heat)
    wires = (actual.shape[1] - 1) // 2
    kinds = (slice(0, 1), slice(1, 1 + wires), slice(1 + wires, None))
    for columns, smallest in zip(kinds, (1e-4, 1.0, 1e5), strict=True):
        scale = max(np.abs(expected[:, columns]).max(), smallest)
        assert np.abs(actual[:, columns] - expected[:, columns]).max() < tolerance * scale
    return actual


def few_time_constants(parameters: Parameters) -> np.ndarray:
    return np.linspace(0.0, 4.0, 15) * time_constant(parameters)


@pytest.mark.parametrize("base", [WIRE, COMPOSITE], ids=["wire rig", "composite rig"])
def test_step_response_is_the_derivative_of_the_nonlinear_model(base: Parameters) -> None:
    @FAST
    @given(points(base), st.lists(st.floats(0.2, 1.0), min_size=4, max_size=4))
    def check(point: OperatingPoint, weights: list[float]) -> None:
        time = few_time_constants(point.parameters)
        assert_tangent(point, np.array(weights[: point.voltage.size]), time)

    check()


PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
DUTY = {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.3}
SPRING = {"load.kind": "spring", "load.stiffness": 900.0, "load.preload": 5.0}
LOADS = {
    "force, duty": {"load.kind": "force", "load.force": 9.0, **DUTY},
    "spring, current": {**SPRING, "bench.drive": "current", "wire.count": 2},
    "antagonist, duty": {
        "load.kind": "antagonist", "load.stiffness": 300.0, "load.preload": 6.0, **PAIR, **DUTY,
    },
}  # fmt: skip


@pytest.mark.parametrize("branch", BRANCHES)
@pytest.mark.parametrize("load", LOADS)
def test_any_load_and_drive_at_rest_where_it_is_linearised(load: str, branch: str) -> None:
    rig = WIRE.replace(LOADS[load])
    sign = 1.0 if "antagonist" in load else -1.0
    wanted = sign * 0.4 * maximum_deflection(rig)
    point = OperatingPoint.at_deflection(rig, wanted, branch)
    assert point.deflection == pytest.approx(wanted, rel=1e-8)
    again = OperatingPoint.at_voltage(rig, point.voltage, branch)
    assert again.martensite_fraction == pytest.approx(point.martensite_fraction, abs=1e-8)
    held = np.tile(point.voltage, (3, 1))
    run = simulate(rig, np.arange(3) * 60.0, held, initial=point.state)
    assert run.deflection[-1] == pytest.approx(wanted, rel=1e-6)
    assert_tangent(point, np.array([0.7, 0.0])[: point.voltage.size], few_time_constants(rig))


def test_latent_heat_slows_the_linear_model_as_it_slows_the_nonlinear_one() -> None:
    point = OperatingPoint.at_deflection(COMPOSITE, 0.5 * maximum_deflection(COMPOSITE), "heating")
    time = np.linspace(0.0, 1.0, 20001)
    with_heat = assert_tangent(point, np.ones(4), time, 2e-4, 10e3)
    without = assert_tangent(point, np.ones(4), time)
    early = np.searchsorted(time, 0.1)
    assert with_heat[early, 0] < 0.5 * without[early, 0]


@FAST
@given(points(WIRE))
def test_equation_18_is_the_tangent_of_the_constitutive_law(point: OperatingPoint) -> None:
    p, xi, e = point.parameters, point.martensite_fraction[0], point.contraction[0]
    recovered = p["wire.maximum_recoverable_strain"] * p["wire.austenite_modulus"]
    h = 1e-5
    up, down = (material.stress(point.temperature, xi + s * h, e, p) for s in (1.0, -1.0))
    pull = linear.a2(xi, -e, p) - recovered
    assert pull == pytest.approx(((up - down) / (2.0 * h))[0], rel=1e-8)
    rise = point.temperature[0] - p["environment.ambient_temperature"]
    line = linear.a1(xi, p) * -e + p["wire.thermal_expansion_factor"] * rise
    line += linear.a2(xi, -e, p) * xi + linear.a3(xi, -e, p) - recovered * (xi - 1.0)
    assert line == pytest.approx(point.stress[0], rel=1e-9, abs=1.0)


@FAST
@given(rigs(WIRE), st.floats(0.05, 0.95), st.floats(0.0, 100e6))
def test_equations_20_and_21_are_the_tangents_of_the_full_loop(
    parameters: Parameters, place: float, sigma: float
) -> None:
    heating = ("austenite_start", "austenite_finish", "stress_influence_austenite")
    cooling = ("martensite_finish", "martensite_start", "stress_influence_martensite")
    rows = (
        (heating, material.heated_fraction, linear.b1, linear.b1_of_stress),
        (cooling, material.cooled_fraction, linear.b3, linear.b3_of_stress),
    )
    for (low, high, influence), fraction, per_kelvin, per_pascal in rows:
        begin, end = (parameters[f"wire.{name}_temperature"] for name in (low, high))
        kelvin = begin + place * (end - begin) + sigma / parameters[f"wire.{influence}"]
        warm, cold = (fraction(kelvin + d, sigma, parameters) for d in (1e-4, -1e-4))
        more, less = (fraction(kelvin, sigma + d, parameters) for d in (1e3, -1e3))
        slope = pytest.approx((warm - cold) / 2e-4, rel=1e-6)
        assert -per_kelvin(kelvin, sigma, parameters) == slope
        slope = pytest.approx((more - less) / 2e3, rel=1e-6)
        assert per_pascal(kelvin, sigma, parameters) == slope


@given(st.floats(0.5, 8.0))
def test_equation_19_is_the_tangent_of_the_heating(voltage: float) -> None:
    ohm, h = 2.6987, 1e-6
    capacity = WIRE["wire.mass"] * WIRE["wire.specific_heat"]
    hot, cold = (temperature_rate(330.0, voltage + k * h, WIRE) for k in (1.0, -1.0))
    up, down = (linear.linear_heating(voltage + k * h, voltage, ohm) for k in (1.0, -1.0))
    assert (up - down) / (2.0 * h) == pytest.approx((hot - cold) * capacity / (2.0 * h), rel=1e-6)
    assert linear.linear_heating(voltage, voltage, ohm) == pytest.approx(voltage**2 / ohm)
    assert linear.linear_heating_as_printed(voltage, voltage, ohm) < 0.0


@FAST
@given(rigs(), st.floats(0.02, 0.98), st.sampled_from(BRANCHES), st.sampled_from([1.0, -1.0]))
def test_operating_point_is_where_the_simulation_comes_to_rest(
    parameters: Parameters, part: float, branch: str, sign: float
) -> None:
    side = "front" if sign > 0.0 else "back"
    wanted = sign * part * maximum_deflection(parameters, side)
    point = OperatingPoint.at_deflection(parameters, wanted, branch)
    assert point.deflection == pytest.approx(wanted, rel=1e-8)
    again = OperatingPoint.at_voltage(parameters, point.voltage, branch)
    assert again.martensite_fraction == pytest.approx(point.martensite_fraction, abs=1e-9)
    # Hot enough for austenite before it cools, or cold before it warms.
    before = 1.6 * point.voltage if branch == "cooling" else 0.0 * point.voltage
    time = np.array([0.0, 60.0, 120.0]) * time_constant(parameters)
    run = simulate(parameters, time, np.array([before, point.voltage, point.voltage]))
    assert run.deflection[-1] == pytest.approx(wanted, rel=1e-7)


def test_printed_and_corrected_coefficients_at_half_of_the_maximum_deflection() -> None:
    point = OperatingPoint.at_deflection(COMPOSITE, 0.5 * maximum_deflection(COMPOSITE), "heating")
    table = {row.name: row for row in coefficient_table(point)}
    ratio = {name: row.printed / row.corrected for name, row in table.items()}
    assert ratio["a_1"] == ratio["b_2"] == ratio["b_4"] == 1.0
    assert ratio["heating per volt"] == -1.0
    assert ratio["b_1"] == pytest.approx((353.61 - 331.81) / np.pi)
    assert ratio["b_3"] == pytest.approx((353.39 - 325.09) / np.pi)
    assert ratio["b_1 of stress"] == pytest.approx(7.0e6 * (353.61 - 331.81) / np.pi)
    # Twice the integral of eq. (16), of wires that are a sheet as wide as the beam.
    assert ratio["alpha"] == pytest.approx(2.0 * 1.05574 / 1.71405, rel=1e-5)
    assert ratio["strain per deflection"] == pytest.approx(-1.0 / ratio["alpha"])
    both = 2.0 * (22.8e9 - 55.4e9) * 0.044 * (1.0 - 2.0 * point.martensite_fraction[0])
    assert table["a_2"].printed + table["a_2"].corrected == pytest.approx(both)
    assert table["heating at V*"].corrected == pytest.approx(point.voltage[0] ** 2 / 2.6987)
    assert ratio["deflection per kelvin"] < 1e-6
    assert ratio["beta"] > 100.0
    of_wire = coefficient_table(OperatingPoint.at_voltage(WIRE, 4.6, "heating"))
    assert "alpha" not in {row.name for row in of_wire}


@pytest.mark.parametrize(
    ("rig", "metres", "message"),
    [
        (COMPOSITE, 0.08, "at most 0.07"),
        (COMPOSITE, -0.08, "to the back"),
        (COMPOSITE, float("nan"), "nan m"),
        (WIRE, 0.01, "clamped"),
        (WIRE.replace(SPRING), 1e-3, "a wire with a load only shortens"),
        (WIRE.replace(SPRING), -0.05, "expected at most"),
    ],
)
def test_impossible_operating_point_is_refused(rig, metres: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        OperatingPoint.at_deflection(rig, metres, "heating")
