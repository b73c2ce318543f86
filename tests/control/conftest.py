"""Two seven-joint arms of the PA10's proportions beside each other, and small two-geom scenes."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from hypothesis import settings

from workcell.control.proximity import PairGeometry

# How long an example takes on a busy machine says nothing about the code.
settings.register_profile("control", deadline=None)
settings.load_profile("control")

_AXES = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
_LENGTHS_M = (0.2, 0.25, 0.2, 0.3, 0.2, 0.1, 0.08)
_RADII_M = (0.09, 0.08, 0.08, 0.07, 0.06, 0.06, 0.03)


def arm_xml(name: str, position: str) -> str:
    """An arm as a chain of capsules, each tilted a little so that no axes are parallel by build."""
    opening = closing = ""
    at = position
    for k, (axis, length, radius) in enumerate(zip(_AXES, _LENGTHS_M, _RADII_M, strict=True)):
        opening += (
            f'<body pos="{at}"><joint name="{name}{k}" axis="{axis}"/>'
            f'<geom name="{name}/c{k}" type="capsule" size="{radius}" mass="1"'
            f' fromto="0.01 0 0 0 0.02 {length}"/>'
        )
        closing += "</body>"
        at = f"0 0 {length}"
    return opening + closing


def build(
    bodies: str, pairs: Sequence[tuple[str, str]], assets: str = ""
) -> tuple[mujoco.MjModel, mujoco.MjData, PairGeometry]:
    """A scene with a fromto sensor a pair, its data, and the geometry of the pairs."""
    sensors = "".join(
        f'<fromto name="{k}" geom1="{i}" geom2="{j}" cutoff="50"/>'
        for k, (i, j) in enumerate(pairs)
    )
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><compiler angle='radian'/><default><geom contype='0' conaffinity='0'/></default>"
        f"<asset>{assets}</asset><worldbody>{bodies}</worldbody>"
        f"<sensor>{sensors}</sensor></mujoco>"
    )
    ids = [(model.geom(i).id, model.geom(j).id) for i, j in pairs]
    geometry = PairGeometry(model, ids, model.sensor_adr)
    return model, mujoco.MjData(model), geometry


def update(model: mujoco.MjModel, data: mujoco.MjData, qpos, qvel=None) -> None:
    """Bring data to a state as far as the numerical modules need it."""
    data.qpos[:] = qpos
    data.qvel[:] = 0.0 if qvel is None else qvel
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_sensorPos(model, data)
    mujoco.mj_comVel(model, data)


@pytest.fixture(scope="module")
def two_arms():
    """Model, data and geometry of all 49 pairs between two arms 0.7 m apart."""
    pairs = [(f"left/c{i}", f"right/c{j}") for i in range(7) for j in range(7)]
    return build(arm_xml("left", "0 -0.35 0") + arm_xml("right", "0 0.35 0"), pairs)


@pytest.fixture
def rng():
    return np.random.default_rng(7)
