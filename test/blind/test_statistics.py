"""Intervals against published and exactly known values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from examination.blind.measures import (
    calibration_error,
    clopper_pearson,
    mean,
    proportion,
    quantile,
)


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [  # Tables of exact limits; 0 of n and n of n have closed forms
        (0, 10, 0.0, 1.0 - 0.025 ** (1 / 10)),
        (10, 10, 0.025 ** (1 / 10), 1.0),
        (5, 10, 0.1871, 0.8129),
        (1, 20, 0.0013, 0.2487),
        (97, 100, 0.9148, 0.9938),
    ],
)
def test_clopper_pearson_gives_the_tabled_limits(hits, n, low, high):
    assert clopper_pearson(hits, n) == pytest.approx((low, high), abs=5e-5)


@given(n=st.integers(1, 60), share=st.floats(1e-6, 1.0))
def test_clopper_pearson_covers_at_least_95_percent_whatever_the_truth(n, share):
    counts = np.arange(n + 1)
    limits = [clopper_pearson(int(hits), n) for hits in counts]
    inside = np.array([low <= share <= high for low, high in limits])
    assert stats.binom.pmf(counts, n, share)[inside].sum() >= 0.95 - 1e-9


def test_a_proportion_of_nothing_has_no_value():
    assert math.isnan(proportion([]).value) and proportion([]).n == 0


def test_quantile_interval_is_the_pair_of_order_statistics_of_the_sign_test():
    found = quantile([float(k) for k in range(1, 21)], 0.5)
    # 20 values: the 6th and the 15th bound the median with 95.86 %
    assert (found.value, found.low, found.high) == (10.5, 6.0, 15.0)


def test_a_percentile_too_high_for_the_number_of_cases_has_no_upper_bound():
    assert quantile([1.0, 2.0, 3.0], 0.9).high == math.inf


def test_an_infinite_error_moves_the_percentile_and_not_the_median():
    values = [1.0, 2.0, 3.0, 4.0, math.inf]
    assert quantile(values, 0.5).value == 3.0
    assert quantile(values, 0.9).value == math.inf


def test_bootstrap_of_a_mean_is_repeatable_and_as_wide_as_its_standard_error():
    values = list(np.random.default_rng(1).normal(2.0, 1.0, 400))
    found = mean(values)
    assert found == mean(values)
    assert found.high - found.low == pytest.approx(2 * 1.96 * np.std(values) / 20, rel=0.1)


def test_calibration_error_of_a_coin_called_at_90_percent_is_40_points():
    found = calibration_error([0.9] * 100, [True, False] * 50)
    assert found.value == pytest.approx(0.4)
    assert found.low < 0.4 < found.high


def test_calibration_error_of_honest_probabilities_is_zero():
    stated = [0.25] * 4 + [0.75] * 4
    right = [True, False, False, False, True, True, True, False]
    assert calibration_error(stated, right).value == 0.0
