"""Is d_min large enough for a stop: the sizing rule of docs/final_check.md, held against the speeds a scenario allows.

    d_min >= c (every_ticks + 1) dt + c² / (2 a) + what comes meanwhile,   c closing speed, a deceleration

A stop from a larger closing speed than the rule allows ends after contact: it is late. The rule is told, not
enforced: scaling makes speeds small near contact, and the check is there for when it does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import mujoco
import numpy as np

from workcell.scenario import Wait
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell


def needed_m(closing_m_s: float, deceleration_m_s2: float, look_s: float) -> float:
    """Distance at which a stop must be called for so that it ends before contact, other things standing, m.

    Args:
        closing_m_s: c >= 0.
        deceleration_m_s2: a > 0, along the closing direction.
        look_s: Time that may pass until the joints begin to brake: a look and a tick.
    """
    return closing_m_s * look_s + closing_m_s**2 / (2.0 * deceleration_m_s2)


def largest_closing_m_s(d_min_m: float, deceleration_m_s2: float, look_s: float) -> float:
    """The inverse: the closing speed from which a stop called for at d_min just ends before contact, m/s."""
    a = deceleration_m_s2
    return math.sqrt((a * look_s) ** 2 + 2.0 * a * d_min_m) - a * look_s


def deceleration_m_s2(cell: Cell, arm: ArmAddresses) -> float:
    """What the joints can give the tool in the least favourable of the axis directions, at home, m/s²."""
    model, data = cell.model, mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, arm.tool_site)
    per_speed = np.abs(np.linalg.pinv(jacobian[:, arm.dofs], rcond=1e-3))
    with np.errstate(divide="ignore"):
        return float(np.min(arm.acceleration_limit_rad_s2[:, None] / per_speed))


def late_stops(cell: Cell) -> Iterator[str]:
    """A sentence for each support arm whose stop would be late from the speeds that the scenario allows it."""
    scenario = cell.scenario
    check, control = scenario.check, scenario.control
    if not check.enabled:
        return
    d_min_m = control.d_min_m if check.d_min_m is None else check.d_min_m
    look_s = (check.every_ticks + 1) * cell.period_s
    for arm, addresses in zip(scenario.arm, cell.arms, strict=True):
        jobs = [job.speed_m_s for job in arm.job if not isinstance(job, Wait)]
        if not jobs:
            continue
        a = deceleration_m_s2(cell, addresses)
        allowed = largest_closing_m_s(d_min_m, a, look_s)
        speeds = {"along its path": max(jobs)}
        cap = getattr(control, "point_speed_m_s", None)
        if cap is not None:
            speeds["at the cap on the speed of its points"] = float(cap)
        late = [
            f"{speed:.3g} m/s {what} asks for {1e3 * needed_m(speed, a, look_s):.0f} mm"
            for what, speed in speeds.items()
            if speed > allowed
        ]
        if late:
            yield (
                f"final check, d_min {1e3 * d_min_m:.3g} mm: a stop of {arm.name} that closes faster than {allowed:.3g} m/s ends "
                f"after contact; {', '.join(late)}"
            )
