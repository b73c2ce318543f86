"""Criteria: values by hand, gradients against differences of what they are gradients of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workcell.control import criteria
from workcell.control.laws import criteria as laws
from workcell.errors import WorkcellError

from .conftest import update


def _difference_gradient(function, at, step=1e-6):
    return np.array(
        [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))]
    )


def test_values_by_hand():
    distance, rate = [0.5, 0.25, 1.0], [-1.0, 0.5, 0.0]
    assert criteria.artc_signed(distance, rate) == pytest.approx((2.0 - 2.0 + 0.0) / 3.0)
    assert criteria.artc_approaching(distance, rate) == pytest.approx(2.0 / 3.0)
    assert criteria.armd(distance) == pytest.approx((2.0 + 4.0 + 1.0) / 3.0)


def test_gradients_on_two_arms_are_those_of_the_log_barrier_and_of_armd(two_arms, rng):
    model, data, geometry = two_arms

    def distance(qpos):
        update(model, data, qpos)
        return geometry.measure(data).distance_m

    tried = 0
    while tried < 5:
        qpos = rng.uniform(-1.5, 1.5, model.nq)
        update(model, data, qpos)
        near = geometry.measure(data)
        if near.distance_m.min() < 0.01:
            continue
        tried += 1
        barrier = _difference_gradient(lambda q: -np.log(distance(q)).mean(), qpos)
        signed = criteria.artc_signed_gradient(near.distance_m, near.jacobian)
        np.testing.assert_allclose(signed, barrier, atol=1e-6)
        mean_reciprocal = _difference_gradient(lambda q: criteria.armd(distance(q)), qpos)
        np.testing.assert_allclose(
            criteria.armd_gradient(near.distance_m, near.jacobian), mean_reciprocal, atol=1e-4
        )


def test_signed_gradient_is_that_of_the_value_in_the_joint_velocities(rng):
    distance, jacobian, qvel = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 4)), rng.normal(size=4)
    gradient = _difference_gradient(lambda v: criteria.artc_signed(distance, jacobian @ v), qvel)
    np.testing.assert_allclose(
        criteria.artc_signed_gradient(distance, jacobian), gradient, atol=1e-8
    )


def test_held_artc_descends_equation_18_in_the_joint_positions_with_the_rates_held(rng):
    distance, jacobian = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 4))
    held = np.array([-0.3, 0.2, -0.02, 0.0, -1.0, 0.5])

    def value(q):
        there = distance + jacobian @ q
        barrier = -laws.HELD_FLOOR * np.log(there).mean()
        return barrier + laws.HELD_TIME_S * criteria.artc_approaching(there, held)

    gradient = _difference_gradient(value, np.zeros(4))
    goal = criteria.objective("artc_held", distance, held, jacobian)
    np.testing.assert_allclose(goal.linear, gradient, atol=1e-6)
    np.testing.assert_array_equal(goal.hessian, 0.0)


def test_of_two_pairs_the_one_that_collides_sooner_counts_more_in_held_artc():
    rows = np.eye(2)
    goal = criteria.objective("artc_held", [0.2, 0.2], [-0.2, 0.2], rows)
    assert goal.linear[0] == pytest.approx(
        (laws.HELD_FLOOR + laws.HELD_TIME_S) / laws.HELD_FLOOR * goal.linear[1]
    )
    signed = criteria.objective("artc", [0.2, 0.2], [-0.2, 0.2], rows)
    assert signed.linear[0] == signed.linear[1]


def test_approaching_objective_is_the_mean_square_of_the_closing_pairs(rng):
    distance, jacobian, qvel = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 4)), rng.normal(size=4)
    other = rng.normal(size=6)
    rate = jacobian @ qvel + other
    goal = criteria.objective("artc_approaching", distance, rate, jacobian, other_rate_m_s=other)
    closing = rate < 0.0
    assert 0 < closing.sum() < 6

    def half_mean_square(v):
        kappa = -(jacobian @ v + other) / distance
        return 0.5 * (kappa[closing] ** 2).sum() / 6

    np.testing.assert_allclose(
        goal.hessian @ qvel + goal.linear, _difference_gradient(half_mean_square, qvel), atol=1e-6
    )
    np.testing.assert_array_equal(goal.hessian, goal.hessian.T)
    assert np.linalg.eigvalsh(goal.hessian).min() >= -1e-12


def test_static_variant_leaves_out_the_others(rng):
    distance, jacobian = rng.uniform(0.1, 1.0, 6), rng.normal(size=(6, 4))
    goal = criteria.objective("artc_approaching", distance, -np.ones(6), jacobian)
    np.testing.assert_array_equal(goal.linear, np.zeros(4))
    assert goal.hessian.any()


@pytest.mark.parametrize("name", ["artc", "armd", "artc_approaching"])
def test_descending_the_objective_opens_the_pair(name):
    # One pair and one joint that closes it when it turns forwards.
    goal = criteria.objective(name, [0.2], [-0.1], [[-1.0]], other_rate_m_s=[-0.1])
    assert goal.linear[0] > 0.0, "the descent direction -linear turns the joint backwards"


def test_armd_weighs_near_pairs_harder_than_artc():
    jacobian = np.eye(2)
    near_far = [0.1, 1.0]
    artc = criteria.artc_signed_gradient(near_far, jacobian)
    armd = criteria.armd_gradient(near_far, jacobian)
    assert artc[0] / artc[1] == pytest.approx(10.0)
    assert armd[0] / armd[1] == pytest.approx(100.0)


def test_touching_and_penetrating_pairs_count_at_the_floor():
    distance = [1.0, laws.DISTANCE_FLOOR_M, 0.0, -0.2]
    at_floor = 1.0 / laws.DISTANCE_FLOOR_M
    assert criteria.armd(distance) == pytest.approx((1.0 + 3.0 * at_floor) / 4.0)
    gradient = criteria.artc_signed_gradient(distance, np.eye(4))
    np.testing.assert_allclose(gradient, [-0.25, *[-0.25 * at_floor] * 3])
    goal = criteria.objective("artc_approaching", [-0.2], [-1.0], [[1.0]])
    assert goal.hessian[0, 0] == pytest.approx(at_floor**2)


def test_no_pairs_and_no_criterion_ask_for_nothing():
    empty = np.zeros((0, 3))
    assert (
        criteria.artc_signed([], [])
        == criteria.artc_approaching([], [])
        == criteria.armd([])
        == 0.0
    )
    for name in criteria.CRITERIA:
        goal = criteria.objective(name, [], [], empty)
        np.testing.assert_array_equal(goal.hessian, np.zeros((3, 3)))
        np.testing.assert_array_equal(goal.linear, np.zeros(3))
    goal = criteria.objective("none", [0.1], [-1.0], [[1.0, 2.0]])
    assert not goal.linear.any()
    assert not goal.hessian.any()


def test_unknown_criterion_and_bad_numbers_are_refused_by_name():
    with pytest.raises(
        WorkcellError, match="'ttc'; must be one of artc, artc_approaching, armd, none, artc_held"
    ):
        criteria.objective("ttc", [1.0], [0.0], [[1.0]])
    with pytest.raises(WorkcellError, match=r"distance_m\[0\] is nan"):
        criteria.armd([np.nan])
    with pytest.raises(WorkcellError, match=r"jacobian\[0, 1\] is inf"):
        criteria.objective("none", [1.0], [0.0], [[1.0, np.inf]])


# ---------------------------------------------------------------- room to the stops


@given(
    q=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=7),
    half=st.floats(0.5, 3.0),
    weight=st.floats(0.1, 20.0),
)
def test_a_joint_is_pushed_from_its_stop_and_only_near_it(q, half, weight):
    q = np.clip(q, -half, half)
    none = criteria.NullspaceObjective(np.zeros((len(q), len(q))), np.zeros(len(q)))
    pushed = criteria.with_room_to_stops(none, q, -half, half, weight)
    velocity = -weight * pushed.linear  # what minimises 1/2 |q'|^2 + weight c'q'
    depth = np.maximum(laws.STOP_MARGIN_RAD - (half - np.abs(q)), 0.0)
    expected = laws.STOP_PUSH_RAD_S * (depth / laws.STOP_MARGIN_RAD) ** 2
    np.testing.assert_allclose(velocity, -np.sign(q) * expected, atol=1e-12)


def test_joints_without_stops_are_left_alone():
    objective = criteria.NullspaceObjective(np.eye(2), np.ones(2))
    free = criteria.with_room_to_stops(objective, [50.0, -50.0], -np.inf, np.inf, 1.0)
    np.testing.assert_array_equal(free.linear, objective.linear)
