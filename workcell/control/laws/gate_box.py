"""What a joint can follow, in whole periods: position, speed, acceleration and jerk as one interval of commands.

largest_stopping_speed   how fast a joint may turn with so much room ahead of its end stop
towards                  the way to a place, at a speed from which each joint still stops there
next_commands            interval of commands each joint may be given next
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part

POSITION, SPEED, ACCELERATION, JERK = 1, 2, 3, 4
"""What bounds an interval of `next_commands`."""


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
    if room == math.inf:
        return math.inf
    step = deceleration * period
    quanta, tau = room / (step * period), latency / period
    whole = math.floor(math.sqrt((0.5 + tau) ** 2 + 2.0 * quanta) - (0.5 + tau))
    used = whole * (whole + 1.0) / 2.0 + whole * tau
    return step * (whole + min(1.0, max(0.0, (quanta - used) / (whole + 1.0 + tau))))


@law
def towards(way, gain, deceleration, period, smallest, largest, velocity):
    """The next velocity of joints that go to a place and stop there.

    Args:
        way: (n,) what is left of the way.
        gain: Rate at which it is made good near the end, 1/s.
        deceleration: (n,) a > 0.
        period: s.
        smallest, largest: (n,) interval of the next command.
        velocity: (n,) out.
    """
    for k in range(len(way)):
        left = abs(way[k])
        speed = min(gain * left, largest_stopping_speed(left, deceleration[k], period, 0.0))
        velocity[k] = min(max(math.copysign(speed, way[k]), smallest[k]), largest[k])


@law
def next_commands(
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
