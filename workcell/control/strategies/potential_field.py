"""`potential_field`: Khatib's repulsion, in velocities.

    V' = J x0 + Σ eta (1/d - 1/d0)/d² ∂d/∂p  over pairs nearer than d0, applied in the joints

Each near pair pushes its own witness point; a push at a point is Gᵀ in the joints. The tool follows
its path as far as the pushes let it. O. Khatib, Real-Time Obstacle Avoidance for Manipulators and
Mobile Robots, IJRR 1986, resolved to velocities. d0 is the tool's way in t_min at its nominal speed, at
least twice d_min, so that both laws look equally far ahead.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from workcell.control.strategies import common
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class PotentialField:
    """Is pushed off its path, whose clock goes on within `deviation_m`; guarantees nothing."""

    class Options(common.DeviationOptions, frozen=True):
        """Options."""

        reach_m: float = Field(default=0.15, gt=0.0)
        """d0: distance from which a pair pushes; 0.15 m is the way in t_min = 1 s at 0.15 m/s."""
        push_m_s: float = Field(default=0.15, gt=0.0)
        """Speed of the push at a third of d0, chosen as the tool's own speed."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        options, solution = self._options, common.nominal(view)
        pairs = view.moved[~np.isin(view.moved, view.meeting)]
        distance = np.maximum(view.distance_m[pairs], view.settings.d_min_m / 2.0)
        near = distance < options.reach_m
        rows = view.rows(pairs[near])
        strength = (1.0 / distance[near] - 1.0 / options.reach_m) / distance[near] ** 2
        # eta makes the push `push_m_s` at d0/3: (3 - 1)/d0 * 9/d0² = 18/d0³.
        eta = options.push_m_s * options.reach_m**3 / 18.0
        lever = np.maximum((rows * rows).sum(axis=1), 1e-4)[:, None]  # G Gᵀ: from a speed to joints
        push = (eta * strength) @ (rows / lever)
        low, high = view.box(view.command_rad_s)
        velocity = np.clip(solution.velocity_rad_s + push, low, high)
        pushed = bool(near.any() and np.abs(push).max() > 1e-4)
        return common.answer(
            view,
            velocity,
            solution.velocity_rad_s,
            status=solution.status,
            clock=common.clock_rate(view, options.deviation_m),
            limiting_pair=int(pairs[int(np.argmin(view.distance_m[pairs]))]) if pushed else None,
            off_path_m=options.deviation_m,
        )
