"""Material points of an arm's geoms: the rows and lever arms of each pair, and how fast points move (docs/theory.md section 9).

    end_rows       the points that span each pair's own geom: rate rows, lever arms, distances
    point_speeds   bound on the speed of any point of a link

Symbols: n joints, P pairs, E points (all pairs together). Points of pair p are `first[p]` to `first[p + 1]`.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part


@part
def point_row(cdof, centre, k, sign, x, y, z):
    """Velocity (3) that joint k at unit speed gives a material point, sign times; theory section 2.

    The joint's screw is (ω, ν) with respect to `centre`: v = ν + ω × (point - centre).
    """
    ox, oy, oz = cdof[k, 0], cdof[k, 1], cdof[k, 2]
    px, py, pz = x - centre[k, 0], y - centre[k, 1], z - centre[k, 2]
    return (
        sign * (cdof[k, 3] + oy * pz - oz * py),
        sign * (cdof[k, 4] + oz * px - ox * pz),
        sign * (cdof[k, 5] + ox * py - oy * px),
    )


@part
def world(geom_position, geom_rotation, g, local, e):
    """A point of a geom's frame in the world."""
    x, y, z, R = local[e, 0], local[e, 1], local[e, 2], geom_rotation
    return (
        geom_position[g, 0] + R[g, 0] * x + R[g, 1] * y + R[g, 2] * z,
        geom_position[g, 1] + R[g, 3] * x + R[g, 4] * y + R[g, 5] * z,
        geom_position[g, 2] + R[g, 6] * x + R[g, 7] * y + R[g, 8] * z,
    )


@law
def end_rows(
    cdof,
    centre,
    geom_position,
    geom_rotation,
    distance,
    normal,
    witness_i,
    witness_j,
    pairs,
    side,
    geom,
    exact,
    first,
    local,
    order,
    sign,
    near,
    own,
    rows,
    levers,
    low,
):
    """Rate rows, lever arms and distances of the points that span each pair's own geom.

    For a point e at P_e: A_ek = n · J_ek, R_ek = |J_ek|, and m_e = d + n · (P_e - w), its distance from
    the plane through the other geom's witness point; m_e = d where the points span a hull that
    contains the geom with room to spare. The witness point itself has the row G of theory section 2.

    Args:
        cdof: (n, 6) joint screws, angular part first.
        centre: (n, 3) the point each refers to.
        geom_position, geom_rotation: (G, 3), (G, 9) of all geoms.
        distance, normal, witness_i, witness_j: Of all watched pairs (i, j); n points from j to i.
        pairs: (P,) which of them.
        side: (P,) 1 where the own geom is i, -1 where it is j.
        geom: (P,) the own geom.
        exact: (P,) whether the points span just the geom (a round one's axis, a box).
        first: (P + 1,) where the points of each pair begin.
        local: (E, 3) the points in their geom's frame.
        order: (P, n) joints that move the own geom against the other, from its tip on; -1 after the last.
        sign: (P, n) 1 where a joint moves the own geom, -1 where the other, 0 else.
        near: (P,) out: d of these pairs.
        own: (P, n) out: G.
        rows: (E, n) out: A.
        levers: (E, n) out: R.
        low: (E,) out: m.
    """
    rows[:], levers[:], own[:] = 0.0, 0.0, 0.0
    for p in range(len(pairs)):
        w, g, towards = pairs[p], geom[p], side[p]
        nx, ny, nz = towards * normal[w, 0], towards * normal[w, 1], towards * normal[w, 2]
        witness = witness_i if towards > 0.0 else witness_j
        wx, wy, wz = witness[w, 0], witness[w, 1], witness[w, 2]
        near[p] = distance[w]
        for e in range(first[p], first[p + 1]):
            x, y, z = world(geom_position, geom_rotation, g, local, e)
            ahead = nx * (x - wx) + ny * (y - wy) + nz * (z - wz)
            low[e] = distance[w] + ahead if exact[p] else distance[w]
            for i in range(order.shape[1]):
                k = order[p, i]
                if k < 0:
                    break
                vx, vy, vz = point_row(cdof, centre, k, sign[p, k], x, y, z)
                rows[e, k] = nx * vx + ny * vy + nz * vz
                levers[e, k] = math.sqrt(vx * vx + vy * vy + vz * vz)
        for i in range(order.shape[1]):
            k = order[p, i]
            if k < 0:
                break
            vx, vy, vz = point_row(cdof, centre, k, sign[p, k], wx, wy, wz)
            own[p, k] = nx * vx + ny * vy + nz * vz


@part
def point_velocity(command, cdof, centre, moves, c, x, y, z):
    """Velocity (3) of a point of a link and angular velocity (3) of the link."""
    vx = vy = vz = wx = wy = wz = 0.0
    for k in range(len(command)):
        if moves[c, k]:
            ax, ay, az = point_row(cdof, centre, k, 1.0, x, y, z)
            u = command[k]
            vx, vy, vz = vx + u * ax, vy + u * ay, vz + u * az
            wx, wy, wz = wx + u * cdof[k, 0], wy + u * cdof[k, 1], wz + u * cdof[k, 2]
    return vx, vy, vz, wx, wy, wz


@law
def point_speeds(
    command, cdof, centre, geom_position, geom_rotation, geom, moves, radius, local, out
):
    """Largest speed of any point of each link: |v| at a corner of its core plus |ω| times the radius about it.

    Both are convex along the core, so its corners have the largest.

    Args:
        command: (n,).
        cdof, centre, geom_position, geom_rotation: As in `end_rows`.
        geom: (C,) of each corner.
        moves: (C, n) whether a joint moves it.
        radius: (C,) of the round hull about the core.
        local: (C, 3) in its geom's frame: a capsule's axis ends, a box's corners.
        out: (C,) out, m/s.
    """
    for c in range(len(radius)):
        x, y, z = world(geom_position, geom_rotation, geom[c], local, c)
        vx, vy, vz, wx, wy, wz = point_velocity(command, cdof, centre, moves, c, x, y, z)
        turning = math.sqrt(wx * wx + wy * wy + wz * wz)
        out[c] = math.sqrt(vx * vx + vy * vy + vz * vz) + turning * radius[c]


@law
def speed_gradient(
    c, command, cdof, centre, geom_position, geom_rotation, geom, moves, radius, local, gradient
):
    """Gradient (n,) of one of `point_speeds` in the command; zero where the link stands.

    Args:
        c: Which corner; the rest as in `point_speeds`.
        gradient: (n,) out.
    """
    gradient[:] = 0.0
    x, y, z = world(geom_position, geom_rotation, geom[c], local, c)
    vx, vy, vz, wx, wy, wz = point_velocity(command, cdof, centre, moves, c, x, y, z)
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    turning = math.sqrt(wx * wx + wy * wy + wz * wz)
    for k in range(len(command)):
        if not moves[c, k]:
            continue
        ax, ay, az = point_row(cdof, centre, k, 1.0, x, y, z)
        if speed > 0.0:
            gradient[k] += (vx * ax + vy * ay + vz * az) / speed
        if turning > 0.0:
            turn = wx * cdof[k, 0] + wy * cdof[k, 1] + wz * cdof[k, 2]
            gradient[k] += radius[c] * turn / turning
