"""The gate's laws: what the joints can follow, and a bound on every distance along a stop (docs/theory.md section 9).

    largest_stopping_speed   how fast a joint may turn with so much room ahead of its end stop
    joint_box                interval of commands each joint may be given next
    end_rows                 the material points of each pair's own geom: rate rows, lever arms, distances
    demands                  what the gate asks of each pair's rate and of each point's stop
    stop_margins             lower bound of each point's distance while the joints brake to rest
    look                     how a command does by both
    stop_gradient            how one such bound changes with the command
    point_speeds             bound on the speed of any point of a link

Symbols: n joints, P pairs, E points (all pairs together). Points of pair p are `first[p]` to `first[p + 1]`.
"""

from __future__ import annotations

import math

import numpy as np

from workcell.control.laws import law, part
from workcell.control.laws.pair_rule import allowance

POSITION, SPEED, ACCELERATION, JERK = 1, 2, 3, 4
"""What bounds an interval of `joint_box`."""


@part
def largest_stopping_speed(room, deceleration, period, latency):
    """Largest speed v from which ticked braking still ends within some room.

    A command v acts for `latency + period`; then v - a dt, v - 2 a dt, ... act for a period each, down
    to 0. With v = (N + f) a dt, 0 <= f < 1, the way is

        a dt² (N (N + 1) / 2 + N τ + f (N + 1 + τ)),   τ = latency / period.

    This is its exact inverse. The continuous formula passes the end stop by up to a dt² / 8. In the last
    step (N = 0, τ = 0) it is room / dt.

    Args:
        room: Distance left, rad or m; <= 0 gives 0.
        deceleration: a > 0.
        period: dt > 0, s.
        latency: >= 0, s: how long commands take before they act.
    """
    if room <= 0.0:
        return 0.0
    step = deceleration * period
    quanta, tau = room / (step * period), latency / period
    whole = math.floor(math.sqrt((0.5 + tau) ** 2 + 2.0 * quanta) - (0.5 + tau))
    used = whole * (whole + 1.0) / 2.0 + whole * tau
    return step * (whole + min(1.0, max(0.0, (quanta - used) / (whole + 1.0 + tau))))


@law
def joint_box(
    q_low, q_high, last, last_change, lower, upper, speed, acceleration, jerk, period, box, bounds
):
    """Interval of velocities that each joint may be commanded next.

    Position (`largest_stopping_speed` to either end stop), speed, acceleration from the last command, and
    jerk from the last change of command. Where they contradict one another, what the joints cannot
    exceed comes first: acceleration, then position and speed, then jerk. Beyond an end stop only
    the way back is left.

    Args:
        q_low, q_high: (n,) interval in which each joint is when the command begins to act.
        last: (n,) last command.
        last_change: (n,) last command less the one before, over the period.
        lower, upper: (n,) ranges, infinite where there is none.
        speed, acceleration, jerk: (n,) limits > 0; jerk may be infinite.
        period: s.
        box: (2, n) out: smallest and largest command.
        bounds: (2, n) integers out: what set them (`POSITION`, ...).
    """
    for k in range(len(last)):
        for side in range(2):
            sign = 1.0 if side == 1 else -1.0
            room = upper[k] - q_high[k] if side == 1 else q_low[k] - lower[k]
            bound, why = speed[k], SPEED
            if room < math.inf:
                stopping = largest_stopping_speed(room, acceleration[k], period, 0.0)
                if stopping < bound:
                    bound, why = stopping, POSITION
            box[side, k], bounds[side, k] = sign * bound, why
        step = acceleration[k] * period
        low, high = last[k] - step, last[k] + step
        # The joint cannot leave this interval: what lies outside it is moved to its nearer end.
        for side in range(2):
            if box[side, k] < low or (side == 0 and box[side, k] <= low):
                box[side, k], bounds[side, k] = low, ACCELERATION
            elif box[side, k] > high or (side == 1 and box[side, k] >= high):
                box[side, k], bounds[side, k] = high, ACCELERATION
        if jerk[k] < math.inf:
            middle, width = last[k] + last_change[k] * period, jerk[k] * period * period
            if box[0, k] < middle - width <= box[1, k]:
                box[0, k], bounds[0, k] = middle - width, JERK
            if box[0, k] <= middle + width < box[1, k]:
                box[1, k], bounds[1, k] = middle + width, JERK


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


