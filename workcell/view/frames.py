"""Poses of all that moves, at the instants that are drawn.

In come a trace and its model; out come positions and orientations of bodies and watched capsules,
found by MuJoCo's kinematics from `qpos`.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.trace.readings import period_s
from workcell.trace.table import Trace

WATCHED_GROUP = 4
"""Geom group of the watched capsules."""
GEOMETRY_PERIOD_S = 0.02
"""Chosen for fluent motion at a tenth of the data: screens redraw at 60 Hz."""
_FRAME_BLOCK = 512
"""Instants whose poses are held in double precision; chosen for a few megabytes."""


class Frames:
    """Poses of all that moves at the instants that are drawn.

    Kept as they are sent, in single precision, and only of what is drawn: a run of ten minutes has
    thirty thousand instants.
    """

    def __init__(self, trace: Trace, model: mujoco.MjModel):
        every = max(1, round(GEOMETRY_PERIOD_S / period_s(trace))) if len(trace) > 1 else 1
        self.rows = np.arange(0, len(trace), every)
        """Rows of the trace that are drawn, (K,)."""
        qpos = trace.part("qpos", self.rows)
        bodies = np.array(sorted({int(model.geom_bodyid[g]) for g in range(model.ngeom)}))
        capsules = np.flatnonzero([is_watched(model, g) for g in range(model.ngeom)])
        self._body_place = {body: k for k, body in enumerate(bodies.tolist())}
        self._capsule_place = {geom: k for k, geom in enumerate(capsules.tolist())}
        count = len(qpos)
        self._body_m = np.empty((len(bodies), count, 3), np.float32)
        self._body_xyzw = np.empty((len(bodies), count, 4), np.float32)
        self._capsule_m = np.empty((count, len(capsules), 3), np.float32)
        self._capsule_xyzw = np.empty((count, len(capsules), 4), np.float32)
        moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)
        corners = moving if len(moving) else np.arange(model.ngeom)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        data = mujoco.MjData(model)
        for start in range(0, count, _FRAME_BLOCK):
            block = slice(start, start + _FRAME_BLOCK)
            some = qpos[block]
            position_m, wxyz = (
                np.empty((len(some), model.nbody, 3)),
                np.empty((len(some), model.nbody, 4)),
            )
            geom_m, geom_xmat = (
                np.empty((len(some), model.ngeom, 3)),
                np.empty((len(some), model.ngeom, 9)),
            )
            for k, q in enumerate(some):
                data.qpos[:] = q
                mujoco.mj_kinematics(model, data)
                position_m[k], wxyz[k] = data.xpos, data.xquat
                geom_m[k], geom_xmat[k] = data.geom_xpos, data.geom_xmat
            self._body_m[:, block] = position_m[:, bodies].swapaxes(0, 1)
            self._body_xyzw[:, block] = wxyz[:, bodies][..., [1, 2, 3, 0]].swapaxes(0, 1)
            self._capsule_m[block] = geom_m[:, capsules]
            matrices = geom_xmat[:, capsules].reshape(-1, 9).astype(np.float32)
            self._capsule_xyzw[block] = _xyzw(matrices).reshape(len(some), len(capsules), 4)
            low = np.minimum(low, geom_m[:, corners].min(axis=(0, 1)))
            high = np.maximum(high, geom_m[:, corners].max(axis=(0, 1)))
        self.centre_m = (low + high) / 2
        self.extent_m = max(float((high - low).max()), 0.1)

    def body(self, body: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (K, 3) and orientations (K, 4), last entry real, of a body that has geoms."""
        place = self._body_place[body]
        return self._body_m[place], self._body_xyzw[place]

    def capsules(self, geoms: list[int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (K, n, 3) and orientations (K, n, 4), last entry real, of watched geoms."""
        places = [self._capsule_place[geom] for geom in geoms]
        return self._capsule_m[:, places], self._capsule_xyzw[:, places]


def is_watched(model: mujoco.MjModel, geom: int) -> bool:
    """Whether it is one of the round geoms that stand for a robot's links."""
    rounds = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE))
    return model.geom_group[geom] == WATCHED_GROUP and model.geom_type[geom] in rounds


def _xyzw(matrices: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rotation matrices (K, 9) as quaternions (K, 4), last entry real."""
    wxyz = np.empty((len(matrices), 4))
    for k, matrix in enumerate(matrices.astype(float)):
        mujoco.mju_mat2Quat(wxyz[k], matrix)
    return wxyz[:, [1, 2, 3, 0]].astype(np.float32)
