"""The linearised model against numerical differentiation of the nonlinear one, on both rigs."""

import numpy as np
import pytest
from effect_references import FOUR
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from sma_bench.errors import InputError
from sma_bench.paper.printed import coefficient_table
from sma_bench.parameters import TABLE, Parameters
from sma_bench.parameters.parameters import SMOOTHER
from sma_bench.physics import Boundary, material, simulate
from sma_bench.physics.linearised import OperatingPoint, linearise, maximum_deflection
from sma_bench.physics.material import time_constant

WIRE = Parameters.of_paper()
COMPOSITE = WIRE.replace(FOUR)
GIVEN = ("composite.deflection_per", "composite.stress_per", *SMOOTHER,
         "wire.end_length", "wire.transition_skew", "wire.least", "wire.r_phase")  # fmt: skip
DRAWN = ("wire.", "env", "comp")
UNCERTAIN = [p.name for p in TABLE if p.uncertainty and p.name.startswith(DRAWN)]
UNCERTAIN = [name for name in UNCERTAIN if not name.startswith(GIVEN)]
BRANCHES = ("heating", "cooling")
WHOLE = {"s": "start", "f": "finish"}
FAST = settings(max_examples=25, deadline=None, derandomize=True)


@st.composite
def rigs(draw, base=COMPOSITE):
    """Parameters up to two standard deviations off, the sides of the composite unlike."""
    values = {n: base[n] + draw(st.floats(-2.0, 2.0)) * base.std(n) for n in UNCERTAIN}
    values["composite.stress_per_deflection_back"] = draw(st.floats(1e9, 4e9))
    return base.replace(values)


@st.composite
def points(draw, base):
    """Anywhere inside the transformation, on the full loop or in a partial one, wires unlike."""
    p = draw(rigs(base))
    wires = len(p["bench.channels"])
    part, fraction = np.array(draw(st.lists(
        st.lists(st.floats(0.05, 0.95), min_size=wires, max_size=wires), min_size=2, max_size=2
    )))  # fmt: skip
    branch = draw(st.sampled_from(BRANCHES))
    boundary, stress = None, material.stress(340.0, fraction, 0.0, p)
    if wires == 1 and draw(st.booleans()):
        boundary, stress = Boundary.held_stress(50e6), 50e6
    elif wires == 4:  # two wires on either side share its load
        pairs = material.modulus(fraction, p).reshape(2, 2)
        stiffness = pairs.sum(axis=1) + np.array(Boundary.of(p).stiffness)
        shorter = stress.reshape(2, 2).sum(axis=1) / stiffness
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


def assert_tangent(point, weights, time, tolerance=2e-6, latent_heat=0.0):
    """The step response (n, 1 + 2 w), to the largest nonlinear one of each kind of output."""
    direction = weights if point.branch == "heating" else -weights
    rig = point.parameters.replace({"effect.latent_heat.heat": latent_heat})

    def change(step):
        """(n, 1 + 2 w) of the outputs of the nonlinear model, a volt."""
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


@pytest.mark.parametrize("base", [WIRE, COMPOSITE], ids=["wire rig", "composite rig"])
def test_step_response_is_the_derivative_of_the_nonlinear_model(base):
    @FAST
    @given(points(base), st.lists(st.floats(0.2, 1.0), min_size=4, max_size=4))
    def check(point, weights):
        time = few_time_constants(point.parameters)
        assert_tangent(point, np.array(weights[: point.voltage.size]), time)

    check()


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
def test_any_load_and_drive_at_rest_where_it_is_linearised(load, branch):
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


def test_a_duty_heats_the_corrected_coefficients_as_it_heats_the_wire():
    bench = WIRE.replace({"bench.drive": "duty", "bench.supply_voltage": 24.0})
    point = OperatingPoint.at_temperature(bench, 340.0, "heating")
    table = {row.name: row.corrected for row in coefficient_table(point)}
    loss = material.heat_loss(bench) * (340.0 - bench["environment.ambient_temperature"])
    assert table["heating at V*"] == pytest.approx(loss)
    assert table["heating per volt"] == pytest.approx(24.0 / bench["wire.resistance"])


def test_printed_and_corrected_coefficients_at_half_of_the_maximum_deflection():
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
    both = 2.0 * (22.8e9 - 55.4e9) * 0.044 * (1.0 - 2.0 * point.martensite_fraction[0])
    assert table["a_2"].printed + table["a_2"].corrected == pytest.approx(both)
    assert table["heating at V*"].corrected == pytest.approx(point.voltage[0] ** 2 / 2.6987)
    assert ratio["deflection per kelvin"] < 1e-6 and ratio["beta"] > 100.0


@pytest.mark.parametrize(("rig", "metres", "message"), [
    (COMPOSITE, 0.08, "at most 0.07"), (COMPOSITE, -0.08, "to the back"), (WIRE, 0.01, "clamped"),
    (WIRE.replace(SPRING), 1e-3, "a wire with a load only shortens"),
    (WIRE.replace(SPRING), -0.05, "expected at most"),
])  # fmt: skip
def test_impossible_operating_point_is_refused(rig, metres, message):
    with pytest.raises(InputError, match=message):
        OperatingPoint.at_deflection(rig, metres, "heating")


def test_where_stress_drives_the_transformation_by_itself_there_is_no_tangent():
    soft = {"wire.martensite_modulus": 200e9, "wire.austenite_modulus": 20e9}
    rig = WIRE.replace(soft)
    stress = material.stress(340.0, 0.1, 0.0, rig)
    kelvin = 345.0 + float(stress) / rig["wire.stress_influence_austenite"]
    point = OperatingPoint.of_state(rig, kelvin, 0.1, "heating")
    with pytest.raises(InputError, match="stress drives the transformation by itself"):
        linearise(point)
