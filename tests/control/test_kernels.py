"""Compiled code and NumPy are two statements of the same: they agree to rounding, in the ugly places too.

Nothing here compares a function with itself: what is compiled is written pair by pair in
`kernels.source`, what it is held against for all pairs at once in the NumPy files.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workcell import scenario
from workcell.control import compiled as compiled_stages
from workcell.control import criteria, ik, proximity, scaling, second_order, share, ttc
from workcell.control.controller import Controller
from workcell.control.kernels import library
from workcell.control.kernels.arguments import SIGNATURES
from workcell.control.proximity import PairGeometry
from workcell.errors import ControlFault, InputError, WorkcellError
from workcell.motion import path
from workcell.motion.path import Target
from workcell.scene import cell as scene

from .conftest import arm_xml, build, update
from .test_proximity import _BLOCK, _SOLIDS

ROUNDING = 1e-12
"""Allowed difference, relative to the numbers that went into a result."""


@pytest.fixture(autouse=True, scope="module")
def compiled():
    """These tests need compiled code, which `make` has put in place."""
    try:
        with library.forced("compiled"):
            yield
    except InputError as error:
        if os.environ.get("WORKCELL_CI"):
            raise
        pytest.skip(str(error))


def both(function: Callable[[], object]) -> tuple:
    """What a function returns with compiled code and with NumPy."""
    found = []
    for wish in ("compiled", "numpy"):
        with library.forced(wish):
            found.append(function())
    return tuple(found)


def said_or_done(function: Callable[[], object]) -> object:
    """What a function returns, or the message it raises."""
    try:
        return function()
    except WorkcellError as error:
        return str(error)


def test_the_tolerances_are_those_of_the_numpy_code():
    pytest.importorskip("numba")
    from workcell.control.kernels import source

    for module in (proximity, second_order, ttc, criteria, ik):
        for name in dir(module):
            if name.endswith(("_M", "_SINE", "SQUARED", "TOLERANCE", "DAMPING")):
                assert getattr(source, name) == getattr(module, name), name
    assert (source.UNBOUNDED, source.EQUALITY) == (ik._UNBOUNDED, ik._EQUALITY)
    assert set(SIGNATURES) == {function.__name__ for function in source.ENTRIES}


# ---------------------------------------------------------------- pairs


def assert_pairs_agree(model, data, geometry, qacc) -> None:
    """Everything measured, and d̈, by both; directions are as good as the axes are apart."""
    mine, theirs = both(lambda: said_or_done(lambda: geometry.measure(data)))
    if isinstance(theirs, str):  # MuJoCo says nothing of two centres in one place
        assert mine == theirs
        return
    between = np.linalg.norm(theirs.witness_i_m - theirs.witness_j_m, axis=1)
    round_pair = (geometry.radius_i_m > 0) & (geometry.radius_j_m > 0)
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
    mine, theirs = both(lambda: second_order.second_order(geometry, data, theirs, qacc))
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


def test_one_joint_and_two_datas_in_turn():
    model, data, geometry = build(
        '<geom name="b" size="0.1"/><body><joint type="slide"/><geom name="a" size="0.1" pos="0.1 0 0.5"/></body>',
        [("a", "b")],
    )
    other = mujoco.MjData(model)
    update(model, data, [0.1], [-1.0])
    update(model, other, [0.3], [-1.0])
    near, far = (geometry.measure(each).distance_m[0] for each in (data, other))
    assert near == pytest.approx(np.hypot(0.6, 0.1) - 0.2)
    assert far == pytest.approx(np.hypot(0.8, 0.1) - 0.2)
    for each in (data, other, data):
        assert_pairs_agree(model, each, geometry, np.ones(1))


def test_what_is_wrong_is_said_alike():
    model, data, geometry = build(
        '<geom name="b" size="0.1"/><body><joint type="slide"/><geom name="a" size="0.1" pos="0.1 0 0.5"/></body>',
        [("a", "b")],
    )

    def message(function: Callable[[], object]) -> str:
        said = []
        for wish in ("compiled", "numpy"):
            with library.forced(wish), pytest.raises(WorkcellError) as caught:
                function()
            said.append(str(caught.value))
        assert said[0] == said[1]
        return said[0]

    assert "reads zero" in message(lambda: geometry.measure(data))
    update(model, data, [0.1], [1.0])
    near = geometry.measure(data)
    data.sensordata[4] = np.nan
    assert "not finite" in message(lambda: geometry.measure(data))
    data.qvel[0] = np.nan
    assert "accel_m_s2[0]" in message(
        lambda: second_order.second_order(geometry, data, near, [0.0])
    )
    bad, good = np.array([1.0, np.nan]), np.ones(2)
    assert "rate_m_s[1]" in message(lambda: ttc.reciprocal_first_order(good, bad))
    assert "accel_m_s2[1]" in message(lambda: ttc.reciprocal_second_order(good, good, bad))
    assert "standoff_m" in message(lambda: ttc.reciprocal_first_order(good, good, standoff_m=-1.0))
    assert "kappa_per_s[1]" in message(lambda: ttc.smallest(bad))
    assert "kappa_per_s[0]" in message(lambda: ttc.smallest(-good))
    assert "distance_m[1]" in message(lambda: criteria.armd(bad))
    assert "jacobian[1, 0]" in message(lambda: criteria.artc_signed_gradient(good, bad[:, None]))


# ---------------------------------------------------------------- time to collision, criteria

NUMBER = (
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e300, -1e300, 5e-324, 0.02])
    | st.floats(-10.0, 10.0)
    | st.floats(allow_nan=False, allow_infinity=False)
)
ROWS = st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=1, max_size=12)


@given(rows=ROWS, standoff=st.sampled_from([0.0, 0.02, 1.0]))
@settings(max_examples=400)
def test_times_to_collision_are_the_same_to_the_last_bit(rows, standoff):
    distance, rate, accel = np.array(rows).T.copy()
    with np.errstate(all="ignore"):
        for function in (
            lambda: ttc.reciprocal_first_order(distance, rate, standoff_m=standoff),
            lambda: ttc.reciprocal_second_order(distance, rate, accel, standoff_m=standoff),
        ):
            mine, theirs = both(function)
            np.testing.assert_array_equal(mine, theirs)
            if not np.isnan(theirs).any():
                first, second = both(lambda kappa=theirs: ttc.smallest(kappa))
                assert first == second


@given(rows=ROWS, t_min=st.sampled_from([1.0, 0.5, 1e-3]), standoff=st.sampled_from([0.0, 0.02]))
@settings(max_examples=400)
def test_the_factor_is_the_same_to_the_last_bit(rows, t_min, standoff):
    distance, own, other = np.array(rows).T.copy()
    with np.errstate(all="ignore"):
        mine, theirs = both(
            lambda: scaling.pairwise_factor(distance, own, other, t_min, standoff_m=standoff)
        )
    np.testing.assert_equal(dataclasses.astuple(mine), dataclasses.astuple(theirs))


SPEED = st.sampled_from([0.0, -0.0, 1e-300, 1e-12, 0.02, -0.02]) | st.floats(-10.0, 10.0)


@given(
    rows=st.lists(st.tuples(SPEED, SPEED), min_size=1, max_size=7),
    reach=st.sampled_from([1.0, 100.0]),
    alike=st.booleans(),
)
@settings(max_examples=400)
def test_what_the_joints_reach_is_the_same_to_the_last_bit(rows, reach, alike):
    previous, wanted = np.array(rows).T.copy()
    previous = wanted.copy() if alike else previous
    limit = np.full(len(rows), reach)
    with np.errstate(all="ignore"):
        found = both(lambda: scaling.acceleration_interval(previous, wanted, limit, 0.002))
    assert found[0] == found[1]


@given(seed=st.integers(0, 2**32 - 1))
def test_the_push_from_the_stops(seed):
    random = np.random.default_rng(seed)
    q, lower = random.uniform(-1.0, 1.0, (2, 7))
    upper = np.where(random.random(7) < 0.3, np.inf, lower + random.choice([0.3, 2.0, 0.0]))
    objective = criteria.NullspaceObjective(np.eye(7), random.normal(size=7))
    mine, theirs = both(lambda: criteria.with_room_to_stops(objective, q, lower, upper, 8.0))
    np.testing.assert_allclose(mine.linear, theirs.linear, rtol=ROUNDING, atol=ROUNDING)
    assert (mine is objective) == (theirs is objective)


@given(
    seed=st.integers(0, 2**32 - 1),
    pairs=st.sampled_from([1, 2, 64, 65]),
    joints=st.sampled_from([1, 7]),
)
def test_criteria(seed, pairs, joints):
    random = np.random.default_rng(seed)
    distance = random.normal(0.05, 0.1, pairs)  # some below the floor, some penetrating
    rate, other = random.normal(size=(2, pairs))
    rate[random.random(pairs) < 0.2] = 0.0
    rows = random.normal(size=(pairs, joints))
    floored = np.maximum(distance, criteria.DISTANCE_FLOOR_M)
    for name, function in (
        ("artc", lambda: criteria.artc_signed(distance, rate)),
        ("artc", lambda: criteria.artc_approaching(distance, rate)),
        ("armd", lambda: criteria.armd(distance)),
    ):
        mine, theirs = both(function)
        size = np.abs(rate / floored).mean() if name == "artc" else (1 / floored).mean()
        assert abs(mine - theirs) <= ROUNDING * size
    for name in criteria.CRITERIA:
        mine, theirs = both(
            lambda name=name: criteria.objective(name, distance, rate, rows, other_rate_m_s=other)
        )
        size = (np.abs(rows).max(axis=1) / floored**2 * (1.0 + np.abs(other))).max() * (
            1.0 + np.abs(rows).max()
        )
        np.testing.assert_allclose(mine.hessian, theirs.hessian, atol=ROUNDING * size, rtol=0)
        np.testing.assert_allclose(mine.linear, theirs.linear, atol=ROUNDING * size, rtol=0)
    for gradient in (criteria.artc_signed_gradient, criteria.armd_gradient):
        mine, theirs = both(lambda gradient=gradient: gradient(distance, rows))
        np.testing.assert_allclose(mine, theirs, atol=ROUNDING * size, rtol=0)


def test_numbers_lists_and_shapes_that_broadcast_are_left_to_numpy():
    for wish in ("compiled", "numpy"):
        with library.forced(wish):
            assert ttc.reciprocal_first_order([1.0, 2.0], -1.0).tolist() == [1.0, 0.5]
            assert ttc.reciprocal_first_order(2.0, -1.0) == 0.5
            assert ttc.reciprocal_first_order(np.ones((2, 2)), -np.ones(2)).shape == (2, 2)
            assert ttc.reciprocal_first_order(np.array([1, 2]), np.array([-1, -1]))[1] == 0.5
            assert len(ttc.reciprocal_first_order(np.zeros(0), np.zeros(0))) == 0
            assert ttc.smallest(np.zeros(0)).pair == -1
            assert criteria.artc_signed(np.zeros(0), np.zeros(0)) == 0.0


def test_what_was_returned_stays_when_the_function_is_called_again():
    kept = ttc.reciprocal_first_order(np.ones(3), -np.ones(3))
    objective = criteria.objective("armd", np.ones(3), np.ones(3), np.ones((3, 2)))
    ttc.reciprocal_first_order(np.ones(3), np.ones(3))
    criteria.objective("armd", np.ones(3), np.ones(3), np.zeros((3, 2)))
    assert kept.tolist() == [1.0, 1.0, 1.0]
    assert objective.linear.tolist() == [-1.0, -1.0]


# ---------------------------------------------------------------- inverse kinematics


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return scene.build(scenario.load("handover"), tmp_path_factory.mktemp("handover"))


@given(
    seed=st.integers(0, 2**32 - 1),
    turn_rad=st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 0.5, 2.5]),
    shift_m=st.sampled_from([0.0, 1e-6, 1e-3, 0.1]),
    free=st.booleans(),
    catch_up=st.sampled_from([np.inf, 0.1]),
)
@settings(max_examples=80)
def test_the_tool_rows_are_minks_and_the_solution_the_same(
    cell, seed, turn_rad, shift_m, free, catch_up
):
    random = np.random.default_rng(seed)
    arm = cell.arms[int(seed) % 2]
    configuration = mink.Configuration(cell.model)
    cell.place_home(configuration.data)
    qpos = configuration.data.qpos.copy()
    qpos[arm.qpos] += random.uniform(-0.5, 0.5, 7)
    configuration.update(qpos)
    pose = configuration.get_transform_frame_to_world(arm.tool_site_name, "site")
    axis = random.normal(size=3)
    turned = np.empty(4)
    mujoco.mju_axisAngle2Quat(turned, axis / np.linalg.norm(axis), turn_rad)
    wxyz = np.empty(4)
    mujoco.mju_mulQuat(wxyz, pose.rotation().wxyz, turned)
    target = Target(
        pose.translation() + shift_m * random.normal(size=3),
        wxyz,
        *random.normal(0, 0.1, (2, 3)),
    )
    inverse = ik.ArmIk(arm, nv=cell.model.nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
    gradient, rows, bounds = (
        random.normal(size=7),
        random.normal(size=(5, 7)),
        -np.abs(random.normal(1.0, 1.0, 5)),
    )

    def solve():
        whole = inverse.aim(configuration, target, catch_up_m_s=catch_up, free_rotation=free)
        task = inverse._tool_rows.copy(), inverse._tool_rates.copy(), inverse.path_rad_s.copy()
        solution = inverse.solve(
            configuration,
            np.clip(whole, -0.5, 0.5),
            criteria.NullspaceObjective(np.eye(7) * 0.1, gradient),
            rows,
            bounds,
        )
        return whole, *task, solution, inverse.tool_error

    mine, theirs = both(solve)
    np.testing.assert_allclose(mine[5], theirs[5], rtol=0, atol=1e-13)
    # mink's coefficients are quotients of differences and lose digits where frames are turned by little
    # against each other; below 1e-5 rad it leaves them out.
    blur = 1e-11 + (1e-15 / turn_rad**2 if turn_rad > 1e-5 else 0.0)
    for a, b in zip(mine[:4], theirs[:4], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=blur * (1.0 + np.abs(b).max()))
    assert mine[4].status == theirs[4].status
    # The program may enlarge what the rows differ by, where two of them are almost parallel.
    enlarged = 1e-7 + 1e4 * np.abs(mine[1] - theirs[1]).max()
    np.testing.assert_allclose(mine[4].velocity_rad_s, theirs[4].velocity_rad_s, atol=enlarged)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_what_the_joint_limits_let_through_is_the_same(cell, seed):
    """With joints before, at and beyond their stops, and any speed before."""
    random = np.random.default_rng(seed)
    arm = cell.arms[0]
    configuration = mink.Configuration(cell.model)
    cell.place_home(configuration.data)
    qpos = configuration.data.qpos.copy()
    qpos[arm.qpos] = _near_stops(random, arm)
    configuration.update(qpos)
    inverse = ik.ArmIk(arm, nv=cell.model.nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
    previous, wanted = random.normal(size=(2, 7))
    mine, theirs = both(lambda: inverse.followed(configuration, previous, wanted))
    np.testing.assert_allclose(mine, theirs, rtol=1e-13, atol=1e-13)


def _near_stops(random, arm) -> np.ndarray:
    """Joint positions, some of them before, at and beyond a stop."""
    stops = np.where(random.random(7) < 0.5, arm.lower_rad, arm.upper_rad)
    offset = random.choice([0.0, 1e-3, -1e-3, 0.1], 7)
    return np.where(random.random(7) < 0.5, arm.home_rad, stops + offset)


# ---------------------------------------------------------------- whole stages


@pytest.fixture(scope="module")
def stages(cell):
    """The nurse's share in compiled code, and what it stands for in NumPy, on the same pairs."""
    controller = Controller(cell)
    controller.step(*_home(cell))
    arms = {arm.addresses.name: arm for arm in controller._arms}
    return controller, arms


