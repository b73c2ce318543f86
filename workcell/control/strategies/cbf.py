"""`cbf`: the least change to the nominal velocity that keeps every barrier.

    minimise |x - x0|²  subject to  ḋ = A x + b >= -(d - δ)/t_min,  lo <= x <= hi

x0 is the tool's task without a criterion, b what the others are predicted to cause. The barrier is
h = d - δ with the linear class-K function h/t_min. After A. Ames et al., Control Barrier Functions:
Theory and Applications, ECC 2019, in joint velocities as in D. Morton and M. Pavone, Safe,
Task-Consistent Manipulation with Operational Space Control Barrier Functions, 2025.
"""

from __future__ import annotations

from workcell.control.strategies import common
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class Cbf:
    """A barrier filter; it leaves the path, whose clock goes on within `deviation_m`."""

    Options = common.DeviationOptions

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        solution = common.nominal(view)
        rows = common.barrier(view, others=True)
        velocity = view.evade(solution.velocity_rad_s, rows.rows, rows.needed_m_s)
        return common.answer(
            view,
            velocity,
            solution.velocity_rad_s,
            status=solution.status,
            clock=common.clock_rate(view, self._options.deviation_m),
            limiting_pair=None if velocity is None else common.binding(rows, velocity),
            off_path_m=self._options.deviation_m,
        )
