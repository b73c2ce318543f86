"""Second time derivative of a pair's distance (docs/theory.md section 3, paper equation 6).

d'' = n (a_i - a_j) + n (omega_i x u s' - omega_j x v t') + n' (v_i - v_j), in which s' and t' say how fast the
witness points slide along their half axes u and v. Dropping them is wrong by as much as the value itself.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.distance import CROSSING_TOLERANCE_M, half_axis
from workcell.control.laws.vectors import (
    cross,
    dot,
    into_frame,
    length,
    minus,
    plus,
    row,
    second_half,
    times,
)

PARALLEL_SIN_SQUARED = 1e-8
"""Squared sine of the angle between axes that count as parallel.

The sliding speed of the witness points grows with one over this number; below it (0.006 degrees)
eight of the sixteen digits are lost and the speed tells nothing about the bodies.
"""
CLAMPED_TOLERANCE = 1e-9
"""Distance from an axis end, relative to the half axis, at which a witness point sits on it."""
FACE_MARGIN_M = 1e-6
"""Distance from a box edge below which a witness point counts as on the edge.

MuJoCo's iterative distance solver stops at this accuracy by default (`ccd_tolerance`).
"""


@law
def second_derivative(
    geom_xpos, geom_xmat, cdof, cdof_dot, subtree_com, qvel, qacc, body_parent, body_root, dof_body,
    geom, body, radius, half_length, face, witness_i, witness_j, normal, degenerate, twist, change,
    accel, exact, parallel,
):  # fmt: skip
    """d'' of every pair, with what was measured by `distance.measure` in the same state.

    Args:
        geom_xpos, geom_xmat, cdof, cdof_dot, subtree_com, qvel: MuJoCo's arrays of these names.
        qacc: (nv,) joint accelerations.
        body_parent, body_root: (nbody,) parent of each body and root of its tree.
        dof_body: (nv,) body of each joint, in rising order.
        geom, body, radius, half_length: (P, 2) of i and j, as in `distance.measure`.
        face: (P, 2, 3) half sizes of flat faces: a box's, infinite for a plane, else 0.
        witness_i, witness_j, normal, degenerate: (P, 3) and (P,), measured.
        twist, change: (nbody, 6) for use inside.
        accel: (P,) d'' in m/s^2, written.
        exact, parallel: (P,), written; see `second_order.SecondOrder`.

    Returns:
        The first pair whose d'' is not finite; -1 if there is none.
    """
    _body_motion(cdof, cdof_dot, qvel, qacc, body_parent, dof_body, twist, change)
    for pair in range(len(accel)):
        n, at_i, at_j = row(normal, pair), row(witness_i, pair), row(witness_j, pair)
        omega_i, velocity_i, acceleration_i = _point_motion(
            twist, change, subtree_com, body_root, body[pair, 0], at_i
        )
        omega_j, velocity_j, acceleration_j = _point_motion(
            twist, change, subtree_com, body_root, body[pair, 1], at_j
        )
        centre_i, centre_j = row(geom_xpos, geom[pair, 0]), row(geom_xpos, geom[pair, 1])
        u = half_axis(geom_xmat, geom[pair, 0], half_length[pair, 0])
        v = half_axis(geom_xmat, geom[pair, 1], half_length[pair, 1])
        free_i = _may_slide(minus(at_i, centre_i), u)
        free_j = _may_slide(minus(at_j, centre_j), v)
        between = minus(at_i, at_j)
        relative = minus(velocity_i, velocity_j)
        direct = dot(n, minus(acceleration_i, acceleration_j))
        round_i, round_j = radius[pair, 0] > 0.0, radius[pair, 1] > 0.0
        alike = False
        if round_i and round_j:
            value, sure, alike = _both_round(
                n, u, v, omega_i, omega_j, between, relative, direct, free_i, free_j
            )
        else:
            # The flat geom is the half space behind its witness point, turning with it.
            turned = cross(omega_i if round_j else omega_j, n)
            value = direct + 2.0 * dot(turned, relative) - dot(n, between) * dot(turned, turned)
            if round_j:
                sure = not free_j and _on_face(
                    geom_xmat, geom[pair, 0], centre_i, face, pair, 0, at_i
                )
            else:
                sure = (
                    round_i
                    and not free_i
                    and _on_face(geom_xmat, geom[pair, 1], centre_j, face, pair, 1, at_j)
                )
        if not math.isfinite(value):
            return pair
        accel[pair], parallel[pair] = value, alike
        exact[pair] = sure and not degenerate[pair]
    return -1


@part
def _body_motion(cdof, cdof_dot, qvel, qacc, body_parent, dof_body, twist, change):
    """Twist and its change (nbody, 6) of every body, from the root outwards."""
    joint = 0
    for link in range(len(body_parent)):
        for axis in range(6):
            twist[link, axis] = twist[body_parent[link], axis] if link else 0.0
            change[link, axis] = change[body_parent[link], axis] if link else 0.0
        while joint < len(dof_body) and dof_body[joint] == link:
            for axis in range(6):
                twist[link, axis] += cdof[joint, axis] * qvel[joint]
                change[link, axis] += (
                    cdof_dot[joint, axis] * qvel[joint] + cdof[joint, axis] * qacc[joint]
                )
            joint += 1


@part
def _point_motion(twist, change, subtree_com, body_root, body, point):
    """Angular velocity of a body, velocity and acceleration of its material point at a place.

    A spatial acceleration lacks the centripetal part of a material point's acceleration.
    """
    omega = row(twist, body)
    arm = minus(point, row(subtree_com, body_root[body]))
    velocity = plus(second_half(twist, body), cross(omega, arm))
    acceleration = plus(
        plus(second_half(change, body), cross(row(change, body), arm)), cross(omega, velocity)
    )
    return omega, velocity, acceleration


@part
def _both_round(n, u, v, omega_i, omega_j, between, relative, direct, free_i, free_j):
    """d'' of two round geoms, whether it is exact, and whether the axes are parallel.

    The witness points slide so that they stay the nearest ones: u e = 0 and v e = 0 stay true for those that may
    slide, e being the line between the axes. [uu, -uv; uv, -vv] (s', t') = -(u e, v e) differentiated with s
    and t held. Crossing axes have no defined turning of n; the term is left out and the pair is not exact.
    """
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    turned_i, turned_j = cross(omega_i, u), cross(omega_j, v)
    drift_i = dot(turned_i, between) + dot(u, relative)
    drift_j = dot(turned_j, between) + dot(v, relative)
    determinant = uu * vv - uv * uv
    offset = dot(u, between)
    # Parallel axes that overlap have many nearest points, wherever MuJoCo put the witness points;
    # those beside each other's ends are at an angle to the line between, and have one.
    parallel = (
        uu > 0.0
        and vv > 0.0
        and determinant <= PARALLEL_SIN_SQUARED * uu * vv
        and offset * offset <= PARALLEL_SIN_SQUARED * uu * dot(between, between)
    )
    slide_i = slide_j = 0.0
    if free_i and free_j and not parallel:
        slide_i = (uv * drift_j - vv * drift_i) / determinant
        slide_j = (uu * drift_j - uv * drift_i) / determinant
    else:
        if free_i and not free_j:
            slide_i = -drift_i / uu
        if free_j:
            slide_j = drift_j / vv
    turning = minus(times(slide_i, turned_i), times(slide_j, turned_j))
    across = minus(plus(relative, times(slide_i, u)), times(slide_j, v))
    across = minus(across, times(dot(n, across), n))
    axis_m = length(between)
    apart = axis_m > CROSSING_TOLERANCE_M
    swing = dot(across, relative) / axis_m if apart else 0.0
    return direct + dot(n, turning) + swing, apart and not parallel, parallel


@part
def _may_slide(offset, half):
    """Whether a witness point lies inside its axis: at an end, or in a sphere, it cannot slide."""
    return abs(dot(offset, half)) < (1.0 - CLAMPED_TOLERANCE) * dot(half, half)


@part
def _on_face(geom_xmat, geom, centre, face, pair, end, point):
    """Whether a surface point lies on a flat face, away from its edges."""
    local = into_frame(geom_xmat, geom, minus(point, centre))
    inside = 0
    for axis in range(3):
        inside += abs(local[axis]) < face[pair, end, axis] - FACE_MARGIN_M
    return inside >= 2
