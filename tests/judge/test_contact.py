"""Who closed the gap: shares of the closing speed against Jacobians, causes against staged contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.judge import ContactWatch

from .conftest import Stage, judged_scene


def pair_of(watch: ContactWatch, names: tuple[str, str]) -> int:
    """Its number among the judged pairs."""
    scene = watch.scene
    found = [{scene.name(i), scene.name(j)} for i, j in scene.solid_pairs.tolist()]
    return found.index(set(names))


def towards(stage: Stage, qpos: np.ndarray, surgeon: float = 0.0, nurse: float = 0.0) -> np.ndarray:
    """Velocities of the arms' first joints, of the given size, positive where they close the gap, rad/s."""
    watch, qvel = stage.watch(), np.zeros(6)
    watch.look(0.0, qpos, qvel)
    assert watch.smallest_pair is not None
    pair = pair_of(watch, watch.smallest_pair)
    for arm, size in (("surgeon", surgeon), ("nurse", nurse)):
        one = np.zeros(6)
        one[stage.dofs(arm)[0]] = 1.0
        qvel += size * np.sign(watch.closing_m_s(pair, qpos, one, arm)) * one
    return qvel


def test_shares_of_the_closing_speed_are_those_of_the_jacobians(stage: Stage):
    watch = stage.watch()
    qpos, qvel = stage.turned(0.3), np.array([0.3, -0.2, 0.4, -0.1, 0.25, -0.3])
    watch.look(0.0, qpos, qvel)
    assert watch.smallest_pair is not None
    assert watch.contact is None
    model = stage.scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    pair = pair_of(watch, watch.smallest_pair)
    i, j = stage.scene.solid_pairs[pair].tolist()
    ends = np.zeros(6)
    distance = mujoco.mj_geomDistance(model, data, i, j, 10.0, ends)
    normal = (ends[:3] - ends[3:]) / distance
    rows = []
    for geom, point in ((i, ends[:3]), (j, ends[3:])):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[geom])
        rows.append(jacobian)
    closing = -normal @ (rows[0] - rows[1])
    for arm in ("surgeon", "nurse"):
        dofs = stage.dofs(arm)
        share = watch.closing_m_s(pair, qpos, qvel, arm)
        assert share == pytest.approx(closing[dofs] @ qvel[dofs], abs=2e-3)


@pytest.mark.parametrize(
    ("surgeon", "nurse", "cause"),
    [
        (0.0, 0.2, "support"),
        (0.2, 0.0, "priority"),
        (0.2, 0.2, "both"),
        (0.2, -0.2, "priority"),
        (-0.2, 0.2, "support"),
        (0.0, 0.0, "none"),
        (-0.2, -0.2, "none"),
    ],
)
def test_the_cause_is_whose_motion_closes_the_gap(
    stage: Stage, touching: np.ndarray, surgeon: float, nurse: float, cause: str
):
    watch = stage.watch()
    watch.look(0.0, touching, towards(stage, touching, surgeon, nurse))
    assert watch.contact is not None
    assert watch.contact.cause == cause


def test_near_misses_are_no_contact_and_the_first_contact_comes_first(
    stage: Stage, touching: np.ndarray
):
    watch, near = stage.watch(), touching + (stage.qpos - touching) / 10.0
    watch.look(0.0, near, towards(stage, near, nurse=0.1))
    assert watch.contact is None
    assert np.isfinite(watch.smallest_support_m)
    watch.look(0.5, touching, towards(stage, touching, surgeon=0.1))
    watch.look(1.0, touching, towards(stage, touching, nurse=0.1))
    assert watch.contact is not None
    assert watch.contact.time_s == 0.5
    assert watch.contact.cause == "priority"
    assert len([c for c in watch.contacts if c.pair == watch.contact.pair]) == 1


def test_what_is_to_meet_may_come_near_but_not_touch(stage: Stage):
    """Tools that meet are left out of the smallest distance, and a touch of theirs still counts."""
    scene = stage.scene
    tools = [scene.tool_body[arm] for arm in ("surgeon", "nurse")]
    capsules = [
        next(
            scene.model.geom(g).name
            for g in range(scene.model.ngeom)
            if scene.model.geom_bodyid[g] == body and scene.model.geom_group[g] == 4
        )
        for body in tools
    ]
    rng, met, touched = np.random.default_rng(0), 0, 0
    for _ in range(3000):
        qpos = stage.qpos + rng.uniform(-0.8, 0.8, 6)
        plain, meeting = stage.watch(), stage.watch([tuple(capsules)])
        plain.look(0.0, qpos, np.zeros(6))
        assert plain.smallest_pair is not None
        bodies = {
            int(scene.model.geom_bodyid[g])
            for g in range(scene.model.ngeom)
            if scene.name(g) in plain.smallest_pair
        }
        if bodies != set(tools):
            continue
        meeting.look(0.0, qpos, np.zeros(6))
        if plain.smallest_m > 0.0:
            met += 1
            assert meeting.smallest_m > plain.smallest_m
        else:
            touched += 1
        assert (meeting.contact is None) == (plain.contact is None)
        if met > 2 and touched:
            break
    assert met > 2
    assert touched


def test_kept_bounds_find_what_measuring_everything_finds(stage: Stage):
    """Over a smooth motion: smallest distance and first contact as if every pair were measured at every look."""
    model, data = stage.scene.model, mujoco.MjData(stage.scene.model)
    watch, smallest, first = stage.watch(), np.inf, None
    looks = 0
    for k, angle in enumerate(np.linspace(0.0, 1.5, 200)):
        qpos = stage.turned(angle)
        qpos[stage.dofs("surgeon")[1]] += 0.3 * np.sin(3.0 * angle)
        watch.look(0.01 * k, qpos, np.zeros(6))
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        distance = [
            mujoco.mj_geomDistance(model, data, i, j, 10.0, None)
            for i, j in stage.scene.solid_pairs.tolist()
        ]
        looks += len(distance)
        smallest = min(smallest, min(distance))
        if min(distance) <= 0.0 and first is None:
            first = 0.01 * k
        assert watch.smallest_m == pytest.approx(smallest, abs=1e-9)
    assert watch.contact is not None
    assert watch.contact.time_s == first
    assert watch._watch.measured < looks / 3


def test_an_instrument_and_the_hand_that_holds_it_may_touch_until_it_is_clear(tmp_path):
    content = cells.duet() | {"instrument": [{"name": "probe", "held_by": "nurse"}]}
    cell = cells.build(tmp_path, content)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    scene = judged_scene(cell, tmp_path / "scene")
    item, qpos = cell.instruments[0], np.array(data.qpos)
    # Into the hand itself: a touch for anybody but its holder.
    inside = qpos.copy()
    inside[item.qpos : item.qpos + 3] = data.site_xpos[cell.arms[1].tool_site]
    still = np.zeros(cell.model.nv)
    held, free = ContactWatch(scene, clear_m=0.01), ContactWatch(scene, clear_m=0.01)
    held.look(0.0, inside, still, {"probe": "nurse"})
    assert held.contact is None
    free.look(0.0, inside, still, {"probe": None})
    assert free.contact is not None
    held.look(0.1, inside, still, {"probe": None})
    assert held.contact is None  # just let go, not clear yet
    away = qpos.copy()
    away[item.qpos + 2] += 1.0
    held.look(0.2, away, still, {"probe": None})
    held.look(0.3, inside, still, {"probe": None})
    assert held.contact is not None
