"""Where every geom was and how every body moved, for a stretch of ticks at once: by MuJoCo's kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRETCH = 256
"""Ticks that are worked on at once; chosen so that their arrays stay within a few megabytes."""


@dataclass(frozen=True)
class Stretch:
    """C ticks in a row, of a model with G geoms, B bodies and S sites."""

    time_s: Array
    """(C,)"""
    t_min_s: Array
    """(C,) in force."""
    qvel: Array
    """(C, nv) true."""
    position: Array
    """(C, G, 3) of geoms."""
    rotation: Array
    """(C, G, 9) of geoms."""
    site: Array
    """(C, S, 3) of sites."""
    centre: Array
    """(C, B, 3) the point that each body's twist refers to."""
    true: Array
    """(C, B, 6) twists at the true velocities, angular part first."""
    told: Array
    """(C, B, 6) twists at the commanded velocities."""

    def __len__(self) -> int:
        return len(self.time_s)


def stretch(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    time_s: Array,
    t_min_s: Array,
    qpos: Array,
    qvel: Array,
    command: Array,
) -> Stretch:
    """The kinematics of C ticks.

    Args:
        model, data: The scene, and data to work on.
        time_s, t_min_s: (C,).
        qpos, qvel: (C, nq), (C, nv) of the plant.
        command: (C, nv) joint velocities commanded in these ticks.
    """
    C = len(time_s)
    found = Stretch(
        time_s,
        t_min_s,
        qvel,
        np.empty((C, model.ngeom, 3)),
        np.empty((C, model.ngeom, 9)),
        np.empty((C, model.nsite, 3)),
        np.empty((C, model.nbody, 3)),
        np.empty((C, model.nbody, 6)),
        np.empty((C, model.nbody, 6)),
    )
    root = model.body_rootid
    for c in range(C):
        data.qpos[:] = qpos[c]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        found.position[c], found.rotation[c] = data.geom_xpos, data.geom_xmat
        found.site[c], found.centre[c] = data.site_xpos, data.subtree_com[root]
        for velocity, twist in ((command, found.told), (qvel, found.true)):
            data.qvel[:] = velocity[c]
            mujoco.mj_comVel(model, data)
            twist[c] = data.cvel
    return found


def point_velocity(twist: Array, centre: Array, point: Array) -> Array:
    """(..., 3) velocities of material points of bodies: v + ω × (point - centre)."""
    return twist[..., 3:] + cross(twist[..., :3], point - centre)


def cross(a: Array, b: Array) -> Array:
    """(..., 3) cross products, without NumPy's look at axes, which takes longer than the product."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def length(vector: Array) -> Array:
    """(...) Euclidean lengths."""
    return np.sqrt(np.vecdot(vector, vector))
