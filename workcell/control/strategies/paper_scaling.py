"""`paper_scaling`: the paper's speed scaling alone.

    x = s x0,  s = min(1, t*/t_min)        equation (16)

t* is the smallest first-order time to collision over the pairs that the arm closes; with
`[control] variant = "static"` the other arms count as standing, as in equations (12), (13). No yielding,
no recovery; the criterion of the scenario chooses the self-motion. A. Spencer, M. Pryor, C. Kapoor,
D. Tesar, ICRA 2008.
"""

from __future__ import annotations

import numpy as np

from workcell.control.strategies import common
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering
from workcell.control.ttc import reciprocal_first_order


class PaperScaling:
    """Slows down along the path, which it never leaves."""

    def __init__(self, setup: StrategySetup):
        pass

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        solution, settings = view.solve(), view.settings
        nominal, pairs = solution.velocity_rad_s, view.owned
        scale, limiting = 1.0, None
        if len(pairs):
            own = view.rows(pairs) @ nominal
            rate = own + view.other_m_s[pairs]
            kappa = reciprocal_first_order(view.distance_m[pairs], rate)
            kappa = np.where(
                own < 0.0, kappa, 0.0
            )  # what the arm does not close, slowing down does not open
            worst = int(np.argmax(kappa))
            if kappa[worst] * settings.t_min_s > 1.0:
                scale, limiting = float(1.0 / (kappa[worst] * settings.t_min_s)), int(pairs[worst])
            reached = (view.distance_m[pairs] <= settings.d_min_m) & (own < 0.0)
            reached &= ~np.isin(pairs, view.meeting)
            if reached.any():
                scale, limiting = 0.0, int(pairs[np.flatnonzero(reached)[0]])
        return along_path(view, nominal, scale, limiting, solution.status)


def along_path(view: ArmView, nominal, scale: float, limiting: int | None, status: str) -> Steering:
    """The answer of a strategy that only slows down."""
    return Steering(
        scale * nominal,
        nominal,
        clock_rate=scale,
        scale=scale,
        mode=common.finished(view) or ("run" if limiting is None else "scale"),
        reason="" if limiting is None else "ttc",
        limiting_pair=limiting,
        ik_status=status,
    )
