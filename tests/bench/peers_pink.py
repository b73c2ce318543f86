"""Pink on Pinocchio: distances by Coal, rows by its SelfCollisionBarrier, the step by solve_ik.

A barrier of gain g is G v >= -g (d - d_min): g = 1/t_min and d_min = 0 make it t >= t_min.
"""

from __future__ import annotations

import numpy as np
import pink
import pinocchio as pin
from pink.barriers import SelfCollisionBarrier
from pink.limits import VelocityLimit
from pink.tasks import FrameTask

from tests.bench.peers import TOOL_WEIGHT, Problem, Rows, Wish


def build(problem: Problem) -> Pink:
    return Pink(problem)


class Pink:
    """See `peers.Peer`."""

    def __init__(self, problem: Problem):
        self._dt = problem.period_s
        model = pin.buildModelFromMJCF(str(problem.mjcf))
        geoms = pin.buildGeomFromMJCF(model, str(problem.mjcf), pin.GeometryType.COLLISION)
        if tuple(model.names)[1:] != problem.joints:
            raise ValueError(f"Pinocchio read the joints {list(model.names)[1:]}")
        for pair in problem.pairs:
            geoms.addCollisionPair(pin.CollisionPair(*(geoms.getGeometryId(name) for name in pair)))
        self._configuration = pink.Configuration(
            model, model.createData(), pin.neutral(model), collision_model=geoms
        )
        self._geoms, self._geoms_data = geoms, geoms.createData()
        count = len(problem.pairs)
        self._barrier = SelfCollisionBarrier(
            count, gain=1.0 / problem.t_min_s, safe_displacement_gain=0.0, d_min=0.0
        )
        cost = TOOL_WEIGHT**0.5
        self._tools = [
            FrameTask(_body_frame(model, name), position_cost=cost, orientation_cost=cost)
            for name in problem.tools
        ]
        self._limits = [VelocityLimit(model, problem.speed_rad_s)]

    def distances(self, qpos: np.ndarray) -> np.ndarray:
        """Pinocchio alone, without the Jacobians and contacts that Pink has computed along with it."""
        model, data = self._configuration.model, self._configuration.data
        pin.computeDistances(model, data, self._geoms, self._geoms_data, qpos)
        return np.array([result.min_distance for result in self._geoms_data.distanceResults])

    def rows(self, qpos: np.ndarray) -> Rows:
        """The rows come in the order into which the barrier partitions the distances."""
        self._configuration.update(qpos)
        G, h = self._barrier.compute_qp_inequalities(self._configuration, self._dt)
        results = self._configuration.collision_data.distanceResults
        count = len(h)
        order = np.argpartition([-result.min_distance for result in results], -count)[-count:]
        distance, rows = np.empty(count), np.empty_like(G)
        distance[order], rows[order] = h / self._barrier.gain, G * -self._dt
        return distance, rows

    def step(self, wish: Wish) -> np.ndarray:
        self._configuration.update(wish.qpos)
        for tool, target in zip(self._tools, wish.target, strict=True):
            tool.set_target(pin.SE3(target))
        return pink.solve_ik(
            self._configuration,
            self._tools,
            self._dt,
            solver="daqp",
            damping=1.0,
            limits=self._limits,
            barriers=[self._barrier],
        )


def _body_frame(model: pin.Model, body: str) -> str:
    """A frame of the body's name; Pink asks for it by name alone, so there may be only one."""
    if sum(frame.name == body for frame in model.frames) != 1:
        raise ValueError(f"Pinocchio has not exactly one frame {body}")
    return body
