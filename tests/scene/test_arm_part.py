"""Only joints on the way to the tool are driven; where an arm starts, and what it lacks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from tests.scene.test_normal_form import beside, leg
from workcell import run
from workcell.errors import InputError

FINGER = (
    '<body name="finger" pos="0.2 0 0"><joint name="grip" type="slide" axis="0 1 0" range="0 0.05"/>'
    '<geom name="finger" class="thin" type="box" size="0.02 0.005 0.005" mass="0.05"/></body>'
)
SECOND = (
    '<body name="other" pos="0 0.5 0"><joint name="other" axis="0 0 1"/>'
    '<geom name="other" class="thin" type="box" size="0.1 0.01 0.01" mass="0.5"/></body>'
)


def test_joints_that_do_not_move_the_tool_are_held_by_name(tmp_path):
    leg(tmp_path, more=FINGER, world=SECOND, limits="")
    cell = cells.build(tmp_path, beside(tmp_path, home=(0.4, 0.5, 0.02, 0.7)))
    arm = cell.arms[1]
    assert arm.joints == ("arm1/hip", "arm1/knee")
    assert cell.model.nv == 5
    assert any("grip = 0.02, other = 0.7" in note for note in cell.notes)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    alone = mujoco.MjModel.from_xml_path(str(tmp_path / "leg.xml"))
    there = mujoco.MjData(alone)
    there.qpos[:] = [0.4, 0.5, 0.02, 0.7]
    mujoco.mj_kinematics(alone, there)
    base = data.body("arm1/")
    for body in ("finger", "other"):
        found = base.xmat.reshape(3, 3).T @ (data.body(f"arm1/{body}").xpos - base.xpos)
        np.testing.assert_allclose(found, there.body(body).xpos, atol=1e-12)


def test_home_may_speak_of_driven_joints_only(tmp_path):
    leg(tmp_path, more=FINGER, limits="")
    content = beside(tmp_path)
    content["arm"][1]["locked"] = {"grip": 0.03}
    cell = cells.build(tmp_path, content)
    np.testing.assert_array_equal(cell.arms[1].home_rad, [0.4, 0.5])
    assert any("grip = 0.03" in note for note in cell.notes)
    content["arm"][1]["locked"] = {}
    assert any("grip = 0" in note for note in cells.build(tmp_path, content).notes)


def test_a_joint_on_the_way_can_be_locked(tmp_path):
    leg(tmp_path)
    content = beside(tmp_path, home=(0.5,))
    content["arm"][1] |= {"locked": {"hip": 0.4}}
    cell = cells.build(tmp_path, content)
    assert cell.arms[1].joints == ("arm1/knee",)
    both = cells.build(tmp_path / "both", beside(leg(tmp_path / "both").parent))
    tools = []
    for which in (cell, both):
        data = mujoco.MjData(which.model)
        which.place_home(data)
        mujoco.mj_kinematics(which.model, data)
        tools.append(data.site("arm1/tool").xpos.copy())
    np.testing.assert_allclose(tools[0], tools[1], atol=1e-12)


def test_limits_of_the_file_and_of_the_scenario_follow_the_driven_joints(tmp_path):
    numeric = '<numeric name="joint_velocity_limit_rad_s" data="1 2 3"/>'
    leg(tmp_path, more=FINGER, limits=numeric)
    content = beside(tmp_path, home=(0.4, 0.5, 0.02))
    content["arm"][1]["acceleration_limit_rad_s2"] = [4.0, 5.0, 6.0]
    arm = cells.build(tmp_path, content).arms[1]
    np.testing.assert_array_equal(arm.velocity_limit_rad_s, [1, 2])
    np.testing.assert_array_equal(arm.acceleration_limit_rad_s2, [4, 5])
    assert arm.assumed == ()


def test_limits_that_nobody_states_are_said(tmp_path):
    leg(tmp_path, limits="")
    notes = cells.build(tmp_path, beside(tmp_path)).notes
    assert [note.split(": ")[1].split(" ")[1] for note in notes] == [
        "velocity_limit_rad_s",
        "acceleration_limit_rad_s2",
    ]
    assert all("for every joint is assumed" in note for note in notes)


def test_a_keyframe_can_be_home(tmp_path):
    leg(tmp_path, tail='<keyframe><key name="ready" qpos="0.3 -0.2"/></keyframe>')
    content = beside(tmp_path)
    content["arm"][1]["home_rad"] = "key:ready"
    np.testing.assert_array_equal(cells.build(tmp_path, content).arms[1].home_rad, [0.3, -0.2])
    assert cells.load(tmp_path, content).arm[1].home_rad == "key:ready"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"home_rad": "key:redy"}, "no such keyframe in leg.xml; allowed: key:ready"),
        ({"home_rad": [0.1, 0.2, 0.3]}, "has 3 entries, leg.xml has 2 joints (hip, knee)"),
        ({"locked": {"hop": 0.0}}, "arm.arm1.locked.hop: no such joint in leg.xml"),
        ({"locked": {"hip": 9.0}}, "arm.arm1.locked.hip = 9: the joint allows"),
        (
            {"locked": {"hip": 0.0, "knee": 0.0}, "home_rad": [0.0, 0.0]},
            "no joint that is not locked moves it",
        ),
        (
            {"velocity_limit_rad_s": [1.0], "home_rad": "key:ready"},
            "velocity_limit_rad_s: has 1 entries; 2 are needed",
        ),
    ],
)
def test_what_does_not_fit_the_file_is_refused_by_key(tmp_path, change, words):
    leg(tmp_path, tail='<keyframe><key name="ready" qpos="0.3 -0.2"/></keyframe>')
    content = beside(tmp_path)
    content["arm"][1] |= change
    with pytest.raises(InputError) as refused:
        cells.build(tmp_path, content)
    assert words in str(refused.value)


def bare(folder, actuators: str) -> None:
    path = leg(folder)
    text = path.read_text()
    start, end = text.index("<actuator>"), text.index("</actuator>")
    path.write_text(text[:start] + f"<actuator>{actuators}" + text[end:])


def test_a_kinematic_arm_needs_no_actuators(tmp_path):
    bare(tmp_path, "")
    content = beside(tmp_path, plant="kinematic")
    content["simulation"] |= {"duration_s": 0.2, "period_s": 0.01}
    content["check"] = {"enabled": False}
    content["arm"][1] |= {
        "job": [{"kind": "move", "waypoints": [{"position_m": [3.0, 0.2, 0.3]}]}],
        "base_wxyz": [1.0, 0.0, 0.0, 0.0],
    }
    cell = cells.build(tmp_path, content)
    assert cell.arms[1].servos == ()
    content["arm"][1]["job"] = [{"kind": "wait", "duration_s": 0.1}]
    summary = run.run(cells.load(tmp_path, content), tmp_path / "out")
    assert summary["metrics"]["fault"] is None


def test_a_dynamic_arm_without_them_is_refused_with_its_joints(tmp_path):
    bare(tmp_path, "")
    with pytest.raises(InputError, match="arm1/hip, arm1/knee: is moved by 0 actuators"):
        cells.build(tmp_path, beside(tmp_path))


@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
def test_torque_motors_are_refused_with_their_joints(tmp_path, plant):
    bare(tmp_path, '<motor joint="hip"/><motor joint="knee"/>')
    with pytest.raises(InputError, match="arm1/hip, arm1/knee: its actuator is neither"):
        cells.build(tmp_path, beside(tmp_path, plant=plant))
