"""Null-space criteria over the pairs of one arm (docs/theory.md section 6, paper equations 17 and 18).

ARMD is the mean of 1/d, ARTC the mean of -d'/d, signed or over approaching pairs only. What the inverse kinematics
minimises is the quadratic 1/2 q' H q' + c q' in the arm's joint velocities that descends the criterion.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part

ARTC_SIGNED, ARTC_APPROACHING, ARMD, NO_CRITERION, ARTC_HELD, GIVEN = 0, 1, 2, 3, 4, 5
"""The criteria by number; the H and c of `GIVEN` are worked out elsewhere."""

HELD_TIME_S = 8.0
"""Weight of 1/t against `HELD_FLOOR` in `ARTC_HELD`. In trials 64 (0.1 + 1/t) was good in every scene at one gain; 8 is the
shipped `criterion_gain`, which multiplies it."""
HELD_FLOOR = 0.8
"""What a pair counts in `ARTC_HELD` that does not close: a log barrier at a tenth, without which room is lost (12 mm in trials)."""

DISTANCE_FLOOR_M = 1e-3
"""Distances below this count as this, touching and penetrating pairs included.

All criteria divide by distance and so grow without bound at contact, where they would drown the
rest of the average. One millimetre was chosen as the fit of a capsule to a real link, below which
ranking distances means nothing.
"""
STOP_MARGIN_RAD = 0.2
"""A joint nearer to its stop than this is pushed back in the null space; chosen as what a tool that works at one place moves it by."""
STOP_PUSH_RAD_S = 1.0
"""Push at the stop itself, falling with the square of the way into the margin; above what the criteria push with."""


@part
def floored(distance):
    return max(distance, DISTANCE_FLOOR_M)


@law
def means(distance, rate, index, approaching):
    """ARTC in 1/s and ARMD in 1/m over some pairs: the means of -d'/d and of 1/d; 0 if there are none.

    Args:
        distance, rate: (P,) in m and m/s.
        index: The pairs.
        approaching: Whether pairs that open count 0 in ARTC; otherwise they count negative.

    Returns:
        ARTC, ARMD; and the first pair with a number that is not finite, -1 if there is none.
    """
    artc = armd = 0.0
    for pair in index:
        d, speed = floored(distance[pair]), rate[pair]
        if not math.isfinite(distance[pair] + speed):
            return 0.0, 0.0, pair
        armd += 1.0 / d
        if speed < 0.0 or not approaching:
            artc += -speed / d
    if len(index) == 0:
        return 0.0, 0.0, -1
    return artc / len(index), armd / len(index), -1


@law
def objective(kind, jacobian, distance, rate, other, index, dof, hessian, linear):
    """H and c of a criterion: minimising 1/2 q' H q' + c q' descends it.

    ARMD: c = -(1/P) sum G/d^2. Signed ARTC: c = -(1/P) sum G/d, also the gradient in the joint positions of
    the log barrier -(1/P) sum ln d. Approaching ARTC is the residual (1/2P) sum ((G q' + b)/d)^2 over the
    pairs that close: H = (1/P) sum G'G/d^2, c = (1/P) sum G' b/d^2. Held ARTC is (18) as a criterion of the
    joint positions, the rates held: with 1/t = max(0, -r/d) its gradient is -(1/P) sum (1/t) G/d, so that a pair
    counts the more the sooner it collides; c = -(1/P) sum (floor + time/t) G/d.

    Args:
        kind: One of the numbers above; `NO_CRITERION` and `GIVEN` ask for nothing here.
        jacobian, distance: (P, nv), (P,).
        rate: (P,) decides what closes; read for `ARTC_APPROACHING` and `ARTC_HELD` only, for which it is r, the rate
            without the arm's own self-motion.
        other: b (P,) the part of the rate that other arms cause; likewise.
        index: The pairs that are averaged.
        dof: (n,) joints of the arm.
        hessian: H (n, n), written.
        linear: c (n,), written.

    Returns:
        The first pair with a number that is not finite, -1 if there is none.
    """
    n = len(dof)
    hessian[:, :] = 0.0
    linear[:] = 0.0
    if kind in (NO_CRITERION, GIVEN):
        return -1
    for pair in index:
        given, d = distance[pair], floored(distance[pair])
        for a in range(n):
            given += jacobian[pair, dof[a]]
        if kind == ARTC_APPROACHING:
            given += rate[pair] + other[pair]
            if rate[pair] < 0.0:
                for a in range(n):
                    scaled = jacobian[pair, dof[a]] / d
                    linear[a] += scaled * (other[pair] / d)
                    for b in range(n):
                        hessian[a, b] += scaled * (jacobian[pair, dof[b]] / d)
        else:
            weight = -1.0 / d
            if kind == ARMD:
                weight = -1.0 / (d * d)
            elif kind == ARTC_HELD:
                given += rate[pair]
                weight *= HELD_FLOOR + HELD_TIME_S * max(0.0, -rate[pair]) / d
            for a in range(n):
                linear[a] += weight * jacobian[pair, dof[a]]
        if not math.isfinite(given):
            return pair
    pairs = max(1, len(index))
    for a in range(n):
        linear[a] /= pairs
        for b in range(n):
            hessian[a, b] /= pairs
    return -1


@law
def push_from_stops(qpos, address, lower, upper, weight, linear):
    """Add to c a push of every joint away from a stop that is near.

    A criterion that always prefers one side would lead a joint to its stop and keep it there, and the
    arm would be one joint short for what its tool has to do.

    Args:
        qpos: All joint positions of the cell, rad.
        address: (n,) where the arm's are.
        lower, upper: (n,) stops, infinite where there is none.
        weight: Weight of the criterion against 1/2 |q'|^2, > 0: the push is a velocity, and does not grow with it.
        linear: c (n,), changed.

    Returns:
        The first joint whose position is not finite, -1 if there is none.
    """
    for k in range(len(address)):
        q = qpos[address[k]]
        if not math.isfinite(q):
            return k
        below = max(STOP_MARGIN_RAD - (q - lower[k]), 0.0) / STOP_MARGIN_RAD
        above = max(STOP_MARGIN_RAD - (upper[k] - q), 0.0) / STOP_MARGIN_RAD
        if below > 0.0 or above > 0.0:
            linear[k] -= STOP_PUSH_RAD_S * (below * below - above * above) / weight
    return -1
