"""Second time derivative of pair distances (docs/theory.md section 3, paper equation 6).

In: what `proximity` measured, joint velocities (in the data) and joint accelerations. Out:
d'' = n (a_i - a_j) + n (omega_i x u s' - omega_j x v t') + n' (v_i - v_j), in which s' and t' say
how fast the witness points slide along their axes u and v. Where the value is only an estimate, it
says so. The arithmetic is `laws.second_derivative`.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import finite
from workcell.control.laws.second_derivative import second_derivative
from workcell.control.proximity import PairGeometry, Proximity
from workcell.errors import WorkcellError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SecondOrder:
    """Second time derivative of the distances."""

    accel_m_s2: Array
    """(P,), always finite."""
    exact: NDArray[np.bool_]
    """(P,) false where the value is an estimate, see `second_order`."""
    parallel: NDArray[np.bool_]
    """(P,) true where axes are parallel and one of many admissible sliding motions was taken."""


def second_order(
    geometry: PairGeometry, data: mujoco.MjData, proximity: Proximity, qacc: ArrayLike
) -> SecondOrder:
    """Second time derivative of the distances at `data.qvel` and the given accelerations.

    Two round geoms: exact, where the axes are neither parallel nor crossing. Of parallel axes the
    witness point of i is held, or that of j if it sits on an end: one of many admissible choices
    (`parallel`).
    Otherwise the geom without a radius (j if neither has one) is replaced by the half space
    behind its witness point, turning with it. That is exact for a sphere or a capsule's end
    against a plane or the face of a box, a lower bound for them against any other convex geom,
    and an estimate for a capsule's side and for two geoms without a radius.

    Args:
        geometry: The pairs.
        data: As for `PairGeometry.measure`, and after `mj_comVel`; `qvel` is read from it.
        proximity: What `geometry.measure` returned for it.
        qacc: Joint accelerations (nv,); zero for an arm whose acceleration is unknown.

    Raises:
        WorkcellError: `qacc` or a result is not finite.
    """
    state = geometry.state(data)
    state.qacc[...] = finite("qacc", qacc)
    found = state.found
    if proximity.normal is not found.normal:  # else it is measured there already
        found.witness_i_m[...] = proximity.witness_i_m
        found.witness_j_m[...] = proximity.witness_j_m
        found.normal[...], found.degenerate[...] = proximity.normal, proximity.degenerate
    pair = second_derivative(*state.moving)
    if pair >= 0:
        raise WorkcellError(
            f"the second derivative of the distance of {geometry.names[pair]} is not finite; check qvel and qacc"
        )
    return SecondOrder(state.accel_m_s2.copy(), state.exact.copy(), state.parallel.copy())
