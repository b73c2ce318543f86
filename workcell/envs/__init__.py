"""Environments for learners: one arm of a scenario acts, all others do what the scenario says.

settings     what an environment is made from
physics      a session as dm_control's physics
task         actions, observations, rewards, ends
environment  the dm_env environment
gym          the same for Gymnasium, registered under `workcell/<scenario>-v0` (extra `environments`)

docs/environments.md says what every number means.
"""

from workcell.envs.environment import make
from workcell.envs.settings import EnvSettings, RewardWeights

__all__ = ["EnvSettings", "RewardWeights", "make"]
