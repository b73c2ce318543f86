"""What a joint may do in the next period: position, speed and acceleration limits as one interval.

The position bound is the speed from which the joint can still brake before its end stop, so it agrees with the
acceleration bound. Where the two disagree all the same (a joint put beyond its range), the position bound wins,
and the interval is never empty.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.gate_box import largest_stopping_speed


@part
def braking_speed(distance, deceleration, fastest, period):
    """Largest speed towards an end stop at a distance from which braking still fits, in whole periods; rad/s.

    Beyond the stop it is negative: the joint comes back within a period, or as fast as it can.
    """
    if distance < 0.0:
        return min(max(distance / period, -fastest), fastest)
    return min(largest_stopping_speed(distance, deceleration, period, 0.0), fastest)


@part
def joint_interval(q, lower, upper, fastest, acceleration, previous, period):
    """Smallest and largest speed (rad/s) of one joint in the next period.

    Both ends are clipped with the other end before it was clipped itself.
    """
    towards_low = braking_speed(q - lower, acceleration, fastest, period)
    towards_high = braking_speed(upper - q, acceleration, fastest, period)
    step = acceleration * period
    low = min(max(-towards_low, previous - step), towards_high)
    high = max(min(towards_high, previous + step), -towards_low)
    return low, high


@law
def joint_box(
    qpos, address, lower, upper, fastest, acceleration, previous, period, smallest, largest
):
    """Smallest and largest velocity of an arm's joints.

    Args:
        qpos: All joint positions of the cell.
        address: (n,) where the arm's are.
        lower, upper: (n,) ranges, rad.
        fastest: (n,) speed limits, rad/s.
        acceleration: (n,) limits, rad/s^2.
        previous: (n,) velocity from which the acceleration counts, rad/s.
        period: In s.
        smallest, largest: (n,) in rad/s, written.

    Returns:
        The first joint with a number that is not finite, -1 if there is none.
    """
    for k in range(len(address)):
        q = qpos[address[k]]
        if not math.isfinite(q + previous[k]):
            return k
        smallest[k], largest[k] = joint_interval(
            q, lower[k], upper[k], fastest[k], acceleration[k], previous[k], period
        )
    return -1


@law
def within_limits(
    qpos, address, lower, upper, fastest, acceleration, previous, wanted, period, allowed
):
    """What the joints' limits let through of a wanted velocity (n,); `allowed` (n,) is written. The rest as `joint_box`."""
    for k in range(len(address)):
        q = qpos[address[k]]
        if not math.isfinite(q + previous[k] + wanted[k]):
            return k
        low, high = joint_interval(
            q, lower[k], upper[k], fastest[k], acceleration[k], previous[k], period
        )
        allowed[k] = min(max(wanted[k], low), high)
    return -1


@law
def settle(velocity, smallest, largest, tolerance, settled):
    """What a solver found, within its box to the last bit, and on a bound where it is on it but for the tolerance.

    Whether a joint brakes as hard as it can must not depend on the last bit of an iteration.

    Args:
        velocity: (n,) found.
        smallest, largest: (n,) the box.
        tolerance: The solver's.
        settled: (n,) written.
    """
    for k in range(len(velocity)):
        settled[k] = velocity[k]
        if velocity[k] <= smallest[k] + tolerance:
            settled[k] = smallest[k]
        if velocity[k] >= largest[k] - tolerance:
            settled[k] = largest[k]
