"""Arm files of many kinds: each ends imported right, or refused with what to do; never a traceback."""

from __future__ import annotations

import struct

import mujoco
import numpy as np
import pytest

from workcell.cli import main
from workcell.errors import InputError
from workcell.scene.adapt import Wishes, adapt

TETRAHEDRON = "0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"
TEXT = """
<mujoco model="kind"><compiler angle="radian"/>
  <asset>{asset}</asset>
  <worldbody>
    <body name="base">{base}
      <geom type="cylinder" size="0.05 0.1" pos="0 0 0.1"/>
      <body name="{link}" pos="0 0 0.25"><joint name="j1" {joint}/>{geom}
        <body name="upper" pos="0.3 0 0"><joint name="j2" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03"/>
          <body name="hand" pos="0.25 0 0"><joint name="j3" axis="0 0 1" range="-2 2"/>
            <geom type="box" size="0.05 0.02 0.02" pos="0.05 0 0"/>
            <site name="tool" pos="0.1 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  {tail}
</mujoco>
"""
PARTS = {
    "asset": "",
    "base": "",
    "link": "lower",
    "joint": 'axis="0 0 1" range="-2 2"',
    "geom": '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>',
    "tail": "",
}
WHEELS = '<joint name="x" type="slide" axis="1 0 0" range="-1 1"/><joint name="y" type="slide" axis="0 1 0" range="-1 1"/><joint name="yaw" axis="0 0 1" range="-3 3"/>'


def arm(folder, **parts: str):
    path = folder / "kind.xml"
    path.write_text(TEXT.format(**PARTS | parts))
    return path


IMPORTED = {
    "slash": ({"link": "left/lower"}, 3),
    "base": ({"link": "stand"}, 3),
    "slide": ({"joint": 'type="slide" axis="0 0 1" range="0 0.3"'}, 3),
    "endless": ({"joint": 'axis="0 0 1"'}, 3),
    "free base": ({"base": '<freejoint name="float"/>'}, 3),
    "mobile base": ({"base": WHEELS}, 6),
    "mirrored mesh": (
        {
            "asset": f'<mesh name="m" vertex="{TETRAHEDRON}" scale="-1 1 1"/>',
            "geom": '<geom type="mesh" mesh="m"/>',
        },
        3,
    ),
    "bare link": (
        {"geom": '<inertial pos="0 0 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/>'},
        3,
    ),
    "loop": (
        {"tail": '<equality><connect body1="hand" body2="base" anchor="0 0 0"/></equality>'},
        3,
    ),
    "keyframe out of range": (
        {"tail": '<keyframe><key name="rest" qpos="9 9 9"/></keyframe>'},
        3,
    ),
}


@pytest.mark.parametrize("name", IMPORTED)
def test_it_is_imported(tmp_path, name):
    parts, joints = IMPORTED[name]
    adapted = adapt(arm(tmp_path, **parts), Wishes())
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    assert model.njnt == joints
    assert set(model.jnt_type.tolist()) <= {
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
    }
    assert np.isfinite(model.key("home").qpos).all()


REFUSED = {
    "ball": ({"joint": 'type="ball"'}, "hold it where it is (--lock NAME=0)"),
    "mocap": ({"base": '<site name="x"/></body><body name="aim" mocap="true">'}, "mocap body"),
    "damping": (
        {"joint": 'axis="0 0 1" range="-2 2" damping="1 2"'},
        "polynomial stiffness or damping",
    ),
    "mesh": (
        {"asset": '<mesh name="m" file="m.stl"/>', "geom": '<geom type="mesh" mesh="m"/>'},
        "m.stl",
    ),
    "range": (
        {"joint": 'axis="0 0 1" range="0 0" limited="true"'},
        "range[0] should be smaller than range[1]",
    ),
    "weightless": (
        {"geom": '<geom type="box" size="0.05 0.02 0.02" mass="0"/>'},
        "mass and inertia of moving bodies",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_with_what_to_do(tmp_path, name):
    parts, words = REFUSED[name]
    path = arm(tmp_path, **parts)
    with pytest.raises(InputError) as refused:
        adapt(path, Wishes())
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_ball_joint_can_be_held_where_it_is_and_nowhere_else(tmp_path):
    path = arm(tmp_path, joint='type="ball"')
    adapted = adapt(path, Wishes(locked={"j1": 0.0}))
    assert mujoco.MjModel.from_xml_string(adapted.xml).njnt == 2
    with pytest.raises(InputError, match="is of type ball, which is held where the file puts it"):
        adapt(path, Wishes(locked={"j1": 0.5}))


def test_a_mobile_base_is_not_held_apart_from_the_floor_it_drives_on(tmp_path, capsys):
    path = arm(tmp_path, base=WHEELS)
    assert adapt(path, Wishes()).on_floor == ("base",)
    assert main(["import", str(path), "--name", "mobile", "--out", str(tmp_path / "arms")]) == 0
    assert "first scenario: workcell run" in capsys.readouterr().out
    text = (tmp_path / "arms" / "mobile" / "mobile_pair.toml").read_text()
    assert 'pair = ["nurse/base", "floor"]' in text


def test_limits_that_cannot_be_meant_are_told_and_not_used(tmp_path):
    numeric = '<custom><numeric name="joint_velocity_limit_rad_s" data="1 0 -3"/></custom>'
    adapted = adapt(arm(tmp_path, tail=numeric), Wishes())
    assert any("joint_velocity_limit_rad_s of the file is" in line for line in adapted.unknown)
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    assert (model.numeric("joint_velocity_limit_rad_s").data == 1.0).all()


URDF = """
<robot name="r">
  <link name="base"><collision><geometry><cylinder length="0.2" radius="0.05"/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="lower"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="10" velocity="1"/></joint>
  <link name="lower">
    <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><mesh filename="package://robot/meshes/{mesh}"/></geometry></collision></link>
</robot>
"""


def stl(path):
    """A tetrahedron as a binary STL file."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    path.parent.mkdir(parents=True)
    path.write_bytes(
        bytes(80)
        + struct.pack("<I", 4)
        + b"".join(struct.pack("<12fH", 0, 0, 0, *corners[list(f)].ravel(), 0) for f in faces)
    )


def test_paths_of_ros_packages_are_found_beside_and_above_the_file(tmp_path):
    stl(tmp_path / "robot" / "meshes" / "link.stl")
    path = tmp_path / "robot" / "urdf" / "r.urdf"
    path.parent.mkdir()
    path.write_text(URDF.format(mesh="link.stl"))
    adapted = adapt(path, Wishes())
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    assert model.njnt == 1
    assert any(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    assert path.read_text() == URDF.format(mesh="link.stl"), "the original is not touched"


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        ("gone.stl", "no such mesh in any folder above"),
        ("link.dae", "MuJoCo reads .stl, .obj, .msh"),
    ],
)
def test_meshes_that_cannot_be_read_are_refused_by_name(tmp_path, mesh, words):
    stl(tmp_path / "robot" / "meshes" / "link.dae")
    path = tmp_path / "robot" / "r.urdf"
    path.write_text(URDF.format(mesh=mesh))
    with pytest.raises(InputError) as refused:
        adapt(path, Wishes())
    assert f"package://robot/meshes/{mesh}: " in str(refused.value)
    assert words in str(refused.value)
