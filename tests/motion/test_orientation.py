"""Orientations in plain floats against SciPy's, in ugly places too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workcell.motion.orientation import (
    angular_velocity,
    pointing,
    product,
    rotation_between,
    turned,
    turned_towards,
)

directions = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)
# Tiny angles, and those beside half a turn and a whole one, are where formulas lose digits.
angles = st.one_of(
    st.floats(0.0, 2 * np.pi),
    st.sampled_from([0.0, 5e-324, 1e-300, 1e-160, 1e-16, 1e-9, 1e-8, 9.9e-4, 1.1e-3]),
    st.sampled_from([np.pi - 1e-6, np.pi - 1e-12, np.pi, np.pi + 1e-12, 2 * np.pi - 1e-9]),
)
vectors = st.builds(lambda axis, angle: angle * axis, directions, angles)
quaternions = st.builds(
    lambda vector, sign: sign * Rotation.from_rotvec(vector).as_quat(scalar_first=True),
    vectors,
    st.sampled_from([1.0, -1.0]),
)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def scipy(wxyz) -> Rotation:
    return Rotation.from_quat(wxyz, scalar_first=True)


def same_rotation(a_wxyz, b_wxyz) -> None:
    assert np.linalg.norm(b_wxyz) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(
        b_wxyz * np.copysign(1.0, np.dot(a_wxyz, b_wxyz)), a_wxyz, rtol=0.0, atol=1e-14
    )


def same_vector(a_rad, b_rad) -> None:
    """Rotation vectors; half a turn is as short one way round as the other."""
    if np.pi - np.linalg.norm(a_rad) < 1e-9:
        b_rad = b_rad * np.copysign(1.0, np.dot(a_rad, b_rad))
    np.testing.assert_allclose(b_rad, a_rad, rtol=0.0, atol=1e-14)


@given(quaternions, quaternions)
def test_a_product_is_one_rotation_after_another(a, b):
    same_rotation((scipy(a) * scipy(b)).as_quat(scalar_first=True), np.array(product(a, b)))


@given(quaternions, vectors)
def test_turning_is_that_of_scipy(wxyz, vector):
    expected = (Rotation.from_rotvec(vector) * scipy(wxyz)).as_quat(scalar_first=True)
    same_rotation(expected, turned(wxyz, vector))


@given(quaternions, quaternions)
def test_the_rotation_between_two_is_that_of_scipy(before, after):
    expected = (scipy(after) * scipy(before).inv()).as_rotvec()
    same_vector(expected, rotation_between(before, after))


@given(directions, st.floats(-300.0, np.log10(np.pi) - 1e-3))
def test_the_smallest_turn_keeps_its_digits(axis, exponent):
    vector = 10.0**exponent * axis
    found = rotation_between(UPRIGHT, turned(UPRIGHT, vector))
    np.testing.assert_allclose(found, vector, rtol=0.0, atol=1e-13 * 10.0**exponent)


@given(quaternions)
def test_no_turn_changes_nothing_to_the_last_bit(wxyz):
    assert turned(wxyz, np.zeros(3)) is wxyz
    assert not rotation_between(wxyz, wxyz.copy()).any()
    assert not rotation_between(UPRIGHT, -UPRIGHT).any()
    np.testing.assert_allclose(rotation_between(wxyz, -wxyz), 0.0, atol=1e-15)


@given(quaternions, st.floats(0.9, 1.1))
def test_a_quaternion_that_is_not_quite_of_length_one_counts_as_its_rotation(wxyz, length):
    """As one from a file may be."""
    other = np.array([0.5, -0.5, 0.5, 0.5])
    same_vector(rotation_between(other, wxyz), rotation_between(other, length * wxyz))
    same_rotation(turned(wxyz, np.ones(3)), turned(length * wxyz, np.ones(3)))
    np.testing.assert_allclose(pointing(length * wxyz), pointing(wxyz), atol=1e-14)


@given(quaternions)
def test_pointing_is_the_z_axis(wxyz):
    np.testing.assert_allclose(pointing(wxyz), scipy(wxyz).apply([0.0, 0.0, 1.0]), atol=1e-14)


@given(quaternions, directions, directions, st.sampled_from([0.0, 1.0, -1.0]))
@example(UPRIGHT, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), -1.0)
def test_what_points_one_way_is_turned_to_point_another_the_shortest_way(wxyz, axis, other, along):
    """Also where it points there already, or right away from there."""
    direction = other if along == 0.0 else along * axis
    result = turned_towards(wxyz, axis, direction)
    turn = scipy(result) * scipy(wxyz).inv()
    # The directions are known to 1e-16, so a turn by nearly nothing or half is to some 1e-8 of an axis.
    np.testing.assert_allclose(turn.apply(axis), direction, atol=1e-8)
    assert turn.magnitude() == pytest.approx(
        np.arctan2(np.linalg.norm(np.cross(axis, direction)), axis @ direction), abs=1e-8
    )


@given(quaternions, st.tuples(*[st.floats(-3, 3)] * 3))
def test_the_angular_velocity_is_that_of_the_finite_turn(wxyz, omega):
    """Of floats and of many at once; q̇ = ω q / 2, and by central differences."""
    omega = np.array(omega)
    rate = np.array(product((0.0, *omega), wxyz)) / 2.0
    np.testing.assert_allclose(angular_velocity(wxyz, rate), omega, atol=1e-13)
    many = angular_velocity(np.transpose([wxyz, UPRIGHT]), np.transpose([rate, np.zeros(4)]))
    np.testing.assert_allclose(np.transpose(many), [omega, np.zeros(3)], atol=1e-13)
    step = 1e-5
    ends = [turned(wxyz, sign * step * omega) for sign in (-1.0, 1.0)]
    slope = (ends[1] - ends[0]) / (2 * step)
    np.testing.assert_allclose(angular_velocity(wxyz, slope), omega, atol=1e-8)


def test_what_is_not_a_number_is_not_made_one():
    nothing = np.full(4, np.nan)
    assert np.isnan(rotation_between(UPRIGHT, nothing)).all()
    assert np.isnan(turned(UPRIGHT, nothing[:3])).all()
    assert np.isnan(turned(nothing, np.ones(3))).all()
