"""`NAME`: a strategy of your own. Change `steer`, then race it against the others.

    workcell run planar_crossing --plugin NAME.py --set control.strategy=NAME
    workcell race planar_crossing --plugin NAME.py --strategies NAME,ttc --runs 10
"""

from pydantic import BaseModel, Field

from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Steering


class Strategy:
    """Slows down with the nearest pair, and stands at `stop_m`."""

    class Options(BaseModel, extra="forbid"):
        """What a scenario may set in `[strategy.NAME]`."""

        stop_m: float = Field(0.05, ge=0.0)
        slow_m: float = Field(0.25, gt=0.0)

    def __init__(self, setup: StrategySetup):
        self.options = setup.options or self.Options()

    def steer(self, view: ArmView) -> Steering:
        nominal = view.solve().velocity_rad_s  # follows the path, before anything is looked at
        near = view.distance_m[view.owned].min() if len(view.owned) else float("inf")
        share = (near - self.options.stop_m) / (self.options.slow_m - self.options.stop_m)
        scale = float(min(1.0, max(0.0, share)))
        return Steering(
            velocity_rad_s=scale * nominal,
            nominal_rad_s=nominal,
            clock_rate=scale,
            scale=scale,
            mode="run" if scale == 1.0 else "scale",
        )


STRATEGIES = {"NAME": Strategy}
