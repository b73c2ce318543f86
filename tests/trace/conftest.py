"""A small cell and a short run of it: two planar three-joint arms, one slowing down for the other.

The run is computed here in the plainest way (distances from MuJoCo, rates from differences), so
that it has what a real one has: two encounters, scaling, a halt, nulls.
"""

import json
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from workcell.signals import Layout, columns
from workcell.trace.table import Trace, load
from workcell.trace.writer import TraceWriter

PERIOD_S = 0.004
T_MIN_S = 0.8
D_MIN_M = 0.01
ARMS = ("surgeon", "nurse")
LINK_M = 0.22
CAPSULE_RADIUS_M = 0.03


class Run(NamedTuple):
    folder: Path
    scene: Path
    trace: Trace


def scene_xml() -> str:
    def arm(name: str, x: float, rgba: str) -> str:
        chain = f'<site name="{name}/tool" pos="{LINK_M} 0 0"/>'
        for k in (3, 2, 1):
            chain = f"""
            <body name="{name}/link{k}" pos="{LINK_M if k > 1 else 0} 0 {0.3 if k == 1 else 0}">
              <joint name="{name}/J{k}" axis="0 0 1"/>
              <geom name="{name}/link{k}_housing" type="box" group="2" rgba="{rgba}"
                    pos="{LINK_M / 2} 0 0" size="{LINK_M / 2} 0.018 0.018"/>
              <geom name="{name}/link{k}_cap" type="cylinder" group="2" rgba="0.3 0.3 0.3 1"
                    size="0.022 0.025"/>
              <geom name="{name}/link{k}_capsule" type="capsule" group="4"
                    fromto="0 0 0 {LINK_M} 0 0" size="{CAPSULE_RADIUS_M}"/>
              {chain}
            </body>"""
        return f"""
        <body name="{name}/base" pos="{x} 0 0">
          <geom name="{name}/base_housing" type="cylinder" group="2" rgba="0.5 0.5 0.5 1"
                pos="0 0 0.14" size="0.05 0.14"/>{chain}
        </body>"""

    return f"""
    <mujoco model="cell">
      <default><geom contype="0" conaffinity="0"/></default>
      <worldbody>
        <light pos="0 -1 2" dir="0 0.5 -1"/>
        <geom name="table" type="box" size="0.7 0.5 0.02" pos="0 0.1 -0.02" rgba="0.7 0.7 0.7 1"/>
        <geom name="lamp" type="ellipsoid" size="0.1 0.1 0.04" pos="0 0.1 0.75"/>
        {arm("surgeon", -0.35, "0.85 0.87 0.9 1")}{arm("nurse", 0.35, "0.9 0.88 0.84 1")}
      </worldbody>
    </mujoco>"""


