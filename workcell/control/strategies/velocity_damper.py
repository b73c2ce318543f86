"""`velocity_damper`: least motion with a soft tool task under velocity-damper rows.

    minimise |x|² + w |J x - V|²  subject to  A x + b >= -(d - δ)/t_min,  lo <= x <= hi

B. Faverjon and P. Tournassoud, A local based approach for path planning of manipulators with a high
number of degrees of freedom, ICRA 1987; as in O. Kanoun, F. Lamiraux, P.-B. Wieber, 2011, and
J. Haviland and P. Corke (NEO), RA-L 2021. Their gain xi/(d_i - d_s) is 1/t_min. As published it knows the
arm's own motion only, b = 0; `mover = true` adds what the others are predicted to cause.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from workcell.control.strategies import common
from workcell.control.strategies.program import least_squares
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class VelocityDamper:
    """Trades the tool's path for clearance; the path's clock goes on within `deviation_m`."""

    class Options(common.DeviationOptions, frozen=True):
        """Options."""

        mover: bool = False
        """Whether the others' predicted rates count."""
        task_weight: float = Field(default=1e3, gt=0.0)
        """w: with 1e3 the tool gives way to least motion by a thousandth."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        options, rows = self._options, common.barrier(view, others=self._options.mover)
        low, high = view.box(view.command_rad_s)
        jacobian = view.tool_jacobian
        H = np.eye(len(low)) + options.task_weight * jacobian.T @ jacobian
        c = -options.task_weight * jacobian.T @ (jacobian @ view.task_rad_s)
        velocity = least_squares(H, c, rows.rows, rows.needed_m_s, low, high)
        return common.answer(
            view,
            velocity,
            view.task_rad_s,
            status="optimal",
            clock=common.clock_rate(view, options.deviation_m),
            limiting_pair=None if velocity is None else common.binding(rows, velocity),
            off_path_m=options.deviation_m,
        )
