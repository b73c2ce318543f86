"""The environments for Gymnasium, registered under `workcell/<scenario>-v0` (extra `environments`).

    env = gymnasium.make("workcell.envs.gym:workcell/planar_crossing-v0", vary=True)

Actions are in [-1, 1], shares of the largest speeds; observations are one vector, in the order of docs/environments.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from dm_control.rl import control
from numpy.typing import NDArray

from workcell import assets
from workcell.envs.environment import make
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
        size = sum(spec.shape[0] for spec in self.environment.observation_spec().values())
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, action.shape, np.float32)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Begin an episode; see Gymnasium."""
        super().reset(seed=seed)
        if seed is not None:
            self.environment.physics.seed(seed)
        return _flat(self.environment.reset().observation), self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """One action; see Gymnasium. An episode is truncated at its time limit, terminated by contact or arrival."""
        wanted = self._most * np.asarray(action, dtype=float)
        found = self.environment.step(wanted)
        over = bool(found.last())
        terminated = over and found.discount == 0.0
        return (
            _flat(found.observation), float(found.reward), terminated, over and not terminated, self._info()
        )  # fmt: skip

    def close(self) -> None:
        """End the run under way."""
        self.environment.close()

    def _info(self) -> dict[str, Any]:
        physics = self.environment.physics
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


def _flat(observation: Any) -> NDArray[np.float64]:
    """(size,) the observations behind each other."""
    return control.flatten_observation(observation)[control.FLAT_OBSERVATION_KEY]


register()
