"""The dm_env environment: dm_control's, on a session."""

from __future__ import annotations

from typing import Any

from dm_control.rl import control

from workcell.envs.physics import SessionPhysics
from workcell.envs.settings import EnvSettings
from workcell.envs.task import ReachTask
from workcell.scenario import Scenario


class WorkcellEnvironment(control.Environment):
    """`control.Environment`, which ends its session when it is closed."""

    def close(self) -> None:
        """End the run under way; the environment cannot be used after it."""
        self.physics.episodes.close()


def make(task: type[ReachTask] = ReachTask, **settings: Any) -> WorkcellEnvironment:
    """An environment for one arm of a scenario.

    Args:
        task: What is observed and rewarded.
        settings: As in `EnvSettings`: scenario, arm, action, step_s, vary, seed, reward, ...

    Raises:
        InputError: A setting makes no sense, or the scenario cannot be run.
    """
    chosen = EnvSettings(**settings)
    physics = SessionPhysics.of(chosen)
    return WorkcellEnvironment(
        physics,
        task(chosen),
        time_limit=time_limit_s(chosen, physics.session.scenario),
        control_timestep=chosen.step_s,
    )


def time_limit_s(settings: EnvSettings, scenario: Scenario) -> float:
    """Length of an episode: what is asked for, at most the scenario's duration."""
    longest_s = scenario.simulation.duration_s
    return min(settings.time_limit_s or longest_s, longest_s)
