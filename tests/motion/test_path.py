"""Paths are smooth, start and end at rest, and keep their speed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workcell.motion import path as path_module
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, PathGeometry, TimedPath, standing

unit = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
point = st.tuples(*[st.floats(-1, 1)] * 3)
poses = st.lists(st.tuples(point, unit), min_size=2, max_size=5)


def geometry(poses) -> PathGeometry:
    quats = np.array([np.array(q) / np.linalg.norm(q) for _, q in poses])
    return PathGeometry(np.array([p for p, _ in poses]), quats)


def angle(a_wxyz, b_wxyz) -> float:
    a, b = (Rotation.from_quat(q, scalar_first=True) for q in (a_wxyz, b_wxyz))
    return float((a.inv() * b).magnitude())


@settings(max_examples=25, deadline=None)
@given(poses)
def test_the_curve_starts_ends_and_passes_where_it_should(poses):
    curve = geometry(poses)
    lengths = np.linspace(0.0, curve.length_m, 2000)
    along = np.array([curve.pose(s)[0] for s in lengths])
    spacing = curve.length_m / 2000
    for waypoint in curve.positions_m:
        assert np.linalg.norm(along - waypoint, axis=1).min() < spacing + 1e-4
    np.testing.assert_allclose(along[0], curve.positions_m[0], atol=1e-9)
    np.testing.assert_allclose(along[-1], curve.positions_m[-1], atol=1e-6)
    assert angle(curve.pose(curve.length_m)[1], curve.wxyz[-1]) < 1e-5


@settings(max_examples=25, deadline=None)
@given(poses, st.floats(0.02, 0.98))
def test_the_twist_is_the_derivative_of_the_pose(poses, where):
    """So the tool task is fed what the target really does; the rotation rate is in the world frame."""
    curve = geometry(poses)
    if curve.length_m < 0.05:
        return
    path = TimedPath(curve, speed_m_s=0.2, acceleration_m_s2=0.5)
    at, h = where * path.duration_s, 1e-5
    target, before, after = path.target(at), path.target(at - h), path.target(at + h)
    np.testing.assert_allclose(
        target.velocity_m_s, (after.position_m - before.position_m) / (2 * h), atol=1e-4
    )
    turned = Rotation.from_quat(after.wxyz, scalar_first=True) * (
        Rotation.from_quat(before.wxyz, scalar_first=True).inv()
    )
    np.testing.assert_allclose(
        target.angular_velocity_rad_s, turned.as_rotvec() / (2 * h), atol=2e-3
    )


@settings(max_examples=25, deadline=None)
@given(poses, st.floats(0.05, 0.5), st.floats(0.1, 2.0))
def test_speed_is_bounded_and_both_ends_are_at_rest(poses, speed, acceleration):
    path = TimedPath(geometry(poses), speed_m_s=speed, acceleration_m_s2=acceleration)
    times = np.linspace(-0.1, path.duration_s + 0.1, 400)
    targets = [path.target(t) for t in times]
    rates = [
        np.hypot(
            np.linalg.norm(t.velocity_m_s),
            TURN_LENGTH_M_PER_RAD * np.linalg.norm(t.angular_velocity_rad_s),
        )
        for t in targets
    ]
    assert max(rates) <= speed * 1.02
    for end in (path.target(0.0), path.target(path.duration_s)):
        assert not end.velocity_m_s.any()
        assert not end.angular_velocity_rad_s.any()


@given(st.floats(0.001, 3.0), st.floats(0.01, 1.0), st.floats(0.05, 5.0))
def test_the_clock_covers_the_whole_length_within_its_acceleration(length, speed, acceleration):
    line = PathGeometry(np.array([[0, 0, 0], [length, 0, 0]]), np.array([[1, 0, 0, 0]] * 2))
    path = TimedPath(line, speed_m_s=speed, acceleration_m_s2=acceleration)
    times = np.linspace(0.0, path.duration_s, 501)
    travelled = np.array([path.length_at(t) for t in times])
    assert travelled[0] == 0.0
    assert travelled[-1] == pytest.approx(length)
    assert (np.diff(travelled) >= -1e-12).all()
    rates = np.array([path.target(t).velocity_m_s[0] for t in times])
    steepest = np.abs(np.diff(rates)).max() / (times[1] - times[0])
    assert steepest <= acceleration * 1.01
    assert rates.max() <= speed * (1 + 1e-6)


def test_a_run_backwards_passes_the_same_poses():
    line = geometry(
        [((0, 0, 0), (1, 0, 0, 0)), ((0.3, 0.2, 0), (1, 1, 0, 0)), ((0.6, 0, 0), (0, 1, 0, 0))]
    )
    there = TimedPath(line, speed_m_s=0.2, acceleration_m_s2=0.5)
    back = TimedPath(line, speed_m_s=0.2, acceleration_m_s2=0.5, start_m=line.length_m, end_m=0.0)
    for t in np.linspace(0, there.duration_s, 23):
        out, home = there.target(t), back.target(back.duration_s - t)
        np.testing.assert_allclose(out.position_m, home.position_m, atol=1e-9)
        np.testing.assert_allclose(out.velocity_m_s, -home.velocity_m_s, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(point, point.filter(lambda p: np.linalg.norm(p) > 1e-4), unit)
def test_a_line_without_a_turn_is_what_the_spline_would_be(start, way, quaternion):
    positions = np.array([start, np.add(start, way)])
    wxyz = np.array(quaternion) / np.linalg.norm(quaternion)
    line = PathGeometry(positions, np.array([wxyz, wxyz]))
    spline = path_module._spline(positions, np.array([wxyz, wxyz]))
    assert line.length_m == pytest.approx(float(spline.x[-1]), rel=1e-9)
    assert line.length_m == pytest.approx(np.linalg.norm(way), rel=1e-9)
    for s in line.length_m * np.array([0.0, 0.3, 1.0]):
        value, rate = spline(s), spline(s, 1)
        target = line.target(s, 0.7)
        np.testing.assert_allclose(target.position_m, value[:3], atol=1e-9)
        assert angle(target.wxyz, value[3:]) < 1e-9
        np.testing.assert_allclose(target.velocity_m_s, 0.7 * rate[:3], atol=1e-9)
        assert not target.angular_velocity_rad_s.any()
    assert not line.bend(np.linspace(0.0, line.length_m, 5)).any()


@settings(max_examples=25, deadline=None)
@given(poses, st.floats(-0.2, 1.2), st.floats(-1.0, 1.0))
def test_a_target_is_the_curve_as_scipy_evaluates_it(poses, where, speed):
    """Beyond the ends, too, where it is that of the end; with a turn the other way round on the way back."""
    curve = geometry(poses)
    if curve.length_m == 0.0:
        return
    s = where * curve.length_m
    clamped = min(max(s, 0.0), curve.length_m)
    value, rate = curve._curve(clamped), curve._curve(clamped, 1)
    target = curve.target(s, speed)
    np.testing.assert_allclose(target.position_m, value[:3], atol=1e-12)
    assert angle(target.wxyz, value[3:]) < 1e-12
    np.testing.assert_allclose(target.velocity_m_s, speed * rate[:3], atol=1e-10)
    # ω of a unit quaternion, from its rotation a little later.
    h = 1e-6
    later = Rotation.from_quat(value[3:] + h * rate[3:], scalar_first=True)
    turn = later * Rotation.from_quat(value[3:], scalar_first=True).inv()
    np.testing.assert_allclose(
        target.angular_velocity_rad_s, speed * turn.as_rotvec() / h, rtol=1e-4, atol=1e-4
    )
    pose = curve.pose(s)
    np.testing.assert_array_equal(pose[0], target.position_m)
    np.testing.assert_array_equal(pose[1], target.wxyz)


def test_degenerate_paths_stand_still():
    """One waypoint, the same one twice, and a path of no length: each is a pose, not a division by zero."""
    for positions in ([[1, 2, 3]], [[1, 2, 3]] * 3):
        curve = PathGeometry(
            np.array(positions, float), np.array([[1.0, 0, 0, 0]] * len(positions))
        )
        path = TimedPath(curve, speed_m_s=0.1, acceleration_m_s2=0.5)
        assert (curve.length_m, path.duration_s) == (0.0, 0.0)
        target = path.target(1.0)
        np.testing.assert_array_equal(target.position_m, [1, 2, 3])
        assert not target.velocity_m_s.any()


def test_a_turn_on_the_spot_takes_time():
    turn = PathGeometry(np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [0, 0, 0, 1]]))
    assert turn.length_m == pytest.approx(np.pi * TURN_LENGTH_M_PER_RAD, rel=1e-3)
    target = TimedPath(turn, speed_m_s=0.1, acceleration_m_s2=1.0).target(3.0)
    np.testing.assert_allclose(target.angular_velocity_rad_s[:2], 0.0, atol=1e-9)
    assert abs(target.angular_velocity_rad_s[2]) == pytest.approx(
        0.1 / TURN_LENGTH_M_PER_RAD, rel=1e-3
    )


def test_a_standing_target_keeps_its_own_copy():
    position = np.zeros(3)
    target = standing(position, np.array([1.0, 0, 0, 0]))
    position[0] = 1.0
    assert target.position_m[0] == 0.0


@pytest.mark.parametrize("speed_m_s", [0.15, 0.3, 1.0])
@pytest.mark.parametrize(
    "corner",
    [[0.5, 0.12, 0.0], [0.0, 0.05, 0.0], [1.0, 0.0, 0.0]],
    ids=["round a corner", "back", "straight on"],
)
def test_bends_are_taken_no_faster_than_the_acceleration_allows(speed_m_s, corner):
    """Forwards and backwards; what counts is the whole acceleration of the tool, turning as length."""
    geometry = PathGeometry(
        [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], corner],
        [[1, 0, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0, 0], [1, 0, 0, 0]],
    )
    for ends in ({}, {"start_m": geometry.length_m, "end_m": 0.0}):
        path = TimedPath(geometry, speed_m_s=speed_m_s, acceleration_m_s2=0.5, **ends)
        clock = np.arange(0.0, path.duration_s + 0.1, 1e-3)
        targets = [path.target(t) for t in clock]
        twist = np.array(
            [
                np.concatenate([t.velocity_m_s, TURN_LENGTH_M_PER_RAD * t.angular_velocity_rad_s])
                for t in targets
            ]
        )
        assert np.linalg.norm(twist, axis=1).max() <= speed_m_s * 1.005
        assert np.linalg.norm(np.gradient(twist, 1e-3, axis=0), axis=1).max() < 1.15 * 0.5
        # What is fed forward is how the pose moves.
        moved = np.gradient(np.array([t.position_m for t in targets]), 1e-3, axis=0)
        np.testing.assert_allclose(moved[2:-2], twist[2:-2, :3], atol=1e-3 * speed_m_s)
        assert path.length_at(path.duration_s) == pytest.approx(path.end_m, abs=1e-9)
