"""A strategy's own quadratic program: a cost, a hard box, soft rows."""

from __future__ import annotations

import numpy as np

from workcell.control.ik.qp import Program, solution
from workcell.control.laws.program import SOFT, UNBOUNDED
from workcell.control.tick import Array


def least_squares(
    H: Array, c: Array, rows: Array, needed_m_s: Array, low: Array, high: Array
) -> Array | None:
    """(n,) the minimum of ½ xᵀ H x + cᵀ x with rows @ x >= needed and low <= x <= high.

    Rows are missed, as little as possible, where the box leaves no other way.

    Args:
        H: (n, n), positive definite.
        c: (n,)
        rows, needed_m_s: (K, n) and (K,).
        low, high: (n,)

    Returns:
        None if the solver failed or was given a number that is not finite.
    """
    if not all(np.isfinite(array).all() for array in (H, c, rows, needed_m_s, low, high)):
        return None
    k = len(needed_m_s)
    return solution(
        Program(
            np.ascontiguousarray(H),
            np.ascontiguousarray(c),
            np.ascontiguousarray(rows),
            np.concatenate([low, needed_m_s]),
            np.concatenate([high, np.full(k, UNBOUNDED)]),
            np.concatenate([np.zeros(len(low), np.intc), np.full(k, SOFT, np.intc)]),
        )
    )
