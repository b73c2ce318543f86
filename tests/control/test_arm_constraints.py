"""What an arm's constraints answer is what the second opinion says, whatever state it is in."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.oracles import rule
from tests.control.oracles.arm import ArmOracle
from workcell import scenario
from workcell.control import criteria
from workcell.control.arm_constraints import ArmConstraints, ArmPairs
from workcell.control.ik import OPTIMAL, ArmIk
from workcell.control.watched import HYPOTHESES, Rates, Watched
from workcell.errors import WorkcellError
from workcell.motion.path import standing
from workcell.scene import cell as scene

ROUNDING = 1e-12
ARTC = criteria.KINDS["artc"]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return scene.build(scenario.load("handover"), tmp_path_factory.mktemp("handover"))


class Bench:
    """A cell's pairs in any state, and one arm's constraints."""

    def __init__(self, cell: scene.Cell, random: np.random.Generator, *, support: bool):
        self.cell, self.random = cell, random
        self.arm = cell.arms[int(support)]
        self.belief = mink.Configuration(cell.model)
        cell.place_home(self.belief.data)
        self.belief.update()
        pose = self.belief.get_transform_frame_to_world(self.arm.tool_site_name, "site")
        self.tool_m, self.tool_wxyz = pose.translation(), pose.rotation().wxyz
        qpos = self.belief.data.qpos.copy()
        stops = np.where(random.random(7) < 0.5, self.arm.lower_rad, self.arm.upper_rad)
        stops += random.choice([0.0, 1e-3, -1e-3, 0.1], 7)
        qpos[self.arm.qpos] = np.where(random.random(7) < 0.5, self.arm.home_rad, stops)
        self.belief.update(qpos)
        pairs, nv = len(cell.pairs.geoms), cell.model.nv
        self.watched = watched = Watched(pairs, [arm.dofs for arm in cell.arms], nv)
        kinds = [-0.02, 0.0, 0.01, 0.0100001, 0.004, 0.05, 0.3, 2.0]
        watched.distance_m[...] = random.choice(kinds, pairs) * random.uniform(0.9, 1.1)
        watched.jacobian[...] = random.normal(0, 0.3, (pairs, nv)) * (
            random.random((pairs, 1)) < 0.9
        )
        watched.inactive[...] = random.random(pairs) < 0.1
        watched.hypotheses_rad_s[...] = random.normal(0, 0.2, (HYPOTHESES, nv)) * random.integers(2)
        watched.rate_m_s[...] = watched.jacobian @ random.normal(0, 0.2, nv)
        moved, averaged, owned = (np.flatnonzero(random.random(pairs) < p) for p in (0.9, 0.6, 0.5))
        self.ik = ArmIk(self.arm, nv=nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
        self.constraints = ArmConstraints(
            watched,
            self.ik,
            self.belief,
            ArmPairs(moved, averaged, owned, random.random(len(owned)) < 0.2),
            support=support,
        )
        self.constraints.meeting[...] = random.random(len(owned)) < 0.2


def state_of(constraints: ArmConstraints, data: mujoco.MjData, *, approaching: bool):
    """Tool and elbow position, and what else is told of the arm."""
    position, elbow = np.empty((2, 3))
    frames = data.site_xpos, data.cvel, data.subtree_com
    return position, elbow, constraints.arm_state(frames, position, elbow, approaching=approaching)


def test_where_an_arm_is_and_how_fast(cell):
    bench = Bench(cell, np.random.default_rng(1), support=True)
    model, data, arm = cell.model, bench.belief.data, bench.arm
    data.qvel[:] = np.random.default_rng(2).normal(size=model.nv)
    mujoco.mj_comVel(model, data)
    position, elbow, (speed, *_) = state_of(bench.constraints, data, approaching=False)
    twist = np.empty(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, arm.tool_site, twist, 0)
    assert speed == pytest.approx(float(np.linalg.norm(twist[3:])), abs=ROUNDING)
    np.testing.assert_array_equal(position, data.site_xpos[arm.tool_site])
    assert arm.elbow_site is not None
    np.testing.assert_array_equal(elbow, data.site_xpos[arm.elbow_site])


def assert_rates_agree(watched: Watched, velocity, accel, found: Rates) -> None:
    rate = watched.jacobian @ velocity
    np.testing.assert_allclose(found.rate_m_s, rate, rtol=0, atol=ROUNDING)
    kappa = (
        rule.first_order(watched.distance_m, found.rate_m_s)
        if accel is None
        else rule.second_order(watched.distance_m, found.rate_m_s, accel)
    )
    ttc, pair = rule.smallest(np.where(watched.inactive, 0.0, kappa))
    assert (found.first.ttc_s, found.first.pair) == (ttc, pair)
    assert found.nearest == np.where(watched.inactive, np.inf, watched.distance_m).argmin()
    if pair >= 0:
        parts = [watched.jacobian[pair, dofs] @ velocity[dofs] for dofs in DOFS]
        assert parts[found.cause] == pytest.approx(min(parts), abs=ROUNDING)
    else:
        assert found.cause is None


DOFS: list[np.ndarray] = []


@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.sampled_from([0.0, 1e-5, 0.3]),
    criterion=st.sampled_from(criteria.CRITERIA),
    variant=st.sampled_from(["relative", "static"]),
    slow_down=st.sampled_from(["ttc", "distance"]),
    order=st.sampled_from([1, 2]),
    pushed=st.sampled_from(["no", "linear", "quadratic"]),
    support=st.booleans(),
    remembered=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_every_answer_of_a_share(
    cell, seed, speed, criterion, variant, slow_down, order, pushed, support, remembered
):
    random = np.random.default_rng(seed)
    bench = Bench(cell, random, support=support)
    DOFS[:] = [arm.dofs for arm in cell.arms]
    constraints, watched, ik = bench.constraints, bench.watched, bench.ik
    asked = cell.scenario.control.model_copy(
        update={"criterion": criterion, "variant": variant, "slow_down": slow_down}
    )
    oracle = ArmOracle(constraints, asked)
    accel = random.normal(0, 0.5, len(watched.distance_m))
    watched.accel_m_s2 = accel if order == 2 else None

    qvel = speed * random.normal(size=cell.model.nv)
    assert_rates_agree(watched, qvel, watched.accel_m_s2, watched.rates(qvel, watched.accel_m_s2))
    averaged = constraints.pairs.averaged
    for approaching in (False, True):
        np.testing.assert_allclose(
            state_of(constraints, bench.belief.data, approaching=approaching)[2][1:],
            rule.means(
                watched.distance_m[averaged], watched.rate_m_s[averaged], approaching=approaching
            ),
            rtol=1e-10, atol=1e-9,
        )  # fmt: skip

    target = standing(bench.tool_m + 0.1 * random.normal(size=3), bench.tool_wxyz)
    task = ik.aim(bench.belief, target, catch_up_m_s=0.3)
    previous = random.normal(0, 0.2, 7)
    push = None
    if pushed != "no":
        root = random.normal(size=(7, 7)) * (pushed == "quadratic")
        push = criteria.NullspaceObjective(root @ root.T, random.normal(size=7))
    static = support and variant == "static"
    other = oracle.other(static=static)
    rows, allowed = oracle.self_motion_rows(task, other)
    H, c = oracle.criterion(qvel, other, task) if push is None else (push.hessian, push.linear)
    kind = criteria.KINDS["none" if push else criterion]
    mine = constraints.solve(previous, task, qvel, asked, kind, push)
    moved = constraints.pairs.moved
    np.testing.assert_allclose(constraints.other_m_s[moved], other[moved], rtol=0, atol=ROUNDING)
    count = len(allowed)
    np.testing.assert_allclose(ik.space.rows[:count], rows, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(ik.space.bounds[:count], allowed, rtol=0, atol=1e-11)
    gain = ik.criterion.gain
    if mine.status == OPTIMAL:  # else the space holds a weaker program
        np.testing.assert_allclose(ik.space.H, np.eye(7) + gain * H, rtol=1e-10, atol=1e-10)
        size = 1.0 + np.abs(gain * c).max()
        np.testing.assert_allclose(ik.space.c, gain * c, rtol=0, atol=1e-10 * size)
    plain = ik.solve(bench.belief, previous, criteria.NullspaceObjective(H, c), rows, allowed)
    assert plain.status == mine.status
    np.testing.assert_allclose(mine.velocity_rad_s, plain.velocity_rad_s, rtol=0, atol=1e-5)

    constraints.other_m_s[...] = other
    if remembered:
        constraints.kept_other_m_s = (other + random.normal(0, 0.1, len(other)))[
            constraints.pairs.owned
        ]
    wanted, command = speed * random.normal(size=(2, 7))
    found = constraints.allow(wanted, command, 0.002, asked)
    (factor, _, _, short, _), must_yield = oracle.allow(wanted, other)
    assert found.bound.factor == pytest.approx(factor, abs=1e-9)
    assert found.bound.shortfall_m_s == pytest.approx(short, abs=1e-12)
    assert found.must_yield == must_yield
    limit = bench.arm.acceleration_limit_rad_s2
    with np.errstate(all="ignore"):
        reach = rule.acceleration_interval(command, wanted, limit, 0.002)
    assert (found.reach.lowest, found.reach.highest, found.reach.feasible) == reach
    assert constraints.is_free(wanted, asked) == (found.bound.factor == 1.0)

    kept, theirs = constraints.kept(command, asked), oracle.kept(command, other)
    np.testing.assert_array_equal(kept.rows, oracle.rows(constraints.pairs.owned))
    for name, values in theirs.items():
        np.testing.assert_allclose(getattr(kept, name), values, rtol=0, atol=1e-12)
    before = constraints.kept_other_m_s
    keeps = constraints.keeps(command, asked)
    assert keeps == (not (theirs["short"] | theirs["needs_more"]).any())
    if keeps:
        np.testing.assert_array_equal(constraints.kept_other_m_s, other[constraints.pairs.owned])
    else:
        assert constraints.kept_other_m_s is before


def test_a_number_that_is_not_finite_is_never_kept_and_is_named(cell):
    bench = Bench(cell, np.random.default_rng(1), support=True)
    constraints, watched = bench.constraints, bench.watched
    settings_, still = cell.scenario.control, np.zeros(7)
    task = bench.ik.aim(bench.belief, standing(bench.tool_m, bench.tool_wxyz))
    pair = int(constraints.pairs.moved[3])
    watched.distance_m[pair] = np.nan
    with pytest.raises(WorkcellError, match=f"watched pair {pair}: its distance nan"):
        watched.rates(np.zeros(cell.model.nv))
    with pytest.raises(FloatingPointError, match=f"arm nurse: .* in watched pair {pair}"):
        constraints.solve(still, task, np.zeros(cell.model.nv), settings_, ARTC)
    watched.distance_m[...] = 1.0
    watched.distance_m[constraints.pairs.owned[0]] = np.nan
    assert not constraints.keeps(still, settings_)
    with pytest.raises(WorkcellError, match=f"watched pair {constraints.pairs.owned[0]}"):
        constraints.allow(still, still, 0.002, settings_)
    watched.distance_m[...] = 1.0
    with pytest.raises(FloatingPointError, match=r"arm nurse: .* in joint "):
        constraints.solve(np.full(7, np.nan), task, np.zeros(cell.model.nv), settings_, ARTC)


def test_a_cell_without_pairs(cell):
    nv = cell.model.nv
    watched = Watched(0, [arm.dofs for arm in cell.arms], nv)
    found = watched.rates(np.ones(nv))
    assert (found.first.pair, found.nearest, found.cause) == (-1, None, None)
    ik = ArmIk(cell.arms[1], nv=nv, dt_s=0.002, task_gain_per_s=10.0, criterion_gain=8.0)
    belief = mink.Configuration(cell.model)
    none = np.zeros(0, dtype=np.intp)
    constraints = ArmConstraints(
        watched, ik, belief, ArmPairs(none, none, none, np.zeros(0, dtype=bool)), support=True
    )
    assert isinstance(constraints, ArmConstraints)
    assert state_of(constraints, belief.data, approaching=False)[2][1:] == (0.0, 0.0)
    assert constraints.keeps(np.ones(7), cell.scenario.control)
    assert (
        constraints.allow(np.ones(7), np.ones(7), 0.002, cell.scenario.control).bound.factor == 1.0
    )
