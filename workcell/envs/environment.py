"""The dm_env environment: dm_control's, on a session."""

from __future__ import annotations

from typing import Any

from dm_control.rl import control

from workcell.envs.physics import SessionPhysics
from workcell.envs.settings import EnvSettings
from workcell.envs.task import ReachTask


class WorkcellEnvironment(control.Environment):
    """`control.Environment`, which ends its session when it is closed."""

    def close(self) -> None:
        """End the run under way; the environment cannot be used after it."""
        self.physics.close()


def make(task: type[ReachTask] = ReachTask, **settings: Any) -> WorkcellEnvironment:
    """An environment for one arm of a scenario.

    Args:
        task: What is observed and rewarded.
        settings: As in `EnvSettings`: scenario, arm, action, step_s, vary, seed, reward, ...

    Raises:
        InputError: A setting makes no sense, or the scenario cannot be run.
    """
    chosen = EnvSettings(**settings)
    physics = SessionPhysics(chosen)
    limit_s = chosen.time_limit_s or physics.session.scenario.simulation.duration_s
    return WorkcellEnvironment(
        physics,
        task(chosen),
        time_limit=min(limit_s, physics.session.scenario.simulation.duration_s),
        control_timestep=chosen.step_s,
    )
