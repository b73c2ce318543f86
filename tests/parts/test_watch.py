"""Watching pairs on any model: the same numbers with sensors and without, times that are right, refusals by name."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.parts import scenes
from workcell import InputError, PairWatch, pairs_between

NAN = float("nan")


@pytest.fixture
def cart() -> tuple[PairWatch, mujoco.MjData]:
    """The ball before the wall, 0.95 m away at zero."""
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    return watch, mujoco.MjData(watch.model)


def test_sensors_and_search_find_the_same():
    rng = np.random.default_rng(3)
    spec = scenes.two_arms()
    pairs = pairs_between(spec, "left/base", "right/base", group=4)
    plain = PairWatch(spec.copy().compile(), pairs)
    sensed = PairWatch(spec, pairs)
    assert sensed.has_sensors
    assert not plain.has_sensors
    assert sensed.model.nsensor == len(pairs) == 15, "the pair of the two fixed bases is left out"
    for _ in range(20):
        found = []
        for watch in (plain, sensed):
            data = mujoco.MjData(watch.model)
            data.qpos[:] = rng.uniform(-2.0, 2.0, 6) if not found else found[0][0]
            found.append((data.qpos.copy(), watch.look(data)))
        for name in ("distance_m", "normal", "jacobian", "witness_i_m"):
            first, second = (getattr(near, name) for _, near in found)
            np.testing.assert_allclose(first, second, rtol=0, atol=1e-12, err_msg=name)


def test_rows_are_the_derivative_of_what_mujoco_measures():
    rng = np.random.default_rng(4)
    spec = scenes.two_arms()
    watch = PairWatch(spec.compile(), pairs_between(spec, "left/base", "right/base", group=4))
    data = mujoco.MjData(watch.model)

    def distances(qpos) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(watch.model, data)
        return np.array(
            [mujoco.mj_geomDistance(watch.model, data, i, j, 9.0, None) for i, j in watch.geom]
        )

    q, step = rng.uniform(-1.0, 1.0, 6), 1e-6
    data.qpos[:] = q
    rows = watch.look(data).jacobian
    for joint, way in enumerate(step * np.eye(6)):
        slope = (distances(q + way) - distances(q - way)) / (2 * step)
        np.testing.assert_allclose(rows[:, joint], slope, atol=1e-5)


def test_times_of_first_and_second_order(cart):
    watch, data = cart
    data.qvel[0] = 0.5
    times = watch.times(data)
    assert times.distance_m == pytest.approx([0.95])
    assert times.rate_m_s == pytest.approx([-0.5])
    assert times.first.ttc_s == times.ttc_s[0] == pytest.approx(0.95 / 0.5)
    braking = watch.times(data, order=2, qacc=[-0.1, 0.0])
    # 0.95 = 0.5 t - 0.05 t^2
    assert braking.ttc_s == pytest.approx([(0.5 - np.sqrt(0.25 - 4 * 0.05 * 0.95)) / 0.1])
    assert np.isinf(watch.times(data, order=2, qacc=[-0.2, 0.0]).ttc_s).all(), "turns round in time"
    away = watch.times(data, qvel=[-0.5, 0.0])
    assert np.isinf(away.ttc_s).all()
    assert away.first.pair == -1
    assert data.qvel[0] == 0.5, "the velocity asked about is not the data's"
    assert watch.times(data, standoff_m=0.45).ttc_s == pytest.approx([1.0])


def test_pairs_are_chosen_by_body_whatever_their_contact_bits():
    model = scenes.slide().compile()
    names = [
        {model.geom(g).name for g in pair}
        for pair in pairs_between(model, "cart", ["world", "other"])
    ]
    assert sorted(map(sorted, names)) == [["ball", "second"], ["ball", "wall"]]
    assert pairs_between(model, "world", "world") == [], "no joint moves a wall against itself"


def refused(what, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        what()
    for word in words:
        assert word in str(caught.value)


def test_what_cannot_be_watched_is_refused_by_name(cart):
    watch, data = cart
    spec, model = scenes.slide('<geom type="sphere" size="0.1" pos="0 0 5"/>'), watch.model
    refused(
        lambda: PairWatch(model, [("bal", "wall"), ("ball", "wal")]), "'bal'", "'ball'", "'wal'"
    )
    refused(lambda: PairWatch(model, [("ball", 7)]), "pairs[0]", "0 to 2")
    refused(lambda: PairWatch(model, [("ball",)]), "allowed is 2")
    refused(lambda: PairWatch(model, []), "at least one")
    refused(lambda: PairWatch(model, [("wall", "wall")]), "no joint moves")
    refused(lambda: PairWatch(spec, [("ball", 1)]), "no name")
    refused(lambda: pairs_between(model, "carts", "world"), "'carts'", "'cart'")
    refused(lambda: pairs_between(model, "cart", "world", group=5), "no geoms in group 5")
    refused(lambda: watch.times(data, order=3), "order", "1 or 2")
    refused(lambda: watch.times(data, qvel=[1.0]), "qvel", "(2,)")
    refused(lambda: watch.times(data, qvel=[1.0, NAN]), "qvel", "finite")
    refused(lambda: watch.times(data, qacc=[0.0, 0.0]), "order = 2")
    refused(lambda: watch.times(data, standoff_m=-1.0), "standoff_m")
    refused(lambda: watch.look(mujoco.MjData(spec.compile())), "not of the watched model", "MjData")
