"""Nothing is left out in silence: what is watched and what is not add up to all there is."""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np
import pytest

from tests import cells
from tests.scene.test_compose import mixed
from workcell import assets, scenario
from workcell.scene import cell as scene
from workcell.scene.coverage import WATCHED_GROUP
from workcell.scene.pairs import APART_M


@pytest.fixture(scope="module")
def handover(tmp_path_factory):
    return scene.build(scenario.load("handover"), tmp_path_factory.mktemp("handover"))


def candidates(model: mujoco.MjModel, arms: set[str]) -> set[frozenset[str]]:
    """All pairs of which at least one is an arm's capsule and none is drawn only, from names and groups alone."""
    watched = [
        g
        for g in range(model.ngeom)
        if model.geom_group[g] == WATCHED_GROUP or "/" not in model.geom(g).name
    ]
    names = [model.geom(g).name for g in watched]
    return {
        frozenset(pair)
        for pair in combinations(names, 2)
        if any(name.split("/")[0] in arms and "/" in name for name in pair)
    }


@pytest.mark.parametrize("models", [("planar3",), ("pa10", "planar3", "slider")], ids="+".join)
def test_kept_and_left_out_are_all_pairs(tmp_path, models):
    cell = cells.build(tmp_path, mixed(*models))
    kept = [frozenset(pair) for pair in cell.pairs.names]
    omitted = [frozenset(pair[:2]) for pair in cell.pairs.omitted]
    assert len(kept) == len(set(kept))
    assert not set(kept) & set(omitted)
    arms = {arm.name for arm in cell.arms}
    assert set(kept) | set(omitted) == candidates(cell.model, arms)
    reasons = {reason.split(":")[0] for *_, reason in cell.pairs.omitted}
    assert reasons <= {"static", "neighbours", "apart"}


def test_handover_watches_what_its_two_arms_can_meet(handover):
    """The counts are the contract of the scenario: a pair that drops out must be noticed."""
    between = [o for o in handover.pairs.owners if set(o) == {"surgeon", "nurse"}]
    capsules = [len(arm.geoms) for arm in handover.arms]
    static = capsules[0] * capsules[1] - len(between)
    assert capsules == [8, 8]
    assert static == 1, "only the two bases cannot move against each other"
    assert len(between) >= 63
    assert len(handover.pairs) >= 64
    tools = ("surgeon/tool_capsule", "nurse/tool_capsule")
    assert tools in handover.pairs.names
    for obstacle in ("table", "patient", "floor"):
        assert ("nurse/tool_capsule", obstacle) in handover.pairs.names


def test_each_pair_has_the_sensor_of_its_number(handover):
    model, data = handover.model, mujoco.MjData(handover.model)
    handover.place_home(data)
    mujoco.mj_forward(model, data)
    fromto = np.zeros(6)
    for (g, h), address in zip(handover.pairs.geoms, handover.sensor_adr, strict=True):
        mujoco.mj_geomDistance(model, data, g, h, 100.0, fromto)
        np.testing.assert_allclose(data.sensordata[address : address + 6], fromto, atol=1e-12)


def test_self_pairs_left_out_as_apart_stay_apart_in_poses_not_sampled(handover):
    model, data = handover.model, mujoco.MjData(handover.model)
    random = np.random.default_rng(99)
    apart = [
        (model.geom(g).id, model.geom(h).id)
        for g, h, reason in handover.pairs.omitted
        if reason.startswith("apart")
    ]
    nearest = np.inf
    for _ in range(300):
        for arm in handover.arms:
            data.qpos[arm.qpos] = random.uniform(
                np.maximum(arm.lower_rad, -np.pi), np.minimum(arm.upper_rad, np.pi)
            )
        mujoco.mj_kinematics(model, data)
        nearest = min(
            [nearest, *(mujoco.mj_geomDistance(model, data, g, h, 1, None) for g, h in apart)]
        )
    assert nearest > APART_M / 2


def test_an_arm_file_without_capsules_is_watched_whole(tmp_path):
    plain = assets.model_file("planar3").read_text().replace('group="4"', 'group="2"')
    (tmp_path / "plain.xml").write_text(plain)
    content = mixed("planar3", "planar3")
    content["arm"][0]["model"] = "plain.xml"
    cell = cells.build(tmp_path, content)
    with_capsules = cell.arms[1]
    assert len(cell.arms[0].geoms) > len(with_capsules.geoms)
    assert ("arm0/link3_probe", "arm1/link3_capsule") in cell.pairs.names
