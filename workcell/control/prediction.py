"""What an arm is predicted to do: velocity hypotheses, from which others predict rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell.control.arm import ControlledArm
from workcell.control.tick import ArmSetpoint
from workcell.control.watched import Watched


def predict(watched: Watched, arm: ControlledArm, setpoint: ArmSetpoint) -> None:
    """Before any arm is steered.

    A support arm is taken to go on as last commanded. A priority arm goes towards what its operator asks as far
    as its joints can within this tick, or on as last commanded: it may be kept from doing at once what it is asked. What the
    joints cannot do is never counted on, however fast a hand moves or how far beyond reach it is. Self-motion
    that helps others is not predicted; what it may take back within the tick is not counted on.
    """
    hypotheses, command = watched.hypotheses_rad_s, arm.memory.command_rad_s
    watched.change_rad_s[arm.columns] = arm.addresses.acceleration_limit_rad_s2 * arm.ik.dt_s
    if arm.support:
        hypotheses[:, arm.columns] = command
        return
    hypotheses[1, arm.columns] = command
    if setpoint.joints_rad_s is not None:
        hypotheses[0, arm.columns] = hypotheses[2, arm.columns] = setpoint.joints_rad_s
        watched.change_rad_s[arm.columns] = 0.0
        return
    # Joint by joint is not how the arm itself will give way to its limits.
    followed, given_way = arm.ik.predicted(arm.configuration, command, setpoint.task_rad_s)
    hypotheses[0, arm.columns], hypotheses[2, arm.columns] = followed, given_way


def settle(watched: Watched, arm: ControlledArm, command_rad_s: NDArray[np.float64]) -> None:
    """Once an arm has its command, (n,), the arms after it take that as its only hypothesis."""
    watched.hypotheses_rad_s[:, arm.columns] = command_rad_s
    watched.change_rad_s[arm.columns] = 0.0
