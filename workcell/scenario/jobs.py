"""What a support arm does by itself: one table for each `kind` of job."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workcell.scenario.operators import Waypoint
from workcell.scenario.values import (
    MOST_WAYPOINTS,
    Acceleration,
    Duration,
    DurationOrZero,
    Entry,
    Length,
    Name,
    Speed,
    Table,
    ToolTask,
)


class _Motion(Table):
    """What every job with a path has; the acceleration bounds its start and its end."""

    speed_m_s: Speed = 0.15
    acceleration_m_s2: Acceleration = 0.5
    task: ToolTask | None = None


class Move(_Motion):
    """Move the tool along waypoints."""

    kind: Literal["move"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=MOST_WAYPOINTS)]
    free_rotation: bool = False


class Meet(_Motion):
    """Approach another arm's tool until the two tools are d_min apart, then dwell."""

    kind: Literal["meet"]
    arm: Name
    dwell_s: DurationOrZero = 0.5


class Fetch(_Motion):
    """Take an instrument from where it lies, from above."""

    kind: Literal["fetch"]
    instrument: Name
    dwell_s: DurationOrZero = 0.5


class Present(_Motion):
    """Bring the tool, or the instrument it holds, before another arm's tool, from a side seen from that arm's base."""

    kind: Literal["present"]
    arm: Name
    entry: Entry = "left"
    distance_m: Length = 0.15
    free_rotation: bool = False


class Exchange(_Motion):
    """Hand an instrument to another arm's tool, or take it from there."""

    kind: Literal["exchange"]
    arm: Name
    instrument: Name
    direction: Literal["give", "take"]
    dwell_s: DurationOrZero = 0.5


class Put(_Motion):
    """Bring an instrument back to where it lay at the start, free end down, and let go of it."""

    kind: Literal["put"]
    instrument: Name


class Wait(Table):
    """Stand still."""

    kind: Literal["wait"]
    duration_s: Duration


class Retreat(_Motion):
    """Go back along the path travelled since the start of the sequence."""

    kind: Literal["retreat"]
    free_rotation: bool = False


Job = Annotated[
    Move | Meet | Fetch | Present | Exchange | Put | Wait | Retreat, Field(discriminator="kind")
]
