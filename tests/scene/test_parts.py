"""Several arms of one file: each part is an arm of its own, and together they are the robot."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from workcell.cli import main
from workcell.scene.adapt import Wishes
from workcell.scene.adapt.parts import adapt_parts

SIDE = """
<body name="{n}_upper" pos="0 {y} 0.5">
  <joint name="{n}_a" axis="0 0 1" range="-100 100" damping="0.5" armature="0.1"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
  <body name="{n}_lower" pos="0.3 0 0">
    <joint name="{n}_b" axis="0 0 1" range="-100 100" damping="0.5" armature="0.1"/>
    <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03" mass="0.7"/>
    <body name="{n}_hand" pos="0.25 0 0">
      <joint name="{n}_c" axis="0 0 1" range="-100 100" damping="0.5" armature="0.1"/>
      <geom type="box" pos="0.05 0 0" size="0.05 0.02 0.02" mass="0.2"/>
      <site name="{n}_tool" pos="0.1 0 0" zaxis="1 0 0"/>
    </body>
  </body>
</body>
"""
ROBOT = f"""
<mujoco model="two">
  <worldbody>
    <body name="pedestal">
      <geom type="cylinder" fromto="0 0 0 0 0 0.3" size="0.08" mass="5"/>
      <body name="torso" pos="0 0 0.3">
        <joint name="lift" type="slide" axis="0 0 1" range="0 0.3"/>
        <geom type="box" pos="0 0 0.2" size="0.06 0.14 0.2" mass="4"/>
        {SIDE.format(n="left", y=0.25)}
        {SIDE.format(n="right", y=-0.25)}
      </body>
    </body>
  </worldbody>
</mujoco>
"""
TOOLS = {"left": "left_tool", "right": "right_tool"}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.xml"
    path.write_text(ROBOT)
    return path


@pytest.fixture(scope="module")
def robot(path):
    return adapt_parts(path, TOOLS, Wishes(locked={"lift": 0.1}))


def test_each_part_is_where_it_is_in_the_robot(path, robot):
    original = mujoco.MjModel.from_xml_path(str(path))
    there = mujoco.MjData(original)
    there.joint("lift").qpos[0] = 0.1
    rng, mass = np.random.default_rng(0), 0.0
    for part, adapted in robot.parts.items():
        model = mujoco.MjModel.from_xml_string(adapted.xml)
        assert [model.joint(j).name for j in range(model.njnt)] == [f"{part}_{j}" for j in "abc"]
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-1.5, 1.5, 3)
        for k, joint in enumerate("abc"):
            there.joint(f"{part}_{joint}").qpos[0] = data.qpos[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_kinematics(original, there)
        np.testing.assert_allclose(data.site("tool").xpos, there.site(TOOLS[part]).xpos, atol=1e-9)
        mass += model.body_mass.sum()
    assert mass == pytest.approx(original.body_mass.sum(), abs=1e-9)
    assert "lift: would move more than one part, thus locked" in robot.said


def test_what_is_near_by_construction_is_told_with_its_reason(robot):
    found = {(near.one, near.other): near.reason for near in robot.ignored}
    # The torso's capsule reaches over the shoulder of the part that does not carry it.
    assert any(pair == ("left/base", "right/right_upper") for pair in found)
    assert all("at most 2 joints apart" in r or "by construction" in r for r in found.values())


def test_the_command_writes_all_parts_and_a_scenario_with_all_of_them(path, tmp_path, capsys):
    wishes = [f"--part={name}={tool}" for name, tool in TOOLS.items()]
    assert main(["import", str(path), "--name", "two", "--out", str(tmp_path), *wishes]) == 0
    assert "first scenario: workcell run" in capsys.readouterr().out
    folder = tmp_path / "two"
    written = {file.name for file in folder.iterdir()}
    assert {"two_left.xml", "two_right.xml", "two_cell.toml"} <= written
    assert main(["check", str(folder / "two_cell.toml")]) == 0


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (["left=left_tool"], "allowed are two parts or more"),
        (["left=left_tool", "left=right_tool"], "each name once"),
        (["left=left_tool", "right=nothing"], "--part right=nothing: no such site or body"),
        (["a=left_upper", "b=left_tool"], "--part a: its tool carries another part's"),
    ],
)
def test_parts_that_cannot_be_are_refused(path, tmp_path, capsys, parts, words):
    wishes = [f"--part={part}" for part in parts]
    assert main(["import", str(path), "--out", str(tmp_path), *wishes]) == 2
    assert words in capsys.readouterr().err


def test_a_part_and_a_tool_are_not_both_asked_for(path, tmp_path, capsys):
    asked = ["--part=left=left_tool", "--part=right=right_tool", "--tool", "left_tool"]
    assert main(["import", str(path), "--out", str(tmp_path), *asked]) == 2
    assert "--part: says what --tool and --root say" in capsys.readouterr().err
