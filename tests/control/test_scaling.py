"""Laws of velocity scaling: the guarantee, what it must leave alone, and the joints' limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from workcell.control.scaling import (
    AccelerationInterval,
    FactorGovernor,
    acceleration_interval,
    pairwise_factor,
    smallest_t_min,
)
from workcell.control.ttc import reciprocal_first_order, smallest
from workcell.errors import WorkcellError

_rate = st.one_of(st.just(0.0), st.just(-0.0), st.floats(-2.0, 2.0), st.floats(-1e-9, 1e-9))
_distance = st.one_of(st.just(0.0), st.floats(-0.1, 3.0))
_pairs = st.lists(st.tuples(_distance, _rate, _rate), min_size=1, max_size=12)
_t_min = st.floats(0.05, 5.0)


@given(_pairs, _t_min, st.sampled_from([0.0, 0.05]))
@example([(0.1, -1.0, -0.2)], 1.0, 0.0)
def test_every_pair_keeps_t_min_or_the_lack_is_told(pairs, t_min, standoff):
    distance, own, other = np.array(pairs).T
    bound = pairwise_factor(distance, own, other, t_min, standoff_m=standoff)
    assert 0.0 <= bound.factor <= 1.0
    margin = (distance - standoff) + t_min * (bound.factor * own + other)
    rounding = 1e-12 * (1.0 + t_min)
    if bound.shortfall_pair == -1:
        assert bound.shortfall_m_s == 0.0
        assert (margin >= -rounding).all()
    else:
        assert margin.min() == pytest.approx(-t_min * bound.shortfall_m_s, abs=rounding)
        assert margin[bound.shortfall_pair] == pytest.approx(margin.min(), abs=rounding)


@given(_pairs, _t_min)
@example([(0.0, -5e-324, -1.0)], 1.0)
def test_no_larger_factor_would_do(pairs, t_min):
    distance, own, other = np.array(pairs).T
    bound = pairwise_factor(distance, own, other, t_min)
    if bound.pair == -1:
        assert bound.factor == 1.0
        return
    assert own[bound.pair] < 0.0, "only a pair that the arm closes may slow it"
    with np.errstate(over="ignore"):  # A pair that hardly closes asks to back up without end.
        allowed = (distance[bound.pair] / t_min + other[bound.pair]) / -own[bound.pair]
    assert bound.factor == pytest.approx(max(0.0, allowed), rel=1e-12)
    assert bound.required == pytest.approx(allowed, rel=1e-12)


@given(_pairs, _t_min)
def test_leaving_is_never_slowed(pairs, t_min):
    distance, own, other = np.array(pairs).T
    bound = pairwise_factor(distance, np.abs(own), other, t_min)
    assert (bound.factor, bound.pair, bound.required) == (1.0, -1, np.inf)


@given(_pairs, _t_min, st.floats(0.0, 1.0))
def test_more_distance_never_means_less_speed(pairs, t_min, more):
    distance, own, other = np.array(pairs).T
    near = pairwise_factor(distance, own, other, t_min)
    far = pairwise_factor(distance + more, own, other, t_min)
    assert far.factor >= near.factor
    assert far.shortfall_m_s <= near.shortfall_m_s + 1e-9 or far.factor > near.factor


@given(st.lists(st.tuples(st.floats(1e-3, 3.0), _rate), min_size=1, max_size=12), _t_min)
def test_among_standing_things_it_is_equation_16_of_the_paper(pairs, t_min):
    distance, rate = np.array(pairs).T
    star = smallest(reciprocal_first_order(distance, rate)).ttc_s
    bound = pairwise_factor(distance, rate, 0.0, t_min)
    assert bound.factor == pytest.approx(min(1.0, star / t_min), rel=1e-9)
    assert bound.shortfall_m_s == 0.0


def test_distance_and_speed_decay_exponentially_against_a_fixed_obstacle():
    t_min, wanted, step = 0.8, 0.5, 1e-4
    distance = t_min * wanted  # Scaling sets in here.
    for tick in range(20000):
        factor = pairwise_factor([distance], [-wanted], 0.0, t_min).factor
        if tick % 2000 == 0:
            decayed = np.exp(-tick * step / t_min)
            assert distance == pytest.approx(t_min * wanted * decayed, rel=1e-3)
            assert factor == pytest.approx(decayed, rel=1e-3)
            assert distance / (factor * wanted) == pytest.approx(t_min)
        distance -= step * factor * wanted


def test_with_a_standoff_the_arm_comes_to_rest_there():
    distance, step = 0.3, 1e-3
    for _ in range(10000):
        bound = pairwise_factor([distance], [-0.5], 0.0, 0.5, standoff_m=0.1)
        distance -= step * bound.factor * 0.5
    assert distance == pytest.approx(0.1, abs=1e-6)
    assert distance >= 0.1
    inside = pairwise_factor([0.05, 1.0], [0.2, -0.1], 0.0, 0.5, standoff_m=0.1)
    assert inside.factor == 1.0, "a pair inside the standoff may open"
    assert pairwise_factor([0.05], [-0.2], 0.0, 0.5, standoff_m=0.1).factor == 0.0


def test_an_arm_that_is_come_at_slows_more_and_says_when_stopping_is_not_enough():
    standing = pairwise_factor([0.2], [-0.4], [0.0], 1.0)
    coming = pairwise_factor([0.2], [-0.4], [-0.1], 1.0)
    rushing = pairwise_factor([0.2], [-0.4], [-0.5], 1.0)
    fleeing = pairwise_factor([0.2], [-0.4], [0.5], 1.0)
    assert (standing.factor, coming.factor) == (pytest.approx(0.5), pytest.approx(0.25))
    assert (rushing.factor, rushing.pair, rushing.shortfall_pair) == (0.0, 0, 0)
    assert rushing.required == pytest.approx(-0.75)
    assert rushing.shortfall_m_s == pytest.approx(0.3)
    assert fleeing.factor == 1.0
    # A pair the arm opens by its own motion counts what it opens.
    helped = pairwise_factor([0.2], [0.4], [-0.5], 1.0)
    assert (helped.factor, helped.shortfall_m_s) == (1.0, 0.0)


def test_four_arms_worst_pair_rules_and_zero_speed_is_free():
    own = np.array([-0.1, -0.4, -0.2, 0.0, -0.0])
    other = np.array([0.0, 0.0, -0.1, 0.0, 0.1])
    bound = pairwise_factor([0.5, 0.3, 0.12, 0.01, 0.01], own, other, 1.0)
    assert (bound.pair, bound.factor) == (2, pytest.approx(0.1))
    still = pairwise_factor([0.0, 0.1], [-0.0, 0.0], 0.0, 1.0)
    assert (still.factor, still.pair, still.shortfall_m_s) == (1.0, -1, 0.0)
    empty = pairwise_factor([], [], 0.0, 1.0)
    assert (empty.factor, empty.pair) == (1.0, -1)


def test_penetrating_pair_may_only_open():
    assert pairwise_factor([-0.01], [-0.1], 0.0, 1.0).factor == 0.0
    opening = pairwise_factor([-0.01], [0.1], 0.0, 1.0)
    assert (opening.factor, opening.shortfall_m_s) == (1.0, 0.0)
    standing = pairwise_factor([-0.01], [0.0], 0.0, 1.0)
    assert standing.shortfall_m_s == pytest.approx(0.01)


@given(
    st.lists(st.tuples(_rate, st.floats(-2.0, 2.0), st.floats(0.1, 20.0)), min_size=1, max_size=7)
)
@example([(0.0, 0.0, 1.0)])
@example([(1.0, -1.0, 0.1)])
def test_acceleration_interval_against_a_fine_search(joints):
    previous, wanted, limit = np.array(joints).T
    period = 0.01
    interval = acceleration_interval(previous, wanted, limit, period)
    grid = np.linspace(0.0, 1.0, 2001)

    def violation(factors):
        return (np.abs(np.outer(factors, wanted) - previous) / (limit * period)).max(axis=1)

    assert 0.0 <= interval.lowest <= interval.highest <= 1.0
    kept = grid[violation(grid) <= 1.0 - 1e-9]
    if interval.feasible:
        ends = violation([interval.lowest, interval.highest])
        assert (ends <= 1.0 + 1e-9).all()
        assert ((kept >= interval.lowest) & (kept <= interval.highest)).all()
    else:
        assert kept.size == 0
        assert violation([interval.lowest])[0] <= violation(grid).min() * (1.0 + 1e-9)


def test_acceleration_interval_by_hand():
    # One joint from rest; one at speed; a reversal; a joint that must stop at once.
    assert acceleration_interval([0.0], [1.0], 10.0, 0.01) == AccelerationInterval(0.0, 0.1, True)
    at_speed = acceleration_interval([0.5], [1.0], 10.0, 0.01)
    assert (at_speed.lowest, at_speed.highest) == (pytest.approx(0.4), pytest.approx(0.6))
    reversal = acceleration_interval([0.5], [-1.0], 10.0, 0.01)
    assert reversal == AccelerationInterval(0.0, 0.0, False)
    assert not acceleration_interval([0.5], [0.0], 10.0, 0.01).feasible
    # Too fast for the wanted velocity altogether: all of it is the least violating.
    assert acceleration_interval([1.0], [0.5], 10.0, 0.01) == AccelerationInterval(1.0, 1.0, False)


def test_governor_bounds_the_rise_and_never_the_fall():
    governor = FactorGovernor(rise_per_s=2.0, period_s=0.1)
    rising = [governor.choose(1.0) for _ in range(6)]
    np.testing.assert_allclose([c.factor for c in rising], [0.2, 0.4, 0.6, 0.8, 1.0, 1.0])
    assert [c.limiter for c in rising][::5] == ["rise", "none"]
    fallen = governor.choose(0.0)
    assert (fallen.factor, fallen.limiter) == (0.0, "ttc")
    governor.choose(0.1)
    governor.reset()
    assert governor.previous == 0.0


def test_leaving_is_not_held_back_by_the_rise_but_by_the_joints():
    governor = FactorGovernor(rise_per_s=2.0, period_s=0.1)
    assert governor.choose(1.0, leaving=True).factor == 1.0
    governor.reset()
    held = governor.choose(1.0, AccelerationInterval(0.0, 0.6, True), leaving=True)
    assert (held.factor, held.limiter) == (0.6, "acceleration")


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30))
def test_governed_factor_never_exceeds_the_bound(bounds):
    governor = FactorGovernor(rise_per_s=3.0, period_s=0.05)
    before = 0.0
    for bound in bounds:
        factor = governor.choose(bound).factor
        assert factor <= bound
        assert factor <= before + 0.15 + 1e-12
        before = factor


@pytest.mark.parametrize(
    ("bound", "interval", "factor", "limiter"),
    [
        (0.5, AccelerationInterval(0.4, 0.6, True), 0.5, "ttc"),
        (1.0, AccelerationInterval(0.4, 0.6, True), 0.6, "acceleration"),
        (0.1, AccelerationInterval(0.4, 0.6, True), 0.4, "braking"),
        (0.1, AccelerationInterval(0.4, 0.4, False), 0.1, "infeasible"),
        (1.0, AccelerationInterval(0.4, 0.4, False), 0.4, "infeasible"),
        (1.0, AccelerationInterval(0.0, 1.0, True), 1.0, "none"),
    ],
)
def test_precedence_of_the_limits(bound, interval, factor, limiter):
    governor = FactorGovernor(rise_per_s=1000.0, period_s=0.01)
    choice = governor.choose(bound, interval)
    assert (choice.factor, choice.limiter) == (factor, limiter)
    assert governor.previous == factor


def test_a_slow_rise_gives_way_to_what_the_joints_cannot_brake():
    governor = FactorGovernor(rise_per_s=1.0, period_s=0.01)
    choice = governor.choose(1.0, AccelerationInterval(0.4, 0.6, True))
    assert (choice.factor, choice.limiter) == (0.4, "acceleration")


def test_governed_arm_respects_its_joints_while_it_brakes():
    limit, period, t_min, wanted = 2.0, 0.01, 0.5, np.array([1.0, -0.5])
    governor = FactorGovernor(rise_per_s=5.0, period_s=period)
    distance, command, seen = 1.0, np.zeros(2), set()
    for _ in range(600):
        interval = acceleration_interval(command, wanted, limit, period)
        bound = pairwise_factor([distance], [-wanted[0]], 0.0, t_min)
        choice = governor.choose(bound.factor, interval)
        seen.add(choice.limiter)
        assert (np.abs(choice.factor * wanted - command) <= limit * period + 1e-12).all()
        command = choice.factor * wanted
        distance -= period * command[0]
    assert distance > 0.0
    assert {"acceleration", "ttc"} <= seen


def test_smallest_t_min_leaves_room_to_brake():
    reaction, speed, deceleration = 0.02, 0.5, 2.0
    standing = smallest_t_min(reaction, speed, deceleration, other_keeps_coming=False)
    assert standing == pytest.approx(0.02 + 0.125)
    # At t_min, the distance is what reacting and braking use up.
    used = speed * reaction + speed**2 / (2.0 * deceleration)
    assert standing * speed == pytest.approx(used)
    coming = smallest_t_min(reaction, speed, deceleration, other_keeps_coming=True)
    assert coming == pytest.approx(0.02 + 0.25)


def test_bad_numbers_are_refused_by_name():
    with pytest.raises(WorkcellError, match=r"rate_own_m_s\[0\] is nan"):
        pairwise_factor([1.0], [np.nan], 0.0, 1.0)
    with pytest.raises(WorkcellError, match=r"t_min_s is 0.0; must be a finite number > 0"):
        pairwise_factor([1.0], [0.0], 0.0, 0.0)
    with pytest.raises(WorkcellError, match="standoff_m is nan"):
        pairwise_factor([1.0], [0.0], 0.0, 1.0, standoff_m=np.nan)
    with pytest.raises(WorkcellError, match="ttc_factor is nan"):
        FactorGovernor(rise_per_s=1.0, period_s=0.1).choose(np.nan)
    with pytest.raises(WorkcellError, match=r"limit_rad_s2 is .*; every entry must be > 0"):
        acceleration_interval([0.0], [1.0], 0.0, 0.1)
    with pytest.raises(WorkcellError, match=r"rise_per_s is -1.0"):
        FactorGovernor(rise_per_s=-1.0, period_s=0.1)
    with pytest.raises(WorkcellError, match=r"deceleration_m_s2 is 0.0"):
        smallest_t_min(0.1, 1.0, 0.0, other_keeps_coming=True)
    with pytest.raises(WorkcellError, match=r"closing_speed_m_s is -1.0"):
        smallest_t_min(0.1, -1.0, 1.0, other_keeps_coming=True)
