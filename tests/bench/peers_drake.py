"""Drake: distances by its QueryObject, rows by its CollisionChecker, the step by
DifferentialInverseKinematicsSystem.

Its collision constraint is 0 <= d + G v Δt, so that Δt = t_min makes it t >= t_min; nothing else
here reads Δt, as the tools are asked for as velocities. Its secondary cost is |P v|² with P the
projector into the tools' null space instead of |v|², which differs where pairs bind.
"""

from __future__ import annotations

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsSystem
from pydrake.multibody.math import SpatialVelocity
from pydrake.planning import (
    DofMask,
    JointLimits,
    RobotDiagramBuilder,
    SceneGraphCollisionChecker,
)
from pydrake.systems.framework import BusValue

from tests.bench.peers import EVERYTHING_M, TOOL_WEIGHT, Problem, Rows, Wish


def build(problem: Problem) -> Drake:
    return Drake(problem)


class Drake:
    """See `peers.Peer`."""

    def __init__(self, problem: Problem):
        self._count = len(problem.pairs)
        builder = RobotDiagramBuilder(time_step=0.0)
        instances = builder.parser().AddModels(str(problem.mjcf))
        plant = builder.plant()
        plant.Finalize()
        self._row_of_geoms, self._row_of_bodies = _watch(builder, problem.pairs)
        self._checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=instances, edge_step_size=0.1
        )
        plant = self._checker.plant()
        read = tuple(
            plant.get_joint(j).name()
            for j in plant.GetJointIndices(instances[0])
            if plant.get_joint(j).num_positions() == 1
        )
        if read != problem.joints:
            raise ValueError(f"Drake read the joints {read}")
        self._frames = [
            plant.GetBodyByName(name).body_frame().scoped_name().get_full()
            for name in problem.tools
        ]
        self._system = _inverse_kinematics(self._checker, problem)
        self._context = self._system.CreateDefaultContext()
        nominal = self._system.get_input_port_nominal_posture()
        nominal.FixValue(self._context, np.zeros(plant.num_positions()))

    def distances(self, qpos: np.ndarray) -> np.ndarray:
        self._checker.UpdatePositions(qpos)
        model = self._checker.model()
        context = self._checker.model_context().scene_graph_context()
        query = model.scene_graph().get_query_output_port().Eval(context)
        distance = np.empty(self._count)
        for found in query.ComputeSignedDistancePairwiseClosestPoints(EVERYTHING_M):
            distance[self._row_of_geoms[found.id_A, found.id_B]] = found.distance
        return distance

    def rows(self, qpos: np.ndarray) -> Rows:
        found = self._checker.CalcRobotClearance(qpos, EVERYTHING_M)
        order = [
            self._row_of_bodies[pair]
            for pair in zip(found.robot_indices(), found.other_indices(), strict=True)
        ]
        distance, jacobian = np.empty(len(order)), np.empty((len(order), len(qpos)))
        distance[order], jacobian[order] = found.distances(), found.jacobians()
        return distance, jacobian

    def step(self, wish: Wish) -> np.ndarray:
        wanted = BusValue()
        for frame, twist in zip(self._frames, wish.twist, strict=True):
            wanted.Set(frame, Value(SpatialVelocity(twist)))
        system, context = self._system, self._context
        system.get_input_port_position().FixValue(context, wish.qpos)
        velocities = system.get_input_port_desired_cartesian_velocities()
        velocities.FixValue(context, Value(wanted))
        return system.get_output_port_commanded_velocity().Eval(context)


def _watch(builder: RobotDiagramBuilder, pairs: tuple[tuple[str, str], ...]) -> tuple[dict, dict]:
    """Filter out all pairs but the watched ones; the row of each by geometries and by bodies."""
    scene, plant = builder.scene_graph(), builder.plant()
    inspector, manager = scene.model_inspector(), scene.collision_filter_manager()
    geoms = {
        inspector.GetName(g).split("::")[-1]: g
        for g in inspector.GetAllGeometryIds(Role.kProximity)
    }
    by_geoms, by_bodies = {}, {}
    for row, pair in enumerate(pairs):
        g, h = (geoms[name] for name in pair)
        b, c = (plant.GetBodyFromFrameId(inspector.GetFrameId(geoms[n])).index() for n in pair)
        by_geoms[g, h] = by_geoms[h, g] = row
        by_bodies[b, c] = by_bodies[c, b] = row
    watched = {frozenset(pair) for pair in pairs}
    for first in geoms:
        others = [geoms[n] for n in geoms if n != first and frozenset((first, n)) not in watched]
        manager.Apply(
            CollisionFilterDeclaration().ExcludeBetween(
                GeometrySet(geoms[first]), GeometrySet(others)
            )
        )
    return by_geoms, by_bodies


def _inverse_kinematics(
    checker: SceneGraphCollisionChecker, problem: Problem
) -> DifferentialInverseKinematicsSystem:
    kind = DifferentialInverseKinematicsSystem
    speed, free = problem.speed_rad_s, np.full_like(problem.speed_rad_s, np.inf)
    limits = JointLimits(-free, free, -speed, speed, -free, free)
    recipe = kind.Recipe()
    for ingredient in (
        kind.LeastSquaresCost(kind.LeastSquaresCost.Config(cartesian_qp_weight=TOOL_WEIGHT)),
        kind.JointCenteringCost(kind.JointCenteringCost.Config(posture_gain=0.0)),
        kind.CollisionConstraint(
            kind.CollisionConstraint.Config(influence_distance=EVERYTHING_M, safety_distance=0.0)
        ),
        kind.JointVelocityLimitConstraint(
            kind.JointVelocityLimitConstraint.Config(min_margin=0.0, influence_margin=1e-3), limits
        ),
    ):
        recipe.AddIngredient(ingredient)
    fast = SpatialVelocity(np.full(6, 1e3))  # so high that it clips no wish
    everything = DofMask(len(speed), True)
    return kind(recipe, "world", checker, everything, problem.t_min_s, 1.0, fast)
