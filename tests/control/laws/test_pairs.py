"""Distances, directions, G and second derivatives against NumPy's second opinion, in the ugly places too."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.conftest import arm_xml, build, update
from tests.control.oracles import pairs as oracle
from tests.control.test_proximity import _BLOCK, _SOLIDS
from workcell.control.second_order import second_order
from workcell.errors import WorkcellError

ROUNDING = 1e-12
"""Allowed difference, relative to the numbers that went into a result."""


def assert_pairs_agree(model, data, geometry, qacc) -> None:
    """Everything measured, and d̈; directions are as good as the axes are apart."""
    theirs = oracle.measure(geometry, data)
    if isinstance(theirs, str):  # MuJoCo says nothing of two centres in one place
        with pytest.raises(WorkcellError, match=theirs):
            geometry.measure(data)
        return
    mine = geometry.measure(data)
    between = np.linalg.norm(theirs.witness_i_m - theirs.witness_j_m, axis=1)
    round_pair = (geometry.radius_m > 0.0).all(axis=1)
    blur = ROUNDING + np.where(round_pair, 1e-15 / np.maximum(between, 1e-9), 1e-9)
    # Where an axis point is on its surface point the direction is a choice, or what rounding left of it.
    blur[theirs.degenerate & ~round_pair] = 1.0
    blur[theirs.degenerate & round_pair] = 1e-9
    np.testing.assert_array_equal(mine.degenerate, theirs.degenerate)
    for name in ("distance_m", "witness_i_m", "witness_j_m", "surface_i_m", "surface_j_m"):
        np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), atol=ROUNDING)
    for name in ("normal", "jacobian"):
        apart = np.abs(getattr(mine, name) - getattr(theirs, name)).max(axis=1, initial=0.0)
        assert (apart <= 4 * blur).all(), (name, apart, blur)
    sure = ~theirs.degenerate
    np.testing.assert_allclose(np.linalg.norm(mine.normal[sure], axis=1), 1.0, atol=ROUNDING)
    # The same measurement for both, as d̈ grows with one over the distance of the axes.
    mine = second_order(geometry, data, theirs, qacc)
    theirs = oracle.second_order(geometry, data, theirs, qacc)
    np.testing.assert_array_equal(mine.exact, theirs.exact)
    np.testing.assert_array_equal(mine.parallel, theirs.parallel)
    size = 1.0 + np.abs(data.qvel).max(initial=0.0) ** 2 + np.abs(qacc).max(initial=0.0)
    np.testing.assert_array_less(
        np.abs(mine.accel_m_s2 - theirs.accel_m_s2),
        10 * ROUNDING * size * (1.0 + np.abs(theirs.accel_m_s2)) / np.maximum(between, 1e-3),
    )


@pytest.fixture(scope="module")
def crowd():
    """Every pair of geoms of two arms, and of these with two more."""
    arms = {"a": "0 -0.35 0", "b": "0 0.35 0", "c": "0.7 0 0", "d": "-0.7 0 0"}
    bodies = "".join(arm_xml(name, at) for name, at in arms.items())
    pairs = [
        (f"{m}/c{i}", f"{n}/c{j}")
        for k, m in enumerate(arms)
        for n in list(arms)[k + 1 :]
        for i in range(7)
        for j in range(7)
    ]
    return build(bodies, pairs)


@given(seed=st.integers(0, 2**32 - 1), still=st.booleans())
@settings(max_examples=60)
def test_four_arms(crowd, seed, still):
    model, data, geometry = crowd
    random = np.random.default_rng(seed)
    qvel, qacc = (0.0 if still else 1.0) * random.normal(size=(2, model.nv))
    update(model, data, random.uniform(-2.0, 2.0, model.nq), qvel)
    assert_pairs_agree(model, data, geometry, qacc)


KINDS = list(_SOLIDS)
PLACES = st.sampled_from([0.0, 0.1, -0.1, 0.2, 0.05, 0.11, 1e-3, 1e-8]) | st.floats(-0.4, 0.4)
TURNS = st.sampled_from([0.0, np.pi / 2, np.pi, np.pi / 4, 1e-2]) | st.floats(-np.pi, np.pi)


@given(
    kinds=st.tuples(st.sampled_from(KINDS), st.sampled_from(KINDS)),
    place=st.tuples(PLACES, PLACES, PLACES),
    axis=st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.0, 0.8)]),
    turn=TURNS,
    seed=st.integers(0, 2**16),
)
@settings(max_examples=250)
def test_two_geoms_in_ugly_places(kinds, place, axis, turn, seed):
    """Parallel and crossing axes, touching, penetrating, an axis inside a box, no round geom at all."""
    if kinds == ("plane", "plane"):
        return  # MuJoCo measures no distance between planes
    first, second = kinds
    if first == "plane":
        first, second = second, first  # a plane cannot be on a body that moves
    model, data, geometry = build(
        f'<geom name="b" {_SOLIDS[second]}/>'
        f'<body><freejoint/><geom name="a" {_SOLIDS[first]} mass="1"/></body>',
        [("a", "b"), ("a", "b")],
        _BLOCK,
    )
    random = np.random.default_rng(seed)
    half = turn / 2
    update(
        model,
        data,
        [*place, np.cos(half), *(np.sin(half) * np.array(axis, dtype=float))],
        random.normal(size=6) if seed else np.zeros(6),
    )
    assert_pairs_agree(model, data, geometry, random.normal(size=6))


SLIDER = (
    '<geom name="b" size="0.1"/><body><joint type="slide"/>'
    '<geom name="a" size="0.1" pos="0.1 0 0.5"/></body>'
)


def test_one_joint_and_two_datas_in_turn():
    model, data, geometry = build(SLIDER, [("a", "b")])
    other = mujoco.MjData(model)
    update(model, data, [0.1], [-1.0])
    update(model, other, [0.3], [-1.0])
    near, far = (geometry.measure(each).distance_m[0] for each in (data, other))
    assert near == pytest.approx(np.hypot(0.6, 0.1) - 0.2)
    assert far == pytest.approx(np.hypot(0.8, 0.1) - 0.2)
    for each in (data, other, data):
        assert_pairs_agree(model, each, geometry, np.ones(1))


def test_what_is_wrong_is_said_with_the_pair_s_name():
    model, data, geometry = build(SLIDER, [("a", "b")])
    with pytest.raises(WorkcellError, match="fromto sensor of pair a - b reads zero"):
        geometry.measure(data)
    update(model, data, [0.1], [1.0])
    near = geometry.measure(data)
    data.sensordata[4] = np.nan
    with pytest.raises(WorkcellError, match="the distance of pair a - b is not finite"):
        geometry.measure(data)
    with pytest.raises(WorkcellError, match=r"qacc\[0\] is nan"):
        second_order(geometry, data, near, [np.nan])
    data.qvel[0] = np.nan
    with pytest.raises(WorkcellError, match="pair a - b is not finite; check qvel and qacc"):
        second_order(geometry, data, near, [0.0])
