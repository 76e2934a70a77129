"""Protocols and references: what the levels are, when a step ends, one line for every mistake."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import sma_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.parameters import wire_length
from sma_bench.physics import simulate
from sma_bench.physics.linearised import maximum_deflection
from sma_bench.protocols import DEFLECTION, TEMPERATURE, Waiting, load_protocol, parse_protocol
from sma_bench.protocols import protocol_names as shipped
from sma_bench.synthetic.bench_records import played

WIRE = Parameters.defaults()
CONFIG = Path(__file__).resolve().parents[2] / "config"
COMPOSITE = read_parameters(CONFIG / "composite_rig.yaml")
REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text())


def one(step, parameters=WIRE, **document):
    return parse_protocol({"steps": [step], **document}, parameters, where="p.yaml")


def hold(level, seconds, until):
    return {"kind": "hold", "level": level, "duration": seconds, "until": until}


def refused(said, read, *given):
    with pytest.raises(InputError) as error:
        read(*given)
    line = str(error.value)
    assert said in line and "\n" not in line, line
    return line


def test_staircase_and_ramp_are_the_papers():
    protocol = load_protocol("staircase", WIRE)
    assert protocol.duration == pytest.approx(51 * 30.0)
    levels = protocol.levels(np.arange(51) * 30.0 + 15.0)[:, 0]
    assert levels == pytest.approx(6.25 - 0.25 * np.abs(np.arange(51) - 25))
    assert protocol.step_at(25 * 30.0 + 1.0) == "up 6.25 V"
    protocol = load_protocol("ramp", WIRE)
    assert protocol.duration == pytest.approx(4 * 19.0)
    volts = protocol.levels(np.array([3.5, 6.999, 7.0]))[:, 0]
    assert volts == pytest.approx([1.35, 2.7, 0.0], abs=1e-3)
    assert [protocol.step_at(19.0 * k) for k in (0, 3)] == ["heat 1 of 4", "heat 4 of 4"]


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_protocol_begins_and_ends_at_zero_and_stays_within_its_rigs_limits(name):
    composite = name.startswith("composite")
    rig = COMPOSITE if composite else WIRE
    protocol = load_protocol(name, rig)
    time, voltage = protocol.sample(0.05)
    assert not protocol.level(-0.1).any() and not protocol.level(protocol.duration).any()
    run = simulate(rig, time, voltage)
    assert 1.0 < run.voltage.max() <= rig["bench.maximum_voltage"]
    assert run.current.max() < rig["bench.maximum_current"]
    assert run.temperature.max() < rig["bench.maximum_temperature"]
    if composite:  # one side at a time, its wires alike
        front, back = voltage[:, :2], voltage[:, 2:]
        assert not np.any((front.max(axis=1) > 0.0) & (back.max(axis=1) > 0.0))
        assert np.array_equal(front[:, 0], front[:, 1])
    if name == "isobaric":  # the whole transformation at 200 MPa
        shift = 200e6 / WIRE["wire.stress_influence_austenite"]
        finish = WIRE["wire.austenite_finish_temperature"]
        assert run.temperature.max() > finish + shift + 10.0
        assert run.temperature[-1, 0] < WIRE["wire.martensite_finish_temperature"]
    if name == "thermal_expansion":
        assert 320.0 < run.temperature.max() < WIRE["wire.austenite_start_temperature"] - 4.0
    if name == "composite_operating_point":  # small steps about half of the way
        steps = (run.voltage[:, 0] >= 4.6) & (run.time < 65.0)
        half = 0.5 * maximum_deflection(COMPOSITE)
        assert run.deflection[steps].min() < half < run.deflection[steps].max()
        assert np.all(np.diff(run.deflection[steps]) >= -1e-12)


def test_steps_drive_their_channels_at_their_own_times(tmp_path):
    held = one({"kind": "hold", "level": 3.0, "duration": 2.0, "drive": ["back_1"]}, COMPOSITE)
    assert held.level(1.0) == pytest.approx([0.0, 0.0, 3.0, 0.0])
    triangle = one({"kind": "triangle", "peak": 6.0, "rise": 2.0, "fall": 4.0})
    volts = triangle.levels(np.array([0.0, 1.0, 2.0, 4.0, 5.0]))[:, 0]
    assert volts == pytest.approx([0.0, 3.0, 6.0, 3.0, 1.5])
    stairs = one({"kind": "staircase", "start": 1.0, "stop": 2.0, "increment": 1.0, "dwell": 0.3})
    for late in (sum([0.1] * 3), 0.3 - 1e-12):  # summed periods: 0.30000000000000004; just below
        assert stairs.level(late) == pytest.approx([2.0])
    path = tmp_path / "cycle.yaml"
    hot = {"kind": "hold", "name": "hot", "level": 2.0, "duration": 1.0, "repeat": 2}
    path.write_text(yaml.safe_dump({"name": "cycle", "repeat": 2, "steps": [hot]}))
    protocol = load_protocol(path, WIRE)
    assert (protocol.name, protocol.duration) == ("cycle", 4.0)
    assert protocol.step_at(3.5) == "hot 2 of 2 2 of 2"


@given(st.integers(0, 20), st.integers(0, 20), st.floats(0.1, 50.0), st.floats(0.05, 5.0))
@settings(max_examples=30)
def test_any_staircase_stays_within_its_levels_and_ends_at_zero(start, stop, dwell, period):
    levels = {"start": start * 0.25, "stop": stop * 0.25, "increment": 0.25, "dwell": dwell}
    protocol = one({"kind": "staircase", **levels})
    time, voltage = protocol.sample(period)
    assert voltage.shape == (len(time), 1)
    assert time[-1] >= protocol.duration - 1e-6 and not voltage[-1].any()
    assert voltage.min() >= 0.0 and voltage.max() <= max(start, stop) * 0.25 + 1e-12
    assert protocol.duration == pytest.approx((abs(stop - start) + 1) * dwell)


def test_a_mistake_is_one_line_with_its_file_and_step(tmp_path):
    for step, said in REFUSED["steps"]:
        assert refused(said, one, step).startswith("p.yaml")
    for until, said in REFUSED["until"]:
        assert "step 1 (hold): until: " in refused(said, one, hold(1.0, 9.0, until))
    path = tmp_path / "mine.yaml"
    for text, said in REFUSED["files"]:
        path.write_text(text)
        assert str(path) in refused(said, load_protocol, path, WIRE)
    for name, said in (
        (tmp_path / "none.yaml", "No such file"), ("stairs", "not one of "),
        ("hold at 2 V\nfor 3 s", "yaml"), ("hold at 1 V " * 40, "yaml"),  # steps in words
        (tmp_path / f"{'x' * 400}.yaml", "too long"),
    ):  # fmt: skip
        line = refused(said, load_protocol, name, WIRE)
        assert name != "stairs" or "staircase" in line
    for document, said in REFUSED["references"]:
        refused(said, parse_protocol, document, WIRE, "r.yaml", "", TEMPERATURE)
    line = refused("reference stairs: not one of ", load_protocol, "stairs", WIRE, TEMPERATURE)
    assert "temperature_staircase" in line


def test_isobaric_hangs_a_wire_under_the_papers_force_unless_the_bench_has_a_load():
    protocol = load_protocol("isobaric", WIRE)
    for stated, force in (({}, 1.0), ({"load.force": 7.0}, 7.0)):
        held = protocol.bench(WIRE.replace(stated))
        assert (held["load.kind"], held["load.force"]) == ("force", force)
    for bench in (WIRE.replace({"load.kind": "clamped"}), COMPOSITE):
        assert protocol.bench(bench) is bench
    assert load_protocol("triangle", WIRE).bench(WIRE)["load.kind"] == ""
    rope = {"steps": [{"kind": "rest", "duration": 1.0}], "load": "rope"}
    refused("load is 'rope', expected clamped, displacement", parse_protocol, rope, COMPOSITE)


def test_steps_set_the_force_that_the_frame_reaches():
    steps = [{"kind": "rest", "name": "pull", "duration": 10.0, "force": 20.0},
             {"kind": "rest", "name": "wait", "duration": 5.0},
             {"kind": "rest", "name": "release", "duration": 5.0, "force": 0.0}]  # fmt: skip
    document = {"steps": steps, "load": "force"}
    pulled = parse_protocol(document, WIRE)
    assert pulled.step_at(5.0) == "pull to 20 N"
    assert pulled.forces([0.0, 5.0, 12.0, 17.5], 1.0) == pytest.approx([1.0, 10.5, 20.0, 10.0])
    run = sma_bench.simulate(document, WIRE, rate=10.0)
    assert run.force[120, 0] == pytest.approx(20.0)
    stiffness = 22.8e9 * np.pi * 0.15e-3**2 / wire_length(WIRE)
    assert run.elongation[120, 0] == pytest.approx(20.0 / stiffness, rel=1e-6)
    for change, said in (
        ({"load": ""}, "expected load: force beside the steps"),
        ({"steps": [{**steps[0], "force": -1.0}]}, "force is -1 N, expected 0 to 10000 N"),
        ({"steps": [{**steps[1], "until": "settled"}, steps[0]]}, "and no until"),
    ):
        refused(said, parse_protocol, document | change, WIRE)
    clamped = WIRE.replace({"load.kind": "clamped"})
    said = "its steps hold forces, expected load.kind force"
    refused(said, sma_bench.simulate, document, clamped)


def test_references_are_of_kelvin_and_of_metres_and_rest_at_ambient():
    reference = load_protocol("temperature_staircase", WIRE, TEMPERATURE)  # of E8
    assert reference.duration == pytest.approx(115.0)
    levels = np.array([reference.level(t)[0] for t in np.arange(11) * 10.0 + 5.0])
    np.testing.assert_allclose(levels, [*np.arange(303.15, 329, 5), *np.arange(323.15, 303, -5)])
    assert levels.max() < WIRE["wire.austenite_start_temperature"]
    assert reference.level(-1.0) == reference.level(112.0) == reference.level(200.0) == 296.15
    assert reference.step_at(15.0) == "up 308.15 K"
    reference = load_protocol("deflection_triangle", COMPOSITE, DEFLECTION)
    assert reference.channels == ("tip",)
    metres = [reference.level(t)[0] for t in (0.0, 10.0, 15.0, 25.0, 40.0)]
    assert metres == pytest.approx([0.0, 0.03, 0.015, 0.0, -0.03])
    step = {"kind": "triangle", "peak": 310.0, "rise": 1.0, "fall": 1.0, "drive": "back"}
    reference = parse_protocol({"unit": "K", "steps": [step]}, COMPOSITE, quantity=TEMPERATURE)
    np.testing.assert_allclose(reference.level(0.5), [296.15, 296.15, 303.075, 303.075])
    for name in shipped(TEMPERATURE):  # read by one quantity and refused by the other
        own, other = (TEMPERATURE, DEFLECTION) if "temp" in name else (DEFLECTION, TEMPERATURE)
        load_protocol(name, COMPOSITE, own)
        refused(f"expected {other.unit}", load_protocol, name, COMPOSITE, other)


def test_a_simulated_step_ends_where_the_bench_gets_there_and_never_after_its_limit():
    warm, ramp = {"temperature_above": 303.15}, {"start": 0.0, "stop": 2.7, "duration": 70.0}
    protocol = parse_protocol({"steps": [{"kind": "ramp", **ramp, "until": warm},
                                         hold(1.0, 2.0, {"temperature_above": 333.15}),
                                         {"kind": "rest", "duration": 60.0,
                                          "until": {"temperature_below": 297.15}}]}, WIRE)
    time, voltage = played(protocol, WIRE, 0.01)
    kelvin = simulate(WIRE, time, voltage).temperature[:, 0]
    end = np.flatnonzero(np.diff(voltage[:, 0]) < 0)[0]
    assert kelvin[end] < 303.15 <= kelvin[end + 1] and time[end] < 70.0
    held = np.count_nonzero(voltage[:, 0] == 1.0)
    assert held == pytest.approx(200, abs=1)  # its limit: 1 V never gets there
    assert voltage[-1] == 0.0 and 297.0 < kelvin[-2] < 297.3


def test_settled_means_no_slope_above_the_noise():
    """A wire of 10 s, read 25 times a second with the camera's noise."""
    protocol = parse_protocol({"steps": [hold(2.0, 300.0, "settled")]}, WIRE)
    waiting, random = Waiting(protocol), np.random.default_rng(1)
    for k in range(25 * 300):
        time = k / 25
        kelvin = 340.0 - 40.0 * np.exp(-time / 10.0)
        waiting.heard("temperature", "wire", kelvin + random.normal(0.0, 0.08), time)
        if waiting.passed_over(time, time):
            break
    assert 340.0 - kelvin < 1.0 and 20.0 < time < 80.0


@pytest.mark.parametrize(("settled", "ends"), [("deflection", True), ("temperature", False),
                                               (True, False)])
def test_only_quantities_named_by_a_step_must_settle(settled, ends):
    waiting = Waiting(parse_protocol({"steps": [hold(2.0, 60.0, {"settled": settled})]}, WIRE))

    def is_over(time):
        waiting.heard("temperature", "wire", 300.0 + time, time)
        waiting.heard("deflection", "", 0.01, time)
        return waiting.passed_over(time, time) > 0.0

    assert any(is_over(k / 25) for k in range(25 * 50)) == ends
