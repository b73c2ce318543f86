"""The smallest distance over all watched pieces, exact below a ceiling, in a fraction of a tick.

A configuration comes in; the nearest pair and its distance come out. Branch and bound: every
pair has a cheap lower bound (first spheres around the pieces, then a sphere against an oriented
box), pairs are measured exactly (`mj_geomDistance`) in the order of their bounds, and the search
ends when the next bound is not below the smallest distance found. It starts from the pair that
was nearest last time, which is nearly always still close to the smallest.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.guard.geometry import Geometry

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
        ceiling_m: Distances beyond this are not told apart, m.
    """

    def __init__(self, model: mujoco.MjModel, geometry: Geometry, *, ceiling_m: float):
        model.opt.ccd_tolerance = CCD_TOLERANCE_M
        # Twice the default: a tighter tolerance may take more steps, and a search that ends for
        # lack of them is not exact.
        model.opt.ccd_iterations = max(int(model.opt.ccd_iterations), 70)
        self._model = model
        self._data = mujoco.MjData(model)
        self._ceiling_m = ceiling_m
        self._geoms = np.array([piece.geom for piece in geometry.pieces], dtype=int)
        boxes = model.geom_aabb[self._geoms]
        self._centre_local = boxes[:, :3].copy()
        self._half_m = boxes[:, 3:].copy()
        self._radius_m = _bounding_radii(model, self._geoms, self._centre_local, self._half_m)
        self._planes = model.geom_type[self._geoms] == _PLANE
        # MuJoCo's box of a plane is the half-space below it, with a centre 5e9 m down; what is
        # asked of a plane is its own origin.
        self._centre_local[self._planes] = 0.0
        self._lists: dict[Hashable, _PairList] = {}

    def place(self, qpos: NDArray[np.float64]) -> None:
        """Moves the pieces to a configuration (nq,) of the model."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        self._rotation = rotation
        self._centre = self._data.geom_xpos[self._geoms] + np.einsum(
            "nij,nj->ni", rotation, self._centre_local
        )

    def nearest(self, mask: NDArray[np.bool_], key: Hashable = 0) -> Nearest:
        """Nearest pair among those of a symmetric mask (n, n), in the configuration last placed.

        Args:
            mask: Which pairs count.
            key: Names the mask; one mask a key. The search keeps its bounds and its last pair.
        """
        pairs = self._lists.get(key)
        if pairs is None:
            pairs = self._lists[key] = self._list(mask)
        bounds = self._sphere_bounds(pairs)
        best_m, best = self._ceiling_m, None
        # Two guesses bring the limit down before any list is sorted: what was nearest last
        # time, and what the spheres say is nearest now.
        guesses = [] if pairs.last is None else [pairs.last]
        if len(bounds):
            guesses.append(int(np.argmin(bounds)))
        for k in guesses:
            best_m, best = self._measure(pairs, k, best_m, best)
        measured = len(guesses)
        near = np.flatnonzero(bounds < best_m)
        for spheres, boxes in ((pairs.i, pairs.j), (pairs.j, pairs.i)):
            bounds[near] = np.maximum(bounds[near], self._box_bounds(spheres[near], boxes[near]))
            near = near[bounds[near] < best_m]
        near_bounds = bounds[near]
        order = np.argsort(near_bounds, kind="stable")
        for k, bound in zip(near[order].tolist(), near_bounds[order].tolist(), strict=True):
            if bound >= best_m:
                break
            if k not in guesses:
                best_m, best = self._measure(pairs, k, best_m, best)
                measured += 1
        if best is None:
            return Nearest(best_m, None, measured)
        pairs.last = best
        return Nearest(best_m, (int(pairs.i[best]), int(pairs.j[best])), measured)

    def _list(self, mask: NDArray[np.bool_]) -> _PairList:
        pairs_i, pairs_j = np.nonzero(np.triu(mask, 1))
        with_plane = self._planes[pairs_i] | self._planes[pairs_j]
        # Planes last, so that the two kinds of bound are two slices.
        order = np.argsort(with_plane, kind="stable")
        pairs_i, pairs_j = pairs_i[order], pairs_j[order]
        return _PairList(
            i=pairs_i,
            j=pairs_j,
            flat=pairs_i * len(self._geoms) + pairs_j,
            reach_m=self._radius_m[pairs_i] + self._radius_m[pairs_j] + BOUND_SLACK_M,
            first_plane=int(np.count_nonzero(~with_plane)),
        )

    def _measure(
        self, pairs: _PairList, k: int, best_m: float, best: int | None
    ) -> tuple[float, int | None]:
        distance_m = mujoco.mj_geomDistance(
            self._model,
            self._data,
            int(self._geoms[pairs.i[k]]),
            int(self._geoms[pairs.j[k]]),
            # Asked for a limit below zero MuJoCo would not resolve how deep a contact is.
            max(best_m, CCD_TOLERANCE_M),
            None,
        )
        return (distance_m, k) if distance_m < best_m else (best_m, best)

    def _sphere_bounds(self, pairs: _PairList) -> NDArray[np.float64]:
        """Lower bounds (pairs,) from spheres around the pieces; from planes as they are."""
        square = np.einsum("ni,ni->n", self._centre, self._centre)[:, None]
        one = np.ones_like(square)
        # |a - b|^2 = -2 a·b + |a|^2 + |b|^2 for all pieces at once.
        left = np.hstack([-2.0 * self._centre, square, one])
        right = np.hstack([self._centre, one, square])
        bounds = (left @ right.T).take(pairs.flat)
        np.sqrt(np.maximum(bounds, 0.0, out=bounds), out=bounds)
        bounds -= pairs.reach_m
        flat = slice(pairs.first_plane, None)
        pairs_i, pairs_j = pairs.i[flat], pairs.j[flat]
        planes = np.where(self._planes[pairs_i], pairs_i, pairs_j)
        others = pairs_i + pairs_j - planes
        normal = self._rotation[planes][:, :, 2]
        height = np.einsum("ni,ni->n", self._centre[others] - self._centre[planes], normal)
        bounds[flat] = height - pairs.reach_m[flat]
        return bounds

    def _box_bounds(
        self, spheres: NDArray[np.int64], boxes: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Lower bounds from the sphere of one piece and the oriented box of the other, m."""
        offset = self._centre[spheres] - self._centre[boxes]
        local = np.einsum("ni,nij->nj", offset, self._rotation[boxes])
        outside = np.maximum(np.abs(local) - self._half_m[boxes], 0.0)
        gap = np.sqrt(np.einsum("ni,ni->n", outside, outside))
        # Inside the box the gap says nothing about depth; a plane has no box.
        known = (gap > 0.0) & ~(self._planes[spheres] | self._planes[boxes])
        return np.where(known, gap - self._radius_m[spheres] - BOUND_SLACK_M, -np.inf)


@dataclass
class _PairList:
    """The pairs of one mask, and which of them was nearest last."""

    i: NDArray[np.int64]
    """(pairs,) smaller piece index."""
    j: NDArray[np.int64]
    """(pairs,) larger piece index."""
    flat: NDArray[np.int64]
    """(pairs,) their place in a flattened table over pieces."""
    reach_m: NDArray[np.float64]
    """(pairs,) sum of the bounding radii."""
    first_plane: int
    """From this pair on one of the two is a plane."""
    last: int | None = None
    """Index of the nearest pair of the last search."""


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
