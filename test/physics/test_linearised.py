"""The linearised model against numerical differentiation of the nonlinear one, on both rigs."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters
from sma_bench.physics import Boundary, material, side_names, simulate
from sma_bench.physics import linear_coefficients as linear
from sma_bench.physics.heat import temperature_rate, time_constant
from sma_bench.physics.linearised import SMOOTHER, coefficient_table, linearise
from sma_bench.physics.operating_point import OperatingPoint, maximum_deflection

WIRE = Parameters.of_paper()
COMPOSITE = WIRE.replace(
    {
        "bench.channels": ["front_1", "front_2", "back_1", "back_2"],
        "bench.channel_sides": ["front", "front", "back", "back"],
    }
)
UNCERTAIN = [
    p.name for p in TABLE
    if p.uncertainty and p.name.startswith(("wire.", "env", "comp")) and p.name not in SMOOTHER
]
BRANCHES = ("heating", "cooling")
FAST = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)


@st.composite
def rigs(draw: st.DrawFn, base: Parameters = COMPOSITE) -> Parameters:
    """Parameters up to two standard deviations off, the sides of the composite unlike."""
    values = {
        name: base[name] + draw(st.floats(-2.0, 2.0)) * base.std(name)
        for name in UNCERTAIN
        if not name.startswith(("composite.deflection_per", "composite.stress_per"))
    }
    values["composite.stress_per_deflection_back"] = draw(st.floats(1e9, 4e9))
    return base.replace(values)


@st.composite
def points(draw: st.DrawFn, base: Parameters) -> OperatingPoint:
    """Anywhere inside the transformation, on the full loop or in a partial one, wires unlike."""
    parameters = draw(rigs(base))
    wires = len(parameters["bench.channels"])
    position = np.array([draw(st.floats(0.05, 0.95)) for _ in range(wires)])
    fraction = [draw(st.floats(0.05, 0.95)) for _ in range(wires)]
    branch = draw(st.sampled_from(BRANCHES))
    boundary = None
    if wires == 1:
        boundary = draw(st.sampled_from([None, Boundary.held_stress(50e6)]))
    low, high, influence = transformation_range(parameters, branch)
    shift = balanced_stress(parameters, 340.0, np.array(fraction), boundary) / influence
    kelvin = low + shift + position * (high - low)
    try:
        point = OperatingPoint.of_state(parameters, kelvin, fraction, branch, boundary)
    except InputError:
        assume(False)  # wires so unlike that their stresses put them outside the other range
    ramp = material.austenite_ramp if branch == "heating" else material.martensite_ramp
    inside = ramp(point.temperature, point.stress, parameters)
    assume(np.all((inside > 1e-3) & (inside < 0.999)))
    return point


def transformation_range(parameters: Parameters, branch: str) -> tuple[float, float, float]:
    """Where the transformation of a branch begins and ends without stress, and C."""
    name, ends = {
        "heating": ("austenite", ("start", "finish")),
        "cooling": ("martensite", ("finish", "start")),
    }[branch]
    low, high = (parameters[f"wire.{name}_{end}_temperature"] for end in ends)
    return low, high, parameters[f"wire.stress_influence_{name}"]


def balanced_stress(
    parameters: Parameters, kelvin: float, fraction: np.ndarray, boundary: Boundary | None
) -> np.ndarray:
    """(w,) Pa that the wires of each side share at given fractions."""
    boundary = boundary or Boundary.of(parameters)
    free = material.stress(kelvin, fraction, 0.0, parameters)
    if boundary.contraction is not None:
        return free
    sides = np.array(parameters["bench.channel_sides"])
    modulus, sigma = material.modulus(fraction, parameters), np.empty_like(free)
    stiffness, load = np.atleast_1d(boundary.stiffness), np.atleast_1d(boundary.load)
    for k, name in enumerate(side_names(parameters)):
        own = sides == name
        contraction = (free[own].sum() - load[min(k, load.size - 1)]) / (
            modulus[own].sum() + stiffness[min(k, stiffness.size - 1)]
        )
        sigma[own] = free[own] - modulus[own] * contraction
    return sigma


def nonlinear_derivative(
    point: OperatingPoint, direction: np.ndarray, time: np.ndarray, latent_heat: float = 0.0
) -> np.ndarray:
    """(n, 1 + 2 w) change of the outputs per volt along `direction`, one-sided, extrapolated."""

    def change(step: float) -> np.ndarray:
        voltage = np.tile(point.voltage + step * direction, (time.size, 1))
        run = simulate(
            point.parameters.replace({"effect.latent_heat.heat": latent_heat}), time, voltage,
            initial=point.state, boundary=point.boundary,
        )
        outputs = np.column_stack([run.deflection, run.temperature, run.stress])
        return (outputs - outputs[0]) / step

    coarse, middle, fine = change(4e-4), change(2e-4), change(1e-4)
    return (8.0 * fine - 6.0 * middle + coarse) / 3.0


def step_response(
    point: OperatingPoint, direction: np.ndarray, time: np.ndarray, latent_heat: float = 0.0
) -> np.ndarray:
    system = linearise(point, latent_heat).state_space()
    return lsim(system, np.tile(direction, (time.size, 1)), time)[1]


def assert_close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Relative to the largest response of each kind of output."""
    wires = (actual.shape[1] - 1) // 2
    kinds = (slice(0, 1), slice(1, 1 + wires), slice(1 + wires, None))
    for columns, smallest in zip(kinds, (1e-4, 1.0, 1e5), strict=True):
        scale = max(np.abs(expected[:, columns]).max(), smallest)
        np.testing.assert_allclose(
            actual[:, columns], expected[:, columns], rtol=0.0, atol=tolerance * scale
        )


