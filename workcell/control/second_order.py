"""Second time derivative of pair distances (docs/theory.md section 3, paper equation 6).

In: what `proximity` measured, joint velocities (in the data) and joint accelerations. Out:
d'' = n (a_i - a_j) + n (omega_i x u s' - omega_j x v t') + n' (v_i - v_j), in which s' and t' say
how fast the witness points slide along their axes u and v. Dropping them is wrong by as much as
the value itself. Where the value is only an estimate, it says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import finite
from workcell.control.kernels.arguments import DONE
from workcell.control.proximity import CROSSING_TOLERANCE_M, PairGeometry, Proximity, cross

Array = NDArray[np.float64]

PARALLEL_SIN_SQUARED = 1e-8
"""Squared sine of the angle between axes that count as parallel.

The sliding speed of the witness points grows with one over this number; below it (0.006 degrees)
eight of the sixteen digits are lost and the speed tells nothing about the bodies.
"""
CLAMPED_TOLERANCE = 1e-9
"""Distance from an axis end, relative to the half axis, at which a witness point sits on it."""
FACE_MARGIN_M = 1e-6
"""Distance from a box edge below which a witness point counts as on the edge.

MuJoCo's iterative distance solver stops at this accuracy by default (`ccd_tolerance`).
"""


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
    qacc = finite("qacc", qacc)
    compiled = geometry.compiled(data)
    if compiled is not None:
        call = compiled.second_order
        kept = call.arrays
        kept["qacc"][...] = qacc
        if proximity.normal is not kept["normal"]:  # else it is measured there already
            kept["witness_i"][...] = proximity.witness_i_m
            kept["witness_j"][...] = proximity.witness_j_m
            kept["normal"][...], kept["degenerate"][...] = proximity.normal, proximity.degenerate
        call.run()
        if call.done() == DONE:
            return SecondOrder(*[kept[name].copy() for name in ("accel", "exact", "parallel")])
    return _second_order(geometry, data, proximity, qacc)


def _second_order(
    geometry: PairGeometry, data: mujoco.MjData, proximity: Proximity, qacc: Array
) -> SecondOrder:
    """`second_order` in NumPy; it also says what is wrong where compiled code only sees that something is."""
    w_i, w_j, n = proximity.witness_i_m, proximity.witness_j_m, proximity.normal
    i = _motion(geometry, data, geometry.moves_i, geometry.body_i, w_i, qacc)
    j = _motion(geometry, data, geometry.moves_j, geometry.body_j, w_j, qacc)
    half, centre = geometry.half_axes(data), geometry.centres(data)
    u, v = half[0::2], half[1::2]
    free_i, free_j = _may_slide(w_i - centre[0::2], u), _may_slide(w_j - centre[1::2], v)
    between = w_i - w_j
    relative_velocity = i.velocity - j.velocity
    direct = np.vecdot(n, i.acceleration - j.acceleration)

    # Two round geoms: the witness points slide so that they stay the nearest ones.
    slide_i, slide_j, parallel = _sliding(
        u, v, i.omega, j.omega, between, relative_velocity, free_i, free_j
    )
    turning = cross(i.omega, u) * slide_i[:, None] - cross(j.omega, v) * slide_j[:, None]
    across = relative_velocity + u * slide_i[:, None] - v * slide_j[:, None]
    across = across - np.vecdot(n, across)[:, None] * n
    axis_distance = np.linalg.norm(between, axis=1)
    apart = axis_distance > CROSSING_TOLERANCE_M
    # Crossing axes have no defined turning of n; the term is left out and the pair not exact.
    swing = np.divide(
        np.vecdot(across, relative_velocity), axis_distance, out=np.zeros(len(n)), where=apart
    )
    of_round_pair = direct + np.vecdot(n, turning) + swing

    # One flat geom: n turns with it, and its half space is all that is known of it.
    round_i, round_j = geometry.radius_i_m > 0.0, geometry.radius_j_m > 0.0
    flat_is_i = round_j & ~round_i
    n_dot = cross(np.where(flat_is_i[:, None], i.omega, j.omega), n)
    of_half_space = (
        direct
        + 2.0 * np.vecdot(n_dot, relative_velocity)
        - np.vecdot(n, between) * np.vecdot(n_dot, n_dot)
    )

    both = round_i & round_j
    end_on_face = np.where(
        flat_is_i,
        _on_face(data, geometry.geom_i, geometry.face_half_size_i_m, w_i) & ~free_j,
        _on_face(data, geometry.geom_j, geometry.face_half_size_j_m, w_j) & ~free_i & round_i,
    )
    parallel = parallel & both
    return SecondOrder(
        accel_m_s2=finite("accel_m_s2", np.where(both, of_round_pair, of_half_space)),
        exact=np.where(both, apart & ~parallel, end_on_face) & ~proximity.degenerate,
        parallel=parallel,
    )


@dataclass(frozen=True)
class _Motion:
    """Motion of the body (`omega`) and of its material points at the witness points, (P, 3)."""

    omega: Array
    velocity: Array
    acceleration: Array


def _motion(
    geometry: PairGeometry,
    data: mujoco.MjData,
    moves: Array,
    body: NDArray[np.int_],
    point: Array,
    qacc: Array,
) -> _Motion:
    twist = moves @ (data.cdof * data.qvel[:, None])
    change = moves @ (data.cdof_dot * data.qvel[:, None] + data.cdof * qacc[:, None])
    arm = point - data.subtree_com[geometry.body_root[body]]
    omega, alpha = twist[:, :3], change[:, :3]
    velocity = twist[:, 3:] + cross(omega, arm)
    # A spatial acceleration lacks the centripetal part of a material point's acceleration.
    acceleration = change[:, 3:] + cross(alpha, arm) + cross(omega, velocity)
    return _Motion(omega=omega, velocity=velocity, acceleration=acceleration)


def _may_slide(offset: Array, half: Array) -> NDArray[np.bool_]:
    """Whether a witness point lies inside its axis: at an end, or in a sphere, it cannot slide."""
    length_squared = np.vecdot(half, half)
    return np.abs(np.vecdot(offset, half)) < (1.0 - CLAMPED_TOLERANCE) * length_squared


def _sliding(
    u: Array,
    v: Array,
    omega_i: Array,
    omega_j: Array,
    between: Array,
    relative_velocity: Array,
    free_i: NDArray[np.bool_],
    free_j: NDArray[np.bool_],
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Sliding speeds along u and v, in half axes per second, and which pairs are parallel.

    They keep u e = 0 and v e = 0 true for the points that may slide, e being the line between
    the axes: [uu, -uv; uv, -vv] (s', t') = -(u e, v e) differentiated with s and t held.
    """
    uu, vv, uv = np.vecdot(u, u), np.vecdot(v, v), np.vecdot(u, v)
    drift_i = np.vecdot(cross(omega_i, u), between) + np.vecdot(u, relative_velocity)
    drift_j = np.vecdot(cross(omega_j, v), between) + np.vecdot(v, relative_velocity)
    determinant = uu * vv - uv**2
    # Parallel axes that overlap have many nearest points, wherever MuJoCo put the witness points;
    # those beside each other's ends are at an angle to the line between, and have one.
    parallel = (uu > 0.0) & (vv > 0.0) & (determinant <= PARALLEL_SIN_SQUARED * uu * vv)
    parallel &= np.vecdot(u, between) ** 2 <= (
        PARALLEL_SIN_SQUARED * uu * np.vecdot(between, between)
    )
    solve = free_i & free_j & ~parallel
    only_i, only_j = free_i & ~free_j, free_j & ~solve
    safe = np.where(solve, determinant, 1.0)
    slide_i = np.where(solve, (uv * drift_j - vv * drift_i) / safe, 0.0)
    slide_j = np.where(solve, (uu * drift_j - uv * drift_i) / safe, 0.0)
    np.divide(-drift_i, uu, out=slide_i, where=only_i)
    np.divide(drift_j, vv, out=slide_j, where=only_j)
    return slide_i, slide_j, parallel


def _on_face(
    data: mujoco.MjData, geom: NDArray[np.int_], half_size_m: Array, point: Array
) -> NDArray[np.bool_]:
    """Whether a surface point lies on a flat face, away from its edges."""
    frame = data.geom_xmat[geom].reshape(-1, 3, 3)
    local = np.einsum("pkl,pk->pl", frame, point - data.geom_xpos[geom])
    return (np.abs(local) < half_size_m - FACE_MARGIN_M).sum(axis=1) >= 2
