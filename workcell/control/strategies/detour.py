"""Past an obstacle with the tool off its path: the `detour` attempt against an impasse.

    minimise |x - x0|²  subject to  ḋ = A x + b >= -(d - δ)/t_min,  lo <= x <= hi

δ is the larger of standoff and d_min, and half of d_min more. x0 is the nominal velocity, b what the others are predicted to cause (docs/theory.md section 5). The path's clock goes on, so that the
target gets past the obstacle though the tool cannot follow it; it slows down as the tool comes near `detour_m`
off its path, and stands there.
"""

from __future__ import annotations

from workcell.control.ik import IkSolution
from workcell.control.recovery import DETOUR
from workcell.control.strategies import common
from workcell.control.strategy import ArmView
from workcell.control.tick import Steering

MARGIN = 0.5
"""Part of d_min that is kept beyond it or the standoff; chosen above what the bend of a surface that it slides along costs in a
tick: 0.3 mm of a d_min of 10 mm at the slowest tick, 20 ms, in `handover`."""


def pass_by(view: ArmView, solution: IkSolution) -> Steering:
    """The answer of an arm that is on a detour.

    Args:
        view: The arm; `settings.detour_m` must be above 0.
        solution: Of its tool's task and its criterion.
    """
    detour_m = view.settings.detour_m
    settings = view.settings
    margin_m = max(settings.standoff_m - settings.d_min_m, 0.0) + MARGIN * settings.d_min_m
    rows = common.barrier(view, others=True, margin_m=margin_m)
    velocity = view.evade(solution.velocity_rad_s, rows.rows, rows.needed_m_s)
    answer = common.answer(
        view,
        velocity,
        solution.velocity_rad_s,
        status=solution.status,
        clock=common.clock_rate(view, detour_m),
        limiting_pair=None if velocity is None else common.binding(rows, velocity),
        off_path_m=detour_m,
    )
    return answer._replace(attempt=DETOUR)
