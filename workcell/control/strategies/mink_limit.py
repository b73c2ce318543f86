"""`mink_limit`: mink's own inverse kinematics with its own collision limit.

One `mink.solve_ik` a tick: FrameTask on the tool, ConfigurationLimit, VelocityLimit and
CollisionAvoidanceLimit over the watched pairs of the arm, all other joints frozen. mink bounds a displacement by
gain times a distance over dt; so with `matched = true` the gain is dt²/t_min, which makes the limit mean
t >= t_min, and with `matched = false` it is the 0.85 that mink ships. The limit knows the arm's own motion
only, and drops pairs of geoms that may not touch. K. Zakka, mink 1.3.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from workcell.control.strategies import common
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Array, Steering

SHIPPED_GAIN = 0.85
"""Default of mink 1.3's CollisionAvoidanceLimit."""
SOLVER_DAMPING = 1e-6
"""Damping of mink's program, which without it is singular where the task leaves joints free."""


class MinkLimit:
    """Leaves the path where mink's limit asks for it; the path's clock goes on within `deviation_m`."""

    class Options(common.DeviationOptions, frozen=True):
        """Options."""

        matched: bool = True
        """Whether the gain means t >= t_min; as shipped otherwise."""

    def __init__(self, setup: StrategySetup):
        self._options = setup.options or self.Options()
        model, limits, settings = setup.model, setup.limits, setup.settings
        dt = setup.period_s
        self._configuration = mink.Configuration(model)
        self._task = mink.FrameTask(
            limits.tool_site_name,
            "site",
            position_cost=1.0,
            orientation_cost=1.0,
            gain=min(1.0, settings.task_gain_per_s * dt),
        )
        joints = [model.joint(model.dof_jntid[dof]).name for dof in limits.dofs]
        gain = dt**2 / settings.t_min_s if self._options.matched else SHIPPED_GAIN
        self._limits: list[mink.Limit] = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(
                model, dict(zip(joints, limits.velocity_limit_rad_s.tolist(), strict=True))
            ),
        ]
        own = _own_pairs(setup)
        if own:
            self._limits.append(
                mink.CollisionAvoidanceLimit(
                    model,
                    own,
                    gain=gain,
                    minimum_distance_from_collisions=settings.d_min_m,
                    collision_detection_distance=10.0,
                )
            )
        others = sorted(set(range(model.nv)) - set(limits.dofs.tolist()))
        self._frozen = [mink.DofFreezingTask(model, others)] if others else []

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        target = view.setpoint.target
        # The target where it will be at the end of the tick: mink has no feed-forward of its own.
        ahead = target.position_m + view.period_s * target.velocity_m_s
        self._task.set_target(mink.SE3(np.concatenate([target.wxyz, ahead])))
        self._configuration.update(view.sensed.qpos)
        velocity = self._solve(view)
        return common.answer(
            view,
            velocity,
            view.task_rad_s,
            status="optimal",
            clock=common.clock_rate(view, self._options.deviation_m),
            limiting_pair=None,
            off_path_m=self._options.deviation_m,
        )

    def _solve(self, view: ArmView) -> Array | None:
        try:
            velocity = mink.solve_ik(
                self._configuration,
                [self._task],
                view.period_s,
                "daqp",
                damping=SOLVER_DAMPING,
                limits=self._limits,
                constraints=self._frozen,
            )
        except mink.NoSolutionFound:
            return None
        found = velocity[view.dofs]
        return found if np.isfinite(found).all() else None


def _own_pairs(setup: StrategySetup) -> list[tuple[list[str], list[str]]]:
    """The watched pairs that this arm moves, as mink wants them."""
    model, own = setup.model, set(setup.limits.dofs.tolist())

    def moves(geom: int) -> bool:
        body = int(model.geom_bodyid[geom])
        while body:
            first, count = int(model.body_dofadr[body]), int(model.body_dofnum[body])
            if own & set(range(first, first + count)):
                return True
            body = int(model.body_parentid[body])
        return False

    def name(geom: int) -> str:
        return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom)

    return [
        ([name(int(i))], [name(int(j))])
        for i, j in setup.pair_geoms
        if moves(int(i)) or moves(int(j))
    ]
