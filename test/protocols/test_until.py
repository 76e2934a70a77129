"""Protocols whose steps end when something happens, and their form in words."""

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.protocols import Waiting, load_protocol, parse_protocol
from sma_bench.synthetic.bench_records import played

WIRE = Parameters.defaults()
FOUR = Parameters({
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
})  # fmt: skip


def lines(protocol):
    """Of every step: seconds, and volts of the channels at its start and end."""
    return [(s.duration, s.start, s.stop) for s in protocol.segments]


def test_words_and_a_file_are_the_same_protocol(tmp_path):
    words = "ramp to 2.7 V in 7 s; hold until settled, 60 s at most; three times"
    (tmp_path / "said.txt").write_text(words.replace("; ", "\n") + "  # as agreed\n")
    (tmp_path / "said.yaml").write_text(f"steps: {words}\n")
    written = parse_protocol({"repeat": 3, "steps": [
        {"kind": "ramp", "start": 0.0, "stop": 2.7, "duration": 7.0},
        {"kind": "hold", "level": 2.7, "duration": 60.0, "until": "settled"},
    ]}, WIRE)  # fmt: skip
    for told in (words, tmp_path / "said.txt", tmp_path / "said.yaml"):
        assert load_protocol(told, WIRE).segments == written.segments
    assert written.length == "201 s at most" and len(written.segments) == 6


def test_a_sentence_goes_on_with_the_wires_and_the_level_of_the_last_one():
    spoken = load_protocol(
        "ramp the front to 3 V in 2 s; hold for 1 min; step back_1 and back_2 to 1.5 V for 500 ms; "
        "rest for 1 s; stairs to 2 V by 1 V, 4 s each; triangle to 4 V, 3 s up and 2 s down",
        FOUR,
    )
    zero, front, back = (0.0,) * 4, (3.0, 3.0, 0.0, 0.0), (0.0, 0.0, 1.5, 1.5)
    assert lines(spoken) == [
        (2.0, zero, front), (60.0, front, front), (0.5, back, back), (1.0, zero, zero),
        (4.0, zero, zero), (4.0, (1.0,) * 4, (1.0,) * 4), (4.0, (2.0,) * 4, (2.0,) * 4),
        (3.0, zero, (4.0,) * 4), (2.0, (4.0,) * 4, zero),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "words, expected",
    [
        ("until above 57 degC", {"above": {"temperature": 330.15}}),
        ("until the temperature is above 330 K or the deflection is below -5 mm",
         {"above": {"temperature": 330.0}, "below": {"deflection": -0.005}}),
        ("until temperature settled over 2 s", {"settled": ("temperature",), "over": 2.0}),
    ],
)  # fmt: skip
def test_conditions_are_read_in_the_units_that_people_say(words, expected):
    until = load_protocol(f"hold at 2 V {words}, at most 9 s", FOUR).segments[0].until
    assert {name: getattr(until, name) for name in expected} == {
        name: pytest.approx(value) if isinstance(value, dict) else value
        for name, value in expected.items()
    }


@pytest.mark.parametrize(
    "words, expected",
    [
        ("ramp to 2.7 V", "'in' is missing"),
        ("hold at 3 V until settled", "expected e.g. 60 s at most"),
        ("hold at 3 V untill settled, 9 s at most", "'untill' is not understood, did you mean"),
        ("hold back_3 at 3 V for 9 s", "did you mean back_"),
        ("ramp to 2.7 V in 7 s, until above 57 degC; hold for 3 s", "say the level"),
        ("ramp to 2.7 kV in 7 s", "2.7 kv: expected a number in v or mv"),
        ("jump to 3 V for 9 s", "begins with none of ramp, hold"),
        ("hold at 2 V until warm, 9 s at most", "until 'warm': expected settled"),
        ("hold at 2 V until above 200 degC, 9 s at most", "where the bench switches off"),
        ("hold at 20 V for 3 s", "expected 0 to 10 V"),
        ("three times", "no step"),
    ],
)
def test_a_sentence_that_is_not_understood_is_quoted(words, expected):
    with pytest.raises(InputError, match="protocol: ") as refused:
        load_protocol(words, FOUR)
    assert expected in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "until, expected",
    [
        ({"temperature": 330.0}, "did you mean temperature_"),
        ({"settled": "range"}, "expected temperature or deflection"),
        ({"settled": True, "over": 0.0}, "expected more than 0"),
        ({"temperature_below": "cold"}, "expected a number in K"),
        ({}, "says nothing"),
        ("warm", "expected a mapping"),
    ],
)
def test_a_wrong_until_is_one_line(until, expected):
    step = {"kind": "hold", "level": 1.0, "duration": 9.0, "until": until}
    with pytest.raises(InputError, match="step 1 .hold.: until: ") as refused:
        parse_protocol({"steps": [step]}, WIRE)
    assert expected in str(refused.value)


def test_a_triangle_waits_for_nothing():
    step = {"kind": "triangle", "peak": 1.0, "rise": 9.0, "fall": 9.0, "until": "settled"}
    with pytest.raises(InputError, match="a triangle ends with its time"):
        parse_protocol({"steps": [step]}, WIRE)


def test_a_simulated_step_ends_where_the_bench_gets_there_and_never_after_its_limit():
    from sma_bench.physics import simulate

    spoken = load_protocol(
        "ramp to 2.7 V in 70 s, until above 30 degC; hold at 1 V until above 60 degC, 2 s at most; "
        "rest until below 24 degC, 60 s at most", WIRE,
    )  # fmt: skip
    time, voltage = played(spoken, WIRE, 0.01)
    kelvin = simulate(WIRE, time, voltage).temperature[:, 0]
    ramp = np.flatnonzero(np.diff(voltage[:, 0]) < 0)[0]
    assert kelvin[ramp] < 303.15 <= kelvin[ramp + 1] and time[ramp] < 70.0
    held = np.count_nonzero(voltage[:, 0] == 1.0)
    assert held == pytest.approx(200, abs=1)  # its limit: 1 V never gets there
    assert voltage[-1] == 0.0 and 297.0 < kelvin[-2] < 297.3


def test_settled_means_no_slope_above_the_noise():
    """A wire of 10 s, read 25 times a second with the camera's noise."""
    spoken = load_protocol("hold at 2 V until settled, 300 s at most", WIRE)
    waiting, random = Waiting(spoken), np.random.default_rng(1)
    for k in range(25 * 300):
        time = k / 25
        kelvin = 340.0 - 40.0 * np.exp(-time / 10.0)
        waiting.heard("temperature", "wire", kelvin + random.normal(0.0, 0.08), time)
        if waiting.passed_over(time, time):
            break
    assert 340.0 - kelvin < 1.0 and 20.0 < time < 80.0
