"""The PI controller by itself: tuning, limits, anti-windup, bumpless start."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.control.temperature import PI, Gains, OutputLimits
from sma_bench.errors import InputError

numbers = st.floats(-1e3, 1e3)


def lag_response(loop: PI, reference: float, gain: float, tau: float, seconds: float) -> np.ndarray:
    """Outputs of a first-order lag under the loop, every 0.01 s."""
    y, values = 0.0, []
    decay = math.exp(-0.01 / tau)
    for _ in range(round(seconds / 0.01)):
        values.append(y)
        u = loop.step(reference, y, 0.01)
        y = gain * u + (y - gain * u) * decay
    return np.array(values)


def test_simc_answers_a_step_like_the_wanted_lag_without_overshoot() -> None:
    gains = Gains.simc(gain=6.0, time_constant=0.2, delay=0.005, closed_loop_time=0.1)
    assert gains.integral_time == 0.2
    assert gains.proportional == pytest.approx(0.2 / (6.0 * 0.105))
    y = lag_response(PI(gains, OutputLimits(0.0, 100.0)), 10.0, 6.0, 0.2, 2.0)
    assert y.max() < 10.1
    assert y[round(0.105 / 0.01)] == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=0.05)


def test_simc_shortens_the_integral_time_of_a_slow_plant() -> None:
    assert Gains.simc(1.0, 10.0, 0.1, 0.4).integral_time == pytest.approx(2.0)


def test_anti_windup_leaves_saturation_at_once() -> None:
    gains = Gains.simc(6.0, 0.2, 0.005)
    limited = lag_response(PI(gains, OutputLimits(0.0, 3.0)), 15.0, 6.0, 0.2, 3.0)
    assert limited.max() < 15.0 * 1.02
    wound_up = PI(Gains(gains.proportional, gains.integral_time, 1e6), OutputLimits(0.0, 3.0))
    assert lag_response(wound_up, 15.0, 6.0, 0.2, 3.0).max() > 15.0 * 1.05


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=30), st.floats(0.1, 50.0))
def test_output_never_leaves_its_range_nor_exceeds_its_rate(
    steps: list[tuple[float, float]], rate: float
) -> None:
    loop, last = PI(Gains(2.0, 0.3), OutputLimits(0.0, 10.0, rate)), 0.0
    for reference, measured in steps:
        output = loop.step(reference, measured, 0.05)
        assert 0.0 <= output <= 10.0
        assert abs(output - last) <= rate * 0.05 * (1.0 + 1e-9)
        last = output


@given(st.floats(0.0, 10.0), numbers, numbers, st.floats(-5.0, 5.0))
def test_take_over_is_bumpless(
    output: float, reference: float, measured: float, feedforward: float
) -> None:
    loop = PI(Gains(2.0, 0.3), OutputLimits(0.0, 10.0))
    loop.take_over(output, reference, measured, feedforward)
    assert loop.step(reference, measured, 0.01, feedforward) == pytest.approx(output, abs=1e-9)


def test_change_of_gains_is_bumpless_at_the_reference() -> None:
    loop = PI(Gains(2.0, 0.3), OutputLimits(0.0, 10.0))
    loop.take_over(4.0, 1.0, 1.0)
    loop.gains = Gains(20.0, 0.1)
    assert loop.step(1.0, 1.0, 0.01) == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("build", "quoted"),
    [
        (lambda: Gains(math.nan, 1.0), "proportional is nan"),
        (lambda: Gains(1.0, 0.0), "integral_time is 0.0 s"),
        (lambda: Gains(1.0, math.inf), "integral_time is inf s"),
        (lambda: Gains(1.0, 1.0, -2.0), "tracking_time is -2.0 s"),
        (lambda: Gains.simc(0.0, 1.0, 0.1), "gain is 0.0"),
        (lambda: Gains.simc(1.0, -1.0, 0.1), "time_constant is -1.0"),
        (lambda: Gains.simc(1.0, 1.0, -0.1), "delay is -0.1 s"),
        (lambda: OutputLimits(2.0, 1.0), "low is 2.0 above high 1.0"),
        (lambda: OutputLimits(0.0, 1.0, 0.0), "rate is 0.0"),
        (lambda: PI(Gains(1.0, 1.0), OutputLimits(0.0, 1.0)).step(0.0, 0.0, 0.0), "dt is 0.0 s"),
        (
            lambda: PI(Gains(1.0, 1.0), OutputLimits(0.0, 1.0)).step(math.nan, 0.0, 0.1),
            "reference nan",
        ),
    ],
)
def test_bad_number_is_quoted(build: object, quoted: str) -> None:
    with pytest.raises(InputError, match=quoted):
        build()
