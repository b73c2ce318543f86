"""Distances, directions, G and second derivatives of all pairs at once (theory: sections 1 to 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workcell.control.proximity import PairGeometry, Proximity
from workcell.control.second_order import SecondOrder

CROSSING_M = COINCIDENT_M = 1e-9
SURFACE_M = 1e-6
PARALLEL_SINE = 1e-6
PARALLEL_SIN_SQUARED = 1e-8
CLAMPED = 1e-9
FACE_MARGIN_M = 1e-6


def measure(geometry: PairGeometry, data) -> Proximity | str:
    """What `PairGeometry.measure` finds, or what is wrong with it."""
    fromto = data.sensordata[geometry.sensor_adr[:, None] + np.arange(6)]
    if not fromto.any(axis=1).all():
        return "reads zero"
    surface_i, surface_j = fromto[:, :3], fromto[:, 3:]
    centre = data.geom_xpos[geometry.geom]
    half = half_axes(geometry, data)
    radius_i, radius_j = geometry.radius_m.T
    radii = radius_i + radius_j
    round_i, round_j = radius_i > 0.0, radius_j > 0.0
    witness_i = np.where(round_i[:, None], nearest(surface_i, centre[:, 0], half[:, 0]), surface_i)
    witness_j = np.where(round_j[:, None], nearest(surface_j, centre[:, 1], half[:, 1]), surface_j)
    gap = surface_i - surface_j
    gap_m = np.linalg.norm(gap, axis=1)

    along = witness_i - witness_j
    distance = np.linalg.norm(along, axis=1) - radii
    chosen = np.zeros(len(radii), dtype=bool)

    # Both round and deep in each other: from the surface points, which have passed each other.
    deep = round_i & round_j & (2.0 * gap_m > radii) & (distance < CROSSING_M)
    inwards = -gap[deep] / gap_m[deep, None]
    along[deep], distance[deep] = inwards, -gap_m[deep]
    witness_i[deep] = surface_i[deep] + radius_i[deep, None] * inwards
    witness_j[deep] = surface_j[deep] - radius_j[deep, None] * inwards
    crossing = deep & (gap_m > radii - CROSSING_M)
    along[crossing] = perpendicular(half[crossing, 0], half[crossing, 1])
    chosen |= crossing

    # One round: from its surface point to its axis point.
    one = round_i ^ round_j
    to_axis = np.where(round_i[:, None], witness_i - surface_i, -(witness_j - surface_j))
    to_axis_m = np.linalg.norm(to_axis, axis=1)
    measured = np.vecdot(to_axis, gap) / np.maximum(to_axis_m, np.finfo(float).tiny)
    unknown = np.abs(to_axis_m - radii) > SURFACE_M
    measured = np.where(unknown, np.minimum(measured, -radii), measured)
    along[one], distance[one] = to_axis[one], measured[one]
    chosen |= one & unknown

    # None round: the line of the surface points, or of the centres at contact.
    none = ~(round_i | round_j)
    centres = centre[:, 0] - centre[:, 1]
    side = np.where(np.vecdot(gap, centres - gap) < 0.0, -1.0, 1.0)
    touching = gap_m < COINCIDENT_M
    flat = np.where(touching[:, None], centres, side[:, None] * gap)
    along[none], distance[none] = flat[none], (side * gap_m)[none]
    chosen |= none & touching

    length = np.linalg.norm(along, axis=1)
    along[length == 0.0] = 1.0, 0.0, 0.0
    chosen |= length == 0.0
    if not np.isfinite(distance).all():
        return "not finite"
    normal = along / np.linalg.norm(along, axis=1)[:, None]
    line = np.concatenate([np.cross(witness_i, normal), normal], axis=1)
    screws = data.cdof.copy()
    screws[:, 3:] += np.cross(data.subtree_com[geometry.dof_root], screws[:, :3])
    jacobian = geometry.sign * (line @ screws.T)
    return Proximity(distance, normal, witness_i, witness_j, surface_i, surface_j, jacobian, chosen)


def half_axes(geometry: PairGeometry, data) -> np.ndarray:
    """(P, 2, 3) from the geoms' centres to the ends of their axes."""
    frames = data.geom_xmat[geometry.geom].reshape(-1, 2, 3, 3)
    return frames[..., 2] * geometry.half_length_m[..., None]


def nearest(point, centre, half) -> np.ndarray:
    """The point of each axis (centre +- half) nearest to a point."""
    square = np.vecdot(half, half)
    along = np.divide(
        np.vecdot(point - centre, half), square, out=np.zeros(len(half)), where=square > 0.0
    )
    return centre + np.clip(along, -1.0, 1.0)[:, None] * half


def perpendicular(u, v) -> np.ndarray:
    """A vector perpendicular to u and v; to the longer one where they are parallel; else zero."""
    crossed = np.cross(u, v)
    longer = np.where((np.vecdot(u, u) >= np.vecdot(v, v))[:, None], u, v)
    any_side = np.cross(longer, np.eye(3)[np.argmin(np.abs(longer), axis=1)])
    scale = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    skew = np.linalg.norm(crossed, axis=1) > PARALLEL_SINE * scale
    return np.where(skew[:, None], crossed, any_side)


@dataclass(frozen=True)
class _Motion:
    omega: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


