"""How far each watched capsule reaches past the housing it stands for, and the least one that does.

In: the pieces of a link and a capsule. Out: margin = radius - max over the pieces of the distance
from the capsule's segment, which is >= 0 exactly when the capsule contains them. That distance is
a convex function, so over a convex piece it peaks at an extreme point: a corner of a box, a point
on an end circle of a cylinder. Circles are replaced by polygons around them, so a margin is never
overstated. `python capsule_fit.py` prints both for every capsule.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from pa10_dimensions import (
    CAPSULES,
    FRUSTUM_SIDES,
    HOUSING,
    LINKS,
    Box,
    Capsule,
    Frustum,
    Piece,
)
from scipy.optimize import minimize

# 96 corners put a polygon's corner 0.05 % outside its circle: below 0.1 mm on every piece.
_CIRCLE_SIDES = 96


def extreme_points(piece: Piece) -> np.ndarray:
    """Points, (n, 3) in mm, whose convex hull contains the piece (and for a frustum is it)."""
    if isinstance(piece, Box):
        return np.array(list(itertools.product(piece.x, piece.y, piece.z)), dtype=float)
    radii = piece.radii if isinstance(piece, Frustum) else (piece.radius, piece.radius)
    corners = FRUSTUM_SIDES if isinstance(piece, Frustum) else _CIRCLE_SIDES
    angle = 2 * math.pi * np.arange(corners) / corners
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / math.cos(math.pi / corners)
    rings = []
    for height, radius in zip(piece.span, radii, strict=True):
        across = np.array(piece.at) + radius * circle
        along = np.full(corners, height)
        if isinstance(piece, Frustum) or piece.along == "z":
            rings.append(np.column_stack([across, along]))
        else:
            rings.append(np.column_stack([across[:, 0], along, across[:, 1]]))
    return np.concatenate(rings)


def covered_points(body: str) -> np.ndarray:
    """Extreme points, (n, 3) in mm, of everything the capsule of `body` must contain.

    The flange turns about the axis of link6 and is itself round about it, so link6's capsule
    covers link7 as well, at any angle of W2.
    """
    points = [extreme_points(piece) for piece in HOUSING[body]]
    if body == "link6":
        flange_mm = 1e3 * next(link.offset_z_m for link in LINKS if link.name == "link7")
        points += [
            extreme_points(piece) + np.array([0, 0, flange_mm]) for piece in HOUSING["link7"]
        ]
    return np.concatenate(points)


def reach(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Largest distance, mm, of the points (n, 3) from the segment start-end (start != end)."""
    along = end - start
    share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(points - start - share[:, None] * along, axis=1).max())


def margin(capsule: Capsule) -> float:
    """Least distance, mm, between the capsule's surface and the housing inside (negative: out)."""
    points = covered_points(capsule.body)
    return capsule.radius - reach(points, np.array(capsule.start), np.array(capsule.end))


def least_capsule(capsule: Capsule) -> tuple[np.ndarray, np.ndarray, float]:
    """Segment ends and radius, mm, of a least-volume capsule around the same pieces.

    A local search from the given capsule; the result is a proposal to round, not a table entry.
    """
    points = covered_points(capsule.body)

    def volume(ends: np.ndarray) -> float:
        radius = reach(points, ends[:3], ends[3:])
        return math.pi * radius**2 * (4 / 3 * radius + float(np.linalg.norm(ends[3:] - ends[:3])))

    ends = np.array([*capsule.start, *capsule.end])
    for _ in range(4):  # Restarting a collapsed simplex is what makes Nelder-Mead reach the bottom.
        ends = minimize(volume, ends, method="Nelder-Mead", options={"maxiter": 4000}).x
    return ends[:3], ends[3:], reach(points, ends[:3], ends[3:])


def main() -> None:
    """Print each capsule's margin and the least capsule of its pieces."""
    for capsule in CAPSULES:
        start, end, radius = least_capsule(capsule)
        print(
            f"{capsule.name:15s} margin {margin(capsule):7.3f} mm; "
            f"least {start.round(2)} - {end.round(2)} r {radius:.2f}"
        )


if __name__ == "__main__":
    main()
