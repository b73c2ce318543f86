"""Null-space criteria over the watched pairs of one arm (docs/theory.md section 6).

In: distances, closing rates and Jacobian rows of the pairs that belong to an arm. Out: the value
of ARTC (paper equation 18) or ARMD (equation 17), its gradient, and a quadratic objective whose
descent in joint velocities lowers it, for the inverse kinematics to follow in the null space.
The 1/(MN) of the paper is one over the number of pairs given: pairs left out do not count.
Plain arrays; pass the rows of an arm's pairs and the columns of its dofs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import finite
from workcell.control.kernels.library import ArrayFunction
from workcell.errors import WorkcellError

Array = NDArray[np.float64]

CriterionName = Literal["artc", "artc_approaching", "armd", "none"]
CRITERIA: tuple[CriterionName, ...] = ("artc", "artc_approaching", "armd", "none")

# As compiled code numbers the criteria.
_SIGNED = ArrayFunction("average", "distance", "rate", kind=0)
_APPROACHING = ArrayFunction("average", "distance", "rate", kind=1)
_ARMD = ArrayFunction("average", "distance", kind=2)
_STOPS = ArrayFunction("with_room_to_stops", "q", "lower", "upper", "linear")
_DESCENTS = {
    "artc": ArrayFunction("objective", "distance", "rows", kind=0),
    "artc_approaching": ArrayFunction("objective", "distance", "rows", "rate", "other", kind=1),
    "armd": ArrayFunction("objective", "distance", "rows", kind=2),
}

DISTANCE_FLOOR_M = 1e-3
"""Distances below this count as this, touching and penetrating pairs included.

All criteria divide by distance and so grow without bound at contact, where they would drown the
rest of the average. One millimetre was chosen as the fit of a capsule to a real link, below which
ranking distances means nothing. `floored` tells which pairs were affected.
"""


STOP_MARGIN_RAD = 0.2
"""A joint nearer to its stop than this is pushed back in the null space; chosen as what a tool that works at one place moves it by."""
STOP_PUSH_RAD_S = 1.0
"""Push at the stop itself, falling with the square of the way into the margin; above what the criteria push with."""


@dataclass(frozen=True)
class NullspaceObjective:
    """Minimising 1/2 q' H q' + c' q' over joint velocities q' descends a criterion."""

    hessian: Array
    """H (n, n), symmetric and positive semidefinite; zero for the criteria that are linear."""
    linear: Array
    """c (n,), the gradient at zero joint velocity."""


def artc_signed(distance_m: ArrayLike, rate_m_s: ArrayLike) -> float:
    """Signed ARTC (1/s): the mean of -rate/distance; opening pairs count negative. 0 if no pairs.

    Args:
        distance_m: (P,), floored at `DISTANCE_FLOOR_M`.
        rate_m_s: (P,).
    """
    found = _SIGNED(distance_m, rate_m_s)
    if found is not None:
        return found["value"].item()
    return _mean(-finite("rate_m_s", rate_m_s) / _floor(distance_m))


def artc_approaching(distance_m: ArrayLike, rate_m_s: ArrayLike) -> float:
    """Approaching ARTC (1/s): the mean of max(0, -rate/distance); opening pairs count 0."""
    found = _APPROACHING(distance_m, rate_m_s)
    if found is not None:
        return found["value"].item()
    return _mean(np.maximum(0.0, -finite("rate_m_s", rate_m_s)) / _floor(distance_m))


def armd(distance_m: ArrayLike) -> float:
    """ARMD (1/m): the mean of 1/distance. 0 if no pairs."""
    found = _ARMD(distance_m)
    if found is not None:
        return found["value"].item()
    return _mean(1.0 / _floor(distance_m))


def artc_signed_gradient(distance_m: ArrayLike, jacobian: ArrayLike) -> Array:
    """Gradient of signed ARTC in the joint velocities (n,): -(1/P) sum of G/d.

    It is also the gradient in the joint positions of the log barrier -(1/P) sum ln d.

    Args:
        distance_m: (P,).
        jacobian: G = dd/dq, (P, n) in m/rad.
    """
    found = _DESCENTS["artc"](distance_m, jacobian)
    if found is not None:
        return found["linear"].copy()
    return _weighted_rows(jacobian, -1.0 / _floor(distance_m))


def armd_gradient(distance_m: ArrayLike, jacobian: ArrayLike) -> Array:
    """Gradient of ARMD in the joint positions (n,): -(1/P) sum of G/d^2."""
    found = _DESCENTS["armd"](distance_m, jacobian)
    if found is not None:
        return found["linear"].copy()
    return _weighted_rows(jacobian, -1.0 / _floor(distance_m) ** 2)


