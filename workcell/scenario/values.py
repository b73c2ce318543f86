"""Kinds of value that keys of a scenario file have, and the base of every table."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

UNIT_QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion in a file may be off 1 (rounded to three digits); it is then normalised."""


def _unit(wxyz: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.sqrt(sum(x * x for x in wxyz))
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise ValueError(
            f"a unit quaternion is needed (w, x, y, z; norm 1 within {UNIT_QUATERNION_TOLERANCE}), its norm is {norm:.6g}"
        )
    return tuple(x / norm for x in wxyz)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_unit)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Entry = Literal["left", "right", "above"]


class Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)
