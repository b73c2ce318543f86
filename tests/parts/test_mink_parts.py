"""The parts as mink sees them, refused where they make no sense."""

from __future__ import annotations

import mink
import numpy as np
import pytest

from tests.parts import scenes
from workcell import CriterionTask, InputError, PairWatch, TtcLimit, objective, pairs_between


@pytest.fixture
def watch() -> PairWatch:
    spec = scenes.two_arms()
    return PairWatch(spec, pairs_between(spec, "left/base", "right/base", group=4))


@pytest.mark.parametrize("t_min_s", [0.0, -1.0, float("nan"), float("inf"), "1", None])
def test_a_limit_without_a_time_is_refused(watch, t_min_s):
    with pytest.raises(InputError, match=r"t_min_s is .*; allowed is a finite number > 0"):
        TtcLimit(watch, t_min_s=t_min_s)


def test_rows_of_another_shape_are_refused():
    limit = TtcLimit(t_min_s=1.0)
    with pytest.raises(InputError, match=r"shape \(3, 6\) and smallest_rate_m_s \(2,\)"):
        limit.give(np.zeros((3, 6)), np.zeros(2))
    with pytest.raises(InputError, match="shape"):
        limit.give(np.zeros(6), np.zeros(1))


def test_pairs_of_another_model_are_refused(watch):
    other = mink.Configuration(scenes.two_arms().compile())
    with pytest.raises(InputError, match="another model"):
        TtcLimit(watch, t_min_s=1.0).compute_qp_inequalities(other, 0.01)


@pytest.mark.parametrize("criterion", ["artc", "artc_approaching", "armd", "none"])
def test_a_criterion_task_measures_what_the_law_is_given(watch, criterion):
    configuration = mink.Configuration(watch.model, q=np.array([0.9, 0.6, 0.2, 2.2, -0.6, -0.2]))
    data, left = configuration.data, np.arange(3)
    data.qvel[:] = [0.1, 0.2, -0.1, 0.3, 0.0, 0.2]
    task = CriterionTask(left, nv=6, dt_s=0.01, gain=4.0, geometry=watch, criterion=criterion)
    got = task.compute_qp_objective(configuration)
    near = watch.look(data)
    moved = near.jacobian[:, left].any(axis=1)
    assert 0 < moved.sum() < len(watch), "the fixed base of the left arm is in pairs, too"
    others = near.jacobian[:, 3:] @ data.qvel[3:]
    wanted = objective(
        criterion,
        near.distance_m[moved],
        near.rate_m_s(data.qvel)[moved],
        near.jacobian[moved][:, left],
        other_rate_m_s=others[moved],
    )
    H, c = np.zeros((6, 6)), np.zeros(6)
    H[:3, :3], c[:3] = np.eye(3) + 4.0 * wanted.hessian, 4.0 * 0.01 * wanted.linear
    np.testing.assert_allclose(got.H, H, atol=1e-12)
    np.testing.assert_allclose(got.c, c, atol=1e-12)
    assert c.any() == (criterion != "none")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"criterion": "arct"}, "did you mean 'artc'"),
        ({"gain": -1.0}, "gain"),
        ({"dt_s": 0.0}, "dt_s"),
        ({"dofs": [0, 6]}, "dofs"),
    ],
)
def test_a_criterion_task_that_makes_no_sense_is_refused(watch, change, word):
    given = {"dofs": [0, 1, 2], "nv": 6, "dt_s": 0.01, "gain": 8.0, "geometry": watch} | change
    with pytest.raises(InputError, match=word):
        CriterionTask(given.pop("dofs"), **given)
