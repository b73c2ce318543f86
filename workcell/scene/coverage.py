"""Is what can be hit also what is watched?

Times to collision are between the watched geoms of an arm. In: an arm file compiled alone, with its
joints at home. Out: which geoms of each link are watched, and how far the link's housing reaches out of
them. A body with capsules of group 4 is watched by these. A body without any is watched by the geoms
with which its file lets it collide, else by all it has; unless the capsules of its link and of the one
before contain it, in every sampled pose (a flange that turns within the wrist before it). Surfaces are
sampled, so that a length is right to about a millimetre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

WATCHED_GROUP = 4
"""Geom group of the watched capsules."""
HOUSING_GROUP = 2
"""Geom group of the housings: what is drawn, and what the final check holds apart."""
CONTAINED_M = 1e-6
"""Housing that reaches out no farther than this is contained; far below what anyone could make."""
FEW_VERTICES = 400
"""Meshes of fewer vertices are also looked at between them."""
MOST_VERTICES = 4000
"""Of larger meshes so many vertices are looked at, every so-manieth."""

_GEOM = mujoco.mjtGeom


@dataclass(frozen=True)
class Bare:
    """How far a link's housing reaches out of what is watched of it."""

    link: str
    """Name of the link's first body."""
    geom: str
    """Name of the housing that reaches out farthest."""
    outside_m: float
    """How far; 0 where all of it is contained."""
    moves: bool
    """Whether a driven joint moves the link."""


@dataclass(frozen=True, eq=False)
class Links:
    """An arm file's links, and poses in which they are looked at."""

    model: mujoco.MjModel
    """The file compiled alone."""
    of_body: Sequence[int]
    """For every body the first body of the link it belongs to; 0 stands still."""
    poses: Sequence[mujoco.MjData]
    """Home first, then others within the joint ranges; positions computed."""

    def before(self, link: int) -> int:
        """The link that carries this one; itself for what stands still."""
        return self.of_body[int(self.model.body_parentid[link])] if link else 0


def sampled_links(
    model: mujoco.MjModel,
    of_body: Sequence[int],
    home: NDArray[np.float64],
    driven: Sequence[int],
    samples: int = 12,
) -> Links:
    """Home, and seeded random poses of the driven joints within their ranges."""
    rng = np.random.default_rng(0)
    poses = []
    for k in range(1 + samples):
        data = mujoco.MjData(model)
        data.qpos[:] = home
        for joint in driven if k else ():
            lower, upper = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.pi, np.pi)
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(lower, upper)
        mujoco.mj_kinematics(model, data)
        poses.append(data)
    return Links(model, of_body, poses)


def watched_geoms(links: Links) -> list[int]:
    """The geoms that are watched, in the order of the model."""
    model = links.model
    capsules = [
        g
        for g in range(model.ngeom)
        if model.geom_group[g] == WATCHED_GROUP and _is_solid(model, g)
    ]
    bodies = {int(model.geom_bodyid[g]) for g in capsules}
    watched = list(capsules)
    for body in range(model.nbody):
        own = [g for g in _geoms_of(model, body) if _is_solid(model, g)]
        if body in bodies or not own:
            continue
        if capsules and all(_outside(links, g, capsules) <= CONTAINED_M for g in own):
            continue
        colliding = [g for g in own if model.geom_contype[g] or model.geom_conaffinity[g]]
        watched += colliding or own
    return sorted(watched)


def bare_housing(
    links: Links, watched: Sequence[int], names: tuple[Sequence[str], Sequence[str]]
) -> tuple[Bare, ...]:
    """How far the housing of each link reaches out of the watched geoms of it and of the link before.

    Args:
        links: The arm's.
        watched: What `watched_geoms` gave.
        names: Of bodies and of geoms.
    """
    bodies, geoms = names
    worst: dict[int, Bare] = {}
    for body, link in enumerate(links.of_body):
        for g in _housing(links.model, body):
            outside = 0.0 if g in watched else _outside(links, g, watched)
            if link not in worst or outside > worst[link].outside_m:
                name = bodies[link] if link else "base"
                worst[link] = Bare(name, geoms[g], outside, link != 0)
    return tuple(worst[link] for link in sorted(worst))


def _outside(links: Links, geom: int, watched: Sequence[int]) -> float:
    """How far the farthest point of a geom's surface is from what is watched of its link and the one before.

    0 if none is outside, infinite if nothing is watched there.
    """
    model = links.model
    link = links.of_body[model.geom_bodyid[geom]]
    own = [g for g in watched if links.of_body[model.geom_bodyid[g]] == link]
    outside = _beyond(model, links.poses[0], geom, own)
    before = links.before(link)
    more = [g for g in watched if links.of_body[model.geom_bodyid[g]] == before]
    if outside <= CONTAINED_M or before == link or not more:
        return outside
    return min(outside, max(_beyond(model, pose, geom, own + more) for pose in links.poses))


