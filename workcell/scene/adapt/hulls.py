"""Geometry of a link -> closed convex pieces.

In: the geoms of an arm file, compiled alone. Out: for each geom the corners of a convex solid that
contains it. A mesh becomes its convex hull; a hull of more than `MOST_CORNERS` corners becomes a
coarser solid around it, so that the final check stays fast. A round primitive is kept as a primitive
by the writer; the corners here are of a solid around it, for the capsules to be fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

MOST_CORNERS = 120
"""Corners of one piece; chosen so that a distance costs MuJoCo a few microseconds."""
_DIRECTIONS = 90
_ROUND = 24
"""Corners of the polygon around a circle."""
FLAT_M = 1e-3
"""A flat or thin mesh is thickened by this, so that it has a hull."""

_GEOM = mujoco.mjtGeom


@dataclass(frozen=True)
class Piece:
    """A convex solid in the frame of its body."""

    geom: int
    """Number of the geom it stands for."""
    corners: NDArray[np.float64]
    """(n, 3) its corners, m."""
    is_mesh: bool
    """Whether the geom is a mesh, which the corners replace; a primitive stays what it is."""
    volume_m3: float
    """Of the hull."""
    surface_volume_m3: float | None
    """What the surface of the mesh itself encloses; None for primitives and open surfaces."""
    position_m: NDArray[np.float64]
    """(3,) of the geom's frame."""
    rotation: NDArray[np.float64]
    """(3, 3) of the geom's frame."""

    def moved(self, position_m: NDArray[np.float64], rotation: NDArray[np.float64]) -> Piece:
        """The same piece in a frame in which its own has this pose."""
        return replace(
            self,
            corners=position_m + self.corners @ rotation.T,
            position_m=position_m + rotation @ self.position_m,
            rotation=rotation @ self.rotation,
        )


def piece_of(model: mujoco.MjModel, geom: int) -> Piece:
    """The convex solid of one geom, in the frame of its body."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    surface = None
    if kind == _GEOM.mjGEOM_MESH:
        local, surface = _mesh(model, int(model.geom_dataid[geom]))
    else:
        local = _primitive(kind, size)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    position, turn = model.geom_pos[geom].copy(), rotation.reshape(3, 3)
    corners = position + local @ turn.T
    volume = float(ConvexHull(corners).volume)
    return Piece(geom, corners, kind == _GEOM.mjGEOM_MESH, volume, surface, position, turn)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[NDArray[np.float64], float | None]:
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count].astype(float)
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    a, b, c = vertices[model.mesh_face[start : start + count]].transpose(1, 0, 2)
    enclosed = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
    corners = hull_corners(vertices)
    return corners, enclosed if enclosed > 0 else None


def hull_corners(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) corners of a convex solid around points: their hull, or a coarser one around it."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat: thicken it
        shift = FLAT_M / 2 * np.concatenate([np.eye(3), -np.eye(3)])
        points = (points[:, None] + shift).reshape(-1, 3)
        hull = ConvexHull(points)
    corners = points[hull.vertices]
    return corners if len(corners) <= MOST_CORNERS else _coarser(corners)


def _coarser(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of the intersection of half-spaces that touch the hull, in evenly spread directions.

    The directions are spread for the hull scaled to a ball, so that long parts stay slender.
    """
    centre, spread = corners.mean(axis=0), corners.std(axis=0)
    scaled = (corners - centre) / spread
    k = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * k / _DIRECTIONS, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    spiral = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    directions = np.concatenate([spiral, np.eye(3), -np.eye(3)])
    reach = (scaled @ directions.T).max(axis=0)
    solid = HalfspaceIntersection(
        np.column_stack([directions, -reach - 1e-9]), np.zeros(3)
    ).intersections
    return centre + solid[ConvexHull(solid).vertices] * spread


def _primitive(kind: int, size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) corners of a solid around a primitive."""
    box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    if kind == _GEOM.mjGEOM_BOX:
        return box * size
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) / np.cos(np.pi / _ROUND)
    if kind == _GEOM.mjGEOM_CYLINDER:
        ring = circle * size[0]
        shift = np.array([0, 0, size[1]])
        return np.concatenate([ring + shift, ring - shift])
    # A ball's solid around it: five rings, each far enough out, and two poles.
    out = 1 / np.cos(np.pi / 8) / np.cos(np.pi / _ROUND)
    ball = [np.array([[0, 0, out], [0, 0, -out]])]
    for latitude in np.pi * np.arange(-3, 4) / 8:
        ring = circle * np.cos(np.pi / _ROUND) * np.cos(latitude) * out
        ball.append(ring + np.array([0, 0, np.sin(latitude) * out]))
    ball = np.concatenate(ball)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return ball * size
    if kind == _GEOM.mjGEOM_CAPSULE:
        shift = np.array([0, 0, size[1]])
        return np.concatenate([ball * size[0] + shift, ball * size[0] - shift])
    return ball * size[0]
