"""An operator that repeats the joint motion of a recorded run, so that strategies race against the same arm.

A person who is replayed by the poses of the tool moves differently in another race: self-motion, limits
and the others' behaviour enter. Here the joint velocities that one arm was commanded come back tick
by tick, and with the same plant and period the arm moves as it did, to the last bit. With another
period the joints pass through the recorded positions, linear in between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.errors import InputError, TraceError
from workcell.motion.path import Target, standing
from workcell.motion.setpoint import ENDED, VALID, Setpoint
from workcell.trace.readings import joint_columns
from workcell.trace.table import load

START_TOLERANCE_RAD = 1e-6
"""How far home_rad may be off that of the recorded arm: what printing a number with seven digits loses."""
_SAME_PERIOD = 1e-9
"""Relative difference below which two periods are one."""
_TARGET = ("target_position_m", "target_wxyz", "target_velocity_m_s", "target_turn_rad_s")


class JointsOperator:
    """Repeats one arm's joint motion; its targets, which the joints need not reach, come along to be logged.

    Args:
        settings: From the scenario.
        arm: Name of the arm that moves.
        period_s: Control period.

    Raises:
        InputError: the run cannot be read, or has no such arm.
    """

    def __init__(self, settings: scenario.Joints, *, arm: str, period_s: float):
        run = _Recorded(settings, arm)
        self._period_s = period_s
        self._command_rad_s = run.command_rad_s(period_s)
        at = np.round(np.arange(len(self._command_rad_s)) * period_s / run.period_s).astype(int)
        self._target = [values[np.minimum(at, run.ticks - 1)] for values in run.target]
        self._still = np.zeros(self._command_rad_s.shape[1])

    def setpoint(self, time_s: float) -> Setpoint:
        tick, count = round(time_s / self._period_s), len(self._command_rad_s)
        position, wxyz, velocity, turn = (values[min(tick, count - 1)] for values in self._target)
        if tick >= count:
            return Setpoint(standing(position, wxyz), "joints", ENDED, joints_rad_s=self._still)
        target = Target(position, wxyz, velocity, turn)
        return Setpoint(target, "joints", VALID, joints_rad_s=self._command_rad_s[tick])


def faults(
    settings: scenario.Joints, arm: str, home_rad: tuple[float, ...], joints: tuple[str, ...]
) -> list[str]:
    """Why a recorded run cannot drive an arm; empty where it can.

    Args:
        settings: From the scenario.
        arm: Name of the arm that moves.
        home_rad: Its joint positions at the start.
        joints: Names of its joints, without the arm's own name.
    """
    try:
        run = _Recorded(settings, arm)
    except InputError as error:
        return list(error.faults)
    where = f"run = {settings.run!r}"
    if run.joints != joints:
        return [
            f"{where}: the joints of {run.arm} are {', '.join(run.joints)}; this arm has {', '.join(joints)}"
        ]
    off = [abs(then - now) for then, now in zip(run.home_rad, home_rad, strict=True)]
    k = int(np.argmax(off))
    if off[k] > START_TOLERANCE_RAD:
        return [
            f"{where}: {joints[k]} of {run.arm} began at {run.home_rad[k]:.7g} rad, home_rad has {home_rad[k]:.7g}; "
            "the arm must start where the recorded one did"
        ]
    return []


class _Recorded:
    """One arm of a recorded run; T ticks, n joints.

    Raises:
        InputError: the run cannot be read, or has no such arm.
    """

    def __init__(self, settings: scenario.Joints, arm: str):
        where = f"run = {settings.run!r}"
        try:
            trace = load(settings.run)
            dofs = joint_columns(trace, settings.arm or arm)
        except TraceError as error:
            raise InputError(f"{where}: {error}") from error
        arms = trace.layout.arms
        self.arm = settings.arm or arm
        if self.arm not in arms:
            raise InputError(
                f"{where}: has no arm {self.arm!r}; allowed for arm: {', '.join(arms)}"
            )
        recorded = trace.metadata["settings"]
        self.period_s = float(recorded["simulation"]["period_s"])
        self.ticks = len(trace)
        if not self.ticks:
            raise InputError(f"{where}: has no ticks")
        # Free joints, whose positions have one entry more than velocities, come after those of arms.
        self.home_rad: list[float] = np.asarray(trace["plant_qpos"])[0, dofs].tolist()
        self.joints = tuple(trace.layout.joints[dof].removeprefix(f"{self.arm}/") for dof in dofs)
        self._command_rad_s = np.asarray(trace["command_rad_s"])[:, dofs]
        self.target = [np.asarray(trace[f"{self.arm}.{name}"]) for name in _TARGET]

    def command_rad_s(self, period_s: float) -> NDArray[np.float64]:
        """(T', n) the commands at another period: the mean of each tick, so that the way stays the same."""
        if abs(self.period_s / period_s - 1.0) <= _SAME_PERIOD:
            return self._command_rad_s
        way_rad = np.vstack(
            [np.zeros(self._command_rad_s.shape[1]), np.cumsum(self._command_rad_s, axis=0)]
        )
        count = max(1, round(self.ticks * self.period_s / period_s))
        at, ticks = np.arange(count + 1) * period_s / self.period_s, np.arange(self.ticks + 1.0)
        passed = np.column_stack([np.interp(at, ticks, joint) for joint in way_rad.T])
        return np.diff(passed, axis=0) * (self.period_s / period_s)
