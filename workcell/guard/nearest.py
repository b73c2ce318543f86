"""The smallest distance over all watched pieces, exact below a ceiling, in a fraction of a tick.

A configuration comes in; the nearest pair and its distance come out. Branch and bound: every
pair has a cheap lower bound (first spheres around the pieces, then a sphere against an oriented
box), pairs are measured exactly (`mj_geomDistance`) in the order of their bounds, and the search
ends when the next bound is not below the smallest distance found. It starts from the pair that
was nearest last time, which is nearly always still close to the smallest.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.guard.geometry import Geometry
from workcell.guard.pairs import PairTable

# Convergence of the distance between curved pieces, m. A thousandth of the smallest sensible
# d_min (1 mm); MuJoCo's default of 1e-6 m costs the same and leaves errors of that order.
CCD_TOLERANCE_M = 1e-7
# Lower bounds are widened by this against rounding, m: positions of metres carry 1e-15.
BOUND_SLACK_M = 1e-9

_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


@dataclass(frozen=True)
class Nearest:
    """The nearest pair of one search."""

    distance_m: float
    """Smallest signed distance, m; the ceiling if no pair is nearer than that."""
    pair: tuple[int, int] | None
    """Indices of the two pieces, smaller first; None at the ceiling."""
    measured: int
    """How many pairs had to be measured exactly."""


class NearestSearch:
    """Finds nearest pairs in one scene. Owns its MjData; not for use by two threads.

    Args:
        model: The compiled scene. Its distance tolerance is set to `CCD_TOLERANCE_M`.
        geometry: The pieces.
        table: Which pairs are watched.
        ceiling_m: Distances beyond this are not told apart, m.
    """

    def __init__(
        self, model: mujoco.MjModel, geometry: Geometry, table: PairTable, *, ceiling_m: float
    ):
        model.opt.ccd_tolerance = CCD_TOLERANCE_M
        # Twice the default: a tighter tolerance may take more steps, and a search that ends for
        # lack of them is not exact.
        model.opt.ccd_iterations = max(int(model.opt.ccd_iterations), 70)
        self._model = model
        self._data = mujoco.MjData(model)
        self._ceiling_m = ceiling_m
        self._watched = table.watched
        self._geoms = np.array([piece.geom for piece in geometry.pieces], dtype=int)
        boxes = model.geom_aabb[self._geoms]
        self._centre_local = boxes[:, :3].copy()
        self._half_m = boxes[:, 3:].copy()
        self._radius_m = _bounding_radii(model, self._geoms, self._centre_local, self._half_m)
        self._planes = np.flatnonzero(model.geom_type[self._geoms] == _PLANE)
        self._reach_m = self._radius_m[:, None] + self._radius_m[None, :] + BOUND_SLACK_M
        # Subtracting this from squared centre distances leaves pairs that cannot count at +inf.
        self._reach_sq = self._reach_m**2
        self._last: dict[int, tuple[int, int]] = {}
        self._masks: dict[int, NDArray[np.float64]] = {}

    def place(self, qpos: NDArray[np.float64]) -> None:
        """Moves the pieces to a configuration (nq,) of the model."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        self._rotation = rotation
        self._centre = self._data.geom_xpos[self._geoms] + np.einsum(
            "nij,nj->ni", rotation, self._centre_local
        )

    def nearest(self, mask: NDArray[np.bool_], key: int = 0) -> Nearest:
        """Nearest pair among those of a symmetric mask (n, n), in the configuration last placed.

        Args:
            mask: Which pairs count.
            key: Names the mask; one mask a key. The search keeps its bounds and its last pair.
        """
        best_m, best_pair, measured = self._ceiling_m, None, 0
        start = self._last.get(key)
        if start is not None:
            best_m, best_pair, measured = *self._measure(start, best_m, None), 1
        pairs_i, pairs_j, bounds = self._candidates(mask, key, best_m)
        for i, j, bound in zip(pairs_i.tolist(), pairs_j.tolist(), bounds.tolist(), strict=True):
            if bound >= best_m:
                break
            if (i, j) == start:
                continue
            best_m, best_pair = self._measure((i, j), best_m, best_pair)
            measured += 1
        if best_pair is not None:
            self._last[key] = best_pair
        return Nearest(best_m, best_pair, measured)

    def _measure(
        self, pair: tuple[int, int], best_m: float, best_pair: tuple[int, int] | None
    ) -> tuple[float, tuple[int, int] | None]:
        distance_m = mujoco.mj_geomDistance(
            self._model,
            self._data,
            int(self._geoms[pair[0]]),
            int(self._geoms[pair[1]]),
            # Asked for a limit below zero MuJoCo would not resolve how deep a contact is.
            max(best_m, CCD_TOLERANCE_M),
            None,
        )
        return (distance_m, pair) if distance_m < best_m else (best_m, best_pair)

    def _candidates(
        self, mask: NDArray[np.bool_], key: int, best_m: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Pairs whose lower bound is below `best_m`, by rising bound."""
        if key not in self._masks:
            counted = np.triu(mask, 1)
            counted[self._planes, :] = counted[:, self._planes] = False
            self._masks[key] = np.where(counted, self._reach_sq, -np.inf)
        limit_m = max(best_m, 0.0)
        square = np.einsum("ni,ni->n", self._centre, self._centre)
        # |a - b|^2 - reach^2 - 2 reach limit < limit^2, that is, |a - b| - reach < limit.
        excess = self._centre @ (-2.0 * self._centre.T)
        excess += square[:, None]
        excess += square
        excess -= self._masks[key]
        excess -= (2.0 * limit_m) * self._reach_m
        flat = np.flatnonzero(excess < limit_m**2 + BOUND_SLACK_M)
        pairs_i, pairs_j = np.divmod(flat, len(self._geoms))
        bounds = np.maximum(
            self._sphere_to_box(pairs_i, pairs_j), self._sphere_to_box(pairs_j, pairs_i)
        )
        if len(self._planes):
            plane_i, plane_j, plane_bounds = self._plane_pairs(mask)
            pairs_i = np.concatenate([pairs_i, plane_i])
            pairs_j = np.concatenate([pairs_j, plane_j])
            bounds = np.concatenate([bounds, plane_bounds])
        order = np.argsort(bounds, kind="stable")
        order = order[: np.searchsorted(bounds[order], best_m)]
        return pairs_i[order], pairs_j[order], bounds[order]

    def _sphere_to_box(
        self, spheres: NDArray[np.int64], boxes: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        offset = self._centre[spheres] - self._centre[boxes]
        local = np.einsum("ni,nij->nj", offset, self._rotation[boxes])
        outside = np.maximum(np.abs(local) - self._half_m[boxes], 0.0)
        gap = np.sqrt(np.einsum("ni,ni->n", outside, outside))
        # Inside the box the gap says nothing about depth, so such a pair is always measured.
        return np.where(gap > 0.0, gap - self._radius_m[spheres] - BOUND_SLACK_M, -np.inf)

    def _plane_pairs(
        self, mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        rows, others = np.nonzero(mask[self._planes])
        planes = self._planes[rows]
        normal = self._rotation[planes][:, :, 2]
        height = np.einsum("ni,ni->n", self._centre[others] - self._centre[planes], normal)
        bounds = height - self._radius_m[others] - BOUND_SLACK_M
        return np.minimum(planes, others), np.maximum(planes, others), bounds


def _bounding_radii(
    model: mujoco.MjModel,
    geoms: NDArray[np.int64],
    centre_local: NDArray[np.float64],
    half_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Radius of a sphere about each piece's box centre that contains the piece, m."""
    radii = np.linalg.norm(half_m, axis=1)
    for index, geom in enumerate(geoms):
        kind = int(model.geom_type[geom])
        if kind == _MESH:
            mesh = int(model.geom_dataid[geom])
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            vertices = model.mesh_vert[first : first + count]
            radii[index] = np.linalg.norm(vertices - centre_local[index], axis=1).max()
        elif kind == _PLANE:
            radii[index] = 0.0
        else:
            # Primitives are centred on their frame; MuJoCo's own radius is exact for them.
            radii[index] = min(radii[index], model.geom_rbound[geom])
    return radii
