"""Within one arm: which of its pieces could collide, decided by looking at poses within the joint ranges.

Bodies three joints apart or more can meet anywhere: they are looked at whole, at home and in random
poses, and watched unless they overlap in all of them. Nearer bodies interlock, as hubs and forks do. They
are looked at piece by piece, over a grid of the one or two joints between them, ends of ranges included:

* never touching: left out, since joint ranges keep them apart;
* never farther apart than d_min: left out, since nothing could hold apart what is near by design;
* grazing: touching here and there, but never deeper than `GRAZE_M`: left out and named;
* all others could collide: watched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.guard.geometry import Piece

Distances = NDArray[np.float64]

FAR_JOINTS = 3
"""Bodies so many joints apart are looked at whole."""
SAMPLES = 100
"""Random poses, beside home, in which bodies that far apart are looked at."""
UNLIMITED = np.pi
"""Where a joint has no range, poses are taken from this to either side, rad or m."""
POSES_OF_ONE, POSES_OF_TWO = 61, 17
"""Grid values of a joint where one or two joints lie between; chosen to look about every 6 and 20 degrees."""
GRAZE_M = 0.002
"""Housings that overlap by less were drawn a little too large. Chosen above the 1.6 mm by which the tail cap of a
PA10's wrist enters its fork, and below the 4 mm and more by which its links enter one another where they collide."""


@dataclass(frozen=True)
class Near:
    """What the grid shows of two bodies one or two joints apart."""

    joints: int
    """Joints between them."""
    poses: int
    """Poses looked at."""
    nearest_m: Distances
    """(n, m) smallest distance of each piece of one from each of the other; not exact where they never touch."""
    farthest_m: Distances
    """(n, m) largest distance; not exact beyond d_min."""
    d_min_m: float

    @property
    def watched(self) -> NDArray[np.bool_]:
        """(n, m) pieces that could collide."""
        return (self.nearest_m <= -GRAZE_M) & (self.farthest_m > self.d_min_m)

    @property
    def grazing(self) -> NDArray[np.bool_]:
        """(n, m) pieces that touch here and there, and hardly."""
        touching = (self.nearest_m <= 0.0) & (self.farthest_m > self.d_min_m)
        return touching & ~self.watched

    @property
    def reason(self) -> str | None:
        """Why the rest is not watched; None if there is no rest."""
        rest = ~self.watched & ~self.grazing
        if not rest.any():
            return None
        apart = f"same arm, {self.joints} joint{'s' * (self.joints > 1)} apart"
        if (self.nearest_m[rest] <= 0.0).any():
            return f"{apart}: what touches there is never farther apart than d_min in {self.poses} poses across the joint ranges, thus by design"
        return f"{apart}, and not touching in any of {self.poses} poses across the joint ranges"


