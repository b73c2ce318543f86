"""The jobs of one arm, in order: which is done now, along which path, and when it is over.

The path's clock advances by the speed scale that the controller grants, so that an arm which is
slowed down stays on its path. `move`, `present`, `put` and `retreat` end when their clock has run
out. `meet`, `fetch` and `exchange` end after a dwell, which begins when what is to meet is d_min
apart; they may hand over an instrument. Where the goal moves, the rest of the path is planned anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workcell import scenario
from workcell.motion.jobs.goals import (
    APPROACH_SIDES,
    HandOver,
    Meeting,
    Surroundings,
    Vector,
    goal_of,
    meeting_of,
    way_to,
)
from workcell.motion.path import PathGeometry, Target, TimedPath, length, path_through, standing

REPLAN_M = 0.01
"""A goal that has moved by more than this is approached on a new path; chosen as the default d_min."""
REPLAN_PRESENT_M = 0.08
"""The same for a presentation, which need not follow every move of a hand; chosen as a hand's breadth."""
REPLAN_S = 0.5
"""A path is followed at least this long before it is planned anew, so that an arm whose goal keeps moving gets under way."""
_MEETINGS = (scenario.Meet, scenario.Fetch, scenario.Exchange)


@dataclass
class _Leg:
    path: TimedPath
    goal_m: Vector | None = None
    """(3,) where it was planned to; None if it cannot move."""


