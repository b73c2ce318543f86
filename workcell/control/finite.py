"""Refuse numbers that are not finite, by name: a NaN compares false with everything, so a bound
that is NaN would count as "not closing" and grant full speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.errors import WorkcellError


def finite(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise naming the first entry that is not finite.

    Args:
        name: What the values are, as it should read in the message.
        values: Any shape.

    Raises:
        WorkcellError: An entry is NaN or infinite.
    """
    array = np.asarray(values, dtype=float)
    good = np.isfinite(array)
    if not good.all():
        index = tuple(int(k) for k in np.argwhere(~good)[0])
        raise WorkcellError(f"{name}{list(index)} is {array[index]}; every entry must be finite")
    return array
