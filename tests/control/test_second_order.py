"""The second derivative of distances against second differences along smooth motions."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from workcell.control.second_order import second_order
from workcell.errors import WorkcellError

from .conftest import build, update

_STEP_S = 1e-4


def _difference(model, data, geometry, qpos, qvel, qacc):
    """Second difference of the distances along constant joint accelerations, for hinges."""

    def distance(time_s):
        update(model, data, qpos + qvel * time_s + 0.5 * qacc * time_s**2)
        return geometry.measure(data).distance_m

    return (distance(_STEP_S) - 2.0 * distance(0.0) + distance(-_STEP_S)) / _STEP_S**2


def test_two_arms_agree_with_second_differences(two_arms, rng):
    model, data, geometry = two_arms
    errors = []
    for _ in range(40):
        qpos = rng.uniform(-2.0, 2.0, model.nq)
        qvel, qacc = rng.normal(size=(2, model.nv))
        update(model, data, qpos, qvel)
        result = second_order(geometry, data, geometry.measure(data), qacc)
        assert result.exact.all()
        difference = _difference(model, data, geometry, qpos, qvel, qacc)
        errors.append(np.abs(result.accel_m_s2 - difference) / (1.0 + np.abs(difference)))
    errors = np.concatenate(errors)
    # A few pairs in a thousand change from side to end of a capsule within the step, where the
    # second derivative jumps; all others must agree.
    assert np.quantile(errors, 0.995) < 1e-5
    assert np.median(errors) < 1e-7


def test_leaving_out_the_sliding_would_be_noticed(two_arms, rng):
    model, data, geometry = two_arms
    qpos, qvel = rng.uniform(-2.0, 2.0, model.nq), rng.normal(size=model.nv)
    qacc = np.zeros(model.nv)
    update(model, data, qpos, qvel)
    near = geometry.measure(data)
    result = second_order(geometry, data, near, qacc)
    material = np.zeros(len(geometry))
    for k, (i, j) in enumerate(geometry.body):
        for sign, body, point in ((1, i, near.witness_i_m[k]), (-1, j, near.witness_j_m[k])):
            jac_dot = np.zeros((3, model.nv))
            mujoco.mj_jacDot(model, data, jac_dot, None, point, body)
            material[k] += sign * near.normal[k] @ jac_dot @ qvel
    assert np.abs(result.accel_m_s2 - material).max() > 0.1


def _sliding_capsule(second: str, position: str = "0 0 0"):
    """A geom on three slides and a hinge about x, above a geom fixed in the world."""
    return build(
        f'<geom name="b" {second} pos="{position}"/>'
        '<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint type="slide" axis="0 0 1"/><joint axis="1 0 0"/>'
        '<geom name="a" type="capsule" size="0.05 0.2" mass="1"/></body>',
        [("a", "b")],
    )


@pytest.mark.parametrize(
    ("second", "qpos"),
    [
        ('type="plane" size="1 1 1"', [0.0, 0.0, 0.5, 0.7]),
        ('type="box" size="0.5 0.5 0.1"', [0.0, 0.1, 0.5, 0.7]),
        ('type="sphere" size="0.1"', [0.1, 0.3, 0.4, 0.7]),
        ('type="capsule" size="0.1 0.3" euler="0 1 0"', [0.1, 0.2, 0.4, 0.7]),
    ],
)
def test_exact_where_it_says_so(second, qpos, rng):
    model, data, geometry = _sliding_capsule(second)
    for _ in range(5):
        qvel, qacc = rng.normal(size=(2, 4))
        update(model, data, qpos, qvel)
        result = second_order(geometry, data, geometry.measure(data), qacc)
        assert result.exact[0]
        difference = _difference(model, data, geometry, np.array(qpos), qvel, qacc)
        assert result.accel_m_s2[0] == pytest.approx(difference[0], abs=1e-5)


def test_a_moving_box_turns_its_face_with_it(rng):
    for pair in (("box", "ball"), ("ball", "box")):
        model, data, geometry = build(
            '<body><joint axis="1 0 0" pos="0 0.2 -0.3"/><joint axis="0 1 0"/>'
            '<geom name="box" type="box" size="0.2 0.3 0.1" mass="1"/></body>'
            '<body pos="0.05 0.05 0.4"><joint axis="0 0 1" pos="0.3 0 0"/><joint type="slide"/>'
            '<geom name="ball" type="sphere" size="0.1" mass="1"/></body>',
            [pair],
        )
        qpos = np.array([0.1, 0.05, 0.1, 0.02])
        qvel, qacc = rng.normal(size=(2, 4))
        update(model, data, qpos, qvel)
        result = second_order(geometry, data, geometry.measure(data), qacc)
        assert result.exact[0]
        difference = _difference(model, data, geometry, qpos, qvel, qacc)
        assert result.accel_m_s2[0] == pytest.approx(difference[0], abs=1e-5)


@pytest.mark.parametrize("solid", ["cylinder", "ellipsoid", "box"])
def test_a_sphere_against_a_curved_geom_has_a_lower_bound(solid, rng):
    model, data, geometry = build(
        f'<body><joint axis="1 0 0"/><joint axis="0 1 0"/>'
        f'<geom name="b" type="{solid}" size="0.1 0.12 0.08" mass="1"/></body>'
        '<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint type="slide" axis="0 0 1"/><geom name="a" size="0.05" mass="1"/></body>',
        [("a", "b")],
    )
    estimates = 0
    for _ in range(30):
        away = rng.normal(size=3)
        qpos = np.concatenate([rng.uniform(-1.0, 1.0, 2), 0.4 * away / np.linalg.norm(away)])
        qvel = rng.normal(size=5)
        update(model, data, qpos, qvel)
        result = second_order(geometry, data, geometry.measure(data), np.zeros(5))
        difference = _difference(model, data, geometry, qpos, qvel, np.zeros(5))[0]
        # MuJoCo's iterative solver is good to 1e-10 m here, so the difference to 0.02 m/s^2.
        assert result.accel_m_s2[0] <= difference + 0.05
        estimates += not result.exact[0]
    assert estimates > 5


def test_parallel_axes_are_flagged_finite_and_an_admissible_choice():
    model, data, geometry = _sliding_capsule('type="capsule" size="0.06 0.2"')
    qvel = np.array([0.3, -0.2, 0.5, 0.8])
    update(model, data, [0.3, 0.0, 0.1, 0.0], qvel)
    near = geometry.measure(data)
    result = second_order(geometry, data, near, np.zeros(4))
    assert result.parallel[0]
    assert not result.exact[0]
    assert np.isfinite(result.accel_m_s2[0])
    # The witness point of a sits on its end and is held: one material point against the z axis.
    assert near.witness_i_m[0, 2] == pytest.approx(-0.1)
    height = near.witness_i_m[0, 2] - 0.1
    across = np.array([0.3, -0.2 - 0.8 * height])
    radial = np.array([1.0, 0.0])
    expected = (across @ across - (radial @ across) ** 2) / 0.3
    assert result.accel_m_s2[0] == pytest.approx(expected)


def test_crossing_axes_are_finite_and_not_exact():
    model, data, geometry = _sliding_capsule('type="capsule" size="0.06 0.2"')
    update(model, data, [0.0, 0.0, 0.1, 1.0], np.ones(4))
    result = second_order(geometry, data, geometry.measure(data), np.ones(4))
    assert np.isfinite(result.accel_m_s2[0])
    assert not result.exact[0]


def test_a_pair_without_radii_is_an_estimate_and_bad_acceleration_is_refused():
    model, data, geometry = build(
        '<geom name="b" type="box" size="0.1 0.1 0.1"/><body><joint type="slide"/>'
        '<geom name="a" type="box" size="0.1 0.1 0.1" pos="0 0 0.5"/></body>',
        [("a", "b")],
    )
    update(model, data, [0.01], [1.0])
    near = geometry.measure(data)
    assert not second_order(geometry, data, near, [0.0]).exact[0]
    with pytest.raises(WorkcellError, match=r"qacc\[0\] is nan"):
        second_order(geometry, data, near, [np.nan])
