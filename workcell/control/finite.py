"""Refuse numbers that are not finite, by name: a NaN compares false with everything, so a bound
that is NaN would count as "not closing" and grant full speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.errors import ControlFault, InputError, WorkcellError, shown


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


def positive(name: str, value: float) -> float:
    """A setting that must be a finite number > 0; raises `InputError` by name if it is not."""
    if not (_is_number(value) and 0.0 < value < math.inf):
        raise InputError(f"{name} is {shown(value)}; allowed is a finite number > 0")
    return float(value)


def at_least_zero(name: str, value: float) -> float:
    """A setting that must be a finite number >= 0; raises `InputError` by name if it is not."""
    if not (_is_number(value) and 0.0 <= value < math.inf):
        raise InputError(f"{name} is {shown(value)}; allowed is a finite number >= 0")
    return float(value)


def vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """`values` as (size,) finite floats; raises `InputError` by name if they are not."""
    array = np.asarray(values, dtype=float)
    if array.shape != (size,):
        raise InputError(f"{name} has shape {array.shape}; allowed is ({size},)")
    if not all_finite(array):
        raise InputError(f"{name} is {array.tolist()}; every entry must be finite")
    return array


def joint_indices(dofs: ArrayLike, nv: int) -> NDArray[np.intp]:
    """(n,) indices of joints in a joint velocity of nv entries; raises `InputError` if one is not, or comes twice."""
    array = np.asarray(dofs)
    good = array.ndim == 1 and array.size and np.issubdtype(array.dtype, np.integer)
    if (
        not good
        or (array < 0).any()
        or (array >= nv).any()
        or len(set(array.tolist())) < len(array)
    ):
        raise InputError(
            f"dofs is {shown(array.tolist())}; allowed are different integers from 0 to {nv - 1}"
        )
    return array.astype(np.intp)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def all_finite(array: NDArray[np.float64]) -> bool:
    """Whether every entry is finite, at a third of the cost of looking at each.

    Whatever is not finite makes the sum of squares so too. Numbers beyond 1e154 can as well; only
    then are the entries looked at. (`vdot` does not warn of them, as `dot` does.)
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
