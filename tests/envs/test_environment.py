"""What an environment promises: its numbers mean what the page says, draws follow the seed, nothing is accepted blindly."""

from __future__ import annotations

import re
import warnings
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

from workcell import InputError, envs
from workcell.assets import scenario_names
from workcell.envs.task import ReachTask
from workcell.judge import judge_trace
from workcell.run import SCENE_FILE, SCENE_FOLDER
from workcell.trace.table import load

QUICK = ("check.enabled=false", "simulation.plant=kinematic", "simulation.period_s=0.02")
PAGE = Path(__file__).parents[2] / "docs" / "environments.md"


@pytest.fixture
def made():
    """Makes environments that are closed in the end."""
    open_ = []

    def make(**settings):
        open_.append(envs.make(**({"overrides": QUICK} | settings)))
        return open_[-1]

    yield make
    for env in open_:
        env.close()


def test_observations_are_what_the_record_says(made):
    env = made()
    first = env.reset()
    for _ in range(5):
        step = env.step([0.1, 0.05, 0, 0, 0, 0])
    seen, physics = step.observation, env.physics
    record, nurse, surgeon = (
        physics.record,
        physics.record.arms["nurse"],
        physics.record.arms["surgeon"],
    )
    np.testing.assert_array_equal(seen["joints_rad"], record.qpos[3:])
    np.testing.assert_array_equal(seen["tool_m"], nurse.tool_position_m)
    np.testing.assert_allclose(seen["others_m"], surgeon.tool_position_m - nurse.tool_position_m)
    np.testing.assert_allclose(seen["goal_m"] + nurse.tool_position_m, [0.03, 0.5, 0.3], atol=1e-9)
    own = ["nurse/link" in " ".join(pair) for pair in physics.session.cell.pairs.names]
    assert seen["nearest_m"] == record.pair_distance_m[own].min()
    way = seen["tool_m"] - first.observation["tool_m"]
    # half a second at 0.1 and 0.05 m/s, less the time to speed up
    np.testing.assert_allclose(way, [0.05, 0.025, 0.0], atol=0.006)
    away_m = float(np.linalg.norm(seen["goal_m"]))
    near = max(0.0, 1.0 - float(seen["nearest_m"][0]) / 0.1)
    assert step.reward == pytest.approx(-0.1 * (away_m + near))
    assert physics.time() == pytest.approx(0.02 + 5 * 0.1), "the first observation takes a tick"


