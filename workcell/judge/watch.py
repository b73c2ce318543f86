"""Distances of many pairs over many poses, measured only where they can matter.

A pair's distance falls between two poses by no more than its two geoms' points have moved: of a geom that is
displaced by c and turned by R, |c| + ρ |R - 1|_F / √2 with ρ the radius of its bounding sphere. So every measured distance
is a lower bound of later ones, less the ways since; only pairs whose bound is below what is asked are measured anew.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.judge.kinematics import length

Array = NDArray[np.float64]

CEILING_M = 10.0
"""Distances beyond it are not told apart; larger than any arm's reach."""


class PairWatch:
    """Lower bounds of the distances of P pairs, kept from pose to pose.

    Args:
        model: The scene.
        pairs: (P, 2) geom ids.
    """

    def __init__(self, model: mujoco.MjModel, pairs: NDArray[np.intp]):
        self.model = model
        self.pairs = pairs
        self.lower_m = np.zeros(len(pairs))
        """(P,) no distance is smaller."""
        self.ends_m = np.zeros((len(pairs), 6))
        """(P, 6) nearest points on the first and second geom at the last measurement."""
        self.measured = 0
        """Distances measured so far."""
        self._i, self._j = pairs[:, 0].copy(), pairs[:, 1].copy()
        self._rows = list(map(tuple, pairs.tolist()))
        self._pose: tuple[Array, Array] | None = None

    def move(self, data: mujoco.MjData) -> None:
        """Take a new pose into account, after `mj_kinematics`."""
        (way,) = self.ways(data.geom_xpos[None], data.geom_xmat[None])
        self.lower_m -= way

    def ways(self, position: Array, rotation: Array) -> Array:
        """(C, P) by how much distances can have fallen from pose to pose, of (C, G, 3) and (C, G, 9) in a row."""
        before = self._pose or (position[0], rotation[0])
        position = np.concatenate([before[0][None], position])
        rotation = np.concatenate([before[1][None], rotation])
        self._pose = position[-1].copy(), rotation[-1].copy()
        way = length(np.diff(position, axis=0))
        way += self.model.geom_rbound * length(np.diff(rotation, axis=0)) / np.sqrt(2.0)
        return way[:, self._i] + way[:, self._j]

    def measure(self, data: mujoco.MjData, which: NDArray[np.intp]) -> Array:
        """(K,) distances of some pairs now, by MuJoCo's own search."""
        model, rows, ends, lower = self.model, self._rows, self.ends_m, self.lower_m
        for k in which.tolist():
            i, j = rows[k]
            lower[k] = mujoco.mj_geomDistance(model, data, i, j, CEILING_M, ends[k])
        self.measured += len(which)
        return lower[which]
