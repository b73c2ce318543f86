"""MuJoCo geoms as shapes of Coal, an implementation of distances that shares nothing with ours."""

from __future__ import annotations

from collections.abc import Iterable

import coal
import mujoco


def shape_of(model: mujoco.MjModel, geom: int) -> coal.ShapeBase:
    """The convex solid of a geom, in the geom's frame."""
    size = model.geom_size[geom]
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_BOX:
            return coal.Box(*(2.0 * size))
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return coal.Cylinder(size[0], 2.0 * size[1])
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return coal.Capsule(size[0], 2.0 * size[1])
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = coal.StdVec_Vec3s()
            for vertex in model.mesh_vert[first : first + count].astype(float):
                points.append(vertex)
            return coal.Convex.convexHull(points, False, None)
    raise AssertionError(f"no shape for geom {geom}")


def smallest_distance_m(
    data: mujoco.MjData, shapes: dict[int, coal.ShapeBase], pairs: Iterable[tuple[int, int]]
) -> float:
    """Smallest distance over pairs of geom ids, m."""
    frames = {
        geom: coal.Transform3s(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        for geom in shapes
    }
    request = coal.DistanceRequest()
    return min(
        coal.distance(shapes[a], frames[a], shapes[b], frames[b], request, coal.DistanceResult())
        for a, b in pairs
    )
