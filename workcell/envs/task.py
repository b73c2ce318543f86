"""The task: one arm's tool goes to its goal, near to nothing.

Actions, observations, reward and ends are in docs/environments.md, with units. Subclass it to change one of them.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from workcell.control.commanded import Twist
from workcell.envs.physics import SessionPhysics
from workcell.envs.settings import EnvSettings

Array = NDArray[np.float64]

FARTHEST_M = 10.0
"""Distances are observed up to this: chosen beyond any arm's reach, so that an observation is finite."""


class ReachTask(control.Task):
    """Go to the goal; keep clear.

    Args:
        settings: Of the environment.
    """

    def __init__(self, settings: EnvSettings):
        self.settings = settings
        self._before: dict[str, Array] = {}
        self._velocity_m_s: dict[str, Array] = {}

    # ---------------------------------------------------------------- what comes in

    def action_spec(self, physics: SessionPhysics) -> specs.BoundedArray:
        """(6,) a twist of the tool in the world, m/s and rad/s, or (n,) joint velocities."""
        if self.settings.action == "twist":
            most = np.repeat([self.settings.tool_speed_m_s, self.settings.tool_turn_rad_s], 3)
        else:
            most = np.array(physics.addresses.velocity_limit_rad_s)
        return specs.BoundedArray(most.shape, float, -most, most, name=self.settings.action)

    def initialize_episode(self, physics: SessionPhysics) -> None:
        """Nothing has moved yet."""
        self._before, self._velocity_m_s = {}, {}

    def before_step(self, action: Array, physics: SessionPhysics) -> None:
        """Hand the action to the arm."""
        spec = self.action_spec(physics)
        wanted = np.clip(np.asarray(action, dtype=float), spec.minimum, spec.maximum)
        self._before = _tools(physics)
        if self.settings.action == "twist":
            physics.set_control(Twist(wanted[:3], wanted[3:]))
        else:
            physics.set_control(wanted)

    def after_step(self, physics: SessionPhysics) -> None:
        """See how far the tools have gone."""
        self._velocity_m_s = {
            arm: (here - self._before[arm]) / self.settings.step_s
            for arm, here in _tools(physics).items()
        }

    # ---------------------------------------------------------------- what goes out

    def get_observation(self, physics: SessionPhysics) -> OrderedDict[str, Array]:
        """What the arm may know, all in the world frame."""
        record, own, cell = physics.record, physics.own, physics.session.cell
        tool, others = own.tool_position_m, physics.others
        still = np.zeros(3)
        seen: OrderedDict[str, Array] = OrderedDict()
        seen["joints_rad"] = record.qpos[physics.addresses.qpos]
        seen["joint_velocities_rad_s"] = record.qvel[physics.addresses.dofs]
        seen["tool_m"] = np.array(tool)
        seen["goal_m"] = physics.goal_m() - tool
        seen["others_m"] = np.concatenate(
            [still[:0], *(record.arms[arm].tool_position_m - tool for arm in others)]
        )
        seen["others_m_s"] = np.concatenate(
            [still[:0], *(self._velocity_m_s.get(arm, still) for arm in others)]
        )
        seen["nearest_m"] = np.array([min(physics.nearest_m(), FARTHEST_M)])
        soonest_s = record.ttc_s
        seen["soonest_per_s"] = np.array(
            [0.0 if soonest_s is None else 1.0 / max(soonest_s, cell.period_s)]
        )
        return seen

    def observation_spec(self, physics: SessionPhysics) -> OrderedDict[str, specs.Array]:
        """Shapes of the observations; a fixed number of others is observed."""
        n, m = len(physics.addresses.dofs), 3 * len(physics.others)
        sizes = {
            "joints_rad": n, "joint_velocities_rad_s": n, "tool_m": 3, "goal_m": 3,
            "others_m": m, "others_m_s": m, "nearest_m": 1, "soonest_per_s": 1,
        }  # fmt: skip
        return OrderedDict(
            (name, specs.Array((size,), float, name=name)) for name, size in sizes.items()
        )

    def get_reward(self, physics: SessionPhysics) -> float:
        """Reward of the last step."""
        weights, step_s = self.settings.reward, self.settings.step_s
        away_m, nearest_m = self._away_m(physics), physics.nearest_m()
        nearness = float(np.clip(1.0 - nearest_m / weights.near_m, 0.0, 1.0))
        reward = -step_s * (weights.distance_per_m_s * away_m + weights.near_per_s * nearness)
        if nearest_m <= 0.0:
            return reward - weights.contact
        return reward + weights.arrival * (away_m <= self.settings.arrived_m)

    def get_termination(self, physics: SessionPhysics) -> float | None:
        """0 after a contact or an arrival, None while the episode goes on."""
        if physics.nearest_m() <= 0.0 or self._away_m(physics) <= self.settings.arrived_m:
            return 0.0
        return None

    def _away_m(self, physics: SessionPhysics) -> float:
        return float(np.linalg.norm(physics.goal_m() - physics.own.tool_position_m))


def _tools(physics: SessionPhysics) -> dict[str, Array]:
    """(3,) where each tool is."""
    return {arm: np.array(row.tool_position_m) for arm, row in physics.record.arms.items()}
