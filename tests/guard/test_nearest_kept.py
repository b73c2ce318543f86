"""Bounds kept from one configuration to the next leave out nothing: every answer against all pairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings, strategies
from numpy.typing import NDArray

from workcell.guard.checker import Checker
from workcell.guard.geometry import Geometry
from workcell.guard.nearest import NearestSearch
from workcell.guard.pairs import PairTable
from workcell.guard.settings import CheckSettings, Exemption, Held
from workcell.guard.shared_memory import CLOSED, NOBODY, Request

from .cell import ARM, CRASH_POSE, random_pose, scene_text, write_scene
from .cell import settings as check_settings

CEILING_M = 0.5
ROD = """
<body name="rod" pos="0 0 1">
  <freejoint name="rod_free"/>
  <geom name="rod_rod" type="capsule" size=".008 .05" group="2"/>
</body>
"""
GIVEN: CheckSettings = check_settings(
    instruments=(Held("rod", rests_on=("table",)),),
    hands=(("nurse/link4", "nurse/tool"), ("surgeon/link4", "surgeon/tool")),
    exemptions=(
        Exemption("exchange", ("nurse/tool", "rod"), ("surgeon/tool", "rod"), 9.0, 1e6, 0.0),
        Exemption("fetch", ("nurse/tool",), ("rod",), 9.0, 1e6, 0.0),
    ),
)


@dataclass(frozen=True)
class Everything:
    """The plain version: measures every pair."""

    model: mujoco.MjModel
    geometry: Geometry
    table: PairTable

    def distance_m(self, mask: NDArray[np.bool_], qpos: NDArray[np.float64]) -> float:
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        geoms = [piece.geom for piece in self.geometry.pieces]
        return min(
            (
                mujoco.mj_geomDistance(self.model, data, geoms[i], geoms[j], CEILING_M, None)
                for i, j in np.argwhere(np.triu(mask)).tolist()
            ),
            default=CEILING_M,
        )

    def pair_m(self, pair: tuple[int, int], qpos: NDArray[np.float64]) -> float:
        mask = np.zeros_like(self.table.watched)
        mask[min(pair), max(pair)] = True
        return self.distance_m(mask, qpos)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bodies = ARM.format(a="nurse", x=-0.3) + ARM.format(a="surgeon", x=0.3) + ROD
    return write_scene(tmp_path_factory.mktemp("kept"), scene_text(bodies=bodies))


@pytest.fixture(scope="module")
def everything(scene: Path) -> Everything:
    checker = Checker(scene, GIVEN)
    return Everything(checker.model, checker.geometry, checker.table)


def walk(rng: np.random.Generator, steps: int) -> NDArray[np.float64]:
    """(steps, 17) standstills, creeping, running, far jumps, crashes; the rod goes about, often to a hand."""
    poses = np.empty((steps, 17))
    arms, rod = random_pose(rng), np.array([0.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0])
    drift = rng.normal(size=10)
    for pose in poses:
        kind = rng.integers(8)
        if kind == 0:
            arms = CRASH_POSE.copy() if rng.random() < 0.5 else random_pose(rng)
        elif kind == 1:
            drift = rng.normal(size=10)
        elif kind > 2:
            arms = arms + drift * 10.0 ** rng.uniform(-6.0, -1.0)
        if rng.random() < 0.2:
            rod = np.concatenate(
                [rng.uniform([-0.5, -0.3, 0.0], [0.5, 0.3, 0.8]), rng.normal(size=4)]
            )
        elif rng.random() < 0.1:
            # Anywhere, so that travels outgrow what is kept.
            rod = np.concatenate([rng.uniform(-1.0, 1.0, 3) * 10.0 ** rng.uniform(0, 5), rod[3:]])
        pose[:] = np.concatenate([arms, rod])
    return poses


@settings(max_examples=60, deadline=None)
@given(seed=strategies.integers(0, 2**32 - 1))
def test_on_any_way_the_distance_is_that_of_measuring_every_pair(everything: Everything, seed: int):
    rng = np.random.default_rng(seed)
    table = everything.table
    search = NearestSearch(
        everything.model, everything.geometry, table.watched, ceiling_m=CEILING_M
    )
    masks = [
        table.watched,
        table.watched & ~table.held[0, 0] & ~table.exempt[0],
        table.exempt[0],
        table.held[0, 1],
        np.triu(table.watched, 9) | np.triu(table.watched, 9).T,
        np.zeros_like(table.watched),
    ]
    for qpos in walk(rng, 25):
        search.place(qpos)
        for key in rng.permutation(len(masks))[:3].tolist():
            found = search.nearest(masks[key], key)
            assert found.distance_m == everything.distance_m(masks[key], qpos)
            assert (found.pair is None) == (found.distance_m == CEILING_M)
            if found.pair is not None:
                assert masks[key][found.pair]
                assert found.distance_m == everything.pair_m(found.pair, qpos)


@settings(max_examples=30, deadline=None)
@given(seed=strategies.integers(0, 2**32 - 1))
def test_so_it_is_whatever_is_held_let_go_and_allowed_to_meet(
    scene: Path, everything: Everything, seed: int
):
    rng = np.random.default_rng(seed)
    checker = Checker(scene, GIVEN)
    asked: list[tuple[NDArray[np.bool_], float, object]] = []
    search = checker._search.nearest

    def listening(mask: NDArray[np.bool_], key: object):
        found = search(mask, key)
        asked.append((mask, found.distance_m, key))
        return found

    checker._search.nearest = listening  # type: ignore[method-assign]
    holder, opened = NOBODY, [CLOSED, CLOSED]
    for tick, qpos in enumerate(walk(rng, 25)):
        if rng.random() < 0.3:
            holder = int(rng.choice([NOBODY, 0, 1]))
        for k in range(2):
            if rng.random() < 0.3:
                opened[k] = tick if opened[k] == CLOSED else CLOSED
        asked.clear()
        answer = checker.answer(Request(tick + 1, tick, tuple(opened), qpos, (holder,)))
        (close_m,) = (m for _, m, key in asked if key == "close")
        ((watched, watched_m),) = (
            (mask, m) for mask, m, key in asked if isinstance(key, tuple) and key[0] == "watched"
        )
        # Neighbours are told only where they are too near.
        if close_m <= GIVEN.d_min_m:
            watched_m = min(watched_m, close_m)
        assert answer.distance_m == watched_m
        # All is asked for but what is let off.
        lifted = np.zeros_like(watched)
        for k in range(2):
            if opened[k] != CLOSED:
                lifted |= everything.table.exempt[k]
        lifted |= everything.table.held[0].any(axis=0)
        assert not (everything.table.watched & ~lifted & ~watched).any()
        for mask, found_m, _ in asked:
            assert found_m == everything.distance_m(mask, qpos)


def test_a_mask_beyond_what_is_watched_is_refused(everything: Everything):
    table = everything.table
    search = NearestSearch(
        everything.model, everything.geometry, table.watched, ceiling_m=CEILING_M
    )
    with pytest.raises(ValueError, match="not watched"):
        search.nearest(~table.watched)


def test_a_configuration_that_is_no_number_has_no_distance_and_leaves_nothing_behind(
    everything: Everything,
):
    table, rng = everything.table, np.random.default_rng(6)
    search = NearestSearch(
        everything.model, everything.geometry, table.watched, ceiling_m=CEILING_M
    )
    for qpos in walk(rng, 10):
        search.place(qpos)
        assert search.nearest(table.watched).distance_m == everything.distance_m(
            table.watched, qpos
        )
        broken = qpos.copy()
        broken[rng.integers(10)] = np.nan
        search.place(broken)
        found = search.nearest(table.watched)
        assert np.isnan(found.distance_m)
        assert found.pair is None


@settings(max_examples=60, deadline=None)
@given(seed=strategies.integers(0, 2**32 - 1))
def test_no_point_of_a_body_moves_farther_than_its_travel_says(everything: Everything, seed: int):
    model, rng = everything.model, np.random.default_rng(seed)
    search = NearestSearch(
        model, everything.geometry, everything.table.watched, ceiling_m=CEILING_M
    )
    solids = [p for p in everything.geometry.pieces if p.name != "floor"]
    # The corners of the pieces' own boxes; a box is as large as that.
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T

    def points(data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
        box = model.geom_aabb[geom]
        local = box[:3] + corners * box[3:]
        return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T

    data = mujoco.MjData(model)
    poses = [
        random_pose(rng) + step for step in (0.0, rng.normal(size=10) * 10.0 ** -rng.integers(6))
    ]
    places = []
    for arms in poses:
        data.qpos[:] = np.concatenate([arms, [0.0, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0]])
        mujoco.mj_kinematics(model, data)
        search.place(np.array(data.qpos))
        places.append(([points(data, p.geom) for p in solids], search._travel_m.copy()))
    (before, start_m), (after, end_m) = places
    for piece, old, new in zip(solids, before, after, strict=True):
        moved_m = np.linalg.norm(new - old, axis=1).max()
        assert moved_m <= (end_m - start_m)[piece.body]


def test_bounds_are_kept_so_that_a_standstill_costs_what_is_near(everything: Everything):
    table = everything.table
    search = NearestSearch(
        everything.model, everything.geometry, table.watched, ceiling_m=CEILING_M
    )
    qpos = walk(np.random.default_rng(1), 1)[0]
    for look in range(200):
        qpos[:10] += 1e-4
        search.place(qpos)
        found = search.nearest(table.watched)
        if look:
            assert found.measured < 0.3 * table.count


def test_planes_stand_still_as_the_bounds_assume():
    """MuJoCo itself refuses a plane on a body that moves."""
    with pytest.raises(ValueError, match="plane"):
        mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><joint/><geom type='plane' size='1 1 1'/>"
            "<geom size='.1'/></body></worldbody></mujoco>"
        )
