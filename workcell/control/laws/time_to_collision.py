"""Time to collision (docs/theory.md section 4, paper equations 7 to 13).

The working quantity is kappa = 1/t, which stays bounded where t does not: 0 when a pair never meets,
infinite when it has met. First order is t = -d/d' (8); second order is the smallest positive
root of d''/2 t^2 + d' t + d = 0 (11).
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part

GRAZING_TOLERANCE = 1e-12
"""Relative size of a negative discriminant that still counts as a double root.

Two motions that just touch have discriminant zero, which rounding turns into some 1e-16 of either
sign. Chosen far above that, so that touching counts as a collision.
"""


@part
def first_order(distance, rate, standoff):
    """kappa = max(0, -rate/(distance - standoff)) in 1/s, infinite for a pair that has met."""
    gap = distance - standoff
    if distance <= 0.0 or (gap <= 0.0 and rate < 0.0):
        return math.inf
    return -rate / gap if rate < 0.0 else 0.0


@part
def second_order(distance, rate, accel, standoff):
    """The largest root kappa of gap kappa^2 + rate kappa + accel/2 = 0 in 1/s, infinite for a pair that has met.

    For rate > 0 the same root is -accel / (rate + sqrt(...)), so neither form subtracts like numbers, and
    accel -> 0 goes over into the first order. Complex roots mean that the pair turns round in time. The
    terms of the discriminant are divided by the larger one's size, so that squaring neither
    overflows nor underflows.
    """
    gap = distance - standoff
    if distance <= 0.0 or (gap <= 0.0 and (rate < 0.0 or (rate == 0.0 and accel < 0.0))):
        return math.inf
    if gap <= 0.0:
        return 0.0
    curvature = math.sqrt(abs(accel)) * math.sqrt(gap)
    size = max(abs(rate), curvature)
    if size == 0.0:
        return 0.0
    speed, bend = rate / size, curvature / size
    direction = 1.0 if accel > 0.0 else (-1.0 if accel < 0.0 else 0.0)
    discriminant = speed * speed - 2.0 * direction * (bend * bend)
    if discriminant < -GRAZING_TOLERANCE:
        return 0.0
    root = math.sqrt(max(discriminant, 0.0))
    if speed > 0.0:
        return max(-accel / (size * (root + speed)), 0.0)
    return max(size * (root - speed) / (2.0 * gap), 0.0)


@law
def reciprocal_first_order(distance, rate, standoff, kappa):
    """`first_order` of every pair: distance (P,), rate (P,), kappa (P,) written."""
    for pair in range(len(kappa)):
        kappa[pair] = first_order(distance[pair], rate[pair], standoff)


@law
def reciprocal_second_order(distance, rate, accel, standoff, kappa):
    """`second_order` of every pair: distance, rate, accel (P,), kappa (P,) written."""
    for pair in range(len(kappa)):
        kappa[pair] = second_order(distance[pair], rate[pair], accel[pair], standoff)


@law
def smallest(kappa):
    """The shortest time (s) and its pair, the lowest among equals.

    Args:
        kappa: (P,) in 1/s.

    Returns:
        The time, infinite where nothing is on a collision course; the pair, -1 there; and the first entry
        that is NaN or negative, -1 if there is none.
    """
    largest, which = 0.0, -1
    for pair in range(len(kappa)):
        value = kappa[pair]
        if not value >= 0.0:
            return 0.0, -1, pair
        if value > largest:
            largest, which = value, pair
    ttc, which = time_of(largest, which)
    return ttc, which, -1


@part
def time_of(kappa, pair):
    """The time 1/kappa and its pair; none where the time is beyond the range of floats."""
    ttc = 1.0 / kappa if kappa > 0.0 else math.inf
    return ttc, (pair if ttc < math.inf else -1)


@law
def rates(jacobian, distance, velocity, accel, order, inactive, owner, part_of_arm, rate):
    """What a velocity of all joints does to all pairs: d' = G q', and the shortest time.

    Args:
        jacobian: G (P, nv).
        distance: (P,).
        velocity: (nv,).
        accel: d'' (P,) for times of second order, read only there.
        order: 1 or 2.
        inactive: (P,) pairs that do not count now.
        owner: (nv,) number of the arm that a joint belongs to, -1 for none.
        part_of_arm: (arms,) written: what each arm does to the pair that would meet first.
        rate: (P,) written.

    Returns:
        The shortest time in s, its pair (-1: none), the nearest pair that counts, the arm that closes the first pair
        most (-1: none); and the first pair with a number that is not finite, -1 if there is none.
    """
    most, least, first, nearest = 0.0, math.inf, -1, 0
    for pair in range(len(rate)):
        total = 0.0
        for joint in range(len(velocity)):
            total += jacobian[pair, joint] * velocity[joint]
        d = distance[pair]
        if not math.isfinite(total + d):
            return 0.0, -1, 0, -1, pair
        rate[pair] = total
        if inactive[pair]:
            continue
        if d < least:
            least, nearest = d, pair
        if order == 2:
            if not math.isfinite(accel[pair]):
                return 0.0, -1, 0, -1, pair
            kappa = second_order(d, total, accel[pair], 0.0)
        else:
            kappa = first_order(d, total, 0.0)
        if kappa > most:
            most, first = kappa, pair
    ttc, first = time_of(most, first)
    cause = -1
    if first >= 0:
        part_of_arm[:] = 0.0
        for joint in range(len(velocity)):
            if owner[joint] >= 0:
                part_of_arm[owner[joint]] += jacobian[first, joint] * velocity[joint]
        cause = 0
        for arm in range(1, len(part_of_arm)):
            if part_of_arm[arm] < part_of_arm[cause]:
                cause = arm
    return ttc, first, nearest, cause, -1
