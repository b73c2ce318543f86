"""Kinds of value that keys of a scenario file have, and the base of every table.

Every number has a bound on both sides. The bounds are far from anything a workcell has; they are chosen
so that what lies beyond is a slip of the pen or a wrong unit, and so that no number within them makes
arithmetic overflow.
"""

from __future__ import annotations

import math
import sys
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from workcell.errors import printable

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion in a file may be off 1 (rounded to three digits); it is then normalised."""

LARGEST_M = 100.0
"""Beyond the size of any cell; `scene` cuts distances off there."""
SMALLEST_M = 1e-6
"""A length that no encoder can tell from none."""
LONGEST_S = 7 * 86400.0
"""A week."""
SHORTEST_PERIOD_S = 1e-4
"""Of a control tick: a tenth of what a tick takes to compute."""
MOST_TICKS = 50_000_000
"""Of a run: more than a day at 2 ms."""
MOST_ARMS = 16
MOST_JOINTS = 100
"""Of an arm."""
MOST_THINGS = 200
"""Obstacles, or instruments."""
MOST_ENTRIES = 1000
"""Of `change`, `expect`, `vary`, and of a list of choices."""
MOST_WAYPOINTS = 500
"""Of one list: following them before the run takes a few seconds."""
LONGEST_PATH_M = 200.0
"""All waypoints of an arm together: following them before the run takes a few seconds."""
MOST_JOBS = 10_000
"""Of an arm, repetitions counted."""


def _unit(wxyz: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.sqrt(sum(x * x for x in wxyz))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise ValueError(
            f"a unit quaternion is needed (w, x, y, z; norm 1 within {UNIT_QUATERNION_TOLERANCE}), its norm is {norm:.6g}"
        )
    return tuple(x / norm for x in wxyz)


def _plain(text: str) -> str:
    if printable(text) != text:
        raise ValueError("control characters are not allowed here")
    return text


def at_least(lowest: float) -> AfterValidator:
    """Above 0 is not enough where one divides by the value."""

    def check(value: float) -> float:
        if value < lowest:
            raise ValueError(f"allowed is {lowest:g} or more")
        return value

    return AfterValidator(check)


def _normal(value: float) -> float:
    if 0.0 < abs(value) < sys.float_info.min:
        raise ValueError("a number this small has lost its digits; write 0")
    return value


NORMAL = AfterValidator(_normal)
"""MuJoCo's reader refuses numbers that a float can only hold with fewer digits."""
Finite = Annotated[float, Field(allow_inf_nan=False), NORMAL]
Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False), NORMAL, at_least(1e-6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False), NORMAL]
Coordinate = Annotated[float, Field(ge=-LARGEST_M, le=LARGEST_M, allow_inf_nan=False), NORMAL]
Length = Annotated[
    float, Field(gt=0, le=LARGEST_M, allow_inf_nan=False), NORMAL, at_least(SMALLEST_M)
]
LengthOrZero = Annotated[float, Field(ge=0, le=LARGEST_M, allow_inf_nan=False), NORMAL]
Duration = Annotated[float, Field(gt=0, le=LONGEST_S, allow_inf_nan=False), NORMAL, at_least(1e-6)]
DurationOrZero = Annotated[float, Field(ge=0, le=LONGEST_S, allow_inf_nan=False), NORMAL]
Speed = Annotated[float, Field(gt=0, le=100.0, allow_inf_nan=False), NORMAL, at_least(1e-4)]
"""Of a tool or a joint, m/s or rad/s."""
Acceleration = Annotated[float, Field(gt=0, le=1e5, allow_inf_nan=False), NORMAL, at_least(1e-3)]
"""Of a tool or a joint, m/s² or rad/s²."""
Turn = Annotated[float, Field(gt=0, le=1e3, allow_inf_nan=False), NORMAL, at_least(1e-6)]
"""An angle that may not be zero, rad."""
AngleOrZero = Annotated[float, Field(ge=0, le=1e3, allow_inf_nan=False), NORMAL]
JointPosition = Annotated[float, Field(ge=-1e3, le=1e3, allow_inf_nan=False), NORMAL]
"""rad, or m of a slide joint."""
Noise = Annotated[float, Field(ge=0, le=10.0, allow_inf_nan=False), NORMAL]
Mass = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False), NORMAL, at_least(1e-6)]
Shade = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False), NORMAL]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False), NORMAL]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Component = Annotated[float, Field(ge=-2, le=2, allow_inf_nan=False), NORMAL]
Quaternion = Annotated[tuple[Component, Component, Component, Component], AfterValidator(_unit)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=64)]
Label = Annotated[str, Field(max_length=200), AfterValidator(_plain)]
"""A name that something else gave, such as a site of an arm file."""
Description = Annotated[str, Field(max_length=10_000)]
FileName = Annotated[str, Field(min_length=1, max_length=4000), AfterValidator(_plain)]
Whole = Annotated[int, Field(ge=-(2**53), le=2**53)]
"""An integer that a float holds exactly."""
Entry = Literal["left", "right", "above"]
ToolTask = Literal["pose", "axis", "position"]
"""What of a tool's pose is asked for: all of it; its position and where its z axis points; its position alone."""


class Table(BaseModel):
    """A table of the file: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)
