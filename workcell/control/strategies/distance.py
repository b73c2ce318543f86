"""`distance`: slow down with the smallest distance, whatever moves where.

    x = s x0,  s linear from 0 at d_min to 1 at `slow_distance_m`

What the collision slowing of MoveIt Servo does, in spirit. An arm that leaves is slowed down as well as
one that comes; pairs that are to meet do not count, since the arm would never get there.
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field

from workcell.control.scaling import slow_near
from workcell.control.strategies.paper_scaling import along_path
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class Distance:
    """Slows down along the path, which it never leaves."""

    class Options(BaseModel, extra="forbid", frozen=True):
        """Options."""

        slow_distance_m: float = Field(default=0.15, gt=0.0)
        """Distance from which the arm slows down; 0.15 m is the tool's way in t_min = 1 s at 0.15 m/s."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        solution, settings = view.solve(), view.settings
        pairs = view.owned[~np.isin(view.owned, view.meeting)]
        slow_m = max(self._options.slow_distance_m, 1.001 * settings.d_min_m)
        bound = slow_near(view.distance_m[pairs], settings.d_min_m, slow_m)
        limiting = int(pairs[bound.pair]) if bound.pair >= 0 else None
        return along_path(view, solution.velocity_rad_s, bound.factor, limiting, solution.status)
