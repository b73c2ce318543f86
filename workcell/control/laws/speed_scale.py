"""The speed scale: how much of a nominal velocity an arm may have (docs/theory.md section 5, equations 14 to 16).

The rule of `pair_rule` holds for s times the nominal velocity where d - standoff + t_min (s a + b) >= 0 in every
pair. For b = 0 the largest such s is the paper's factor t*/t_min (16). The joints' acceleration limits, too,
are an interval of s.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.pair_rule import AT_REST_M_S, allowance, counted_distance
from workcell.control.laws.time_to_collision import second_order, time_of

BY_TIME, BY_SECOND_ORDER_TIME, BY_DISTANCE = 0, 1, 2
"""What the speed scale is worked out from: the rule; the rule and equation (16) on the second-order time; distance alone."""

MUST_YIELD_M_S = 1e-3
"""Opening rate another arm's motion must leave missing before this arm gives way; above servo noise, below any intent."""
MUST_YIELD_MEETING_M_S = 0.03
"""The same for what is meant to meet, where a hand is near that trembles: 0.1 mm at 10 Hz move at up to 20 mm/s."""

EQUALLY_GOOD = 1e-12
"""Relative difference below which two violations of the joints' limits count as equal."""

FULL = (1.0, -1, math.inf, 0.0, -1, -1)
"""What `pairwise_factor` returns where no pair limits the arm."""


@law
def pairwise_factor(distance, own, other, t_min, standoff):
    """Largest factor s in [0, 1] with distance - standoff + t_min (s own + other) >= 0 in every pair.

    Pairs that the arm itself opens (own >= 0) never limit it. Where no s in [0, 1] holds a pair,
    s is 0 for the pairs it closes and the lack is the shortfall. A pair that sets the factor is met exactly,
    and only rounding would say otherwise.

    Args:
        distance: (P,) in m.
        own: a (P,) in m/s, caused by the whole nominal velocity.
        other: b (P,) in m/s.
        t_min: In s, > 0.
        standoff: Distance to which the time is counted, m.

    Returns:
        The factor; the pair that sets it (-1: none); the factor before clamping; the opening rate still missing at the
        factor in the worst pair, m/s; that pair (-1: none); and the first pair with a number that is not
        finite (-1: none).
    """
    least, limiting = math.inf, -1
    for pair in range(len(distance)):
        left = allowance(distance[pair], other[pair], t_min, standoff)
        if not math.isfinite(left + own[pair]):
            return 0.0, -1, 0.0, 0.0, -1, pair
        if own[pair] < 0.0:
            required = left / -own[pair]
            if required < least:
                least, limiting = required, pair
    factor = 0.0 if least <= 0.0 else min(least, 1.0)
    lowest, worst = math.inf, -1
    for pair in range(len(distance)):
        left = allowance(distance[pair], other[pair], t_min, standoff)
        margin = left + factor * own[pair]
        if own[pair] < 0.0 and left >= 0.0:
            margin = 0.0
        if margin < lowest:
            lowest, worst = margin, pair
    short = max(0.0, -lowest)
    return (
        factor, limiting if least < 1.0 else -1, least, short, worst if short > 0.0 else -1, -1,
    )  # fmt: skip


@law
def slow_near(distance, stop, slow):
    """The plain rule to compare with: the factor falls linearly from 1 at `slow` to 0 at `stop`, whatever moves where.

    Args:
        distance: (P,) in m.
        stop, slow: In m, stop < slow.

    Returns:
        As `pairwise_factor`; nothing is ever said to be missing.
    """
    least, nearest = math.inf, -1
    for pair in range(len(distance)):
        if not math.isfinite(distance[pair]):
            return 0.0, -1, 0.0, 0.0, -1, pair
        if distance[pair] < least:
            least, nearest = distance[pair], pair
    if nearest < 0:
        return FULL
    required = (least - stop) / (slow - stop)
    factor = min(1.0, max(0.0, required))
    return factor, nearest if factor < 1.0 else -1, required, 0.0, -1, -1


