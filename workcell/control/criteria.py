"""Null-space criteria over the watched pairs of one arm (docs/theory.md section 6).

In: distances, closing rates and Jacobian rows of the pairs that belong to an arm. Out: the value
of ARTC (paper equation 18) or ARMD (equation 17), its gradient, and a quadratic objective whose
descent in joint velocities lowers it, for the inverse kinematics to follow in the null space.
The 1/(MN) of the paper is one over the number of pairs given: pairs left out do not count.
Plain arrays; pass the rows of an arm's pairs and the columns of its dofs. The arithmetic is `laws.criteria`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell import plugins
from workcell.control.finite import alike, finite
from workcell.control.laws import criteria as laws
from workcell.errors import WorkcellError

Array = NDArray[np.float64]

KINDS: dict[str, int] = plugins.built_in("criteria")
"""The numbers by which the laws know our own criteria."""
CRITERIA: tuple[str, ...] = tuple(KINDS)
"""Their names."""


class NullspaceObjective(NamedTuple):
    """Minimising 1/2 q' H q' + c' q' over joint velocities q' descends a criterion."""

    hessian: Array
    """H (n, n), symmetric and positive semidefinite; zero for the criteria that are linear."""
    linear: Array
    """c (n,), the gradient at zero joint velocity."""

    @classmethod
    def nothing(cls, n: int) -> NullspaceObjective:
        """What asks for nothing of n joints."""
        return cls(np.zeros((n, n)), np.zeros(n))


def artc_signed(distance_m: ArrayLike, rate_m_s: ArrayLike) -> float:
    """Signed ARTC (1/s): the mean of -rate/distance; opening pairs count negative. 0 if no pairs.

    Args:
        distance_m: (P,), floored at `DISTANCE_FLOOR_M`.
        rate_m_s: (P,).
    """
    return _means(distance_m, rate_m_s, approaching=False)[0]


def artc_approaching(distance_m: ArrayLike, rate_m_s: ArrayLike) -> float:
    """Approaching ARTC (1/s): the mean of max(0, -rate/distance); opening pairs count 0."""
    return _means(distance_m, rate_m_s, approaching=True)[0]


def armd(distance_m: ArrayLike) -> float:
    """ARMD (1/m): the mean of 1/distance. 0 if no pairs."""
    return _means(distance_m, 0.0, approaching=False)[1]


def artc_signed_gradient(distance_m: ArrayLike, jacobian: ArrayLike) -> Array:
    """Gradient of signed ARTC in the joint velocities (n,): -(1/P) sum of G/d.

    It is also the gradient in the joint positions of the log barrier -(1/P) sum ln d.

    Args:
        distance_m: (P,).
        jacobian: G = dd/dq, (P, n) in m/rad.
    """
    return objective("artc", distance_m, 0.0, jacobian).linear


def armd_gradient(distance_m: ArrayLike, jacobian: ArrayLike) -> Array:
    """Gradient of ARMD in the joint positions (n,): -(1/P) sum of G/d^2."""
    return objective("armd", distance_m, 0.0, jacobian).linear


def objective(
    criterion: str,
    distance_m: ArrayLike,
    rate_m_s: ArrayLike,
    jacobian: ArrayLike,
    *,
    other_rate_m_s: ArrayLike = 0.0,
) -> NullspaceObjective:
    """The quadratic objective in an arm's joint velocities that descends a criterion.

    "artc", "artc_held" and "armd" are linear: they need damping (or bounds) from whoever minimises them.
    "artc_approaching" is the least-squares residual (1/2P) sum of ((G q' + b)/d)^2 over the
    pairs that close now.

    Args:
        criterion: One of `CRITERIA`.
        distance_m: (P,) of the arm's pairs.
        rate_m_s: (P,) total rates, which decide what closes; used by "artc_approaching", and by "artc_held", which
            wants them without the arm's own self-motion.
        jacobian: (P, n) in m/rad, columns of the arm's own joints.
        other_rate_m_s: b, (P,) or 0: the part of the rate that other arms cause. 0 is the static
            variant (paper equation 12).

    Raises:
        WorkcellError: An unknown criterion, or an input that is not finite.
    """
    kind = KINDS.get(criterion)
    if kind is None:
        raise WorkcellError(f"criterion is {criterion!r}; must be one of {', '.join(CRITERIA)}")
    rows = np.asarray(finite("jacobian", jacobian), order="C")
    distance, rate, other, _ = alike(
        finite("distance_m", distance_m),
        finite("rate_m_s", rate_m_s),
        finite("other_rate_m_s", other_rate_m_s),
        np.zeros(len(rows)),
    )
    pairs, n = rows.shape
    hessian, linear = np.zeros((n, n)), np.zeros(n)
    laws.objective(
        kind, rows, distance, rate, other, np.arange(pairs), np.arange(n), hessian, linear
    )
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
    q, lower, upper = alike(
        finite("q_rad", q_rad),
        np.asarray(lower_rad, dtype=float),
        np.asarray(upper_rad, dtype=float),
    )
    linear = np.array(objective.linear, dtype=float)
    laws.push_from_stops(q, np.arange(len(q)), lower, upper, weight, linear)
    return NullspaceObjective(objective.hessian, linear)


def _means(distance_m: ArrayLike, rate_m_s: ArrayLike, *, approaching: bool) -> tuple[float, float]:
    """ARTC and ARMD of all pairs."""
    distance, rate = alike(finite("distance_m", distance_m), finite("rate_m_s", rate_m_s))
    artc, armd, _ = laws.means(distance, rate, np.arange(len(distance)), approaching)
    return artc, armd
