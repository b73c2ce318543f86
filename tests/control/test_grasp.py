"""Who holds what decides what G says, which pairs count, and where the instrument is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import cells
from workcell.control import grasp
from workcell.control.grasp import Grasps
from workcell.control.proximity import PairGeometry
from workcell.scene import cell as scene

STEP_RAD = 1e-6


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    """Two planar arms, tilted against each other so that no rods are parallel; a probe in the nurse's
    hand, a clamp on the ground."""
    content = cells.duet()
    content["arm"][1]["base_wxyz"] = [0.98, 0.15, 0.1, (1 - 0.98**2 - 0.15**2 - 0.1**2) ** 0.5]
    content["arm"][1]["base_position_m"] = [-0.55, 0.0, 0.2]
    content["arm"][0]["home_rad"] = [1.9, 0.9, -0.6]
    content["instrument"] = [
        {"name": "probe", "held_by": "nurse"},
        {"name": "clamp", "position_m": [0.0, -0.5, 0.3], "wxyz": [0.8, 0.6, 0.0, 0.0]},
    ]
    return cells.build(tmp_path_factory.mktemp("grasp"), content)


@pytest.fixture
def data(cell) -> mujoco.MjData:
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    kinematics(cell, data)
    return data


def kinematics(cell: scene.Cell, data: mujoco.MjData) -> None:
    mujoco.mj_kinematics(cell.model, data)
    mujoco.mj_comPos(cell.model, data)
    mujoco.mj_sensorPos(cell.model, data)


def bodies(cell: scene.Cell, instrument: str):
    return next(item for item in cell.instruments if item.name == instrument)


def pairs_of(cell: scene.Cell, *geoms: str) -> list[int]:
    return [k for k, names in enumerate(cell.pairs.names) if set(geoms) <= set(names)]


def geometry(cell: scene.Cell) -> PairGeometry:
    return PairGeometry(cell.model, [tuple(p) for p in cell.pairs.geoms], cell.sensor_adr)


def distances(cell: scene.Cell, grasps: Grasps, data: mujoco.MjData) -> np.ndarray:
    """With every held instrument carried along."""
    kinematics(cell, data)
    grasps.carry(data)
    kinematics(cell, data)
    return geometry(cell).measure(data).distance_m.copy()


@pytest.mark.parametrize("holder", ["nurse", "surgeon"])
def test_g_of_a_held_instrument_is_that_of_the_arm_that_holds_it(cell, data, holder):
    """Against finite differences of its distances over all joints, the instrument carried along."""
    grasps = Grasps(cell, data)
    grasps.take("probe", holder, data)
    folded = grasps.fold(data, geometry(cell).measure(data).jacobian)
    item = bodies(cell, "probe")
    mine = [k for k in pairs_of(cell, "probe_capsule") if grasps.parties(k)]
    home = data.qpos.copy()
    for arm in cell.arms:
        for dof, adr in zip(arm.dofs, arm.qpos, strict=True):
            sides = []
            for sign in (1.0, -1.0):
                data.qpos[:] = home
                data.qpos[adr] += sign * STEP_RAD
                sides.append(distances(cell, grasps, data)[mine])
            slope = (sides[0] - sides[1]) / (2 * STEP_RAD)
            np.testing.assert_allclose(folded[mine, dof], slope, atol=2e-5)
            if arm.name == holder:
                assert np.abs(slope).max() > 0.05, "it must really be carried to mean anything"
    assert not folded[:, item.dof : item.dof + 6].any(), "it has no motion of its own left"


def test_joints_that_do_not_follow_one_another_carry_alike(cell, data, monkeypatch):
    """Addressed one by one rather than as a slice, as those of an arm with others in between would be."""
    jacobian = geometry(cell).measure(data).jacobian
    data.qvel[cell.arms[1].dofs] = [0.7, -0.4, 0.9]
    together = Grasps(cell, data)
    together.carry(data)
    carried, folded = data.qvel.copy(), together.fold(data, jacobian)
    monkeypatch.setattr(grasp, "_as_slice", lambda dofs: dofs)
    apart = Grasps(cell, data)
    apart.carry(data)
    np.testing.assert_allclose(data.qvel, carried, rtol=1e-14)
    np.testing.assert_allclose(apart.fold(data, jacobian), folded, rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize(
    ("dofs", "found"), [([3], slice(3, 4)), ([3, 4, 5], slice(3, 6)), ([3, 5, 6], None)]
)
def test_only_what_follows_one_another_is_a_slice(dofs, found):
    result = grasp._as_slice(np.array(dofs))
    assert result == found if found else np.array_equal(result, dofs)


def test_an_instrument_that_lies_has_no_part_in_g(cell, data):
    grasps = Grasps(cell, data)
    folded = grasps.fold(data, geometry(cell).measure(data).jacobian)
    clamp = bodies(cell, "clamp")
    assert not folded[:, clamp.dof : clamp.dof + 6].any()
    (with_hand,) = pairs_of(cell, "clamp_capsule", "nurse/link3_capsule")
    assert grasps.parties(with_hand) == ("nurse",), "who comes near answers"


def test_the_own_hand_does_not_count_and_everything_else_is_the_holders(cell, data):
    grasps = Grasps(cell, data)
    (own_hand,) = pairs_of(cell, "probe_capsule", "nurse/link3_capsule")
    (own_base,) = pairs_of(cell, "probe_capsule", "nurse/base_capsule")
    (other_hand,) = pairs_of(cell, "probe_capsule", "surgeon/link3_capsule")
    (both_items,) = pairs_of(cell, "probe_capsule", "clamp_capsule")
    assert grasps.parties(own_hand) == ()
    assert grasps.parties(own_base) == ("nurse",)
    assert set(grasps.parties(other_hand)) == {"nurse", "surgeon"}
    assert grasps.parties(both_items) == ("nurse",)
    grasps.let_go("probe")
    assert grasps.parties(own_hand) == ("nurse",), "it counts again once it is let go of"
    assert grasps.parties(both_items) == (), "nobody moves two instruments that lie"


def test_a_hand_over_changes_owner_and_hand_at_once(cell, data):
    grasps = Grasps(cell, data)
    (to_surgeon,) = pairs_of(cell, "probe_capsule", "surgeon/link3_capsule")
    (to_nurse,) = pairs_of(cell, "probe_capsule", "nurse/link3_capsule")
    assert (grasps.holding("nurse"), grasps.holding("surgeon")) == ("probe", None)
    before = grasps.holders
    grasps.take("probe", "surgeon", data)
    assert before == {"probe": "nurse", "clamp": None}, "who asked before keeps the answer"
    assert grasps.holders == {"probe": "surgeon", "clamp": None}
    assert (grasps.holding("nurse"), grasps.holding("surgeon")) == (None, "probe")
    assert grasps.summary() == "probe=surgeon clamp="
    assert grasps.parties(to_surgeon) == ()
    assert set(grasps.parties(to_nurse)) == {"nurse", "surgeon"}
    probe = cell.model.geom("probe_capsule").id
    assert grasps.part_of_hand(probe, "surgeon")
    assert not grasps.part_of_hand(probe, "nurse")


def test_an_instrument_is_taken_where_it_is_and_carried_rigidly(cell, data, rng):
    grasps, item = Grasps(cell, data), bodies(cell, "clamp")
    nurse = cell.arms[1]
    before = data.qpos[item.qpos : item.qpos + 7].copy()
    grasps.take("clamp", "nurse", data)
    grasps.carry(data)
    np.testing.assert_allclose(data.qpos[item.qpos : item.qpos + 7], before, atol=1e-12)

    def in_tool() -> tuple[np.ndarray, np.ndarray]:
        tool = data.site_xmat[nurse.tool_site].reshape(3, 3)
        rod = Rotation.from_quat(
            data.qpos[item.qpos + 3 : item.qpos + 7], scalar_first=True
        ).as_matrix()
        away = data.qpos[item.qpos : item.qpos + 3] - data.site_xpos[nurse.tool_site]
        return tool.T @ away, tool.T @ rod

    place, turn = in_tool()
    for _ in range(3):
        data.qpos[nurse.qpos] += rng.uniform(-0.5, 0.5, 3)
        kinematics(cell, data)
        grasps.carry(data)
        np.testing.assert_allclose(in_tool()[0], place, atol=1e-12)
        np.testing.assert_allclose(in_tool()[1], turn, atol=1e-12)


def test_the_velocity_of_a_carried_instrument_is_that_of_its_motion(cell, data):
    """One small step of its free joint leads to where the arm's step carries it."""
    grasps, item, nurse = Grasps(cell, data), bodies(cell, "probe"), cell.arms[1]
    data.qvel[nurse.dofs] = [0.7, -0.4, 0.9]
    grasps.carry(data)
    own = slice(item.qpos, item.qpos + 7)
    step_s = 1e-5
    mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), step_s)
    integrated = data.qpos[own].copy()
    kinematics(cell, data)
    grasps.carry(data)
    np.testing.assert_allclose(integrated, data.qpos[own], atol=1e-9)


def test_an_instrument_that_lies_stands_still(cell, data):
    grasps, item = Grasps(cell, data), bodies(cell, "clamp")
    before = data.qpos[item.qpos : item.qpos + 7].copy()
    data.qvel[:] = 0.3
    grasps.carry(data)
    assert not data.qvel[item.dof : item.dof + 6].any()
    np.testing.assert_array_equal(data.qpos[item.qpos : item.qpos + 7], before)
