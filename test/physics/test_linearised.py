"""The linearised model against numerical differentiation of the nonlinear one, on both rigs."""

import numpy as np
import pytest
from effect_references import FOUR, full_loop
from scipy.signal import lsim

from sma_bench.errors import InputError
from sma_bench.paper.printed import coefficient_table
from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, material, simulate
from sma_bench.physics.linearised import OperatingPoint, linearise, maximum_deflection
from sma_bench.physics.material import time_constant

WIRE = Parameters.of_paper()
COMPOSITE = WIRE.replace(FOUR)
UNLIKE = COMPOSITE.replace({"composite.stress_per_deflection_back": 2e9})
BRANCHES = ("heating", "cooling")


def assert_tangent(point, weights, time, tolerance=2e-6, latent_heat=0.0):
    """Compare the linear step response (n, 1 + 2 w), which is returned, with the nonlinear one.
    `tolerance`: relative to the largest value of each kind of output."""
    direction = weights if point.branch == "heating" else -weights
    rig = point.parameters.replace({"effect.latent_heat.heat": latent_heat})

    def change(step):
        """(n, 1 + 2 w) change of the nonlinear model's outputs per volt."""
        voltage = np.tile(point.voltage + step * direction, (time.size, 1))
        run = simulate(rig, time, voltage, initial=point, boundary=point.boundary)
        outputs = np.column_stack([run.deflection, run.temperature, run.stress])
        return (outputs - outputs[0]) / step

    system = linearise(point, latent_heat).state_space()
    actual = lsim(system, np.tile(direction, (time.size, 1)), time)[1]
    expected = (8.0 * change(1e-4) - 6.0 * change(2e-4) + change(4e-4)) / 3.0  # extrapolated
    wires = (actual.shape[1] - 1) // 2
    kinds = (slice(0, 1), slice(1, 1 + wires), slice(1 + wires, None))
    for columns, smallest in zip(kinds, (1e-4, 1.0, 1e5), strict=True):
        scale = max(np.abs(expected[:, columns]).max(), smallest)
        assert np.abs(actual[:, columns] - expected[:, columns]).max() < tolerance * scale
    return actual


def few_time_constants(parameters):
    return np.linspace(0.0, 4.0, 15) * time_constant(parameters)