@part
def _by_second_order(found, distance, own, other, accel, t_min, standoff):
    """The smaller of a factor of `pairwise_factor` and t/t_min, t being the shortest second-order time (16).

    Only pairs that the arm closes itself can be held by slowing down; leaving is not slowed either way.
    """
    most, first = 0.0, -1
    for pair in range(len(distance)):
        if not math.isfinite(accel[pair]):
            return 0.0, -1, 0.0, 0.0, -1, pair
        if own[pair] < 0.0:
            rate = own[pair] + other[pair]
            kappa = second_order(distance[pair], rate, accel[pair], standoff)
            if kappa > most:
                most, first = kappa, pair
    ttc, first = time_of(most, first)
    factor = min(1.0, ttc / t_min)
    if found[5] >= 0 or factor >= found[0]:
        return found
    return factor, first, factor, found[3], found[4], -1


@part
def _speed_scale(rule, distance, own, other, accel, t_min, standoff, d_min, slow):
    if rule == BY_DISTANCE:
        return slow_near(distance, d_min, slow)
    found = pairwise_factor(distance, own, other, t_min, standoff)
    if rule == BY_SECOND_ORDER_TIME:
        return _by_second_order(found, distance, own, other, accel, t_min, standoff)
    return found


@law
def arm_scale(
    jacobian, distance, other, accel, index, meeting, fixed_base, dof, nominal, rule, t_min,
    standoff, d_min, slow, work,
):  # fmt: skip
    """The speed scale of an arm, and whether it must yield: whether standing is not enough for a pair it can open.

    From d_min on a pair may only be opened, unless it is meant to meet. Nothing the arm does opens a pair with
    its own base; to yield for that would only stop its work. R is the number of pairs it answers for.

    Args:
        jacobian: G (P, nv).
        distance: (P,).
        other: (P,) what the others cause.
        accel: d'' (P,), read only for `BY_SECOND_ORDER_TIME`.
        index: (R,) the pairs.
        meeting: (R,) which of them are meant to meet.
        fixed_base: (R,) which are with the arm's own base.
        dof: (n,) joints of the arm.
        nominal: (n,) velocity that is scaled.
        rule: `BY_TIME`, `BY_SECOND_ORDER_TIME` or `BY_DISTANCE`.
        t_min, standoff, d_min: The rule's.
        slow: Distance from which `BY_DISTANCE` slows down.
        work: (4, R) for use inside.

    Returns:
        What `pairwise_factor` returns, its pairs numbered among the R; and whether the arm must yield.
    """
    counted, own, rest, bend = work[0], work[1], work[2], work[3]
    for k in range(len(index)):
        pair = index[k]
        rate = 0.0
        for m in range(len(dof)):
            rate += jacobian[pair, dof[m]] * nominal[m]
        counted[k], reached = counted_distance(distance[pair], meeting[k], d_min, standoff)
        own[k], rest[k] = _at_rest(rate, reached), _at_rest(other[pair], reached)
        bend[k] = accel[pair]
    found = _speed_scale(rule, counted, own, rest, bend, t_min, standoff, d_min, slow)
    if not found[3] > MUST_YIELD_M_S:
        return found, False
    for k in range(len(index)):
        pair = index[k]
        spared = other[pair]
        if meeting[k]:
            spared += MUST_YIELD_MEETING_M_S
        if fixed_base[k]:
            spared = max(spared, 0.0)
        rest[k] = _at_rest(spared, distance[pair] <= d_min and not meeting[k])
    spared = _speed_scale(rule, counted, own, rest, bend, t_min, standoff, d_min, slow)
    return found, spared[3] > MUST_YIELD_M_S


@part
def _at_rest(rate, reached):
    """A rate, 0 where the pair is at d_min and hardly moves."""
    return 0.0 if reached and abs(rate) < AT_REST_M_S else rate


