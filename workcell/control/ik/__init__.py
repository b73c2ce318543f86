"""Inverse kinematics: the program of one arm, its solver, and its parts as mink's tasks and limits."""

from workcell.control.ik.aim import DIRECTIONS
from workcell.control.ik.mink_tasks import CriterionTask, JointLimit, ToolTask, TtcLimit
from workcell.control.ik.solve import (
    OPTIMAL,
    STOPPED,
    TASK_ONLY,
    TASK_SOFT,
    ArmIk,
    IkSolution,
)

__all__ = [
    "DIRECTIONS",
    "OPTIMAL",
    "STOPPED",
    "TASK_ONLY",
    "TASK_SOFT",
    "ArmIk",
    "CriterionTask",
    "IkSolution",
    "JointLimit",
    "ToolTask",
    "TtcLimit",
]
