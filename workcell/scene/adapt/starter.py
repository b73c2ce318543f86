"""A first scenario of two such arms, face to face, that runs at once."""

from __future__ import annotations

import mujoco
import numpy as np

from workcell.scene.adapt.adapt import Adapted
from workcell.scene.adapt.home import TOOL
from workcell.scene.adapt.parts import Robot

GAP_M = 0.4
"""Between the two tools at the start; chosen wide enough for any hand."""
STEPS_M = (0.1, 0.05, 0.02, None)
"""How far the second arm moves its tool towards the first; the shorter ones, or none at all, for arms that cannot reach farther."""


def scenario_text(arm: Adapted, step_m: float | None) -> str:
    """The scenario file.

    Args:
        arm: Two of these stand in it.
        step_m: How far the second one moves its tool towards the first; None for an arm that
            cannot, and waits.
    """
    tool = _tool(arm)
    yaw = float(np.arctan2(tool[1], tool[0]))
    out = float(np.hypot(tool[0], tool[1]))
    z = round(-arm.floor_m, 4) + 0.0
    x = round(out + GAP_M / 2, 4)
    job = '{ kind = "wait", duration_s = 2.0 }'
    if step_m is not None:
        towards = f"{{ position_m = [{-x + out + step_m:.4f}, 0.0, {tool[2] + z:.4f}] }}"
        job = f'{{ kind = "move", waypoints = [{towards}], speed_m_s = 0.05 }}, {{ kind = "retreat", speed_m_s = 0.05 }}'
    home = ", ".join(f"{q:g}" for q in arm.home_rad)
    over_floor = "".join(
        f'[[ignore]]\npair = ["{name}/{body}", "floor"]\nreason = "moves level over the floor"\n\n'
        for name in ("surgeon", "nurse")
        for body in arm.on_floor
    )
    return f"""# Two arms of {arm.name}.xml face to face: the surgeon's holds still, the nurse's comes nearer and goes back.
# Written by `workcell import`; a place to begin.
description = "Two {arm.name} face to face"

[simulation]
plant = "dynamic"
duration_s = 12.0

[[arm]]
name = "surgeon"
model = "{arm.name}.xml"
base_position_m = [{x:g}, 0.0, {z:g}]
base_wxyz = [{_turn(np.pi - yaw)}]
home_rad = [{home}]
tool_site = "{TOOL}"
priority = 0
operator = {{ kind = "hold" }}

[[arm]]
name = "nurse"
model = "{arm.name}.xml"
base_position_m = [{-x:g}, 0.0, {z:g}]
base_wxyz = [{_turn(-yaw)}]
home_rad = [{home}]
tool_site = "{TOOL}"
priority = 1
job = [{job}]

{over_floor}[expect]
contact = false
completed = true
"""


def robot_text(robot: Robot, step_m: float | None) -> str:
    """The scenario file of one robot with several arms: the first holds still, the others come nearer to it and go back.

    Args:
        robot: Its parts.
        step_m: How far each of the others moves its tool towards the first's; None for arms that wait.
    """
    arms = list(robot.parts.items())
    lift = round(max(-arm.floor_m for _, arm in arms), 4) + 0.0
    tools = {name: _tool(arm) + np.array([0.0, 0.0, lift]) for name, arm in arms}
    first = tools[arms[0][0]]
    tables = []
    for number, (name, arm) in enumerate(arms):
        towards = first - tools[name]
        towards /= max(float(np.linalg.norm(towards)), 1e-9)
        if number == 0:
            drive = 'operator = { kind = "hold" }'
        elif step_m is None:
            drive = 'job = [{ kind = "wait", duration_s = 2.0 }]'
        else:
            place = ", ".join(f"{x:.4f}" for x in tools[name] + step_m * towards)
            drive = f'job = [{{ kind = "move", waypoints = [{{ position_m = [{place}] }}], speed_m_s = 0.05 }}, {{ kind = "retreat", speed_m_s = 0.05 }}]'
        tables.append(f"""[[arm]]
name = "{name}"
model = "{arm.name}.xml"
base_position_m = [0.0, 0.0, {lift:g}]
home_rad = [{", ".join(f"{q:g}" for q in arm.home_rad)}]
tool_site = "{TOOL}"
priority = {number}
{drive}
""")
    tables += [
        f'[[ignore]]\npair = ["{near.one}", "{near.other}"]\nreason = "{near.reason}"\n'
        + "final_check = true\n" * near.housings_apart
        for near in robot.ignored
    ]
    whole = "\n".join(tables)
    return f"""# The arms of one {robot.name}: the first holds still, the others come nearer to it and go back.
# Written by `workcell import`; a place to begin. All parts stand at the same base pose: that of the robot.
description = "The arms of one {robot.name}"

[simulation]
plant = "dynamic"
duration_s = 12.0

{whole}
[expect]
contact = false
completed = true
"""


def _tool(arm: Adapted) -> np.ndarray:
    """(3,) where the tool is at home."""
    model = mujoco.MjModel.from_xml_string(arm.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = arm.home_rad
    mujoco.mj_kinematics(model, data)
    return data.site(TOOL).xpos.copy()


def _turn(angle: float) -> str:
    """Unit quaternion of a turn about the vertical."""
    return f"{np.cos(angle / 2):.9f}, 0.0, 0.0, {np.sin(angle / 2):.9f}"
