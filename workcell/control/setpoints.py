"""Setpoint stage: jobs and operators -> the tool pose and twist asked of each arm in this tick."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from workcell.control import pair_assignment
from workcell.control.arm import ControlledArm
from workcell.control.finite import require_finite
from workcell.control.reach import OutOfReach, Reach
from workcell.control.sensing import Sensing
from workcell.control.tick import ArmSensed, ArmSetpoint, Sensed
from workcell.errors import ControlFault
from workcell.motion.jobs import Instrument, JobSequence, Surroundings
from workcell.motion.path import Target, standing
from workcell.scene.addresses import InstrumentAddresses
from workcell.scene.cell import Cell

REJOIN_M = 0.02
"""Off its path by more than this, an arm first comes back before the path's clock goes on.
A retreat does not: what it has to come back to is what it is to get away from."""


class Setpoints:
    """Asks jobs and operators, arm by arm.

    Args:
        cell: The cell.
        arms: All arms; what changes hands is dealt out to them anew.
        sensing: The belief, and who holds what.
    """

    def __init__(self, cell: Cell, arms: Sequence[ControlledArm], sensing: Sensing):
        self._cell, self._arms, self._sensing = cell, arms, sensing
        self._base_position_m = {arm.name: arm.base_position_m for arm in arms}

    def follow(
        self, arm: ControlledArm, sensed: Sensed, seen: Mapping[str, ArmSensed]
    ) -> ArmSetpoint:
        """The setpoint of one arm.

        Args:
            arm: Whose jobs or operator are asked.
            sensed: What was measured of the cell.
            seen: What was measured of each arm.

        Raises:
            ControlFault: a target is not finite.
        """
        memory = arm.memory
        state, elbow_m_s, waits, began, replanned = "", 0.0, False, False, False
        joints_rad_s: np.ndarray | None = None
        target, doing, clock_s = memory.target, "", 0.0
        if arm.jobs is not None:
            jobs, answer = arm.jobs, memory.answer
            if sensed.tick:
                waits = self._advance(arm, jobs, sensed, seen)
            target = jobs.target()
            if waits or answer.path == "pause":
                target = standing(target.position_m, target.wxyz)
            elif answer.path == "reverse":
                target = target.reversed()
            doing, clock_s = jobs.name, jobs.clock_s
            began, replanned = jobs.began, jobs.switched and not jobs.began
            if jobs.switched:
                # The new path starts from rest: acceleration now counts from what was really commanded.
                memory.nominal_rad_s = memory.command_rad_s
        elif arm.operator is not None:
            setpoint = arm.operator.setpoint(sensed.time_s)
            target, doing, clock_s = setpoint.target, setpoint.doing, sensed.time_s
            state, elbow_m_s = setpoint.state, setpoint.elbow_speed_m_s
            joints_rad_s = setpoint.joints_rad_s
        task_rad_s = self._task(arm, target, doing, sensed)
        error_m, error_rad = arm.ik.tool_error
        left_m = None
        if joints_rad_s is None and arm.reach is not None:
            beyond = self._beyond_reach(arm, arm.reach, target, task_rad_s)
            if beyond is not None:
                joints_rad_s, left_m = beyond
        if joints_rad_s is not None:
            task_rad_s = joints_rad_s
        return ArmSetpoint(
            target=target,
            task_rad_s=task_rad_s,
            doing=doing,
            clock_s=clock_s,
            tool_error_m=error_m,
            tool_error_rad=error_rad,
            operator_state=state,
            elbow_speed_m_s=elbow_m_s,
            joints_rad_s=joints_rad_s,
            out_of_reach_m=left_m,
            waits=waits,
            began=began,
            replanned=replanned,
        )

    def _task(self, arm: ControlledArm, target: Target, doing: str, sensed: Sensed) -> np.ndarray:
        """(n,) the smallest joint motion that does what the target asks."""
        try:
            return arm.ik.aim(
                arm.configuration,
                target,
                catch_up_m_s=sensed.settings.catch_up_m_s if arm.support else np.inf,
                free_rotation=arm.memory.answer.free_rotation
                or (arm.jobs is not None and arm.jobs.free_rotation),
                task=(arm.jobs and arm.jobs.task) or arm.task,
            )
        except FloatingPointError as error:
            for value in (
                target.position_m,
                target.wxyz,
                target.velocity_m_s,
                target.angular_velocity_rad_s,
            ):
                require_finite(
                    sensed.tick, value, f"the tool target of arm {arm.name} from {doing}"
                )
            raise ControlFault(sensed.tick, str(error)) from error

    def _beyond_reach(
        self, arm: ControlledArm, reach: Reach, target: Target, task_rad_s: np.ndarray
    ) -> OutOfReach | None:
        """What to do with a target that cannot be reached; None for one that can."""
        if reach.has_reached(arm.ik.tool_error):
            return None
        last, here = arm.memory.command_rad_s, arm.configuration
        return reach.follow(
            here,
            target,
            arm.task,
            errors=arm.ik.tool_error,
            box=arm.ik.box(here, last),
            eased=bool((arm.ik.followed(here, last, task_rad_s) == task_rad_s).all()),
        )

    def _advance(
        self,
        arm: ControlledArm,
        jobs: JobSequence,
        sensed: Sensed,
        seen: Mapping[str, ArmSensed],
    ) -> bool:
        """Let an arm's jobs go on by the clock rate it was granted, and hand over what changes hands.

        Returns:
            Whether the path stands still until the tool has come back to it.
        """
        memory, answer = arm.memory, arm.memory.answer
        around = self._around(arm, seen)
        tool = seen[arm.name].tool_position_m
        off_path = math.dist(tool.tolist(), memory.target.position_m.tolist())
        allowed = REJOIN_M if answer.off_path_m is None else answer.off_path_m
        if jobs.ends_within(self._cell.period_s):
            # A tool that may be off its path may not be off its goal: a job is done where it was to be done.
            allowed = min(allowed, REJOIN_M)
        waits = off_path > allowed and answer.clock_rate > 0.0 and not jobs.retreats
        rate = 0.0 if waits or answer.path == "pause" else answer.clock_rate
        jobs.advance(self._cell.period_s, rate, around)
        if sensed.settings.entry:
            jobs.prefer(sensed.settings.entry, around)
        if not answer.another_approach:
            memory.approach_tried = False
        elif not memory.approach_tried:
            memory.approach_tried = jobs.try_another_entry(around)
        if jobs.hand_over is not None:
            grasps = self._sensing.grasps
            if jobs.hand_over.to is None:
                grasps.let_go(jobs.hand_over.instrument)
            else:
                grasps.take(jobs.hand_over.instrument, jobs.hand_over.to)
            pair_assignment.assign(self._cell, grasps, self._sensing.watched, self._arms)
        return waits

    def _around(self, arm: ControlledArm, seen: Mapping[str, ArmSensed]) -> Surroundings:
        pairs = pair_assignment.meeting_pairs(self._cell, self._sensing.grasps, arm)
        distance = self._sensing.watched.distance_m
        return Surroundings(
            tool_position_m={name: each.tool_position_m for name, each in seen.items()},
            base_position_m=self._base_position_m,
            instruments={item.name: self._instrument(item) for item in self._cell.instruments},
            meeting_distance_m=float(distance[pairs].min()) if len(pairs) else np.inf,
        )

    def _instrument(self, item: InstrumentAddresses) -> Instrument:
        data = self._sensing.belief.data
        return Instrument(
            data.xpos[item.body].copy(),
            item.half_length_m * data.xmat[item.body, 2::3],
            self._cell.model.body_pos[item.body],
            self._sensing.grasps.holder(item.name),
        )
