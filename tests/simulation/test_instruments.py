"""Where the plant has an instrument: with the hand that holds it, rigidly, or lying still."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import cells
from workcell.control.grasp import Grasps
from workcell.scene import cell as scene
from workcell.scene import contacts
from workcell.scene.contacts import as_slice
from workcell.simulation.instruments import Instruments


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    return cells.build(tmp_path_factory.mktemp("grasp"), cells.tilted_duet_with_instruments())


@pytest.fixture
def data(cell) -> mujoco.MjData:
    return cells.at_home(cell)


def test_joints_that_do_not_follow_one_another_carry_alike(cell, data, monkeypatch):
    """Addressed one by one rather than as a slice, as those of an arm with others in between would be."""
    jacobian = cells.geometry(cell).measure(data).jacobian
    data.qvel[cell.arms[1].dofs] = [0.7, -0.4, 0.9]
    Instruments(cell, data).carry(data)
    carried, folded = data.qvel.copy(), Grasps(cell).fold(data, jacobian)
    monkeypatch.setattr(contacts, "as_slice", lambda dofs: dofs)
    Instruments(cell, data).carry(data)
    np.testing.assert_allclose(data.qvel, carried, rtol=1e-14)
    np.testing.assert_allclose(Grasps(cell).fold(data, jacobian), folded, rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize(
    ("dofs", "found"), [([3], slice(3, 4)), ([3, 4, 5], slice(3, 6)), ([3, 5, 6], None)]
)
def test_only_what_follows_one_another_is_a_slice(dofs, found):
    result = as_slice(np.array(dofs))
    assert result == found if found else np.array_equal(result, dofs)


def test_an_instrument_is_taken_where_it_is_and_carried_rigidly(cell, data):
    instruments, item = Instruments(cell, data), cells.item(cell, "clamp")
    nurse = cell.arms[1]
    before = data.qpos[item.qpos : item.qpos + 7].copy()
    instruments.follow({"probe": None, "clamp": "nurse"}, data)
    instruments.carry(data)
    np.testing.assert_allclose(data.qpos[item.qpos : item.qpos + 7], before, atol=1e-12)

    def in_tool() -> tuple[np.ndarray, np.ndarray]:
        tool = data.site_xmat[nurse.tool_site].reshape(3, 3)
        rod = Rotation.from_quat(
            data.qpos[item.qpos + 3 : item.qpos + 7], scalar_first=True
        ).as_matrix()
        away = data.qpos[item.qpos : item.qpos + 3] - data.site_xpos[nurse.tool_site]
        return tool.T @ away, tool.T @ rod

    place, turn = in_tool()
    random = np.random.default_rng(7)
    for _ in range(3):
        data.qpos[nurse.qpos] += random.uniform(-0.5, 0.5, 3)
        cells.kinematics(cell, data)
        instruments.carry(data)
        np.testing.assert_allclose(in_tool()[0], place, atol=1e-12)
        np.testing.assert_allclose(in_tool()[1], turn, atol=1e-12)


def test_the_velocity_of_a_carried_instrument_is_that_of_its_motion(cell, data):
    """One small step of its free joint leads to where the arm's step carries it."""
    instruments, item, nurse = Instruments(cell, data), cells.item(cell, "probe"), cell.arms[1]
    data.qvel[nurse.dofs] = [0.7, -0.4, 0.9]
    instruments.carry(data)
    own = slice(item.qpos, item.qpos + 7)
    step_s = 1e-5
    mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), step_s)
    integrated = data.qpos[own].copy()
    cells.kinematics(cell, data)
    instruments.carry(data)
    np.testing.assert_allclose(integrated, data.qpos[own], atol=1e-9)


def test_an_instrument_that_lies_stands_still(cell, data):
    instruments, item = Instruments(cell, data), cells.item(cell, "clamp")
    before = data.qpos[item.qpos : item.qpos + 7].copy()
    data.qvel[:] = 0.3
    instruments.carry(data)
    assert not data.qvel[item.dof : item.dof + 6].any()
    np.testing.assert_array_equal(data.qpos[item.qpos : item.qpos + 7], before)


def test_hands_open_and_close_as_told_and_only_then(cell, data):
    """What changes hands stays where it is; whoever holds it next carries it from there."""
    instruments, item = Instruments(cell, data), cells.item(cell, "probe")
    before = data.qpos[item.qpos : item.qpos + 7].copy()
    instruments.follow({"probe": "surgeon", "clamp": None}, data)
    data.qpos[cell.arms[1].qpos] += 0.2
    instruments.carry(data)
    np.testing.assert_allclose(data.qpos[item.qpos : item.qpos + 7], before, atol=1e-12)
    data.qpos[cell.arms[0].qpos] += 0.2
    instruments.carry(data)
    moved = np.linalg.norm(data.qpos[item.qpos : item.qpos + 3] - before[:3])
    assert moved > 0.05
    instruments.follow({"probe": None, "clamp": None}, data)
    lies = data.qpos[item.qpos : item.qpos + 7].copy()
    data.qpos[cell.arms[0].qpos] -= 0.2
    instruments.carry(data)
    np.testing.assert_array_equal(data.qpos[item.qpos : item.qpos + 7], lies)