@pytest.mark.parametrize("branch", BRANCHES)
@pytest.mark.parametrize(("rig", "held"), [(WIRE, 0.0), (WIRE, 50e6), (UNLIKE, 0.0)])
def test_step_response_is_the_derivative_of_the_nonlinear_model(rig, held, branch):
    """Within partial loops, with different wires."""
    time, wires = np.arange(0.0, 60.0, 0.05), len(rig["bench.channels"])
    voltage = 4.6 + 0.8 * np.sin(np.outer(time, 2.0 + 0.05 * np.arange(wires)))
    boundary = Boundary.held_stress(held) if held else Boundary.of(rig)
    run = simulate(rig, time, voltage, boundary=boundary)
    ramp = full_loop(rig, run.temperature, run.stress)[BRANCHES.index(branch)]
    xi = run.martensite_fraction
    moving = (ramp > 0.01) & (ramp < 0.99) & (xi > 0.02) & (xi < 0.98)
    inside = np.flatnonzero(moving.all(axis=1))
    assert inside.size > 40
    for k in inside[:: inside.size // 6]:
        point = OperatingPoint.of_state(rig, run.temperature[k], xi[k], branch, boundary)
        assert_tangent(point, np.linspace(0.3, 1.0, wires), few_time_constants(rig))


PAIR = {"bench.channels": ("a", "b"), "bench.channel_sides": ("front", "back")}
DUTY = {"bench.drive": "duty", "bench.supply_voltage": 12.0, "bench.lead_resistance": 0.3}
SPRING = {"load.kind": "spring", "load.stiffness": 900.0, "load.preload": 5.0}
LOADS = {"force, duty": {"load.kind": "force", "load.force": 9.0, **DUTY},
         "spring, power": {**SPRING, "bench.drive": "power", "bench.lead_resistance": 0.3},
         "spring, current": {**SPRING, "bench.drive": "current", "wire.count": 2},
         "antagonist, duty": {**SPRING, "load.kind": "antagonist", **PAIR, **DUTY},
         "beam, front": FOUR,
         "beam, back": {**FOUR, "composite.stress_per_deflection_back": 3e9}}  # fmt: skip


@pytest.mark.parametrize("branch", BRANCHES)
@pytest.mark.parametrize("load", LOADS)
def test_operating_points_are_steady_for_any_load_and_drive(load, branch):
    rig = WIRE.replace(LOADS[load])
    sign = 1.0 if "antagonist" in load or "front" in load else -1.0
    side = "back" if "back" in load else "front"
    wanted = sign * 0.4 * maximum_deflection(rig, side)
    point = OperatingPoint.at_deflection(rig, wanted, branch)
    assert point.deflection == pytest.approx(wanted, rel=1e-8)
    again = OperatingPoint.at_voltage(rig, point.voltage, branch)
    assert again.martensite_fraction == pytest.approx(point.martensite_fraction, abs=1e-8)
    held = np.tile(point.voltage, (3, 1))
    run = simulate(rig, np.arange(3) * 60.0, held, initial=point)
    assert run.deflection[-1] == pytest.approx(wanted, rel=1e-6)
    weights = np.where(point.voltage > 0.0, 0.7, 0.0)
    assert_tangent(point, weights, few_time_constants(rig))


@pytest.mark.compiled
def test_latent_heat_slows_the_linear_model_as_it_slows_the_nonlinear_one():
    point = OperatingPoint.at_deflection(COMPOSITE, 0.5 * maximum_deflection(COMPOSITE), "heating")
    time = np.linspace(0.0, 1.0, 20001)
    with_heat = assert_tangent(point, np.ones(4), time, 2e-4, 10e3)
    without = assert_tangent(point, np.ones(4), time)
    early = np.searchsorted(time, 0.1)
    assert with_heat[early, 0] < 0.5 * without[early, 0]


def test_printed_and_corrected_coefficients_at_half_of_the_maximum_deflection():
    point = OperatingPoint.at_deflection(COMPOSITE, 0.5 * maximum_deflection(COMPOSITE), "heating")
    table = {row.name: row for row in coefficient_table(point)}
    ratio = {name: row.printed / row.corrected for name, row in table.items()}
    assert ratio["a_1"] == ratio["b_2"] == ratio["b_4"] == 1.0
    assert ratio["heating per volt"] == -1.0
    assert ratio["b_1"] == pytest.approx((353.61 - 331.81) / np.pi)
    assert ratio["b_3"] == pytest.approx((353.39 - 325.09) / np.pi)
    assert ratio["b_1 of stress"] == pytest.approx(7.0e6 * (353.61 - 331.81) / np.pi)
    # Twice the integral of eq. (16), for wires as a sheet as wide as the beam.
    assert ratio["alpha"] == pytest.approx(2.0 * 1.05574 / 1.71405, rel=1e-5)
    both = 2.0 * (22.8e9 - 55.4e9) * 0.044 * (1.0 - 2.0 * point.martensite_fraction[0])
    assert table["a_2"].printed + table["a_2"].corrected == pytest.approx(both)
    assert table["heating at V*"].corrected == pytest.approx(point.voltage[0] ** 2 / 2.6987)
    assert ratio["deflection per kelvin"] < 1e-6 and ratio["beta"] > 100.0
    duty = WIRE.replace({"bench.drive": "duty", "bench.supply_voltage": 24.0})
    point = OperatingPoint.at_temperature(duty, 340.0, "heating")
    table = {row.name: row.corrected for row in coefficient_table(point)}
    assert table["heating at V*"] == pytest.approx(material.heat_loss(duty) * (340.0 - 296.15))
    assert table["heating per volt"] == pytest.approx(24.0 / 2.6987)


@pytest.mark.parametrize(("rig", "metres", "message"), [
    (COMPOSITE, 0.08, "at most 0.07"), (COMPOSITE, -0.08, "to the back"), (WIRE, 0.01, "clamped"),
    (WIRE.replace(SPRING), 1e-3, "a wire with a load only shortens"),
    (WIRE.replace(SPRING), -0.05, "expected at most"),
])  # fmt: skip
def test_impossible_operating_point_is_refused(rig, metres, message):
    with pytest.raises(InputError, match=message):
        OperatingPoint.at_deflection(rig, metres, "heating")


def test_where_stress_drives_the_transformation_by_itself_there_is_no_tangent():
    rig = WIRE.replace({"wire.martensite_modulus": 200e9, "wire.austenite_modulus": 20e9})
    stress = material.stress(340.0, 0.1, 0.0, rig)
    kelvin = 345.0 + float(stress) / rig["wire.stress_influence_austenite"]
    point = OperatingPoint.of_state(rig, kelvin, 0.1, "heating")
    with pytest.raises(InputError, match="stress drives the transformation by itself"):
        linearise(point)