@law
def stop_travel(command, ahead_low, ahead_high, deceleration, reaction, travel):
    """Interval of displacements each joint may go through until it stands.

    A joint goes on for the reaction time and then brakes: |x| T_r + x² / (2 a) in the direction of x, on top of
    what is still ahead of it (commands in flight, servo lag, the error of measurement).

    Args:
        command: (n,) x.
        ahead_low, ahead_high: (n,) interval of displacements before the command acts.
        deceleration: (n,) a.
        reaction: T_r, s.
        travel: (2, n) out: smallest and largest displacement.
    """
    for k in range(len(command)):
        x = command[k]
        way = abs(x) * reaction + x * x / (2.0 * deceleration[k])
        travel[0, k] = ahead_low[k] - (way if x < 0.0 else 0.0)
        travel[1, k] = ahead_high[k] + (way if x > 0.0 else 0.0)


@part
def margin_of(e, p, travel, order, rows, levers, low):
    """low_e for one point e of pair p: first order, less the bound Q on all higher orders.

    low_e = m_e - Σ_k max(-A_ek δ over the interval of δ_k) - Q_e. With s_k the larger end of the interval,
    joints from the tip to the base: R = R_ek + acc; acc += R s_k; Q += R s_k (s_k / 2 + Σ s of those nearer the base).
    """
    margin, rest = low[e], 0.0
    for i in range(order.shape[1]):
        k = order[p, i]
        if k < 0:
            break
        rest += max(-travel[0, k], travel[1, k])
        margin -= max(-rows[e, k] * travel[0, k], -rows[e, k] * travel[1, k])
    grown = 0.0
    for i in range(order.shape[1]):
        k = order[p, i]
        if k < 0:
            break
        s = max(-travel[0, k], travel[1, k])
        lever = levers[e, k] + grown
        grown += lever * s
        rest -= s
        margin -= lever * s * (0.5 * s + rest)
    return margin


@law
def stop_margins(travel, first, order, rows, levers, low, margin):
    """Lower bound of every point's distance over all displacements in a box; the stop test of theory section 9.

    Args:
        travel: (2, n) smallest and largest displacement of each joint (`stop_travel`).
        first, order, rows, levers, low: As in `end_rows`.
        margin: (E,) out.
    """
    for p in range(len(first) - 1):
        for e in range(first[p], first[p + 1]):
            margin[e] = margin_of(e, p, travel, order, rows, levers, low)


@law
def demands(
    near,
    meeting,
    other,
    first,
    low,
    t_min,
    d_min,
    standoff,
    hold,
    slack_moving,
    slack_at_rest,
    clearance_most,
    needed,
    slack,
    clearance,
):
    """What the gate asks of each pair's rate and of each point's stop.

    The rate rule is d - standoff + t_min (own + other) >= 0, asked of `own` as far as standing keeps it: what
    standing does not keep is for the arm's strategy to open. A pair at d_min, or at the distance that
    stops hold, may only open. Pairs that are to meet know neither standoff nor d_min.

    Args:
        near: (P,) d.
        meeting: (P,) whether the pair is to meet.
        other: (P,) predicted rates that all but this arm cause.
        first, low: As in `end_rows`.
        t_min, d_min, standoff, hold: s, m, m, m.
        slack_moving, slack_at_rest: Tolerances of rates, m/s.
        clearance_most: Distance that a stop leaves, or half of what there is, m.
        needed: (P,) out: smallest own rate, <= 0.
        slack: (P,) out: its tolerance.
        clearance: (E,) out: smallest margin; minus infinity where there is contact, which has the rule above.
    """
    for p in range(len(near)):
        gap = near[p] - (0.0 if meeting[p] else standoff)
        only_open = near[p] <= hold or (near[p] <= d_min and not meeting[p])
        if only_open:
            gap = min(gap, 0.0)
        rate = -allowance(gap, other[p], t_min, 0.0)
        needed[p] = 0.0 if rate > 0.0 else rate  # what is not a number stays so
        slack[p] = slack_at_rest if only_open else slack_moving
        for e in range(first[p], first[p + 1]):
            if near[p] <= hold:
                clearance[e] = -math.inf
            else:
                clearance[e] = hold + min(clearance_most, 0.5 * (low[e] - hold))