def test_arrival_and_contact_end_an_episode(made):
    env = made(arrived_m=0.3)
    env.reset()
    while not (step := env.step([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).last():
        pass
    assert step.discount == 0.0
    assert step.reward > 0.5, "arrived"

    class Touching(ReachTask):
        """As if something were touched."""

        def get_reward(self, physics):
            physics.nearest_m = lambda: -0.001
            return super().get_reward(physics)

    env = made(task=Touching)
    env.reset()
    step = env.step(np.zeros(6))
    assert (step.last(), step.discount) == (True, 0.0)
    assert step.reward < -10.0


def test_a_time_limit_truncates(made):
    env = made(time_limit_s=0.3)
    env.reset()
    steps = [env.step(np.zeros(6)) for _ in range(3)]
    assert [step.last() for step in steps] == [False, False, True]
    assert steps[-1].discount == 1.0


def episode(env) -> np.ndarray:
    env.reset()
    return np.array([env.step([0.1, 0, 0, 0, 0, 0]).observation["others_m"] for _ in range(10)])


def test_episodes_follow_the_seed(made):
    first, second = made(vary=True, seed=3), made(vary=True, seed=3)
    one, another = episode(first), episode(first)
    assert not np.array_equal(one, another), "every episode is another variation"
    np.testing.assert_array_equal(episode(second), one)
    second.physics.episodes.seed(3)
    np.testing.assert_array_equal(episode(second), one)


def test_episodes_can_be_kept_and_judged(made, tmp_path):
    env = made(out=tmp_path / "run")
    env.reset()
    for _ in range(3):
        env.step([0.1, 0, 0, 0, 0, 0])
    env.reset()
    env.close()
    assert len(load(tmp_path / "run")) == 16
    assert set(load(tmp_path / "run")["nurse.reason"]) == {"commanded"}
    assert (tmp_path / "run_2" / SCENE_FOLDER / SCENE_FILE).is_file()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"arm": "nuse"}, "did you mean 'nurse'"),
        ({"action": "torque"}, "twist, joints"),
        ({"step_s": 0.03}, "multiples of simulation.period_s = 0.02"),
        ({"step_s": 0.0}, "step_s"),
        ({"tool_speed_m_s": float("nan")}, "tool_speed_m_s"),
        ({"seed": -1}, "seed"),
        ({"seed": True}, "seed"),
        ({"reward": envs.RewardWeights(contact=-1.0)}, "reward.contact"),
        ({"reward": envs.RewardWeights(near_m=0.0)}, "reward.near_m"),
        ({"vary": True, "out": "runs/x"}, "drop one"),
        ({"scenario": "planar"}, "planar"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(made, settings, word):
    with pytest.raises(InputError, match=re.escape(word)):
        made(**settings)


def test_nothing_can_be_observed_before_a_reset(made):
    with pytest.raises(Exception, match="reset the environment first"):
        made().physics.record  # noqa: B018


def test_the_page_lists_every_observation_and_setting(made):
    text = PAGE.read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)`", text, flags=re.M))
    env = made()
    env.reset()
    observed = env.task.get_observation(env.physics)
    assert isinstance(observed, OrderedDict)
    assert {name: value.shape for name, value in observed.items()} == {
        name: spec.shape for name, spec in env.observation_spec().items()
    }
    settings = set(envs.EnvSettings.__dataclass_fields__)
    weights = set(envs.RewardWeights.__dataclass_fields__)
    assert named == set(observed) | settings | weights


def test_gymnasiums_own_checker_passes():
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    env = gymnasium.make(
        "workcell.envs.gym:workcell/planar_crossing-v0", overrides=QUICK, time_limit_s=2.0
    )
    with warnings.catch_warnings():
        # Distances and velocities have no bound of their own.
        warnings.filterwarnings("ignore", message=".*observation space (minimum|maximum) value")
        check_env(env.unwrapped, skip_render_check=True)
    _, told = env.reset(seed=1)
    assert told["time_s"] == pytest.approx(0.02)
    ended = False
    while not ended:
        *_, terminated, truncated, told = env.step(np.zeros(6, dtype=np.float32))
        ended = terminated or truncated
    assert truncated
    assert told["time_s"] == pytest.approx(2.02)
    env.close()


def test_every_shipped_scenario_is_registered():
    gymnasium = pytest.importorskip("gymnasium")
    import workcell.envs.gym  # noqa: F401

    assert {f"workcell/{name}-v0" for name in scenario_names()} <= set(gymnasium.registry)


def wander(scenario: str, folder: Path, steps: int) -> None:
    """Random twists, each for half a second; every episode is judged by its plant's states."""
    random = np.random.default_rng(1)
    env = envs.make(scenario=scenario, step_s=0.02, out=folder / "run")
    most, acted = env.action_spec().maximum, 0
    step = env.reset()
    while acted < steps:
        if acted % 25 == 0:
            action = random.uniform(-most, most)
        step = env.step(action)
        acted += 1
        if step.last():
            env.reset()
    model = env.physics.session.cell.model
    env.close()
    for run in sorted(folder.glob("run*")):
        trace = load(run)
        if not len(trace):
            continue
        contact = judge_trace(trace, model).contact
        assert contact is None or contact.cause == "priority", (run.name, contact)


def test_random_actions_of_a_support_arm_cause_no_contact(tmp_path):
    wander("planar_crossing", tmp_path, 150)


FOLDS = pytest.mark.xfail(
    reason="the nurse folds link 3 against its own link 4: neighbours are the final check's, which is off",
    raises=AssertionError,
)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=FOLDS if name == "impasse" else ()) for name in scenario_names()],
)
def test_a_thousand_random_actions_cause_no_contact(name, tmp_path):
    wander(name, tmp_path, 1000)
