"""What a support arm does: a sequence of jobs, each a path with its own clock.

The clock advances by the factor the controller grants, so an arm that is slowed down stays on its
path. A job ends when its clock has run out, or, for `meet`, when the controller reports that the
two tools are as near as they may be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operator import path_through
from workcell.motion.path import PathGeometry, Target, TimedPath, standing


@dataclass(frozen=True)
class Surroundings:
    """What a job may know about the cell this tick."""

    tool_position_m: dict[str, NDArray[np.float64]]
    """(3,) tool position of every arm, in the world."""
    tool_distance_m: dict[str, float]
    """Smallest distance between this arm's and another arm's tool geoms, by the other's name."""


class JobSequence:
    """The jobs of one arm, in order; stands still after the last.

    Args:
        jobs: From the scenario.
        position_m, wxyz: Tool pose at the start.
        d_min_m: Distance at which a `meet` is complete.
    """

    def __init__(
        self,
        jobs: tuple[scenario.Job, ...],
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        d_min_m: float,
    ):
        self._jobs = jobs
        self._d_min_m = d_min_m
        self._index = -1
        self._target = standing(position_m, wxyz)
        self._travelled: list[tuple[PathGeometry, float]] = []
        self._legs: list[TimedPath] = []
        self._met = False
        self.clock_s = 0.0
        self.switched = False
        """Whether the last `advance` began another job or stopped a path short: motion starts again from rest."""

    @property
    def name(self) -> str:
        """Logged as the arm's job."""
        if self._index < 0:
            return "start"
        if self._index >= len(self._jobs):
            return "done"
        kind = self._jobs[self._index].kind
        return "dwell" if kind == "meet" and self._met else kind

    @property
    def done(self) -> bool:
        """Whether the last job has ended."""
        return self._index >= len(self._jobs)

    @property
    def meeting(self) -> str | None:
        """Name of the arm whose tool this arm is meant to meet now; also while it leaves again."""
        job = self._current
        if isinstance(job, scenario.Meet):
            return job.arm
        if isinstance(job, (scenario.Retreat, scenario.Wait)):
            for earlier in reversed(self._jobs[: self._index]):
                if isinstance(earlier, scenario.Meet):
                    return earlier.arm
        return None

    @property
    def arrived(self) -> bool:
        """Whether a `meet` has come as near as it may and dwells."""
        return self._met and isinstance(self._current, scenario.Meet)

    @property
    def _current(self) -> scenario.Job | None:
        return self._jobs[self._index] if 0 <= self._index < len(self._jobs) else None

    def target(self) -> Target:
        """The pose and twist wanted at the present clock."""
        return self._target

    def advance(self, step_s: float, factor: float, surroundings: Surroundings) -> None:
        """Let time pass: `step_s` of the run, of which the path's clock gets the granted factor."""
        self.switched = False
        job = self._current
        if job is None and self.done:
            return
        if isinstance(job, scenario.Wait) or self.arrived:
            self.clock_s += step_s  # waiting is not slowed down
        else:
            self.clock_s += step_s * factor
        if (
            isinstance(job, scenario.Meet)
            and not self._met
            and surroundings.tool_distance_m[job.arm] <= self._d_min_m
        ):
            self._met = self.switched = True
            self._leave(self._legs[0])
            self._target = standing(self._target.position_m, self._target.wxyz)
            self.clock_s = 0.0
        if job is None or self._over(job):
            self._next(surroundings)
        elif self._legs and not self.arrived:
            self._target = self._legs[0].target(self.clock_s)

    def _over(self, job: scenario.Job) -> bool:
        if isinstance(job, scenario.Wait):
            return self.clock_s >= job.duration_s
        if isinstance(job, scenario.Meet):
            return self._met and self.clock_s >= job.dwell_s
        if not self._legs:  # a retreat with nothing travelled
            return True
        if self.clock_s < self._legs[0].duration_s:
            return False
        if isinstance(job, scenario.Move):
            self._leave(self._legs[0])
        self.clock_s = 0.0
        self._legs = self._legs[1:]
        return not self._legs

    def _leave(self, leg: TimedPath) -> None:
        self._travelled.append((leg.geometry, leg.length_at(self.clock_s)))

    def _next(self, surroundings: Surroundings) -> None:
        self._index += 1
        self.clock_s, self._met, self._legs, self.switched = 0.0, False, [], True
        job = self._current
        if job is None or isinstance(job, scenario.Wait):
            self._target = standing(self._target.position_m, self._target.wxyz)
            return
        if isinstance(job, scenario.Retreat):
            profile = {"speed_m_s": job.speed_m_s, "acceleration_m_s2": job.acceleration_m_s2}
            self._legs = [
                TimedPath(geometry, **profile, start_m=length, end_m=0.0)
                for geometry, length in reversed(self._travelled)
            ]
            self._travelled = []
        else:
            self._legs = [
                TimedPath(
                    self._geometry(job, surroundings),
                    speed_m_s=job.speed_m_s,
                    acceleration_m_s2=job.acceleration_m_s2,
                )
            ]
        self._target = (
            self._legs[0].target(0.0)
            if self._legs
            else standing(self._target.position_m, self._target.wxyz)
        )

    def _geometry(
        self, job: scenario.Move | scenario.Meet, surroundings: Surroundings
    ) -> PathGeometry:
        if isinstance(job, scenario.Move):
            return path_through(job.waypoints, self._target.position_m, self._target.wxyz)
        there = surroundings.tool_position_m[job.arm]
        return PathGeometry(
            np.array([self._target.position_m, there]), np.array([self._target.wxyz] * 2)
        )