@pytest.mark.parametrize("base", [WIRE, COMPOSITE], ids=["wire rig", "composite rig"])
def test_step_response_is_the_derivative_of_the_nonlinear_model(base: Parameters) -> None:
    @FAST
    @given(points(base), st.lists(st.floats(0.2, 1.0), min_size=4, max_size=4))
    def check(point: OperatingPoint, weights: list[float]) -> None:
        assert_tangent(point, np.array(weights[: point.voltage.size]))

    check()


def assert_tangent(point: OperatingPoint, weights: np.ndarray) -> None:
    direction = weights if point.branch == "heating" else -weights
    time = np.linspace(0.0, 4.0, 15) * time_constant(point.parameters)
    assert_close(
        step_response(point, direction, time), nonlinear_derivative(point, direction, time), 2e-6
    )


PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
LOADS = {
    "force": {"load.kind": "force", "load.force": 9.0},
    "spring": {"load.kind": "spring", "load.stiffness": 900.0, "load.preload": 5.0},
    "antagonist": {**PAIR, "load.kind": "antagonist", "load.stiffness": 300.0,
                   "load.preload": 6.0},
}  # fmt: skip
DRIVES = {
    "voltage": {},
    "duty": {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.3},
    "current": {"bench.drive": "current", "wire.count": 2},
}


@pytest.mark.parametrize("branch", BRANCHES)
@pytest.mark.parametrize(("load", "drive"), [
    ("force", "duty"), ("spring", "current"), ("antagonist", "voltage"), ("antagonist", "duty"),
])
def test_any_load_and_drive_at_rest_where_it_is_linearised(load, drive, branch) -> None:
    rig = WIRE.replace({**LOADS[load], **DRIVES[drive]})
    sign = 1.0 if load == "antagonist" else -1.0
    wanted = sign * 0.4 * maximum_deflection(rig)
    point = OperatingPoint.at_deflection(rig, wanted, branch)
    assert point.deflection == pytest.approx(wanted, rel=1e-8)
    again = OperatingPoint.at_voltage(rig, point.voltage, branch)
    assert again.martensite_fraction == pytest.approx(point.martensite_fraction, abs=1e-8)
    held = np.tile(point.voltage, (3, 1))
    run = simulate(rig, np.arange(3) * 60.0, held, initial=point.state)
    assert run.deflection[-1] == pytest.approx(wanted, rel=1e-6)
    assert_tangent(point, np.array([0.7, 0.0])[: point.voltage.size])


def test_a_wire_with_a_load_has_no_operating_point_beyond_its_length() -> None:
    rig = WIRE.replace(LOADS["spring"])
    with pytest.raises(InputError, match="a wire with a load only shortens"):
        OperatingPoint.at_deflection(rig, 1e-3, "heating")
    with pytest.raises(InputError, match="expected at most"):
        OperatingPoint.at_deflection(rig, -0.05, "heating")


