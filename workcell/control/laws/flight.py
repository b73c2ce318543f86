"""What a joint has ahead of it when its next command begins to act: the lag of its servo."""

from __future__ import annotations

from workcell.control.laws import law


@law
def ahead(
    q, last, period, lately, place, begins, drifts, largest_lag, uncertainty, total, reference,
    low, high,
):  # fmt: skip
    """Interval of displacements from the present position, and the servos' references a command later.

    A reference is the sum of all commands. It lies ahead of the joint by what its servo has not followed yet, but by no
    more than was commanded lately: what a standing joint sags below its reference is not ahead of it.

    Args:
        q: (n,) positions, rad.
        last: (n,) last command, rad/s.
        period: s.
        lately: (L, n) displacements commanded lately, in a ring; one is written.
        place: Which of them is the oldest.
        begins: Whether this is the first tick, at which references are where the joints are.
        drifts: (n,) where the sum of all commands drifts away from the joint: there nothing is ahead.
        largest_lag: Of a servo behind its reference, rad.
        uncertainty: Bound on the error of a measured position, rad, >= 0.
        total: (n,) sum of |displacement| over the ring, kept from tick to tick.
        reference: (n,) of the servos, kept from tick to tick.
        low, high: (n,) written, rad.
    """
    for k in range(len(q)):
        step = last[k] * period
        total[k] += abs(step) - abs(lately[place, k])
        lately[place, k] = step
        most = max(total[k], 0.0)
        way = 0.0 if begins else reference[k] + step - q[k]
        lag = largest_lag + most
        reference[k] = q[k] + min(max(way, -lag), lag)
        way = min(max(way, -most), most)
        if drifts[k]:
            way = 0.0
        low[k], high[k] = min(way, 0.0) - uncertainty, max(way, 0.0) + uncertainty
