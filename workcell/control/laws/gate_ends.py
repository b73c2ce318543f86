"""Rate rows of the ends of near-parallel capsules, to which their nearest points may jump (docs/theory.md section 9).

    jump_rows    a row for each end of either capsule of a pair, and how much farther away than the nearest points it is
    jump_needs   what the arm's own motion may close there
    ends_keep    both for one command

Symbols: n joints, P pairs, K rows.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.gate_points import point_row
from workcell.control.laws.pair_rule import allowance, counted_distance

PARALLEL = 0.3
"""Sine of the angle between two axes below which they are near-parallel: chosen so that an end of a link 0.3 m long is farther
away beyond it than the joints of any arm here need to brake for, 0.09 m."""
BRAKING_SHARE = 0.5
"""Of the deceleration at an end that all joints together could give; the other half is the path's, and what G's own turning asks."""
TOUCHING_M = 1e-9
UNBOUNDED_M_S = -1e9
"""A rate that no command falls short of."""


@part
def along(x, y, z, a, b, c, half):
    """Where on an axis (a, b, c) the point nearest to (x, y, z) is, both from the axis' middle, within its half length."""
    return min(half, max(-half, x * a + y * b + z * c))


@law
def jump_rows(
    screws, centre, geom_position, geom_rotation, near, geom, against, half, radii, order, sign,
    farthest, rows, farther, pair,
):  # fmt: skip
    """Rows of the ends of near-parallel capsules.

    Args:
        screws, centre, geom_position, geom_rotation, geom, order, sign: As in `gate_points.end_rows`.
        near: (P,) d.
        against: (P,) the other geom.
        half: (P, 2) half lengths of the own and the other capsule's axes; negative where there is none.
        radii: (P,) sum of their radii.
        farthest: Pairs beyond this distance are left out, m.
        rows: (4 P, n) out: A, the rate each joint gives the distance of an end.
        farther: (4 P,) out: g, its distance less that of the pair.
        pair: (4 P,) out: whose it is, of the P.

    Returns:
        K, how many rows there are.
    """
    count = 0
    for p in range(len(near)):
        if half[p, 0] < 0.0 or half[p, 1] < 0.0 or near[p] > farthest or near[p] <= 0.0:
            continue
        g, o, R = geom[p], against[p], geom_rotation
        ax, ay, az = R[g, 2], R[g, 5], R[g, 8]
        bx, by, bz = R[o, 2], R[o, 5], R[o, 8]
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        if cx * cx + cy * cy + cz * cz > PARALLEL * PARALLEL:
            continue
        dx = geom_position[g, 0] - geom_position[o, 0]
        dy = geom_position[g, 1] - geom_position[o, 1]
        dz = geom_position[g, 2] - geom_position[o, 2]
        for end in range(4):
            if end < 2:  # an end of the own axis, s from its middle
                s = half[p, 0] if end == 0 else -half[p, 0]
                t = along(dx + s * ax, dy + s * ay, dz + s * az, bx, by, bz, half[p, 1])
            else:  # an end of the other's
                t = half[p, 1] if end == 2 else -half[p, 1]
                s = along(t * bx - dx, t * by - dy, t * bz - dz, ax, ay, az, half[p, 0])
            nx, ny, nz = dx + s * ax - t * bx, dy + s * ay - t * by, dz + s * az - t * bz
            apart = math.sqrt(nx * nx + ny * ny + nz * nz)
            if apart <= TOUCHING_M:
                continue
            nx, ny, nz = nx / apart, ny / apart, nz / apart
            x = geom_position[g, 0] + s * ax
            y = geom_position[g, 1] + s * ay
            z = geom_position[g, 2] + s * az
            rows[count, :] = 0.0
            for i in range(order.shape[1]):
                k = order[p, i]
                if k < 0:
                    break
                vx, vy, vz = point_row(screws, centre, k, sign[p, k], x, y, z)
                rows[count, k] = nx * vx + ny * vy + nz * vz
            farther[count] = max(0.0, apart - radii[p] - near[p])
            pair[count] = p
            count += 1
    return count


@law
def jump_needs(
    rows, farther, pair, near, meeting, deceleration, t_min, d_min, standoff, needed
):  # fmt: skip
    """The smallest own rate at each end.

    The nearest points may be at one end now and at the other in the next tick, and the rate jumps with them. There it
    has to be -gap/t_min, whatever another arm does; g farther away it may be faster by what joints can brake on
    that way: A x >= -√((gap/t_min)² + 2 a g), with a = `BRAKING_SHARE` Σ |A_k| a_k. What is to meet is led together along its
    path, where a tool slides past what it takes: there the rule holds at the nearest points alone.

    Args:
        rows, farther, pair: (K, n), (K,), (K,) of `jump_rows`.
        near: (P,) d.
        meeting: (P,) pairs that are to meet.
        deceleration: (n,) of the joints.
        t_min, d_min, standoff: The rule's.
        needed: (K,) out.
    """
    for e in range(len(farther)):
        p = pair[e]
        if meeting[p]:
            needed[e] = UNBOUNDED_M_S
            continue
        counted, _ = counted_distance(near[p], False, d_min, standoff)
        allowed = max(0.0, allowance(counted, 0.0, t_min, standoff))
        brakes = 0.0
        for k in range(rows.shape[1]):
            brakes += abs(rows[e, k]) * deceleration[k]
        needed[e] = -math.sqrt(allowed * allowed + 2.0 * BRAKING_SHARE * brakes * farther[e])


@law
def ends_keep(
    command, screws, centre, geom_position, geom_rotation, near, geom, against, half, radii, order,
    sign, farthest, rows, farther, pair, meeting, deceleration, t_min, d_min, standoff, slack, needed,
):  # fmt: skip
    """How many ends there are, and whether a command (n,) closes none of them faster than it may, but for `slack` in m/s.

    The other arguments are those of `jump_rows` and `jump_needs`; `needed` is (4 P,).
    """
    count = jump_rows(
        screws, centre, geom_position, geom_rotation, near, geom, against, half, radii, order, sign,
        farthest, rows, farther, pair,
    )  # fmt: skip
    jump_needs(
        rows, farther[:count], pair, near, meeting, deceleration, t_min, d_min, standoff, needed
    )
    kept = True
    for e in range(count):
        rate = 0.0
        for k in range(len(command)):
            rate += rows[e, k] * command[k]
        kept = kept and rate >= needed[e] - slack  # what is not a number is not kept
    return count, kept