@law
def look(
    command,
    ahead_low,
    ahead_high,
    deceleration,
    reaction,
    own,
    first,
    order,
    rows,
    levers,
    low,
    needed,
    slack,
    clearance,
    short,
    lack,
):
    """How a command does: whether its rates and its stop are all that `demands` asks.

    Args:
        command, ahead_low, ahead_high, deceleration, reaction: As in `stop_travel`.
        own, first, order, rows, levers, low: As in `end_rows`.
        needed, slack, clearance: As in `demands`.
        short: (P,) out: by how much a rate falls short beyond its tolerance; <= 0 where it is kept.
        lack: (E,) out: by how much a margin falls short; <= 0 where it is kept.

    Returns:
        Whether all are kept; a number that is not finite keeps nothing.
    """
    travel = np.empty((2, len(command)))
    stop_travel(command, ahead_low, ahead_high, deceleration, reaction, travel)
    kept = True
    for p in range(len(needed)):
        rate = 0.0
        for k in range(len(command)):
            rate += own[p, k] * command[k]
        short[p] = needed[p] - slack[p] - rate
        kept = kept and short[p] <= 0.0
        for e in range(first[p], first[p + 1]):
            lack[e] = clearance[e] - margin_of(e, p, travel, order, rows, levers, low)
            kept = kept and lack[e] <= 0.0
    return kept


@law
def stop_gradient(
    e, p, command, ahead_low, ahead_high, deceleration, reaction, order, rows, levers, gradient
):
    """∇ low_e (n,) in the command: where to move a command so that its stop keeps more distance.

    The adjoint of `margin_of`. Joints at rest take the direction in which they would close the pair.

    Args:
        e, p: The point and its pair.
        command, ahead_low, ahead_high, deceleration, reaction: As in `stop_travel`.
        order, rows, levers: As in `end_rows`.
        gradient: (n,) out.
    """
    n = len(command)
    gradient[:] = 0.0
    ways, levers_then, rests = np.zeros(n), np.zeros(n), np.zeros(n)
    count, rest, grown = 0, 0.0, 0.0
    for i in range(order.shape[1]):
        k = order[p, i]
        if k < 0:
            break
        x = command[k]
        way = abs(x) * reaction + x * x / (2.0 * deceleration[k])
        to_low = ahead_low[k] - (way if x < 0.0 else 0.0)
        to_high = ahead_high[k] + (way if x > 0.0 else 0.0)
        ways[i] = max(-to_low, to_high)
        rest += ways[i]
        count += 1
    for i in range(count):
        lever = levers[e, order[p, i]] + grown
        grown += lever * ways[i]
        rest -= ways[i]
        levers_then[i], rests[i] = lever, rest
    # Backwards: how Q changes with each way, then with the command that makes it.
    from_grown, nearer_base = 0.0, 0.0
    slope = np.zeros(n)
    for i in range(count - 1, -1, -1):
        lever, way = levers_then[i], ways[i]
        of_lever = way * (0.5 * way + rests[i]) + from_grown * way
        slope[i] = lever * (way + rests[i]) + lever * from_grown
        from_grown += of_lever
    for i in range(count):
        # Each way also stands in the rest of all joints nearer the tip.
        slope[i] += nearer_base
        nearer_base += levers_then[i] * ways[i]
    for i in range(count):
        k = order[p, i]
        x, row = command[k], rows[e, k]
        per_speed = reaction + abs(x) / deceleration[k]
        direction = 1.0 if x > 0.0 or (x == 0.0 and row < 0.0) else -1.0
        closing = max(0.0, -row * direction)
        gradient[k] = -direction * per_speed * (closing + slope[i])


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
