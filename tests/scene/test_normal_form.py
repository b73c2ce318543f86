"""An arm in a cell is what its file says when MuJoCo alone compiles it, whatever stands beside it."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from tests.scene.test_compose import mixed
from workcell.errors import InputError
from workcell.scene import arm_file, compose, fidelity
from workcell.scene.normal_form import normal_form

LEG = """
<mujoco model="leg">
  {head}
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="thin"><geom group="2" rgba="1 0 0 1"/></default>
  </default>
  {assets}
  <worldbody>
    <body name="foot" {foot}>
      <geom name="foot_post" class="thin" type="cylinder" fromto="0 0 0 0 0 0.3" size="0.04" mass="2"/>
      <geom name="foot_capsule" type="capsule" group="4" fromto="0 0 0.03 0 0 0.27" size="0.06" mass="0"/>
      <body name="thigh" pos="0 0 0.3" {thigh}>
        <joint name="hip" axis="0 0 1" {range} damping="0.5" armature="0.1" {joint}/>
        <geom name="thigh_beam" class="thin" type="box" pos="0.15 0 0" size="0.15 0.02 0.02" mass="1.5"/>
        <geom name="thigh_capsule" type="capsule" group="4" fromto="0 0 0 0.3 0 0" size="0.05" mass="0"/>
        <body name="shin" pos="0.3 0 0" gravcomp="1">
          <joint name="knee" axis="0 0 1" {range} damping="0.5" armature="0.1"/>
          <geom name="shin_beam" class="thin" type="box" pos="0.12 0 0" size="0.12 0.02 0.02" mass="0.8"/>
          <geom name="shin_capsule" type="capsule" group="4" fromto="0 0 0 0.24 0 0" size="0.05" mass="0"/>
          {more}
          <site name="tool" pos="0.25 0 0" zaxis="1 0 0"/>
        </body>
      </body>
    </body>
    {world}
  </worldbody>
  <actuator>
    <position name="hip" joint="hip" kp="900" kv="30"/>
    <position name="knee" joint="knee" kp="300" kv="12"/>
  </actuator>
  <custom>{limits}</custom>
  {tail}
