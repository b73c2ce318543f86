"""cbfpy: the program as a control barrier function of our making, h = d, solved by qpax.

cbfpy takes state, dynamics and h from its user and brings derivatives and solver. Here the state is
q, its rate is the control, and d is written in JAX: forward kinematics, then the nearest points of
segments and boxes. alpha(h) = h / t_min makes it t >= t_min.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from cbfpy import CBF, CBFConfig

from tests.bench.peers import TOOL_WEIGHT, Problem, Rows, Wish

jax.config.update(
    "jax_enable_x64", True
)  # qpax gets no further than 1e-3 rad/s in single precision

SOLVER_TOLERANCE = 1e-9
"""cbfpy's own, 1e-3, is as fast but misses joint velocities by 0.01 rad/s."""
_TINY = 1e-12
_CAPSULE, _BOX = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX


def build(problem: Problem) -> Cbfpy:
    return Cbfpy(problem)


class Cbfpy:
    """See `peers.Peer`."""

    def __init__(self, problem: Problem):
        cell = _Distances(problem)
        self._cbf = CBF.from_config(_Config(problem, cell))
        # The program gets h and Lgh from the very functions that are called here.
        self._distances = jax.jit(cell.distances)
        self._rows = jax.jit(lambda q: (self._cbf.h(q), self._cbf.Lgh(q)))
        self._none = np.zeros(len(problem.joints))

    def distances(self, qpos: np.ndarray) -> np.ndarray:
        return np.asarray(self._distances(qpos))

    def rows(self, qpos: np.ndarray) -> Rows:
        distance, rows = self._rows(qpos)
        return np.asarray(distance), np.asarray(rows)

    def step(self, wish: Wish) -> np.ndarray:
        return np.asarray(self._cbf.safety_filter(wish.qpos, self._none, wish.twist))


class _Config(CBFConfig):
    def __init__(self, problem: Problem, cell: _Distances):
        self._cell, self._t_min_s, self._n = cell, problem.t_min_s, len(problem.joints)
        super().__init__(
            n=self._n,
            m=self._n,
            u_min=-problem.speed_rad_s,
            u_max=problem.speed_rad_s,
            relax_qp=False,
            solver_tol=SOLVER_TOLERANCE,
            init_args=(np.zeros((len(problem.tools), 6)),),
        )

    def f(self, z, *args):
        return jnp.zeros(self._n)

    def g(self, z, *args):
        return jnp.eye(self._n)

    def h_1(self, z, *args):
        return self._cell.distances(z)

    def alpha(self, h, *args):
        return h / self._t_min_s

    def P(self, z, u_des, twist):
        J = self._cell.tool_jacobian(z)
        square = TOOL_WEIGHT * J.T @ J
        # cbfpy refuses what is symmetric but for rounding.
        return 2.0 * jnp.eye(self._n) + square + square.T

    def q(self, z, u_des, twist):
        return -2.0 * TOOL_WEIGHT * self._cell.tool_jacobian(z).T @ twist.ravel()


