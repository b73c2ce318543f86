"""The elbow as a wish of the null space: swing at an operator's speed, or push to one side.

The elbow moves sideways, about the line from base to tool, as far as the tool's task leaves it free.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.criteria import NullspaceObjective
from workcell.control.strategy import ArmView

ELBOW_PUSH = 0.25
"""Strength of the push to one side; chosen so that the elbow swings at about 0.5 rad/s at the default criterion gain."""
FIXED_ELBOW_M2 = 1e-6
"""Square of the lever (1 mm) below which no self-motion moves the elbow sideways."""


def push(view: ArmView, side: float) -> NullspaceObjective | None:
    """To the left (1) or to the right (-1); None for an arm without an elbow site."""
    if view.limits.elbow_site is None:
        return None
    return _preferring(side * ELBOW_PUSH * row(view))


def swing(view: ArmView) -> NullspaceObjective | None:
    """At the speed the operator asks for; None where it asks for nothing, or the arm has no elbow site."""
    speed_m_s = view.setpoint.elbow_speed_m_s
    if speed_m_s == 0.0 or view.limits.elbow_site is None:
        return None
    sideways, tool = row(view), view.tool_jacobian
    free = sideways - np.linalg.pinv(tool, rcond=1e-3) @ (tool @ sideways)
    mobility = float(free @ free)
    if mobility < FIXED_ELBOW_M2 or view.criterion_gain == 0.0:
        return _preferring(np.zeros_like(sideways))
    return _preferring(speed_m_s / (view.criterion_gain * mobility) * sideways)


def row(view: ArmView) -> NDArray[np.float64]:
    """(n,) speed of the elbow to the left for each joint's, as seen from the base towards the tool."""
    model, data, arm = view.configuration.model, view.configuration.data, view.limits
    body = model.site_bodyid[arm.elbow_site]
    base = data.xpos[model.body_rootid[body]]
    forward = data.site_xpos[arm.tool_site] - base
    left = np.array([-forward[1], forward[0], 0.0])
    left /= max(float(np.linalg.norm(left)), 1e-9)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, data.site_xpos[arm.elbow_site], body)
    return left @ jacobian[:, arm.dofs]


def _preferring(wish: NDArray[np.float64]) -> NullspaceObjective:
    """A null space that wants nothing but this, (n,)."""
    return NullspaceObjective(np.zeros((len(wish), len(wish))), -wish)
