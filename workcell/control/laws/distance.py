"""Distance, direction, witness points and G of a pair (docs/theory.md sections 1 and 2).

In: the surface points that MuJoCo's `fromto` sensors give, and the frames of the geoms. Out: for each pair
the signed distance d, the unit vector n from j to i, the witness points, and its row of G = dd/dq,
the paper's first-order influence coefficients (3) to (5).
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.vectors import cross, dot, length, minus, over, plus, put, row, times

FINE, BEYOND_CUTOFF, NOT_FINITE = 0, 1, 2
"""What `measure` answers: every pair was measured; a sensor reads nothing but zero; a number is not finite."""

CROSSING_TOLERANCE_M = 1e-9
"""Axis distance below which two axes count as crossing.

Witness points are good to about 1e-16 m, so at 1e-9 m their direction has seven digits left.
"""
COINCIDENT_TOLERANCE_M = 1e-9
"""Distance below which the witness points of two geoms without a radius give no direction."""
SURFACE_TOLERANCE_M = 1e-6
"""How far the surface point of a round geom may be off its surface.

Measured against boxes, cylinders, ellipsoids and meshes, 6000 poses each: at most 2e-8 m while
the axis is outside. Beyond the tolerance the axis is inside the other geom.
"""
CROSSING_PARALLEL_SINE = 1e-6
"""Sine of the angle below which crossing axes have no common perpendicular worth its digits."""


@law
def measure(
    sensordata, geom_xpos, geom_xmat, cdof, subtree_com, sensor_adr, geom, radius, half_length,
    sign, dof_root, screws, distance, normal, witness_i, witness_j, surface_i, surface_j, jacobian,
    degenerate,
):  # fmt: skip
    """Distance, direction, witness points and Jacobian of every pair.

    Two round geoms (sphere, capsule): n and d come from the axis points, so they hold through
    contact, and from the surface points where these are deep in each other, so they hold
    until the axes cross. There n is set perpendicular to both axes (`degenerate`).
    One round geom: n runs from its surface point to its axis point, so it holds at contact;
    once the axis itself enters the other geom, n is approximate and d at most -radius
    (`degenerate`, where MuJoCo's answer shows it).
    None: n is the line between the surface points; where these coincide it is the line of
    the geom centres (`degenerate`).

    Args:
        sensordata, geom_xpos, geom_xmat, cdof, subtree_com: MuJoCo's arrays of these names.
        sensor_adr: (P,) where each pair's six sensor readings begin.
        geom: (P, 2) the geoms i and j.
        radius: (P, 2) in m, 0 for a geom that is not round.
        half_length: (P, 2) of the axes in m, 0 for a sphere.
        sign: (P, nv) +1 where a joint moves i alone, -1 where it moves j alone, else 0.
        dof_root: (nv,) root body of each joint's tree.
        screws: (6, nv) for use inside.
        distance, normal, witness_i, witness_j, surface_i, surface_j, jacobian, degenerate: (P,), (P, 3)
            and (P, nv), written; see `proximity.Proximity`.

    Returns:
        `FINE`, `BEYOND_CUTOFF` or `NOT_FINITE`, and the first pair it is about.
    """
    joint_screws(cdof, subtree_com, dof_root, screws)
    for pair in range(len(distance)):
        at = sensor_adr[pair]
        on_i = (sensordata[at], sensordata[at + 1], sensordata[at + 2])
        on_j = (sensordata[at + 3], sensordata[at + 4], sensordata[at + 5])
        seen = False
        for entry in range(6):
            seen = seen or sensordata[at + entry] != 0.0
        if not seen:
            return BEYOND_CUTOFF, pair
        put(surface_i, pair, on_i)
        put(surface_j, pair, on_j)
        centre_i, centre_j = row(geom_xpos, geom[pair, 0]), row(geom_xpos, geom[pair, 1])
        half_i = half_axis(geom_xmat, geom[pair, 0], half_length[pair, 0])
        half_j = half_axis(geom_xmat, geom[pair, 1], half_length[pair, 1])
        radius_i, radius_j = radius[pair, 0], radius[pair, 1]
        at_i, at_j = on_i, on_j
        if radius_i > 0.0:
            at_i = _nearest_on_axis(on_i, centre_i, half_i, half_length[pair, 0])
        if radius_j > 0.0:
            at_j = _nearest_on_axis(on_j, centre_j, half_j, half_length[pair, 1])
        if radius_i > 0.0 and radius_j > 0.0:
            away, along, at_i, at_j, chosen = _both_round(
                on_i, on_j, at_i, at_j, half_i, half_j, radius_i, radius_j
            )
        elif radius_i > 0.0:
            away, along, chosen = _one_round(minus(at_i, on_i), minus(on_i, on_j), radius_i)
        elif radius_j > 0.0:
            outwards = times(-1.0, minus(at_j, on_j))
            away, along, chosen = _one_round(outwards, minus(on_i, on_j), radius_j)
        else:
            away, along, chosen = _none_round(minus(on_i, on_j), minus(centre_i, centre_j))
        along_m = length(along)
        if along_m == 0.0:
            along, along_m, chosen = (1.0, 0.0, 0.0), 1.0, True
        if not math.isfinite(away + dot(on_i, on_i) + dot(on_j, on_j)):
            return NOT_FINITE, pair
        n = over(along, along_m)
        distance[pair], degenerate[pair] = away, chosen
        put(normal, pair, n)
        put(witness_i, pair, at_i)
        put(witness_j, pair, at_j)
        row_of_g(n, at_i, screws, sign, pair, jacobian)
    return FINE, -1


@part
def joint_screws(cdof, subtree_com, dof_root, screws):
    """The screws (6, nv) of all joints, referred to the world's origin: omega, then nu + c x omega."""
    for joint in range(len(dof_root)):
        omega = row(cdof, joint)
        moment = cross(row(subtree_com, dof_root[joint]), omega)
        for axis in range(3):
            screws[axis, joint] = omega[axis]
            screws[3 + axis, joint] = cdof[joint, 3 + axis] + moment[axis]


@part
def row_of_g(n, witness, screws, sign, pair, jacobian):
    """G[pair, k] = sign ( n (nu_k + c x omega_k) + (w x n) omega_k ).

    Both witness points lie on the line along n, so one line serves the joints of i and of j.
    """
    torque = cross(witness, n)
    for joint in range(screws.shape[1]):
        jacobian[pair, joint] = sign[pair, joint] * (
            torque[0] * screws[0, joint]
            + torque[1] * screws[1, joint]
            + torque[2] * screws[2, joint]
            + n[0] * screws[3, joint]
            + n[1] * screws[4, joint]
            + n[2] * screws[5, joint]
        )


@part
def half_axis(geom_xmat, geom, half_length):
    """From a geom's centre to an end of its axis, in the world, m."""
    return (
        geom_xmat[geom, 2] * half_length,
        geom_xmat[geom, 5] * half_length,
        geom_xmat[geom, 8] * half_length,
    )


@part
def _nearest_on_axis(point, centre, half, half_length):
    """The point of an axis (centre +- half) nearest to a point; the centre of a sphere."""
    along = 0.0
    if half_length > 0.0:
        along = dot(minus(point, centre), half) * (1.0 / (half_length * half_length))
        along = min(1.0, max(-1.0, along))
    return plus(centre, times(along, half))


@part
def _both_round(on_i, on_j, at_i, at_j, half_i, half_j, radius_i, radius_j):
    """Distance, direction and axis points of two round geoms; whether the direction is a choice.

    Deep in each other the axis points are too near each other to give a direction as well as the surface
    points, which are then far apart. Where the axes meet, MuJoCo's direction may not be perpendicular
    to them and is not used. Pairs that are separate by such a gap have axes farther apart than both radii.
    """
    radii = radius_i + radius_j
    along = minus(at_i, at_j)
    away = length(along) - radii
    gap = minus(on_i, on_j)
    gap_m = length(gap)
    chosen = False
    if away < CROSSING_TOLERANCE_M and 2.0 * gap_m > radii:
        inwards = times(-1.0, over(gap, gap_m))
        along, away = inwards, -gap_m
        at_i = plus(on_i, times(radius_i, inwards))
        at_j = minus(on_j, times(radius_j, inwards))
        if gap_m > radii - CROSSING_TOLERANCE_M:
            along, chosen = _perpendicular(half_i, half_j), True
    return away, along, at_i, at_j, chosen


@part
def _one_round(to_axis, gap, radius):
    """Distance and direction where one geom is round; `to_axis` runs from its surface to its axis, towards i.

    Once the axis itself is inside the other geom, MuJoCo's capsule against box may report any
    depth, and even 1 mm of clearance; but then its surface point is not on the surface. The
    depth is at least the radius there, and is said to be no less.
    """
    to_axis_m = length(to_axis)
    away = 0.0 if to_axis_m == 0.0 else dot(to_axis, gap) / to_axis_m
    chosen = False
    if math.isfinite(away) and abs(to_axis_m - radius) > SURFACE_TOLERANCE_M:
        away, chosen = min(away, -radius), True
    return away, to_axis, chosen


@part
def _none_round(gap, centres):
    """Distance and direction where no geom is round: the line of the surface points, or of the centres at contact.

    All of a convex geom lies on the far side of its witness point, so the centres tell
    whether that line leads out (separate) or in (penetrating).
    """
    gap_m = length(gap)
    side = -1.0 if dot(gap, minus(centres, gap)) < 0.0 else 1.0
    if gap_m < COINCIDENT_TOLERANCE_M:
        return side * gap_m, centres, True
    return side * gap_m, times(side, gap), False


@part
def _perpendicular(u, v):
    """A vector perpendicular to u and v; to the longer one where they are parallel; else zero."""
    crossed = cross(u, v)
    if length(crossed) > CROSSING_PARALLEL_SINE * (length(u) * length(v)):
        return crossed
    longer = u if dot(u, u) >= dot(v, v) else v
    x, y, z = abs(longer[0]), abs(longer[1]), abs(longer[2])
    if x <= y and x <= z:
        return cross(longer, (1.0, 0.0, 0.0))
    if y <= z:
        return cross(longer, (0.0, 1.0, 0.0))
    return cross(longer, (0.0, 0.0, 1.0))
