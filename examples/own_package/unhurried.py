"""A strategy in a package of its own: slows down along the path, with more time than `t_min_s` asks for.

Each pair that the arm closes at a = G x may close at (d - d_min)/T in all, the others' part b included:
s = min over these pairs of ((d - d_min)/T + b)/(-a), with T = `patience` times t_min.
"""

import numpy as np
from pydantic import BaseModel, Field

from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class Unhurried:
    """Stays on its path and never yields."""

    class Options(BaseModel, extra="forbid"):
        """What a scenario may set in `[strategy.unhurried]`."""

        patience: float = Field(2.0, ge=1.0, le=10.0)

    def __init__(self, setup: StrategySetup):
        self.patience = (setup.options or self.Options()).patience

    def steer(self, view: ArmView) -> Steering:
        nominal, pairs, settings = view.solve().velocity_rad_s, view.owned, view.settings
        own_m_s = view.rows(pairs) @ nominal
        standoff_m = np.where(np.isin(pairs, view.meeting), 0.0, settings.d_min_m)
        room_m_s = (view.distance_m[pairs] - standoff_m) / (self.patience * settings.t_min_s)
        closing = own_m_s < -1e-9  # numerically none below: nothing to slow down for
        share = (room_m_s + view.other_m_s[pairs])[closing] / -own_m_s[closing]
        scale = float(np.clip(share.min(initial=1.0), 0.0, 1.0))
        limiting = int(pairs[closing][share.argmin()]) if scale < 1.0 else None
        mode = "run" if limiting is None else "scale"
        return Steering(scale * nominal, nominal, scale, scale, mode, limiting_pair=limiting)


STRATEGIES = {"unhurried": Unhurried}  # so that the file alone works with --plugin as well