</mujoco>
"""
LIMITS = (
    '<numeric name="joint_velocity_limit_rad_s" data="2 2"/>'
    '<numeric name="joint_acceleration_limit_rad_s2" data="4 4"/>'
)
_PARTS = ("head", "assets", "foot", "thigh", "joint", "more", "world", "tail")
_TETRAHEDRON = "0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"


def leg(folder: Path, name: str = "leg.xml", **parts: str) -> Path:
    """Write an arm of two joints with something of its own."""
    defaults = {"range": 'range="-120 120"', "limits": LIMITS} | dict.fromkeys(_PARTS, "")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(LEG.format(**defaults | parts))
    return path


def beside(folder: Path, *, home: tuple[float, ...] = (0.4, 0.5), plant: str = "dynamic") -> dict:
    """A cell of the arm `leg.xml` and a shipped one."""
    content = mixed("planar3", "planar3")
    content["simulation"] = {"plant": plant}
    content["arm"][1] |= {"model": "leg.xml", "home_rad": list(home)}
    return content


RADIAN = '<compiler angle="radian"/>'
RADIANS = 'range="-2 2"'
MEANINGS = {
    "degrees by default": {"foot": 'euler="0 0 90"', "thigh": 'euler="10 20 30"'},
    "degrees in so many words": {
        "head": '<compiler angle="degree"/>',
        "foot": 'axisangle="0 0 1 45"',
    },
    "another Euler sequence": {
        "head": '<compiler angle="radian" eulerseq="ZYX"/>',
        "range": RADIANS,
        "thigh": 'euler="0.3 -0.4 0.5"',
    },
    "no automatic limits": {
        "head": '<compiler angle="radian" autolimits="false"/>',
        "range": 'range="-2 2" limited="true"',
    },
    "limits that do not count": {
        "head": RADIAN,
        "range": 'range="-2 2" limited="false"',
    },
    "a total mass": {"head": '<compiler settotalmass="9"/>'},
    "a least mass and inertia": {"head": '<compiler boundmass="1" boundinertia="0.01"/>'},
    "balanced inertia": {
        "head": '<compiler balanceinertia="true"/>',
        "more": '<body name="tip"><inertial pos="0 0 0" mass="0.1" diaginertia="1 1 5"/></body>',
    },
    "inertia from geoms in spite of what is written": {
        "head": '<compiler inertiafromgeom="true"/>',
        "more": '<inertial pos="0 0 0" mass="7" diaginertia="1 1 1"/>',
    },
    "a full inertia": {
        "more": '<inertial pos="0.1 0 0" mass="1" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>'
    },
    "a zero of the joint elsewhere": {"joint": 'ref="20" springref="10" stiffness="3"'},
    "a joint beside its body": {"joint": 'pos="0.02 0.01 0"'},
    "a frame and copies": {
        "more": '<frame euler="0 0 30"><replicate count="3" euler="0 0 40"><geom name="rib" type="sphere" size="0.01" pos="0.1 0 0"/></replicate></frame>'
    },
    "a mesh": {
        "assets": f'<asset><mesh name="tip" vertex="{_TETRAHEDRON}" scale="1 2 3" refpos="0.01 0 0"/></asset>',
        "more": '<geom name="tip" type="mesh" mesh="tip" euler="20 0 0"/>',
    },
    "a primitive fitted to a mesh": {
        "head": '<compiler fitaabb="true"/>',
        "assets": f'<asset><mesh name="tip" vertex="{_TETRAHEDRON}" scale="1 1 4"/></asset>',
        "more": '<geom name="tip" type="capsule" mesh="tip" euler="20 0 0"/>',
    },
    "no names": {"more": '<geom type="sphere" size="0.01" pos="0.1 0 0"/><site pos="0 0 0.1"/>'},
    "names with slashes": {"more": '<geom name="a/b" size="0.01"/><site name="a/c" pos="0 0 1"/>'},
    "a material": {
        "assets": '<asset><material name="steel" rgba="0.1 0.2 0.3 1"/></asset>',
        "more": '<geom size="0.01" material="steel"/>',
    },
}


@pytest.mark.parametrize("parts", MEANINGS.values(), ids=MEANINGS)
def test_an_arm_means_in_a_cell_what_its_file_says_alone(tmp_path, parts):
    path = leg(tmp_path, **parts)
    cell = cells.build(tmp_path, beside(tmp_path))
    alone = mujoco.MjModel.from_xml_path(str(path))
    there, here = mujoco.MjData(alone), mujoco.MjData(cell.model)
    there.qpos[:] = [0.4, 0.5]
    cell.place_home(here)
    for model, data in ((alone, there), (cell.model, here)):
        mujoco.mj_kinematics(model, data)
    base = here.body("arm1/")
    turn = base.xmat.reshape(3, 3)
    for site in ("tool",):
        found = turn.T @ (here.site(f"arm1/{site}").xpos - base.xpos)
        np.testing.assert_allclose(found, there.site(site).xpos, atol=1e-12)
        np.testing.assert_allclose(
            turn.T @ here.site(f"arm1/{site}").xmat.reshape(3, 3),
            there.site(site).xmat.reshape(3, 3),
            atol=1e-12,
        )
    for body in ("foot", "thigh", "shin"):
        assert cell.model.body(f"arm1/{body}").mass == alone.body(body).mass
        np.testing.assert_array_equal(
            cell.model.body(f"arm1/{body}").inertia, alone.body(body).inertia
        )
    for joint in ("hip", "knee"):
        mine, theirs = cell.model.joint(f"arm1/{joint}"), alone.joint(joint)
        assert mine.range.tolist() == theirs.range.tolist()
        assert cell.model.jnt_limited[mine.id] == alone.jnt_limited[theirs.id]
    # And the arm beside it is as it is in a cell of its own.
    other = cells.build(tmp_path / "other", mixed("planar3")).model
    for joint in ("J1", "J2", "J3"):
        assert cell.model.joint(f"arm0/{joint}").range.tolist() == (
            other.joint(f"arm0/{joint}").range.tolist()
        )
    assert cell.model.body("arm0/link2").mass == other.body("arm0/link2").mass


OF_THE_CELL = {
    "timestep": '<option timestep="0.0005"/>',
    "gravity": '<option gravity="0 0 0"/>',
    "integrator": '<option integrator="RK4"/>',
    "cone": '<option cone="elliptic"/>',
    "density": '<option density="1000" viscosity="1" wind="1 0 0"/>',
    "disableflags": '<option><flag gravity="disable"/></option>',
    "enableflags": '<option><flag energy="enable"/></option>',
}


@pytest.mark.parametrize("option", OF_THE_CELL)
def test_what_belongs_to_the_cell_is_not_taken_and_said_in_one_line(tmp_path, option):
    plain = leg(tmp_path / "plain")
    expected = cells.build(plain.parent, beside(plain.parent))
    own = leg(tmp_path / "own", tail=OF_THE_CELL[option])
    cell = cells.build(own.parent, beside(own.parent))
    assert (tmp_path / "own" / "scene" / "scene.xml").read_text() == (
        tmp_path / "plain" / "scene" / "scene.xml"
    ).read_text()
    assert not expected.notes
    (note,) = cell.notes
    assert note.startswith("arm.arm1: leg.xml: option")
    assert option in note


@pytest.mark.parametrize(
    "setting",
    [
        '<visual><headlight ambient="1 0 0"/><map znear="0.1"/></visual>',
        '<statistic extent="9" meansize="3"/>',
        '<size memory="20M" nuser_geom="3"/>',
    ],
)
def test_how_a_file_wants_to_be_looked_at_is_ignored(tmp_path, setting):
    plain, own = leg(tmp_path / "plain"), leg(tmp_path / "own", tail=setting)
    texts = []
    for path in (plain, own):
        cells.build(path.parent, beside(path.parent))
        texts.append((path.parent / "scene" / "scene.xml").read_text())
    assert texts[0] == texts[1]


def test_a_ground_of_an_arm_file_is_left_out_and_said(tmp_path):
    leg(tmp_path, world='<geom name="ground" type="plane" size="1 1 1"/><light pos="0 0 3"/>')
    cell = cells.build(tmp_path, beside(tmp_path))
    assert "ground" not in [cell.model.geom(g).name for g in range(cell.model.ngeom)]
    assert any("plane ground" in note for note in cell.notes)
    assert any("1 lights" in note for note in cell.notes)


REFUSED = {
    "body 'target' is a mocap body": {"world": '<body name="target" mocap="true"/>'},
    "geom 'hills' is of type hfield": {
        "assets": '<asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>',
        "world": '<geom name="hills" type="hfield" hfield="h"/>',
    },
    "equality 'linked' ties driven joints": {
        "tail": '<equality><joint name="linked" joint1="hip" joint2="knee"/></equality>'
    },
    "equality 'tied' ties driven joints": {
        "tail": '<equality><weld name="tied" body1="shin"/></equality>'
    },
    "tendon 'band' has a spring": {
        "tail": '<tendon><fixed name="band" stiffness="3"><joint joint="hip" coef="1"/></fixed></tendon>'
    },
    "joint 'screw' is of type ball": {
        "more": '<body name="tip"><joint name="screw" type="ball"/><geom size="0.01"/></body>'
    },
    "joint 'loose' is of type free": {
        "world": '<body name="cup"><freejoint name="loose"/><geom size="0.01"/></body>'
    },
    "is not a readable MJCF file": {"more": "<no_such_thing/>"},
    "geom 'spike': geom_pos = [nan  0.  0.]: is not finite": {
        "more": '<geom name="spike" size="0.01" pos="nan 0 0" mass="0"/>'
    },
    "joint 'free_turn': jnt_range = [-inf  inf]: is not finite": {
        "more": '<body name="tip"><joint name="free_turn" range="-inf inf"/><geom size="0.01"/></body>'
    },
    "= 'bell\\x07': has a character that cannot be printed": {"more": '<site name="bell\x07"/>'},
}


def test_numbers_beyond_those_of_a_type_mean_nothing(tmp_path):
    """A sphere has one number; files that turn boxes into spheres leave the other two."""
    leg(tmp_path, more='<geom name="knob" size="0.01 0.02 0.03"/>')
    cell = cells.build(tmp_path, beside(tmp_path))
    assert cell.model.geom("arm1/knob").size.tolist() == [0.01, 0.0, 0.0]


def test_a_name_that_is_no_text_is_refused(tmp_path):
    path = leg(tmp_path, more='<site name="NAME"/>')
    path.write_bytes(path.read_bytes().replace(b"NAME", b"b\xe9ta"))
    with pytest.raises(InputError, match="is not UTF-8 text; write it in UTF-8"):
        cells.build(tmp_path, beside(tmp_path))


@pytest.mark.parametrize("words", REFUSED)
def test_what_no_cell_can_carry_is_refused_by_name(tmp_path, words):
    leg(tmp_path, **REFUSED[words])
    content = beside(tmp_path)
    if any(kind in words for kind in ("is of type ball", "is of type free", "free_turn")):
        content["arm"][1]["home_rad"] = [0.4, 0.5, 0.0]
    with pytest.raises(InputError) as refused:
        cells.build(tmp_path, content)
    fault = refused.value.faults[0]
    assert words in fault
    assert fault.startswith("arm.arm1.model = ")
    assert "leg.xml" in fault


def test_a_file_that_never_ends_is_refused_before_it_is_read(tmp_path):
    leg(tmp_path, tail='<include file="/dev/zero"/>')
    with pytest.raises(InputError, match="'/dev/zero', which is no file but a device"):
        cells.build(tmp_path, beside(tmp_path))


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"world": "<replicate count='100000'><geom size='.1'/></replicate>"}, "asks for 100000"),
        (
            {
                "world": "<replicate count='100'><replicate count='100'><geom size='.1'/></replicate></replicate>"
            },
            "<replicate count='100'> in line .* asks for 10000; allowed are 1,000",
        ),
        ({"tail": "<custom><numeric name='n' size='100000000'/></custom>"}, "<numeric size="),
        (
            {"assets": "<asset><hfield name='h' nrow='9999' ncol='9999' size='1 1 1 1'/></asset>"},
            "hfield",
        ),
    ],
)
def test_a_line_that_asks_for_endless_work_is_refused_at_once(tmp_path, parts, words):
    leg(tmp_path, **parts)
    started = time.monotonic()
    with pytest.raises(InputError, match=words):
        cells.build(tmp_path, beside(tmp_path))
    assert time.monotonic() - started < 5.0


def test_a_tendon_that_does_nothing_by_itself_is_no_reason_to_refuse(tmp_path):
    leg(
        tmp_path,
        tail='<tendon><fixed name="sum"><joint joint="hip" coef="1"/></fixed></tendon>',
    )
    cells.build(tmp_path, beside(tmp_path))


@pytest.mark.parametrize(
    ("servo", "words"),
    [
        ('<position name="h" joint="hip" kp="9" kv="1" timeconst="0.1"/>', "dynamics of its own"),
        ('<intvelocity name="h" joint="hip" kp="9" actrange="-1 1"/>', "dynamics of its own"),
        ('<damper name="h" joint="hip" kv="9" ctrlrange="0 1"/>', "neither a position nor"),
    ],
)
def test_a_servo_that_does_not_follow_at_once_is_refused(tmp_path, servo, words):
    path = leg(tmp_path)
    whole = '<position name="hip" joint="hip" kp="900" kv="30"/>'
    path.write_text(path.read_text().replace(whole, servo))
    with pytest.raises(InputError, match=words):
        cells.build(tmp_path, beside(tmp_path))


def test_a_range_of_the_control_is_left_out_and_said(tmp_path):
    path = leg(tmp_path)
    path.write_text(path.read_text().replace('kp="900"', 'kp="900" ctrlrange="-1 1"'))
    cell = cells.build(tmp_path, beside(tmp_path))
    assert not cell.model.actuator("arm1/hip").ctrllimited
    assert (
        "arm.arm1: leg.xml: ctrlrange of actuator hip: the joint's own range counts" in cell.notes
    )


def test_a_joint_that_is_held_leaves_its_body_where_it_stands_and_its_mass(tmp_path):
    path = leg(tmp_path, joint='ref="20"', **{"range": 'range="-120 120"'})
    file = arm_file.read(path)
    home = np.array([0.4, 0.5])
    form = normal_form(file, home, [1])
    model = mujoco.MjModel.from_xml_string(form.xml, form.assets)
    assert model.njnt == 1
    assert "actuators hip: they move no driven joint" in form.left_out
    data, alone = mujoco.MjData(model), mujoco.MjData(file.model)
    for knee in (-1.0, 0.5, 1.3):
        data.qpos[:], alone.qpos[:] = knee, [0.4, knee]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_kinematics(file.model, alone)
        np.testing.assert_allclose(data.xpos, alone.xpos, atol=1e-12)
        np.testing.assert_allclose(data.site_xmat, alone.site_xmat, atol=1e-12)
    np.testing.assert_array_equal(model.body_mass, file.model.body_mass)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('mass="', 'mass="1'), "mass of body"),
        (('<joint name="hip" ', '<joint name="hip" margin="0" '), None),
        (("0.3", "0.300000002"), "position of body thigh"),
        (('limited="true"', 'limited="false"'), "jnt_limited of joint hip"),
    ],
)
def test_an_arm_that_came_out_otherwise_stops(tmp_path, change, words):
    file = arm_file.read(leg(tmp_path))
    home = np.array([0.4, 0.5])
    form = normal_form(file, home, [0, 1])
    assert change[0] in form.xml
    form = replace(form, xml=form.xml.replace(*change))
    skeleton = compose._skeleton(0.002, ("one",), (form,))
    model = mujoco.MjModel.from_xml_string(
        compose.etree.tostring(skeleton.tree, encoding="unicode"), skeleton.assets
    )
    if words is None:
        fidelity.compare(model, "one", file, form, home)
        return
    with pytest.raises(fidelity.ArmDiffers, match=words):
        fidelity.compare(model, "one", file, form, home)