def _home(cell) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    return data.qpos.copy(), data.qvel.copy()


def _in_numpy(arm, controller) -> share.Share:
    """What an arm's share stands for, told the same about its meeting and its past."""
    mine = arm.share
    assert isinstance(mine, compiled_stages.CompiledShare)
    theirs = share.Share(mine.watched, arm.ik, controller._belief, mine.pairs, support=arm.support)
    theirs.meeting[...] = mine.meeting
    theirs.kept_other_m_s = None if mine.kept_other_m_s is None else mine.kept_other_m_s.copy()
    return theirs


def _muddle(random, watched) -> None:
    """Distances of all kinds, some rows of G without entries, pairs that are silent."""
    pairs, nv = watched.jacobian.shape
    kinds = [-0.02, 0.0, 0.01, 0.0100001, 0.004, 0.05, 0.3, 2.0]
    watched.distance_m[...] = random.choice(kinds, pairs) * random.uniform(0.9, 1.1)
    watched.jacobian[...] = random.normal(0, 0.3, (pairs, nv)) * (random.random((pairs, 1)) < 0.9)
    watched.silent[...] = random.random(pairs) < 0.1
    watched.ways_rad_s[...] = random.normal(0, 0.2, (share.WAYS, nv)) * random.integers(2)
    watched.rate_m_s[...] = watched.jacobian @ random.normal(0, 0.2, nv)


