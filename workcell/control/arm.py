"""What the controller keeps for one arm: its solver, its driver, its part of the watched pairs."""

from __future__ import annotations

import mink
import numpy as np
from numpy.typing import NDArray

from workcell.control.ik import ArmIk
from workcell.control.ladder import Ladder
from workcell.control.scaling import FactorGovernor
from workcell.control.servo import ServoCommand
from workcell.control.share import Share
from workcell.motion.jobs import JobSequence
from workcell.motion.operators import make_operator
from workcell.motion.path import Target, standing
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell


class ControlledArm:
    """What the controller keeps for one arm: its part of the pairs, its solver, its driver."""

    def __init__(self, cell: Cell, addresses: ArmAddresses, configuration: mink.Configuration):
        control, dt, nv = cell.scenario.control, cell.period_s, cell.model.nv
        settings = next(arm for arm in cell.scenario.arm if arm.name == addresses.name)
        self.addresses = addresses
        self.dofs = addresses.dofs
        self.columns = _columns(addresses.dofs)
        """Where they are in a joint velocity of the whole cell."""
        self.support = bool(settings.job)
        self.ik = ArmIk(
            addresses,
            nv=nv,
            dt_s=dt,
            task_gain_per_s=control.task_gain_per_s,
            criterion_gain=control.criterion_gain,
        )
        self.servo = ServoCommand(addresses, dt_s=dt)
        self.ladder = Ladder(period_s=dt, yields=control.yields, resolves=control.resolves_impasse)
        self.attempt = ""
        self.governor = FactorGovernor(rise_per_s=1.0 / control.rise_time_s, period_s=dt)
        pose = configuration.get_transform_frame_to_world(addresses.tool_site_name, "site")
        position, wxyz = pose.translation(), pose.rotation().wxyz
        self.jobs = (
            JobSequence(
                settings.job,
                arm=addresses.name,
                position_m=position,
                wxyz=wxyz,
                d_min_m=control.d_min_m,
                repeat=settings.job_repeat,
            )
            if self.support
            else None
        )
        self.operator = (
            None
            if settings.operator is None
            else make_operator(
                settings.operator,
                position,
                wxyz,
                seed=cell.scenario.simulation.seed,
                name=addresses.name,
                period_s=dt,
            )
        )
        self.share: Share
        """Its part of the watched pairs, dealt out by the controller."""
        self.target: Target = standing(position, wxyz)
        self.elbow_speed_m_s = 0.0
        """Speed at which the operator wants the elbow to swing to the left."""
        self.command_rad_s = self.command_before_rad_s = np.zeros(len(addresses.dofs))
        """(n,) commanded now, and in the tick before."""
        self.wanted_rad_s = np.zeros(len(addresses.dofs))
        self.task_rad_s = self.followed_rad_s = np.zeros(len(addresses.dofs))
        """(n,) the smallest motion that does what the target asks, and what the joint limits let through of it."""
        self.factor = 1.0
        self.paused = False
        """Whether the path stands still while self-motion is tried against an impasse."""
        self.held = False
        """Whether the path stands still until the tool has come back to it."""
        self.meeting_key: object = None
        self.meeting_pairs = np.array([], dtype=np.intp)
        self.tried_entry = False
        """Whether another entry has been tried in the present attempt."""
        base = cell.model.body_rootid[cell.model.site_bodyid[addresses.tool_site]]
        self.base_position_m = configuration.data.xpos[base].copy()

    @property
    def window(self) -> str | None:
        """Name of the final check's exemption that the present job holds open."""
        meeting = None if self.jobs is None else self.jobs.meeting
        if meeting is None:
            return None
        return f"{self.addresses.name}_{meeting.arm or meeting.instrument}"


def _columns(dofs: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """The same entries as a slice where they follow each other, which is ten times as fast to write to."""
    first, last = int(dofs[0]), int(dofs[-1])
    follows = np.array_equal(dofs, np.arange(first, last + 1))
    return slice(first, last + 1) if follows else dofs
