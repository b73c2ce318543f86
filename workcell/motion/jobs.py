"""What a support arm does: a sequence of jobs, each a path with its own clock.

The clock advances by the factor the controller grants, so an arm that is slowed down stays on its
path. `move` and `retreat` end when their clock has run out; `meet`, `fetch` and `exchange` end when
what is meant to meet is d_min apart, dwell, and may hand over an instrument; `present` ends at a
pose relative to another arm's tool. Where the place to go moves, the rest of the path is planned anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators import path_through
from workcell.motion.orientation import pointing, turned_towards
from workcell.motion.path import PathGeometry, Target, TimedPath, length, standing

Vector = NDArray[np.float64]

_DOWN = np.array([0.0, 0.0, -1.0])
REPLAN_M = 0.01
"""A goal that has moved by more than this is approached on a new path; chosen as the default d_min."""
REPLAN_PRESENT_M = 0.08
"""The same for a presentation, which need not follow every move of a hand; chosen as a hand's breadth."""
REPLAN_S = 0.5
"""A path is followed at least this long before it is planned anew, so that an arm whose goal keeps moving gets under way."""
APPROACH_M = 0.12
"""Length of the straight last stretch to a presentation pose or an instrument: chosen longer than a tool."""
ENTRIES: tuple[scenario.Entry, ...] = ("left", "right", "above")
_MEETINGS = (scenario.Meet, scenario.Fetch, scenario.Exchange)
_Aimed = scenario.Meet | scenario.Fetch | scenario.Exchange | scenario.Present | scenario.Put
"""Jobs that go where something else is, which may move."""


@dataclass(frozen=True)
class Instrument:
    """Where an instrument is now."""

    centre_m: Vector
    """(3,) in the world."""
    axis_m: Vector
    """(3,) half-length vector: the ends are centre ± axis."""
    place_m: Vector
    """(3,) centre where it was at the start."""
    holder: str | None
    """Arm that holds it; None where it lies."""


@dataclass(frozen=True)
class Surroundings:
    """What a job may know about the cell this tick."""

    tool_position_m: dict[str, Vector]
    """(3,) tool position of every arm, in the world."""
    base_position_m: dict[str, Vector]
    """(3,) base position of every arm, in the world."""
    instruments: dict[str, Instrument]
    """Every instrument, by name."""
    meeting_distance_m: float
    """Smallest distance between what the present job brings together; infinite where it brings nothing."""


@dataclass(frozen=True)
class Meeting:
    """What a job brings together on purpose."""

    arm: str | None
    """The other arm, None for an instrument that lies."""
    instrument: str | None
    """The instrument handed over, None where two tools only meet."""
    gives: bool = False
    """Whether this arm holds the instrument before, rather than after."""


@dataclass(frozen=True)
class HandOver:
    """An instrument changes hands this tick."""

    instrument: str
    to: str | None
    """Arm that holds it from now on; None if it is let go of."""


