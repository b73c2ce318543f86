"""What the controller keeps for one arm: what never changes, and a small memory of the last tick."""

from __future__ import annotations

from dataclasses import dataclass

import mink
import numpy as np
from numpy.typing import NDArray

from workcell.control.arm_constraints import ArmConstraints
from workcell.control.arm_criterion import ArmCriterion
from workcell.control.ik import ArmIk
from workcell.control.reach import Reach
from workcell.control.servo import ServoCommand
from workcell.control.tick import ArmTick, Steering
from workcell.motion.jobs import JobSequence
from workcell.motion.operators import make_operator
from workcell.motion.path import Target, standing
from workcell.motion.setpoint import Operator
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell
from workcell.scene.contacts import as_slice, window_name


@dataclass(slots=True)
class ArmMemory:
    """All that lasts of an arm from one tick to the next, its strategy's own memory apart."""

    target: Target
    """The last one."""
    command_rad_s: NDArray[np.float64]
    """(n,) last command, from which the joints' acceleration counts."""
    nominal_rad_s: NDArray[np.float64]
    """(n,) last nominal velocity, from which the nominal acceleration counts: a scaled arm stays on its path."""
    answer: Steering
    """What its strategy answered last."""
    approach_tried: bool = False
    """Whether another approach side has been tried since the strategy asks for one."""


class ControlledArm:
    """One arm of the controller.

    Args:
        cell: The cell.
        addresses: Of this arm.
        configuration: The controller's belief, at home.
    """

    def __init__(self, cell: Cell, addresses: ArmAddresses, configuration: mink.Configuration):
        control, dt, n = cell.scenario.control, cell.period_s, len(addresses.dofs)
        settings = next(arm for arm in cell.scenario.arm if arm.name == addresses.name)
        self.addresses = addresses
        self.name = addresses.name
        self.support = addresses.support
        self.task: str = settings.task
        """What of its tool's pose its operator and its jobs ask for, unless a job says otherwise."""
        self.self_motion: bool = settings.self_motion
        """Whether its null space may be used; otherwise it moves as little as its tool needs."""
        self.dofs = addresses.dofs
        self.columns = as_slice(addresses.dofs)
        """Where its joints are in a joint velocity of the whole cell."""
        self.configuration = configuration
        self.ik = ArmIk(
            addresses,
            nv=cell.model.nv,
            dt_s=dt,
            task_gain_per_s=control.task_gain_per_s,
            criterion_gain=control.criterion_gain,
        )
        self.criterion = ArmCriterion(cell.scenario, addresses.name)
        self.servo = ServoCommand(addresses, dt_s=dt)
        self.constraints: ArmConstraints
        """Its part of the watched pairs; another one whenever an instrument changes hands."""
        self.meeting_pairs: NDArray[np.intp] = np.array([], dtype=np.intp)
        """Pairs that its present job brings together."""
        self.meeting_key: object = None
        """The job's meeting and the holders for which they were looked up."""
        pose = configuration.get_transform_frame_to_world(addresses.tool_site_name, "site")
        position, wxyz = pose.translation(), pose.rotation().wxyz
        self.jobs: JobSequence | None = None
        self.operator: Operator | None = None
        if settings.job:
            self.jobs = JobSequence(
                settings.job,
                arm=addresses.name,
                position_m=position,
                wxyz=wxyz,
                d_min_m=control.d_min_m,
                repeat=settings.job_repeat,
            )
        elif settings.operator is not None:
            self.operator = make_operator(
                settings.operator,
                position,
                wxyz,
                seed=cell.scenario.simulation.seed,
                name=addresses.name,
                period_s=dt,
            )
        self.reach: Reach | None = None
        """Looks after targets that an operator asks for beyond the arm's reach."""
        if self.operator is not None:
            self.reach = Reach(
                cell.model, addresses, period_s=dt, gain_per_s=control.task_gain_per_s
            )
        base = cell.model.body_rootid[cell.model.site_bodyid[addresses.tool_site]]
        self.base_position_m = configuration.data.xpos[base].copy()
        still = np.zeros(n)
        self.memory = ArmMemory(standing(position, wxyz), still, still, Steering(still, still))

    @property
    def window(self) -> str | None:
        """Name of the final check's exemption that the present job holds open."""
        meeting = None if self.jobs is None else self.jobs.meeting
        if meeting is None:
            return None
        return window_name(self.name, meeting.arm or str(meeting.instrument))

    def remember(self, tick: ArmTick) -> None:
        """Keep what the next tick needs of this one."""
        memory, answer = self.memory, tick.steering
        memory.target, memory.answer = tick.setpoint.target, answer
        memory.nominal_rad_s, memory.command_rad_s = (
            answer.nominal_rad_s,
            tick.command.velocity_rad_s,
        )
