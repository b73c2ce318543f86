"""`joint_qp`: one program over the joints of all arms.

    minimise  Σ |x_a|² + w_a |J_a x_a - V_a|²   over all arms a
    subject to  G x >= -(d - δ)/t_min  for every watched pair,  lo <= x <= hi

w is 1e3 for support arms and 1e6 for priority arms, whose tools give way by as much: they are held to a
fraction of a millimetre, not exactly, and the race's column of their tool error says by how much. The joints of a
priority arm with `self_motion = false` do what its tool needs, and are no variables of the program. As in the
two-arm examples of Pink and mink. With `criterion = true` the signed ARTC of all pairs is added.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from workcell.control.laws.pair_rule import smallest_rates
from workcell.control.strategies import common
from workcell.control.strategies.program import least_squares
from workcell.control.strategy import CellView, StrategySetup
from workcell.control.tick import Steering


class JointQp:
    """Steers all arms of a cell at once."""

    class Options(common.DeviationOptions, frozen=True):
        """Options."""

        task_weight: float = Field(default=1e3, gt=0.0)
        """w of support arms."""
        priority_weight: float = Field(default=1e6, gt=0.0)
        """w of priority arms."""
        criterion: bool = False
        """Whether the average reciprocal time to collision is minimised in the null spaces."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()
        self._gain = setup.settings.criterion_gain

    def steer_all(self, view: CellView) -> dict[str, Steering]:
        """See `strategy.CellStrategy`."""
        options = self._options
        views = list(view.arms.values())
        settings = views[0].settings
        dofs = np.concatenate([arm.dofs for arm in views])
        rows = view.jacobian[:, dofs]
        meeting = np.unique(np.concatenate([arm.meeting for arm in views])).astype(int)
        standoff = np.full(len(rows), settings.d_min_m)
        standoff[meeting] = 0.0
        counts = rows.any(axis=1) & ~view.inactive
        needed = np.empty(len(rows))
        smallest_rates(
            view.distance_m - standoff, np.zeros(len(rows)), settings.t_min_s, 0.0, needed
        )
        barrier = common.Barrier(rows[counts], needed[counts], np.flatnonzero(counts))
        n = len(dofs)
        H, c = np.eye(n), np.zeros(n)
        low, high = np.zeros(n), np.zeros(n)
        parts, start = {}, 0
        for name, arm in view.arms.items():
            part = slice(start, start + len(arm.dofs))
            parts[name], start = part, part.stop
            weight = options.task_weight if arm.limits.support else options.priority_weight
            jacobian = arm.tool_jacobian
            H[part, part] += weight * jacobian.T @ jacobian
            c[part] -= weight * jacobian.T @ (jacobian @ arm.task_rad_s)
            low[part], high[part] = arm.box(arm.command_rad_s)
            if not arm.limits.support and not arm.self_motion:
                # Its joints do what its tool needs and nothing else: no elbow to make way with.
                task = np.clip(arm.task_rad_s, low[part], high[part])
                low[part], high[part] = task, task
        if options.criterion and len(barrier.pairs):
            distance = np.maximum(view.distance_m[counts], settings.d_min_m)
            c -= self._gain / len(distance) * (1.0 / distance) @ barrier.rows
        found = least_squares(H, c, barrier.rows, barrier.needed_m_s, low, high)
        limiting = None if found is None else common.binding(barrier, found)
        return {
            name: common.answer(
                arm,
                None if found is None else found[parts[name]],
                arm.task_rad_s,
                status="optimal",
                clock=common.clock_rate(arm, options.deviation_m),
                limiting_pair=limiting,
                off_path_m=options.deviation_m,
            )
            for name, arm in view.arms.items()
        }
