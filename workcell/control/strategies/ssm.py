"""`ssm`: the terms of the protective separation distance, for two arms.

The largest s in [0, 1] for which, pair by pair,

    s c T_r + (s c)²/(2 a) + v_h (T_r + s c/a) <= d - δ

c is the arm's own closing speed at s = 1, a its deceleration along the closing direction, T_r the control
period plus `[control] reaction_s`, v_h the speed at which the other closes: predicted, or `other_speed_m_s`
where that is set (1.6 m/s is the walking speed of a person). Terms follow ISO 13855, ISO/TS 15066 and
ISO 10218-2:2025, which are written for people; nothing here complies with any of them.
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field

from workcell.control.strategies.paper_scaling import along_path
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Array, Steering


class Ssm:
    """Slows down along the path, which it never leaves."""

    class Options(BaseModel, extra="forbid", frozen=True):
        """Options."""

        other_speed_m_s: float | None = Field(default=None, ge=0.0)
        """Closing speed of every other; None takes what is predicted of each."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()
        self._reaction_s = setup.period_s + setup.settings.reaction_s

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        solution, settings = view.solve(), view.settings
        nominal, pairs = solution.velocity_rad_s, view.owned
        rows = view.rows(pairs)
        own = rows @ nominal
        gap = view.distance_m[pairs] - np.where(np.isin(pairs, view.meeting), 0.0, settings.d_min_m)
        other = self._options.other_speed_m_s
        coming = np.full(len(pairs), other) if other is not None else -view.other_m_s[pairs]
        scale = largest_scale(
            np.maximum(gap, 0.0),
            np.maximum(-own, 0.0),
            np.abs(rows) @ view.limits.acceleration_limit_rad_s2,
            np.maximum(coming, 0.0),
            self._reaction_s,
        )
        if not len(pairs) or scale.min() >= 1.0:
            return along_path(view, nominal, 1.0, None, solution.status)
        worst = int(np.argmin(scale))
        return along_path(view, nominal, float(scale[worst]), int(pairs[worst]), solution.status)


def largest_scale(
    gap_m: Array, closing_m_s: Array, deceleration_m_s2: Array, other_m_s: Array, reaction_s: float
) -> Array:
    """(R,) the largest s in [0, 1] for each pair; 1 where the arm closes nothing.

    With z = s c the condition is z²/(2a) + z (T_r + v_h/a) + v_h T_r - gap <= 0, a quadratic in z.

    Args:
        gap_m: (R,) distance above the standoff, >= 0.
        closing_m_s: (R,) own closing speed at s = 1, >= 0.
        deceleration_m_s2: (R,) a, > 0 where the arm closes.
        other_m_s: (R,) v_h >= 0.
        reaction_s: T_r > 0.
    """
    a = np.where(closing_m_s > 0.0, deceleration_m_s2, 1.0)
    linear = reaction_s + other_m_s / a
    room = np.maximum(gap_m - other_m_s * reaction_s, 0.0)
    # 2 room / (linear + sqrt(...)) is the positive root without the cancellation of -linear + sqrt(...).
    speed = 2.0 * room / (linear + np.sqrt(linear**2 + 2.0 * room / a))
    return np.where(closing_m_s > 0.0, np.minimum(1.0, speed / np.maximum(closing_m_s, 1e-12)), 1.0)
