"""MuJoCo geoms as triangles, for whoever draws them without MuJoCo.

In comes a geom of a compiled model; out come vertices, outward normals and triangles in the frame
of the geom's body. Round shapes are profiles turned about z. MuJoCo keeps no triangles of its round
shapes, and trimesh, which makes them, takes longer to import than a recording to write.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError

SEGMENTS = 32
"""Corners of a circle: chosen so that a link's outline looks round at screen size."""


@dataclass(frozen=True)
class Triangles:
    """A surface in some frame."""

    vertices: NDArray[np.float64]
    """(V, 3), m."""
    normals: NDArray[np.float64]
    """(V, 3), unit vectors pointing out."""
    faces: NDArray[np.int64]
    """(F, 3), indices into the vertices, counter-clockwise from outside."""


def geom_triangles(model: mujoco.MjModel, geom: int) -> Triangles:
    """Surface of a geom in the frame of its body.

    Raises:
        TraceError: The geom is of a type that is not drawn (plane, height field, distance field).
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        local = _mesh(model, int(model.geom_dataid[geom]))
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        local = _box(size)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        local = _round(size[0], 0.0)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        local = _round(size[0], size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        local = _cylinder(size[0], size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        ball = _round(1.0, 0.0)
        normals = ball.normals / size
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        local = Triangles(ball.vertices * size, normals, ball.faces)
    else:
        raise TraceError(f"geom {model.geom(geom).name!r}: a {kind.name} cannot be drawn")
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    turn = rotation.reshape(3, 3).T
    return Triangles(
        local.vertices @ turn + model.geom_pos[geom], local.normals @ turn, local.faces
    )


def joined(parts: list[Triangles]) -> Triangles:
    """Several surfaces of one frame as one."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
    )


def _mesh(model: mujoco.MjModel, mesh: int) -> Triangles:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    first_face, face_count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(float)
    return _flat(vertices[model.mesh_face[first_face : first_face + face_count]])


def _box(half: NDArray[np.float64]) -> Triangles:
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
    sides = []
    for axis in range(3):
        # Rolling the axes keeps the orientation; turning both other axes over leads to the
        # opposite side without mirroring it.
        top = np.roll(square, axis + 1, axis=1)
        turned = np.ones(3)
        turned[[axis, (axis + 1) % 3]] = -1
        sides += [top, top * turned]
    corners = np.array(sides) * half
    return _flat(corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 3))


def _flat(triangles: NDArray[np.float64]) -> Triangles:
    """Triangles (F, 3, 3) with the normal of the plane at every corner, hence sharp edges."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    return Triangles(triangles.reshape(-1, 3), np.repeat(normal, 3, axis=0), faces)


def _round(radius: float, half_length: float) -> Triangles:
    """A sphere, or a capsule along z."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS // 2 + 2)
    if half_length:
        middle = len(angle) // 2
        angle = np.concatenate([angle[:middle], [0.0, 0.0], angle[middle:]])
    shift = np.where(np.arange(len(angle)) < len(angle) // 2, -half_length, half_length)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return _turned(radius * normal + np.column_stack([np.zeros(len(angle)), shift]), normal)


def _cylinder(radius: float, half_length: float) -> Triangles:
    r, h = radius, half_length
    profile = np.array([[0, -h], [r, -h], [r, -h], [r, h], [r, h], [0, h]])
    normal = np.array([[0, -1], [0, -1], [1, 0], [1, 0], [0, 1], [0, 1]], dtype=float)
    return _turned(profile, normal)


def _turned(profile: NDArray[np.float64], normal: NDArray[np.float64]) -> Triangles:
    """A profile of (distance from z, z), from bottom to top, turned about z."""
    angle = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    around = np.column_stack([np.cos(angle), np.sin(angle)])

    def turn(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        flat = rows[:, None, :1] * around
        height = np.broadcast_to(rows[:, None, 1:], (len(rows), SEGMENTS, 1))
        return np.concatenate([flat, height], axis=2).reshape(-1, 3)

    ring, step = np.meshgrid(np.arange(len(profile) - 1), np.arange(SEGMENTS), indexing="ij")
    a = ring * SEGMENTS + step
    b = ring * SEGMENTS + (step + 1) % SEGMENTS
    quads = np.stack([a, b, b + SEGMENTS, a + SEGMENTS], axis=-1).reshape(-1, 4)
    return Triangles(turn(profile), turn(normal), quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