def _wanted_rad_s(time_s: float) -> np.ndarray:
    """The nurse swings at the surgeon's middle, backs off, and comes again with its tool."""
    if time_s < 2.5:
        return np.array([0.6, 0.0, 0.0])
    if time_s < 3.7:
        return np.array([-0.5, 0.3, 0.4])
    return np.array([0.7, 0.0, -0.1])


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    scene = folder / "scene.xml"
    scene.write_text(scene_xml())
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    geoms = [[model.geom(f"{arm}/link{k}_capsule").id for k in (1, 2, 3)] for arm in ARMS]
    ids = [(i, j) for i in geoms[0] for j in geoms[1]]
    pairs = tuple((model.geom(i).name, model.geom(j).name) for i, j in ids)
    joints = tuple(model.joint(j).name for j in range(model.njnt))
    layout = Layout(arms=ARMS, joints=joints, nq=6, nv=6, pairs=pairs)
    control = {"t_min_s": T_MIN_S, "d_min_m": D_MIN_M}
    arm_settings = [{"name": "surgeon", "priority": 0}, {"name": "nurse", "priority": 1}]
    metadata = {
        "scenario": "0" * 64,
        "settings": json.dumps({"control": control, "arm": arm_settings}),
        "meeting_pairs": json.dumps([["nurse/link3_capsule", "surgeon/link2_capsule"]]),
    }
    fromto = np.zeros(6)

    def distances(qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        found, points = [], []
        for i, j in ids:
            found.append(mujoco.mj_geomDistance(model, data, i, j, 10.0, fromto))
            points.append(fromto.copy())
        return np.array(found), np.array(points)

    qpos = np.array([0.9, -0.9, -0.8, 1.5, 0.2, 0.2])
    halted = False
    previous_tool = {}
    with TraceWriter(folder, layout, metadata, PERIOD_S) as writer:
        for tick in range(1500):
            time_s = tick * PERIOD_S
            wanted = np.zeros(6)
            wanted[3:] = _wanted_rad_s(time_s)
            distance, points = distances(qpos)
            rate = (distances(qpos + 1e-6 * wanted)[0] - distance) / 1e-6
            closing = np.maximum(-rate, 0.0) / np.maximum(distance, 1e-9)
            worst = int(np.argmax(closing))
            scale = min(1.0, 1.0 / (T_MIN_S * closing[worst])) if closing[worst] > 0 else 1.0
            halted = halted or distance.min() <= D_MIN_M
            mode = "halt" if halted else "scale" if scale < 1 else "run"
            scale = 0.0 if halted else scale
            command = scale * wanted
            moving = bool(scale * closing[worst] > 0)
            ttc_s = float(1 / (scale * closing[worst])) if moving else None
            distances(qpos)
            shown = worst if moving else int(np.argmin(distance))
            row = {
                "tick": tick,
                "time_s": time_s,
                "plant_qpos": qpos,
                "plant_qvel": None,
                "qpos": qpos,
                "qvel": command,
                "pair_distance_m": distance,
                "pair_rate_m_s": scale * rate,
                "t_min_s": T_MIN_S,
                "criterion": "artc",
                "entry": "",
                "closest_pair": int(np.argmin(distance)),
                "ttc_s": ttc_s,
                "ttc_pair": worst if moving else None,
                "witness_i_m": points[shown][:3],
                "witness_j_m": points[shown][3:],
                "wanted_rad_s": wanted,
                "ttc_command_s": ttc_s,
                "ttc_command_pair": worst if moving else None,
                "check_distance_m": float(distance.min()) + 0.01,
                "check_state": "ok",
                "command_rad_s": command,
                "holders": "",
                "closing_cause": "",
                "mode": mode,
            }
            for arm in ARMS:
                tool = data.site(f"{arm}/tool").xpos.copy()
                speed = np.linalg.norm(tool - previous_tool.get(arm, tool)) / PERIOD_S
                previous_tool[arm] = tool
                scaled = arm == "nurse" and scale < 1
                own = {
                    "target_position_m": tool,
                    "target_wxyz": np.array([1.0, 0, 0, 0]),
                    "target_velocity_m_s": np.zeros(3),
                    "target_turn_rad_s": np.zeros(3),
                    "job": "meet" if arm == "nurse" else "hold",
                    "operator_state": "valid" if arm == "surgeon" else "",
                    "path_s": min(tick, 1200) * PERIOD_S if arm == "nurse" else 0.0,
                    "tool_position_m": tool,
                    "tool_wxyz": np.array([1.0, 0, 0, 0]),
                    "tool_speed_m_s": float(speed),
                    "tool_error_m": 1e-4 * (arm == "nurse"),
                    "tool_error_rad": 2e-4 * (arm == "nurse"),
                    "out_of_reach_m": None,
                    "elbow_position_m": data.body("nurse/link3").xpos if arm == "nurse" else None,
                    "artc_per_s": float(np.mean(-scale * rate / distance)),
                    "armd_per_m": float(np.mean(1 / distance)),
                    "ik_status": "optimal",
                    "scale": scale if arm == "nurse" else 1.0,
                    "limiting_pair": worst if scaled and not halted else None,
                    "reason": ("halt" if halted else "ttc") if scaled else "",
                    "gate": "",
                    "gate_pair": None,
                    "attempt": "",
                    "mode": mode if arm == "nurse" else "run",
                }
                row |= {f"{arm}.{name}": value for name, value in own.items()}
            writer.append(row)
            qpos = qpos + PERIOD_S * command
    assert set(row) == {column.name for column in columns(layout)}
    return Run(folder, scene, load(folder))