def test_latent_heat_slows_the_linear_model_as_it_slows_the_nonlinear_one() -> None:
    point = OperatingPoint.at_deflection(COMPOSITE, 0.5 * maximum_deflection(COMPOSITE), "heating")
    direction = np.array([1.0, 1.0, 1.0, 1.0])
    time = np.linspace(0.0, 1.0, 20001)
    with_heat = step_response(point, direction, time, 10e3)
    assert_close(with_heat, nonlinear_derivative(point, direction, time, 10e3), 2e-4)
    without = step_response(point, direction, time)
    early = np.searchsorted(time, 0.1)
    assert with_heat[early, 0] < 0.5 * without[early, 0]


@FAST
@given(points(WIRE))
def test_equation_18_is_the_tangent_of_the_constitutive_law(point: OperatingPoint) -> None:
    p, xi, e = point.parameters, point.martensite_fraction[0], point.contraction[0]
    pull = linear.a2(xi, -e, p) - p["wire.maximum_recoverable_strain"] * p["wire.austenite_modulus"]
    h = 1e-5
    by_fraction = (
        material.stress(point.temperature, xi + h, e, p)
        - material.stress(point.temperature, xi - h, e, p)
    ) / (2.0 * h)
    assert pull == pytest.approx(by_fraction[0], rel=1e-8)
    rise = point.temperature[0] - p["environment.ambient_temperature"]
    line = (
        linear.a1(xi, p) * -e
        + p["wire.thermal_expansion_factor"] * rise
        - p["wire.maximum_recoverable_strain"] * p["wire.austenite_modulus"] * (xi - 1.0)
        + linear.a2(xi, -e, p) * xi
        + linear.a3(xi, -e, p)
    )
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
        by_kelvin = fraction(kelvin + 1e-4, sigma, parameters) - fraction(
            kelvin - 1e-4, sigma, parameters
        )
        by_stress = fraction(kelvin, sigma + 1e3, parameters) - fraction(
            kelvin, sigma - 1e3, parameters
        )
        assert -per_kelvin(kelvin, sigma, parameters) == pytest.approx(by_kelvin / 2e-4, rel=1e-6)
        assert per_pascal(kelvin, sigma, parameters) == pytest.approx(by_stress / 2e3, rel=1e-6)


@given(st.floats(0.5, 8.0))
def test_equation_19_is_the_tangent_of_the_heating(voltage: float) -> None:
    ohm, h = 2.6987, 1e-6
    capacity = WIRE["wire.mass"] * WIRE["wire.specific_heat"]
    hot, cold = (temperature_rate(330.0, voltage + k * h, WIRE) for k in (1.0, -1.0))
    tangent = linear.linear_heating(voltage + h, voltage, ohm) - linear.linear_heating(
        voltage - h, voltage, ohm
    )
    assert tangent / (2.0 * h) == pytest.approx((hot - cold) * capacity / (2.0 * h), rel=1e-6)
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
    np.testing.assert_allclose(
        again.martensite_fraction, point.martensite_fraction, atol=1e-9
    )
    # Hot enough for austenite before it cools, or cold before it warms.
    before = 1.6 * point.voltage if branch == "cooling" else 0.0 * point.voltage
    settling = 60.0 * time_constant(parameters)
    time = np.array([0.0, settling, 2.0 * settling])
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
    assert table["a_2"].printed + table["a_2"].corrected == pytest.approx(
        2.0 * (22.8e9 - 55.4e9) * 0.044 * (1.0 - 2.0 * point.martensite_fraction[0])
    )
    assert table["heating at V*"].corrected == pytest.approx(point.voltage[0] ** 2 / 2.6987)
    assert ratio["deflection per kelvin"] < 1e-6
    assert ratio["beta"] > 100.0


def test_wire_rig_has_no_bending_coefficients() -> None:
    names = {row.name for row in coefficient_table(OperatingPoint.at_voltage(WIRE, 4.6, "heating"))}
    assert "b_1" in names
    assert "alpha" not in names


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: OperatingPoint.at_deflection(COMPOSITE, 0.08, "heating"), "at most 0.07"),
        (lambda: OperatingPoint.at_deflection(COMPOSITE, -0.08, "heating"), "to the back"),
        (lambda: OperatingPoint.at_deflection(COMPOSITE, float("nan"), "heating"), "nan m"),
        (lambda: OperatingPoint.at_deflection(WIRE, 0.01, "heating"), "clamped"),
        (lambda: OperatingPoint.at_temperature(WIRE, 280.0, "heating"), "280 K lies below"),
        (lambda: coefficient_table(OperatingPoint.at_voltage(WIRE, 1.0, "heating"), 3), "wire 3"),
    ],
)
def test_impossible_operating_point_is_refused(build: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        build()
