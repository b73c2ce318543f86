"""Convex pieces of a link -> one to three small capsules that contain every corner of them.

A capsule is convex: with the corners of a convex piece it contains the piece. One capsule: over
directions of its axis, the smallest circle around the corners seen along the axis is its radius, and
its length is the least that keeps all corners inside. Two or three: the pieces are cut by planes
across the long axis, and each part gets its own capsule; the points of the cut belong to both parts,
so that together the capsules contain the whole.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

WORTH = 0.8
"""A further capsule is taken where it makes their volume smaller than this share; chosen since each costs pairs."""
HOPELESS = 1.25
"""Capsules this many times too large are not refined: that saves a tenth of their volume, seldom more."""
KEPT = 64
"""Links whose capsules are remembered; chosen larger than one robot has."""
MARGIN_M = 1e-5
"""Added to every radius, far above what rounding and single precision could take from it."""
_CUTS = {
    2: ((0.2,), (0.35,), (0.5,), (0.65,), (0.8,)),
    3: ((0.15, 0.85), (0.2, 0.5), (0.35, 0.65), (0.5, 0.8)),
}
"""Where a link is tried to be cut into so many parts, as shares of its length."""


@dataclass(frozen=True)
class Capsule:
    """A capsule: all points within the radius of a segment."""

    ends: NDArray[np.float64]
    """(2, 3) the ends of its axis, m."""
    radius_m: float

    @property
    def length_m(self) -> float:
        """Of its axis."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def volume_m3(self) -> float:
        """Of the solid."""
        return np.pi * self.radius_m**2 * (self.length_m + 4 / 3 * self.radius_m)

    def beyond(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) how far points are outside, negative inside, m."""
        axis = self.ends[1] - self.ends[0]
        share = np.clip((points - self.ends[0]) @ axis / max(axis @ axis, 1e-18), 0, 1)
        nearest = self.ends[0] + share[:, None] * axis
        return np.linalg.norm(points - nearest, axis=1) - self.radius_m


def fit(pieces: Sequence[NDArray[np.float64]], most: int = 3) -> list[Capsule]:
    """The fewest capsules that are worth it, at most three.

    Args:
        pieces: (n, 3) corners of each convex piece, all in one frame.
        most: How many capsules are allowed.
    """
    # Parts of one robot, and an arm that is adapted again, have links in common.
    return list(_fit(tuple(piece.astype(float).tobytes() for piece in pieces), most))


@lru_cache(maxsize=KEPT)
def _fit(contents: tuple[bytes, ...], most: int) -> tuple[Capsule, ...]:
    pieces = [np.frombuffer(content).reshape(-1, 3) for content in contents]
    best = [fit_one(np.concatenate(pieces))]
    axis = best[0].ends[1] - best[0].ends[0]
    if np.linalg.norm(axis) < 1e-6:
        axis = np.linalg.svd(np.concatenate(pieces) - np.concatenate(pieces).mean(axis=0))[2][0]
    axis = axis / np.linalg.norm(axis)
    for count in range(2, most + 1):
        found = _cut_and_fit(pieces, axis, count, HOPELESS * WORTH * _volume(best))
        if found and _volume(found) < WORTH * _volume(best):
            best = found
    return tuple(best)


def _volume(capsules: Sequence[Capsule]) -> float:
    return sum(capsule.volume_m3 for capsule in capsules)


def _cut_and_fit(
    pieces: Sequence[NDArray[np.float64]],
    axis: NDArray[np.float64],
    count: int,
    most_m3: float,
) -> list[Capsule]:
    """The best of the tried cuts into so many parts; empty if a part has no corners, or all are too large before they
    are refined."""
    along = np.concatenate(pieces) @ axis
    low, high = along.min(), along.max()
    best: list[Capsule] = []
    for shares in _CUTS[count]:
        edges = (low, *(low + share * (high - low) for share in shares), high)
        parts = [
            [part for piece in pieces if len(part := _between(piece, axis, a, b))]
            for a, b in itertools.pairwise(edges)
        ]
        if not all(parts):
            continue
        found = [fit_one(np.concatenate(part), refine=False) for part in parts]
        if not best or _volume(found) < _volume(best):
            best, kept = found, parts
    if not best or _volume(best) > most_m3:
        return []
    return [fit_one(np.concatenate(part)) for part in kept]


def _between(
    corners: NDArray[np.float64], axis: NDArray[np.float64], low: float, high: float
) -> NDArray[np.float64]:
    """(n, 3) corners of what two planes across an axis leave of a convex piece."""
    for level, side in ((low, 1.0), (high, -1.0)):
        height = side * (corners @ axis - level)
        inside = height >= -1e-9
        if inside.all():
            continue
        if not inside.any():
            return np.zeros((0, 3))
        # The plane cuts the piece in a polygon, whose corners are where it meets edges of the hull.
        edges = _edges(corners)
        edges = edges[inside[edges[:, 0]] != inside[edges[:, 1]]]
        first, second = edges.T
        share = (height[first] / (height[first] - height[second]))[:, None]
        met = corners[first] + share * (corners[second] - corners[first])
        corners = np.concatenate([corners[inside], met])
    return corners


def _edges(corners: NDArray[np.float64]) -> NDArray[np.intp]:
    """(n, 2) edges of the hull of corners; all pairs of corners where it is flat."""
    try:
        faces = ConvexHull(corners).simplices
    except QhullError:
        return np.stack(np.triu_indices(len(corners), 1), axis=1)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0).astype(np.intp)


def _corners(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Only those points that are corners of their hull; all of them where it is flat."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def fit_one(points: NDArray[np.float64], *, refine: bool = True) -> Capsule:
    """A small capsule that contains all points.

    Args:
        points: (n, 3) in m.
        refine: Whether the direction of its axis is optimised beyond the principal ones.
    """
    points = _corners(points)
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    trials = [*principal, *np.eye(3)]
    best = min((_along(points, direction) for direction in trials), key=lambda c: c.volume_m3)
    if refine:
        axis = best.ends[1] - best.ends[0]
        start = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 1e-9 else principal[0]
        sides = np.linalg.svd(start[None])[2][1:]

        def turned(angles: NDArray[np.float64]) -> Capsule:
            return _along(points, start + angles @ sides)

        found = minimize(
            lambda angles: turned(angles).volume_m3,
            np.zeros(2),
            method="Nelder-Mead",
            options={"maxiter": 30, "initial_simplex": [[0, 0], [0.2, 0], [0, 0.2]]},
        )
        trials = [best.ends[1] - best.ends[0], start + found.x @ sides]
        settled = [_along(points, axis, 100) for axis in trials if np.linalg.norm(axis) > 1e-9]
        best = min(best, *settled, key=lambda c: c.volume_m3)
    return best


def _along(points: NDArray[np.float64], direction: NDArray[np.float64], steps: int = 12) -> Capsule:
    """The capsule of least radius with its axis in a direction, as short as it can be."""
    direction = direction / np.linalg.norm(direction)
    sides = np.linalg.svd(direction[None])[2][1:]
    flat = points @ sides.T
    centre = _centre(flat, steps)
    away = np.linalg.norm(flat - centre, axis=1)
    best = None
    for factor in (1.0, 1.05, 1.15):
        radius = away.max() * factor + MARGIN_M
        height = points @ direction
        cap = np.sqrt(np.maximum((radius - MARGIN_M / 2) ** 2 - away**2, 0))
        low, high = (height + cap).min(), (height - cap).max()
        if low > high:
            low = high = (low + high) / 2
        ends = centre @ sides + np.array([[low], [high]]) * direction
        capsule = Capsule(ends, float(radius))
        if best is None or capsule.volume_m3 < best.volume_m3:
            best = capsule
    assert best is not None
    # Whatever rounding did, it contains them.
    spare = float(best.beyond(points).max())
    return Capsule(best.ends, best.radius_m + max(0.0, spare + MARGIN_M / 2))


def _centre(flat: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
    """(2,) centre of the smallest circle around points, near enough (Badoiu and Clarkson's steps)."""
    centre = (flat.min(axis=0) + flat.max(axis=0)) / 2
    for k in range(1, steps + 1):
        away = flat - centre
        farthest = np.argmax(np.einsum("ij,ij->i", away, away))
        centre = centre + away[farthest] / (k + 1)
    return centre