class SelfPairs:
    """Looks at the bodies of arms in poses.

    Args:
        model: The compiled scene.
        pieces: Of its geometry.
        home: (nq,) positions of all joints at the start; empty for the model's own zero pose, brought
            into the joint ranges.
        d_min_m: Distance at which the final check halts.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        pieces: Sequence[Piece],
        home: Sequence[float],
        d_min_m: float,
    ):
        self._model, self._pieces, self._d_min_m = model, pieces, d_min_m
        single = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        addresses = model.jnt_qposadr[single]
        limited = model.jnt_limited.astype(bool)
        self._lower = np.where(limited, model.jnt_range[:, 0], -UNLIMITED)
        self._upper = np.where(limited, model.jnt_range[:, 1], UNLIMITED)
        start = np.array(home) if len(home) else model.qpos0.copy()
        if not len(home):
            start[addresses] = np.clip(start[addresses], self._lower[single], self._upper[single])
        rng = np.random.default_rng(0)
        self.poses: list[mujoco.MjData] = []
        """Home first, then random poses of hinges and slides; positions computed."""
        for k in range(1 + SAMPLES):
            data = mujoco.MjData(model)
            data.qpos[:] = start
            if k:
                data.qpos[addresses] = rng.uniform(self._lower[single], self._upper[single])
            mujoco.mj_kinematics(model, data)
            self.poses.append(data)
        self._start = start
        self._known: dict[bytes, tuple[int, Distances, Distances]] = {}

    def always_overlap(self, first: Sequence[int], second: Sequence[int]) -> bool:
        """Whether pieces of two bodies overlap at home and in every random pose."""
        model, pieces = self._model, self._pieces
        return all(
            any(
                mujoco.mj_geomDistance(model, pose, pieces[i].geom, pieces[j].geom, 1.0, None) <= 0
                for i in first
                for j in second
            )
            for pose in self.poses
        )

    def near(self, way: Sequence[int], first: Sequence[int], second: Sequence[int]) -> Near:
        """Look at two bodies that one or two joints move against one another.

        Args:
            way: Bodies on the way through the tree from one to the other, without their common ancestors.
            first, second: Numbers of the two bodies' pieces.
        """
        model = self._model
        joints = [
            joint
            for body in way
            for joint in range(
                model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
            )
        ]
        key = self._signature(way, joints, first, second)
        if key not in self._known:  # Two arms of one file are looked at once.
            self._known[key] = self._over_grid(joints, first, second)
        poses, nearest, farthest = self._known[key]
        nearest, farthest = nearest.copy(), farthest.copy()
        self._see(self.poses[0], first, second, nearest, farthest)  # Home is each arm's own.
        return Near(len(joints), poses, nearest, farthest, self._d_min_m)

    def _over_grid(
        self, joints: Sequence[int], first: Sequence[int], second: Sequence[int]
    ) -> tuple[int, Distances, Distances]:
        """Number of poses, and smallest and largest distances over all of them."""
        model, data = self._model, mujoco.MjData(self._model)
        nearest = np.full((len(first), len(second)), np.inf)
        farthest = -nearest
        count = POSES_OF_ONE if len(joints) == 1 else POSES_OF_TWO
        grid = [np.linspace(self._lower[j], self._upper[j], count) for j in joints]
        data.qpos[:] = self._start
        addresses = model.jnt_qposadr[joints]
        for values in product(*grid):
            data.qpos[addresses] = values
            mujoco.mj_kinematics(model, data)
            self._see(data, first, second, nearest, farthest)
        return count ** len(joints), nearest, farthest

    def _see(
        self,
        data: mujoco.MjData,
        first: Sequence[int],
        second: Sequence[int],
        nearest: Distances,
        farthest: Distances,
    ) -> None:
        """Take one pose into account, as far as it can change an answer."""
        model, d_min = self._model, self._d_min_m
        geoms_i, geoms_j = ([self._pieces[k].geom for k in side] for side in (first, second))
        between = data.geom_xpos[geoms_i][:, None] - data.geom_xpos[geoms_j]
        radii = model.geom_rbound[geoms_i][:, None] + model.geom_rbound[geoms_j]
        far = np.linalg.norm(between, axis=-1) - radii > d_min
        farthest[far] = np.inf
        settled = (farthest > d_min) & (nearest <= -GRAZE_M)
        for a, b in np.argwhere(~far & ~settled):
            distance = mujoco.mj_geomDistance(
                model, data, geoms_i[a], geoms_j[b], 2.0 * d_min, None
            )
            nearest[a, b] = min(nearest[a, b], distance)
            farthest[a, b] = max(farthest[a, b], distance)

    def _signature(
        self, way: Sequence[int], joints: Sequence[int], first: Sequence[int], second: Sequence[int]
    ) -> bytes:
        """Equal for two bodies that are shaped alike and move alike."""
        model = self._model
        number = {body: k for k, body in enumerate(way)}
        geoms = [self._pieces[k].geom for k in (*first, *second)]
        carriers = [*model.geom_bodyid[geoms].tolist(), *model.body_parentid[list(way)].tolist()]
        parts = [
            np.array([len(first), *(number.get(body, -1) for body in carriers)]),
            *(getattr(model, f"geom_{name}")[geoms] for name in ("type", "size", "pos", "quat")),
            *(getattr(model, f"body_{name}")[list(way)] for name in ("pos", "quat", "jntnum")),
            *(getattr(model, f"jnt_{name}")[joints] for name in ("pos", "axis", "type")),
            model.qpos0[model.jnt_qposadr[joints]],
            self._lower[joints],
            self._upper[joints],
        ]
        for mesh in model.geom_dataid[geoms].tolist():
            if mesh >= 0:
                start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
                parts.append(model.mesh_vert[start : start + count])
        return b"|".join(np.ascontiguousarray(part).tobytes() for part in parts)
