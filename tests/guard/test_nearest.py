"""The branch and bound finds what trying every pair finds, and Coal agrees with the distances."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings, strategies

from workcell.guard.geometry import Geometry, collect_geometry
from workcell.guard.nearest import NearestSearch
from workcell.guard.pairs import PairTable, choose_pairs

from .cell import ARMS, CLEAR_POSE, CRASH_POSE, random_pose, scene_text
from .coal_shapes import shape_of, smallest_distance_m

CEILING_M = 0.5
# Both sides stop iterating on curved shapes at 1e-6 m or below; twice that is allowed.
AGREEMENT_M = 2e-6


@pytest.fixture(scope="module")
def cell() -> tuple[mujoco.MjModel, Geometry, PairTable, NearestSearch]:
    model = mujoco.MjModel.from_xml_string(scene_text())
    geometry = collect_geometry(model, ARMS)
    table = choose_pairs(model, geometry, ARMS)
    return (
        model,
        geometry,
        table,
        NearestSearch(model, geometry, table.watched, ceiling_m=CEILING_M),
    )


def brute_force(model: mujoco.MjModel, geometry: Geometry, mask, qpos) -> float:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return min(
        mujoco.mj_geomDistance(
            model, data, geometry.pieces[i].geom, geometry.pieces[j].geom, CEILING_M, None
        )
        for i, j in np.argwhere(np.triu(mask)).tolist()
    )


@settings(max_examples=150, deadline=None)
@given(seed=strategies.integers(0, 2**32 - 1))
def test_the_search_finds_what_trying_every_pair_finds(cell, seed: int):
    model, geometry, table, search = cell
    rng = np.random.default_rng(seed)
    # Without the table only the arms are left, which are sometimes beyond the ceiling.
    mask = table.watched.copy()
    if seed % 2:
        world = [k for k, piece in enumerate(geometry.pieces) if piece.owner == "world"]
        mask[world, :] = mask[:, world] = False
    qpos = random_pose(rng)
    search.place(qpos)
    found = search.nearest(mask, seed % 2)
    assert found.distance_m == pytest.approx(brute_force(model, geometry, mask, qpos), abs=1e-6)
    assert (found.pair is None) == (found.distance_m >= CEILING_M)
    if found.pair is not None:
        assert mask[found.pair]
        assert found.pair[0] < found.pair[1]


def test_the_floor_is_watched_as_everything_else_is(cell):
    model, geometry, table, _ = cell
    search = NearestSearch(model, geometry, table.watched, ceiling_m=CEILING_M)
    floor = [piece.name for piece in geometry.pieces].index("floor")
    mask = np.zeros_like(table.watched)
    mask[floor] = table.watched[floor]
    mask |= mask.T
    rng = np.random.default_rng(2)
    distances = []
    for _ in range(50):
        qpos = random_pose(rng)
        # Away from each other and down beside the table.
        qpos[[1, 2, 6, 7]] = -2.9, 0.0, 2.9, 0.0
        search.place(qpos)
        distances.append(search.nearest(mask).distance_m)
        assert distances[-1] == pytest.approx(brute_force(model, geometry, mask, qpos), abs=1e-6)
    assert min(distances) < 0.0


def test_the_answer_does_not_depend_on_what_was_asked_before(cell):
    model, geometry, table, _ = cell
    rng = np.random.default_rng(3)
    warm = NearestSearch(model, geometry, table.watched, ceiling_m=CEILING_M)
    for _ in range(20):
        qpos = random_pose(rng)
        cold = NearestSearch(model, geometry, table.watched, ceiling_m=CEILING_M)
        cold.place(qpos)
        warm.place(qpos)
        assert warm.nearest(table.watched).distance_m == pytest.approx(
            cold.nearest(table.watched).distance_m, abs=1e-6
        )


def test_most_pairs_are_never_measured(cell):
    _, _, table, search = cell
    rng = np.random.default_rng(5)
    measured = []
    for _ in range(100):
        search.place(random_pose(rng))
        measured.append(search.nearest(table.watched).measured)
    assert np.median(measured) < 0.2 * table.count


def test_a_crash_is_negative_and_names_the_crashing_pair(cell):
    _, geometry, table, search = cell
    search.place(CRASH_POSE)
    found = search.nearest(table.watched)
    assert found.pair is not None
    assert found.distance_m < -0.01
    assert {geometry.pieces[k].owner for k in found.pair} == {"nurse", "surgeon"}


def test_beyond_the_ceiling_there_is_no_pair(cell):
    _, geometry, table, _ = cell
    model = mujoco.MjModel.from_xml_string(scene_text())
    search = NearestSearch(model, geometry, table.watched, ceiling_m=0.05)
    search.place(CLEAR_POSE)
    assert search.nearest(table.watched).distance_m == 0.05
    assert search.nearest(table.watched).pair is None


def test_coal_agrees_on_random_configurations(cell):
    model, geometry, table, search = cell
    planes = [k for k, p in enumerate(geometry.pieces) if p.name == "floor"]
    mask = table.watched.copy()
    mask[planes, :] = mask[:, planes] = False
    shapes = {p.geom: shape_of(model, p.geom) for p in geometry.pieces if p.name != "floor"}
    geoms = [piece.geom for piece in geometry.pieces]
    pairs = [(geoms[i], geoms[j]) for i, j in np.argwhere(np.triu(mask)).tolist()]
    rng = np.random.default_rng(11)
    data = mujoco.MjData(model)
    seen_kinds, seen_contact = set(), 0
    for _ in range(120):
        qpos = random_pose(rng)
        search.place(qpos)
        found = search.nearest(mask, 7)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        expected_m = smallest_distance_m(data, shapes, pairs)
        if expected_m < 0.0:
            # How deep a contact is, is a matter of definition; that it is one, is not.
            assert found.distance_m < AGREEMENT_M
            seen_contact += 1
        else:
            assert found.distance_m == pytest.approx(min(expected_m, CEILING_M), abs=AGREEMENT_M)
            seen_kinds |= {int(model.geom_type[geometry.pieces[k].geom]) for k in found.pair or ()}
    # The sample meets contacts, and its nearest pairs have met boxes, cylinders and the mesh.
    assert seen_contact >= 5
    kinds = mujoco.mjtGeom
    assert {int(kinds.mjGEOM_BOX), int(kinds.mjGEOM_CYLINDER), int(kinds.mjGEOM_MESH)} <= seen_kinds