def _agree(mine: share.Rates, theirs: share.Rates) -> None:
    np.testing.assert_allclose(mine.rate_m_s, theirs.rate_m_s, rtol=0, atol=ROUNDING)
    assert mine.nearest == theirs.nearest
    if np.isinf(mine.first.ttc_s) or mine.first.ttc_s == 0.0:
        assert mine.first == theirs.first
        assert mine.cause == theirs.cause
        return
    # Of times that are equal to rounding either pair may be the first.
    assert mine.first.ttc_s == pytest.approx(theirs.first.ttc_s, rel=1e-9)
    if mine.first.pair == theirs.first.pair:
        assert mine.cause == theirs.cause


@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.sampled_from([0.0, 1e-5, 0.3]),
    criterion=st.sampled_from(criteria.CRITERIA),
    variant=st.sampled_from(["relative", "static"]),
    slow_down=st.sampled_from(["ttc", "distance"]),
    pushed=st.booleans(),
    name=st.sampled_from(["nurse", "surgeon"]),
)
@settings(max_examples=150, deadline=None)
def test_a_whole_stage_does_what_numpy_says(
    cell, stages, seed, speed, criterion, variant, slow_down, pushed, name
):
    random = np.random.default_rng(seed)
    controller, arms = stages
    arm, watched, belief = arms[name], controller._watched, controller._belief
    asked = cell.scenario.control.model_copy(
        update={"criterion": criterion, "variant": variant, "slow_down": slow_down}
    )
    qpos = _home(cell)[0]
    qpos[arm.addresses.qpos] = _near_stops(random, arm.addresses)
    belief.update(qpos)
    _muddle(random, watched)
    mine = arm.share
    mine.meeting[...] = random.random(len(mine.meeting)) < 0.2
    theirs = _in_numpy(arm, controller)

    qvel = speed * random.normal(size=cell.model.nv)
    for accel in (None, random.normal(0, 0.5, len(watched.distance_m))):
        _agree(watched.rates(qvel, accel), share.Watched.rates(watched, qvel, accel))
    for approaching in (False, True):
        np.testing.assert_allclose(
            mine.surroundings(approaching=approaching),
            theirs.surroundings(approaching=approaching),
            rtol=1e-10,
            atol=1e-9,
        )

    target = path.standing(arm.target.position_m + 0.1 * random.normal(size=3), arm.target.wxyz)
    task = arm.ik.aim(belief, target, catch_up_m_s=0.3)
    previous = random.normal(0, 0.2, 7)
    push = None
    if pushed:
        push = criteria.NullspaceObjective(np.zeros((7, 7)), random.normal(size=7))
    theirs.count_on_others(static=arm.support and variant == "static")
    rows, allowed = theirs.self_motion_rows(task, asked)
    mine._bind_program(arm.ik.aimed_by)
    solved = mine._solve(previous, qvel, asked, push)
    moved = mine.pairs.moved
    np.testing.assert_allclose(
        mine.other_m_s[moved], theirs.other_m_s[moved], rtol=0, atol=ROUNDING
    )
    kept = mine._program.arrays
    count = kept["counts"].tolist()[0]
    assert count == len(allowed)
    np.testing.assert_allclose(kept["rows"][:count], rows, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(kept["bounds"][:count], allowed, rtol=0, atol=1e-11)
    objective = push or theirs._criterion(qvel, asked)
    gain = arm.ik.criterion.gain
    np.testing.assert_allclose(kept["H"], np.eye(7) + gain * objective.hessian, rtol=1e-10)
    size = 1.0 + np.abs(gain * objective.linear).max()
    np.testing.assert_allclose(kept["c"], gain * objective.linear, rtol=0, atol=1e-10 * size)
    reference = theirs.solve(previous, task, qvel, asked, push)
    whole = mine.solve(previous, task, qvel, asked, push)
    assert whole.status == reference.status
    if solved is not None and reference.status == ik.OPTIMAL:
        np.testing.assert_allclose(solved, reference.velocity_rad_s, rtol=0, atol=1e-5)

    wanted, command = speed * random.normal(size=(2, 7))
    allowance, law = (s.allow(wanted, command, 0.002, asked) for s in (mine, theirs))
    assert allowance.bound.factor == pytest.approx(law.bound.factor, abs=1e-9)
    assert allowance.bound.shortfall_m_s == pytest.approx(law.bound.shortfall_m_s, abs=1e-12)
    assert allowance.pressed == law.pressed
    assert allowance.reach == law.reach
    assert mine.keeps(command, asked) == theirs.keeps(command, asked)
    if theirs.kept_other_m_s is not None:
        np.testing.assert_allclose(mine.kept_other_m_s, theirs.kept_other_m_s, atol=ROUNDING)


@pytest.mark.parametrize("name", ["handover", "busy_human", "three_arms"])
def test_stages_agree_on_the_way(tmp_path, name):
    """Every arm, in states of a run: the same answers, and none that is left to NumPy without need."""
    cell = scene.build(scenario.load(name), tmp_path)
    controller = Controller(cell)
    qpos, qvel = _home(cell)
    kept = 0
    for tick in range(600):
        record = controller.step(qpos, qvel)
        qvel = record.command_rad_s.copy()
        if tick % 20 == 0:
            watched = controller._watched
            _agree(watched.rates(qvel), share.Watched.rates(watched, qvel))
            for arm in controller._arms:
                mine, theirs = arm.share, _in_numpy(arm, controller)
                theirs.other_m_s[...] = mine.other_m_s
                wanted = arm.wanted_rad_s
                allowance, law = (
                    s.allow(wanted, wanted, cell.period_s, controller.settings)
                    for s in (mine, theirs)
                )
                assert allowance.bound.factor == pytest.approx(law.bound.factor, abs=1e-9)
                assert allowance.pressed == law.pressed
                keeps = mine.keeps(wanted, controller.settings)
                assert keeps == theirs.keeps(wanted, controller.settings)
                kept += keeps
        mujoco.mj_integratePos(cell.model, qpos, qvel, cell.period_s)
    assert kept > 20


def test_numbers_that_are_not_finite_are_told_by_name(cell, monkeypatch):
    qpos, qvel = _home(cell)
    for bad in (np.nan, np.inf):
        controller = Controller(cell)
        controller.step(qpos, qvel)
        arm = controller._arms[1]
        assert arm.jobs is not None
        target = path.standing(arm.target.position_m, np.array([bad, 0.0, 0.0, 0.0]))
        monkeypatch.setattr(arm.jobs, "target", lambda target=target: target)
        with pytest.raises(ControlFault, match="the tool target of arm nurse"):
            controller.step(qpos, qvel)


@given(
    st.lists(st.tuples(NUMBER, st.sampled_from([0.0, 5e-10, -5e-10, 2e-9, -1.0, 1.0])), min_size=1)
)
def test_what_is_on_a_bound_but_for_the_solvers_tolerance_is_set_on_it(rows):
    bound, offset = np.array(rows).T.copy()
    for low, high in ((bound, bound + 1.0), (bound - 1.0, bound)):
        mine, theirs = both(lambda low=low, high=high: ik.within(bound + offset, low, high))
        np.testing.assert_array_equal(mine, theirs)
        assert ((mine >= low) & (mine <= high)).all()
        assert (mine == bound)[np.abs(offset) <= 5e-10].all()


# ---------------------------------------------------------------- which is used


def test_an_array_that_is_not_what_is_meant_is_refused():
    with library.forced("compiled") as kernels:
        assert kernels is not None
        with pytest.raises(ValueError, match=r"kappa is float64 \(2,\); must be float64 \(3,\)"):
            kernels.bind("smallest", {"pairs": 3}, kappa=np.zeros(2))
        with pytest.raises(ValueError, match="C-contiguous"):
            kernels.bind("smallest", {"pairs": 3}, kappa=np.zeros(6)[::2])
        with pytest.raises(ValueError, match="no argument lambda"):
            kernels.bind("smallest", {"pairs": 3}, **{"lambda": np.zeros(3)})


SAY = "from workcell.control.kernels import library; print(library.in_use(), end='')"


def said(tmp_path, wish: str | None) -> subprocess.CompletedProcess[str]:
    """What a process of its own uses that looks for compiled code in an empty folder."""
    source = f"from pathlib import Path\nfrom workcell.control.kernels import library\nlibrary.folders = lambda: [Path({str(tmp_path)!r})]\n{SAY}"
    environment = {key: value for key, value in os.environ.items() if key != library.VARIABLE}
    return subprocess.run(
        [sys.executable, "-c", source],
        capture_output=True,
        text=True,
        check=False,
        env=environment | ({} if wish is None else {library.VARIABLE: wish}),
    )


def test_where_nothing_is_compiled_numpy_is_used_and_one_line_says_what_to_do(tmp_path):
    unasked = said(tmp_path, None)
    assert (unasked.stdout, unasked.returncode) == ("numpy", 0)
    assert unasked.stderr.splitlines() == [
        "ticks are slower than they could be: run `workcell compile` once"
    ]
    asked = said(tmp_path, "numpy")
    assert (asked.stdout, asked.stderr) == ("numpy", "")
    demanded = said(tmp_path, "compiled")
    assert demanded.returncode != 0
    assert "run `workcell compile` once" in demanded.stderr


def test_a_wish_that_is_none_is_refused():
    with (
        pytest.raises(InputError, match="must be `numpy`, `compiled` or empty"),
        library.forced("fast"),
    ):
        pass


def test_compiled_code_of_another_source_or_version_is_not_used(monkeypatch):
    library._load.cache_clear()
    monkeypatch.setattr(library, "key", lambda: "0" * 16)
    try:
        with pytest.raises(InputError, match="nothing is compiled"), library.forced("compiled"):
            pass
    finally:
        library._load.cache_clear()


def test_the_object_file_alone_does_as_well_where_there_is_no_linker():
    """LLVM then puts it into memory; the numbers are those of the same machine code."""
    for folder in library.folders():
        _, plain = library.files(folder)
        if plain.is_file():
            call = library.Kernels(plain).bind("smallest", {"pairs": 3})
            call.arrays["kappa"][:] = 1.0, 4.0, 2.0
            call.run()
            assert (call.done(), call.arrays["pair"][0], call.arrays["ttc"][0]) == (0, 1, 0.25)
            return
    pytest.fail("there is no object file")


def test_a_run_needs_neither_numba_nor_a_compiler():
    """Importing numba takes longer than all the rest of a cold start."""
    check = f"{SAY}\nimport sys, workcell.run\nassert 'numba' not in sys.modules"
    done = subprocess.run(
        [sys.executable, "-c", check],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {library.VARIABLE: "compiled"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("compiled by numba")


def test_geometry_built_before_the_choice_changes_follows_it(two_arms):
    model, data, geometry = two_arms
    update(model, data, np.zeros(model.nq))
    assert isinstance(geometry, PairGeometry)
    with library.forced("compiled"):
        assert geometry.compiled(data) is not None
    with library.forced("numpy"):
        assert geometry.compiled(data) is None
