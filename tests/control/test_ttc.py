"""Times to collision: closed forms, a polynomial solver, and the degenerate cases by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from workcell.control.ttc import (
    reciprocal_first_order,
    reciprocal_second_order,
    smallest,
)
from workcell.errors import WorkcellError

_distance = st.floats(1e-6, 10.0)
# Rates and accelerations stop at 1e-30, so that the polynomial in t, up to 1e36 s, can be checked
# without overflow; what lies beyond has a test of its own.
_rate = st.one_of(
    st.just(0.0), st.just(-0.0), st.floats(-10.0, 10.0).filter(lambda r: abs(r) > 1e-30)
)
_accel = st.one_of(
    st.just(0.0),
    st.floats(-100.0, 100.0).filter(lambda a: abs(a) > 1e-3),
    st.floats(1e-30, 1e-9).map(lambda a: -a),
    st.floats(1e-30, 1e-9),
)


def test_first_order_by_hand():
    kappa = reciprocal_first_order([1.0, 1.0, 1.0, 1.0], [-2.0, 2.0, 0.0, -0.0])
    np.testing.assert_array_equal(kappa, [2.0, 0.0, 0.0, 0.0])
    assert not np.signbit(kappa).any()


@pytest.mark.parametrize("rate_m_s", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("distance_m", [0.0, -0.0, -0.01])
def test_met_pairs_have_no_time_left_whatever_their_rate(distance_m, rate_m_s):
    assert reciprocal_first_order([distance_m], [rate_m_s])[0] == np.inf
    assert reciprocal_second_order([distance_m], [rate_m_s], [5.0])[0] == np.inf


def test_standoff_counts_to_it_and_inside_it_only_closing_is_a_collision():
    rates = np.array([-1.0, -1.0, 0.0, 1.0])
    distance = np.array([0.3, 0.05, 0.05, 0.05])
    kappa = reciprocal_first_order(distance, rates, standoff_m=0.1)
    np.testing.assert_allclose(kappa, [1.0 / 0.2, np.inf, 0.0, 0.0])
    kappa = reciprocal_second_order(distance, rates, np.zeros(4), standoff_m=0.1)
    np.testing.assert_allclose(kappa, [1.0 / 0.2, np.inf, 0.0, 0.0])
    # Standing inside and accelerating inwards is closing, too.
    assert reciprocal_second_order([0.05], [0.0], [-1.0], standoff_m=0.1)[0] == np.inf
    assert reciprocal_second_order([-0.05], [1.0], [1.0], standoff_m=0.1)[0] == np.inf


def test_a_vanishing_distance_overflows_to_infinity_not_to_an_error():
    assert reciprocal_first_order([5e-324], [-1.0])[0] == np.inf
    assert reciprocal_second_order([5e-324], [-1.0], [1.0])[0] == np.inf


@given(_distance, _rate, _accel)
@example(1.0, -1.0, 0.5)  # A double root: the pair just touches.
@example(1.0, 0.0, -2.0)
@example(1e-6, 10.0, -1e-12)
def test_second_order_is_the_smallest_positive_root(distance, rate, accel):
    kappa = reciprocal_second_order([distance], [rate], [accel])[0]
    if kappa == 0.0:
        # Nothing ahead: the distance stays positive at its minimum, or never turns back.
        if accel > 0.0:
            time_s = max(0.0, -rate / accel)
            lowest = distance + rate * time_s + 0.5 * accel * time_s**2
            assert lowest >= -1e-9 * distance
        else:
            assert accel == 0.0
            assert rate >= 0.0
        return
    t = 1.0 / kappa
    terms = np.array([0.5 * accel * t * t, rate * t, distance])
    assert abs(terms.sum()) <= 1e-9 * np.abs(terms).max()
    # It is the first one: the distance is still positive on the way there.
    for part in (0.25, 0.5, 0.9, 0.99):
        assert distance + rate * part * t + 0.5 * accel * (part * t) ** 2 > -1e-9 * distance


@given(st.floats(0.01, 10.0), st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_second_order_agrees_with_a_polynomial_solver(distance, rate, accel):
    assume(abs(accel) > 1e-3)
    discriminant = rate**2 - 2.0 * accel * distance
    assume(abs(discriminant) > 1e-3)  # Near a double root a polynomial solver is ill-conditioned.
    roots = np.roots([0.5 * accel, rate, distance])
    ahead = [r.real for r in roots if abs(r.imag) < 1e-12 and r.real > 0.0]
    kappa = reciprocal_second_order([distance], [rate], [accel])[0]
    expected = 1.0 / min(ahead) if ahead else 0.0
    assert kappa == pytest.approx(expected, rel=1e-7)


@given(_distance, st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
def test_second_order_goes_over_into_first_order(distance, rate, direction):
    assume(abs(rate) > 1e-3)
    first = reciprocal_first_order([distance], [rate])[0]
    for small in (1e-6, 1e-9, 1e-15, 1e-300, 0.0):
        accel = direction * small * rate**2 / distance
        second = reciprocal_second_order([distance], [rate], [accel])[0]
        # kappa is g k^2 + r k + a/2 = 0; a perturbs k by about a/(2 r), relative size `small`.
        assert second == pytest.approx(
            first, rel=2.0 * small + 1e-14, abs=small * abs(rate / distance)
        )


@pytest.mark.parametrize("speed", [1e-150, 1.0, 1e150])
def test_second_order_neither_overflows_nor_underflows(speed):
    # Time scales out: d = 1 - 3 (v t) + 2 (v t)^2 has the roots v t = 1/2 and 1 for any v.
    accel = 4.0 * speed * speed
    kappa = reciprocal_second_order([1.0], [-3.0 * speed], [accel])[0]
    assert kappa == pytest.approx(2.0 * speed)


def test_a_pair_that_turns_round_in_time_does_not_collide():
    assert reciprocal_second_order([1.0], [-1.0], [0.6])[0] == 0.0
    assert reciprocal_second_order([1.0], [-1.0], [0.5])[0] == pytest.approx(0.5)


def test_an_opening_pair_can_still_collide():
    kappa = reciprocal_second_order([1.0], [1.0], [-1.0])[0]
    assert 1.0 / kappa == pytest.approx(1.0 + np.sqrt(3.0))


@given(st.lists(st.tuples(_distance, _rate, _accel), max_size=6))
def test_pairs_do_not_influence_each_other(pairs):
    columns = np.array(pairs, dtype=float).reshape(-1, 3)
    together = reciprocal_second_order(*columns.T)
    apart = [reciprocal_second_order([d], [r], [a])[0] for d, r, a in columns]
    np.testing.assert_array_equal(together, apart)


def test_smallest_names_the_first_of_the_most_urgent_pairs():
    assert (smallest([0.0, 4.0, 2.0, 4.0]).ttc_s, smallest([0.0, 4.0, 2.0, 4.0]).pair) == (0.25, 1)
    assert (smallest([1.0, np.inf]).ttc_s, smallest([1.0, np.inf]).pair) == (0.0, 1)
    for none in ([], [0.0, 0.0], [5e-324]):
        assert (smallest(none).ttc_s, smallest(none).pair) == (np.inf, -1)


def test_what_is_not_a_number_is_refused_by_name():
    with pytest.raises(WorkcellError, match=r"rate_m_s\[1\] is nan; every entry must be finite"):
        reciprocal_first_order([1.0, 1.0], [0.0, np.nan])
    with pytest.raises(WorkcellError, match=r"accel_m_s2\[0\] is inf"):
        reciprocal_second_order([1.0], [0.0], [np.inf])
    with pytest.raises(WorkcellError, match=r"standoff_m is -0.1; must be a finite number >= 0"):
        reciprocal_first_order([1.0], [0.0], standoff_m=-0.1)
    with pytest.raises(WorkcellError, match=r"kappa_per_s\[1\] is nan"):
        smallest([0.0, np.nan])
    with pytest.raises(WorkcellError, match=r"kappa_per_s\[0\] is -1.0; must be a number >= 0"):
        smallest([-1.0])
