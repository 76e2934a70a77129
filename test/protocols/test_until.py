"""Protocols whose steps end when something happens."""

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
from sma_bench.protocols import Waiting, parse_protocol
from sma_bench.synthetic.bench_records import played

WIRE = Parameters.defaults()


def hold(level, seconds, until):
    return {"kind": "hold", "level": level, "duration": seconds, "until": until}


@pytest.mark.parametrize(
    "until, expected",
    [
        ({"temperature": 330.0}, "did you mean temperature_"),
        ({"settled": "range"}, "expected temperature or deflection"),
        ({"settled": True, "over": 0.0}, "expected more than 0"),
        ({"temperature_below": "cold"}, "expected a number in K"),
        ({"temperature_above": 473.15}, "maximum_temperature"),  # where the bench switches off
        ({}, "says nothing"),
        ("warm", "expected a mapping"),
    ],
)
def test_a_wrong_until_is_one_line(until, expected):
    with pytest.raises(InputError, match="step 1 .hold.: until: ") as refused:
        parse_protocol({"steps": [hold(1.0, 9.0, until)]}, WIRE)
    assert expected in str(refused.value)
    step = {"kind": "triangle", "peak": 1.0, "rise": 9.0, "fall": 9.0, "until": "settled"}
    with pytest.raises(InputError, match="a triangle ends with its time"):
        parse_protocol({"steps": [step]}, WIRE)


def test_a_simulated_step_ends_where_the_bench_gets_there_and_never_after_its_limit():
    protocol = parse_protocol({"steps": [
        {"kind": "ramp", "start": 0.0, "stop": 2.7, "duration": 70.0,
         "until": {"temperature_above": 303.15}},
        hold(1.0, 2.0, {"temperature_above": 333.15}),
        {"kind": "rest", "duration": 60.0, "until": {"temperature_below": 297.15}},
    ]}, WIRE)  # fmt: skip
    time, voltage = played(protocol, WIRE, 0.01)
    kelvin = simulate(WIRE, time, voltage).temperature[:, 0]
    ramp = np.flatnonzero(np.diff(voltage[:, 0]) < 0)[0]
    assert kelvin[ramp] < 303.15 <= kelvin[ramp + 1] and time[ramp] < 70.0
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