def objective(
    criterion: CriterionName,
    distance_m: ArrayLike,
    rate_m_s: ArrayLike,
    jacobian: ArrayLike,
    *,
    other_rate_m_s: ArrayLike = 0.0,
) -> NullspaceObjective:
    """The quadratic objective in an arm's joint velocities that descends a criterion.

    "artc" and "armd" are linear: they need damping (or bounds) from whoever minimises them.
    "artc_approaching" is the least-squares residual (1/2P) sum of ((G q' + b)/d)^2 over the
    pairs that close now.

    Args:
        criterion: One of `CRITERIA`.
        distance_m: (P,) of the arm's pairs.
        rate_m_s: (P,) total rates, which decide what closes; used by "artc_approaching" only.
        jacobian: (P, n) in m/rad, columns of the arm's own joints.
        other_rate_m_s: b, (P,) or 0: the part of the rate that other arms cause. 0 is the static
            variant (paper equation 12).

    Raises:
        WorkcellError: An unknown criterion, or an input that is not finite.
    """
    if criterion in _DESCENTS:
        rates = (rate_m_s, other_rate_m_s) if criterion == "artc_approaching" else ()
        found = _DESCENTS[criterion](distance_m, jacobian, *rates)
        if found is not None:
            return NullspaceObjective(found["hessian"].copy(), found["linear"].copy())
    rows = finite("jacobian", jacobian)
    n = rows.shape[1]
    hessian, linear = np.zeros((n, n)), np.zeros(n)
    if criterion == "artc":
        linear = artc_signed_gradient(distance_m, rows)
    elif criterion == "armd":
        linear = armd_gradient(distance_m, rows)
    elif criterion == "artc_approaching":
        closing = finite("rate_m_s", rate_m_s) < 0.0
        scaled = np.where(closing[:, None], rows / _floor(distance_m)[:, None], 0.0)
        other = finite("other_rate_m_s", other_rate_m_s) / _floor(distance_m)
        pairs = max(1, len(rows))
        hessian = scaled.T @ scaled / pairs
        linear = scaled.T @ np.broadcast_to(other, len(rows)) / pairs
    elif criterion != "none":
        raise WorkcellError(f"criterion is {criterion!r}; must be one of {', '.join(CRITERIA)}")
    return NullspaceObjective(hessian=hessian, linear=linear)


def with_room_to_stops(
    objective: NullspaceObjective,
    q_rad: ArrayLike,
    lower_rad: ArrayLike,
    upper_rad: ArrayLike,
    weight: float,
) -> NullspaceObjective:
    """The same objective with a push of every joint away from a stop that is near.

    A criterion that always prefers one side would lead a joint to its stop and keep it there, and the
    arm would be one joint short for what its tool has to do.

    Args:
        objective: The criterion's.
        q_rad: Joint positions (n,).
        lower_rad, upper_rad: Stops (n,), infinite where there is none.
        weight: Weight of the criterion against 1/2 |q'|^2, > 0: the push is a velocity, and does not
            grow with it.
    """
    found = _STOPS(
        q_rad,
        lower_rad,
        upper_rad,
        objective.linear,
        setting=(STOP_MARGIN_RAD, STOP_PUSH_RAD_S, weight),
    )
    if found is not None:
        if not found["any"][0]:
            return objective
        return NullspaceObjective(objective.hessian, found["pushed"].copy())
    q = finite("q_rad", q_rad)
    lower, upper = np.asarray(lower_rad, dtype=float), np.asarray(upper_rad, dtype=float)
    below = np.maximum(STOP_MARGIN_RAD - (q - lower), 0.0) / STOP_MARGIN_RAD
    above = np.maximum(STOP_MARGIN_RAD - (upper - q), 0.0) / STOP_MARGIN_RAD
    if not (below.any() or above.any()):
        return objective
    push = STOP_PUSH_RAD_S * (below * below - above * above)
    return NullspaceObjective(objective.hessian, objective.linear - push / weight)


def floored(distance_m: ArrayLike) -> NDArray[np.bool_]:
    """Which pairs (P,) are nearer than `DISTANCE_FLOOR_M` and so were counted at the floor."""
    return finite("distance_m", distance_m) < DISTANCE_FLOOR_M


def _floor(distance_m: ArrayLike) -> Array:
    return np.maximum(finite("distance_m", distance_m), DISTANCE_FLOOR_M)


def _mean(terms: Array) -> float:
    return float(np.add.reduce(terms)) / terms.size if terms.size else 0.0


def _weighted_rows(jacobian: ArrayLike, weights: Array) -> Array:
    return weights @ finite("jacobian", jacobian) / max(1, len(weights))
