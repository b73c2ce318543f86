"""The smallest distance over all watched pieces, exact below a ceiling, in a fraction of a tick.

A configuration comes in; the nearest pair and its distance come out. Branch and bound: every pair
has a lower bound (spheres around the pieces, then a sphere against an oriented box), and pairs are
measured exactly (`mj_geomDistance`) while their bounds are below the smallest distance found. It
starts from the pair that was nearest last time, nearly always still close to the smallest.

Bounds are kept from one configuration to the next. Pairs are grouped in blocks, one for every two
bodies, and a configuration costs what has changed. Why nothing nearer is skipped:

* The displacement of a point of a rigid body is an affine function of the point, and its norm a
  convex one: over a box it is largest at a corner. The eight corners of a box around a body's pieces
  thus bound how far any point of them has moved, by s_k at the k-th configuration.
* Let S = Σ s_k be a body's travel since the start. By the triangle inequality two bodies a, b have
  come nearer by no more than ΔS_a + ΔS_b since a bound was made, however they moved, far jumps
  included: a bound B made at travels S_a, S_b holds as B + S_a + S_b - S_a(now) - S_b(now).
* A pair is left unmeasured only while such a bound, its own or the least of its block, is not
  below the smallest distance found. Both come from spheres and boxes around the pieces, never
  from a measured distance: what one measurement might get wrong does not outlive its configuration.
* Only bounds of pairs that are apart (B > 0) are kept; all others are measured every time. How
  deep a contact is thus enters no kept bound.

Distances so found are those of measuring every pair. Where several pairs are equally near to within
the tolerance of a measurement (`CCD_TOLERANCE_M`), any of them may be named.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Hashable
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.guard.geometry import Geometry

# Convergence of the distance between curved pieces, m. A thousandth of the smallest sensible
# d_min (1 mm); MuJoCo's default of 1e-6 m costs the same and leaves errors of that order.
CCD_TOLERANCE_M = 1e-7
# Lower bounds are widened by this against rounding, m: positions of metres carry 1e-15. Travel is
# lengthened by it at every configuration, which is more than adding to it may round off.
BOUND_SLACK_M = 1e-9
# All bounds are forgotten when a body has travelled this far, m: sums of such size still round
# by a thousandth of the slack.
MAX_TRAVEL_M = 1e4
# When bounds are made anew, those of every block within this of the smallest distance are, m: a
# batch costs nearly the same whatever its size, and what is near will be wanted soon. Chosen by
# trial on recorded runs, as are the next five; none of them changes an answer.
AHEAD_M = 0.03
# Pairs whose spheres are within this of the smallest distance get the better bound of boxes, m, and
# of those that then still are, and of all in blocks of FEW_PAIRS, each one's bound is kept.
REFINE_M = 0.1
FEW_PAIRS = 24
# As many measurements more than fresh bounds would have asked for cost about as much as a batch.
BATCH_WORTH = 60
# From so many blocks on, spheres around whole bodies are worth a look first.
MANY_BLOCKS = 40

_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


@dataclass(frozen=True)
class Nearest:
    """The nearest pair of one search."""

    distance_m: float
    """Smallest signed distance, m; the ceiling if no pair is nearer than that; not a number if the
    configuration is none."""
    pair: tuple[int, int] | None
    """Indices of the two pieces, smaller first; None at the ceiling."""
    measured: int
    """How many pairs had to be measured exactly."""


class NearestSearch:
    """Finds nearest pairs in one scene. Owns its MjData; not for use by two threads.

    Args:
        model: The compiled scene. Its distance tolerance is set to `CCD_TOLERANCE_M`.
        geometry: The pieces.
        watched: (n, n) symmetric; every pair that will ever be asked for.
        ceiling_m: Distances beyond this are not told apart, m.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        geometry: Geometry,
        watched: NDArray[np.bool_],
        *,
        ceiling_m: float,
    ):
        model.opt.ccd_tolerance = CCD_TOLERANCE_M
        # Twice the default: a tighter tolerance may take more steps, and a search that ends for
        # lack of them is not exact.
        model.opt.ccd_iterations = max(int(model.opt.ccd_iterations), 70)
        self._model = model
        self._data = mujoco.MjData(model)
        self._ceiling_m = ceiling_m
        self._watched = watched.copy()
        self._geoms = np.array([piece.geom for piece in geometry.pieces], dtype=int)
        boxes = model.geom_aabb[self._geoms]
        self._centre_local = boxes[:, :3].copy()
        self._half_m = boxes[:, 3:].copy()
        self._radius_m = _bounding_radii(model, self._geoms, self._centre_local, self._half_m)
        self._planes = model.geom_type[self._geoms] == _PLANE
        # MuJoCo's box of a plane is the half-space below it, with a centre 5e9 m down; what is
        # asked of a plane is its own origin.
        self._centre_local[self._planes] = 0.0
        self._any_plane = bool(self._planes.any())
        # Views into what MuJoCo writes.
        self._qpos = self._data.qpos
        self._geom_position = self._data.geom_xpos
        self._geom_rotation = self._data.geom_xmat.reshape(-1, 3, 3)
        self._body_position = self._data.xpos[:, :, None]
        self._body_rotation = self._data.xmat.reshape(-1, 3, 3)
        bodies = np.array([piece.body for piece in geometry.pieces], dtype=int)
        self._corners_local = self._boxes_around(bodies)
        self._body_radius_m = np.linalg.norm(
            0.5 * (self._corners_local[:, :, 0] - self._corners_local[:, :, -1]), axis=1
        )
        # Nothing is known of planes; no sphere contains one.
        self._body_radius_m[np.unique(bodies[self._planes])] = np.inf
        mujoco.mj_kinematics(model, self._data)
        self._corners = self._body_rotation @ self._corners_local + self._body_position
        self._travel_m = np.zeros(model.nbody)
        self._pairs = _Pairs.of(watched, bodies)
        self._geom_i: list[int] = self._geoms[self._pairs.i].tolist()
        self._geom_j: list[int] = self._geoms[self._pairs.j].tolist()
        self._reach_m = self._radius_m[self._pairs.i] + self._radius_m[self._pairs.j]
        self._reach_m += BOUND_SLACK_M
        blocks = len(self._pairs.first)
        # Bounds plus the travels of both bodies when they were made: of every block the least; of
        # its nearer pairs each, in rising order, with their rows; and the least of the others.
        self._kept_m = np.full(blocks, -np.inf)
        self._near: list[tuple[list[float], list[int]]] = [([], [])] * blocks
        self._others_m = [-math.inf] * blocks
        # What follows from the configuration.
        self._travelled_m = np.zeros(blocks)
        self._bounds_m = self._kept_m.copy()
        self._centre: NDArray[np.float64] | None = None
        self._lost = False
        self._groups: dict[Hashable, _Group] = {}
        self._recent = -1

    def place(self, qpos: NDArray[np.float64]) -> None:
        """Moves the pieces to a configuration (nq,) of the model."""
        self._qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        corners = np.matmul(self._body_rotation, self._corners_local)
        corners += self._body_position
        moved = corners - self._corners
        self._corners = corners
        self._travel_m += np.sqrt(np.einsum("bxc,bxc->cb", moved, moved).max(axis=0))
        self._travel_m += BOUND_SLACK_M
        self._lost = False
        # Written so that what is not a number is not below either.
        if not self._travel_m.max() < MAX_TRAVEL_M:
            self._forget()
            self._lost = not np.isfinite(corners).all()
        self._centre = None
        pairs = self._pairs
        self._travelled_m = self._travel_m.take(pairs.body_i)
        self._travelled_m += self._travel_m.take(pairs.body_j)
        self._bounds_m = self._kept_m - self._travelled_m

    def nearest(self, mask: NDArray[np.bool_], key: Hashable = 0) -> Nearest:
        """Nearest pair among those of a symmetric mask (n, n), in the configuration last placed.

        Args:
            mask: Which pairs count, all of them watched.
            key: Names the mask; one mask a key. The search keeps what it knows of it.

        Raises:
            ValueError: If the mask has a pair that is not watched.
        """
        if self._lost:
            return Nearest(float("nan"), None, 0)
        group = self._groups.get(key)
        if group is None:
            group = self._groups[key] = self._group(mask)
        best = _Best(self._ceiling_m)
        if group.last >= 0:
            self._measure(group.last, best)
        blocks = self._below(group, best.distance_m)
        if blocks:
            expected = self._candidates(blocks, best.distance_m)
            group.waste += max(expected - group.usual, 0)
            if group.waste > BATCH_WORTH:
                self._renew(group, self._below(group, best.distance_m + AHEAD_M), best)
                blocks = self._below(group, best.distance_m)
                group.waste, group.usual = 0, self._candidates(blocks, best.distance_m)
        # What is nearest is likely in the block of the lowest bound.
        for block in sorted(blocks, key=self._bounds_m.__getitem__):
            travelled_m = float(self._travelled_m[block])
            for kept_m, row in zip(*self._near[block], strict=True):
                if kept_m - travelled_m >= best.distance_m:
                    break
                if group.counts[row]:
                    self._measure(row, best)
            if self._others_m[block] - travelled_m < best.distance_m:
                for row in self._pairs.rows[block]:
                    if group.counts[row]:
                        self._measure(row, best)
        if best.row < 0:
            return Nearest(best.distance_m, None, best.measured)
        group.last = self._recent = best.row
        pair = (int(self._pairs.i[best.row]), int(self._pairs.j[best.row]))
        return Nearest(best.distance_m, pair, best.measured)

    def _below(self, group: _Group, limit_m: float) -> list[int]:
        """The group's blocks with a lower bound below a limit."""
        if group.blocks is None:
            return np.flatnonzero(self._bounds_m < limit_m).tolist()
        return group.blocks[self._bounds_m.take(group.blocks) < limit_m].tolist()

    def _candidates(self, blocks: list[int], limit_m: float) -> int:
        """How many pairs of some blocks would be measured below a limit."""
        count = 0
        for block in blocks:
            kept_m = limit_m + float(self._travelled_m[block])
            count += bisect_left(self._near[block][0], kept_m)
            if self._others_m[block] < kept_m:
                count += len(self._pairs.rows[block])
        return count

    def _measure(self, row: int, best: _Best) -> None:
        limit_m = best.distance_m
        distance_m = mujoco.mj_geomDistance(
            self._model,
            self._data,
            self._geom_i[row],
            self._geom_j[row],
            # Asked for a limit below zero MuJoCo would not resolve how deep a contact is.
            limit_m if limit_m > CCD_TOLERANCE_M else CCD_TOLERANCE_M,
            None,
        )
        best.measured += 1
        if distance_m < limit_m:
            best.distance_m, best.row = distance_m, row

    def _renew(self, group: _Group, blocks: list[int], best: _Best) -> None:
        """Makes the bounds of all pairs of some blocks anew, and measures the group's nearest by spheres."""
        chosen = np.array(blocks)
        if len(chosen) > MANY_BLOCKS:
            chosen = self._not_apart(chosen, best.distance_m + AHEAD_M)
            if not len(chosen):
                return
        pairs = self._pairs
        counts = pairs.count[chosen]
        ends = counts.cumsum()
        starts = ends - counts
        rows = np.repeat(pairs.first[chosen] - starts, counts) + np.arange(ends[-1])
        i, j = pairs.i.take(rows), pairs.j.take(rows)
        centre = self._centres()
        bounds = self._sphere_bounds(centre, i, j) - self._reach_m[rows]
        guess = int(np.where(group.mask[rows], bounds, np.inf).argmin())
        if bounds[guess] < best.distance_m:
            self._measure(int(rows[guess]), best)
        # After a far jump there is much to bound and nothing to be saved by bounding it well.
        margin_m = REFINE_M if len(chosen) <= MANY_BLOCKS else 0.0
        limit_m = max(best.distance_m, 0.0) + margin_m
        near = np.flatnonzero(bounds < limit_m)
        for spheres, boxes in ((i, j), (j, i)):
            better = self._box_bounds(centre, spheres[near], boxes[near])
            bounds[near] = better = np.maximum(bounds[near], better)
            near = near[better < limit_m]
        travelled = self._travelled_m[chosen]
        kept = np.where(bounds > 0.0, bounds + np.repeat(travelled, counts), -np.inf)
        self._kept_m[chosen] = np.minimum.reduceat(kept, starts)
        self._bounds_m[chosen] = self._kept_m[chosen] - travelled
        of_block = np.repeat(np.arange(len(chosen)), counts)
        is_near = (bounds < limit_m) | (counts <= FEW_PAIRS)[of_block]
        others = np.minimum.reduceat(np.where(is_near, np.inf, kept), starts).tolist()
        near = np.flatnonzero(is_near)
        near = near[np.lexsort((kept[near], of_block[near]))]
        near_m, near_rows = kept[near].tolist(), rows[near].tolist()
        cuts = np.searchsorted(of_block[near], np.arange(len(chosen) + 1)).tolist()
        for k, block in enumerate(chosen.tolist()):
            part = slice(cuts[k], cuts[k + 1])
            self._near[block] = near_m[part], near_rows[part]
            self._others_m[block] = others[k]

    def _not_apart(self, blocks: NDArray[np.int64], limit_m: float) -> NDArray[np.int64]:
        """Those of some blocks that spheres around the two bodies do not show to be beyond a limit."""
        pairs = self._pairs
        # First and last corner are opposite ones.
        centre = 0.5 * (self._corners[:, :, 0] + self._corners[:, :, -1])
        body_i, body_j = pairs.body_i[blocks], pairs.body_j[blocks]
        offset = centre[body_i] - centre[body_j]
        gap = np.sqrt(np.einsum("nx,nx->n", offset, offset)) - BOUND_SLACK_M
        gap -= self._body_radius_m[body_i] + self._body_radius_m[body_j]
        kept = np.where(gap > 0.0, gap + self._travelled_m[blocks], -np.inf)
        self._kept_m[blocks] = np.maximum(self._kept_m[blocks], kept)
        self._bounds_m[blocks] = self._kept_m[blocks] - self._travelled_m[blocks]
        return blocks[self._bounds_m[blocks] < limit_m]

    def _forget(self) -> None:
        """Drops every kept bound: afterwards none says more than that anything may be anywhere."""
        self._travel_m[:] = 0.0
        self._kept_m[:] = -np.inf
        self._near = [([], [])] * len(self._near)
        self._others_m = [-math.inf] * len(self._others_m)

    def _group(self, mask: NDArray[np.bool_]) -> _Group:
        if (mask & ~self._watched).any():
            raise ValueError("the mask has pairs that are not watched")
        pairs = self._pairs
        rows = mask[pairs.i, pairs.j]
        blocks = np.flatnonzero(np.logical_or.reduceat(rows, pairs.first)) if len(rows) else None
        every = blocks is None or len(blocks) == len(pairs.first)
        counts = rows.tolist()
        last = self._recent if self._recent >= 0 and counts[self._recent] else -1
        return _Group(rows, counts, None if every else blocks, last)

    def _centres(self) -> NDArray[np.float64]:
        """(pieces, 3) centres of the pieces' spheres and boxes, made once a configuration, m."""
        centre = self._centre
        if centre is None:
            rotation = self._geom_rotation[self._geoms]
            centre = self._geom_position[self._geoms]
            centre += np.einsum("nxy,ny->nx", rotation, self._centre_local)
            self._centre = centre
        return centre

    def _sphere_bounds(
        self, centre: NDArray[np.float64], i: NDArray[np.int64], j: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Distances (pairs,) between the centres of pieces; from planes to the centres, m."""
        offset = centre.take(i, axis=0)
        offset -= centre.take(j, axis=0)
        distance = np.sqrt(np.einsum("nx,nx->n", offset, offset))
        if self._any_plane:
            flat = np.flatnonzero(self._planes[i] | self._planes[j])
            first = self._planes[i[flat]]
            normal = self._geom_rotation[self._geoms[np.where(first, i[flat], j[flat])], :, 2]
            height = np.einsum("nx,nx->n", offset[flat], normal)
            distance[flat] = np.where(first, -height, height)
        return distance

    def _box_bounds(
        self, centre: NDArray[np.float64], spheres: NDArray[np.int64], boxes: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Lower bounds (pairs,) from the sphere of one piece and the oriented box of the other, m."""
        offset = centre.take(spheres, axis=0)
        offset -= centre.take(boxes, axis=0)
        rotation = self._geom_rotation.take(self._geoms.take(boxes), axis=0)
        local = np.einsum("nx,nxy->ny", offset, rotation)
        outside = np.maximum(np.abs(local) - self._half_m.take(boxes, axis=0), 0.0)
        gap = np.sqrt(np.einsum("nx,nx->n", outside, outside))
        # Inside the box the gap says nothing about depth; a plane has no box.
        known = gap > 0.0
        if self._any_plane:
            known &= ~(self._planes[spheres] | self._planes[boxes])
        return np.where(known, gap - self._radius_m[spheres] - BOUND_SLACK_M, -np.inf)

    def _boxes_around(self, bodies: NDArray[np.int64]) -> NDArray[np.float64]:
        """(bodies, 3, 8) corners of a box around the pieces of each body, in the body's frame, m.

        A plane has no corners and needs none: MuJoCo has planes on bodies that stand still only.
        """
        signs = np.array(list(product((-1.0, 1.0), repeat=3)))
        corners = np.zeros((self._model.nbody, 3, 8))
        for body in np.unique(bodies[~self._planes]).tolist():
            points = []
            for piece in np.flatnonzero((bodies == body) & ~self._planes).tolist():
                geom, rotation = int(self._geoms[piece]), np.empty(9)
                mujoco.mju_quat2Mat(rotation, self._model.geom_quat[geom])
                box = self._centre_local[piece] + signs * self._half_m[piece]
                points.append(self._model.geom_pos[geom] + box @ rotation.reshape(3, 3).T)
            low, high = np.min(points, axis=(0, 1)), np.max(points, axis=(0, 1))
            corners[body] = np.where(signs > 0.0, high, low).T
        return corners


@dataclass(frozen=True)
class _Pairs:
    """All watched pairs, one row each, block by block: a block is what two bodies have."""

    i: NDArray[np.int64]
    """(rows,) smaller piece index."""
    j: NDArray[np.int64]
    """(rows,) larger piece index."""
    rows: list[range]
    """(blocks,) the rows of each."""
    first: NDArray[np.int64]
    """(blocks,) first row."""
    count: NDArray[np.int64]
    """(blocks,) how many rows."""
    body_i: NDArray[np.int64]
    """(blocks,) body of the pieces i."""
    body_j: NDArray[np.int64]
    """(blocks,) body of the pieces j."""

    @classmethod
    def of(cls, watched: NDArray[np.bool_], bodies: NDArray[np.int64]) -> _Pairs:
        i, j = np.nonzero(np.triu(watched, 1))
        order = np.lexsort((bodies[j], bodies[i]))
        i, j = i[order], j[order]
        names = np.stack([bodies[i], bodies[j]], axis=1)
        blocks, first, count = np.unique(names, axis=0, return_index=True, return_counts=True)
        return cls(
            i=i,
            j=j,
            rows=[range(k, k + n) for k, n in zip(first.tolist(), count.tolist(), strict=True)],
            first=first,
            count=count,
            body_i=blocks[:, 0].copy(),
            body_j=blocks[:, 1].copy(),
        )


@dataclass
class _Group:
    """The pairs of one mask, and what the search remembers of them."""

    mask: NDArray[np.bool_]
    """(rows,) which pairs count."""
    counts: list[bool]
    """The same for reading one by one."""
    blocks: NDArray[np.int64] | None
    """Blocks that have a pair that counts; None: all."""
    last: int
    """Row of the nearest pair of the last search; -1: none."""
    waste: int = 0
    """Measurements since the bounds were last made anew beyond what was needed then."""
    usual: int = 0
    """How many were needed then."""


@dataclass(slots=True)
class _Best:
    """The nearest pair so far of one search."""

    distance_m: float
    """Its distance, at first the ceiling."""
    row: int = -1
    """Its row; -1: none."""
    measured: int = 0
    """Measurements made."""


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
