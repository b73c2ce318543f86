"""Two learners in one cell: PettingZoo's own check holds, and each sees what a single one would."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

from workcell import InputError, envs

pettingzoo = pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test  # noqa: E402

from workcell.envs.parallel import ParallelCell  # noqa: E402

QUICK = ("check.enabled=false", "simulation.plant=kinematic", "simulation.period_s=0.02")


def test_pettingzoos_own_check_holds():
    env = ParallelCell(overrides=QUICK, time_limit_s=0.8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=20)
    env.close()


def test_one_agent_alone_is_the_single_environment():
    single = envs.make(overrides=QUICK, time_limit_s=0.8, seed=4)
    several = ParallelCell(("nurse",), overrides=QUICK, time_limit_s=0.8, seed=4)
    first = np.concatenate(list(single.reset().observation.values()))
    np.testing.assert_array_equal(several.reset()[0]["nurse"], first)
    for share in (0.4, -0.2, 1.0):
        action = np.full(6, share)
        step = single.step(action * single.action_spec().maximum)
        seen, reward, *_ = several.step({"nurse": action})
        np.testing.assert_array_equal(
            seen["nurse"], np.concatenate(list(step.observation.values()))
        )
        assert reward["nurse"] == step.reward
    single.close()
    several.close()


def test_who_has_arrived_leaves_and_stands_still():
    env = ParallelCell(overrides=QUICK, arrived_m=0.3)
    env.reset()
    wanted = {"nurse": np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]), "surgeon": np.zeros(6)}
    while "nurse" in env.agents:
        _, _, ended, _, _ = env.step({agent: wanted[agent] for agent in env.agents})
    assert ended["nurse"]
    env.episodes.step(20)
    session = env.episodes.session
    dofs = next(arm.dofs for arm in session.cell.arms if arm.name == "nurse")
    assert np.abs(env.episodes.record.command_rad_s[dofs]).max() < 1e-9
    env.close()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"arm": "nurse"}, "say arms=(...)"),
        ({"arms": ()}, "at least one"),
        ({"arms": ("nurse", "nurse")}, "different arms"),
        ({"arms": ("nuse",)}, "did you mean 'nurse'"),
    ],
)
def test_arms_that_make_no_sense_are_refused_by_name(settings, word):
    with pytest.raises(InputError, match=re.escape(word)):
        ParallelCell(overrides=QUICK, **settings)


def test_an_agent_without_an_action_is_named():
    env = ParallelCell(overrides=QUICK)
    env.reset()
    with pytest.raises(InputError, match="one each for"):
        env.step({"nurse": np.zeros(6)})
    env.close()
