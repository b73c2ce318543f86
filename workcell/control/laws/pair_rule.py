"""The rule of this project, once: d - standoff + t_min (a + b) >= 0 (docs/theory.md section 5).

a is the part of a pair's rate that the arm in question causes, b the part that all else causes. The rule says
that the time to collision is at least t_min: d' >= -(d - standoff)/t_min. Whatever needs the rule calls
`allowance`: the speed scale, the rows of the inverse kinematics, the check of a command, evasive motion.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part

TASK_SLACK_M_S = 1e-5
"""The tool task's own velocity is known up to its regularisation; without this slack it could seem to break the very
rows it defines. Ten micrometres a second is 0.1 % of the slowest closing speed that matters, d_min / t_min."""
AT_REST_M_S = 1e-4
"""Rates below this at d_min count as standing: an arm that starts to leave is first moved by the last digits of its
tool error, which may point either way, and must not be held for that."""


@part
def allowance(distance, other, t_min, standoff):
    """How fast the arm may close a pair, m/s: the rule is a >= -allowance. Negative: it must open it.

    Args:
        distance: d in m.
        other: b in m/s.
        t_min: In s.
        standoff: Distance to which the time is counted, m.
    """
    return (distance - standoff) / t_min + other


@part
def counted_distance(distance, meeting, d_min, standoff):
    """The distance that the rule counts with, and whether it is at d_min.

    From there on no way is left, but for what is meant to meet, which knows no standoff either.
    """
    if meeting:
        return distance + standoff, False
    reached = distance <= d_min
    return (min(distance, 0.0) if reached else distance), reached


@law
def smallest_rates(distance, other, t_min, standoff, rate):
    """The smallest own rate that the rule asks of every pair: (P,) distance, (P,) other, (P,) rate written."""
    for pair in range(len(rate)):
        rate[pair] = -allowance(distance[pair], other[pair], t_min, standoff)


@law
def predicted_rates(jacobian, index, foreign, velocities, change, other):
    """The rates that the other arms may cause: the least under any of their predicted velocities.

    Opening is counted on only as far as the others' joints cannot take it back within the tick: an arm that makes
    room may stop for what nobody predicts.

    Args:
        jacobian: G (P, nv).
        index: Pairs to work out.
        foreign: The joints of other arms.
        velocities: (K, nv) predicted, the second as last commanded; with K = 0 the others stand.
        change: (nv,) by how much each joint's velocity may yet change in this tick; 0 where it is known.
        other: (P,) written at these pairs.

    Returns:
        The first pair whose rate is not finite; -1 if there is none.
    """
    for pair in index:
        least = 0.0
        for way in range(len(velocities)):
            total = 0.0
            for joint in foreign:
                total += jacobian[pair, joint] * velocities[way, joint]
            if not math.isfinite(total):
                return pair
            if way == 0 or total < least:
                least = total
        if least > 0.0:
            last = velocities[min(1, len(velocities) - 1)]
            sure = 0.0
            for joint in foreign:
                sure += (
                    jacobian[pair, joint] * last[joint] - abs(jacobian[pair, joint]) * change[joint]
                )
            least = max(0.0, min(least, sure))
        other[pair] = least
    return -1


@law
def self_motion_rows(
    jacobian, distance, other, index, dof, task, speed, t_min, standoff, d_min, rows, bounds
):
    """Rows of G and the smallest rate allowed to each, of the pairs that self-motion could bring below t_min.

    A row never asks for more than the tool's task alone gives: what the path or the operator
    wants is not the null space's to refuse. Pairs that no allowed velocity could bring below t_min are left out.

    Args:
        jacobian, distance, other: (P, nv), (P,), (P,).
        index: Pairs that the arm moves.
        dof: (n,) joints of the arm.
        task: (n,) the smallest motion that does what the tool is to do.
        speed: (n,) speed limits.
        t_min, standoff, d_min: The rule's.
        rows: (K, n) or longer, written.
        bounds: (K,) or longer, written.

    Returns:
        How many rows were written; and the first pair with a number that is not finite, -1 if there is none.
    """
    count = 0
    for pair in index:
        gap = distance[pair] - standoff
        bound = -allowance(distance[pair], other[pair], t_min, standoff)
        if gap <= d_min:
            bound = -other[pair]
        asked = reachable = 0.0
        for k in range(len(dof)):
            entry = jacobian[pair, dof[k]]
            rows[count, k] = entry
            asked += entry * task[k]
            reachable -= abs(entry) * speed[k]
        bound = min(bound, asked - TASK_SLACK_M_S)
        if not math.isfinite(bound + reachable):
            return 0, pair
        if bound > reachable:
            bounds[count] = bound
            count += 1
    return count, -1


@law
def keeping(
    jacobian, distance, other, other_before, index, meeting, dof, command, t_min, standoff, d_min,
    allowed, needed, needs_more, short, others_alone,
):  # fmt: skip
    """How far a command keeps the rule, pair by pair, R being the number of pairs the arm answers for.

    Args:
        jacobian, distance, other: (P, nv), (P,), (P,).
        other_before: (R,) what the others caused when the rule was last kept.
        index: (R,) the pairs.
        meeting: (R,) which of them are meant to meet.
        dof: (n,) joints of the arm.
        command: (n,) joint velocity.
        t_min, standoff, d_min: The rule's.
        allowed: (R,) written: how fast each may be closed; negative where standing does not keep it.
        needed: (R,) written: rate that each needs of this arm; 0 for those that standing keeps.
        needs_more: (R,) written: which do not get it.
        short: (R,) written: which fall short of their time to collision.
        others_alone: (R,) written: where a time falls short, whether the others alone are the cause: they close too
            fast for an arm that stands, or faster than when the rule was last kept.

    Returns:
        Whether every pair is kept.
    """
    kept = True
    for k in range(len(index)):
        pair = index[k]
        opening = 0.0
        for m in range(len(dof)):
            opening += jacobian[pair, dof[m]] * command[m]
        counted, reached = counted_distance(distance[pair], meeting[k], d_min, standoff)
        slack = AT_REST_M_S if reached else TASK_SLACK_M_S
        allowed[k] = allowance(counted, other[pair], t_min, standoff)
        needed[k] = min(-allowed[k], 0.0)
        # Not "<", so that what is not a number is not kept.
        needs_more[k] = not opening >= needed[k] - slack
        short[k] = not allowed[k] + opening >= -slack
        before = other_before[k] - other[pair]
        others_alone[k] = allowed[k] < 0.0 or allowed[k] + before + opening >= -slack
        kept = kept and not needs_more[k] and not short[k]
    return kept
