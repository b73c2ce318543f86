"""The tool's rows are those of mink's frame task, and the program they stand in has the same solution."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workcell import scenario
from workcell.control.ik import ArmIk
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.scene import cell as scene


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return scene.build(scenario.load("handover"), tmp_path_factory.mktemp("handover"))


@given(
    seed=st.integers(0, 2**32 - 1),
    turn_rad=st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 0.5, 2.5]),
    shift_m=st.sampled_from([0.0, 1e-6, 1e-3, 0.1]),
    free=st.booleans(),
    catch_up=st.sampled_from([np.inf, 0.1]),
)
@settings(max_examples=80)
def test_rows_rates_and_least_motion(cell, seed, turn_rad, shift_m, free, catch_up):
    random = np.random.default_rng(seed)
    arm = cell.arms[int(seed) % 2]
    configuration = mink.Configuration(cell.model)
    cell.place_home(configuration.data)
    qpos = configuration.data.qpos.copy()
    qpos[arm.qpos] += random.uniform(-0.5, 0.5, 7)
    configuration.update(qpos)
    pose = configuration.get_transform_frame_to_world(arm.tool_site_name, "site")
    axis = random.normal(size=3)
    turned, wxyz = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turned, axis / np.linalg.norm(axis), turn_rad)
    mujoco.mju_mulQuat(wxyz, pose.rotation().wxyz, turned)
    shift = shift_m * random.normal(size=3)
    target = Target(pose.translation() + shift, wxyz, *random.normal(0, 0.1, (2, 3)))
    inverse = ArmIk(arm, nv=cell.model.nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
    whole = inverse.aim(configuration, target, catch_up_m_s=catch_up, free_rotation=free)

    # mink's coefficients are quotients of differences and lose digits where frames are turned by little
    # against each other; below 1e-5 rad it leaves them out.
    blur = 1e-11 + (1e-15 / turn_rad**2 if turn_rad > 1e-5 else 0.0)
    inverse.tool.follow(target)
    error, jacobian = inverse.tool._error_and_jacobian(configuration)
    ahead = inverse.tool._ahead()
    correction = -(error - ahead) * inverse.tool.gain / inverse.dt_s
    turning = TURN_LENGTH_M_PER_RAD * np.linalg.norm(correction[3:])
    speed = np.hypot(np.linalg.norm(correction[:3]), turning)
    correction *= min(1.0, catch_up / max(speed, 1e-12))
    rows, path_rates = jacobian[:, arm.dofs], -ahead * inverse.tool.gain / inverse.dt_s
    count = 5 if free else 6
    assert inverse.tool_count == count
    gram = rows[:count] @ rows[:count].T + 1e-6 * np.eye(count)
    least = [
        rows[:count].T @ np.linalg.solve(gram, rates[:count])
        for rates in (correction + path_rates, path_rates)
    ]
    for mine, theirs in (
        (inverse.tool_rows, rows),
        (inverse.tool_rates, correction + path_rates),
        (whole, least[0]),
        (inverse.path_rad_s, least[1]),
    ):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=blur * (1.0 + np.abs(theirs).max()))
    assert inverse.tool_error[0] == pytest.approx(np.linalg.norm(shift), abs=1e-13)
    assert inverse.tool_error[1] == pytest.approx(turn_rad, abs=1e-13)


def test_what_is_not_finite_is_named(cell):
    arm = cell.arms[0]
    configuration = mink.Configuration(cell.model)
    cell.place_home(configuration.data)
    configuration.update()
    inverse = ArmIk(arm, nv=cell.model.nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
    still = np.zeros(3)
    bad = Target(np.array([np.nan, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]), still, still)
    with pytest.raises(FloatingPointError, match=f"arm {arm.name}: .* in the tool's target"):
        inverse.aim(configuration, bad)
    configuration.data.cdof[arm.dofs[0], 0] = np.inf
    good = Target(np.ones(3), np.array([1.0, 0.0, 0.0, 0.0]), still, still)
    with pytest.raises(FloatingPointError, match="in the tool's Jacobian"):
        inverse.aim(configuration, good)
