"""Commands from outside: what a learner, a script or a person asks of an arm in the place of its strategy.

In: joint velocities or a tool twist, for one tick. Out: a `Steering` like a strategy's, within the joints' limits.
Everything behind it stays as it is: the final check's stop comes first, and the gate looks at what is asked, of a priority
arm, too.
The path of a support arm stands still meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.arm import ControlledArm
from workcell.control.finite import vector
from workcell.control.strategy import ArmView
from workcell.control.tick import Steering
from workcell.errors import ControlFault
from workcell.motion.path import Target

Array = NDArray[np.float64]

REASON = "commanded"
"""Reason of an arm that does what was asked from outside."""


@dataclass(frozen=True)
class Twist:
    """Motion of a tool, in the world frame; the joints do the least that gives it."""

    velocity_m_s: ArrayLike
    """(3,) of the tool point."""
    angular_velocity_rad_s: ArrayLike = (0.0, 0.0, 0.0)
    """(3,)"""


def checked(arm: str, joints: int, wanted: ArrayLike | Twist) -> Array | Twist:
    """A command as arrays.

    Args:
        arm: Name of the arm.
        joints: How many joints it has.
        wanted: (n,) joint velocities in 1/s times rad or m, or a twist.

    Raises:
        InputError: A shape is another, or a number is not finite.
    """
    if isinstance(wanted, Twist):
        return Twist(
            vector(f"velocity_m_s of {arm}", wanted.velocity_m_s, 3),
            vector(f"angular_velocity_rad_s of {arm}", wanted.angular_velocity_rad_s, 3),
        )
    return np.array(vector(f"command of {arm}", wanted, joints))


def commanded(arm: ControlledArm, view: ArmView, wanted: Array | Twist) -> Steering:
    """The answer that does what was asked, as far as the joints can.

    Raises:
        ControlFault: The state is not finite.
    """
    try:
        nominal = _of_twist(arm, view, wanted) if isinstance(wanted, Twist) else wanted
        velocity = arm.ik.followed(view.configuration, view.command_rad_s, nominal)
    except FloatingPointError as error:
        raise ControlFault(view.sensed.tick, str(error)) from error
    return Steering(
        velocity,
        nominal,
        clock_rate=0.0,
        mode="run",
        reason=REASON,
        ik_status="not_solved",
        path="pause",
    )


def _of_twist(arm: ControlledArm, view: ArmView, wanted: Twist) -> Array:
    """(n,) the least joint motion that moves the tool as wanted."""
    here = Target(
        view.seen.tool_position_m,
        view.seen.tool_wxyz,
        np.asarray(wanted.velocity_m_s),
        np.asarray(wanted.angular_velocity_rad_s),
    )
    return arm.ik.aim(view.configuration, here)
