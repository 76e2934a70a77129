"""Protocols: what the voltages are, and one line for every mistake."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import sma_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length
from sma_bench.protocols import load_protocol, parse_protocol, protocol_names

WIRE = Parameters.defaults()
COMPOSITE = WIRE.replace(
    {
        "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
        "bench.channel_sides": ("front", "front", "back", "back"),
    }
)


def one(step, parameters=WIRE, **document):
    return parse_protocol({"steps": [step], **document}, parameters, where="p.yaml")


def test_staircase_of_the_paper_goes_up_and_down_in_quarter_volts_of_thirty_seconds():
    protocol = load_protocol("staircase", WIRE)
    assert protocol.duration == pytest.approx(51 * 30.0)
    levels = protocol.voltages(np.arange(51) * 30.0 + 15.0)[:, 0]
    expected = [0.25 * k for k in range(26)] + [0.25 * k for k in range(24, -1, -1)]
    assert levels == pytest.approx(expected)
    assert protocol.step_at(25 * 30.0 + 1.0) == "up 6.25 V"


def test_ramp_of_the_paper_reaches_2_7_volts_in_seven_seconds_four_times():
    protocol = load_protocol("ramp", WIRE)
    assert protocol.duration == pytest.approx(4 * 19.0)
    assert protocol.voltage(3.5) == pytest.approx([1.35])
    assert protocol.voltage(6.999) == pytest.approx([2.7], abs=1e-3)
    assert protocol.voltage(7.0) == pytest.approx([0.0])
    steps = [protocol.step_at(19.0 * k) for k in range(4)]
    assert steps == ["heat 1 of 4", "heat 2 of 4", "heat 3 of 4", "heat 4 of 4"]


@pytest.mark.parametrize("name", ["composite_triangle", "composite_step"])
def test_composite_protocols_drive_one_side_at_a_time_with_rests_between(name):
    protocol = load_protocol(name, COMPOSITE)
    _, voltage = protocol.sample(0.05)
    front, back = voltage[:, :2], voltage[:, 2:]
    assert front.max() == pytest.approx(6.0) and back.max() == pytest.approx(6.0)
    assert not np.any((front.max(axis=1) > 0.0) & (back.max(axis=1) > 0.0))
    assert np.mean(voltage.max(axis=1) == 0.0) > 0.4
    assert np.array_equal(front[:, 0], front[:, 1])


def test_every_shipped_protocol_is_read_and_starts_and_ends_at_zero():
    assert set(protocol_names()) >= {"staircase", "ramp", "triangle", "composite_step"}
    for name in protocol_names():
        protocol = load_protocol(name, COMPOSITE)
        assert not protocol.voltage(-0.1).any()
        assert not protocol.voltage(protocol.duration).any()
        assert protocol.maximum_voltage <= COMPOSITE["bench.maximum_voltage"]


def test_channels_that_are_not_driven_stay_at_zero():
    protocol = one(
        {"kind": "hold", "level": 3.0, "duration": 2.0, "drive": ["back_1"]}, COMPOSITE
    )
    assert protocol.voltage(1.0) == pytest.approx([0.0, 0.0, 3.0, 0.0])


def test_triangle_rises_and_falls_at_its_own_rates():
    protocol = one({"kind": "triangle", "peak": 6.0, "rise": 2.0, "fall": 4.0})
    assert protocol.voltages(np.array([0.0, 1.0, 2.0, 4.0, 5.0]))[:, 0] == pytest.approx(
        [0.0, 3.0, 6.0, 3.0, 1.5]
    )


def test_summed_command_periods_do_not_delay_a_step():
    protocol = one({"kind": "staircase", "start": 1.0, "stop": 2.0, "increment": 1.0, "dwell": 0.3})
    period = 0.1
    late = sum([period] * 3)  # 0.30000000000000004; and just below:
    assert protocol.voltage(late) == pytest.approx([2.0])
    assert protocol.voltage(0.3 - 1e-12) == pytest.approx([2.0])


@given(
    start=st.integers(0, 20),
    stop=st.integers(0, 20),
    dwell=st.floats(0.1, 50.0),
    period=st.floats(0.01, 5.0),
)
@settings(max_examples=50, deadline=None)
def test_samples_of_any_staircase_stay_within_its_levels_and_end_at_zero(
    start, stop, dwell, period
):
    protocol = one(
        {
            "kind": "staircase",
            "start": start * 0.25,
            "stop": stop * 0.25,
            "increment": 0.25,
            "dwell": dwell,
        }
    )
    time, voltage = protocol.sample(period)
    assert voltage.shape == (len(time), 1)
    assert time[-1] >= protocol.duration - 1e-6 and not voltage[-1].any()
    assert voltage.min() >= 0.0 and voltage.max() <= max(start, stop) * 0.25 + 1e-12
    assert protocol.duration == pytest.approx((abs(stop - start) + 1) * dwell)


BAD_STEPS = [
    ({"kind": "rampp", "start": 0.0}, "kind is 'rampp'"),
    ({"kind": "ramp", "start": 0.0, "stop": 2.0}, "duration is missing"),
    ({"kind": "ramp", "start": 0.0, "stop": 2.0, "duration": 0.0}, "duration is 0 s"),
    ({"kind": "ramp", "start": 0.0, "stop": "2 V", "duration": 1.0}, "stop is '2 V'"),
    ({"kind": "ramp", "start": 0.0, "stop": float("nan"), "duration": 1.0}, "stop is nan"),
    ({"kind": "ramp", "start": 0.0, "stop": True, "duration": 1.0}, "stop is True"),
    ({"kind": "step", "level": 12.0, "duration": 1.0}, "level is 12 V, expected 0 to 10 V"),
    ({"kind": "step", "level": -1.0, "duration": 1.0}, "level is -1 V"),
    ({"kind": "step", "level": 9.0, "duration": 1.0}, "drives 3.33 A"),
    ({"kind": "step", "level": 1.0, "durration": 1.0}, "did you mean duration?"),
    ({"kind": "step", "level": 1.0, "duration": 1.0, "drive": "back"}, "no channel is on that"),
    ({"kind": "step", "level": 1.0, "duration": 1.0, "drive": ["wyre"]}, "'wyre' is not one of"),
    ({"kind": "step", "level": 1.0, "duration": 1.0, "drive": 3}, "drive is 3"),
    ({"kind": "rest", "duration": 1.0, "drive": "all"}, "drives nothing"),
    ({"kind": "rest", "duration": 1.0, "repeat": 0}, "repeat is 0"),
    ({"kind": "rest", "duration": 1e9}, "lasts"),
    (
        {"kind": "staircase", "start": 0.0, "stop": 1.0, "increment": 0.3, "dwell": 1.0},
        "does not divide",
    ),
    (
        {"kind": "staircase", "start": 0.0, "stop": 1.0, "increment": 1e-9, "dwell": 1.0},
        "levels, expected at most",
    ),
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
    ("steps: [{kind: rest, duration: 1.0}]\nrepeat: yes", "repeat is True"),
    ("steps: [{kind: rest, duration: 1.0}]\nname: 3", "name is 3"),
    ("steps: [{kind: rest, duration: 2024-01-01}]", "duration is datetime.date"),
]


@pytest.mark.parametrize(("text", "expected"), BAD_FILES, ids=[e for _, e in BAD_FILES])
def test_bad_file_is_one_line_with_its_path(tmp_path, text, expected):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_protocol(path, WIRE)
    line = str(error.value)
    assert expected in line and "\n" not in line and str(path) in line


def test_missing_file_and_unknown_name_are_told_apart(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_protocol(tmp_path / "none.yaml", WIRE)
    with pytest.raises(InputError, match="not one of .*staircase"):
        load_protocol("stairs", WIRE)


@given(st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["kind", "steps", "repeat", "drive", "level", "duration"])
                      | st.text(max_size=4), inner, max_size=4),
    max_leaves=12,
))
@settings(max_examples=150, deadline=None)
def test_any_document_is_a_protocol_or_an_input_error(document):
    try:
        parse_protocol(document, WIRE, where="p.yaml")
    except InputError as error:
        assert "\n" not in str(error)


def test_a_file_may_carry_its_own_name_and_repeat(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({
        "name": "cycle", "repeat": 2,
        "steps": [{"kind": "hold", "name": "hot", "level": 2.0, "duration": 1.0, "repeat": 2}],
    }))
    protocol = load_protocol(path, WIRE)
    assert (protocol.name, protocol.duration) == ("cycle", 4.0)
    assert protocol.step_at(3.5) == "hot 2 of 2 2 of 2"


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