def _housing(model: mujoco.MjModel, body: int) -> list[int]:
    """What the final check holds apart of a body: group 2, else all but the capsules of group 4."""
    own = [g for g in _geoms_of(model, body) if _is_solid(model, g)]
    housing = [g for g in own if model.geom_group[g] == HOUSING_GROUP]
    return housing or [g for g in own if model.geom_group[g] != WATCHED_GROUP]


def _geoms_of(model: mujoco.MjModel, body: int) -> range:
    return range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])


def _is_solid(model: mujoco.MjModel, geom: int) -> bool:
    return model.geom_type[geom] != _GEOM.mjGEOM_PLANE


def _beyond(model: mujoco.MjModel, data: mujoco.MjData, geom: int, covers: Sequence[int]) -> float:
    """The same in one pose, with these geoms as covers."""
    points = surface(model, data, geom)
    nearest = np.full(len(points), np.inf)
    for cover in covers:
        nearest = np.minimum(nearest, _distance(model, data, cover, points))
    return max(0.0, float(nearest.max(initial=0.0)))


def surface(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
    """(n, 3) points on the surface of a geom, in the world; its corners and rims among them."""
    local = np.concatenate(list(_local_surface(model, geom)))
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T


def _local_surface(model: mujoco.MjModel, geom: int) -> Iterator[NDArray[np.float64]]:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _GEOM.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[start : start + count].astype(float)
        yield vertices[:: 1 + count // MOST_VERTICES]
        if count <= FEW_VERTICES:
            start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            corners = vertices[model.mesh_face[start : start + count]]
            yield corners.mean(axis=1)
            yield (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2
    elif kind == _GEOM.mjGEOM_BOX:
        grid = np.linspace(-1, 1, 7)
        x, y = (a.ravel() for a in np.meshgrid(grid, grid))
        for axis in range(3):
            for side in (-1.0, 1.0):
                face = np.insert(np.stack([x, y], axis=1), axis, side, axis=1)
                yield face * size
    elif kind == _GEOM.mjGEOM_CYLINDER:
        for z in np.linspace(-size[1], size[1], 9):
            yield _circle(size[0], z)
        for radius in np.linspace(0, size[0], 4)[:-1]:
            yield _circle(radius, size[1])
            yield _circle(radius, -size[1])
    elif kind == _GEOM.mjGEOM_CAPSULE:
        ball = _ball() * size[0]
        shift = np.array([0.0, 0.0, size[1]])
        yield ball + shift
        yield ball - shift
        yield _circle(size[0], 0.0)
    else:
        yield _ball() * (size if kind == _GEOM.mjGEOM_ELLIPSOID else size[0])


def _circle(radius: float, z: float, count: int = 32) -> NDArray[np.float64]:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(count, float(z))], axis=1
    )


def _ball(count: int = 300) -> NDArray[np.float64]:
    """(count, 3) unit vectors, evenly spread (a golden spiral), the six axes among them."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    spiral = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.concatenate([spiral, np.eye(3), -np.eye(3)])


def _distance(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) how far points are outside a geom, negative inside; never more than the true distance."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
    if kind == _GEOM.mjGEOM_SPHERE:
        return np.linalg.norm(local, axis=1) - size[0]
    if kind == _GEOM.mjGEOM_CAPSULE:
        local[:, 2] -= np.clip(local[:, 2], -size[1], size[1])
        return np.linalg.norm(local, axis=1) - size[0]
    if kind == _GEOM.mjGEOM_BOX:
        return _outside_extents(np.abs(local) - size)
    if kind == _GEOM.mjGEOM_CYLINDER:
        radial = np.linalg.norm(local[:, :2], axis=1) - size[0]
        return _outside_extents(np.stack([radial, np.abs(local[:, 2]) - size[1]], axis=1))
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        scaled = np.linalg.norm(local / size, axis=1)
        return (scaled - 1) * size.min()
    mesh = int(model.geom_dataid[geom])
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    try:
        planes = ConvexHull(model.mesh_vert[start : start + count].astype(float)).equations
    except QhullError:  # A flat mesh contains nothing.
        return np.full(len(points), np.inf)
    return (local @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def _outside_extents(beyond: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance from (n, k) amounts by which points are beyond each extent."""
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.where(outside > 0, outside, beyond.max(axis=1))
