"""Protocols: what the voltages are, and one line for every mistake."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import sma_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.audit import wire_length
from sma_bench.physics import simulate
from sma_bench.physics.operating_point import maximum_deflection
from sma_bench.protocols import load_protocol, parse_protocol, protocol_names

WIRE = Parameters.defaults()
CONFIG = Path(__file__).resolve().parents[2] / "config"
COMPOSITE = read_parameters(CONFIG / "composite_rig.yaml")


def one(step, parameters=WIRE, **document):
    return parse_protocol({"steps": [step], **document}, parameters, where="p.yaml")


def test_staircase_and_ramp_are_the_papers():
    protocol = load_protocol("staircase", WIRE)
    assert protocol.duration == pytest.approx(51 * 30.0)
    levels = protocol.voltages(np.arange(51) * 30.0 + 15.0)[:, 0]
    expected = [0.25 * k for k in range(26)] + [0.25 * k for k in range(24, -1, -1)]
    assert levels == pytest.approx(expected)
    assert protocol.step_at(25 * 30.0 + 1.0) == "up 6.25 V"
    protocol = load_protocol("ramp", WIRE)
    assert protocol.duration == pytest.approx(4 * 19.0)
    volts = protocol.voltages(np.array([3.5, 6.999, 7.0]))[:, 0]
    assert volts == pytest.approx([1.35, 2.7, 0.0], abs=1e-3)
    steps = [protocol.step_at(19.0 * k) for k in range(4)]
    assert steps == ["heat 1 of 4", "heat 2 of 4", "heat 3 of 4", "heat 4 of 4"]


@pytest.mark.parametrize("name", protocol_names())
def test_a_shipped_protocol_begins_and_ends_at_zero_and_stays_within_its_rigs_limits(name):
    composite = name.startswith("composite")
    rig = COMPOSITE if composite else WIRE
    protocol = load_protocol(name, rig)
    time, voltage = protocol.sample(0.05)
    assert not protocol.voltage(-0.1).any() and not protocol.voltage(protocol.duration).any()
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


def test_steps_drive_their_channels_at_their_own_times():
    held = one({"kind": "hold", "level": 3.0, "duration": 2.0, "drive": ["back_1"]}, COMPOSITE)
    assert held.voltage(1.0) == pytest.approx([0.0, 0.0, 3.0, 0.0])
    triangle = one({"kind": "triangle", "peak": 6.0, "rise": 2.0, "fall": 4.0})
    volts = triangle.voltages(np.array([0.0, 1.0, 2.0, 4.0, 5.0]))[:, 0]
    assert volts == pytest.approx([0.0, 3.0, 6.0, 3.0, 1.5])
    stairs = one({"kind": "staircase", "start": 1.0, "stop": 2.0, "increment": 1.0, "dwell": 0.3})
    for late in (sum([0.1] * 3), 0.3 - 1e-12):  # summed periods: 0.30000000000000004; just below
        assert stairs.voltage(late) == pytest.approx([2.0])


@given(
    start=st.integers(0, 20), stop=st.integers(0, 20), dwell=st.floats(0.1, 50.0),
    period=st.floats(0.01, 5.0),
)
@settings(max_examples=50)
def test_samples_of_any_staircase_stay_within_its_levels_and_end_at_zero(
    start, stop, dwell, period
):
    levels = {"start": start * 0.25, "stop": stop * 0.25, "increment": 0.25, "dwell": dwell}
    protocol = one({"kind": "staircase", **levels})
    time, voltage = protocol.sample(period)
    assert voltage.shape == (len(time), 1)
    assert time[-1] >= protocol.duration - 1e-6 and not voltage[-1].any()
    assert voltage.min() >= 0.0 and voltage.max() <= max(start, stop) * 0.25 + 1e-12
    assert protocol.duration == pytest.approx((abs(stop - start) + 1) * dwell)


RAMP = {"kind": "ramp", "start": 0.0, "stop": 2.0, "duration": 1.0}
STEP = {"kind": "step", "level": 1.0, "duration": 1.0}
REST = {"kind": "rest", "duration": 1.0}
STAIRS = {"kind": "staircase", "start": 0.0, "stop": 1.0, "increment": 0.3, "dwell": 1.0}
BAD_STEPS = [
    ({"kind": "rampp", "start": 0.0}, "kind is 'rampp'"),
    ({"kind": "ramp", "start": 0.0, "stop": 2.0}, "duration is missing"),
    (RAMP | {"duration": 0.0}, "duration is 0 s"),
    (RAMP | {"stop": "2 V"}, "stop is '2 V'"),
    (RAMP | {"stop": float("nan")}, "stop is nan"),
    (STEP | {"level": 12.0}, "level is 12 V, expected 0 to 10 V"),
    (STEP | {"level": 9.0}, "drives 3.33 A"),
    (STEP | {"durration": 1.0}, "did you mean duration?"),
    (STEP | {"drive": "back"}, "no channel is on that"),
    (STEP | {"drive": ["wyre"]}, "'wyre' is not one of"),
    (REST | {"drive": "all"}, "drives nothing"),
    (REST | {"duration": 1e9}, "lasts"),
    (STAIRS, "does not divide"),
    (STAIRS | {"increment": 1e-9}, "levels, expected at most"),
    ("rest", "expected a mapping with a kind"),
]


@pytest.mark.parametrize(("step", "expected"), BAD_STEPS, ids=[e for _, e in BAD_STEPS])
def test_bad_step_is_one_line_with_file_and_step(step, expected):
    with pytest.raises(InputError) as error:
        one(step)
    line = str(error.value)
    assert expected in line and "\n" not in line and line.startswith("p.yaml")


BAD_FILES = [
    ("steps: [", "not YAML"),
    ("- 1", "expected a mapping"),
    ("steps: []", "expected a list of one step"),
    ("name: x", "steps is missing"),
    ("stepps: []", "unknown key 'stepps', did you mean steps?"),
    ("steps: [{kind: rest, duration: 2024-01-01}]", "duration is datetime.date"),
]


def test_bad_file_is_one_line_with_its_path_and_an_unknown_name_names_the_known(tmp_path):
    path = tmp_path / "mine.yaml"
    for text, expected in BAD_FILES:
        path.write_text(text)
        with pytest.raises(InputError) as error:
            load_protocol(path, WIRE)
        line = str(error.value)
        assert expected in line and "\n" not in line and str(path) in line
    for name, expected in (
        (tmp_path / "none.yaml", "No such file"), ("stairs", "not one of .*staircase"),
        ("hold at 2 V\nfor 3 s", "protocol .*yaml"),  # steps in words
    ):
        with pytest.raises(InputError, match=expected) as error:
            load_protocol(name, WIRE)
        assert "\n" not in str(error.value)
    path.write_text(yaml.safe_dump({
        "name": "cycle", "repeat": 2,
        "steps": [{"kind": "hold", "name": "hot", "level": 2.0, "duration": 1.0, "repeat": 2}],
    }))
    protocol = load_protocol(path, WIRE)
    assert (protocol.name, protocol.duration) == ("cycle", 4.0)
    assert protocol.step_at(3.5) == "hot 2 of 2 2 of 2"


@given(st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["kind", "steps", "repeat", "drive", "level", "duration"])
                      | st.text(max_size=4), inner, max_size=4),
    max_leaves=12,
))
@settings(max_examples=100)
def test_any_document_is_a_protocol_or_an_input_error(document):
    try:
        parse_protocol(document, WIRE, where="p.yaml")
    except InputError as error:
        assert "\n" not in str(error)


def test_isobaric_hangs_a_wire_under_the_papers_force_unless_the_bench_has_a_load():
    protocol = load_protocol("isobaric", Parameters.defaults())
    assert (held := protocol.bench(Parameters.defaults()))["load.kind"] == "force"
    assert held["load.force"] == 1.0
    heavier = protocol.bench(Parameters.defaults().replace({"load.force": 7.0}))
    assert heavier["load.force"] == 7.0 and heavier["load.kind"] == "force"
    for bench in (Parameters.defaults().replace({"load.kind": "clamped"}), COMPOSITE):
        assert protocol.bench(bench) is bench
    triangle = load_protocol("triangle", Parameters.defaults())
    assert triangle.bench(Parameters.defaults())["load.kind"] == ""
    with pytest.raises(InputError, match="load is 'rope', expected clamped, force"):
        parse_protocol({"steps": [{"kind": "rest", "duration": 1.0}], "load": "rope"}, COMPOSITE)


def test_steps_say_what_force_the_frame_comes_to():
    steps = [
        {"kind": "rest", "name": "pull", "duration": 10.0, "force": 20.0},
        {"kind": "rest", "name": "wait", "duration": 5.0},
        {"kind": "rest", "name": "release", "duration": 5.0, "force": 0.0},
    ]
    pulled = parse_protocol({"steps": steps, "load": "force"}, WIRE)
    assert pulled.step_at(5.0) == "pull to 20 N"
    assert pulled.forces([0.0, 5.0, 12.0, 17.5], 1.0) == pytest.approx([1.0, 10.5, 20.0, 10.0])
    run = sma_bench.simulate({"steps": steps, "load": "force"}, WIRE, rate=10.0)
    assert run.force[120, 0] == pytest.approx(20.0)
    stiffness = 22.8e9 * np.pi * 0.15e-3**2 / wire_length(WIRE)
    assert run.elongation[120, 0] == pytest.approx(20.0 / stiffness, rel=1e-6)
    for change, message in (
        ({"load": ""}, "expected load: force beside the steps"),
        ({"steps": [{**steps[0], "force": -1.0}]}, "force is -1 N, expected 0 to 10000 N"),
        ({"steps": [{**steps[1], "until": "settled"}, steps[0]]}, "and no until"),
    ):
        with pytest.raises(InputError, match=message):
            parse_protocol({"steps": steps, "load": "force", **change}, WIRE)
    with pytest.raises(InputError, match="its steps hold forces, expected load.kind force"):
        sma_bench.simulate(
            {"steps": steps, "load": "force"}, WIRE.replace({"load.kind": "clamped"})
        )