class _Distances:
    """Distances of all pairs as a function of q, in JAX; pairs of capsules, or capsule and box."""

    def __init__(self, problem: Problem):
        model = mujoco.MjModel.from_xml_path(str(problem.mjcf))
        if tuple(model.joint(j).name for j in range(model.njnt)) != problem.joints:
            raise ValueError("the plain scene has other joints")
        if (model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any() or model.jnt_pos.any():
            raise ValueError("only hinges at the origin of their body are written here")
        self._model = model
        self._tools = [model.body(name).id for name in problem.tools]
        self._radius = np.where(model.geom_type == _CAPSULE, model.geom_size[:, 0], 0.0)
        self._geom_rotation = np.stack([_matrix(quat) for quat in model.geom_quat])
        pairs = np.array([[model.geom(name).id for name in pair] for pair in problem.pairs])
        kind = model.geom_type[pairs]
        self._capsules = np.flatnonzero((kind == _CAPSULE).all(axis=1))
        self._boxes = np.flatnonzero((kind == (_CAPSULE, _BOX)).all(axis=1))
        if len(self._capsules) + len(self._boxes) != len(pairs):
            raise ValueError("only capsule-capsule and capsule-box pairs are written here")
        self._pairs = pairs
        self._order = np.argsort(np.concatenate([self._capsules, self._boxes]))

    def distances(self, q):
        """(P,)"""
        rotation, position = self._bodies(q)
        body = self._model.geom_bodyid
        turn = rotation[body] @ self._geom_rotation
        centre = position[body] + jnp.einsum("gij,gj->gi", rotation[body], self._model.geom_pos)
        half = turn[:, :, 2] * self._model.geom_size[:, 1:2]
        i, j = self._pairs[self._capsules].T
        capsules = _between_segments(centre[i], half[i], centre[j], half[j])
        capsules -= self._radius[i] + self._radius[j]
        i, j = self._pairs[self._boxes].T
        point = jnp.einsum("pij,pi->pj", turn[j], centre[i] - centre[j])
        along = jnp.einsum("pij,pi->pj", turn[j], half[i])
        boxes = _segment_to_box(point, along, self._model.geom_size[j]) - self._radius[i]
        return jnp.concatenate([capsules, boxes])[self._order]

    def tool_jacobian(self, q):
        """(6 A, nv) angular, then linear, of each tool's body."""
        rotation, position = self._bodies(q)
        model, rows = self._model, []
        axes = jnp.einsum("jkl,jl->jk", rotation[model.jnt_bodyid], model.jnt_axis)
        for tool in self._tools:
            moves = np.zeros(model.njnt)
            body = tool
            while body:
                moves[model.jnt_bodyid == body] = 1.0
                body = model.body_parentid[body]
            arm = position[tool] - position[model.jnt_bodyid]
            rows += [(axes * moves[:, None]).T, (jnp.cross(axes, arm) * moves[:, None]).T]
        return jnp.concatenate(rows)

    def _bodies(self, q):
        """Rotations (B, 3, 3) and positions (B, 3) in the world."""
        model = self._model
        rotations, positions = [jnp.eye(3)], [jnp.zeros(3)]
        for body in range(1, model.nbody):
            parent = model.body_parentid[body]
            rotation = rotations[parent] @ _matrix(model.body_quat[body])
            positions.append(positions[parent] + rotations[parent] @ model.body_pos[body])
            if model.body_jntnum[body]:
                joint = model.body_jntadr[body]
                rotation = rotation @ _about(model.jnt_axis[joint], q[joint])
            rotations.append(rotation)
        return jnp.stack(rotations), jnp.stack(positions)


def _between_segments(p, u, r, v):
    """Distances of the segments p ± u and r ± v, (P, 3) each.

    The nearest points are found without derivatives: by the envelope theorem they move d only at
    second order.
    """
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    e, f = _dot(u, p - r), _dot(v, p - r)
    free = (b * f - c * e) / jnp.maximum(a * c - b * b, _TINY)
    s = jnp.clip(free, -1.0, 1.0)
    t = jnp.clip((b * s + f) / c, -1.0, 1.0)
    s = jax.lax.stop_gradient(jnp.clip((b * t - e) / a, -1.0, 1.0))[:, None]
    t = jax.lax.stop_gradient(t)[:, None]
    return jnp.linalg.norm(p + s * u - r - t * v, axis=1)


def _segment_to_box(p, u, half_size):
    """Distances of the segments p ± u to boxes about the origin, all (P, 3), the segment outside.

    The squared distance along the segment is convex and quadratic between the crossings of the six
    faces: its slope is known there, and the root lies on the line between two of them.
    """
    safe = jnp.where(jnp.abs(u) < _TINY, _TINY, u)
    faces = jnp.concatenate([(half_size - p) / safe, (-half_size - p) / safe], axis=1)
    ends = jnp.ones((len(p), 1))
    at = jnp.sort(jnp.concatenate([jnp.clip(faces, -1.0, 1.0), -ends, ends], axis=1), axis=1)
    point = p[:, None] + at[:, :, None] * u[:, None]
    beyond = point - jnp.clip(point, -half_size[:, None], half_size[:, None])
    slope = _dot(beyond, u[:, None])
    after = jnp.clip(jnp.sum(slope < 0.0, axis=1), 1, at.shape[1] - 1)[:, None]
    low, high = (jnp.take_along_axis(slope, after - k, axis=1)[:, 0] for k in (1, 0))
    start, end = (jnp.take_along_axis(at, after - k, axis=1)[:, 0] for k in (1, 0))
    part = jnp.clip(-low / jnp.maximum(high - low, _TINY), 0.0, 1.0)
    s = jax.lax.stop_gradient(start + part * (end - start))[:, None]
    nearest = p + s * u
    return jnp.linalg.norm(nearest - jnp.clip(nearest, -half_size, half_size), axis=1)


def _dot(a, b):
    return jnp.sum(a * b, axis=-1)


def _matrix(quat: np.ndarray) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _about(axis: np.ndarray, angle):
    """Rotation about a fixed axis, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return jnp.eye(3) + jnp.sin(angle) * cross + (1.0 - jnp.cos(angle)) * (cross @ cross)