@law
def acceleration_interval(previous, wanted, limit, period):
    """Factors s in [0, 1] with |s wanted - previous| <= limit period in every joint.

    Where there is none (the wanted direction turned faster than the joints can follow, or a reversal is due),
    the factor with the least relative violation, max |s wanted - previous| / limit over the joints.
    A joint that hardly moves leaves the factor free: the quotients are infinite.

    Args:
        previous: (n,) joint velocities commanded in the last period, rad/s.
        wanted: (n,) unscaled joint velocities, rad/s.
        limit: (n,) in rad/s^2.
        period: In s.

    Returns:
        The smallest and the largest reachable factor; whether there is one; and the first joint with a number that
        is not finite or a limit that is not positive, -1 if there is none.
    """
    lowest, highest, feasible = 0.0, 1.0, True
    for k in range(len(previous)):
        v, w, reach = previous[k], wanted[k], limit[k] * period
        if not (math.isfinite(v) and math.isfinite(w) and math.isfinite(reach) and limit[k] > 0.0):
            return 0.0, 0.0, False, k
        if w == 0.0:
            feasible = feasible and abs(v) <= reach
        else:
            one, two = (v - reach) / w, (v + reach) / w
            lowest, highest = max(lowest, min(one, two)), min(highest, max(one, two))
    if feasible and lowest <= highest:
        return lowest, highest, True, -1
    least = _least_violation(previous, wanted, limit, period)
    return least, least, False, -1


@part
def _least_violation(previous, wanted, limit, period):
    """The s in [0, 1] that minimises max |s wanted - previous| / limit.

    The maximum is convex and piecewise linear in s, so its minimum lies where two of the lines
    +-(s wanted - previous) / limit cross or at an end of the range; there are few enough to try them all. The
    smallest factor among equally good ones is taken, so that the result is the same everywhere.
    """
    lines = 2 * len(previous)
    best, lowest = 1.0, math.inf
    for search in range(2):  # the least violation, then the smallest factor that has it
        for one in range(lines):
            slope_one, offset_one = _line(one, previous, wanted, limit, period)
            for two in range(one, lines):
                slope_two, offset_two = _line(two, previous, wanted, limit, period)
                s = 0.0 if one == 0 else 1.0  # both ends are among the candidates
                if two != one:
                    if slope_one == slope_two:
                        continue
                    s = (offset_two - offset_one) / (slope_one - slope_two)
                if not 0.0 <= s <= 1.0:
                    continue
                worst = _violation(s, previous, wanted, limit, period)
                if search == 0:
                    lowest = min(lowest, worst)
                elif worst <= lowest * (1.0 + EQUALLY_GOOD):
                    best = min(best, s)
    return best


@part
def _line(k, previous, wanted, limit, period):
    """Slope and offset of line k: the joints' own, then the same with the other sign."""
    joints = len(previous)
    if k < joints:
        reach = limit[k] * period
        return wanted[k] / reach, -(previous[k] / reach)
    reach = limit[k - joints] * period
    return -(wanted[k - joints] / reach), previous[k - joints] / reach


@part
def _violation(s, previous, wanted, limit, period):
    """max |s wanted - previous| / (limit period) over the joints."""
    worst = 0.0
    for k in range(len(previous)):
        reach = limit[k] * period
        worst = max(worst, abs(s * (wanted[k] / reach) - previous[k] / reach))
    return worst


@law
def backing_factor(own, needed):
    """The mildest factor in [-1, 0] that gives every pair the rate it needs; NaN if there is none.

    Args:
        own: (R,) rates at factor 1, m/s.
        needed: (R,) smallest rate of each pair, m/s.
    """
    lowest, highest = -1.0, 0.0
    for k in range(len(own)):
        if own[k] < 0.0:
            highest = min(highest, needed[k] / own[k])
        elif own[k] > 0.0:
            lowest = max(lowest, needed[k] / own[k])
        elif needed[k] > 0.0:
            return math.nan
    return highest if lowest <= highest else math.nan
