"""Several learners in one cell, by PettingZoo's parallel interface (extra `environments`).

    env = ParallelCell(scenario="planar_crossing", arms=("nurse", "surgeon"))

Every agent is an arm. Actions and observations are those of `workcell.envs.gym`, one of each an agent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.envs.environment import time_limit_s
from workcell.envs.gym import flat, info, shares, vector
from workcell.envs.physics import Episodes, SessionPhysics
from workcell.envs.settings import EnvSettings
from workcell.envs.task import ReachTask
from workcell.errors import InputError
from workcell.extras import need

pettingzoo = need("pettingzoo", extra="environments", what="workcell.envs.parallel")

Array = NDArray[np.float64]


class ParallelCell(pettingzoo.ParallelEnv):
    """A PettingZoo environment for several arms of a scenario; the other arms do what the scenario says.

    An agent whose episode has ended, by contact or arrival, leaves; its arm then stands still.

    Args:
        arms: Who acts; None: every arm.
        task: What each of them observes and is rewarded for.
        settings: As for `workcell.envs.make`, but for `arm`.

    Raises:
        InputError: A setting makes no sense, or the scenario cannot be run.
    """

    metadata = {"name": "workcell_v0", "render_modes": []}  # noqa: RUF012  PettingZoo's own form

    def __init__(
        self,
        arms: Sequence[str] | None = None,
        task: type[ReachTask] = ReachTask,
        **settings: Any,
    ):
        if "arm" in settings:
            raise InputError("arm: several arms act here; say arms=(...)")
        self.render_mode = None
        chosen = EnvSettings(**settings)
        scenario = chosen.read()
        names = [arm.name for arm in scenario.arm] if arms is None else list(arms)
        if not names or len(set(names)) < len(names):
            raise InputError(f"arms is {tuple(names)}; allowed are different arms, at least one")
        each = {name: replace(chosen, arm=name) for name in names}
        for own in each.values():
            own.who(scenario)
        self.episodes = Episodes(scenario, vary=chosen.vary, seed=chosen.seed, out=chosen.out)
        """The runs that all of them share."""
        self.possible_agents = names
        self.agents: list[str] = []
        self._steps_of_episode = round(time_limit_s(chosen, scenario) / chosen.step_s)
        self._ticks = round(chosen.step_s / self.episodes.period_s)
        self._taken = 0
        self._tasks = {name: task(own) for name, own in each.items()}
        self._physics = {name: SessionPhysics(name, self.episodes) for name in names}
        actions = {n: self._tasks[n].action_spec(self._physics[n]) for n in names}
        self._most = {name: np.array(spec.maximum) for name, spec in actions.items()}
        self._action_spaces = {name: shares(spec) for name, spec in actions.items()}
        self._observation_spaces = {
            n: vector(self._tasks[n].observation_spec(self._physics[n])) for n in names
        }

    def action_space(self, agent: str) -> Any:
        """(n,) shares in [-1, 1] of the largest speeds."""
        return self._action_spaces[agent]

    def observation_space(self, agent: str) -> Any:
        """One vector, in the order of docs/environments.md."""
        return self._observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begin an episode; see PettingZoo."""
        if seed is not None:
            self.episodes.seed(seed)
        self.episodes.reset()
        self.agents, self._taken = list(self.possible_agents), 0
        for agent in self.agents:
            self._physics[agent].rest()
        self.episodes.step()
        for agent in self.agents:
            self._tasks[agent].initialize_episode(self._physics[agent])
        return self._observed(self.agents), self._said(self.agents)

    def step(
        self, actions: dict[str, NDArray[np.float32]]
    ) -> tuple[
        dict[str, Array],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One action of every agent; see PettingZoo.

        Raises:
            InputError: An agent has no action, or an action belongs to no agent.
        """
        if set(actions) != set(self.agents):
            raise InputError(
                f"actions are for {', '.join(sorted(actions)) or 'nobody'}; allowed is one each for {', '.join(self.agents) or 'nobody: reset() first'}"
            )
        acting = list(self.agents)
        for agent in acting:
            wanted = self._most[agent] * np.asarray(actions[agent], dtype=float)
            self._tasks[agent].before_step(wanted, self._physics[agent])
        self.episodes.step(self._ticks)
        self._taken += 1
        over = self._taken >= self._steps_of_episode
        rewards, terminated, truncated = {}, {}, {}
        for agent in acting:
            task, physics = self._tasks[agent], self._physics[agent]
            task.after_step(physics)
            rewards[agent] = float(task.get_reward(physics))
            terminated[agent] = task.get_termination(physics) is not None
            truncated[agent] = over and not terminated[agent]
            if terminated[agent]:
                physics.rest()
        self.agents = [a for a in acting if not (terminated[a] or truncated[a])]
        return self._observed(acting), rewards, terminated, truncated, self._said(acting)

    def close(self) -> None:
        """End the run under way."""
        self.episodes.close()

    def _observed(self, agents: Sequence[str]) -> dict[str, Array]:
        return {a: flat(self._tasks[a].get_observation(self._physics[a])) for a in agents}

    def _said(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        return {agent: info(self._physics[agent]) for agent in agents}
