"""Time to collision of pairs, from distance and its time derivatives (docs/theory.md section 4).

In: distances, closing rates and, for second order, accelerations of P pairs. Out: the reciprocal
kappa = 1/t of each pair's estimated time to collision, the working quantity because it stays
bounded where t does not: 0 when a pair never meets, infinite when it has met. First order is
t = -d/d' (paper equation 8), second order the smallest positive root of d''/2 t^2 + d' t + d = 0
(paper equation 11). Plain arrays; no model is needed. The arithmetic is `laws.time_to_collision`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import alike, finite
from workcell.control.laws import time_to_collision as laws
from workcell.errors import WorkcellError

Array = NDArray[np.float64]


class SmallestTtc(NamedTuple):
    """The pair that would collide first."""

    ttc_s: float
    """Time to collision (s); infinite when no pair is on a collision course."""
    pair: int
    """Index of the pair, the lowest one among equals; -1 when `ttc_s` is infinite."""


def reciprocal_first_order(
    distance_m: ArrayLike, rate_m_s: ArrayLike, *, standoff_m: float = 0.0
) -> Array:
    """First-order reciprocal time to collision, kappa = max(0, -rate/(distance - standoff)).

    Args:
        distance_m: Surface distances (P,), negative when penetrating.
        rate_m_s: Their time derivatives (P,), negative when closing.
        standoff_m: Distance at which the count ends; 0 counts to contact.

    Returns:
        kappa (P,) in 1/s. Infinite for a penetrating pair (distance <= 0), whatever its rate, and
        for one inside the standoff that still closes; one inside the standoff that opens or
        stands has 0, as leaving must not be slowed.

    Raises:
        WorkcellError: An input is not finite.
    """
    standoff_m = _checked_standoff(standoff_m)
    distance, rate = alike(finite("distance_m", distance_m), finite("rate_m_s", rate_m_s))
    kappa = np.empty(distance.shape)
    laws.reciprocal_first_order(distance.ravel(), rate.ravel(), standoff_m, kappa.ravel())
    return kappa


def reciprocal_second_order(
    distance_m: ArrayLike, rate_m_s: ArrayLike, accel_m_s2: ArrayLike, *, standoff_m: float = 0.0
) -> Array:
    """Second-order reciprocal time to collision: 1 over the smallest positive root t.

    Written for kappa the quadratic is gap kappa^2 + rate kappa + accel/2 = 0, whose largest root,
    (-rate + sqrt(rate^2 - 2 accel gap)) / (2 gap), is the earliest collision. For rate > 0 the
    same root is -accel / (rate + sqrt(...)), so neither form ever subtracts like numbers, and
    accel -> 0 goes over into the first order. Complex roots mean the pair turns round in time.

    Args:
        distance_m: Surface distances (P,).
        rate_m_s: Their first time derivatives (P,).
        accel_m_s2: Their second time derivatives (P,).
        standoff_m: Distance at which the count ends; 0 counts to contact.

    Returns:
        kappa (P,) in 1/s; penetrating and standoff as in `reciprocal_first_order`, where a pair
        that stands inside the standoff and accelerates inwards counts as closing.

    Raises:
        WorkcellError: An input is not finite.
    """
    standoff_m = _checked_standoff(standoff_m)
    distance, rate, accel = alike(
        finite("distance_m", distance_m),
        finite("rate_m_s", rate_m_s),
        finite("accel_m_s2", accel_m_s2),
    )
    kappa = np.empty(distance.shape)
    laws.reciprocal_second_order(
        distance.ravel(), rate.ravel(), accel.ravel(), standoff_m, kappa.ravel()
    )
    return kappa


def smallest(kappa_per_s: ArrayLike) -> SmallestTtc:
    """The pair with the shortest time to collision.

    Args:
        kappa_per_s: Reciprocals (P,), P may be 0.

    Raises:
        WorkcellError: A reciprocal is NaN or negative.
    """
    kappa = np.ascontiguousarray(kappa_per_s, dtype=float)
    ttc_s, pair, bad = laws.smallest(kappa)
    if bad >= 0:
        raise WorkcellError(f"kappa_per_s[{bad}] is {kappa[bad]}; must be a number >= 0")
    return SmallestTtc(ttc_s, pair)


def _checked_standoff(standoff_m: float) -> float:
    if not 0.0 <= standoff_m < np.inf:
        raise WorkcellError(f"standoff_m is {standoff_m}; must be a finite number >= 0")
    return standoff_m
