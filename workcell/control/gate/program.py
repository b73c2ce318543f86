"""The gate's program: the command nearest to a given one that keeps rows, in order of their rank.

In: a command x (n,), the joints' box, own rates that nobody else is to blame for, and cuts, hard or soft. Out:
argmin |y - x|², every row kept where the joints can; what cannot be kept is missed least, soft rows first.
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from workcell.control.gate.data import Array
from workcell.control.laws.program import HARD, SOFT, UNBOUNDED
from workcell.control.laws.quadprog import SOLVED

MISS_SLACK_M_S = 1e-8
"""By how much more than the least a row may be missed: ten times the solver's tolerance."""
LEAST_PULL = 1e-6
"""Of a program that is to miss its rows least: enough to have one answer."""


class Rows(NamedTuple):
    """K rows of a program."""

    A: Array
    """(K, n)"""
    b: Array
    """(K,) A z >= b."""
    sense: NDArray[np.intc]
    """(K,) daqp's marks."""

    def and_these(self, more: Rows) -> Rows:
        """Both."""
        return Rows(
            np.concatenate([self.A, more.A]),
            np.concatenate([self.b, more.b]),
            np.concatenate([self.sense, more.sense]),
        )


def nearest(
    command: Array, low: Array, high: Array, own: Array, alone: Array, cuts: Rows
) -> Array | None:
    """The nearest command (n,) in a box that keeps own rates (K, n) >= alone (K,) before all that is soft.

    Where the joints cannot keep them all, they are missed least, and only then what is soft counts. None where the hard
    cuts have no solution.
    """
    hard = Rows(own, alone, np.full(len(own), HARD, dtype=np.intc))
    found = _solve(command, 1.0, low, high, hard.and_these(cuts))
    if found is not None or not len(own):
        return found
    # Alone, and pulled by nothing but the least miss: any preferred command would be paid for with more of it.
    stays = cuts.sense != SOFT
    needed = Rows(cuts.A[stays], cuts.b[stays], cuts.sense[stays])
    soft = hard._replace(sense=np.full(len(own), SOFT, dtype=np.intc))
    least = _solve(np.zeros_like(command), LEAST_PULL, low, high, soft.and_these(needed))
    if least is None:
        return None
    within = hard._replace(b=np.minimum(alone, own @ least - MISS_SLACK_M_S))
    found = _solve(command, 1.0, low, high, within.and_these(cuts))
    return least if found is None else found


def _solve(command: Array, pull: float, low: Array, high: Array, rows: Rows) -> Array | None:
    """(n,) what of a box and rows is nearest to a command; None where daqp finds nothing."""
    n = len(command)
    found, _, flag, _ = daqp.solve(
        pull * np.eye(n),
        -pull * command,
        np.ascontiguousarray(rows.A),
        np.concatenate([high, np.full(len(rows.b), UNBOUNDED)]),
        np.concatenate([low, rows.b]),
        np.concatenate([np.zeros(n), rows.sense]).astype(np.intc),
    )
    return found if flag in SOLVED and np.isfinite(found).all() else None
