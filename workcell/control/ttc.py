"""Time to collision of pairs, from distance and its time derivatives (docs/theory.md section 4).

In: distances, closing rates and, for second order, accelerations of P pairs. Out: the reciprocal
kappa = 1/t of each pair's estimated time to collision, the working quantity because it stays
bounded where t does not: 0 when a pair never meets, infinite when it has met. First order is
t = -d/d' (paper equation 8), second order the smallest positive root of d''/2 t^2 + d' t + d = 0
(paper equation 11). Plain arrays; no model is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import alike, finite
from workcell.control.kernels.library import ArrayFunction
from workcell.errors import WorkcellError

Array = NDArray[np.float64]

GRAZING_TOLERANCE = 1e-12
"""Relative size of a negative discriminant that still counts as a double root.

Two motions that just touch have discriminant zero, which rounding turns into some 1e-16 of either
sign. Chosen far above that, so that touching counts as a collision.
"""


_FIRST_ORDER = ArrayFunction("reciprocal_first_order", "distance", "rate")
_SECOND_ORDER = ArrayFunction("reciprocal_second_order", "distance", "rate", "accel")
_SMALLEST = ArrayFunction("smallest", "kappa")


@dataclass(frozen=True)
class SmallestTtc:
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
    found = _FIRST_ORDER(distance_m, rate_m_s, setting=standoff_m)
    if found is not None:
        return found["kappa"].copy()
    distance, rate = alike(finite("distance_m", distance_m), finite("rate_m_s", rate_m_s))
    gap = distance - standoff_m
    if gap.size and gap.min() > 0.0:  # Nothing has met yet: the usual case, in a third of the time.
        with np.errstate(over="ignore"):
            return np.maximum(-rate, 0.0) / gap
    kappa = np.zeros(gap.shape)
    with np.errstate(over="ignore"):  # A vanishing gap rightly overflows to an infinite kappa.
        np.divide(-rate, gap, out=kappa, where=(rate < 0.0) & (gap > 0.0))
    return _with_contact(kappa, distance, gap, closing=rate < 0.0)


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
    found = _SECOND_ORDER(distance_m, rate_m_s, accel_m_s2, setting=standoff_m)
    if found is not None:
        return found["kappa"].copy()
    distance, rate, accel = alike(
        finite("distance_m", distance_m),
        finite("rate_m_s", rate_m_s),
        finite("accel_m_s2", accel_m_s2),
    )
    gap = distance - standoff_m
    ahead = gap > 0.0
    reach = np.where(ahead, gap, 1.0)
    # Both terms of the discriminant are divided by the larger one's size, so that squaring
    # neither overflows nor underflows.
    curvature = np.sqrt(np.abs(accel)) * np.sqrt(reach)
    size = np.maximum(np.abs(rate), curvature)
    moving = ahead & (size > 0.0)
    size = np.where(moving, size, 1.0)
    speed = rate / size
    discriminant = speed**2 - 2.0 * np.sign(accel) * (curvature / size) ** 2
    root = np.sqrt(np.maximum(discriminant, 0.0))
    with np.errstate(over="ignore"):
        closing_root = size * (root - speed) / (2.0 * reach)
        opening_root = np.divide(
            -accel, size * (root + speed), out=np.zeros(gap.shape), where=moving & (speed > 0.0)
        )
    kappa = np.where(speed > 0.0, opening_root, closing_root)
    kappa = np.where(moving & (discriminant >= -GRAZING_TOLERANCE), np.maximum(kappa, 0.0), 0.0)
    return _with_contact(
        kappa, distance, gap, closing=(rate < 0.0) | ((rate == 0.0) & (accel < 0.0))
    )


def time_from_reciprocal(kappa_per_s: ArrayLike) -> Array:
    """Time to collision (s) for people: 1/kappa, infinite where kappa is 0, 0 where infinite."""
    kappa = np.asarray(kappa_per_s, dtype=float)
    with np.errstate(over="ignore"):  # A time beyond the range of floats is infinite.
        return np.divide(1.0, kappa, out=np.full(kappa.shape, np.inf), where=kappa != 0.0)


def smallest(kappa_per_s: ArrayLike) -> SmallestTtc:
    """The pair with the shortest time to collision.

    Args:
        kappa_per_s: Reciprocals (P,), P may be 0.

    Raises:
        WorkcellError: A reciprocal is NaN or negative.
    """
    found = _SMALLEST(kappa_per_s)
    if found is not None:
        return SmallestTtc(found["ttc"].item(), found["pair"].item())
    kappa = np.asarray(kappa_per_s, dtype=float)
    if kappa.size == 0:
        return SmallestTtc(ttc_s=np.inf, pair=-1)
    if not kappa.min() >= 0.0:  # The smallest of numbers with a NaN among them is NaN.
        pair = int(np.argmax(~(kappa >= 0.0)))
        raise WorkcellError(f"kappa_per_s[{pair}] is {kappa[pair]}; must be a number >= 0")
    pair = int(kappa.argmax())
    largest = float(kappa[pair])
    ttc_s = 1.0 / largest if largest > 0.0 else np.inf
    return SmallestTtc(ttc_s=ttc_s, pair=pair if ttc_s < np.inf else -1)


def _checked_standoff(standoff_m: float) -> float:
    if not 0.0 <= standoff_m < np.inf:
        raise WorkcellError(f"standoff_m is {standoff_m}; must be a finite number >= 0")
    return standoff_m


def _with_contact(kappa: Array, distance: Array, gap: Array, *, closing: NDArray) -> Array:
    """Set the pairs that have already met: there is no time left, so kappa is infinite."""
    return np.where((distance <= 0.0) | ((gap <= 0.0) & closing), np.inf, kappa)
