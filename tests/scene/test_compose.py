"""Any number of any arms make one scene, and what is simulated is what was written."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.errors import InputError
from workcell.scene.cell import check_start

HOMES = {
    "pa10": [0.0, 0.3491, 0.0, 1.3963, 0.0, 1.3963, 0.0],
    "planar3": [0.4, 0.5, 0.6],
    "slider": [0.1],
}


def mixed(*models: str) -> dict:
    """A cell with these arms two and a half metres apart, the first driven by an operator, the rest by jobs."""
    arms = [
        {
            "name": f"arm{k}",
            "model": model,
            "base_position_m": [2.5 * k, 0.0, 0.0],
            "base_wxyz": [np.cos(0.3 * k), 0.0, 0.0, np.sin(0.3 * k)],
            "home_rad": HOMES[model],
            "priority": k,
        }
        | ({"job": [{"kind": "wait", "duration_s": 1.0}]} if k else {"operator": {"kind": "hold"}})
        for k, model in enumerate(models)
    ]
    return {"name": "mixed", "arm": arms}


@pytest.mark.parametrize(
    "models",
    [("slider",), ("planar3", "pa10"), ("planar3", "slider", "pa10"), ("slider",) * 4],
    ids="+".join,
)
def test_any_number_of_any_arms(tmp_path, models):
    cell = cells.build(tmp_path, mixed(*models))
    joints = [len(HOMES[model]) for model in models]
    assert (cell.model.nq, cell.model.nv, cell.model.nu) == (sum(joints),) * 3
    assert [arm.name for arm in cell.arms] == [f"arm{k}" for k in range(len(models))]
    everything = np.concatenate([arm.dofs for arm in cell.arms])
    assert sorted(everything) == list(range(cell.model.nv)), "every joint belongs to one arm"
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    np.testing.assert_array_equal(data.qpos, np.concatenate([HOMES[m] for m in models]))
    check_start(cell)


def test_an_arm_stands_where_and_as_the_scenario_says(tmp_path):
    cell = cells.build(tmp_path, mixed("planar3", "planar3"))
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    first, second = (data.site(f"arm{k}/tool").xpos for k in (0, 1))
    turn = np.array([[np.cos(0.6), -np.sin(0.6), 0], [np.sin(0.6), np.cos(0.6), 0], [0, 0, 1]])
    np.testing.assert_allclose(second, [2.5, 0, 0] + turn @ first, atol=1e-12)


def test_the_written_scene_is_the_model(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    again = mujoco.MjModel.from_xml_path(str(tmp_path / "scene" / "scene.xml"))
    for field in ("body_pos", "body_quat", "geom_size", "jnt_range", "actuator_gainprm"):
        np.testing.assert_array_equal(getattr(again, field), getattr(cell.model, field))
    assert again.nsensor == len(cell.pairs)
    assert cells.build(tmp_path / "again", cells.duet()).digest == cell.digest


def test_nothing_in_a_scene_can_bounce(tmp_path):
    model = cells.build(tmp_path, mixed("pa10", "slider")).model
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()


def test_obstacles_are_static_geoms_of_the_world_with_their_own_names(tmp_path):
    content = cells.duet()
    content["obstacle"] = [
        {"name": "block", "shape": "box", "size_m": [0.1, 0.2, 0.3], "position_m": [0, 2, 0.3]},
        {
            "name": "rod",
            "shape": "capsule",
            "size_m": [0.05, 0.4],
            "position_m": [0, -2, 0.5],
            "wxyz": [0.70710678, 0.70710678, 0, 0],
        },
    ]
    model = cells.build(tmp_path, content).model
    for obstacle in content["obstacle"]:
        geom = model.geom(obstacle["name"])
        assert geom.bodyid == 0
        np.testing.assert_allclose(geom.pos, obstacle["position_m"])
        np.testing.assert_allclose(geom.size[: len(obstacle["size_m"])], obstacle["size_m"])
    np.testing.assert_allclose(model.geom("rod").quat, [2**-0.5, 2**-0.5, 0, 0], atol=1e-12)


def test_the_simulation_steps_at_the_control_period(tmp_path):
    assert cells.build(tmp_path, cells.duet()).model.opt.timestep == 0.008


def test_refusals_of_all_arms_come_together(tmp_path):
    content = mixed("planar3", "slider")
    content["arm"][0]["home_rad"], content["arm"][1]["home_rad"] = [0.0], [0.0, 0.0]
    with pytest.raises(InputError) as refused:
        cells.build(tmp_path, content)
    assert len(refused.value.faults) == 2