def second_order(geometry: PairGeometry, data, near: Proximity, qacc) -> SecondOrder:
    """The second derivatives of all distances."""
    w_i, w_j, n = near.witness_i_m, near.witness_j_m, near.normal
    i, j = _motion(geometry, data, 0, w_i, qacc), _motion(geometry, data, 1, w_j, qacc)
    half, centre = half_axes(geometry, data), data.geom_xpos[geometry.geom]
    u, v = half[:, 0], half[:, 1]
    free_i, free_j = _may_slide(w_i - centre[:, 0], u), _may_slide(w_j - centre[:, 1], v)
    between, relative = w_i - w_j, i.velocity - j.velocity
    direct = np.vecdot(n, i.acceleration - j.acceleration)

    slide_i, slide_j, parallel = _sliding(u, v, i.omega, j.omega, between, relative, free_i, free_j)
    turning = np.cross(i.omega, u) * slide_i[:, None] - np.cross(j.omega, v) * slide_j[:, None]
    across = relative + u * slide_i[:, None] - v * slide_j[:, None]
    across = across - np.vecdot(n, across)[:, None] * n
    axis_m = np.linalg.norm(between, axis=1)
    apart = axis_m > CROSSING_M
    swing = np.divide(np.vecdot(across, relative), axis_m, out=np.zeros(len(n)), where=apart)
    of_round_pair = direct + np.vecdot(n, turning) + swing

    round_i, round_j = geometry.radius_m.T > 0.0
    flat_is_i = round_j & ~round_i
    n_dot = np.cross(np.where(flat_is_i[:, None], i.omega, j.omega), n)
    of_half_space = (
        direct + 2.0 * np.vecdot(n_dot, relative) - np.vecdot(n, between) * np.vecdot(n_dot, n_dot)
    )
    both = round_i & round_j
    end_on_face = np.where(
        flat_is_i,
        _on_face(geometry, data, 0, w_i) & ~free_j,
        _on_face(geometry, data, 1, w_j) & ~free_i & round_i,
    )
    return SecondOrder(
        np.where(both, of_round_pair, of_half_space),
        np.where(both, apart & ~parallel, end_on_face) & ~near.degenerate,
        parallel & both,
    )


def _motion(geometry: PairGeometry, data, end: int, point, qacc) -> _Motion:
    """Of the body and of its material point at the witness point; twists summed over the joints that move it."""
    model_moves = _moves(geometry)[geometry.body[:, end]]
    twist = model_moves @ (data.cdof * data.qvel[:, None])
    change = model_moves @ (data.cdof_dot * data.qvel[:, None] + data.cdof * qacc[:, None])
    arm = point - data.subtree_com[geometry.body_root[geometry.body[:, end]]]
    omega = twist[:, :3]
    velocity = twist[:, 3:] + np.cross(omega, arm)
    acceleration = change[:, 3:] + np.cross(change[:, :3], arm) + np.cross(omega, velocity)
    return _Motion(omega, velocity, acceleration)


def _moves(geometry: PairGeometry) -> np.ndarray:
    """(nbody, nv) 1 where a joint moves a body, itself or through a parent."""
    moves = np.zeros((len(geometry.body_root), len(geometry.dof_body)))
    moves[geometry.dof_body, np.arange(len(geometry.dof_body))] = 1.0
    for body in range(1, len(moves)):
        moves[body] += moves[geometry.body_parent[body]]
    return moves


def _may_slide(offset, half) -> np.ndarray:
    return np.abs(np.vecdot(offset, half)) < (1.0 - CLAMPED) * np.vecdot(half, half)


def _sliding(u, v, omega_i, omega_j, between, relative, free_i, free_j) -> tuple:
    uu, vv, uv = np.vecdot(u, u), np.vecdot(v, v), np.vecdot(u, v)
    drift_i = np.vecdot(np.cross(omega_i, u), between) + np.vecdot(u, relative)
    drift_j = np.vecdot(np.cross(omega_j, v), between) + np.vecdot(v, relative)
    determinant = uu * vv - uv**2
    parallel = (uu > 0.0) & (vv > 0.0) & (determinant <= PARALLEL_SIN_SQUARED * uu * vv)
    parallel &= np.vecdot(u, between) ** 2 <= (
        PARALLEL_SIN_SQUARED * uu * np.vecdot(between, between)
    )
    solve = free_i & free_j & ~parallel
    safe = np.where(solve, determinant, 1.0)
    slide_i = np.where(solve, (uv * drift_j - vv * drift_i) / safe, 0.0)
    slide_j = np.where(solve, (uu * drift_j - uv * drift_i) / safe, 0.0)
    np.divide(-drift_i, uu, out=slide_i, where=free_i & ~free_j)
    np.divide(drift_j, vv, out=slide_j, where=free_j & ~solve)
    return slide_i, slide_j, parallel


def _on_face(geometry: PairGeometry, data, end: int, point) -> np.ndarray:
    geom = geometry.geom[:, end]
    frame = data.geom_xmat[geom].reshape(-1, 3, 3)
    local = np.einsum("pkl,pk->pl", frame, point - data.geom_xpos[geom])
    half_size = geometry.face_half_size_m[:, end]
    return (np.abs(local) < half_size - FACE_MARGIN_M).sum(axis=1) >= 2
