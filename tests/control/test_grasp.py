"""Who holds what decides what G says and which pairs count."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.control.grasp import Grasps
from workcell.scene import cell as scene
from workcell.simulation.instruments import Instruments

STEP_RAD = 1e-6


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    return cells.build(tmp_path_factory.mktemp("grasp"), cells.tilted_duet_with_instruments())


@pytest.fixture
def data(cell) -> mujoco.MjData:
    return cells.at_home(cell)


def pairs_of(cell: scene.Cell, *geoms: str) -> list[int]:
    return [k for k, names in enumerate(cell.pairs.names) if set(geoms) <= set(names)]


def distances(cell: scene.Cell, carried: Instruments, data: mujoco.MjData) -> np.ndarray:
    """With every held instrument carried along."""
    carried.carry(data)
    cells.kinematics(cell, data)
    return cells.geometry(cell).measure(data).distance_m.copy()


@pytest.mark.parametrize("holder", ["nurse", "surgeon"])
def test_g_of_a_held_instrument_is_that_of_the_arm_that_holds_it(cell, data, holder):
    """Against finite differences of its distances over all joints, the instrument carried along."""
    grasps = Grasps(cell)
    grasps.take("probe", holder)
    carried = Instruments(cell, data)
    carried.follow(grasps.holders, data)
    folded = grasps.fold(data, cells.geometry(cell).measure(data).jacobian)
    item = cells.item(cell, "probe")
    mine = [k for k in pairs_of(cell, "probe_capsule") if grasps.parties(k)]
    home = data.qpos.copy()
    for arm in cell.arms:
        for dof, adr in zip(arm.dofs, arm.qpos, strict=True):
            sides = []
            for sign in (1.0, -1.0):
                data.qpos[:] = home
                data.qpos[adr] += sign * STEP_RAD
                sides.append(distances(cell, carried, data)[mine])
            slope = (sides[0] - sides[1]) / (2 * STEP_RAD)
            np.testing.assert_allclose(folded[mine, dof], slope, atol=2e-5)
            if arm.name == holder:
                assert np.abs(slope).max() > 0.05, "it must really be carried to mean anything"
    assert not folded[:, item.dof : item.dof + 6].any(), "it has no motion of its own left"


def test_an_instrument_that_lies_has_no_part_in_g(cell, data):
    grasps = Grasps(cell)
    folded = grasps.fold(data, cells.geometry(cell).measure(data).jacobian)
    clamp = cells.item(cell, "clamp")
    assert not folded[:, clamp.dof : clamp.dof + 6].any()
    (with_hand,) = pairs_of(cell, "clamp_capsule", "nurse/link3_capsule")
    assert grasps.parties(with_hand) == ("nurse",), "who comes near answers"


def test_the_own_hand_does_not_count_and_everything_else_is_the_holders(cell, data):
    grasps = Grasps(cell)
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
    grasps = Grasps(cell)
    (to_surgeon,) = pairs_of(cell, "probe_capsule", "surgeon/link3_capsule")
    (to_nurse,) = pairs_of(cell, "probe_capsule", "nurse/link3_capsule")
    assert (grasps.holding("nurse"), grasps.holding("surgeon")) == ("probe", None)
    before = grasps.holders
    grasps.take("probe", "surgeon")
    assert before == {"probe": "nurse", "clamp": None}, "who asked before keeps the answer"
    assert grasps.holders == {"probe": "surgeon", "clamp": None}
    assert (grasps.holding("nurse"), grasps.holding("surgeon")) == (None, "probe")
    assert grasps.summary() == "probe=surgeon clamp="
    assert grasps.parties(to_surgeon) == ()
    assert set(grasps.parties(to_nurse)) == {"nurse", "surgeon"}
    probe = cell.model.geom("probe_capsule").id
    assert grasps.part_of_hand(probe, "surgeon")
    assert not grasps.part_of_hand(probe, "nurse")
