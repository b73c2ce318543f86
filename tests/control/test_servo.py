"""Velocity commands become controls that track without lag and never wind up."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from tests.scene.test_compose import mixed
from workcell import assets
from workcell.control.servo import LARGEST_LAG_RAD, ServoCommand


def track(cell, velocity_m_s: float, ticks: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Drive a slider at a constant velocity from its home; positions wanted and had."""
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    arm = cell.arms[0]
    servo = ServoCommand(arm, dt_s=cell.period_s)
    wanted, had, lost = [], [], False
    for k in range(ticks):
        lost |= servo.write(data, data.qpos[arm.qpos].copy(), np.array([velocity_m_s]))
        mujoco.mj_step(cell.model, data)
        wanted.append(arm.home_rad[0] + velocity_m_s * cell.period_s * (k + 1))
        had.append(data.qpos[arm.qpos[0]])
    return np.array(wanted), np.array(had), lost


def test_a_constant_velocity_is_tracked_without_lag(tmp_path):
    cell = cells.build(tmp_path, mixed("slider"))
    wanted, had, lost = track(cell, 0.1, 400)
    assert not lost
    # An ordinary position servo would trail by kv / kp times the velocity, here 2 mm; what is left is the rail's damping.
    np.testing.assert_allclose(had[200:], wanted[200:], atol=2e-4)


def test_a_velocity_servo_gets_the_velocity_itself(tmp_path):
    text = assets.model_file("slider").read_text()
    position = '<position name="X" joint="X" kp="17800" kv="372"/>'
    (tmp_path / "own.xml").write_text(
        text.replace(position, '<velocity name="X" joint="X" kv="2000"/>')
    )
    content = mixed("slider")
    content["arm"][0]["model"] = "own.xml"
    cell = cells.build(tmp_path, content)
    data = mujoco.MjData(cell.model)
    ServoCommand(cell.arms[0], dt_s=0.002).write(data, np.zeros(1), np.array([0.123]))
    assert data.ctrl[0] == 0.123
    wanted, had, lost = track(cell, 0.1, 400)
    assert not lost
    assert had[-1] - had[-101] == pytest.approx(wanted[-1] - wanted[-101], rel=0.02)


def test_a_blocked_joint_is_reported_and_does_not_leap_when_freed(tmp_path):
    cell = cells.build(tmp_path, mixed("slider"))
    arm, data = cell.arms[0], mujoco.MjData(cell.model)
    servo, stuck = ServoCommand(arm, dt_s=0.002), arm.home_rad.copy()
    reports = [servo.write(data, stuck, np.array([0.5])) for _ in range(200)]
    assert not reports[0]
    assert reports[-1]
    lead = arm.servos[0].lead_s * 0.5
    assert data.ctrl[0] - lead - stuck[0] <= LARGEST_LAG_RAD + 1e-12
