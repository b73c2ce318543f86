"""dm_env's own checks hold, for a support arm and for a priority arm."""

from __future__ import annotations

import numpy as np
from absl.testing import absltest
from dm_env import test_utils

from workcell.envs import make

QUICK = ("check.enabled=false", "simulation.plant=kinematic", "simulation.period_s=0.02")


class SupportArm(test_utils.EnvironmentTestMixin, absltest.TestCase):
    def make_object_under_test(self):
        return make(overrides=QUICK, time_limit_s=0.8)

    def make_action_sequence(self):
        random, spec = np.random.default_rng(0), self.environment.action_spec()
        for _ in range(20):
            yield random.uniform(spec.minimum, spec.maximum)


class PriorityArmByJoints(SupportArm):
    def make_object_under_test(self):
        return make(arm="surgeon", action="joints", overrides=QUICK, time_limit_s=0.8)
