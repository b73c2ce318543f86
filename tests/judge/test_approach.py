"""Times to collision and their blame, pair by pair, against distances differenced along the motion."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from workcell.judge.approach import ApproachWatch
from workcell.judge.kinematics import stretch

from .conftest import Stage


def watched(stage: Stage, *owners: str) -> list[tuple[str, str]]:
    """Watched pairs of the cell between these two owners."""
    pairs = stage.cell.pairs
    return [
        names
        for names, own in zip(pairs.names, pairs.owners, strict=True)
        if {o or "world" for o in own} == set(owners)
    ]


def look(stage: Stage, pairs, qvel, qpos=None, t_min_s=1.0) -> ApproachWatch:
    watch = ApproachWatch(stage.scene, pairs)
    where = stage.qpos if qpos is None else qpos
    model, now, t_min = stage.scene.model, np.zeros(1), np.full(1, t_min_s)
    watch.look(
        stretch(model, mujoco.MjData(model), now, t_min, where[None], qvel[None], qvel[None])
    )
    return watch


def test_times_to_collision_against_differences(stage: Stage):
    """Each pair by itself: the time is the distance over its rate, by central differences of MuJoCo's distance."""
    model, data = stage.scene.model, mujoco.MjData(stage.scene.model)
    rng = np.random.default_rng(1)
    checked = 0
    for _ in range(12):
        qpos, qvel = stage.qpos + rng.uniform(-0.5, 0.5, 6), rng.uniform(-1.0, 1.0, 6)
        for pair in stage.cell.pairs.names:
            i, j = (model.geom(name).id for name in pair)
            distance = []
            for h in (-1e-6, 0.0, 1e-6):
                data.qpos[:] = qpos + h * qvel
                mujoco.mj_kinematics(model, data)
                distance.append(mujoco.mj_geomDistance(model, data, i, j, 10.0, None))
            rate = (distance[2] - distance[0]) / 2e-6
            if distance[1] < 1e-3 or abs(rate) < 1e-3:
                continue
            watch = look(stage, [pair], qvel, qpos)
            expected = -distance[1] / rate if rate < 0.0 else np.inf
            assert watch.measured.ttc_s == pytest.approx(expected, rel=1e-3)
            checked += 1
    assert checked > 60


def closing(stage: Stage, pair, surgeon: float, nurse: float) -> np.ndarray:
    """Velocities with which each arm's first joint gives the pair this closing rate, m/s."""
    qvel = np.zeros(6)
    for arm, wanted in (("surgeon", surgeon), ("nurse", nurse)):
        if wanted:
            one = np.zeros(6)
            one[stage.dofs(arm)[0]] = 1.0
            data = mujoco.MjData(stage.scene.model)
            rates = []
            for h in (1e-6, -1e-6):
                data.qpos[:] = stage.qpos + h * one
                mujoco.mj_kinematics(stage.scene.model, data)
                i, j = (stage.scene.model.geom(n).id for n in pair)
                rates.append(mujoco.mj_geomDistance(stage.scene.model, data, i, j, 10.0, None))
            qvel += one * wanted / -((rates[0] - rates[1]) / 2e-6)
    return qvel


@pytest.mark.parametrize(
    ("surgeon", "nurse", "short", "forced"),
    [
        (0.0, 2.0, True, False),  # alone too fast
        (2.0, 0.0, False, False),  # the other's, and this arm stands: nothing of its own closes
        (2.0, 0.1, False, True),  # the other's, while this arm closes within its own limit
        (2.0, 2.0, True, False),  # both: that the other closes too is no excuse
        (-2.0, 2.0, False, False),  # it follows one that leaves as fast
        (-1.0, 2.9, True, False),  # it follows one that leaves, too fast
        (0.0, 0.5, False, False),
    ],
)
def test_a_pair_is_forced_only_where_the_other_party_closes_it(
    stage: Stage, surgeon: float, nurse: float, short: bool, forced: bool
):
    """Rates in units of the distance over t_min."""
    (pair,) = min(
        ([p] for p in watched(stage, "surgeon", "nurse")),
        key=lambda p: look(stage, p, np.zeros(6)).smallest_m,
    )
    distance = look(stage, [pair], np.zeros(6)).smallest_m
    watch = look(stage, [pair], closing(stage, pair, surgeon * distance, nurse * distance))
    kept = watch.arms["nurse"]
    assert bool(kept.short_ticks) == short
    # Where this arm stands, the other's pair is forced on it too.
    assert bool(kept.forced_ticks) == (forced or (surgeon > 1.0 and not short))


def test_a_pair_with_what_stands_is_always_the_arms_own(stage: Stage):
    """Even in a tick in which another arm forces another pair."""
    world = watched(stage, "nurse", "world")
    pair = min(world, key=lambda p: look(stage, [p], np.zeros(6)).smallest_m)
    other = min(
        watched(stage, "surgeon", "nurse"),
        key=lambda p: look(stage, [p], np.zeros(6)).smallest_m,
    )
    distance = look(stage, [pair], np.zeros(6)).smallest_m
    qvel = closing(stage, pair, 0.0, 3.0 * distance)
    apart = look(stage, [other], np.zeros(6)).smallest_m
    qvel += closing(stage, other, 5.0 * apart, 0.0)
    watch = look(stage, [pair, other], qvel)
    assert watch.arms["nurse"].short_ticks == 1
    assert watch.arms["nurse"].own.ttc_s <= 1.0 / 3.0 + 1e-3


def test_arms_that_people_drive_are_not_blamed(stage: Stage):
    assert set(look(stage, list(stage.cell.pairs.names), np.zeros(6)).arms) == {"nurse"}
