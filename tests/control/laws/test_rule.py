"""Times, factors, criteria and joint limits against NumPy's second opinion."""

from __future__ import annotations

import ast
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.oracles import rule as oracle
from workcell.control import criteria, scaling, ttc
from workcell.control.laws import joint_limits, pair_rule, speed_scale

ROUNDING = 1e-12
"""Allowed difference, relative to the numbers that went into a result."""

NUMBER = (
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e300, -1e300, 5e-324, 0.02])
    | st.floats(-10.0, 10.0)
    | st.floats(allow_nan=False, allow_infinity=False)
)
ROWS = st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=1, max_size=12)


@given(rows=ROWS, standoff=st.sampled_from([0.0, 0.02, 1.0]))
@settings(max_examples=400)
def test_times_to_collision_are_the_same_to_the_last_bit(rows, standoff):
    distance, rate, accel = np.array(rows).T.copy()
    with np.errstate(all="ignore"):
        for mine, theirs in (
            (
                ttc.reciprocal_first_order(distance, rate, standoff_m=standoff),
                oracle.first_order(distance, rate, standoff),
            ),
            (
                ttc.reciprocal_second_order(distance, rate, accel, standoff_m=standoff),
                oracle.second_order(distance, rate, accel, standoff),
            ),
        ):
            np.testing.assert_array_equal(mine, theirs)
            if not np.isnan(theirs).any():
                first = ttc.smallest(mine)
                assert (first.ttc_s, first.pair) == oracle.smallest(theirs)


@given(rows=ROWS, t_min=st.sampled_from([1.0, 0.5, 1e-3]), standoff=st.sampled_from([0.0, 0.02]))
@settings(max_examples=400)
def test_the_factor_is_the_same_to_the_last_bit(rows, t_min, standoff):
    distance, own, other = np.array(rows).T.copy()
    with np.errstate(all="ignore"):
        theirs = oracle.pairwise_factor(distance, own, other, t_min, standoff)
    mine = speed_scale.pairwise_factor(distance, own, other, t_min, standoff)
    if mine[5] >= 0:  # beyond the range of floats
        with np.errstate(all="ignore"):
            assert not np.isfinite(
                (distance[mine[5]] - standoff) / t_min + other[mine[5]] + own[mine[5]]
            )
        return
    np.testing.assert_equal(mine[:5], theirs)


SPEED = st.sampled_from([0.0, -0.0, 1e-300, 1e-12, 0.02, -0.02]) | st.floats(-10.0, 10.0)


@given(
    rows=st.lists(st.tuples(SPEED, SPEED), min_size=1, max_size=7),
    reach=st.sampled_from([1.0, 100.0]),
    alike=st.booleans(),
)
@settings(max_examples=400)
def test_what_the_joints_reach_is_the_same_to_the_last_bit(rows, reach, alike):
    previous, wanted = np.array(rows).T.copy()
    previous = wanted.copy() if alike else previous
    limit = np.full(len(rows), reach)
    mine = scaling.acceleration_interval(previous, wanted, limit, 0.002)
    with np.errstate(all="ignore"):
        theirs = oracle.acceleration_interval(previous, wanted, limit, 0.002)
    assert (mine.lowest, mine.highest, mine.feasible) == theirs


@given(seed=st.integers(0, 2**32 - 1))
def test_the_push_from_the_stops(seed):
    random = np.random.default_rng(seed)
    q, lower = random.uniform(-1.0, 1.0, (2, 7))
    upper = np.where(random.random(7) < 0.3, np.inf, lower + random.choice([0.3, 2.0, 0.0]))
    objective = criteria.NullspaceObjective(np.eye(7), random.normal(size=7))
    mine = criteria.with_room_to_stops(objective, q, lower, upper, 8.0)
    theirs = objective.linear + oracle.push_from_stops(q, lower, upper, 8.0)
    np.testing.assert_allclose(mine.linear, theirs, rtol=ROUNDING, atol=ROUNDING)


@given(
    seed=st.integers(0, 2**32 - 1),
    pairs=st.sampled_from([1, 2, 64, 65]),
    joints=st.sampled_from([1, 7]),
)
def test_criteria(seed, pairs, joints):
    random = np.random.default_rng(seed)
    distance = random.normal(0.05, 0.1, pairs)  # some below the floor, some penetrating
    rate, other = random.normal(size=(2, pairs))
    rate[random.random(pairs) < 0.2] = 0.0
    rows = random.normal(size=(pairs, joints))
    floored = np.maximum(distance, oracle.FLOOR_M)
    for mine, approaching in ((criteria.artc_signed, False), (criteria.artc_approaching, True)):
        artc, armd = oracle.means(distance, rate, approaching=approaching)
        assert abs(mine(distance, rate) - artc) <= ROUNDING * np.abs(rate / floored).mean()
        assert abs(criteria.armd(distance) - armd) <= ROUNDING * armd
    for name in criteria.CRITERIA:
        mine = criteria.objective(name, distance, rate, rows, other_rate_m_s=other)
        H, c = oracle.objective(name, distance, rate, rows, other)
        size = (np.abs(rows).max(axis=1) / floored**2 * (1.0 + np.abs(other))).max() * (
            1.0 + np.abs(rows).max()
        )
        np.testing.assert_allclose(mine.hessian, H, atol=ROUNDING * size, rtol=0)
        np.testing.assert_allclose(mine.linear, c, atol=ROUNDING * size, rtol=0)


