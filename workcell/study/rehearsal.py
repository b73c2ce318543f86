"""An arm's jobs, or its operator's path, gone through with kinematics alone: is all of it within reach, and is there room?

In: a cell, and which arm moves; the others stand at home. Out: by how much its tool misses what is asked, and how much
too near the arm comes to anything that it is not to meet. No limit of speed counts, and nobody gives way: a layout that
leaves room here leaves the controller room to work with.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.control import pair_assignment
from workcell.control.grasp import Grasps
from workcell.control.ik import DIRECTIONS
from workcell.motion.jobs import Instrument, JobSequence, Surroundings
from workcell.motion.operators import make_operator
from workcell.motion.orientation import pointing
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell
from workcell.simulation.instruments import Instruments

STEP_S = 0.25
"""Time from one look to the next: 4 cm at the default speed of a path."""
FINE_S = 0.03
"""The same where what is to meet is within `FINE_M`: half a centimetre, less than the default d_min."""
FINE_M = 0.06
STANDS_LOOKS = 8
"""A path that ends is waited for so many looks to come to what it is to meet."""
LONGEST_S = 120.0
"""Of a rehearsal; what repeats itself is seen before."""
MISSED_M = 2e-3
"""A tool this near to what is asked is there, turning counted as length."""
LONGEST_STEP_RAD = 0.3
_ITERATIONS = 12
_CONVERGES = 0.98
"""An iteration that leaves more of the miss than this share is the last: the target is out of reach from there."""
_DAMPING = 1e-4
_SEEN_M = 0.15
"""Pairs farther apart than this are of no interest."""


@dataclass(frozen=True)
class Rehearsal:
    """What came of it."""

    missed_m: float
    """Largest miss of the tool beyond `MISSED_M`, m, turning counted as length; 0 where all is within reach."""
    missed_at: str
    """At which job."""
    near_m: float
    """How much of the room wanted the nearest pair lacks, m; 0 where there is room everywhere."""
    near_pair: tuple[str, str] | None
    total: float
    """Sum of misses and lacking room over all looks, m: what a search makes small."""
    looks: int

    @property
    def fits(self) -> bool:
        """Whether all is within reach and clear."""
        return self.missed_m == 0.0 and self.near_m == 0.0


def rehearse(
    cell: Cell, arm: ArmAddresses, room_m: float, *, give_up_m: float = np.inf
) -> Rehearsal:
    """Go through what an arm is to do.

    Args:
        cell: Where; its model is not changed.
        arm: Which of its arms moves.
        room_m: Distance wanted of everything that the arm is not to meet, m.
        give_up_m: Where misses and lacking room together are larger, nothing more is looked at.
    """
    stage = _Stage(cell, arm)
    missed, near, total, looks = (0.0, ""), (0.0, None), 0.0, 0
    for target, directions, doing in stage.targets():
        stage.doing = doing
        short = max(0.0, stage.reach(target, directions) - MISSED_M)
        lacking, pair = stage.lacking(room_m)
        total += short + lacking
        looks += 1
        missed = max(missed, (short, doing), key=lambda found: found[0])
        near = max(near, (lacking, pair), key=lambda found: found[0])
        if missed[0] + near[0] > give_up_m:
            break
    short = min(stage.short_of_meeting_m, _SEEN_M)
    if short > missed[0]:
        missed = short, f"{stage.doing}, which does not come together"
    total += short
    return Rehearsal(missed[0], missed[1], near[0], near[1], total, looks)


class _Stage:
    """The cell as it is during a rehearsal."""

    def __init__(self, cell: Cell, arm: ArmAddresses):
        self.cell, self.arm, self.model = cell, arm, cell.model
        self.data = mujoco.MjData(cell.model)
        cell.place_home(self.data)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        self.grasps = Grasps(cell)
        self.instruments = Instruments(cell, self.data)
        self.asked = next(each for each in cell.scenario.arm if each.name == arm.name)
        self.jobs: JobSequence | None = None
        self._mine: NDArray[np.intp] = np.array([], dtype=np.intp)
        self._meeting: frozenset[int] = frozenset()
        self._known: object = None
        self._jacobian = np.zeros((6, self.model.nv))
        self.doing = ""
        self.short_of_meeting_m = 0.0
        """How far apart what a job should bring together stays when its path has ended, m."""

    def targets(self) -> Iterator[tuple[Target, int, str]]:
        """Pose, directions that count, and name of what is done, one a look."""
        position, wxyz = self._tool()
        seconds = min(self.cell.scenario.simulation.duration_s, LONGEST_S)
        if self.asked.operator is not None:
            driver = make_operator(
                self.asked.operator, position, wxyz, seed=self.cell.scenario.simulation.seed, name=self.arm.name,
            )  # fmt: skip
            for k in range(round(seconds / STEP_S)):
                yield driver.setpoint(k * STEP_S).target, DIRECTIONS[self.asked.task], "operator"
                if isinstance(self.asked.operator, scenario.Hold):
                    return
            return
        jobs = self.jobs = JobSequence(
            self.asked.job, arm=self.arm.name, position_m=position, wxyz=wxyz, d_min_m=self.cell.scenario.control.d_min_m,
        )  # fmt: skip
        stood, before = 0, None
        while seconds > 0.0:
            around = self._around()
            step_s = FINE_S if around.meeting_distance_m < FINE_M else STEP_S
            seconds -= step_s
            jobs.advance(step_s, 1.0, around)
            if jobs.hand_over is not None:
                if jobs.hand_over.to is None:
                    self.grasps.let_go(jobs.hand_over.instrument)
                else:
                    self.grasps.take(jobs.hand_over.instrument, jobs.hand_over.to)
                self.instruments.follow(self.grasps.holders, self.data)
            if jobs.done:
                return
            target = jobs.target()
            stands = jobs.moving and before is not None and not np.any(target.position_m - before)
            stood, before = stood + 1 if stands else 0, target.position_m
            if stood == STANDS_LOOKS:
                self.short_of_meeting_m = around.meeting_distance_m
                return
            directions = DIRECTIONS[jobs.task or self.asked.task]
            directions = min(directions, 5) if jobs.free_rotation else directions
            yield target, directions, jobs.name

    def reach(self, target: Target, directions: int) -> float:
        """Move the tool as near to a target as the joints allow; how far it stays away, m."""
        arm, data, model = self.arm, self.data, self.model
        miss = np.inf
        for _ in range(_ITERATIONS):
            error = self._error(target, directions)
            before, miss = miss, math.sqrt(error @ error)
            if miss < MISSED_M / 4 or miss > _CONVERGES * before:
                break
            mujoco.mj_jacSite(model, data, self._jacobian[:3], self._jacobian[3:], arm.tool_site)
            turn = data.site_xmat[arm.tool_site].reshape(3, 3).T
            rows = np.concatenate(
                [
                    turn @ self._jacobian[:3, arm.dofs],
                    TURN_LENGTH_M_PER_RAD * (turn @ self._jacobian[3:, arm.dofs]),
                ]
            )[:directions]
            step = rows.T @ np.linalg.solve(rows @ rows.T + _DAMPING * np.eye(directions), error)
            step *= min(1.0, LONGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-9))
            data.qpos[arm.qpos] = np.clip(data.qpos[arm.qpos] + step, arm.lower_rad, arm.upper_rad)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
        self.instruments.carry(data)
        return miss

    def lacking(self, room_m: float) -> tuple[float, tuple[str, str] | None]:
        """How much of the room wanted the nearest pair lacks that the arm is not to meet, and which it is."""
        mine, meeting = self._pairs()
        worst, pair = 0.0, None
        for k in mine.tolist():
            if k in meeting:
                continue
            g, h = self.cell.pairs.geoms[k].tolist()
            lacks = room_m - mujoco.mj_geomDistance(self.model, self.data, g, h, _SEEN_M, None)
            if lacks > worst:
                worst, pair = lacks, self.cell.pairs.names[k]
        return worst, pair

    def _error(self, target: Target, directions: int) -> NDArray[np.float64]:
        """(directions,) from the tool to its target in the tool's frame, m, turning counted as length."""
        position, wxyz = self._tool()
        turn = self.data.site_xmat[self.arm.tool_site].reshape(3, 3).T
        rotation = np.empty(3)
        if directions == 5:
            rotation = turn @ np.cross(pointing(wxyz), pointing(target.wxyz))
            if pointing(wxyz) @ pointing(target.wxyz) < 0.0:
                rotation *= 2.0 / max(float(np.linalg.norm(rotation)), 1e-3)
        else:
            mujoco.mju_subQuat(rotation, target.wxyz, wxyz)
        moved = turn @ (target.position_m - position)
        return np.concatenate([moved, TURN_LENGTH_M_PER_RAD * rotation])[:directions]

    def _tool(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        wxyz = np.empty(4)
        mujoco.mju_mat2Quat(wxyz, self.data.site_xmat[self.arm.tool_site])
        return self.data.site_xpos[self.arm.tool_site].copy(), wxyz

    def _pairs(self) -> tuple[NDArray[np.intp], frozenset[int]]:
        """Pairs that the arm's motion changes, and those of them that it is to bring together."""
        meeting = None if self.jobs is None else self.jobs.meeting
        known = meeting, self.grasps.summary()
        if known != self._known:
            self._known = known
            parties = (self.grasps.parties(k) for k in range(len(self.cell.pairs)))
            self._mine = np.array(
                [k for k, names in enumerate(parties) if self.arm.name in names], dtype=np.intp
            )
            together = (
                []
                if meeting is None
                else pair_assignment.brought_together(
                    self.cell, self.grasps, self.arm.name, self._mine.tolist(), meeting
                )
            )
            self._meeting = frozenset(int(k) for k in together)
        return self._mine, self._meeting

    def _around(self) -> Surroundings:
        model, data, cell = self.model, self.data, self.cell
        _, meeting = self._pairs()
        return Surroundings(
            tool_position_m={arm.name: data.site_xpos[arm.tool_site].copy() for arm in cell.arms},
            base_position_m={
                arm.name: data.xpos[model.body_rootid[model.site_bodyid[arm.tool_site]]].copy()
                for arm in cell.arms
            },
            instruments={
                item.name: Instrument(
                    data.xpos[item.body].copy(),
                    item.half_length_m * data.xmat[item.body, 2::3],
                    model.body_pos[item.body],
                    self.grasps.holder(item.name),
                )
                for item in cell.instruments
            },
            meeting_distance_m=min(
                (
                    mujoco.mj_geomDistance(model, data, *cell.pairs.geoms[k].tolist(), 1.0, None)
                    for k in meeting
                ),
                default=np.inf,
            ),
        )
