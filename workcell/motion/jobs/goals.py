"""Where a job goes: the tool position it aims at, and the direction of its last stretch.

In come the job and what the arm may know about the cell at this tick; out come points and unit
vectors in the world frame. Nothing here remembers anything: a goal that moves is asked for again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.orientation import pointing, turned_towards
from workcell.motion.path import PathGeometry, Target, length

Vector = NDArray[np.float64]

APPROACH_M = 0.12
"""Length of the straight last stretch to a presentation pose or an instrument: chosen longer than a tool."""
APPROACH_SIDES: tuple[scenario.Entry, ...] = ("left", "right", "above")
"""Every side that a presentation may come from, in the order in which they are tried."""
AimedJob = scenario.Meet | scenario.Fetch | scenario.Exchange | scenario.Present | scenario.Put
"""Jobs that go where something else is, which may move."""
_DOWN = np.array([0.0, 0.0, -1.0])
_NO_LEFT_M = 1e-6
"""Horizontal distance from base to tool below which left and right have no meaning."""


class Instrument(NamedTuple):
    """Where an instrument is now."""

    centre_m: Vector
    """(3,) in the world."""
    axis_m: Vector
    """(3,) half-length vector: the ends are centre ± axis."""
    place_m: Vector
    """(3,) centre where it was at the start."""
    holder: str | None
    """Arm that holds it; None where it lies."""


class Surroundings(NamedTuple):
    """What a job may know about the cell at this tick."""

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
    """An instrument changes hands at this tick."""

    instrument: str
    to: str | None
    """Arm that holds it from now on; None if it is let go of."""


def meeting_of(job: scenario.Job | None) -> Meeting | None:
    """What a job brings together; None where it brings nothing."""
    if isinstance(job, scenario.Meet):
        return Meeting(job.arm, None)
    if isinstance(job, scenario.Fetch):
        return Meeting(None, job.instrument)
    if isinstance(job, scenario.Exchange):
        return Meeting(job.arm, job.instrument, gives=job.direction == "give")
    return None


def goal_of(
    job: AimedJob, arm: str, side: scenario.Entry | None, around: Surroundings
) -> tuple[Vector, Vector | None]:
    """Where an arm's tool has to go for a job, and from which direction.

    Args:
        job: The job.
        arm: Name of the arm that does it.
        side: The approach side of a presentation; None is the one that the job names.
        around: The cell at this tick.

    Returns:
        (3,) position of the tool, in m, and (3,) direction of the straight last stretch; None where
        the whole way is straight.
    """
    if isinstance(job, scenario.Fetch):
        item = around.instruments[job.instrument]
        # Its highest point: the upper end of one that stands, the middle of one that lies.
        return item.centre_m - abs(item.axis_m[2]) * _DOWN, _DOWN
    tool = around.tool_position_m[arm]
    if isinstance(job, scenario.Put):
        item = around.instruments[job.instrument]
        # With the free end down, the centre is this far below the tool.
        return item.place_m - length(item.centre_m - tool) * _DOWN, _DOWN
    there = around.tool_position_m[job.arm]
    if isinstance(job, scenario.Present):
        toward = -_side_direction(side or job.entry, around.base_position_m[job.arm], there)
        # The instrument will point along the tool once the tool has turned.
        return there - (job.distance_m + length(_held_m(arm, around))) * toward, toward
    if isinstance(job, scenario.Exchange) and job.direction == "take":
        # Gripped at the end that is free.
        return _free_end(around.instruments[job.instrument], there), None
    return there - _held_m(arm, around), None


def way_to(
    job: AimedJob, arm: str, side: scenario.Entry | None, start: Target, around: Surroundings
) -> tuple[PathGeometry, Vector]:
    """The curve from a pose to where a job goes.

    Args:
        job, arm, side, around: As for `goal_of`.
        start: The pose it begins at.

    Returns:
        The curve and (3,) the goal it was planned to, in m.
    """
    goal, toward = goal_of(job, arm, side, around)
    position, wxyz = start.position_m, start.wxyz
    if toward is None:
        return PathGeometry(np.array([position, goal]), np.array([wxyz, wxyz])), goal
    turned = turned_towards(wxyz, _leading(job, arm, wxyz, around), toward)
    positions = np.array([position, goal - APPROACH_M * toward, goal])
    return PathGeometry(positions, np.array([wxyz, turned, turned])), goal


def _leading(job: AimedJob, arm: str, wxyz: Vector, around: Surroundings) -> Vector:
    """(3,) the unit vector, now, that points along the straight last stretch once the tool is turned: the tool's
    axis, or what is to be put down."""
    if isinstance(job, scenario.Put):
        held = _held_m(arm, around)
        return held / max(length(held), 1e-9)
    return pointing(wxyz)


def _held_m(arm: str, around: Surroundings) -> Vector:
    """(3,) from an arm's tool to the free end of what it holds; zero if it holds nothing."""
    tool = around.tool_position_m[arm]
    for item in around.instruments.values():
        if item.holder == arm:
            return _free_end(item, tool) - tool
    return np.zeros(3)


def _free_end(instrument: Instrument, hand_m: Vector) -> Vector:
    """The end of an instrument that is away from the hand that holds it."""
    outward = (instrument.centre_m - hand_m) @ instrument.axis_m >= 0.0
    return instrument.centre_m + (instrument.axis_m if outward else -instrument.axis_m)


def _side_direction(side: scenario.Entry, base_m: Vector, tool_m: Vector) -> Vector:
    """Unit vector from an arm's tool to the side named, left and right as seen from its base."""
    if side == "above":
        return np.array([0.0, 0.0, 1.0])
    x, y, _ = (tool_m - base_m).tolist()
    out = math.hypot(x, y)
    # A tool right above its base has no left: the world's y axis stands in.
    left = np.array([-y / out, x / out, 0.0] if out > _NO_LEFT_M else [0.0, 1.0, 0.0])
    return left if side == "left" else -left