@dataclass
class _Leg:
    path: TimedPath
    goal_m: Vector | None = None
    """(3,) where it was planned to; None if it cannot move."""
    planned_s: float = field(default=0.0)


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
        self._entry: scenario.Entry | None = None
        self._preferred: scenario.Entry | None = None
        self._entries_tried = 0
        self._since_plan_s = 0.0
        self.clock_s = 0.0
        self.meeting: Meeting | None = None
        """What the arm is meant to meet now; after a meeting, until it has retreated, what it leaves."""
        self.retreats = False
        """Whether the present job is to get away."""
        self.free_rotation = False
        """Whether the present job leaves the rotation about the tool's axis free."""
        self.finished = 0
        """How many jobs have been done."""
        self.switched = False
        """Whether the last `advance` began another path or stopped one short: motion starts again from rest."""
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
        """Whether a meeting has come as near as it may, and dwells."""
        return self._met

    @property
    def moving(self) -> bool:
        """Whether the present job wants motion along a path."""
        return bool(self._legs) and not self._met

    @property
    def progress_s(self) -> float:
        """The clock as far as it means motion: at the end of a path it may go on, while the tool stands."""
        return min(self.clock_s, self._legs[0].path.duration_s) if self._legs else self.clock_s

    def target(self) -> Target:
        """The pose and twist wanted at the present clock."""
        return self._target

    def enter_from(self, entry: scenario.Entry, around: Surroundings) -> bool:
        """Change the side a presentation comes from, also on the way; False if nothing is being presented."""
        job = self._current
        if not isinstance(job, scenario.Present):
            return False
        if entry != (self._entry or job.entry):
            self._entry = entry
            self._plan(job, around)
        return True

    def prefer(self, entry: scenario.Entry, around: Surroundings) -> None:
        """From now on every presentation comes from this side, the one on its way included."""
        if entry != self._preferred:
            self._preferred = entry
            self.enter_from(entry, around)

    def try_another_entry(self, around: Surroundings) -> bool:
        """Present from the next side in the order of `ENTRIES`, once round and back to the first.

        False if nothing is being presented, or each side has been tried: then the one asked for is kept.
        """
        job = self._current
        if not isinstance(job, scenario.Present) or self._entries_tried == len(ENTRIES):
            return False
        self._entries_tried += 1
        now = self._entry or job.entry
        return self.enter_from(ENTRIES[(ENTRIES.index(now) + 1) % len(ENTRIES)], around)

    def advance(self, step_s: float, factor: float, around: Surroundings) -> None:
        """Let time pass: `step_s` of the run, of which the path's clock gets the granted factor."""
        self.switched, self.began, self.hand_over = False, False, None
        job = self._current
        if job is None and self.done:
            return
        # Waiting is not slowed down.
        waiting = self._met or (job is not None and job.kind == "wait")
        self.clock_s = max(0.0, self.clock_s + step_s * (1.0 if waiting else factor))
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
        meeting = _meeting(job)
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
        self._entry, self._entries_tried = self._preferred, 0
        job = self._current = None if self.done else self._jobs[self._index]
        self.meeting = self._to_meet_or_leave()
        self.retreats = isinstance(job, scenario.Retreat)
        self.free_rotation = (
            isinstance(job, (scenario.Move, scenario.Present, scenario.Retreat))
            and job.free_rotation
        )
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
        """What the present job brings together, or what a retreat from it leaves, also while it waits before."""
        job = self._current
        if isinstance(job, (scenario.Retreat, scenario.Wait)):
            for earlier in reversed(self._jobs[: self._index]):
                if not isinstance(earlier, scenario.Wait):
                    return _meeting(earlier)
        return _meeting(job)

    def _plan(self, job: scenario.Job, around: Surroundings) -> None:
        """A path from the present target to where the job goes, from rest."""
        if isinstance(job, (scenario.Wait, scenario.Retreat)):
            return
        self._leave()
        position, wxyz = self._target.position_m, self._target.wxyz
        goal = None
        if isinstance(job, scenario.Move):
            geometry = path_through(job.waypoints, position, wxyz)
        else:
            goal, toward = self._goal(job, around)
            if toward is None:
                geometry = PathGeometry(np.array([position, goal]), np.array([wxyz, wxyz]))
            else:
                turned = turned_towards(wxyz, self._leading(job, around), toward)
                geometry = PathGeometry(
                    np.array([position, goal - APPROACH_M * toward, goal]),
                    np.array([wxyz, turned, turned]),
                )
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

    def _goal(self, job: _Aimed, around: Surroundings) -> tuple[Vector, Vector | None]:
        """Where this arm's tool has to go, and from where: the direction of the straight last stretch,
        None where the way is straight anyhow."""
        if isinstance(job, scenario.Fetch):
            item = around.instruments[job.instrument]
            # Its highest point: the upper end of one that stands, the middle of one that lies.
            return item.centre_m - abs(item.axis_m[2]) * _DOWN, _DOWN
        tool = around.tool_position_m[self._arm]
        if isinstance(job, scenario.Put):
            item = around.instruments[job.instrument]
            # With the free end down, the centre is this far below the tool.
            return item.place_m - length(item.centre_m - tool) * _DOWN, _DOWN
        there = around.tool_position_m[job.arm]
        if isinstance(job, scenario.Present):
            entry = self._entry or job.entry
            toward = -_entry_direction(entry, around.base_position_m[job.arm], there)
            # The instrument will point along the tool once the tool has turned.
            return there - (job.distance_m + length(self._held_m(around))) * toward, toward
        if isinstance(job, scenario.Exchange) and job.direction == "take":
            # Gripped at the end that is free.
            return _end(around.instruments[job.instrument], there), None
        return there - self._held_m(around), None

    def _leading(self, job: _Aimed, around: Surroundings) -> Vector:
        """(3,) the unit vector, now, that points along the straight last stretch once the tool is turned: the tool's
        axis, or what is to be put down."""
        if isinstance(job, scenario.Put):
            held = self._held_m(around)
            return held / max(length(held), 1e-9)
        return pointing(self._target.wxyz)

    def _held_m(self, around: Surroundings) -> Vector:
        """(3,) from the tool to the free end of what it holds; zero if it holds nothing."""
        tool = around.tool_position_m[self._arm]
        for item in around.instruments.values():
            if item.holder == self._arm:
                return _end(item, tool) - tool
        return np.zeros(3)

    def _has_moved(self, job: scenario.Job, around: Surroundings) -> bool:
        planned = self._legs[0].goal_m
        if (
            planned is None
            or self._since_plan_s < REPLAN_S
            or isinstance(job, (scenario.Move, scenario.Wait, scenario.Retreat))
        ):
            return False
        limit = REPLAN_PRESENT_M if isinstance(job, scenario.Present) else REPLAN_M
        return length(self._goal(job, around)[0] - planned) > limit


def _meeting(job: scenario.Job | None) -> Meeting | None:
    if isinstance(job, scenario.Meet):
        return Meeting(job.arm, None)
    if isinstance(job, scenario.Fetch):
        return Meeting(None, job.instrument)
    if isinstance(job, scenario.Exchange):
        return Meeting(job.arm, job.instrument, gives=job.direction == "give")
    return None


def _end(instrument: Instrument, hand_m: Vector) -> Vector:
    """The end of an instrument that is away from the hand that holds it."""
    outward = (instrument.centre_m - hand_m) @ instrument.axis_m >= 0.0
    return instrument.centre_m + (instrument.axis_m if outward else -instrument.axis_m)


def _entry_direction(entry: scenario.Entry, base_m: Vector, tool_m: Vector) -> Vector:
    """Unit vector from an arm's tool to the side named, left and right as seen from its base."""
    if entry == "above":
        return np.array([0.0, 0.0, 1.0])
    x, y, _ = (tool_m - base_m).tolist()
    out = math.hypot(x, y)
    # A tool right above its base has no left: the world's y axis stands in.
    left = np.array([-y / out, x / out, 0.0] if out > 1e-6 else [0.0, 1.0, 0.0])
    return left if entry == "left" else -left
