"""Avoidance: what a support arm does where slowing down along its path is not enough.

    keep       leave the path where the joints cannot slow down as fast as the times to collision ask
    slide      get away from what was met, past what is near
    give_way   yield to another arm: back along the path if that is enough, else so that the near pairs open

Each looks for the velocity nearest to a preferred one that gives every pair the rate it needs
(docs/theory.md section 5), within the joint limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workcell.control.arm_constraints import Keeping
from workcell.control.laws.pair_rule import TASK_SLACK_M_S, smallest_rates
from workcell.control.laws.speed_scale import backing_factor
from workcell.control.strategy import ArmView
from workcell.guard.halt import brake

Array = NDArray[np.float64]


class Avoidance(NamedTuple):
    """A velocity, and what it means for the path."""

    velocity_rad_s: Array
    """(n,)"""
    factor: float
    """The share of the nominal velocity that it has; negative where the path is gone back."""
    forced: bool
    """Whether a time falls short all the same, for nothing but what the others do."""
    solved: bool = True
    """False where the solver failed and the arm brakes."""
    left_path: bool = True
    """Whether it is not along the nominal velocity."""
    missed_pair: int | None = None
    """While yielding, the pair that the joints cannot keep although nothing presses it; the worst one."""


def keep(view: ArmView, nominal_rad_s: Array, factor: float, infeasible: bool) -> Avoidance:
    """Leave the path where the joints cannot slow down along it as fast as the times to collision ask.

    One joint that already brakes as hard as it can keeps the factor up for all; the others can
    still do more. The tool comes back to its path by its own correction. A pair that
    standing does not keep is for giving way to; here it may only not be closed. So, too, where the
    joints cannot follow any factor: the command is what they can reach.

    Args:
        view: The arm.
        nominal_rad_s: (n,)
        factor: That has been granted of it.
        infeasible: Whether the joints can follow no factor.
    """
    velocity = factor * nominal_rad_s
    found = Avoidance(velocity, factor, False, left_path=False)
    if not infeasible and view.keeps(velocity):
        return found
    keeping = view.kept(velocity)
    if infeasible or keeping.needs_more.any():
        found = _leave_path(view, nominal_rad_s, velocity, keeping)
        keeping = view.kept(found.velocity_rad_s)
    if not keeping.short.any():
        view.remember_kept()
        return found
    return found._replace(forced=bool(keeping.others_alone[keeping.short].all()))


def slide(view: ArmView, nominal_rad_s: Array) -> Avoidance:
    """Get away from what was met: the motion nearest to the way back that closes no pair that is too near.

    Slowing down would not do: what is drawn out of a hand passes close by its fingers.
    """
    standing = view.kept(np.zeros_like(nominal_rad_s))
    found = _leave_path(view, nominal_rad_s, nominal_rad_s, standing)
    return found._replace(forced=bool(standing.allowance_m_s.min() < -TASK_SLACK_M_S))


def give_way(view: ArmView, nominal_rad_s: Array) -> Avoidance:
    """Yield: back along the path if that is enough, else so that the pressed pairs open.

    Times count to d_min here, so that an arm that can move fast enough is never nearer. Pressed are pairs that
    the arm answers for and that standing does not keep. All others come first: what stands, the arm itself, a third arm
    may not be closed below t_min to open a pressed pair, and is missed only by what the joints cannot do at all.
    """
    settings, moved = view.settings, view.moved
    rows = view.rows(moved)
    movable = rows.any(axis=1)  # what its own base comes near to is not in its power
    rows, pairs = rows[movable], moved[movable]
    needed = np.empty(len(pairs))
    smallest_rates(
        view.distance_m[pairs], view.other_m_s[pairs], settings.t_min_s, settings.d_min_m, needed
    )
    pressed = (needed > 0.0) & np.isin(pairs, view.owned)
    needed = np.where(pressed, needed, np.minimum(needed, 0.0))
    back = backing_factor(rows @ nominal_rad_s, needed)
    factor = 0.0 if math.isnan(back) else back
    velocity = view.evade(factor * nominal_rad_s, rows, needed, ~pressed)
    if velocity is None:
        return Avoidance(_braking(view), factor, True, False)
    missed = np.where(pressed, 0.0, needed - rows @ velocity)
    worst = int(missed.argmax()) if len(missed) else -1
    culprit = int(pairs[worst]) if worst >= 0 and missed[worst] > TASK_SLACK_M_S else None
    return Avoidance(velocity, factor, True, missed_pair=culprit)


def _leave_path(
    view: ArmView, nominal_rad_s: Array, preferred_rad_s: Array, keeping: Keeping
) -> Avoidance:
    """What is nearest to a preferred velocity (n,) among what gives each pair its needed rate.

    What the arm's own motion alone closes comes first: where the joints cannot keep every pair, the part of it that
    another arm's motion asks for is missed, never a pair that this arm would close below t_min were the other to stand.
    """
    rows, needed_m_s, hard = keeping.rows, keeping.needed_m_s, None
    others = view.other_m_s[view.owned]
    pressed = others < 0.0
    if pressed.any():
        # Without what the other does, the same pair asks for less.
        own = np.minimum(others - keeping.allowance_m_s, 0.0)[pressed]
        rows = np.concatenate([rows, rows[pressed]])
        needed_m_s = np.concatenate([needed_m_s, own])
        hard = np.concatenate([~pressed, np.ones(len(own), dtype=bool)])
    velocity, solved = view.evade(preferred_rad_s, rows, needed_m_s, hard), True
    if velocity is None:
        velocity, solved = _braking(view), False
    along = float(velocity @ nominal_rad_s) / max(float(nominal_rad_s @ nominal_rad_s), 1e-12)
    return Avoidance(velocity, min(1.0, max(0.0, along)), False, solved)


def _braking(view: ArmView) -> Array:
    return brake(view.command_rad_s, view.limits.acceleration_limit_rad_s2, view.period_s)
