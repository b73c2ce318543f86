"""The gate's laws: a bound on every distance along a stop, and what is asked of it (docs/theory.md section 9).

    demands                  what the gate asks of each pair's rate and of each point's stop
    stop_margins             lower bound of each point's distance while the joints brake to rest
    look                     how a command does by both
    stop_gradient            how one such bound changes with the command
    passes                   all of it for one command, from MuJoCo's arrays

Symbols: n joints, P pairs, E points (all pairs together). Points of pair p are `first[p]` to `first[p + 1]`.
"""

from __future__ import annotations

import math

import numpy as np

from workcell.control.laws import law, part
from workcell.control.laws.gate_box import next_commands
from workcell.control.laws.gate_points import end_rows, point_speeds
from workcell.control.laws.pair_rule import allowance

SAME_RAD_S = 1e-9
"""A command this far outside of its interval is in it: rounding."""


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


@law
def passes(
    command, position, last, last_change, ahead_low, ahead_high, lower, upper, speed, acceleration,
    jerk, period, reaction, t_min, d_min, standoff, hold, slack_moving, slack_at_rest, clearance_most,
    cap, dof, root, cdof, subtree_com, geom_position, geom_rotation, distance, normal, witness_i,
    witness_j, pairs, side, geom, exact, first, local, order, sign, meeting, counted, other,
    corner_geom, corner_moves, corner_radius, corner_local, screws, centre, near, own, rows, levers,
    low, box, bounds, rest, needed, slack, clearance, short, lack, over,
):  # fmt: skip
    """Whether a command passes as it is, with all that the gate knows of it, from MuJoCo's arrays.

    Args:
        command, ahead_low, ahead_high, acceleration, reaction: As in `stop_travel`.
        position: (n,) measured.
        last, last_change, lower, upper, speed, jerk, period: As in `gate_box.next_commands`.
        t_min, d_min, standoff, hold, slack_moving, slack_at_rest, clearance_most: As in `demands`.
        cap: On the speed of points, m/s; infinite for none.
        dof, root: (n,) joints of the arm, and the root bodies of their tree.
        cdof, subtree_com, geom_position, geom_rotation: MuJoCo's.
        distance, normal, witness_i, witness_j, pairs, side, geom, exact, first, local, order, sign: As in `end_rows`.
        meeting: (P,) which pairs are to meet.
        counted: (P,) whether the others' part of a pair's rate counts.
        other: (W,) that part, of all watched pairs.
        corner_geom, corner_moves, corner_radius, corner_local: As in `point_speeds`.
        screws, centre: (n, 6), (n, 3) out: of the arm's joints.
        near, own, rows, levers, low: Out, as in `end_rows`.
        box, bounds: Out, as in `gate_box.next_commands`.
        rest: (P,) out: the others' part as counted.
        needed, slack, clearance: Out, as in `demands`.
        short, lack: Out, as in `look`.
        over: (C,) out, as in `point_speeds`.
    """
    for k in range(len(dof)):
        screws[k], centre[k] = cdof[dof[k]], subtree_com[root[k]]
    end_rows(
        screws, centre, geom_position, geom_rotation, distance, normal, witness_i, witness_j, pairs,
        side, geom, exact, first, local, order, sign, near, own, rows, levers, low,
    )  # fmt: skip
    for p in range(len(pairs)):
        rest[p] = other[pairs[p]] if counted[p] else 0.0
    next_commands(
        position + ahead_low, position + ahead_high, last, last_change, lower, upper, speed,
        acceleration, jerk, period, box, bounds,
    )  # fmt: skip
    demands(
        near, meeting, rest, first, low, t_min, d_min, standoff, hold, slack_moving, slack_at_rest,
        clearance_most, needed, slack, clearance,
    )  # fmt: skip
    kept = True
    for k in range(len(dof)):
        kept = kept and box[0, k] - SAME_RAD_S <= command[k] <= box[1, k] + SAME_RAD_S
    if not kept:
        return False
    if cap < math.inf:
        point_speeds(
            command, screws, centre, geom_position, geom_rotation, corner_geom, corner_moves,
            corner_radius, corner_local, over,
        )  # fmt: skip
        for c in range(len(over)):
            kept = kept and over[c] <= cap
    return kept and look(
        command, ahead_low, ahead_high, acceleration, reaction, own, first, order, rows, levers, low,
        needed, slack, clearance, short, lack,
    )  # fmt: skip
