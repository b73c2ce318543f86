"""Names become addresses once, and fail there."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from tests.scene.test_compose import mixed
from workcell import assets
from workcell.errors import InputError
from workcell.scene.addresses import (
    DEFAULT_ACCELERATION_LIMIT_RAD_S2,
    DEFAULT_VELOCITY_LIMIT_RAD_S,
)


def own_model(folder, replacements: dict[str, str]) -> dict:
    """A cell of one slider whose file was changed."""
    text = assets.model_file("slider").read_text()
    for old, new in replacements.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "own.xml").write_text(text)
    content = mixed("slider")
    content["arm"][0]["model"] = "own.xml"
    return content


def test_addresses_point_at_the_arms_own_joints(tmp_path):
    cell = cells.build(tmp_path, mixed("planar3", "slider", "pa10"))
    for arm in cell.arms:
        for joint, dof, adr, servo in zip(arm.joints, arm.dofs, arm.qpos, arm.servos, strict=True):
            handle = cell.model.joint(joint)
            assert joint.startswith(f"{arm.name}/")
            assert (handle.dofadr[0], handle.qposadr[0]) == (dof, adr)
            assert cell.model.actuator_trnid[servo.actuator, 0] == handle.id
        assert cell.model.site(arm.tool_site).name == arm.tool_site_name == f"{arm.name}/tool"


def test_limits_come_from_the_scenario_else_the_file_else_the_default(tmp_path):
    cell = cells.build(tmp_path, mixed("planar3"))
    np.testing.assert_array_equal(cell.arms[0].velocity_limit_rad_s, [2, 2, 3])
    content = mixed("planar3")
    content["arm"][0]["velocity_limit_rad_s"] = [0.5, 0.6, 0.7]
    arm = cells.build(tmp_path, content).arms[0]
    np.testing.assert_array_equal(arm.velocity_limit_rad_s, [0.5, 0.6, 0.7])
    np.testing.assert_array_equal(arm.acceleration_limit_rad_s2, [4, 4, 6])
    arm = cells.build(tmp_path, own_model(tmp_path, {"joint_": "other_"})).arms[0]
    np.testing.assert_array_equal(arm.velocity_limit_rad_s, [DEFAULT_VELOCITY_LIMIT_RAD_S])
    np.testing.assert_array_equal(
        arm.acceleration_limit_rad_s2, [DEFAULT_ACCELERATION_LIMIT_RAD_S2]
    )


def test_limits_in_the_file_must_fit_the_joints(tmp_path):
    content = own_model(tmp_path, {'limit_rad_s" data="0.5"': 'limit_rad_s" data="0.5 -1"'})
    with pytest.raises(InputError, match=r"joint_velocity_limit_rad_s = \[0.5, -1.0\]: 1 positive"):
        cells.build(tmp_path, content)


def test_a_joint_without_a_range_is_unlimited(tmp_path):
    cell = cells.build(tmp_path, own_model(tmp_path, {' range="-0.4 0.4"': ""}))
    assert (cell.arms[0].lower_rad, cell.arms[0].upper_rad) == ([-np.inf], [np.inf])


@pytest.mark.parametrize(
    ("actuator", "kind", "lead_s"),
    [
        ('<position name="X" joint="X" kp="200" kv="40"/>', "position", 0.2),
        ('<velocity name="X" joint="X" kv="40"/>', "velocity", 0.0),
    ],
)
def test_both_kinds_of_servo_are_known(tmp_path, actuator, kind, lead_s):
    content = own_model(tmp_path, {'<position name="X" joint="X" kp="17800" kv="372"/>': actuator})
    (servo,) = cells.build(tmp_path, content).arms[0].servos
    assert (servo.kind, servo.lead_s) == (kind, lead_s)