class JobSequence:
    """The jobs of one arm, in order; stands still after the last, or starts again if it repeats.

    Args:
        jobs: From the scenario.
        arm: Name of the arm.
        position_m, wxyz: Tool pose at the start.
        d_min_m: Distance at which a meeting is complete.
        repeat: How many times the whole sequence is done.
    """

    def __init__(
        self,
        jobs: tuple[scenario.Job, ...],
        *,
        arm: str,
        position_m: Vector,
        wxyz: Vector,
        d_min_m: float,
        repeat: int = 1,
    ):
        self._jobs = jobs * repeat
        self._arm = arm
        self._d_min_m = d_min_m
        self._index = -1
        self._current: scenario.Job | None = None
        """The present job; None before the first and after the last."""
        self._target = standing(position_m, wxyz)
        self._travelled: list[tuple[PathGeometry, float]] = []
        self._legs: list[_Leg] = []
        self._met = False
        self._side: scenario.Entry | None = None
        self._preferred: scenario.Entry | None = None
        self._sides_tried = 0
        self._since_plan_s = 0.0
        self.clock_s = 0.0
        self.meeting: Meeting | None = None
        """What the arm is meant to meet now. After a meeting, until the arm has retreated: what it leaves."""
        self.retreats = False
        """Whether the present job is to get away."""
        self.free_rotation = False
        """Whether the present job leaves the rotation about the tool's axis free."""
        self.task: scenario.ToolTask | None = None
        """What of the tool's pose the present job asks for, None as the arm's others do; kept until the next job with a path."""
        self.finished = 0
        """How many jobs have been done."""
        self.switched = False
        """Whether the last `advance` began another path or ended one early: motion starts again from rest."""
        self.began = False
        """Whether the last `advance` began another job."""
        self.hand_over: HandOver | None = None
        """What changed hands in the last `advance`."""

    @property
    def name(self) -> str:
        """Logged as the arm's job."""
        if self._index < 0:
            return "start"
        job = self._current
        if job is None:
            return "done"
        return "dwell" if self._met else job.kind

    @property
    def done(self) -> bool:
        """Whether the last job has ended."""
        return self._index >= len(self._jobs)

    @property
    def arrived(self) -> bool:
        """Whether what is to meet is d_min apart, and the arm dwells."""
        return self._met

    @property
    def moving(self) -> bool:
        """Whether the present job wants motion along a path."""
        return bool(self._legs) and not self._met

    @property
    def progress_s(self) -> float:
        """The clock, at most the duration of the path: beyond it the clock may go on while the tool stands."""
        return min(self.clock_s, self._legs[0].path.duration_s) if self._legs else self.clock_s

    def ends_within(self, step_s: float) -> bool:
        """Whether so much more on the clock ends the present job: its path ends there, and nothing else has to happen."""
        return (
            len(self._legs) == 1
            and not isinstance(self._current, _MEETINGS)
            and self.clock_s + step_s >= self._legs[0].path.duration_s
        )

    def target(self) -> Target:
        """The pose and twist wanted at the present clock."""
        return self._target

    def ahead(self, count: int = 20) -> Vector:
        """(count, 3) points in m along what is left of the present path, from the present clock on; (0, 3) without a path."""
        if not self._legs:
            return np.empty((0, 3))
        path = self._legs[0].path
        clocks = np.linspace(min(self.clock_s, path.duration_s), path.duration_s, count)
        return np.array([path.target(float(clock)).position_m for clock in clocks])

    def enter_from(self, entry: scenario.Entry, around: Surroundings) -> bool:
        """Change the approach side of a presentation, also on the way; False if nothing is being presented."""
        job = self._current
        if not isinstance(job, scenario.Present):
            return False
        if entry != (self._side or job.entry):
            self._side = entry
            self._plan(job, around)
        return True

    def prefer(self, entry: scenario.Entry, around: Surroundings) -> None:
        """Use this approach side for every presentation from now on, the present one included."""
        if entry != self._preferred:
            self._preferred = entry
            self.enter_from(entry, around)

    def try_another_entry(self, around: Surroundings) -> bool:
        """Present from the next approach side in the order of `APPROACH_SIDES`; after the last comes the first.

        Returns:
            False if nothing is being presented, or every side has been tried: then the side is kept.
        """
        job = self._current
        if not isinstance(job, scenario.Present) or self._sides_tried == len(APPROACH_SIDES):
            return False
        self._sides_tried += 1
        after = APPROACH_SIDES.index(self._side or job.entry) + 1
        return self.enter_from(APPROACH_SIDES[after % len(APPROACH_SIDES)], around)

    def advance(self, step_s: float, speed_scale: float, around: Surroundings) -> None:
        """Let time pass.

        Args:
            step_s: Time of the run that has passed.
            speed_scale: Share of it by which the path's clock advances; a wait and a dwell take all of it.
            around: The cell at this tick.
        """
        self.switched, self.began, self.hand_over = False, False, None
        job = self._current
        if job is None and self.done:
            return
        # Waiting is not slowed down.
        waiting = self._met or (job is not None and job.kind == "wait")
        self.clock_s = max(0.0, self.clock_s + step_s * (1.0 if waiting else speed_scale))
        self._since_plan_s += step_s
        if (
            around.meeting_distance_m <= self._d_min_m
            and not self._met
            and isinstance(job, _MEETINGS)
        ):
            self._arrive()
        if job is None or self._over(job):
            if job is not None:
                self._finish(job)
            self._next(around)
        elif self._legs and not self._met:
            if self._has_moved(job, around):
                self._plan(job, around)
            self._target = self._legs[0].path.target(self.clock_s)

    def _arrive(self) -> None:
        self._met = self.switched = True
        self._leave()
        self._legs = []
        self._target = standing(self._target.position_m, self._target.wxyz)
        self.clock_s = 0.0

    def _over(self, job: scenario.Job) -> bool:
        if job.kind == "wait":
            return self.clock_s >= job.duration_s
        if isinstance(job, _MEETINGS):
            return self._met and self.clock_s >= job.dwell_s
        if not self._legs:  # a retreat with nothing travelled
            return True
        if self.clock_s < self._legs[0].path.duration_s:
            return False
        if not isinstance(job, scenario.Retreat):
            self._leave()
        self.clock_s = 0.0
        self._legs = self._legs[1:]
        return not self._legs

    def _finish(self, job: scenario.Job) -> None:
        self.finished += 1
        meeting = meeting_of(job)
        if isinstance(job, scenario.Put):
            self.hand_over = HandOver(job.instrument, None)
        elif meeting is not None and meeting.instrument is not None:
            to = str(meeting.arm) if meeting.gives else self._arm
            self.hand_over = HandOver(meeting.instrument, to)

    def _leave(self) -> None:
        """Remember how far the present path was followed."""
        if self._legs:
            path = self._legs[0].path
            self._travelled.append((path.geometry, path.length_at(self.clock_s)))

    def _next(self, around: Surroundings) -> None:
        self._index += 1
        self.clock_s, self._met, self._legs = 0.0, False, []
        self.switched = self.began = True
        self._side, self._sides_tried = self._preferred, 0
        job = self._current = None if self.done else self._jobs[self._index]
        self.meeting = self._to_meet_or_leave()
        self.retreats = isinstance(job, scenario.Retreat)
        self.free_rotation = (
            isinstance(job, (scenario.Move, scenario.Present, scenario.Retreat))
            and job.free_rotation
        )
        if job is not None and not isinstance(job, scenario.Wait):
            self.task = job.task
        if job is None or isinstance(job, scenario.Wait):
            self._target = standing(self._target.position_m, self._target.wxyz)
        elif isinstance(job, scenario.Retreat):
            self._legs = [
                _Leg(
                    TimedPath(
                        geometry,
                        speed_m_s=job.speed_m_s,
                        acceleration_m_s2=job.acceleration_m_s2,
                        start_m=reached_m,
                        end_m=0.0,
                    )
                )
                for geometry, reached_m in reversed(self._travelled)
            ]
            self._travelled = []
            self._target = (
                self._legs[0].path.target(0.0)
                if self._legs
                else standing(self._target.position_m, self._target.wxyz)
            )
        else:
            self._plan(job, around)

    def _to_meet_or_leave(self) -> Meeting | None:
        """What the present job brings together; for a retreat, and a wait before it, what the job before brought together."""
        job = self._current
        if isinstance(job, (scenario.Retreat, scenario.Wait)):
            for earlier in reversed(self._jobs[: self._index]):
                if not isinstance(earlier, scenario.Wait):
                    return meeting_of(earlier)
        return meeting_of(job)

    def _plan(self, job: scenario.Job, around: Surroundings) -> None:
        """A path from the present target to where the job goes, from rest."""
        if isinstance(job, (scenario.Wait, scenario.Retreat)):
            return
        self._leave()
        start, goal = self._target, None
        if isinstance(job, scenario.Move):
            geometry = path_through(job.waypoints, start.position_m, start.wxyz)
        else:
            geometry, goal = way_to(job, self._arm, self._side, start, around)
        self._legs = [
            _Leg(
                TimedPath(
                    geometry, speed_m_s=job.speed_m_s, acceleration_m_s2=job.acceleration_m_s2
                ),
                goal,
            )
        ]
        self.clock_s, self._since_plan_s, self.switched = 0.0, 0.0, True
        self._target = self._legs[0].path.target(0.0)

    def _has_moved(self, job: scenario.Job, around: Surroundings) -> bool:
        planned = self._legs[0].goal_m
        if (
            planned is None
            or self._since_plan_s < REPLAN_S
            or isinstance(job, (scenario.Move, scenario.Wait, scenario.Retreat))
        ):
            return False
        limit = REPLAN_PRESENT_M if isinstance(job, scenario.Present) else REPLAN_M
        return length(goal_of(job, self._arm, self._side, around)[0] - planned) > limit
