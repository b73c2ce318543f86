"""Refuse numbers that are not finite, by name: a NaN compares false with everything, so a bound
that is NaN would count as "not closing" and grant full speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.errors import ControlFault, WorkcellError


def finite(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise naming the first entry that is not finite.

    Args:
        name: What the values are, as it should read in the message.
        values: Any shape.

    Raises:
        WorkcellError: An entry is NaN or infinite.
    """
    array = np.asarray(values, dtype=float)
    if not all_finite(array):
        index = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise WorkcellError(f"{name}{list(index)} is {array[index]}; every entry must be finite")
    return array


def all_finite(array: NDArray[np.float64]) -> bool:
    """Whether every entry is finite, at a third of the cost of looking at each.

    Whatever is not finite makes the sum of squares so too. Numbers beyond 1e154 can as well; only
    then are the entries looked at.
    """
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def alike(*arrays: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """The arrays broadcast against each other, C-contiguous; as they are where they are so already."""
    shape = np.broadcast_shapes(*(array.shape for array in arrays))
    return tuple(
        np.asarray(array, order="C") if array.shape == shape else np.full(shape, array)
        for array in arrays
    )


def require_finite(tick: int, values: NDArray[np.float64], what: str) -> None:
    """Raise a `ControlFault` of this tick that names what is not finite."""
    if not all_finite(values):
        raise ControlFault(tick, f"{what}, is not finite: {np.asarray(values).tolist()}")