def test_numbers_lists_and_shapes_that_broadcast():
    assert ttc.reciprocal_first_order([1.0, 2.0], -1.0).tolist() == [1.0, 0.5]
    assert ttc.reciprocal_first_order(2.0, -1.0) == 0.5
    assert ttc.reciprocal_first_order(np.ones((2, 2)), -np.ones(2)).shape == (2, 2)
    assert ttc.reciprocal_first_order(np.array([1, 2]), np.array([-1, -1]))[1] == 0.5
    assert ttc.reciprocal_first_order(np.ones(6)[::2], -np.ones(6)[::2]).tolist() == [1.0, 1.0, 1.0]
    assert len(ttc.reciprocal_first_order(np.zeros(0), np.zeros(0))) == 0
    assert ttc.smallest(np.zeros(0)).pair == -1
    assert criteria.artc_signed(np.zeros(0), np.zeros(0)) == 0.0


@given(seed=st.integers(0, 2**32 - 1), dt_s=st.sampled_from([0.002, 0.02]))
@settings(max_examples=200)
def test_the_joint_box_and_what_it_lets_through(seed, dt_s):
    """With joints before, at and beyond their stops, without a stop, and at any speed before."""
    random = np.random.default_rng(seed)
    n = 7
    lower = np.where(random.random(n) < 0.2, -np.inf, random.uniform(-3.0, -1.0, n))
    upper = np.where(random.random(n) < 0.2, np.inf, random.uniform(1.0, 3.0, n))
    arm = types.SimpleNamespace(
        lower_rad=lower, upper_rad=upper, velocity_limit_rad_s=random.uniform(0.1, 3.0, n),
        acceleration_limit_rad_s2=random.uniform(0.5, 20.0, n),
    )  # fmt: skip
    q = random.uniform(-1.0, 1.0, n)
    near = random.choice([0.0, 1e-3, -1e-3, 0.1, -0.1], n)
    at_stop = (random.random(n) < 0.5) & np.isfinite(lower)
    q[at_stop] = (lower + near)[at_stop]
    previous, wanted = random.normal(size=(2, n))
    low, high, allowed = np.empty((3, n))
    joints = (
        q, np.arange(n), lower, upper, arm.velocity_limit_rad_s, arm.acceleration_limit_rad_s2,
    )  # fmt: skip
    assert joint_limits.joint_box(*joints, previous, dt_s, low, high) == -1
    smallest, largest = oracle.joint_box(q, arm, previous, dt_s)
    np.testing.assert_allclose(low, smallest, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(high, largest, rtol=1e-13, atol=1e-13)
    assert joint_limits.within_limits(*joints, previous, wanted, dt_s, allowed) == -1
    np.testing.assert_array_equal(allowed, np.clip(wanted, low, high))
    previous[3] = np.nan
    assert joint_limits.joint_box(*joints, previous, dt_s, low, high) == 3


@given(
    st.lists(st.tuples(NUMBER, st.sampled_from([0.0, 5e-10, -5e-10, 2e-9, -1.0, 1.0])), min_size=1)
)
def test_what_is_on_a_bound_but_for_the_solvers_tolerance_is_set_on_it(rows):
    bound, offset = np.array(rows).T.copy()
    for low, high in ((bound, bound + 1.0), (bound - 1.0, bound)):
        settled = np.empty(len(bound))
        joint_limits.settle(bound + offset, low, high, 1e-9, settled)
        assert ((settled >= low) & (settled <= high)).all()
        assert (settled == bound)[np.abs(offset) <= 5e-10].all()


@given(rows=st.lists(st.tuples(SPEED, st.floats(-1.0, 1.0)), max_size=8))
def test_the_mildest_way_back_gives_every_pair_its_rate(rows):
    own, needed = np.array(rows).reshape(-1, 2).T.copy()
    factor = speed_scale.backing_factor(own, needed)
    tried = np.linspace(-1.0, 0.0, 2001)
    if np.isnan(factor):
        assert not (np.outer(tried, own) >= needed).all(axis=1).any()
        return
    assert -1.0 <= factor <= 0.0
    rounding = 1e-12 * (1.0 + np.abs(needed))
    assert (factor * own >= needed - rounding).all()
    milder = tried[tried > factor + 1e-9]
    assert not (np.outer(milder, own) >= needed + 1e-12).all(axis=1).any()


def test_the_rule_is_written_once():
    """d - standoff + t_min (a + b): nothing else divides a distance by t_min."""
    control = Path(pair_rule.__file__).parent.parent
    dividing = [
        (file.name, ast.unparse(node))
        for file in control.glob("**/*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Div)
        and "t_min" in ast.unparse(node.right)
    ]
    assert sorted(dividing) == [
        ("mink_limit.py", "dt ** 2 / settings.t_min_s"),  # mink's gain, which divides no distance
        ("pair_rule.py", "(distance - standoff) / t_min"),
        # Equation (16) by itself, a peer of the rule.
        ("paper_scaling.py", "1.0 / (kappa[worst] * settings.t_min_s)"),
        ("speed_scale.py", "ttc / t_min"),  # the paper's factor (16), on second-order times
    ]


def test_the_wrappers_name_what_is_wrong():
    bad, good = np.array([1.0, np.nan]), np.ones(2)
    for match, call in {
        r"rate_m_s\[1\]": lambda: ttc.reciprocal_first_order(good, bad),
        r"accel_m_s2\[1\]": lambda: ttc.reciprocal_second_order(good, good, bad),
        "standoff_m": lambda: ttc.reciprocal_first_order(good, good, standoff_m=-1.0),
        r"kappa_per_s\[1\]": lambda: ttc.smallest(bad),
        r"kappa_per_s\[0\]": lambda: ttc.smallest(-good),
        r"distance_m\[1\]": lambda: criteria.armd(bad),
        r"jacobian\[1, 0\]": lambda: criteria.artc_signed_gradient(good, bad[:, None]),
    }.items():
        with pytest.raises(scaling.WorkcellError, match=match):
            call()
