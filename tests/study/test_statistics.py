"""Intervals against their definitions and another library's; bounds, never certainties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from workcell.study.statistics import paired, paired_events, rate


@given(st.integers(1, 3000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_at_the_ends_of_the_interval_the_count_is_just_too_unlikely(case: tuple[int, int]):
    count, runs = case
    found = rate(count, runs)
    tail = 0.05 if count in (0, runs) else 0.025
    if count > 0:
        assert stats.binom.sf(count - 1, runs, found.low) == pytest.approx(tail, rel=1e-6)
    if count < runs:
        assert stats.binom.cdf(count, runs, found.high) == pytest.approx(tail, rel=1e-6)
    assert found.low <= count / runs <= found.high


def test_no_failure_is_an_upper_bound():
    none = rate(0, 3000)
    assert none.low == 0.0
    assert none.high == pytest.approx(1.0 - 0.05 ** (1 / 3000), rel=1e-9)
    assert str(none) == "0 of 3000 (below 0.0998 %)"
    assert (rate(0, 0).low, rate(0, 0).high) == (0.0, 1.0)
    with pytest.raises(ValueError, match="count is 4; it must be between 0 and runs, 3"):
        rate(4, 3)


def test_paired_differences_are_students():
    rng = np.random.default_rng(0)
    first, second = rng.normal(3.0, 2.0, 40), rng.normal(3.4, 2.0, 40)
    reference = stats.ttest_rel(second, first).confidence_interval(0.95)
    found = paired(np.append(first, [1.0, np.nan]), np.append(second, [np.nan, 2.0]))
    assert found.pairs == 40
    assert (found.low, found.high) == pytest.approx((reference.low, reference.high), rel=1e-9)


def test_few_pairs_say_little():
    assert paired([], []).text() == "no pairs"
    one = paired([1.0], [3.0])
    assert (one.mean, one.low) == (2.0, None)
    assert one.text() == "+2 (one pair)"
    assert not one.is_clear
    assert paired([1.0, 1.0], [1.0, 1.0]).text() == "the same in all pairs"


def test_pairs_that_all_agree_bound_the_difference_of_rates():
    found = paired_events([True] * 300, [True] * 300)
    assert found.mean == 0.0
    assert not found.is_clear
    assert found.high == pytest.approx(1.0 - 0.025 ** (1 / 300), rel=1e-9)
    assert found.low == -found.high  # type: ignore[operator]


@pytest.mark.long
def test_the_interval_of_a_difference_of_rates_covers():
    """2000 experiments of 60 correlated pairs: the true difference is left out in at most 5 % of them."""
    rng = np.random.default_rng(1)
    misses = 0
    for _ in range(2000):
        u = rng.random(60)
        found = paired_events(u < 0.1, (u > 0.05) & (u < 0.3))
        misses += not (found.low or 0.0) <= 0.15 <= (found.high or 0.0)
    assert misses <= 100
    assert paired_events(np.zeros(60), np.ones(60)).is_clear
