"""What every operator answers: the tool motion wanted at a time, and whether its input is sound.

An operator drives a priority arm. Whatever it is (a script, a file, a simulated or a real person),
it is asked once a tick, with the time of the run, and answers with a `Setpoint`. Its state has a name
for every fault an input can have, so that a log says why an arm stood still (docs/teleop.md).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from workcell.motion.path import Target

VALID = "valid"
"""The input is sound and is followed."""
WAITING = "waiting"
"""Nothing has come yet; the arm keeps the pose it starts with."""
ENDED = "ended"
"""The input is over; the arm keeps its last pose."""
GAP = "gap"
"""A recording has no samples for longer than its `gap_s`; the arm keeps the pose before the gap."""
STALE = "stale"
"""No sound sample for longer than `stale_s`."""
FROZEN = "frozen"
"""Samples keep coming, but with exactly the same pose for longer than `frozen_s`."""
REPEATED = "repeated"
"""A sample came twice."""
LATE = "late"
"""A sample was older than `late_s` when it came."""
OUT_OF_ORDER = "out_of_order"
"""A sample was older than the one before."""
JUMP = "jump"
"""The pose leapt farther than a hand can move."""
NOT_FINITE = "not_finite"
"""A sample holds NaN or infinity."""
NOT_UNIT = "not_unit"
"""The quaternion of a sample is not of length 1."""
CATCHING_UP = "catching_up"
"""The input is sound again, and the target is on its way back to it at limited speed."""

STATES = (
    VALID, WAITING, ENDED, GAP, STALE, FROZEN, REPEATED, LATE, OUT_OF_ORDER, JUMP, NOT_FINITE,
    NOT_UNIT, CATCHING_UP,
)  # fmt: skip
"""Every state there is."""


class Setpoint(NamedTuple):
    """What an operator wants at one tick."""

    target: Target
    """Tool pose and twist wanted."""
    doing: str
    """What the operator is doing, logged as the arm's job."""
    state: str = VALID
    """One of `STATES`."""
    elbow_speed_m_s: float = 0.0
    """Speed at which the elbow should swing about the line from base to tool, right-handed; the tool does not move with it."""
    joints_rad_s: NDArray[np.float64] | None = None
    """(n,) joint velocities to be commanded as they are; None where the target is to be followed."""


class Operator(Protocol):
    """Anything that knows the tool motion wanted at a time."""

    def setpoint(self, time_s: float) -> Setpoint:
        """The setpoint at a time of the run; asked once a tick, with rising times."""
        ...
