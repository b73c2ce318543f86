"""All watched pairs as a tick sees them: distances, G = dd/dq, rates and the smallest time to collision.

What is kept here from tick to tick are the arrays; the arithmetic is `laws.time_to_collision`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workcell.control.laws import time_to_collision
from workcell.control.proximity import Proximity
from workcell.control.ttc import SmallestTtc
from workcell.errors import WorkcellError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

HYPOTHESES = 3
"""Velocity hypotheses of an arm, for others: what each joint lets through of what is asked of it, what it was last
commanded, and what its inverse kinematics makes of the task within its limits."""


class Rates(NamedTuple):
    """What a joint velocity of the whole cell does to the pairs."""

    rate_m_s: Array
    """ḋ = G q̇ (P,)."""
    first: SmallestTtc
    """The smallest time to collision among the pairs that count."""
    nearest: int | None
    """The pair of those that is nearest now; None in a cell without pairs."""
    cause: int | None
    """Which arm, by its number, closes the first pair most; None where nothing closes."""


class Watched:
    """What a tick knows of all watched pairs.

    Args:
        pairs: P, how many.
        dofs: Of each arm, indices into the cell's joint velocities.
        nv: Joint velocities of the cell.
    """

    def __init__(self, pairs: int, dofs: list[Indices], nv: int):
        self.distance_m = np.zeros(pairs)
        """d (P,)."""
        self.jacobian = np.zeros((pairs, nv))
        """G = dd/dq (P, nv), instruments moved by who holds them."""
        self.rate_m_s = np.zeros(pairs)
        """ḋ (P,) at the measured velocities."""
        self.accel_m_s2: Array | None = None
        """d̈ (P,) where second-order times are asked for."""
        self.inactive = np.zeros(pairs, dtype=bool)
        """(P,) pairs that do not count now: an instrument against the hand that holds it."""
        self.hypotheses_rad_s = np.zeros((HYPOTHESES, nv))
        """(HYPOTHESES, nv) what each arm is predicted to do in this tick."""
        self.change_rad_s = np.zeros(nv)
        """(nv,) by how much it may yet do otherwise: what accelerations allow in a tick, 0 once it has its command."""
        self._owner = np.full(nv, -1, dtype=np.int64)
        for arm, own in enumerate(dofs):
            self._owner[own] = arm
        self._part = np.zeros(len(dofs))
        self._velocity = np.zeros(nv)

    def take(self, proximity: Proximity, jacobian: Array) -> None:
        """Take this tick's distances and G."""
        self.distance_m[...], self.jacobian[...] = proximity.distance_m, jacobian

    def rates(self, velocity_rad_s: Array, accel_m_s2: Array | None = None) -> Rates:
        """What a velocity (nv,) of all joints does; with d̈ (P,) the times are of second order.

        Raises:
            WorkcellError: a number is not finite.
        """
        rate = np.empty(len(self.distance_m))
        self._velocity[...] = velocity_rad_s
        order, accel = (1, self.distance_m) if accel_m_s2 is None else (2, accel_m_s2)
        ttc_s, first, nearest, cause, bad = time_to_collision.rates(
            self.jacobian, self.distance_m, self._velocity, accel, order, self.inactive, self._owner,
            self._part, rate,
        )  # fmt: skip
        if bad >= 0:
            raise WorkcellError(
                f"watched pair {bad}: its distance {self.distance_m[bad]}, its rate or its second derivative is not finite"
            )
        return Rates(
            rate,
            SmallestTtc(ttc_s, first),
            nearest if len(rate) else None,
            None if cause < 0 else cause,
        )
