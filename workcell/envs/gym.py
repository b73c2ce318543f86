"""The environments for Gymnasium, registered under `workcell/<scenario>-v0` (extra `environments`).

    env = gymnasium.make("workcell.envs.gym:workcell/planar_crossing-v0", vary=True)

Actions are in [-1, 1], shares of the largest speeds; observations are one vector, in the order of docs/environments.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from workcell import assets
from workcell.envs.environment import make
from workcell.envs.physics import SessionPhysics
from workcell.extras import need

gymnasium = need("gymnasium", extra="environments", what="workcell.envs.gym")

NAMESPACE = "workcell"
VERSION = 0


class WorkcellEnv(gymnasium.Env):
    """A Gymnasium environment for one arm of a scenario.

    Args:
        settings: As for `workcell.envs.make`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  Gymnasium's own form

    def __init__(self, **settings: Any):
        self.render_mode = None
        self.environment = make(**settings)
        """The same as a dm_env environment."""
        action = self.environment.action_spec()
        self._most = np.array(action.maximum)
        self.action_space = shares(action)
        self.observation_space = vector(self.environment.observation_spec())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Begin an episode; see Gymnasium."""
        super().reset(seed=seed)
        if seed is not None:
            self.environment.physics.episodes.seed(seed)
        return flat(self.environment.reset().observation), info(self.environment.physics)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """One action; see Gymnasium. An episode is truncated at its time limit, terminated by contact or arrival."""
        wanted = self._most * np.asarray(action, dtype=float)
        found = self.environment.step(wanted)
        over = bool(found.last())
        terminated = over and found.discount == 0.0
        truncated, said = over and not terminated, info(self.environment.physics)
        return flat(found.observation), float(found.reward), terminated, truncated, said

    def close(self) -> None:
        """End the run under way."""
        self.environment.close()


def shares(action: specs.BoundedArray) -> Any:
    """The space of actions: shares of the largest speeds."""
    return gymnasium.spaces.Box(-1.0, 1.0, action.shape, np.float32)


def vector(observation: Mapping[str, specs.Array]) -> Any:
    """The space of observations, one vector."""
    size = sum(spec.shape[0] for spec in observation.values())
    return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)


def flat(observation: Any) -> NDArray[np.float64]:
    """(size,) the observations behind each other."""
    return control.flatten_observation(observation)[control.FLAT_OBSERVATION_KEY]


def info(physics: SessionPhysics) -> dict[str, Any]:
    """What a learner may log beside its observations."""
    return {
        "time_s": physics.time(),
        "nearest_m": physics.nearest_m(),
        "reason": physics.own.reason,
    }


def register() -> None:
    """Tell Gymnasium of an environment for every shipped scenario; harmless if it knows."""
    for name in assets.scenario_names():
        identifier = f"{NAMESPACE}/{name}-v{VERSION}"
        if identifier not in gymnasium.registry:
            gymnasium.register(
                identifier, entry_point="workcell.envs.gym:WorkcellEnv", kwargs={"scenario": name}
            )


register()
